"""Read numbers and times in the cells of a log."""

import math
import re

from calibration.import_logs.words import is_unit

AMOUNT = re.compile(r"([-+.,\d]+(?:[eE][-+]?\d+)?)\s*([^\d\s].*)")  # a number and its unit
_SWITCH_STATES = {"on": 1.0, "off": 0.0, "true": 1.0, "false": 0.0, "ein": 1.0, "aus": 0.0}
_TIME = re.compile(
    r"(?:\d+[-/. ]+[^\W_]+[-/. ]+\d+)?[ T_]*(?P<hours>\d+):(?P<minutes>\d\d?):"
    r"(?P<seconds>\d\d)(?:[.:](?P<fraction>\d+))?\s*(?P<half>[AaPp][Mm])?\s*"
    r"(?:Z|[-+]\d\d:?\d\d)?"
)


def number(text: str, decimal_mark: str = ".") -> float:
    """Return the number in a cell, without its unit; nan if it has none, or one not finite.

    With a decimal comma "1.234,5" is 1234.5; but "1.234" has no comma, and is 1.234.
    """
    if decimal_mark == "," and text.count(",") == 1 and text.rfind(".") < text.find(","):
        text = text.replace(".", "").replace(",", ".")
    try:
        value = float(text)
    except ValueError:
        text = text.strip()
        amount = AMOUNT.fullmatch(text)
        if amount and is_unit(amount[2]):
            return number(amount[1])
        return _SWITCH_STATES.get(text.lower(), math.nan)
    return value if math.isfinite(value) else math.nan


def time_of_day(text: str) -> float:
    """Return the time since midnight in a cell with or without a date, s; nan if it has none.

    The date and the time zone say nothing more: no recording goes on over a gap of hours.
    """
    match = _TIME.fullmatch(text.strip().replace(",", "."))
    if not match:
        return math.nan
    part = match.groupdict()
    hours = int(part["hours"])
    if part["half"]:
        hours = hours % 12 + 12 * (part["half"][0] in "Pp")
    seconds = float(f"{part['seconds']}.{part['fraction'] or 0}")
    return 3600.0 * hours + 60.0 * int(part["minutes"]) + seconds


def is_number(cell: str, decimal_mark: str) -> bool:
    """Return whether a cell has a number."""
    return not math.isnan(number(cell, decimal_mark))


def is_time(cell: str) -> bool:
    """Return whether a cell has a time of day."""
    return not math.isnan(time_of_day(cell))


def is_name(cell: str) -> bool:
    """Return whether a cell may be the name of a column."""
    has_letter = re.search(r"[^\W\d_]", cell)
    return bool(has_letter) and not is_time(cell) and not is_number(cell, ".")
