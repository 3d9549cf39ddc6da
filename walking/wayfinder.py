"""Feedback that walks a robot to places on the ground, gait by gait."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import EventStatus

from controllers.estimator import StateEstimate
from limb_systems import LimbError, LimbParameters, Trajectory
from limb_systems.drake_python import weak_method
from limb_systems.files.schema import short_repr
from limb_systems.simulation import PERIOD
from walking.gait import Gait, GaitCheck, along_heading, travels
from walking.gait_check import MOST_TILT
from walking.heat_feedback import HeatFeedback
from walking.walk_trajectory import walk

NEAR = 0.015  # m, of a place at which the robot is there
FACING = np.deg2rad(8.0)  # rad, of a heading that is asked for
FARTHEST = 1000.0  # m and rad, of a goal
LEARNED = 0.5  # of what a cycle made otherwise than expected
CYCLES_AHEAD = 3  # of which the best are looked for
SLOWEST = 1e-6  # m/s and rad/s, of robots that turn to one side alone, or not at all
# A robot does not get on when so many cycles in a row made less than this share of their way.
STALLED_CYCLES, LEAST_SHARE = 5, 0.2
TIME, BEFORE, GAIT, GOAL, START = range(5)  # of the state
STALLED, EXPECTED = 7, 8  # of the state, which ends with what is expected


class Wayfinder(HeatFeedback):
    """`HeatFeedback` about a gait, which is chosen anew at the end of each cycle.

    The gait is the first of those three cycles after which the robot is expected to be at its goal
    soonest, by the time that it takes to turn to it, walk there, and turn to the heading that is
    asked for. What a cycle of a gait is expected to make after one of each gait is what was planned
    at first, and then follows what is seen: friction and limbs are not quite as described. Where a
    gait begins with other heat than the one before ended with, the robot stands until its wires
    have it. A place is reached within 15 mm, a heading within 8°. The simulation
    ends after the last goal, and if the robot falls or five cycles in a row make less than a fifth
    of their way.

    - inputs 0 and 1, output 0: those of `PlanController`
    - input 2 ``body_pose``: x, y, z, m, and roll, pitch and yaw, rad; NaN where it is not seen
    - output 1 ``course``: time in the plan, s; numbers of the gait before, of the gait, and of the
      goal; where the cycle began, x, y, m, and yaw, rad; how many cycles in a row made little; and
      what a cycle is expected to make, x, y, m, and yaw, rad, in the heading at its beginning,
      after each gait of each gait
    - state, discrete, at 20 Hz: 0 and 1 of `PlanController`; 2: the course
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(
        self,
        gaits: Mapping[str, Gait],
        goals: Sequence[Sequence[float]],
        *,
        parameters: LimbParameters | None = None,
    ):
        """
        Args:
            gaits: gaits of one robot in space, as of `plan_gaits`; the first begins from cold.
            goals: places x, y, m, or x, y and yaw, m and rad, one after the other.
            parameters: description of all limbs together; the gaits' if None.

        Raises:
            LimbError: if a gait failed its check or is of a robot in the plane, if there is no
                goal, or one is not two or three finite numbers within 1 km.
        """
        self._gaits = list(gaits.values())
        if not goals:
            raise LimbError("There is no place to go to; give at least one goal.")
        if not all(gait.in_space for gait in self._gaits):
            raise LimbError("A robot in the vertical plane goes to no place; it walks ahead.")
        for name, gait in gaits.items():
            if not gait.check.is_missing and (failure := gait.check.failure()):
                raise LimbError(f"The gait {name!r} failed its check and is not walked: {failure}")
        self._goals = np.array([_checked(goal, index) for index, goal in enumerate(goals)])
        trajectory, self._begins, self._lasts = joined(self._gaits)
        super().__init__(trajectory, parameters=parameters)
        made = np.array([gait.displacement for gait in self._gaits])
        self.DeclareVectorInputPort("body_pose", 6)
        start = [0.0, len(made), 0.0, 0.0, *[np.nan] * 3, 0.0]
        expected = np.tile(made, (len(made), 1)).ravel()
        self.DeclareStateOutputPort("course", self.DeclareDiscreteState([*start, *expected]))
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, weak_method(self._look))

    def _plan_time(self, context) -> float:
        return context.get_discrete_state(2).value()[TIME]

    def _after_update(self, context, ahead: StateEstimate, state) -> None:
        now = context.get_discrete_state(2).value().copy()
        now[TIME] += PERIOD
        part = tuple(now[[BEFORE, GAIT]].astype(int))
        over = now[TIME] - self._begins[part] - self._lasts[part]
        if over > -1e-9:
            self._choose(now, self.get_input_port(2).Eval(context)[[0, 1, 5]], over)
        state.set_value(2, now)

    def _choose(self, now: np.ndarray, pose: np.ndarray, over: float) -> None:
        """Learn from the cycle that ended, and begin the next one, in the course."""
        G, start = len(self._gaits), now[START : START + 3].copy()
        made = now[EXPECTED:].reshape(G, G, 3)  # after each gait, of each gait
        before, gait = map(int, now[[BEFORE, GAIT]])
        if before < G and np.isfinite([*start, *pose]).all():  # the first one began from cold
            poses = np.zeros((6, 2))
            poses[[0, 1, 5]] = np.transpose([start, pose])
            made[before, gait] += LEARNED * (travels(poses)[:, 0] - made[before, gait])
            made_little = self._gaits[gait].progress(poses)[0][0] < LEAST_SHARE
            now[STALLED] = now[STALLED] + 1 if made_little else 0.0
        if np.isfinite(pose).all():
            while now[GOAL] < len(self._goals) and self.is_there(pose, now[GOAL]):
                now[GOAL] += 1
            if now[GOAL] < len(self._goals):
                now[GAIT] = self._best(pose, made, gait, now[GOAL])
        now[BEFORE], now[START : START + 3] = gait, pose
        now[TIME] = self._begins[gait, int(now[GAIT])] + max(0.0, over)

    def _best(self, pose: np.ndarray, made: np.ndarray, now: int, goal: float) -> int:
        """The number of the gait to go on with, after a cycle of the gait now."""
        each = np.arange(len(made))
        # By planned speeds a robot that is slower would seem to lose nothing while it stands.
        rates = (made / self._lasts[:-1, :, None])[each, each]
        speed, *turning = np.maximum([rates[:, 0], rates[:, 2], -rates[:, 2]], SLOWEST).max(axis=1)
        choices = list(itertools.product(range(len(made)), repeat=CYCLES_AHEAD))
        times = []
        for choice in choices:
            after, taken = pose, 0.0
            for before, gait in itertools.pairwise((now, *choice)):
                if self.is_there(after, goal):
                    break
                x_y, turn = made[before, gait][:2], made[before, gait][2]
                place = after[:2] + along_heading(x_y, -after[2])
                after = np.append(place, after[2] + turn)
                taken += self._lasts[before, gait]
            times.append(taken + self._time_to_go(after, goal, speed, turning))
        return choices[int(np.argmin(times))][0]

    def is_there(self, pose: np.ndarray, goal: float, slack: float = 1.0) -> bool:
        """Return whether a pose x, y, m, and yaw, rad, is at a goal, and faces as it asks for.

        Args:
            pose: of the body (3,).
            goal: number of the goal, from 0.
            slack: times 15 mm and 8°, within which it is there.
        """
        x, y, heading = self._goals[int(goal)]
        distance = np.hypot(x - pose[0], y - pose[1])
        turn = abs(_wrapped(heading - pose[2]))  # NaN if any heading will do
        return bool(distance <= slack * NEAR and not turn > slack * FACING)

    def _time_to_go(
        self, pose: np.ndarray, goal: float, speed: float, turning: Sequence[float]
    ) -> float:
        """Time that it takes to turn to a goal, walk to it and face as it asks for, s.

        Args:
            speed: speed ahead, m/s.
            turning: rates of turning to the left and to the right, rad/s.
        """

        def time_to_turn(angle: float, tolerance: float) -> float:
            angle = _wrapped(angle)
            left = max(0.0, abs(angle) - tolerance) * np.sign(angle)
            return min(left % (2 * np.pi) / turning[0], -left % (2 * np.pi) / turning[1])

        x, y, heading = self._goals[int(goal)]
        away = np.array([x, y]) - pose[:2]
        distance, facing, time = float(np.hypot(*away)), pose[2], 0.0
        if distance > NEAR:
            facing = np.arctan2(away[1], away[0])
            time = time_to_turn(facing - pose[2], np.arcsin(NEAR / distance))
            time += (distance - NEAR) / speed
        return time + (0.0 if np.isnan(heading) else time_to_turn(heading - facing, FACING))

    def _look(self, context) -> EventStatus:
        roll, pitch = self.get_input_port(2).Eval(context)[3:5]
        if max(abs(roll), abs(pitch)) > MOST_TILT:
            return EventStatus.ReachedTermination(self, "the robot has fallen")
        course = context.get_discrete_state(2).value()
        if course[GOAL] >= len(self._goals):
            return EventStatus.ReachedTermination(self, "the robot has arrived")
        if course[STALLED] >= STALLED_CYCLES:
            return EventStatus.ReachedTermination(self, "the robot does not get on")
        return EventStatus.DidNothing()


def _checked(goal: Sequence[float], index: int) -> list[float]:
    """Return a goal's x, y, m, and heading, rad, or NaN; LimbError if it is no place."""
    try:
        place = np.asarray(goal, float)
    except (TypeError, ValueError):
        place = np.empty(0)
    if place.shape not in ((2,), (3,)) or not (np.abs(place) <= FARTHEST).all():  # NaN is not
        raise LimbError(
            f"goals[{index}] is {short_repr(goal)}; it must be x and y in m, or x, y and a heading "
            f"in rad, finite and at most {FARTHEST:g} in size."
        )
    return [*place, np.nan][:3]


def joined(gaits: Sequence[Gait]) -> tuple[Trajectory, np.ndarray, np.ndarray]:
    """Cycles of each gait after each, and of the first one from cold, as one plan.

    Returns:
        The plan, and when each part begins in it, and how long it lasts (1 + G, G), s, in the rows
        of the gaits before, the last of which is none: only the first gait begins from cold.
    """
    G = len(gaits)
    begins, lasts = np.full((1 + G, G), np.nan), np.full((1 + G, G), np.nan)
    parts: list[Trajectory] = []
    for before, gait in [(G, 0), *itertools.product(range(G), repeat=2)]:
        # A check of each part, by its bends, would take long, and no one asks for it.
        unchecked, start = dataclasses.replace(gaits[gait], check=GaitCheck()), {}
        if before < G:
            first = gaits[before]
            start = {"heat": first.initial_heat, "bend": first.bend_angle[:, 0]}
        cycles, period = walk(unchecked, 2, **start), gaits[gait].period
        warm_up = PERIOD * np.floor((cycles.duration - 2 * period) / PERIOD + 1e-6)
        begins[before, gait] = PERIOD * sum(len(part.time) for part in parts)
        lasts[before, gait] = warm_up + period
        # The period in which the cycle ends is its own, to its end.
        parts.append(_until(cycles, int(np.ceil((warm_up + period) / PERIOD)) + 1))
    signals: dict[str, Any] = {
        name: np.hstack([getattr(part, name) for part in parts]) for name in _signals(parts[0])
    }
    signals["time"] = PERIOD * np.arange(signals["duty"].shape[1])
    return dataclasses.replace(parts[0], **signals), begins, lasts


def _until(trajectory: Trajectory, knots: int) -> Trajectory:
    """The first knots of a trajectory."""
    signals: dict[str, Any] = {
        name: getattr(trajectory, name)[..., :knots] for name in _signals(trajectory)
    }
    return dataclasses.replace(trajectory, **signals)


def _signals(trajectory: Trajectory) -> list[str]:
    names = [field.name for field in dataclasses.fields(trajectory)]
    return [name for name in names if isinstance(getattr(trajectory, name), np.ndarray)]


def _wrapped(angle: float) -> float:
    """An angle within half a turn of zero, rad."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
