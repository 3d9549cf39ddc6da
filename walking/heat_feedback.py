"""Feedback that holds wires to the heat of a plan: the default on robots that walk in space."""

import numpy as np

from controllers.estimator import StateEstimate
from controllers.plan_controller import PlanController, SampledPlan
from limb_systems import LimbParameters, Trajectory

PROPORTIONAL = 1.0  # 1/s


class HeatFeedback(PlanController):
    """Proportional feedback of the estimated temperature of each wire about a plan.

    Limbs that stand on the ground together bend as the ground lets them. Feedback of a bend that
    feet hold heats the wires of that limb against each other until the feet slip: on a robot of
    three limbs under `PlanFeedback`, wires were 12 °C warmer than planned, and the fifth stride was
    two fifths of the first. With the heat of the plan, though, the wires' torques are those of the
    plan, whatever the feet do:

        D = D* + k (T* - T) / a2

    Up to what the model does not say of the limbs, this makes what the plan makes in open loop,
    with a supply, air or wires that heat otherwise than described, and from cold wires.

    No duty is beyond what `TemperatureLimiter` allows, and there is none after the plan's end.

    Ports and state are those of `PlanController`.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, trajectory: Trajectory, *, parameters: LimbParameters | None = None):
        """
        Args:
            trajectory: the plan.
            parameters: description of the limb, of which estimates are made; the plan's if None.
        """
        parameters = LimbParameters.of(parameters or trajectory.parameters)
        self._plan, self._duration = SampledPlan(trajectory, parameters), trajectory.duration
        super().__init__(parameters, self._plan.duty[0])

    def _desired_duty(self, time: float, estimate: StateEstimate, caps: np.ndarray, state):
        k, model = self._plan.index(time), self._estimator.model
        if time > self._duration:
            return np.zeros(model.num_wires), np.zeros(model.num_bends)
        colder = self._plan.temperature[k] - model.temperatures(estimate.heat)
        duty = self._plan.duty[k] + PROPORTIONAL * colder / model.heating_rates
        return duty, np.zeros(model.num_bends)
