"""Feedback that holds wires to the heat of a plan: the default on robots that walk in space."""

import numpy as np

from controllers.estimator import StateEstimate
from controllers.plan_controller import PlanController, SampledPlan
from controllers.reduced_model import ReducedModel
from limb_systems import LimbParameters, Trajectory

PROPORTIONAL_GAIN = 1.0  # 1/s


class HeatFeedback(PlanController):
    """Proportional feedback of the estimated temperature of each wire about a plan.

    Limbs that stand on the ground together bend as the ground lets them. Feedback of a bend that
    feet hold heats the wires of that limb against each other until the feet slip: on a robot of
    three limbs under `PlanFeedback`, wires were 12 °C warmer than planned, and the fifth stride was
    two fifths of the first. With the heat of the plan, though, the wires have the plan's torques,
    whatever the feet do:

        D = D* + k (T* - T) / a2

    Up to what the model does not say of the limbs, this makes what the plan makes in open loop,
    with a supply, air or wires that heat otherwise than described, and from cold wires.

    No duty is beyond what `TemperatureLimiter` allows, and there is none after the plan's end.

    For ports and state see `PlanController`.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, trajectory: Trajectory, *, parameters: LimbParameters | None = None):
        """
        Args:
            trajectory: the plan.
            parameters: description of the limb, of which estimates are made; the plan's if None.
        """
        parameters = LimbParameters.of(parameters or trajectory.parameters)
        self._plan = SampledPlan(trajectory, parameters)
        self._duration = trajectory.duration
        super().__init__(parameters, self._plan.duty[0])

    def _desired_duty(self, time: float, estimate: StateEstimate, caps: np.ndarray, state):
        k = self._plan.index(time)
        model = self._estimator.model
        if time > self._duration:
            return np.zeros(model.num_wires), np.zeros(model.num_bends)
        duty = self._plan.duty[k] + heating_duty(model, self._plan.temperature[k], estimate)
        return duty, np.zeros(model.num_bends)


def heating_duty(
    model: ReducedModel, temperature: np.ndarray, estimate: StateEstimate
) -> np.ndarray:
    """Return the duty k (T* - T) / a2 (W,) that brings wires to planned temperatures (W,), °C."""
    colder = temperature - model.temperatures(estimate.heat)
    return PROPORTIONAL_GAIN * colder / model.heating_rates
