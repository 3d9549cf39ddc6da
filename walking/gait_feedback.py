"""Feedback for robots that walk: bends within a cycle, amplitude and duration from one to the next.

Friction that is not as planned bends the limbs otherwise than planned, and so do wires that are
stronger or heat faster: both mostly go with the bends held. What they leave of the stride, and
what holding leaves since wires run out of heat or of time to cool, repeats in every cycle.
"""

import numpy as np
from numpy.typing import ArrayLike

from controllers.estimator import StateEstimate
from controllers.plan_feedback import PlanFeedback
from limb_systems import LimbError, LimbParameters
from limb_systems.simulation import PERIOD
from walking.gait import Gait
from walking.walk_trajectory import walk

GAIN = 0.5  # of the stride's relative error, by which amplitude changes: strides change twice so
AMPLITUDES, DURATIONS = (0.6, 1.4), (1.0, 2.0)  # of those planned
SETTLING = 1  # cycles from cold, of which nothing is learned
TIME, AMPLITUDE, DURATION, START = range(4)  # of the state


class GaitFeedback(PlanFeedback):
    """`PlanFeedback` about a walk, whose amplitude and duration are corrected once per cycle.

    Within a cycle the bends of the limbs, F in all, are held to φ̄ + a (φ* - φ̄), with φ̄ the mean of
    each planned bend over the cycle, at a clock that runs c times slower than the plan's. At its
    end, where the body has travelled S, and not S* as planned, and the bends had on average the
    share r of the ranges that were asked for,

        a ← a (S* / S)^0.5,   c ← c / r

    within 0.6 <= a <= 1.4 and 1 <= c <= 2: amplitude corrects what the stride misses, and
    slowness what the wires did not reach. The duty that is fed forward keeps the planned heat
    at that clock. The first cycle, from straight limbs, corrects nothing, nor does one at whose
    beginning or end the body is not seen.

    - inputs 0 and 1, output 0: those of `PlanController`
    - input 2 ``body_pose``: x, z, m, and θ, rad, of the body; NaN where it is not seen
    - output 1 ``correction``: time in the walk, s, a, c, where the cycle began, m, and the least
      and the largest bends in it so far (2F), rad
    - state, discrete, at 20 Hz: 0 and 1 of `PlanController`; 2: the correction
    """

    __slots__ = ()  # see limb_systems.drake_python

    _uncalibrated_margin = 0.0  # °C: gaits are planned with one, and slower if feedback has another

    def __init__(
        self,
        gait: Gait,
        cycles: int,
        *,
        heat: ArrayLike | None = None,
        bend: ArrayLike | None = None,
        parameters: LimbParameters | None = None,
    ):
        """
        Args:
            gait: a gait that passed its check, or was not checked.
            cycles, heat, bend: as for `walk`, about which it is.
            parameters: description of all limbs together, of which gains and estimates are
                made; the gait's if None.

        Raises:
            LimbError: if the gait failed its check, or the body does not move in a plane.
        """
        if gait.in_space:
            raise LimbError(
                "Gait feedback is for robots in the vertical plane; in space, use heat feedback "
                "(HeatFeedback, --controller heat-feedback)."
            )
        trajectory = walk(gait, cycles, heat=heat, bend=bend)
        super().__init__(trajectory, parameters=parameters, known_start=heat is not None)
        self._period, self._stride = gait.period, gait.stride
        self._begin = PERIOD * np.floor((trajectory.duration - cycles * gait.period) / PERIOD + 0.5)
        bends = self._plan.bend_angle[round(self._begin / PERIOD) : -1]
        self._mean_bend, self._range = bends.mean(axis=0), np.ptp(bends, axis=0)
        model, duty = self._estimator.model, np.zeros_like(self._plan.duty)
        # Temperatures alone, as duty does not change states of memory within a step.
        W = model.num_wires
        none, full = (
            (model.step(self._plan.heat, duty + D) - self._plan.heat)[:, :W] for D in (0.0, 1.0)
        )
        self._holding = np.clip(none / (none - full), 0.0, 1.0)
        self.DeclareVectorInputPort("body_pose", 3)
        F = model.num_bends
        start = [0.0, 1.0, 1.0, np.nan, *[np.inf] * F, *[-np.inf] * F]
        self.DeclareStateOutputPort("correction", self.DeclareDiscreteState(start))

    def _plan_time(self, context) -> float:
        return context.get_discrete_state(2).value()[TIME]

    def _planned(self, times: np.ndarray, state) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        _, amplitude, duration, *_ = state.value(2)
        times = times[0] + (times - times[0]) / duration
        *bends, duty = super()._planned(times, state)
        bend, reference = (self._mean_bend + amplitude * (x - self._mean_bend) for x in bends)
        holding = self._holding[[self._plan.index(time) for time in times]]
        return bend, reference, np.clip(holding + (duty - holding) / duration, 0.0, 1.0)

    def _after_update(self, context, ahead: StateEstimate, state) -> None:
        now = context.get_discrete_state(2).value().copy()
        bend, x = self.get_input_port(1).Eval(context), self.get_input_port(2).Eval(context)[0]
        least, largest = np.split(now[START + 1 :], 2)
        least[:], largest[:] = np.fmin(least, bend), np.fmax(largest, bend)
        before = np.floor((now[TIME] - self._begin) / self._period + 1e-9)
        now[TIME] += PERIOD / now[DURATION]
        if np.floor((now[TIME] - self._begin) / self._period + 1e-9) > before:
            if before >= SETTLING and np.isfinite([*least, *largest]).all():
                reached = np.mean((largest - least) / (now[AMPLITUDE] * self._range))
                travelled = (x - now[START]) / self._stride
                if np.isfinite(travelled):
                    step = np.clip(travelled, 0.3, 3.0) ** -GAIN
                    now[AMPLITUDE] = np.clip(now[AMPLITUDE] * step, *AMPLITUDES)
                now[DURATION] = np.clip(now[DURATION] / reached, *DURATIONS)
            now[START], least[:], largest[:] = x, np.inf, -np.inf
        state.set_value(2, now)
