"""Feedback for robots that walk in the vertical plane: the heat and the bends of their gait.

Wires heat in two seconds and cool in twenty. Feedback of every small error of a bend warms both
wires of a limb in turns, and then wires cool too late for the next phase. So wires are held to the
heat of the gait, larger errors of bends are corrected, and the gait waits for limbs that lag.
"""

import dataclasses
from typing import Any

import numpy as np
from pydrake.systems.framework import EventStatus

from controllers.estimator import StateEstimate
from controllers.plan_controller import SampledPlan
from controllers.plan_feedback import PREVIEW_TICKS, PROPORTIONAL_GAIN, PlanFeedback
from controllers.reduced_model import ReducedModel
from limb_systems import LimbError, LimbParameters, Trajectory
from limb_systems.drake_python import weak_method
from limb_systems.simulation import PERIOD
from walking.gait import Gait
from walking.heat_feedback import heating_duty
from walking.walk_trajectory import walk

# Relative change of the amplitude per relative error of the stride; strides change twice as much.
STRIDE_GAIN = 0.5
AMPLITUDE_RANGE = (0.6, 1.4)
SETTLING_CYCLES = 1  # cycles from cold, of which nothing is learned
MAX_ERROR = np.deg2rad(1.0)  # rad, of bends that are not corrected
LAG = np.deg2rad(3.0)  # rad, error of a bend from which on the clock slows down
MIN_PACE = 0.5  # of the clock, for errors of 1.5 times as much or more
MAX_EXCESS = 2.0  # °C, beyond the gait's heat, of wires of calibrated limbs
TIME, PACE, AMPLITUDE, START = range(4)  # of the state


class GaitFeedback(PlanFeedback):
    """Feedback of heat and bends about a walk, with a clock that waits and corrected amplitude.

    Within a cycle the F bends of the limbs are to be φ̄ + a (φ* - φ̄), with φ̄ the mean of each
    planned bend over the cycle. Their errors e in the coming 0.5 s are predicted as by
    `PlanFeedback`, with the bends that the ground makes in the gait. Wires are held to the heat of
    the gait's limit cycle. In addition errors beyond 1° are corrected:

        D = D* + k (T* - T) / a2 + λ g,   bend rate by λ g = k_p (e - clip(e, -1°, 1°))

    with k of `HeatFeedback` and the rest of `PlanFeedback`. No wire is heated to more than 2 °C
    beyond the gait's heat and what holds bends that the gait's ground does not make. The pace of
    the clock is

        ṡ = 2 - max |e| / 3°,   0.5 <= ṡ <= 1

    At the end of a cycle, where the body has travelled S, and not S* as planned,

        a ← a (S* / S)^0.5,   0.6 <= a <= 1.4

    The first cycle, from straight limbs, corrects nothing, nor does one at whose beginning or end
    the body is not seen. In the warm-up, in which the ground holds all feet, heat alone is held.
    The simulation ends with the last cycle.

    - ``cycle_starts``: times at which the cycles began in the last simulation, and the last of them
      ended, s.

    Ports and state:

    - inputs 0 and 1, output 0: see `PlanController`
    - input 2 ``body_pose``: x, z, m, and θ, rad, of the body; NaN where it is not seen
    - output 1 ``correction``: time in the walk, s, ṡ, a, and where the cycle began, m
    - state, discrete, at 20 Hz: 0 and 1 of `PlanController`; 2: the correction
    """

    __slots__ = ()  # see limb_systems.drake_python

    _uncalibrated_margin = 0.0  # °C: gaits are planned with one, and slower if feedback has another

    def __init__(
        self,
        gait: Gait,
        cycles: int,
        *,
        parameters: LimbParameters | None = None,
    ):
        """
        Args:
            gait: a gait that passed its check, or was not checked.
            cycles: number of cycles to walk, as for `walk`.
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
        # Follow the heat of the limit cycle: from cold, duty alone reaches it after many cycles.
        trajectory = walk(gait, cycles)
        start = trajectory.duration - cycles * gait.period
        trajectory = _with_heat_of_gait(trajectory, gait, start)
        super().__init__(trajectory, parameters=parameters)
        if self._parameters.calibration:
            self._max_excess = MAX_EXCESS
        self._cycles = cycles
        self._period = gait.period
        self._stride = gait.stride
        self._begin = PERIOD * np.floor(start / PERIOD + 0.5)
        bends = self._plan.bend_angle[round(self._begin / PERIOD) : -1]
        self._mean_bend = bends.mean(axis=0)

        # The bends that the ground makes in the gait: the planned bends without what the wires of
        # the gait's own robot make.
        planned = SampledPlan(trajectory, trajectory.parameters)
        ends = np.vstack([trajectory.bend_angle[:, :1].T, planned.bend_angle[:-1]])
        made_by_wires = ReducedModel(trajectory.parameters).bend_angle(planned.heat)
        self._planned_offset = ends - made_by_wires

        # The duty that holds planned temperatures; duty changes no state of memory within a step.
        model = self._estimator.model
        W = model.num_wires
        duty = np.zeros_like(self._plan.duty)
        cooling = (model.step(self._plan.heat, duty) - self._plan.heat)[:, :W]
        heating = (model.step(self._plan.heat, duty + 1.0) - self._plan.heat)[:, :W]
        self._holding = np.clip(cooling / (cooling - heating), 0.0, 1.0)

        self.cycle_starts: list[float] = []
        self.DeclareVectorInputPort("body_pose", 3)
        self.DeclareStateOutputPort(
            "correction", self.DeclareDiscreteState([0.0, 1.0, 1.0, np.nan])
        )
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, weak_method(self._follow_clock))

    def _plan_time(self, context) -> float:
        return context.get_discrete_state(2).value()[TIME]

    def _planned(self, times: np.ndarray, state) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        _, pace, amplitude, _ = state.value(2)
        times = times[0] + (times - times[0]) * pace
        bend, reference, duty = super()._planned(times, state)
        bend = self._mean_bend + amplitude * (bend - self._mean_bend)
        reference = self._mean_bend + amplitude * (reference - self._mean_bend)
        holding = self._holding[[self._plan.index(time) for time in times]]
        return bend, reference, np.clip(holding + (duty - holding) * pace, 0.0, 1.0)

    def _desired_duty(self, time: float, estimate: StateEstimate, caps: np.ndarray, state):
        # Hold the heat of the plan at the clock's pace.
        model = self._estimator.model
        (duty,) = self._planned(np.array([time]), state)[-1]
        temperature = self._plan.temperature[self._plan.index(time)]
        duty = duty + heating_duty(model, temperature, estimate)
        if time < self._begin:
            return duty, np.zeros(model.num_bends)
        # Correct bends that are far from the plan's.
        error = self._predicted_error(time, estimate, state)
        beyond = error - np.clip(error, -MAX_ERROR, MAX_ERROR)
        return duty, PROPORTIONAL_GAIN * beyond

    def _known_offset(self, time: float) -> np.ndarray:
        return self._planned_offset[self._plan.index(time)]

    def _predicted_error(self, time: float, estimate: StateEstimate, state) -> np.ndarray:
        later = time + PREVIEW_TICKS * PERIOD * state.value(2)[PACE]
        return super()._predicted_error(time, estimate, state) - self._known_offset(later)

    def _after_update(self, context, ahead: StateEstimate, state) -> None:
        now = context.get_discrete_state(2).value().copy()
        cycle = self._cycle(now[TIME])
        now[TIME] += PERIOD * now[PACE]
        # Wait for limbs that lag.
        if now[TIME] >= self._begin:
            lag = np.abs(self._predicted_error(now[TIME], ahead, state)).max()
            now[PACE] = np.clip(2.0 - lag / LAG, MIN_PACE, 1.0)
        # Correct the amplitude at the end of a cycle.
        if self._cycle(now[TIME]) > cycle:
            x = self.get_input_port(2).Eval(context)[0]
            travelled = (x - now[START]) / self._stride
            if cycle >= SETTLING_CYCLES and np.isfinite(travelled):
                step = np.clip(travelled, 0.3, 3.0) ** -STRIDE_GAIN
                now[AMPLITUDE] = np.clip(now[AMPLITUDE] * step, *AMPLITUDE_RANGE)
            now[START] = x
        state.set_value(2, now)

    def _cycle(self, time: float) -> int:
        """Return the number of the cycle at a time in the walk, s, from 0; -1 in the warm-up."""
        return int(np.floor((time - self._begin) / self._period + 1e-9))

    def _follow_clock(self, context) -> EventStatus:
        """Keep the time at which a cycle begins, and end the simulation after the last one."""
        if context.get_time() == 0.0:
            self.cycle_starts.clear()
        cycle = self._cycle(self._plan_time(context))
        if cycle >= len(self.cycle_starts):
            self.cycle_starts.append(context.get_time())
        if cycle >= self._cycles:
            return EventStatus.ReachedTermination(self, "the last cycle is over")
        return EventStatus.DidNothing()


def _with_heat_of_gait(trajectory: Trajectory, gait: Gait, start: float) -> Trajectory:
    """Return a walk with the heat of its gait's limit cycle, from the start of its cycles on, s."""
    since = trajectory.time - start
    changed: dict[str, Any] = {}
    for name in ("wire_temperature", "measured_temperature", "other_wire_state"):
        values = getattr(gait, name)
        if values is not None:
            of_gait = gait.interpolated(values, since % gait.period)
            changed[name] = np.where(since >= 0, of_gait, getattr(trajectory, name))
    return dataclasses.replace(trajectory, **changed)
