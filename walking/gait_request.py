"""The request for a gait: `GaitRequest`."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np

from planners.transcription.solving import PlanningError
from walking.course import Course
from walking.gait import Gait
from walking.robot_parameters import RobotParameters

INTERVALS = 24
MAX_INTERVALS = 240


@dataclasses.dataclass(frozen=True, kw_only=True)
class GaitRequest:
    """The properties that a gait must have; each has a default.

    - ``turn``: turn of the body to the left in a cycle, rad; as far as it can if infinite. To the
      right it is negative.
    - ``stride``: travel in a cycle, m; 0 on the spot. If None, the fastest stride, or none
      if the turn is infinite.
    - ``speed``: speed that it has, at the least heat, m/s; the fastest if None.
    - ``schedule``: contact of each foot in each phase (P, F), of `CONTACTS`. If None, in a plane
      the first of `candidate_schedules`, and in space the first that walks as planned.
    - ``objective``: "speed" for the largest stride by period, "energy" for the least duty, summed
      over time and wires, by stride.
    - ``temperature_margin``: how far T stays below T_max, °C.
    - ``steadiness``: least stiffness against pitch in a plane, as a multiple of weight times limb
      length. Less is faster, but more of the robots that are not quite as described fall. If None,
      25, or 12.5 if all limbs are calibrated.
    - ``sticking_share``: share of μ that feet that stick may use, at most 1. More is faster, but
      the robot stands still if friction or load differs from foot to foot. If None, 0.8; for robots
      in space of four or more limbs, all calibrated, 0.6 ahead, and 0.5 on the spot.
    - ``intervals``: number of intervals between knots, shared by the phases; in a plane, a gait
      that is checked gets twice or four times as many, up to 96, where simulation differs.
    - ``near``: a gait of a robot or a course that differs little, of this schedule, to start from.
    - ``begins_as``: a gait of this robot, with whose wire temperatures it begins, as far as the
      ``temperature_margin`` allows, so that one may follow the other; with its own if None.
    - ``check``, ``spread``: whether to check it by `check_gait`, and with its spread.
    - ``explain``: whether to find out, in up to a minute, why there is no gait, if there is none.
    """

    turn: float = 0.0
    stride: float | None = None
    speed: float | None = None
    schedule: Sequence[Sequence[str]] | None = None
    objective: Literal["speed", "energy"] = "speed"
    temperature_margin: float = 0.0
    steadiness: float | None = None
    sticking_share: float | None = None
    intervals: int = INTERVALS
    near: Gait | None = None
    begins_as: Gait | None = None
    check: bool = True
    spread: bool = True
    explain: bool = True

    @property
    def course(self) -> Course:
        """The way that it goes in a cycle."""
        return Course(self.turn, self.stride, self.speed)

    def validate(self, robot: RobotParameters, schedule: Sequence[Sequence[str]]) -> None:
        """Raise PlanningError if no gait of a robot and a schedule can satisfy the request."""
        if self.objective not in ("speed", "energy"):
            raise PlanningError(
                f"The objective is {self.objective!r}; it must be 'speed' or 'energy'."
            )
        limits = robot.as_single_limb.temperature_limits
        ambient = robot.as_single_limb.ambient_temperature
        if not 0 <= self.temperature_margin < limits.maximum - ambient:
            raise PlanningError(
                f"temperature_margin is {self.temperature_margin:g} °C; it must be from 0 to less "
                f"than {limits.maximum - ambient:g} °C, by which T_max is above ambient."
            )
        if self.steadiness is not None and not 0 < self.steadiness < np.inf:
            raise PlanningError(f"steadiness is {self.steadiness:g}; it must be a positive number.")
        if self.sticking_share is not None and not 0 < self.sticking_share <= 1:
            raise PlanningError(
                f"sticking_share is {self.sticking_share:g}; it must be more than 0 and at most 1."
            )
        if not 2 * len(schedule) <= self.intervals <= MAX_INTERVALS:
            raise PlanningError(
                f"intervals is {self.intervals}; it must be from {2 * len(schedule)}, two for each "
                f"phase, to {MAX_INTERVALS}."
            )
