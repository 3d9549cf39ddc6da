"""Numbers, dates and times of day in the cells of a log."""

import datetime
import functools
import math
import re

from calibration.import_logs.words import unit_quantity

_SWITCHED = {"on": 1.0, "off": 0.0, "true": 1.0, "false": 0.0, "ein": 1.0, "aus": 0.0}
_AMOUNT = re.compile(r"([-+.,\d]+(?:[eE][-+]?\d+)?)\s*([^\d\s].*)")
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(,\d{3})+(\.\d*)?")
_MONTHS = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"]
_GERMAN_MONTHS = {"mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12}
_DATE = (
    r"(?:(?P<year>\d{4})[-/.](?P<month>\d\d?)[-/.](?P<day>\d\d?)"
    r"|(?P<first>\d\d?)(?P<mark>[./-])(?P<second>\d\d?)[./-](?P<last>\d{4}|\d\d)"
    r"|(?P<named_day>\d\d?)[-. ]+(?P<name>[^\W\d_]{3,9})[-. ]+(?P<named_year>\d{4}))"
)
_MOMENT = re.compile(
    rf"{_DATE}?[ T_]*(?:(?P<hours>\d+):)?(?P<minutes>\d\d?):(?P<seconds>\d\d)"
    r"(?:[.:](?P<fraction>\d+))?\s*(?P<half>[AaPp][Mm])?\s*(?P<zone>Z|[-+]\d\d:?\d\d)?"
)


def number(text: str, decimal: str = ".") -> float:
    """Return the number in a cell; nan if it has none, or one that is not finite."""
    if decimal == ",":
        german = text.count(",") == 1 and text.rfind(".") < text.find(",")
        text = text.replace(".", "").replace(",", ".") if german else text
    try:
        value = float(text)
    except ValueError:
        text = text.strip()
        if (word := text.lower()) in _SWITCHED:
            return _SWITCHED[word]
        if _THOUSANDS.fullmatch(text):
            return float(text.replace(",", ""))
        amount = _AMOUNT.fullmatch(text)
        return number(amount[1]) if amount and unit_quantity(amount[2]) else math.nan
    return value if math.isfinite(value) else math.nan


@functools.lru_cache(maxsize=16)
def _seconds_of_date(year: int, month: int, day: int) -> float:
    return datetime.datetime(year, month, day, tzinfo=datetime.UTC).timestamp()


def moment(text: str) -> float:
    """Return the date and time in a cell, or its time of day, s; nan if it has none.

    Times of day alone are of the year 1900, and negative.
    """
    found = _MOMENT.fullmatch(text.strip().replace(",", "."))
    if not found:
        return math.nan
    part = found.groupdict()
    year, month, day = _date(part)
    if year == 1900 and not part["hours"] and not part["half"]:
        return math.nan  # 12:30 may be of hours or of minutes
    hours, minutes, seconds = part["hours"], part["minutes"], part["seconds"]
    if not hours:  # beside a date or am and pm: hours and minutes
        hours, minutes, seconds = minutes, seconds, "0"
    time = 3600.0 * int(hours) + 60.0 * int(minutes) + float(f"{seconds}.{part['fraction'] or 0}")
    if part["half"]:
        time += 3600.0 * (12 * (part["half"][0] in "Pp") - 12 * (int(hours) == 12))
    if (zone := part["zone"]) and zone != "Z":
        ahead = 3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:])
        time += ahead if zone[0] == "-" else -ahead
    try:
        return _seconds_of_date(year, month, day) + time
    except ValueError:
        return math.nan


def _date(part: dict[str, str]) -> tuple[int, int, int]:
    """Return year, month and day of a moment; 1900, 1 and 1 of a time of day."""
    if part["year"]:
        return int(part["year"]), int(part["month"]), int(part["day"])
    if part["name"]:
        name = part["name"].lower()[:3]
        month = _MONTHS.index(name) + 1 if name in _MONTHS else _GERMAN_MONTHS.get(name, 0)
        return int(part["named_year"]), month, int(part["named_day"])
    if not part["first"]:
        return 1900, 1, 1
    # 31.12.2025, or 12/31/2025 unless there is no such month.
    american = part["mark"] == "/" and int(part["first"]) <= 12
    first = int(part["first"])
    second = int(part["second"])
    year = int(part["last"])
    year = year if year > 99 else 2000 + year
    return (year, first, second) if american else (year, second, first)


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell has a number."""
    return not math.isnan(number(cell, decimal))


def is_moment(cell: str) -> bool:
    """Whether a cell has a date and time, or a time of day."""
    return not math.isnan(moment(cell))


def is_name(cell: str) -> bool:
    """Whether a cell may be the name of a column."""
    return any(map(str.isalpha, cell)) and not is_moment(cell) and not is_number(cell, ".")
