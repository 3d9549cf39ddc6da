"""Read numbers, dates and times of day in the cells of a log."""

import datetime
import functools
import math
import re

from calibration.import_logs.words import parse_unit

_SWITCH_STATES = {"on": 1.0, "off": 0.0, "true": 1.0, "false": 0.0, "ein": 1.0, "aus": 0.0}
AMOUNT = re.compile(r"([-+.,\d]+(?:[eE][-+]?\d+)?)\s*([^\d\s].*)")
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(,\d{3})+(\.\d*)?")
_MONTHS = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"]
_GERMAN_MONTHS = {"mär": "mar", "mrz": "mar", "mai": "may", "okt": "oct", "dez": "dec"}
_DATE = (
    r"(?:(?P<year>\d{4})[-/.](?P<month>\d\d?)[-/.](?P<day>\d\d?)"
    r"|(?P<first>\d\d?)(?P<mark>[./-])(?P<second>\d\d?)[./-](?P<last>\d{4}|\d\d)"
    r"|(?P<named_day>\d\d?)[-. ]+(?P<name>[^\W\d_]{3,9})[-. ]+(?P<named_year>\d{4}))"
)
_MOMENT = re.compile(
    rf"{_DATE}?[ T_]*(?:(?P<hours>\d+):)?(?P<minutes>\d\d?):(?P<seconds>\d\d)"
    r"(?:[.:](?P<fraction>\d+))?\s*(?P<half>[AaPp][Mm])?\s*(?P<zone>Z|[-+]\d\d:?\d\d)?"
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
        if _THOUSANDS.fullmatch(text):
            return float(text.replace(",", ""))
        amount = AMOUNT.fullmatch(text)
        if amount and parse_unit(amount[2])[0]:
            return number(amount[1])
        return _SWITCH_STATES.get(text.lower(), math.nan)
    return value if math.isfinite(value) else math.nan


def moment(text: str) -> float:
    """Return the date and time in a cell, or its time of day, s; nan if it has none.

    Times of day alone are of the year 1900, and negative.
    """
    match = _MOMENT.fullmatch(text.strip().replace(",", "."))
    if not match:
        return math.nan
    part = match.groupdict()
    year, month, day = _date(part)
    hours = part["hours"]
    minutes = part["minutes"]
    seconds = part["seconds"]
    if not hours and year == 1900 and not part["half"]:
        return math.nan  # 12:30 may be of hours or of minutes
    if not hours:  # with a date, or am and pm: hours and minutes
        hours = minutes
        minutes = seconds
        seconds = "0"
    time = 3600.0 * int(hours) + 60.0 * int(minutes) + float(f"{seconds}.{part['fraction'] or 0}")
    if part["half"]:
        time += 3600.0 * (12 * (part["half"][0] in "Pp") - 12 * (int(hours) == 12))
    zone = part["zone"] or "Z"
    if zone != "Z":
        ahead = 3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:])
        time -= ahead if zone[0] == "+" else -ahead
    return _seconds_of_date(year, month, day) + time


@functools.lru_cache(maxsize=16)
def _seconds_of_date(year: int, month: int, day: int) -> float:
    try:
        return datetime.datetime(year, month, day, tzinfo=datetime.UTC).timestamp()
    except ValueError:
        return math.nan


def _date(part: dict[str, str]) -> tuple[int, int, int]:
    """Return year, month and day of a moment; 1900, 1 and 1 of a time of day."""
    if part["year"]:
        return int(part["year"]), int(part["month"]), int(part["day"])
    if part["name"]:
        name = part["name"].lower()[:3]
        name = _GERMAN_MONTHS.get(name, name)
        month = _MONTHS.index(name) + 1 if name in _MONTHS else 0
        return int(part["named_year"]), month, int(part["named_day"])
    if not part["first"]:
        return 1900, 1, 1
    # 31.12.2025, or 12/31/2025 unless there is no such month.
    first = int(part["first"])
    second = int(part["second"])
    year = int(part["last"])
    year = year if year > 99 else 2000 + year
    is_american = part["mark"] == "/" and first <= 12
    return (year, first, second) if is_american else (year, second, first)


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell has a number."""
    return not math.isnan(number(cell, decimal))


def is_moment(cell: str) -> bool:
    """Return whether a cell has a date and time, or a time of day."""
    return not math.isnan(moment(cell))


def is_name(cell: str) -> bool:
    """Return whether a cell may be the name of a column."""
    return any(map(str.isalpha, cell)) and not is_moment(cell) and not is_number(cell, ".")
