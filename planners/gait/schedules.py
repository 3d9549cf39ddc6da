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


def sensible_schedules(num_feet: int) -> list[Schedule]:
    """Schedules forward that are worth trying, the crawl of `plan_gait` first.

    Feet move one after the other, from the rear or from the front; they slide, or are lifted if
    three or more can stand on the others. Between their moves all stick, while the body shifts, or
    the next foot moves at once. Of four or more, every other one may move at a time.
    """
    wave = [[foot] for foot in range(num_feet)]
    orders = [wave] if num_feet < 3 else [wave, wave[::-1]]
    if num_feet > 3:
        orders.append([list(range(0, num_feet, 2)), list(range(1, num_feet, 2))])
    return [
        _schedule(order, contact, num_feet, rests)
        for contact in ("slide_forward", "swing")[: 1 if num_feet < 3 else 2]
        for order in orders
        for rests in (True, False)
    ]


def _schedule(order: list[list[int]], contact: str, num_feet: int, rests: bool) -> Schedule:
    """Groups of feet that move in an order, all sticking between if it rests."""
    phases = []
    for moving in order:
        phases.append([contact if foot in moving else "stick" for foot in range(num_feet)])
        phases += [["stick"] * num_feet] * rests
    return phases
