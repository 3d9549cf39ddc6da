"""Feedback that holds a limb to its plan: proportional, the default on robots, and LQR."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from controllers.estimator import StateEstimate
from controllers.plan_controller import PlanController, SampledPlan, gains_along_plan
from controllers.reduced_model import ReducedModel
from limb_systems import LimbModel, LimbParameters, Trajectory
from limb_systems.simulation import PERIOD

PROPORTIONAL_GAIN = 2.5  # 1/s
PREVIEW_TICKS = 10  # of the plan's coming duty, after which the bend is compared with the plan
COMMON_MODE_GAIN = 5.0  # 1/s
PREVIEW_TIME = 2.0  # s of the plan, whose highest temperature limits a wire
MAX_EXCESS = 6.0  # °C beyond it, for a calibrated limb
MAX_EXCESS_UNCALIBRATED = 20.0  # °C, for a limb that is not calibrated
# °C below T_max, from where on a limb that is not calibrated is not heated beyond its plan's
# highest: its wires may be as much warmer than estimated.
UNCALIBRATED_MARGIN = 10.0
WARM_MARGIN = 10.0  # °C above T_warm, up to which heat is not limited
# Deviations of equal cost; (15) has no weight on temperature, but feedback runs out of heat.
BEND_DEVIATION = np.deg2rad(0.5)  # rad
DUTY_DEVIATION = 0.2
TEMPERATURE_DEVIATION = 10.0  # °C


class PlanFeedback(PlanController):
    """Proportional feedback of the estimated bend about a plan, with an estimated disturbance.

    The `Estimator` estimates the bend φ(x) that the wires make, and the rest of the bend, p, which
    takes the place of an integral and cannot wind up. The model under the
    coming 0.5 s of the plan's duty leads from x to x⁺. The wires are to make, in addition
    to the plan's duty, the bend rate

        w = k_p (clip(φ⁺, φ*⁺, φ_ref⁺) - φ⁺),  φ⁺ = φ(x⁺) + p

    with φ⁺ clipped to the range between plan and reference: a limb that is nearer to the reference
    than planned stays there. The wires share w: D = D* + λ g, with g the bend rate that full duty
    makes there. A wire that the plan heats for the next reversal bends nothing at first, within the
    play of its hysteresis. An error that the reversal removes takes no duty from it.

    As the antagonists can always push, heat is the scarce resource. Where a segment's wires are
    warmer than in the plan on average, the plan's duty is reduced, so that they cool:

        D* - k_c max(0, mean T - mean T*) / a2

    The wires together still make the bend rate of the plan's duty.

    No duty exceeds the caps of `TemperatureLimiter`, and no wire is heated to more than
    6 °C beyond its highest temperature in the next 2 s of the plan and the heat that holds p (20 °C
    if the limb is not calibrated, but then at most to 10 °C below T_max, or to the highest of the
    plan). A bend that needs more heat is given up, as the heat would stay for long after it. Up to
    10 °C above T_warm there is no such limit, as wires cool from there soon.

    Ports and state are as in `PlanController`.
    """

    __slots__ = ()  # see limb_systems.drake_python

    _uncalibrated_margin = UNCALIBRATED_MARGIN

    def __init__(self, trajectory: Trajectory, *, parameters: LimbParameters | None = None):
        """
        Args:
            trajectory: the plan.
            parameters: description of the limb, for gains and estimates; the plan's if None.
        """
        parameters = LimbParameters.of(parameters or trajectory.parameters)
        self._plan = SampledPlan(trajectory, parameters)
        super().__init__(parameters, self._plan.duty[0])
        model = self._estimator.model
        self._planned_gains = gains_along_plan(model, self._plan)
        self._to_mean = np.zeros((model.num_wires, model.num_wires))
        for wires in LimbModel.of(parameters).layout.wires_of:
            self._to_mean[wires, wires] = 1.0 / (wires.stop - wires.start)
        # The mean of each segment's wires, and the highest temperature of the coming seconds.
        planned = self._plan.temperature
        self._planned_mean = self._mean(planned)
        ahead = round(PREVIEW_TIME / PERIOD)
        later = np.pad(planned, ((0, ahead), (0, 0)), mode="edge")
        self._highest = sliding_window_view(later, ahead + 1, axis=0).max(axis=-1)
        self._max_excess = MAX_EXCESS if parameters.calibration else MAX_EXCESS_UNCALIBRATED

    def _desired_duty(self, time: float, estimate: StateEstimate, caps: np.ndarray, state):
        k = self._plan.index(time)
        model = self._estimator.model
        error = self._predicted_error(time, estimate, state)
        duty = self._planned(np.array([time]), state)[-1][0]
        # Let wires cool where they are warmer than planned on average.
        warmer = self._mean(model.temperatures(estimate.heat)) - self._planned_mean[k]
        base = duty - COMMON_MODE_GAIN * np.maximum(warmer, 0.0) / model.heating_rates
        base = np.clip(base, 0.0, caps)
        return base, PROPORTIONAL_GAIN * error + self._gains_at(time) @ (duty - base)

    def _predicted_error(self, time: float, estimate: StateEstimate, state) -> np.ndarray:
        """Return the bends (F,), rad, that will be missing under the coming duty of the plan."""
        model = self._estimator.model
        times = time + PERIOD * np.arange(PREVIEW_TICKS)
        bends, reference, duties = self._planned(times, state)
        heat = model.rollout(estimate.heat, duties)[-1]
        predicted = model.bend_angle(heat) + estimate.offset
        nearest = np.clip(predicted, *np.sort([bends[-1], reference[-1]], axis=0))
        return nearest - predicted

    def _gains_at(self, time: float) -> np.ndarray:
        return self._planned_gains[self._plan.index(time)]

    def _planned(self, times: np.ndarray, state) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return φ* and φ_ref (K, F), rad, and D* (K, W) of the periods at times (K,), s.

        Args:
            state: as for `_desired_duty`.
        """
        plan = self._plan
        periods = [self._plan.index(time) for time in times]
        return plan.bend_angle[periods], plan.reference[periods], plan.duty[periods]

    def _temperature_limit(self, time: float, estimate: StateEstimate) -> np.ndarray:
        to_hold = self._estimator.model.temperature_to_hold(estimate.offset)
        limits = self._parameters.temperature_limits
        highest = self._highest[self._plan.index(time)] + self._max_excess + to_hold
        limit = np.maximum(highest, limits.warm + WARM_MARGIN)
        if not self._parameters.calibration:
            margin = limits.maximum - self._uncalibrated_margin
            limit = np.minimum(limit, np.maximum(margin, self._highest.max(axis=0)))
        return limit

    def _mean(self, temperature: np.ndarray) -> np.ndarray:
        """Return the mean of T (..., W), °C, over the segment of each wire (..., W)."""
        return temperature @ self._to_mean


class PlanRegulator(PlanController):
    """The linear-quadratic regulator about a plan on `ReducedModel`, time-varying.

    The least of, summed over the periods to the end of the plan,

        (δφ / 0.5°)² + Σ (δT / 10 °C)² + Σ (δD / 0.2)²

    for deviations from the plan that the `Estimator` sees, and a bend p from outside that
    stays: D = D* - K(t) [x - x*, p]. Where the duty of a wire is at a bound, the other wires of its
    segment take over, as far as they can. No duty exceeds the caps of `TemperatureLimiter`.

    Ports and state are as in `PlanController`.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, trajectory: Trajectory):
        """
        Args:
            trajectory: the plan.
        """
        parameters = LimbParameters.of(trajectory.parameters)
        self._plan = SampledPlan(trajectory, parameters)
        super().__init__(parameters, self._plan.duty[0])
        self._regulator = regulator_gains(self._estimator.model, self._plan)
        # The reduced model bends otherwise under the plan's duty.
        first = trajectory.bend_angle[:, :1].T
        planned = np.vstack([first, self._plan.bend_angle[:-1]])
        self._plan_difference = self._estimator.model.bend_angle(self._plan.heat) - planned

    def _desired_duty(self, time: float, estimate: StateEstimate, caps: np.ndarray, state):
        k = self._plan.index(time)
        N = estimate.heat.size - len(caps)
        offset = estimate.offset + self._plan_difference[k]
        deviation = np.append((estimate.heat - self._plan.heat[k])[:N], offset)
        duty = self._plan.duty[k] - self._regulator[k] @ deviation
        return duty, self._gains @ (duty - np.clip(duty, 0.0, caps))


def regulator_gains(model: ReducedModel, plan: SampledPlan) -> np.ndarray:
    """Return K (periods, W, N + F) of `PlanRegulator`, by the Riccati recursion from the end.

    The bend at the beginning of a period counts at its end, and so not in the last one.
    """
    W = model.num_wires
    F = model.num_bends
    N = model.size - W
    _, by_heat, by_duty = model.linearized_step(plan.heat, plan.duty)
    slopes = model.bend_slopes(plan.heat)[1]
    # The state is [x, p], and p stays.
    A = np.eye(N + F)
    B = np.zeros((N + F, W))
    P = np.zeros((N + F, N + F))
    state_cost = np.zeros((N + F, N + F))
    state_cost[:W, :W] = TEMPERATURE_DEVIATION**-2 * np.eye(W)
    duty_cost = DUTY_DEVIATION**-2 * np.eye(W)
    gains: list[np.ndarray] = []
    # From the end of the plan to its beginning.
    for k in reversed(range(len(by_heat))):
        A[:N, :N] = by_heat[k, :N, :N]
        B[:N] = by_duty[k, :N]
        gains.append(np.linalg.solve(duty_cost + B.T @ P @ B, B.T @ P @ A))
        C = np.hstack([slopes[k, :, :N], np.eye(F)])
        bend_cost = C.T @ C * BEND_DEVIATION**-2 if len(gains) > 1 else 0.0
        P = state_cost + bend_cost + A.T @ P @ (A - B @ gains[-1])
    return np.array(gains[::-1])
