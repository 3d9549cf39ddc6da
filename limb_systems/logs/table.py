"""A log as a table of text: its encoding, its delimiter, its line of names."""

import csv
import dataclasses
import datetime
import math
import re
from collections import Counter
from pathlib import Path

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.input import LARGEST_TABLE, read_bytes

# As mappings call them; the last one stands for any white space.
DELIMITERS = {",": ",", ";": ";", "tab": "\t", "|": "|", "space": None}
LOOKED_AT = 200  # rows by which the delimiter is told
FEWEST_ROWS = 10
_TIMES = ("%H:%M:%S.%f", "%H:%M:%S", "%d.%m.%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S",
          "%m/%d/%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S", "%m/%d/%Y %I:%M:%S %p")  # fmt: skip
_SWITCHED = {"on": 1.0, "off": 0.0, "true": 1.0, "false": 0.0}
_DATED = re.compile(r"\d+\D\d+\D\d+")
_UNIT = re.compile(
    r"[\[(]?(m?s|us|µs|sec|h|min|°?[CFK]|deg[CF]?|rad|°|%|-|1|V|A|counts?|px)?[\])]?"
)


class LogError(LimbError):
    """A log cannot be read, or not by its mapping."""


@dataclasses.dataclass(frozen=True)
class LogTable:
    """The rows of a log, as text.

    - ``names``: names of the columns; ``column_1`` and so on where the log has none.
    - ``units``: units in a row under the names; empty texts if there is no such row.
    - ``cells``: rows of as many cells.
    - ``head``: lines before the names.
    - ``delimiter``: what is between cells, one of `DELIMITERS`.
    - ``decimal``: decimal mark of numbers.
    - ``names_line``: number of the line of names, from 1; 0 if there is none.
    - ``odd_rows``: number of rows with another number of cells, which were left out.
    """

    names: list[str]
    units: list[str]
    cells: list[list[str]]
    head: list[str]
    delimiter: str
    decimal: str
    names_line: int
    odd_rows: int

    def texts(self, name: str) -> list[str]:
        """The cells of a column (K,); LogError if there is none of that name."""
        if name not in self.names:
            raise LogError(f"no column {name!r}; the columns are {', '.join(self.names)}.")
        index = self.names.index(name)
        return [row[index] for row in self.cells]

    def numbers(self, name: str) -> np.ndarray:
        """The numbers of a column (K,); nan where a cell has none."""
        return np.array([number(text, self.decimal) for text in self.texts(name)])

    def oldest_first(self) -> "LogTable":
        """The same with its rows in the other order."""
        return dataclasses.replace(self, cells=self.cells[::-1])

    def moments(self, name: str) -> np.ndarray:
        """The dates or times of day of a column (K,), s since any of them; nan where none is."""
        return np.array([_moment(text) for text in self.texts(name)])


def number(text: str, decimal: str = ".") -> float:
    """The number in a cell; nan if it has none, or one that is not finite."""
    if decimal == ",":
        text = text.replace(".", "").replace(",", ".") if text.count(",") == 1 else text
    try:
        value = float(text)
    except ValueError:
        if (word := text.lower()) in _SWITCHED:
            return _SWITCHED[word]
        amount, _, unit = text.partition(" ")
        return number(amount, decimal) if unit and _UNIT.fullmatch(unit) else math.nan
    return value if math.isfinite(value) else math.nan


def _moment(text: str) -> float:
    text = text.strip().replace(",", ".")
    if not _DATED.match(text):
        return math.nan
    try:
        moment = datetime.datetime.fromisoformat(text)
    except ValueError:
        for form in _TIMES:
            try:
                moment = datetime.datetime.strptime(text, form)
                break
            except ValueError:
                continue
        else:
            return math.nan
    return moment.replace(tzinfo=moment.tzinfo or datetime.UTC).timestamp()


def read_table(
    path: str | Path, delimiter: str = "", decimal: str = "", names_line: int | None = None
) -> LogTable:
    """Reads a log whatever wrote it.

    Args:
        delimiter, decimal, names_line: as in `LogTable`; what the log itself shows if left out.

    Raises:
        LogError: with one sentence, if it is no table of text with rows of numbers.
    """
    lines = _text(path).splitlines()
    if lines and (own := re.match(r"# limb (\w+), format ", lines[0])):
        raise LogError(f"{path} is no log, but a {own[1]} of soft-limb, which is read as it is.")
    choices = [delimiter] if delimiter else list(DELIMITERS)
    delimiter, width, decimal = max(
        ((d, *_shape(lines, d, decimal)) for d in choices), key=lambda shape: shape[3]
    )[:3]
    rows = [_split(line, delimiter) for line in lines]
    first = next(
        (
            index
            for index, row in enumerate(rows)
            if index >= (names_line or 0) and len(row) == width and _is_of_numbers(row, decimal)
        ),
        None,
    )
    if first is None or width < 2:
        raise LogError(f"{path} has no rows of numbers between delimiters; is it a log?")
    if names_line is None:
        names_line = _names_line(rows, first, width)
    names = rows[names_line - 1] if names_line else []
    cells = [row for row in rows[first:] if len(row) == width and any(row)]
    odd = sum(any(row) for row in rows[first:]) - len(cells)
    if len(cells) < FEWEST_ROWS:
        raise LogError(f"{path} has only {len(cells)} rows of numbers.")
    head = lines[: (names_line or first + 1) - 1]
    below = rows[names_line] if names_line and names_line < first else []
    units = below if len(below) == width else [""] * width
    return LogTable(_unique(names, width), units, cells, head, delimiter, decimal, names_line, odd)


def _text(path: str | Path) -> str:
    data = read_bytes(path, "log", LARGEST_TABLE, LogError)
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    if b"\0" in data[:4096]:
        raise LogError(f"{path} is not text; save the log as CSV.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _split(line: str, delimiter: str) -> list[str]:
    if not (character := DELIMITERS[delimiter]):
        return line.split()
    cells = next(csv.reader([line], delimiter=character), [])
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
    shares = [
        np.mean([not math.isnan(number(c, mark)) or not math.isnan(_moment(c)) for c in cells])
        for mark in marks
    ]
    best = int(np.argmax(shares))
    return width, marks[best], float(shares[best]) * count / len(rows) if cells else 0.0


def _is_of_numbers(row: list[str], decimal: str) -> bool:
    full = [cell for cell in row if cell]
    known = sum(not (math.isnan(number(c, decimal)) and math.isnan(_moment(c))) for c in full)
    return known >= max(2, 0.5 * len(full))


def _names_line(rows: list[list[str]], first: int, width: int) -> int:
    """Number of the line of names before the first row of numbers; 0 if there is none."""
    for index in range(first - 1, -1, -1):
        row = rows[index]
        if not any(row):
            continue
        if len(row) not in (width - 1, width, width + 1):  # it may lack a cell, or begin with "#"
            return 0
        if not all(_UNIT.fullmatch(cell) for cell in row):
            return index + 1
    return 0


def _unique(names: list[str], width: int) -> list[str]:
    """A name for each column, none twice."""
    names = [name.lstrip("#% ").strip("\"'") for name in names]
    names = [name for name in names if name] if len(names) > width else names
    names = [""] * (width - len(names)) + names if len(names) < width else names
    given = [name or f"column_{i}" for i, name in enumerate(names, 1)]
    seen: Counter[str] = Counter()
    unique = []
    for name in given[:width]:
        seen[name] += 1
        unique.append(name if seen[name] == 1 else f"{name}_{seen[name]}")
    return unique
