"""A log as a table of numbers: its encoding, its delimiter, its line of names."""

import codecs
import csv
import dataclasses
import datetime
import functools
import io
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.files.input import LARGEST_TABLE, read_bytes
from limb_systems.logs.columns import is_unit, unit_quantity
from limb_systems.progress import Progress

# As mappings call them; the last one stands for any white space.
DELIMITERS = {",": ",", ";": ";", "tab": "\t", "|": "|", "space": None}
LOOKED_AT = 200  # rows by which the delimiter is told
FEWEST_ROWS = 10
LONGEST_LINE = 100_000  # characters
LONGEST_HEAD = 10_000  # lines before the first row of numbers
BLOCK = 20_000  # rows that are texts at a time
_PIECE = 2**18  # bytes, of which the rows that are looked at are
_SWITCHED = {"on": 1.0, "off": 0.0, "true": 1.0, "false": 0.0}
_AMOUNT = re.compile(r"([-+.,\d]+(?:[eE][-+]?\d+)?)\s*([^\d\s].*)")
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(,\d{3})+(\.\d*)?")
_MOMENT = re.compile(
    r"(?:(\d{4})[-/.](\d\d?)[-/.](\d\d?)|(\d\d?)([./-])(\d\d?)[./-](\d{4}))?[ T_]*"
    r"(?:(\d+):)?(\d\d):(\d\d)(?:[.:](\d+))?\s*([AaPp][Mm])?\s*(Z|[-+]\d\d:?\d\d)?"
)


class LogError(LimbError):
    """A log cannot be read, or not by its mapping."""


@dataclasses.dataclass(frozen=True, eq=False)
class LogTable:
    """The rows of a log, as numbers.

    - ``names``: names of the N columns; ``column_1`` and so on where the log has none.
    - ``units``: units in a row under the names, or in the cells; empty texts if there are none.
    - ``values``: the number in each cell, a column (K,) for each name; nan where a cell has none.
    - ``dates``: the moment in each cell, s, of columns that have dates or times of day (K,).
    - ``delimiter``: what is between cells, one of `DELIMITERS`.
    - ``decimal``: decimal mark of numbers.
    - ``names_line``: number of the line of names, from 1; 0 if there is none.
    - ``odd_rows``: number of rows with another number of cells, which were left out.
    """

    names: list[str]
    units: list[str]
    values: list[np.ndarray]
    dates: dict[str, np.ndarray]
    delimiter: str
    decimal: str
    names_line: int
    odd_rows: int

    @property
    def num_rows(self) -> int:
        """The number K of rows."""
        return len(self.values[0])

    def numbers(self, name: str) -> np.ndarray:
        """The numbers of a column (K,); LogError if there is none of that name."""
        if name not in self.names:
            raise LogError(f"no column {name!r}; the columns are {', '.join(self.names)}.")
        return self.values[self.names.index(name)]

    def moments(self, name: str) -> np.ndarray:
        """The dates or times of day of a column (K,), s since any of them; nan where none is."""
        return self.dates.get(name, np.full(self.numbers(name).shape, np.nan))

    def only(self, names: set[str]) -> "LogTable":
        """The same with some of its columns, so that the others need no memory."""
        kept = [index for index, name in enumerate(self.names) if name in names]
        return dataclasses.replace(
            self,
            names=[self.names[index] for index in kept],
            units=[self.units[index] for index in kept],
            values=[self.values[index] for index in kept],
        )

    def oldest_first(self) -> "LogTable":
        """The same with its rows in the other order."""
        return dataclasses.replace(
            self,
            values=[column[::-1] for column in self.values],
            dates={name: column[::-1] for name, column in self.dates.items()},
        )


def number(text: str, decimal: str = ".") -> float:
    """The number in a cell; nan if it has none, or one that is not finite."""
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
    """The date and time in a cell, or its time of day, s; nan if it has none.

    Times of day alone are of the year 1900, and negative.
    """
    found = _MOMENT.fullmatch(text.strip().replace(",", "."))
    if not found:
        return math.nan
    year, month, day, first, mark, second, last, *clock = found.groups()
    if not clock[0] and not clock[3]:
        return math.nan  # 12:30 may be of hours or of minutes
    if first:  # 31.12.2025, or 12/31/2025 unless there is no such month
        american = mark == "/" and int(first) <= 12
        year, month, day = last, *((first, second) if american else (second, first))
    hours, minutes, seconds, fraction, half, zone = clock[0] or "0", *clock[1:]
    time = 3600.0 * int(hours) + 60.0 * int(minutes) + float(f"{seconds}.{fraction or 0}")
    if half:
        time += 3600.0 * (12 * (half[0] in "Pp") - 12 * (int(hours) == 12))
    if zone and zone != "Z":
        time -= (3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:])) * (-1 if zone[0] == "-" else 1)
    try:
        return _seconds_of_date(int(year or 1900), int(month or 1), int(day or 1)) + time
    except ValueError:
        return math.nan


def read_table(
    path: str | Path, delimiter: str = "", decimal: str = "", names_line: int | None = None
) -> LogTable:
    """Reads a log whatever wrote it, and shows how far it is on a terminal.

    Args:
        delimiter, decimal, names_line: as in `LogTable`; what the log itself shows if left out.

    Raises:
        LogError: with one sentence, if it is no table of text with rows of numbers.
    """
    data = read_bytes(path, "log", LARGEST_TABLE, LogError)
    if own := re.match(rb"(?:\xef\xbb\xbf)?# limb (\w+), format ", data):
        raise LogError(
            f"{path} is no log, but a {own[1].decode()} of soft-limb, which is read as it is."
        )
    encoding = _encoding(data, path)
    sample = _sample(data, encoding)
    choices = [delimiter] if delimiter else list(DELIMITERS)
    delimiter, width, decimal = max(
        ((d, *_shape(sample, d, decimal)) for d in choices), key=lambda shape: shape[3]
    )[:3]
    lines = _lines(data, encoding, path)
    del data
    head: list[list[str]] = []
    no_rows = LogError(f"{path} has no rows of numbers between delimiters; is it a log?")
    for line in lines:
        row = _split(line, delimiter)
        if (
            len(head) >= (names_line or 0)
            and len(row) == width > 1
            and _is_of_numbers(row, decimal)
        ):
            lines = itertools.chain([line], lines)
            break
        head.append(row)
        if len(head) > LONGEST_HEAD:
            raise no_rows
    else:
        raise no_rows
    if names_line is None:
        names_line = _names_line(head, width)
    below = head[names_line] if names_line and names_line < len(head) else []
    units = below if len(below) == width else [""] * width
    units = _units_in_cells(units, [_split(line, delimiter) for line in sample])
    names = _names(head[names_line - 1], row, delimiter) if names_line else [""] * width
    if len(names) != width:
        raise LogError(
            f"{path} has {len(names)} names in line {names_line}, but {width} cells in the rows "
            "below; give each column a name, or none in the line."
        )
    names = _unique(names)
    values, dates, odd = _columns(lines, delimiter, decimal, names)
    if len(values[0]) < FEWEST_ROWS:
        raise LogError(f"{path} has only {len(values[0])} rows of numbers.")
    return LogTable(names, units, values, dates, delimiter, decimal, names_line, odd)


def _encoding(data: bytes, path: str | Path) -> str:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    if zeros := data[:4096].count(b"\0"):
        # Half of the bytes of text in UTF-16 are zero, always the same half.
        for encoding, start in (("utf-16-le", 1), ("utf-16-be", 0)):
            if data[start:4096:2].count(b"\0") == zeros > 0.4 * len(data[:4096]):
                return encoding
        raise LogError(f"{path} is not text; save the log as CSV.")
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        for start in range(0, len(data), 2**20):
            decoder.decode(data[start : start + 2**20])
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _sample(data: bytes, encoding: str) -> list[str]:
    """Lines from the middle of a log, without those that no log has."""
    if len(data) <= _PIECE:
        lines = data.decode(encoding, errors="replace").splitlines()
    else:
        middle = (len(data) - _PIECE) // 4 * 2  # a character of UTF-16 begins at even bytes
        if encoding == "utf-16":
            encoding += "-be" if data[:2] == b"\xfe\xff" else "-le"
        piece = data[middle : middle + _PIECE].decode(encoding, errors="replace")
        lines = piece.splitlines()[1:-1]
    return [line for line in lines if len(line) < LONGEST_LINE]


def _lines(data: bytes, encoding: str, path: str | Path) -> Iterator[str]:
    """The lines of a log, without their ends."""
    binary = io.BytesIO(data)
    text = io.TextIOWrapper(binary, encoding, errors="replace")
    with Progress(f"reading {Path(path).name}", round(len(data) / 1e6, 1), "MB") as progress:
        for number in itertools.count(1):
            if not (line := text.readline(LONGEST_LINE)):
                return
            if len(line) == LONGEST_LINE and line[-1] != "\n":
                raise LogError(
                    f"{path} has more than {LONGEST_LINE} characters in line {number}; "
                    "a row of a log is shorter: save the log with a line for each row."
                )
            if number % 1000 == 0:
                progress.update(binary.tell() / 1e6)
            yield line.removesuffix("\n")


def _columns(
    lines: Iterator[str], delimiter: str, decimal: str, names: list[str]
) -> tuple[list[np.ndarray], dict[str, np.ndarray], int]:
    """The numbers and the moments of columns, from rows of text; how many rows are odd.

    The texts of `BLOCK` rows at a time are in memory.
    """
    numbers: list[list[np.ndarray]] = [[] for _ in names]
    moments: list[dict[int, np.ndarray]] = [{} for _ in names]  # by block
    odd = 0
    while block := list(itertools.islice(lines, BLOCK)):
        rows = _rows(block, delimiter)
        full = [row for row in rows if len(row) == len(names) and any(row)]
        odd += sum(any(row) for row in rows) - len(full)
        for cells, of_numbers, of_moments in zip(
            zip(*full, strict=True), numbers, moments, strict=False
        ):
            of_numbers.append(_numbers(cells, decimal))
            if of_moments or np.isnan(of_numbers[-1]).all():
                found = np.array([moment(cell) for cell in cells])
                if of_moments or not np.isnan(found).all():
                    of_moments[len(of_numbers) - 1] = found
    values, dates = [], {}
    for name, of_numbers, of_moments in zip(names, numbers, moments, strict=True):
        if of_moments:
            parts = [of_moments.get(i, np.full(len(p), np.nan)) for i, p in enumerate(of_numbers)]
            dates[name] = np.concatenate(parts)
        values.append(np.concatenate(of_numbers) if of_numbers else np.empty(0))
        of_numbers.clear()
    return values, dates, odd


def _numbers(cells: tuple[str, ...], decimal: str) -> np.ndarray:
    """The numbers in a column's cells (K,)."""
    try:
        values = np.fromiter(map(float, cells), float, len(cells))
    except ValueError:
        known: dict[str, float] = {}
        for cell in cells:
            if cell not in known:
                known[cell] = number(cell, decimal)
        values = np.fromiter(map(known.__getitem__, cells), float, len(cells))
    return np.where(np.isfinite(values), values, np.nan)


def _rows(lines: list[str], delimiter: str) -> list[list[str]]:
    character = DELIMITERS[delimiter]
    if character and not any('"' in line for line in lines):
        return [line.split(character) for line in lines]
    return [_split(line, delimiter) for line in lines]


def _split(line: str, delimiter: str) -> list[str]:
    if not (character := DELIMITERS[delimiter]):
        return line.split()
    # A quote that is never closed is a character of its cell.
    quoted = line.count('"') % 2 == 0
    cells = next(csv.reader([line], delimiter=character), []) if quoted else line.split(character)
    return [cell.strip() for cell in cells]


def _shape(lines: list[str], delimiter: str, decimal: str) -> tuple[int, str, float]:
    """Cells in most rows with a delimiter, their decimal mark, and how well that fits (0 to 1)."""
    full = [line for line in lines if line.strip()]
    start = max(0, (len(full) - LOOKED_AT) // 2)
    rows = [_split(line, delimiter) for line in full[start : start + LOOKED_AT]]
    if not rows:
        return 0, ".", 0.0
    width, count = Counter(map(len, rows)).most_common(1)[0]
    if width < 2:
        return width, ".", 0.0
    cells = [cell for row in rows if len(row) == width for cell in row if cell]
    marks = [decimal] if decimal else [".", ","]
    shares = [np.mean([_is_written(cell, mark) for cell in cells]) for mark in marks]
    best = int(np.argmax(shares))
    return width, marks[best], float(shares[best]) * count / len(rows) if cells else 0.0


def _is_written(cell: str, mark: str) -> bool:
    """Whether a cell is a moment, or a number with a decimal mark and no other."""
    if not math.isnan(moment(cell)):
        return True
    other = "." if mark == "," else ","
    alone = other not in cell or (mark == "," in cell)
    return alone and not math.isnan(number(cell, mark))


def _is_of_numbers(row: list[str], decimal: str) -> bool:
    full = [cell for cell in row if cell]
    known = sum(not (math.isnan(number(c, decimal)) and math.isnan(moment(c))) for c in full)
    return known >= max(2, 0.3 * len(full))


def _names_line(head: list[list[str]], width: int) -> int:
    """Number of the line of names before the first row of numbers; 0 if there is none."""
    for index in range(len(head) - 1, -1, -1):
        row = head[index]
        if not any(row):
            continue
        if len(row) not in (width - 1, width, width + 1):  # it may lack a cell, or begin with "#"
            return 0
        known = sum(is_unit(cell) for cell in row)
        above = head[index - 1] if index else []
        if known < len(row) and (known < 0.5 * len(row) or len(above) != len(row)):
            return index + 1
    return 0


def _units_in_cells(units: list[str], rows: list[list[str]]) -> list[str]:
    """The units of columns, also those that have their unit in each cell: "27 %"."""
    found = [*units]
    for row in rows:
        for index, cell in enumerate(row if len(row) == len(units) else []):
            amount = _AMOUNT.fullmatch(cell)
            if not found[index] and amount and unit_quantity(amount[2]):
                found[index] = amount[2]
    return found


def _names(names: list[str], row: list[str], delimiter: str) -> list[str]:
    """The names in a line, one for each cell of a row below it, as far as that can be told."""
    names = [name.lstrip("#% ").strip("\"'") for name in names]
    if len(names) > len(row):
        return [name for name in names if name]  # the line began with a "#" of its own
    if len(names) == len(row) - 1:
        if not row[-1]:
            return [*names, ""]  # rows end with a delimiter
        is_number = re.fullmatch(r"[-+]?\d*[.,]?\d+", row[0])
        if delimiter == "space" or not is_number:
            return ["", *names]  # a date before the time, or the name of the row
    return names


def _unique(names: list[str]) -> list[str]:
    """A name for each column, none twice."""
    given = [name or f"column_{i}" for i, name in enumerate(names, 1)]
    seen: Counter[str] = Counter()
    unique = []
    for name in given:
        seen[name] += 1
        unique.append(name if seen[name] == 1 else f"{name}_{seen[name]}")
    return unique
