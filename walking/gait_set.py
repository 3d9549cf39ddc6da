"""A set of gaits by which a robot walks to any place on the ground: `plan_gaits`."""

import contextlib
import dataclasses
import functools
import itertools
import operator
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from limb_systems import LimbError
from limb_systems.files.output import check_outputs
from limb_systems.progress import Progress
from planners.transcription.solving import PlanningError
from walking.gait import Gait
from walking.gait_planning import plan_gait
from walking.gait_request import GaitRequest
from walking.robot_parameters import RobotParameters
from walking.schedules import Schedule, candidate_schedules

AHEAD = "ahead"
SIDE_SIGNS = {"left": 1.0, "right": -1.0}
TURNING_GAITS = ("left", "right", "spot_left", "spot_right")  # names of gaits
ARC_TURN = 0.2  # rad, in a cycle
# rad, in a cycle on the spot, the first with which the robot turns as planned; softer robots turn
# by less, as legs that bend farther have more than one balance.
SPOT_TURNS = 0.3, 0.2


def plan_gaits(
    robot: RobotParameters | str | Path, *, map_function: Callable = map, **options: Any
) -> dict[str, Gait]:
    """Plan gaits ahead, along arcs to the left and right, and on the spot.

    Where possible, gaits along arcs begin with the heat of the gait ahead, so that a robot changes
    between them at the end of a cycle. The other gaits begin with heat of their own.

    Args:
        robot: description of a robot in space.
        map_function: takes a function and its arguments, as `map` does, and may call it for
            several arguments at one time; it plans the gaits that turn.
        options: fields of `GaitRequest`.

    Returns:
        Checked gaits by name: ahead, left, right, spot_left and spot_right, without those that were
        not found. Gaits that turn do not fall on the robots of `gait_check.variations`, either.

    Raises:
        PlanningError: if there is no gait ahead, or none that turns to one of the sides.
    """
    robot = RobotParameters.of(robot)
    if robot.body.mount != "free":
        raise PlanningError(
            f"The body is {robot.body.mount}, so that it cannot turn; set body.mount to free."
        )
    request = dataclasses.replace(GaitRequest(explain=False), **options)
    with Progress("planning", 1 + len(TURNING_GAITS), "gaits") as progress:
        ahead = plan_gait(robot, request, spread=False)
        progress.update(1, "that turn")
        arcs = []
        spots = []
        for sign in SIDE_SIGNS.values():
            arcs.append(functools.partial(_plan_arc, robot, sign, ahead, request))
            spots.append(functools.partial(plan_spot_turn, robot, sign, request))
        gaits = {AHEAD: ahead}
        planned = map_function(operator.call, [*arcs, *spots])
        for number, (name, gait) in enumerate(zip(TURNING_GAITS, planned, strict=True)):
            progress.update(2 + number)
            if gait:
                gaits[name] = gait
    for side in SIDE_SIGNS:
        if not {side, f"spot_{side}"} & {*gaits}:
            raise PlanningError(
                f"The robot goes ahead, but no gait was found that turns it to the {side}, "
                f"neither by {np.rad2deg(ARC_TURN):.0f}° along an arc nor on the spot."
            )
    return gaits


def _plan_arc(
    robot: RobotParameters, sign: float, ahead: Gait, request: GaitRequest
) -> Gait | None:
    """Plan a gait along an arc, with the heat of the gait ahead if possible, else with its own."""
    request = dataclasses.replace(
        request, turn=sign * ARC_TURN, schedule=ahead.schedule, near=ahead
    )
    for first in (ahead, None):
        with contextlib.suppress(PlanningError):
            gait = plan_gait(robot, request, begins_as=first)
            if _never_falls(gait):
                return gait
    return None


def plan_spot_turn(robot: RobotParameters, sign: float, request: GaitRequest) -> Gait | None:
    """Return the gait with the largest turn, of `schedules_on_the_spot`, that never falls.

    Args:
        robot: description of the robot.
        sign: 1 to the left, -1 to the right.
        request: request of the gait.

    Returns:
        The gait, or None if there is none.
    """
    for turn, schedule in itertools.product(SPOT_TURNS, schedules_on_the_spot(robot)):
        with contextlib.suppress(PlanningError):
            gait = plan_gait(robot, request, turn=sign * turn, stride=0.0, schedule=schedule)
            if _never_falls(gait):
                return gait
    return None


def schedules_on_the_spot(robot: RobotParameters) -> list[Schedule]:
    """Return schedules by which a robot in space turns on the spot, those with rests first.

    On soft feet, four limbs that go one after the other without rests slip where they stand.
    """
    sensible = candidate_schedules(robot)
    still = ["stick"] * len(robot.limbs)
    with_rests = [schedule for schedule in sensible if still in schedule][:2]
    return with_rests + [each for each in sensible[:2] if each not in with_rests]


def _never_falls(gait: Gait) -> bool:
    """Return whether no robot falls in the spread of a gait's check."""
    return not any(variation.fall for variation in gait.check.spread)


def gait_files(folder: Path) -> list[Path]:
    """Return the files of a folder that a set of gaits may replace: its own, and other gaits."""
    named = [folder / f"{name}.csv" for name in (AHEAD, *TURNING_GAITS)]
    return named + [file for file in sorted(set(folder.glob("*.csv")) - {*named}) if _is_gait(file)]


def save_gaits(gaits: Mapping[str, Gait], folder: Path, *, force: bool = False) -> list[Path]:
    """Save gaits as files of a folder, by their names, and return these.

    The folder has no other gaits afterwards, which `load_gaits` would take for gaits of this set.

    Args:
        force: whether gaits that are in the folder may be replaced and removed.

    Raises:
        OutputError: if there are gaits in the folder, and ``force`` is false; or as `Gait.save`.
    """
    files = [folder / f"{name}.csv" for name in gaits]
    others = [file for file in gait_files(folder) if file not in files and file.exists()]
    check_outputs([*files, *others], force=force)
    folder.mkdir(parents=True, exist_ok=True)
    for gait, file in zip(gaits.values(), files, strict=True):
        gait.save(file)
    for file in others:
        file.unlink()
    return files


def _is_gait(file: Path) -> bool:
    """Return whether a file is a gait that can be read."""
    with contextlib.suppress(LimbError):
        Gait.load(file)
        return True
    return False


def load_gaits(folder: Path) -> dict[str, Gait]:
    """Load the gaits of a folder, by the names of their files; the gait ahead is the first.

    Raises:
        LimbError: if it is a file, none is named ahead, or they are of different robots.
    """
    if folder.is_file():
        raise LimbError(
            f"{folder} is a file; places are walked to by the folder of gaits that soft-limb gait "
            "--set writes."
        )
    files = sorted(folder.glob("*.csv"), key=lambda file: (file.stem != AHEAD, file.stem))
    if not files or files[0].stem != AHEAD:
        raise LimbError(
            f"{folder} has no gait named {AHEAD}.csv; soft-limb gait ROBOT --set -o {folder} "
            "writes one, and others that turn."
        )
    gaits = {file.stem: Gait.load(file) for file in files}
    for name, gait in gaits.items():
        if gait.robot != gaits[AHEAD].robot:
            raise LimbError(
                f"{folder / name}.csv is the gait of another robot than {AHEAD}.csv; plan all "
                "gaits of the folder for one robot."
            )
    return gaits
