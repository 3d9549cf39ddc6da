"""Feedback that holds a limb to its plan: the default on robots."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from controllers.estimator import Estimate
from controllers.gains import mean_gains, planned_gains
from controllers.plan_controller import PlanController, SampledPlan, share
from controllers.reduced_model import PERIOD
from limb_systems import LimbParameters, Trajectory

PROPORTIONAL = 2.5  # 1/s
COMMON_MODE = 0.5  # 1/s
# °C, that a wire of a limb that is calibrated, or is not, may be warmer than planned within these s
WARMER, WARMER_UNCALIBRATED, AHEAD = 8.0, 20.0, 2.0
LUKEWARM = 30.0  # °C above T_warm, that it may have in any case


class PlanFeedback(PlanController):
    """Proportional feedback of the estimated bend about a plan, with an estimated disturbance.

    The `Estimator` says how the wires bend the limb, φ(x), and by how much it is bent
    otherwise, p, which takes the place of an integral and cannot wind up. What is wanted of
    the wires in addition to the plan's duty is the bend rate

        w = k_p (φ* - p - φ(x))

    which both wires share: D = D* + λ g, with g the bend rate that full duty makes there. As the
    antagonist can always push, what runs out is heat. Where the wires of a segment are
    warmer than in the plan on average, the plan's duty is reduced, so that they cool:

        D* - k_c max(0, mean T - mean T*) / a2

    No duty is beyond what `TemperatureLimiter` allows, and no wire is heated to more than
    8 °C beyond the most that it has in the next 2 s of the plan, and what holds p (20 °C if
    the limb is not calibrated): a bend that needs more is left, as heat would stay for long
    after it. Up to 30 °C above T_warm there is no such limit, as wires cool from there soon.

    Ports and state are those of `PlanController`.
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(
        self,
        trajectory: Trajectory,
        *,
        parameters: LimbParameters | None = None,
        proportional: float = PROPORTIONAL,
    ):
        """
        Args:
            trajectory: the plan.
            parameters: of the limb, from which gains and estimates follow; the plan's if None.
            proportional: k_p, 1/s.
        """
        parameters = LimbParameters.of(parameters or trajectory.parameters)
        self._plan, self._proportional = SampledPlan(trajectory, parameters), proportional
        super().__init__(parameters, self._plan.duty[0])
        model = self._estimator.model
        self._mean_gains, self._heating = mean_gains(model), model.heating_rates
        self._gains = planned_gains(model, self._plan)
        planned = self._plan.temperature
        self._planned_mean = self._mean(planned)
        ahead = round(AHEAD / PERIOD)
        later = np.pad(planned, ((0, ahead), (0, 0)), mode="edge")
        self._highest = sliding_window_view(later, ahead + 1, axis=0).max(axis=-1)
        self._highest += WARMER if parameters.calibration else WARMER_UNCALIBRATED
        self.set_name("plan_feedback")

    def _duty(self, time: float, estimate: Estimate, caps: np.ndarray, state) -> np.ndarray:
        k, model = self._plan.index(time), self._estimator.model
        missed = self._plan.bend_angle[k] - estimate.offset - model.bend_angle(estimate.heat)
        warmer = self._mean(model.temperatures(estimate.heat)) - self._planned_mean[k]
        base = self._plan.duty[k] - COMMON_MODE * np.maximum(warmer, 0.0) / self._heating
        base = np.clip(base, 0.0, caps)
        return share(self._proportional * missed, base, self._gains[k], caps)

    def _temperature_limit(self, time: float, estimate: Estimate) -> np.ndarray:
        by_temperature = self._mean_gains / self._heating  # rad/°C
        against = np.sign(by_temperature) * -estimate.offset[:, None]
        held = np.maximum(against, 0.0).max(axis=0) / np.abs(by_temperature).max(axis=0)
        lukewarm = self._parameters.temperature_limits.warm + LUKEWARM
        return np.maximum(self._highest[self._plan.index(time)] + held, lukewarm)

    def linearized(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The plan's heat (H,) and duty (W,) at a time, s, and K (W, M) of the feedback there.

        D = D* - K (all that is estimated, less the plan's), while no bound is active and wires
        are not too warm.
        """
        k, model = self._plan.index(time), self._estimator.model
        heat = self._plan.heat[k]
        missed = np.zeros((model.num_segments, self._estimator.sensing(heat)[1].shape[1]))
        missed[:, : model.size] = model.bend_slopes(heat)[1]
        missed[:, -model.num_segments :] = np.eye(model.num_segments)
        sharing = self._gains[k].T / (self._gains[k] ** 2).sum(axis=1)
        return heat, self._plan.duty[k], self._proportional * sharing @ missed

    def _mean(self, temperature: np.ndarray) -> np.ndarray:
        """The mean over the wires of each wire's segment (..., W) of T (..., W), °C."""
        same = np.abs(np.sign(self._estimator.model.sides))
        return temperature @ (same.T @ (same / same.sum(axis=1, keepdims=True)))
