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
from limb_systems.kinematics import wrap_angle
from limb_systems.simulation import PERIOD
from walking.gait import Gait, GaitCheck, body_travel, rotate_to_heading
from walking.gait_check import FALL_TILT
from walking.heat_feedback import HeatFeedback
from walking.walk_trajectory import walk

PLACE_TOLERANCE = 0.015  # m, of a place at which the robot is there
HEADING_TOLERANCE = np.deg2rad(8.0)  # rad, of a heading that is asked for
MAX_GOAL = 1000.0  # m and rad, of a goal
LEARNING_RATE = 0.5  # of what a cycle made otherwise than expected
CYCLES_AHEAD = 3  # of which the best are looked for
MIN_SPEED = 1e-6  # m/s and rad/s, of robots that turn to one side alone, or not at all
MIN_CYCLE_SHARE = 0.2  # of the planned travel; a gait that makes less is not walked any more
TIME, BEFORE, GAIT, GOAL, START = range(5)  # of the state
EXPECTED = 7  # of the state, which ends with what is expected


class Wayfinder(HeatFeedback):
    """`HeatFeedback` about a gait, which is chosen at the end of each cycle.

    The gait is the first of those three cycles after which the robot is expected to be at its goal
    soonest, by the time that it takes to turn to it, walk there, and turn to the heading that is
    asked for. What a cycle of a gait is expected to make after one of each gait is what was planned
    at first, and then follows what is seen: friction and limbs are not quite as described. A gait
    that makes less than a fifth of its planned travel is not walked any more. Where a robot does
    not turn on the spot, it turns by arcs, along which it also travels. Where a gait begins with
    other heat than the last gait ended with, the robot stands until its wires have it. A place is
    reached within 15 mm, a heading within 8°. The simulation ends after the last goal, if the robot
    falls, and if no gait is left that moves it.

    - inputs 0 and 1, output 0: see `PlanController`
    - input 2 ``body_pose``: x, y, z, m, and roll, pitch and yaw, rad; NaN where it is not seen
    - output 1 ``course``: time in the plan, s; numbers of the gait before, of the gait, and of the
      goal; where the cycle began, x, y, m, and yaw, rad; and what a cycle is expected to make, x,
      y, m, and yaw, rad, in the heading at its beginning, after each gait of each gait
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
            gaits: gaits of one robot in space, see `plan_gaits`; the first begins from cold.
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
        self._goals = np.array([_check_goal(goal, index) for index, goal in enumerate(goals)])
        trajectory, self._cycle_starts, self._cycle_times = join_gaits(self._gaits)
        super().__init__(trajectory, parameters=parameters)
        made = np.array([gait.displacement for gait in self._gaits])
        # A turn counts by the way of a point that is a limb's length away.
        self._travel_scales = np.array([1.0, 1.0, self._gaits[0].robot.longest_limb])
        self._min_travels = MIN_CYCLE_SHARE * np.linalg.norm(self._travel_scales * made, axis=1)
        self.DeclareVectorInputPort("body_pose", 6)
        start = [0.0, len(made), 0.0, 0.0, *[np.nan] * 3]
        expected = np.tile(made, (len(made), 1)).ravel()
        self.DeclareStateOutputPort("course", self.DeclareDiscreteState([*start, *expected]))
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, weak_method(self._check_end))

    def _plan_time(self, context) -> float:
        return context.get_discrete_state(2).value()[TIME]

    def _after_update(self, context, ahead: StateEstimate, state) -> None:
        course = context.get_discrete_state(2).value().copy()
        course[TIME] += PERIOD
        part = tuple(course[[BEFORE, GAIT]].astype(int))
        overrun = course[TIME] - self._cycle_starts[part] - self._cycle_times[part]
        if overrun > -1e-9:
            self._begin_cycle(course, self.get_input_port(2).Eval(context)[[0, 1, 5]], overrun)
        state.set_value(2, course)

    def _begin_cycle(self, course: np.ndarray, pose: np.ndarray, overrun: float) -> None:
        """Learn from the cycle that ended, choose the next gait, and begin its cycle.

        Args:
            course: state of output ``course``, which is changed in place.
            pose: x, y, m, and yaw, rad, of the body (3,); NaN where it is not seen.
            overrun: time since the end of the cycle, s.
        """
        start = course[START : START + 3].copy()
        expected_travel = self._expected_travel(course)
        previous_gait, gait = map(int, course[[BEFORE, GAIT]])

        # Learn the travel of the cycle, unless it began from cold or the body was not seen. The
        # first cycle after another gait tells of cycles after that gait alone.
        if previous_gait < len(self._gaits) and np.isfinite([*start, *pose]).all():
            poses = np.zeros((6, 2))
            poses[[0, 1, 5]] = np.transpose([start, pose])
            error = body_travel(poses)[:, 0] - expected_travel[previous_gait, gait]
            learned = slice(None) if previous_gait == gait else previous_gait
            expected_travel[learned, gait] += LEARNING_RATE * error

        # Go on to the next goal after the robot has reached one, and choose the gait.
        if np.isfinite(pose).all():
            while course[GOAL] < len(self._goals) and self.is_there(pose, course[GOAL]):
                course[GOAL] += 1
            if course[GOAL] < len(self._goals) and len(self._useful_gaits(course)):
                course[GAIT] = self._choose_gait(pose, course)

        # Begin its cycle.
        course[BEFORE] = gait
        course[START : START + 3] = pose
        course[TIME] = self._cycle_starts[gait, int(course[GAIT])] + max(0.0, overrun)

    def _expected_travel(self, course: np.ndarray) -> np.ndarray:
        """Return x, y, m, and yaw, rad, by gait before and gait (G, G, 3), a view of a course."""
        num_gaits = len(self._gaits)
        return course[EXPECTED:].reshape(num_gaits, num_gaits, 3)

    def _useful_gaits(self, course: np.ndarray) -> np.ndarray:
        """Return the numbers of the gaits that are expected to move the robot (U,).

        Args:
            course: state of output ``course``.
        """
        expected = np.diagonal(self._expected_travel(course)).T
        travels = np.linalg.norm(self._travel_scales * expected, axis=1)
        return np.flatnonzero(travels >= self._min_travels)

    def _choose_gait(self, pose: np.ndarray, course: np.ndarray) -> int:
        """Return the number of the next gait, by the expected time to the goal.

        Args:
            pose: x, y, m, and yaw, rad, of the body (3,).
            course: state of output ``course``.
        """
        expected = self._expected_travel(course)
        useful = self._useful_gaits(course)
        goal = course[GOAL]

        # Estimate speeds from expected travel: by planned speeds a slow robot would stand too much.
        rates = (expected / self._cycle_times[:-1, :, None])[useful, useful]
        speed = max(MIN_SPEED, rates[:, 0].max())

        # Take the fastest turn to the left and to the right, and the radius of its arc.
        turns = []
        for side in (1.0, -1.0):
            fastest = rates[np.argmax(side * rates[:, 2])]
            turn_rate = side * max(MIN_SPEED, side * fastest[2])
            turns.append((turn_rate, fastest[0] / turn_rate))  # no radius on the spot

        # Predict the time to the goal after each choice of the next three cycles.
        choices = np.array(list(itertools.product(useful, repeat=CYCLES_AHEAD)))
        poses = np.tile(pose[:, None], len(choices))
        times = np.zeros(len(choices))
        before = np.full(len(choices), int(course[GAIT]))
        for gaits in choices.T:
            goes_on = ~self.is_there(poses, goal)
            travel = goes_on * expected[before, gaits].T
            poses[:2] += rotate_to_heading(travel[:2], -poses[2])
            poses[2] += travel[2]
            times += goes_on * self._cycle_times[before, gaits]
            before = gaits
        time_to_go = self._time_to_go(poses, goal, speed, turns)
        times += np.where(self.is_there(poses, goal), 0.0, time_to_go)
        return int(choices[np.argmin(times), 0])

    def is_there(self, pose: np.ndarray, goal: float, slack: float = 1.0) -> np.ndarray:
        """Return whether poses x, y, m, and yaw, rad, are at a goal, and face as it asks for.

        Args:
            pose: x, y, m, and yaw, rad, of the body (3, ...).
            goal: number of the goal, from 0.
            slack: times 15 mm and 8°, within which it is there.
        """
        x, y, heading = self._goals[int(goal)]
        distance = np.hypot(x - pose[0], y - pose[1])
        turn = np.abs(wrap_angle(heading - pose[2]))  # NaN if any heading will do
        return (distance <= slack * PLACE_TOLERANCE) & ~(turn > slack * HEADING_TOLERANCE)

    def _time_to_go(
        self, poses: np.ndarray, goal: float, speed: float, turns: Sequence[tuple[float, float]]
    ) -> np.ndarray:
        """Return the time to turn to a goal, walk to it and turn to its heading (C,), s.

        The way is an arc, a line that touches it, and an arc that touches the line at its end. On
        the spot an arc has no radius.

        Args:
            poses: x, y, m, and yaw, rad, of the body (3, C).
            speed: speed ahead, m/s.
            turns: rate, rad/s, and radius of the arc, m, of the turns to the left and to the right;
                those to the right are negative.
        """

        def time_to_turn(
            angle: np.ndarray, tolerance: np.ndarray | float, rate: float
        ) -> np.ndarray:
            """Return the time to turn by an angle with a rate of one sign, s."""
            angle = wrap_angle(angle)
            remaining = np.maximum(0.0, np.abs(angle) - tolerance) * np.sign(angle)
            return np.sign(rate) * remaining % (2 * np.pi) / abs(rate)

        x, y, heading = self._goals[int(goal)]
        any_heading = np.isnan(heading)
        times = []
        for (first_rate, first_radius), (last_rate, last_radius) in itertools.product(turns, turns):
            # Find the line from the circle of the first arc to the circle of the last arc.
            if any_heading:
                last_radius = 0.0  # the way ends with the line
            start = poses[:2] + first_radius * np.array([-np.sin(poses[2]), np.cos(poses[2])])
            end = np.array([x, y])
            if not any_heading:
                end += last_radius * np.array([-np.sin(heading), np.cos(heading)])
            away = end[:, None] - start
            distance = np.hypot(*away)
            offset = last_radius - first_radius
            length = np.sqrt(np.maximum(0.0, distance**2 - offset**2))
            line = np.arctan2(away[1], away[0]) - np.arctan2(offset, length)

            # Add up the times, with the tolerances of place and heading.
            is_near = distance <= PLACE_TOLERANCE
            tolerance = np.arcsin(np.minimum(1.0, PLACE_TOLERANCE / np.maximum(distance, 1e-9)))
            facing = np.where(is_near, poses[2], line)
            time = time_to_turn(facing - poses[2], tolerance, first_rate)
            time += np.maximum(0.0, length - PLACE_TOLERANCE) / speed
            if not any_heading:
                time += time_to_turn(heading - facing, HEADING_TOLERANCE, last_rate)
            # There is no such line from one circle to another one around it.
            times.append(np.where(distance + PLACE_TOLERANCE < abs(offset), np.inf, time))
        return np.min(times, axis=0)

    def _check_end(self, context) -> EventStatus:
        """End the simulation after a fall, after the last goal, or if no gait moves the robot."""
        roll, pitch = self.get_input_port(2).Eval(context)[3:5]
        if max(abs(roll), abs(pitch)) > FALL_TILT:
            return EventStatus.ReachedTermination(self, "the robot has fallen")
        course = context.get_discrete_state(2).value()
        if course[GOAL] >= len(self._goals):
            return EventStatus.ReachedTermination(self, "the robot has arrived")
        if not len(self._useful_gaits(course)):
            return EventStatus.ReachedTermination(self, "the robot does not get on")
        return EventStatus.DidNothing()


def _check_goal(goal: Sequence[float], index: int) -> list[float]:
    """Return a goal's x, y, m, and heading, rad, or NaN; LimbError if it is no place."""
    try:
        place = np.asarray(goal, float)
    except (TypeError, ValueError):
        place = np.empty(0)
    if place.shape not in ((2,), (3,)) or not (np.abs(place) <= MAX_GOAL).all():  # NaN is not
        raise LimbError(
            f"goals[{index}] is {short_repr(goal)}; it must be x and y in m, or x, y and a heading "
            f"in rad, finite and at most {MAX_GOAL:g} in size."
        )
    return [*place, np.nan][:3]


def join_gaits(gaits: Sequence[Gait]) -> tuple[Trajectory, np.ndarray, np.ndarray]:
    """Join a cycle of each gait after each gait, and of the first from cold, to one plan.

    Returns:
        The plan, and when each part begins in it, and how long it lasts (1 + G, G), s, in the rows
        of the gaits before, the last of which is none: only the first gait begins from cold.
    """
    G = len(gaits)
    begins = np.full((1 + G, G), np.nan)
    lasts = np.full((1 + G, G), np.nan)
    parts: dict[str, list[np.ndarray]] = {}  # of each signal
    num_knots = 0
    for before, gait in [(G, 0), *itertools.product(range(G), repeat=2)]:
        # A check of each part, by its bends, would take long, and no one asks for it.
        unchecked = dataclasses.replace(gaits[gait], check=GaitCheck())
        start = {}
        if before < G:
            first = gaits[before]
            start = {"heat": first.initial_heat, "bend": first.bend_angle[:, 0]}
        cycles = walk(unchecked, 2, **start)
        period = gaits[gait].period
        warm_up = PERIOD * np.floor((cycles.duration - 2 * period) / PERIOD + 1e-6)
        begins[before, gait] = PERIOD * num_knots
        lasts[before, gait] = warm_up + period
        # The period in which the cycle ends is its own, to its end.
        num_knots_of_part = int(np.ceil((warm_up + period) / PERIOD)) + 1
        num_knots += num_knots_of_part
        for field in dataclasses.fields(cycles):
            values = getattr(cycles, field.name)
            if isinstance(values, np.ndarray):
                parts.setdefault(field.name, []).append(values[..., :num_knots_of_part])
    signals: dict[str, Any] = {name: np.hstack(values) for name, values in parts.items()}
    signals["time"] = PERIOD * np.arange(signals["duty"].shape[1])
    return dataclasses.replace(cycles, **signals), begins, lasts
