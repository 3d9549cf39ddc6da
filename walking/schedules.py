"""Schedules of gaits: the contact of each foot in each phase, and candidates to try.

In text, a phase is a letter for each foot, and a space ends it: ``fs ss sf ss`` is a crawl of two
feet, of which the first slides forward, then both stick while the body shifts, and so on.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from limb_systems.files.schema import short_repr
from planners.transcription.solving import PlanningError
from walking.gait import CONTACTS
from walking.robot_parameters import RobotParameters

LETTERS = dict(zip("sfbdl", CONTACTS, strict=True))  # forward, backward, dragged, lifted
LETTER_OF = dict(zip(CONTACTS, LETTERS, strict=True))

Schedule = list[list[str]]


def parse_schedule(text: str, num_feet: int) -> Schedule:
    """Return the contact of each foot in each phase (P, F), from text such as ``fs ss sf ss``.

    Raises:
        PlanningError: if it is not such text for so many feet.
    """
    phases = text.lower().split()
    if not phases or any(len(phase) != num_feet or set(phase) - {*LETTERS} for phase in phases):
        raise PlanningError(
            f"The schedule is {short_repr(text)}; it must have phases of {num_feet} letters, one "
            "for each foot, with spaces between: s if it sticks, f or b if it slides forward or "
            "backward in a plane, d if it is dragged along in space, l if it is lifted."
        )
    return [[*map(LETTERS.__getitem__, phase)] for phase in phases]


def format_schedule(schedule: Sequence[Sequence[str]]) -> str:
    """Return the text of a schedule, which `parse_schedule` reads."""
    return " ".join("".join(map(LETTER_OF.__getitem__, phase)) for phase in schedule)


def check_schedule(schedule: Sequence[Sequence[str]], robot: RobotParameters) -> None:
    """Check that there can be a gait of a schedule.

    Raises:
        PlanningError: if it has other feet or contacts, or nothing holds the body at some time.
    """
    num_feet = len(robot.limbs)
    in_space = robot.body.mount == "free"
    for phase in schedule:
        if len(phase) != num_feet or set(phase) - {*CONTACTS}:
            raise PlanningError(
                f"The schedule has the phase {short_repr(list(phase))}; each phase must have one "
                f"of {', '.join(CONTACTS)} for each of {num_feet} feet."
            )
    forbidden = {"slide_forward", "slide_backward"} if in_space else {"slide"}
    if forbidden & set().union(*schedule):
        raise PlanningError(
            f"The schedule {format_schedule(schedule)!r} has feet that slide forward or backward, "
            "but the body moves in space; let them be dragged (d), where the planner finds along "
            "what."
            if in_space
            else f"The schedule {format_schedule(schedule)!r} has feet that are dragged (d), but "
            "the body moves in a plane; let them slide forward (f) or backward (b)."
        )
    for foot, contacts in enumerate(zip(*schedule, strict=True)):
        if set(contacts) == {"stick"}:
            raise PlanningError(
                f"Foot {foot + 1} sticks in all phases of the schedule "
                f"{format_schedule(schedule)!r}, so that the robot stays where it is; let it slide "
                "or be lifted in one."
            )
    for number, phase in enumerate(schedule):
        after = (number + 1) % len(schedule)
        if ("stick", "stick") not in zip(phase, schedule[after], strict=True):
            raise PlanningError(
                f"No foot sticks both in phase {number + 1} and in phase {after + 1} of the "
                f"schedule {format_schedule(schedule)!r}, so that nothing holds the body when one "
                "follows the other; put a phase between in which all feet stick."
            )


def candidate_schedules(robot: RobotParameters) -> list[Schedule]:
    """Return schedules that are worth trying, the best first.

    In a plane feet move forward one after the other, from the rear or from the front; they slide,
    or are lifted if three or more can stand on the others. Of four or more, every other one may
    move at a time. Between their moves all stick, while the body shifts: where one foot begins to
    slide as another ceases to, friction holds neither, and no such gait walked as planned.

    In space feet are dragged. Four or more go one after the other along each side, from the rear,
    without rests, as two or more others hold the body; or across it. Feet across each other, or on
    one side, go together with rests. Three feet need rests. A cycle may begin at either side: a
    robot turns to the left by one as well as it turns to the right by the other.
    """
    num_feet = len(robot.limbs)
    if robot.body.mount == "free":
        return _schedules_in_space(robot)
    wave = [[foot] for foot in range(num_feet)]
    orders = [wave] if num_feet < 3 else [wave, wave[::-1]]
    if num_feet > 3:
        orders.insert(0, [list(range(0, num_feet, 2)), list(range(1, num_feet, 2))])
    schedules = []
    for contact in ("slide_forward", "swing")[: 1 if num_feet < 3 else 2]:
        for order in orders:
            schedules.append(_group_schedule(order, contact, num_feet))
    return schedules


def _schedules_in_space(robot: RobotParameters) -> list[Schedule]:
    """Return schedules, in the order of trying, in which feet slide one by one or in groups."""
    num_feet = len(robot.limbs)
    # Sort the feet of each side from the rear to the front.
    x, y, _ = robot.hips.T
    from_rear = np.argsort(x, kind="stable")
    left = from_rear[y[from_rear] > 0].tolist()
    right = from_rear[y[from_rear] <= 0].tolist()
    # Order the feet around the body, and in diagonal pairs, such as left rear with right front.
    around = [*left, *right[::-1]]
    diagonal = [*itertools.chain(*zip(left, right[::-1], strict=False))]
    diagonal += [foot for foot in around if foot not in diagonal]
    # Feet move one by one.
    waves = [[*left, *right], [*right, *left], diagonal, diagonal[::-1]]
    waves = waves[::2] if num_feet == 3 else waves  # the others only begin at another foot
    schedules = []
    for wave in waves:
        one_by_one = [[foot] for foot in wave]
        schedules.append(_group_schedule(one_by_one, "slide", num_feet, rests=num_feet < 4))
    # Four and more feet also move in two groups: every other foot, or one side after the other.
    if num_feet > 3:
        alternate = [around[::2], around[1::2]]
        for groups in (alternate, alternate[::-1], [left, right]):
            schedules.append(_group_schedule(groups, "slide", num_feet))
    return [each for number, each in enumerate(schedules) if each not in schedules[:number]]


def _group_schedule(
    order: list[list[int]], contact: str, num_feet: int, rests: bool = True
) -> Schedule:
    """Return phases in which groups of feet move in an order; with rests, all stick in between."""
    phases = []
    for moving in order:
        phases.append([contact if foot in moving else "stick" for foot in range(num_feet)])
        phases += [["stick"] * num_feet] * rests
    return phases
