"""Feedback that holds a limb to its plan: proportional, the default on robots, and LQR."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from controllers.estimator import StateEstimate
from controllers.plan_controller import (
    PlanController,
    SampledPlan,
    planned_gains,
)
from controllers.reduced_model import ReducedModel
from limb_systems import LimbModel, LimbParameters, Trajectory
from limb_systems.simulation import PERIOD

PROPORTIONAL = 2.5  # 1/s
FORESEEN = 10  # ticks of the plan's coming duty, after which the bend is to be that of the plan
COMMON_MODE = 5.0  # 1/s
# °C, that a wire of a limb that is calibrated, or is not, may be warmer than planned within these s
WARMER, WARMER_UNCALIBRATED, AHEAD = 6.0, 20.0, 2.0
# °C below T_max, from where on a limb that is not calibrated is not heated beyond its plan's
# highest: its wires may be as much warmer than estimated.
UNCALIBRATED_MARGIN = 10.0
LUKEWARM = 10.0  # °C above T_warm, that it may have in any case
# Deviations that cost alike; (15) has no weight on temperature, but feedback runs out of heat.
BEND = np.deg2rad(0.5)  # rad
DUTY = 0.2
TEMPERATURE = 10.0  # °C


class PlanFeedback(PlanController):
    """Proportional feedback of the estimated bend about a plan, with an estimated disturbance.

    The `Estimator` says how the wires bend the limb, φ(x), and by how much it is bent
    otherwise, p, which takes the place of an integral and cannot wind up. The model under the
    coming 0.5 s of the plan's duty leads from x to x⁺. What is wanted of the wires in addition
    to the plan's duty is the bend rate

        w = k_p (clip(φ⁺, φ*⁺, φ_ref⁺) - φ⁺),  φ⁺ = φ(x⁺) + p

    with φ⁺ clipped to what lies between plan and reference: a limb that is nearer to the reference
    than planned is left there. The wires share w: D = D* + λ g, with g the bend rate that full duty
    makes there. A wire that the plan heats for the next reversal bends nothing at first, within the
    play of its hysteresis. What the limb misses now takes no duty from it if the reversal makes up
    for it.

    As the antagonists can always push, what runs out is heat. Where the wires of a segment are
    warmer than in the plan on average, the plan's duty is reduced, so that they cool:

        D* - k_c max(0, mean T - mean T*) / a2

    The bend rate that the plan's duty makes is wanted all the same, of the wires together.

    No duty is beyond what `TemperatureLimiter` allows, and no wire is heated to more than
    6 °C beyond the most that it has in the next 2 s of the plan, and what holds p (20 °C if
    the limb is not calibrated, but then at most to 10 °C below T_max, or to the highest of the
    plan): a bend that needs more is left, as heat would stay for long after it. Up to 10 °C above
    T_warm there is no such limit, as wires cool from there soon.

    Ports and state are those of `PlanController`.
    """

    __slots__ = ()  # see limb_systems.drake_python

    _uncalibrated_margin = UNCALIBRATED_MARGIN

    def __init__(
        self,
        trajectory: Trajectory,
        *,
        parameters: LimbParameters | None = None,
        proportional: float = PROPORTIONAL,
        known_start: bool = False,
    ):
        """
        Args:
            trajectory: the plan.
            parameters: description of the limb, of which gains and estimates are made; the
                plan's if None.
            proportional: k_p, 1/s.
            known_start: whether the limb begins with the plan's heat and bend, as one that is warm
                or carries a load; else at rest, as its first readings show.
        """
        parameters = LimbParameters.of(parameters or trajectory.parameters)
        self._plan, self._proportional = SampledPlan(trajectory, parameters), proportional
        start = (self._plan.heat[0], trajectory.bend_angle[:, 0]) if known_start else None
        super().__init__(parameters, self._plan.duty[0], start)
        model = self._estimator.model
        self._planned_gains = planned_gains(model, self._plan)
        self._to_mean = np.zeros((model.num_wires, model.num_wires))
        for wires in LimbModel.of(parameters).layout.wires_of:
            self._to_mean[wires, wires] = 1.0 / (wires.stop - wires.start)
        planned = self._plan.temperature
        self._planned_mean = self._mean(planned)
        ahead = round(AHEAD / PERIOD)
        later = np.pad(planned, ((0, ahead), (0, 0)), mode="edge")
        self._highest = sliding_window_view(later, ahead + 1, axis=0).max(axis=-1)
        self._warmer = WARMER if parameters.calibration else WARMER_UNCALIBRATED

    def _wanted(self, time: float, estimate: StateEstimate, caps: np.ndarray, state):
        k, model = self._plan.index(time), self._estimator.model
        bends, reference, duties = self._planned(time + PERIOD * np.arange(FORESEEN), state)
        heat = model.rollout(estimate.heat, duties)[-1]
        foreseen = model.bend_angle(heat) + estimate.offset
        missed = np.clip(foreseen, *np.sort([bends[-1], reference[-1]], axis=0)) - foreseen
        warmer = self._mean(model.temperatures(estimate.heat)) - self._planned_mean[k]
        base = duties[0] - COMMON_MODE * np.maximum(warmer, 0.0) / model.heating_rates
        base = np.clip(base, 0.0, caps)
        return base, self._proportional * missed + self._gains_at(time) @ (duties[0] - base)

    def _gains_at(self, time: float) -> np.ndarray:
        return self._planned_gains[self._plan.index(time)]

    def _planned(self, times: np.ndarray, state) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """φ* and φ_ref (K, F), rad, and D* (K, W) of the periods at times, s.

        Args:
            state: as of `_wanted`.
        """
        plan, periods = self._plan, [self._plan.index(time) for time in times]
        return plan.bend_angle[periods], plan.reference[periods], plan.duty[periods]

    def _temperature_limit(self, time: float, estimate: StateEstimate) -> np.ndarray:
        held = self._estimator.model.temperature_to_hold(estimate.offset)
        limits, planned = self._parameters.temperature_limits, self._highest[self._plan.index(time)]
        warmer = np.maximum(planned + self._warmer + held, limits.warm + LUKEWARM)
        if not self._parameters.calibration:
            most = np.maximum(limits.maximum - self._uncalibrated_margin, self._highest.max(axis=0))
            warmer = np.minimum(warmer, most)
        return warmer

    def _mean(self, temperature: np.ndarray) -> np.ndarray:
        """The mean over the wires of each wire's segment (..., W) of T (..., W), °C."""
        return temperature @ self._to_mean


class PlanRegulator(PlanController):
    """The linear-quadratic regulator about a plan on `ReducedModel`, time-varying.

    The least of, summed over the periods to the end of the plan,

        (δφ / 0.5°)² + Σ (δT / 10 °C)² + Σ (δD / 0.2)²

    for deviations from the plan that the `Estimator` sees, and a bend p from outside that
    stays: D = D* - K(t) [x - x*, p]. What a wire cannot do of it the others of its segment
    do, as far as they can. No duty is beyond what `TemperatureLimiter` allows.

    Ports and state are those of `PlanController`.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, trajectory: Trajectory, *, parameters: LimbParameters | None = None):
        """
        Args:
            trajectory: the plan.
            parameters: description of the limb, of which gains and estimates are made; the
                plan's if None.
        """
        parameters = LimbParameters.of(parameters or trajectory.parameters)
        self._plan = SampledPlan(trajectory, parameters)
        super().__init__(parameters, self._plan.duty[0])
        self._regulator = regulator_gains(self._estimator.model, self._plan)
        # How other parameters than the plan's bend otherwise under the plan's duty.
        first = trajectory.bend_angle[:, :1].T
        planned = np.vstack([first, self._plan.bend_angle[:-1]])
        self._unlike_plan = self._estimator.model.bend_angle(self._plan.heat) - planned

    def _wanted(self, time: float, estimate: StateEstimate, caps: np.ndarray, state):
        k, N = self._plan.index(time), estimate.heat.size - len(caps)
        offset = estimate.offset + self._unlike_plan[k]
        deviation = np.append((estimate.heat - self._plan.heat[k])[:N], offset)
        wanted = self._plan.duty[k] - self._regulator[k] @ deviation
        return wanted, self._gains @ (wanted - np.clip(wanted, 0.0, caps))


def regulator_gains(model: ReducedModel, plan: SampledPlan) -> np.ndarray:
    """K (periods, W, N + F) of `PlanRegulator`, by the Riccati recursion from the plan's end.

    The bend at the beginning of a period counts at its end, and so not in the last one.
    """
    W, F, N = model.num_wires, model.num_bends, model.size - model.num_wires
    _, by_heat, by_duty = model.linearized_step(plan.heat, plan.duty)
    slopes = model.bend_slopes(plan.heat)[1]
    A, B, P = np.eye(N + F), np.zeros((N + F, W)), np.zeros((N + F, N + F))
    cost, gains = np.diag(np.append(np.full(W, TEMPERATURE**-2), np.zeros(N + F - W))), []
    for k in reversed(range(len(by_heat))):
        A[:N, :N], B[:N] = by_heat[k, :N, :N], by_duty[k, :N]
        gains.append(np.linalg.solve(DUTY**-2 * np.eye(W) + B.T @ P @ B, B.T @ P @ A))
        C = np.hstack([slopes[k, :, :N], np.eye(F)])
        bend_cost = C.T @ C * BEND**-2 if len(gains) > 1 else 0.0
        P = cost + bend_cost + A.T @ P @ (A - B @ gains[-1])
    return np.array(gains[::-1])
