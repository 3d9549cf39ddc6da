"""The base of controllers about a plan: ports, estimate, gains, and bounds of duty."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from controllers.estimator import Estimator, StateEstimate, pack
from controllers.reduced_model import ReducedModel
from controllers.temperature_supervisor import TemperatureLimiter
from limb_systems import LimbParameters, Trajectory, split_state
from limb_systems.drake_python import weak_method
from limb_systems.simulation import PERIOD

MIN_GAIN_SHARE = 0.25  # of the mean gain, that a cold wire is taken to have at least
BEND_RATE_WEIGHT = 1e4  # s/rad, of errors of the bend rate over changes of duty
DUTY_ROUNDING = 1e-9  # of duty


class PlanController(LeafSystem):
    """The base of controllers for a limb of W wires and F bends.

    At each tick the `Estimator` takes the readings. A subclass returns a desired duty and further
    bend rates. The output is the duty within the caps of `TemperatureLimiter` that makes them.

    - input 0 ``measured_temperature``: V (W), °C; NaN where there is no reading
    - input 1 ``bend_angle``: φ (F), rad, as read; NaN where there is no reading
    - output 0 ``duty``: D (W), in [0, 1]
    - state, discrete, at 20 Hz: 0: the duty; 1: the `StateEstimate`, NaN before the first
      readings; subclasses may have more
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, parameters: LimbParameters, duty: np.ndarray):
        """
        Args:
            parameters: description of the limb.
            duty: initial duty (W,).
        """
        super().__init__()
        self._parameters = parameters
        self._estimator = Estimator(parameters)
        self._limiter = TemperatureLimiter(parameters)
        model = self._estimator.model
        self._gains = model.mean_gains
        # Ports and the discrete state, which is updated at each tick.
        self.DeclareVectorInputPort("measured_temperature", model.num_wires)
        self.DeclareVectorInputPort("bend_angle", model.num_bends)
        state = self.DeclareDiscreteState(duty)
        self.DeclareDiscreteState(self._estimator.nothing)
        self.DeclareStateOutputPort("duty", state)
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))

    def _update(self, context, state) -> None:
        # Estimate the limb's state from the readings.
        time = self._plan_time(context)
        readings, bend = (self.get_input_port(index).Eval(context) for index in range(2))
        known_offset = self._known_offset(time)
        estimate = self._estimator.read(state.value(1), readings, bend, known_offset)
        # Find the duty within the caps that makes the desired bend rates.
        caps = self._limiter.caps(estimate, self._temperature_limit(time, estimate))
        base, bend_rate = self._desired_duty(time, estimate, caps, state)
        base = np.clip(base, 0.0, caps)
        duty = allocate(bend_rate, base, self._gains_at(time), caps)
        duty = limit_total_duty(duty, self._parameters.total_duty)
        state.set_value(0, duty)
        # Predict the estimate of the next tick.
        ahead = self._estimator.predict(estimate, duty)
        state.set_value(1, pack(ahead))
        self._after_update(context, ahead, state)

    def _desired_duty(
        self, time: float, estimate: StateEstimate, caps: np.ndarray, state
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return a desired duty (W,), and the bend rates (F,), rad/s, to make beyond it.

        Args:
            time: time since the start of the plan, s.
            estimate: estimate of the limb.
            caps: the most duty that each wire may have (W,).
            state: the discrete values, for subclasses with more of them.
        """
        raise NotImplementedError

    def _known_offset(self, time: float) -> np.ndarray | float:
        """Return the bends (F,), rad, that the plan has from outside; none by default."""
        return 0.0

    def _gains_at(self, time: float) -> np.ndarray:
        """Return the bend rates by full duty of each wire (F, W), rad/s, as for `allocate`."""
        return self._gains

    def _after_update(self, context, ahead: StateEstimate, state) -> None:
        """Update the states of a subclass; ``ahead`` is the estimate of the next tick."""

    def _plan_time(self, context) -> float:
        """Return the time since the start of the plan, s."""
        return context.get_time()

    def _temperature_limit(self, time: float, estimate: StateEstimate) -> np.ndarray | None:
        """Return lower limits of the wires (W,), °C, than `TemperatureLimiter` has, if any."""
        return None


class SampledPlan:
    """A plan at the controllers' period.

    - ``duty``: mean duty over each period (K, W).
    - ``bend_angle``, ``reference``: φ* and φ_ref at the ends of the periods (K, F), rad.
    - ``temperature``: T* at the beginnings of the periods (K, W), °C.
    - ``heat``: [x, V] at the beginnings of the periods (K, H).

    Args:
        trajectory: the plan.
        parameters: description of the limb; if it is not the plan's, ``heat`` is the heat of this
            limb under the plan's duty.
    """

    def __init__(self, trajectory: Trajectory, parameters: LimbParameters):
        plan = trajectory.since_start()
        times = PERIOD * np.arange(int(np.ceil(plan.duration / PERIOD)) + 1)
        middle = np.minimum(times + PERIOD / 2, plan.duration)
        end = np.minimum(times + PERIOD, plan.duration)
        self.duty = np.clip(plan.duty_trajectory().vector_values(middle).T, 0.0, 1.0)
        self.bend_angle = plan.bend_angle_at(end).T
        self.reference = plan.interpolated(plan.reference, end).T
        states = plan.state_trajectory().vector_values(np.minimum(times, plan.duration))
        self.heat = np.vstack(split_state(plan.parameters, states)[2:]).T
        self.temperature = self.heat[:, : len(plan.duty)]
        if parameters != plan.parameters:
            model = ReducedModel(parameters)
            self.heat = model.rollout(model.rested(plan.measured_temperature[:, 0]), self.duty[:-1])

    def index(self, time: float) -> int:
        """Return the index of the period that begins at a time, s; the last one after the end."""
        return min(round(time / PERIOD), len(self.duty) - 1)


def limit_total_duty(duty: np.ndarray, total: float) -> np.ndarray:
    """Return duty (W, ...) in the same proportions that adds up to no more than a total."""
    return duty * np.minimum(1.0, total / np.maximum(duty.sum(axis=0), 1e-9))


def allocate(
    bend_rate: np.ndarray, duty: np.ndarray, gains: np.ndarray, caps: np.ndarray
) -> np.ndarray:
    """Return the duty (W,) nearest to a given duty that bends a limb faster by a given rate.

    The wires of a bend change it in proportion to their gains, δ = λ g. Where the duty of a wire is
    at zero or at its cap, the other wires take over, as far as they can. Wires with a part in two
    bends change by Σ λ g, likewise: as wires cannot be cooled, the wires on the other side heat.

    Args:
        bend_rate: additional bend rates (F,), rad/s.
        duty: the given duty (W,), within the caps.
        gains: g, rate of each bend by duty of each wire (F, W), rad/s.
        caps: the most duty of each wire (W,).
    """
    if (np.count_nonzero(gains, axis=0) > 1).any():
        from scipy.optimize import lsq_linear  # takes long to import

        costs = np.vstack([BEND_RATE_WEIGHT * gains, np.eye(len(duty))])
        target = np.append(BEND_RATE_WEIGHT * bend_rate, 0.0 * duty)
        # The method needs bounds that differ.
        bounds = (-duty - DUTY_ROUNDING, caps - duty + DUTY_ROUNDING)
        change = lsq_linear(costs, target, bounds, method="bvls", tol=1e-15).x
        return np.clip(duty + change, 0.0, caps)
    result = duty.copy()
    for rate, gain in zip(bend_rate, gains, strict=True):
        wires = np.flatnonzero(gain)
        g = gain[wires]
        least = -duty[wires]
        most = (caps - duty)[wires]
        # Σ g δ is piecewise linear in λ, with corners where a wire gets to a bound.
        corners = np.unique(np.concatenate([least / g, most / g]))
        changes = np.clip(corners[:, None] * g, least, most)
        scale = np.interp(rate, changes @ g, corners)
        result[wires] += np.clip(scale * g, least, most)
    return result


def gains_along_plan(model: ReducedModel, plan: SampledPlan) -> np.ndarray:
    """Return g (K, F, W), rad/s, the bend rate by full duty along a plan.

    It is at least a quarter of the mean, as a cold wire gets warm.

    It is not more than the mean, as a wire that transforms now may not do so later.
    """
    mean = model.mean_gains
    by_duty = model.bend_slopes(plan.heat)[1] @ model.linearized_step(plan.heat, plan.duty)[2]
    towards = by_duty / PERIOD * np.sign(mean)
    return np.sign(mean) * np.clip(towards, MIN_GAIN_SHARE * np.abs(mean), np.abs(mean))
