"""Schedules of gaits: what each foot does, phase by phase, and those that are worth trying.

In text, a phase is a letter for each foot, and a space ends it: ``fs ss sf ss`` is a crawl of two
feet, of which the first slides forward, then both stick while the body shifts, and so on.
"""

from collections.abc import Sequence

from limb_systems.files.gait import CONTACTS
from limb_systems.schema import shown
from planners.transcription.solving import PlanningError

LETTERS = dict(zip("sfbl", CONTACTS, strict=True))  # stick, forward, backward, lifted

Schedule = list[list[str]]


def schedule_of(text: str, num_feet: int) -> Schedule:
    """The contact of each foot in each phase (P, F), from text such as ``fs ss sf ss``.

    Raises:
        PlanningError: if it is not such text for so many feet.
    """
    phases = text.lower().split()
    if not phases or any(len(phase) != num_feet or set(phase) - {*LETTERS} for phase in phases):
        raise PlanningError(
            f"The schedule is {shown(text)}; it must have phases of {num_feet} letters, one for "
            "each foot, with spaces between: s if it sticks, f or b if it slides forward or "
            "backward, l if it is lifted."
        )
    return [[LETTERS[letter] for letter in phase] for phase in phases]


def schedule_text(schedule: Sequence[Sequence[str]]) -> str:
    """Text of a schedule, as `schedule_of` reads it."""
    letters = {contact: letter for letter, contact in LETTERS.items()}
    return " ".join("".join(letters[contact] for contact in phase) for phase in schedule)


def check_schedule(schedule: Sequence[Sequence[str]], num_feet: int) -> None:
    """Checks whether there can be a gait of a schedule.

    Raises:
        PlanningError: if it has other feet or contacts, or nothing holds the body at some time.
    """
    for phase in schedule:
        if len(phase) != num_feet or set(phase) - {*CONTACTS}:
            raise PlanningError(
                f"The schedule has the phase {shown(list(phase))}; each phase must have one of "
                f"{', '.join(CONTACTS)} for each of {num_feet} feet."
            )
    for foot, contacts in enumerate(zip(*schedule, strict=True)):
        if set(contacts) == {"stick"}:
            raise PlanningError(
                f"Foot {foot + 1} sticks in all phases of the schedule "
                f"{schedule_text(schedule)!r}, so that the robot stays where it is; let it slide "
                "or be lifted in one."
            )
    for number, phase in enumerate(schedule):
        after = (number + 1) % len(schedule)
        pairs = zip(phase, schedule[after], strict=True)
        if not any(pair == ("stick", "stick") for pair in pairs):
            raise PlanningError(
                f"No foot sticks both in phase {number + 1} and in phase {after + 1} of the "
                f"schedule {schedule_text(schedule)!r}, so that nothing holds the body when one "
                "follows the other; put a phase between in which all feet stick."
            )


def sensible_schedules(num_feet: int) -> list[Schedule]:
    """Schedules forward that are worth trying, the crawl of `plan_gait` first.

    Feet move one after the other, from the rear or from the front; they slide, or are lifted if
    three or more can stand on the others. Of four or more, every other one may move at a time.
    Between their moves all stick, while the body shifts: where one foot begins to slide as another
    ceases to, friction holds neither, and no such gait walked as planned.
    """
    wave = [[foot] for foot in range(num_feet)]
    orders = [wave] if num_feet < 3 else [wave, wave[::-1]]
    if num_feet > 3:
        orders.insert(0, [list(range(0, num_feet, 2)), list(range(1, num_feet, 2))])
    return [
        _schedule(order, contact, num_feet)
        for contact in ("slide_forward", "swing")[: 1 if num_feet < 3 else 2]
        for order in orders
    ]


def _schedule(order: list[list[int]], contact: str, num_feet: int) -> Schedule:
    """Groups of feet that move in an order, all sticking between."""
    phases = []
    for moving in order:
        phases.append([contact if foot in moving else "stick" for foot in range(num_feet)])
        phases.append(["stick"] * num_feet)
    return phases
