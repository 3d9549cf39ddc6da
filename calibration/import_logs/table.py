"""Read a log as a table of numbers, whatever wrote it."""

import codecs
import contextlib
import csv
import dataclasses
import io
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from calibration.import_logs.words import is_unit
from limb_systems.errors import LimbError
from limb_systems.files.input import LARGEST_TABLE, check_file
from limb_systems.progress import Progress

# Delimiters by name; "space" is any white space.
DELIMITERS = {",": ",", ";": ";", "tab": "\t", "|": "|", "space": None}
SAMPLE_ROWS = 100  # which show the form of the lines
MIN_ROWS = 10
MIN_FIRST_ROWS = 4  # rows of numbers, one after the other, with which the numbers begin
MAX_HEAD_LINES = 10_000  # lines before the first row of numbers
MAX_LINE_LENGTH = 100_000  # characters
BLOCK_CHARACTERS = 2**21  # characters that are in memory as text
AMOUNT = re.compile(r"([-+.,\d]+(?:[eE][-+]?\d+)?)\s*([^\d\s([].*)")  # a number and its unit
_SWITCH_STATES = {"on": 1.0, "off": 0.0, "true": 1.0, "false": 0.0, "ein": 1.0, "aus": 0.0}
_SWITCH_STATES |= {"high": 1.0, "low": 0.0}
_TIME = re.compile(
    r"(?:\d+[-/. ]+[^\W_]+[-/. ]+\d+)?[ T_]*(?P<hours>\d+):(?P<minutes>\d\d?):"
    r"(?P<seconds>\d\d)(?:[.:](?P<fraction>\d+))?\s*(?P<half>[AaPp][Mm])?\s*"
    r"(?:Z|(?P<sign>[-+])(?P<zone_hours>\d\d):?(?P<zone_minutes>\d\d))?"
)
_CLOCK = r"\d\d?:\d\d:\d\d(?:[.,]\d+)?(?:\s*[AaPp][Mm])?"
_DATED = rf"(?:\d{{4}}-\d\d-\d\d[ T]|\d\d?[./]\d\d?[./]\d{{4}} )?{_CLOCK}"
# A terminal's time before a line: "14:02:11.451 -> ", "[14:02:11.451] ", "14:02:11.451 1,2,3".
_STAMP = re.compile(rf"\s*\[?({_DATED})(?:\]\s*|\s*->\s*|\s+(?=[^\s,;|]+\s*[,;|\t]))")
_LABELLED = re.compile(r"\s*\{?\s*\"?([^\W\d][^:=\"]*?)\"?\s*[:=]\s*([^:=]*?)\}?\s*")


def _decode_as_windows(error: UnicodeError) -> tuple[str, int]:
    """Return the text of bytes that are not UTF-8, as Windows writes them."""
    assert isinstance(error, UnicodeDecodeError)
    return error.object[error.start : error.end].decode("cp1252", "replace"), error.end


codecs.register_error("cp1252", _decode_as_windows)


class LogError(LimbError):
    """A log cannot be read, or not by its mapping."""


@dataclasses.dataclass(frozen=True, eq=False)
class LogTable:
    """The rows of a log, as numbers.

    - ``names``: names of the N columns; ``column_1`` and so on where the log has none.
    - ``units``: units from a row of units or from the cells; empty texts if there are none.
    - ``values``: the number in each cell (N, K); nan where a cell has none.
    - ``times_of_day``: names of columns whose numbers are times of day, s.
    - ``has_names``: whether columns have names, in a line or in each cell.
    - ``odd_rows``: number of rows left out, which have another number of cells.
    """

    names: list[str]
    units: list[str]
    values: np.ndarray
    times_of_day: frozenset[str]
    has_names: bool = True
    odd_rows: int = 0

    def numbers(self, name: str) -> np.ndarray:
        """Return the numbers of a column (K,); LogError if the log has no such column."""
        if name in self.names:
            return self.values[self.names.index(name)]
        if name.isdigit() and 0 < int(name) <= len(self.names):
            return self.values[int(name) - 1]
        raise LogError(f"no column {name!r}; the columns are {', '.join(self.names)}.")

    def only(self, names: set[str]) -> "LogTable":
        """Return the table with some of its columns; the others then need no memory."""
        is_kept = [name in names for name in self.names]
        if all(is_kept) or not names <= {*self.names}:  # some are given by number
            return self
        kept_names = list(itertools.compress(self.names, is_kept))
        units = list(itertools.compress(self.units, is_kept))
        return dataclasses.replace(self, names=kept_names, units=units, values=self.values[is_kept])

    def rows(self, which: np.ndarray | slice) -> "LogTable":
        """Return the table with some of its rows, or with its rows in another order."""
        return dataclasses.replace(self, values=self.values[:, which])


class _Form:
    """The form of a log's lines: a delimiter between cells, and what is around numbers.

    - ``delimiter``: between cells, one of `DELIMITERS`.
    - ``decimal``: the decimal mark.
    - ``names_line``: the number of the line of names, from 1, or 0 if there is none.
    - ``is_stamped``: whether a terminal wrote the time before each line.
    - ``labels``: names, if each cell is ``label:value``.
    - ``width``: number of cells of most lines.
    - ``columns``: cells of these lines, column by column.
    - ``is_time``: whether each column has times of day.
    - ``score``: how well the form fits, 0 to 1.
    - ``head``: cells of the lines before the numbers, once they are read.
    """

    def __init__(self, lines: list[str], delimiter: str):
        """Find the form of lines with a delimiter."""
        self.delimiter = delimiter
        self.decimal = "."
        self.names_line = 0
        self.head: list[list[str]] = []
        self.score = 0.0
        # Terminals write a time before each line; sketches write a label before each number.
        self.is_stamped = sum(map(bool, map(_STAMP.match, lines))) > 0.9 * len(lines)
        label_counts = Counter(self._labels_and_values(line)[0] for line in lines)
        self.labels, count = label_counts.most_common(1)[0]
        if count <= 0.8 * len(lines):
            self.labels = ()
        # The form fits as well as its rows are numbers of one decimal mark.
        rows = list(map(self.cells, lines))
        self.width, count = Counter(map(len, rows)).most_common(1)[0]
        self.columns = list(zip(*self._full_rows(rows), strict=True))
        cells = list(filter(None, itertools.chain(*self.columns)))
        if self.width < 2 or not cells:
            return
        for mark in (".", ","):
            num_fitting = 0
            for cell in cells:
                has_other = "," in cell if mark == "." else "." in cell and "," not in cell
                num_fitting += is_time(cell) or (not has_other and is_number(cell, mark))
            score = num_fitting / len(cells) * count / len(lines)
            if score > self.score:
                self.score = score
                self.decimal = mark
        self.is_time = []
        for column in self.columns:
            num_numbers = sum(is_number(cell, self.decimal) for cell in column)
            self.is_time.append(sum(map(is_time, column)) > num_numbers)

    def _without_stamp(self, line: str) -> tuple[list[str], str]:
        """Return the time that a terminal wrote before a line, if any, and the line."""
        stamp = _STAMP.match(line) if self.is_stamped else None
        return ([stamp[1]], line[stamp.end() :]) if stamp else ([], line)

    def _labels_and_values(self, line: str) -> tuple[tuple[str, ...], list[str]]:
        """Return labels and values of the cells of a line; nothing if a cell has none."""
        line = re.sub(r"\s*([:=])\s+", r"\1", self._without_stamp(line)[1])
        cells = filter(None, split_cells(line.replace('"', ""), self.delimiter))
        labels = []
        values = []
        for match in map(_LABELLED.fullmatch, cells):
            if not match:
                return (), []
            labels.append(match[1])
            values.append(match[2])
        return tuple(labels), values

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line; none if its labels are others."""
        stamp, rest = self._without_stamp(line)
        if not self.labels:
            return [*stamp, *split_cells(rest, self.delimiter)]
        labels, values = self._labels_and_values(line)
        return [*stamp, *values] if labels == self.labels else []

    def _full_rows(self, rows: list[list[str]]) -> list[list[str]]:
        """Return the rows with as many cells as most lines have."""
        return [row for row in rows if len(row) == self.width]

    def numbers(self, lines: list[str]) -> tuple[np.ndarray, int]:
        """Return the numbers in lines (N, K), and how many lines have other numbers of cells."""
        # Read lines of numbers and nothing else at once.
        if not (self.is_stamped or self.labels or any(self.is_time)) and self.decimal == ".":
            mark = DELIMITERS[self.delimiter]
            with contextlib.suppress(ValueError):
                parsed = np.loadtxt(lines, comments=None, delimiter=mark, ndmin=2)
                if parsed.shape[1] == self.width:
                    parsed[~np.isfinite(parsed)] = np.nan
                    return parsed.T, 0
        # Read others cell by cell.
        rows = list(filter(any, map(self.cells, lines)))
        full = self._full_rows(rows)
        values = np.empty((self.width, len(full)))
        for index, column in enumerate(zip(*full, strict=True)):
            number_of_cell = {}
            for cell in set(column):
                if self.is_time[index]:
                    number_of_cell[cell] = time_of_day(cell)
                else:
                    number_of_cell[cell] = number(cell, self.decimal)
            values[index] = list(map(number_of_cell.__getitem__, column))
        return values, len(rows) - len(full)

    def read_head(self, lines: list[str]) -> bool:
        """Read the lines before the numbers, and find the names; return whether there are rows."""
        num_rows = 0
        for line in lines[:MAX_HEAD_LINES]:
            row = self.cells(line)
            # Numbers begin where some rows of them follow each other.
            full = list(filter(None, row))
            num_numbers = sum(is_number(cell, self.decimal) or is_time(cell) for cell in full)
            is_row = len(row) == self.width and num_numbers >= max(2, 0.3 * len(full))
            num_rows = num_rows + 1 if is_row else 0
            self.head.append(row)
            if num_rows == MIN_FIRST_ROWS:
                break
        if not num_rows:
            return False
        # Find the names in the lines before.
        del self.head[-num_rows:]
        if not self.labels:
            self.names_line = self._find_names_line()
        return True

    def _find_names_line(self) -> int:
        """Return the number of the last line that has names for all cells; 0 if there is none."""
        width = self.width
        for widths in ((width,), (width - 1, width + 1)):  # it may lack a cell, or begin with "#"
            for line in range(len(self.head), 0, -1):
                row = self.head[line - 1]
                num_units = sum(not cell.strip(" []()-1") or is_unit(cell) for cell in row)
                has_names_above = line > 1 and len(self.head[line - 2]) == len(row)
                is_of_units = num_units >= (0.5 if has_names_above else 1.0) * len(row)
                num_names = sum(map(is_name, row))
                if len(row) in widths and not is_of_units and num_names > 0.5 * sum(map(bool, row)):
                    return line
        return 0

    def names(self, row: list[str]) -> list[str]:
        """Return the names of the columns, as many as the head has, above the first row."""
        time_name = "time" if self.is_stamped else ""
        if self.labels:
            return [*filter(None, [time_name]), *self.labels]
        if not self.names_line:
            return [time_name, *[""] * (self.width - 1)]
        names = [name.lstrip("#% ").strip("\"'") for name in self.head[self.names_line - 1]]
        # The line may have begun with a "#", rows may end with a delimiter or begin with a date.
        begins_plain = bool(re.fullmatch(r"[-+]?\d*[.,]?\d+", row[0]))
        if len(names) > len(row):
            names = list(filter(None, names))
        elif len(names) == len(row) - 1 and not row[-1]:
            names.append("")
        elif len(names) == len(row) - 1 and (self.delimiter == "space" or not begins_plain):
            names.insert(0, time_name)
        if self.is_stamped and is_time(names[0]):
            names[0] = time_name
        # Names that are there twice, such as X and Y of points, begin with what a row above says.
        counts = Counter(filter(None, names))
        above = [row for row in self.head[: self.names_line - 1] if len(row) == len(names)]
        above.sort(key=lambda cells: {"name", "bodyparts"}.isdisjoint(map(str.lower, cells[:2])))
        for cells in above:
            # Cells that are merged have their text in the first of them.
            joined = []
            group = ""
            for name, cell in zip(names, cells, strict=True):
                group = cell or group
                joined.append(f"{group} {name}".strip() if counts[name] > 1 else name)
            if max(Counter(filter(None, joined)).values()) == 1:
                return joined
        return names

    def units(self) -> list[str]:
        """Return the unit of each column, from a row beside the names, or from its cells."""
        units = [""] * self.width
        above = self.head[: max(0, self.names_line - 1)]
        for row in [*self.head[self.names_line :], *reversed(above)]:
            num_units = sum(map(is_unit, row))
            if len(row) == self.width and num_units >= max(2, 0.5 * sum(map(bool, row))):
                units = [cell if is_unit(cell) else "" for cell in row]
                break
        for index, column in enumerate(self.columns):
            for amount in filter(None, map(AMOUNT.fullmatch, column)):
                if not units[index] and is_unit(amount[2]):
                    units[index] = amount[2]
        return units


def read_table(path: str | Path) -> LogTable:
    """Read a log whatever wrote it, and show the progress on a terminal.

    LogError if it is no table of text with rows of numbers.
    """
    check_file(path, "log", LARGEST_TABLE, LogError)
    path = Path(path)
    encoding, num_lines = _survey(path)
    size = round(path.stat().st_size / 1e6, 1)
    with (
        path.open("rb") as raw,
        io.TextIOWrapper(raw, encoding, errors="cp1252") as file,
        Progress(f"reading {path.name}", size, "MB") as progress,
    ):
        # Find the form of the lines in the middle of the first block, and read the head.
        lines = file.readlines(BLOCK_CHARACTERS)
        full_lines = [line for line in lines if line.strip() and len(line) < MAX_LINE_LENGTH]
        middle = max(0, (len(full_lines) - SAMPLE_ROWS) // 2)
        sample = full_lines[middle : middle + SAMPLE_ROWS] or [""]
        forms = [_Form(sample, delimiter) for delimiter in DELIMITERS]
        form = max(forms, key=lambda form: form.score)
        if not form.score or not form.read_head(lines):
            raise LogError(
                f"{path} has no rows of numbers; save the log as CSV, a row for each time."
            )
        lines = lines[len(form.head) :]
        names = form.names(form.cells(lines[0]))
        if len(names) != form.width:
            raise LogError(
                f"{path} has {len(names)} names in line {form.names_line}, but {form.width} cells "
                "in the rows below; give each column a name, or none in the line."
            )
        # Read the numbers.
        values = np.empty((form.width, num_lines))
        count = 0
        odd_rows = 0
        while lines:
            block, num_odd = form.numbers(lines)
            values[:, count : count + block.shape[1]] = block
            count += block.shape[1]
            odd_rows += num_odd
            progress.update(raw.tell() / 1e6)
            lines = file.readlines(BLOCK_CHARACTERS)
    if count < MIN_ROWS:
        raise LogError(f"{path} has only {count} rows of numbers.")
    names = unique_names(names)
    times_of_day = frozenset(itertools.compress(names, form.is_time))
    has_names = bool(form.names_line or form.labels)
    values = values[:, :count]
    return LogTable(names, form.units(), values, times_of_day, has_names, odd_rows)


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
    """Return the time since midnight in a cell, s; nan if it has none.

    The midnight is of UTC if the cell has a time zone, as files that are joined may differ in it.
    The date says nothing more: no recording goes on over a gap of hours.
    """
    match = _TIME.fullmatch(text.strip().replace(",", "."))
    if not match:
        return math.nan
    part = match.groupdict()
    hours = int(part["hours"])
    if part["half"]:
        hours = hours % 12 + 12 * (part["half"][0] in "Pp")
    minutes = int(part["minutes"])
    if part["sign"]:
        hours -= int(part["sign"] + part["zone_hours"])
        minutes -= int(part["sign"] + part["zone_minutes"])
    seconds = float(f"{part['seconds']}.{part['fraction'] or 0}")
    return 3600.0 * hours + 60.0 * minutes + seconds


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


def split_cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; delimiters within quotes are text."""
    mark = DELIMITERS[delimiter]
    cells = line.split(mark)
    # A quote that is never closed is a character of its cell.
    if mark and '"' in line and line.count('"') % 2 == 0:
        cells = next(csv.reader([line], delimiter=mark))
    return list(map(str.strip, cells))


def unique_names(names: Iterable[str]) -> list[str]:
    """Return a name for each column, none twice; ``column_3`` for the third if it has none."""
    counts: Counter[str] = Counter()
    names_so_far = []
    for column_number, name_or_empty in enumerate(names, 1):
        name = name_or_empty or f"column_{column_number}"
        counts[name] += 1
        names_so_far.append(name if counts[name] == 1 else f"{name}_{counts[name]}")
    return names_so_far


def _survey(path: Path) -> tuple[str, int]:
    """Return the encoding of a log, and the most lines that it can have."""
    encoding = "utf-8-sig"
    with path.open("rb") as file:
        # Recognize files of soft-limb, and encodings, by their first bytes.
        start = file.read(4096)
        if header := re.match(rb"(?:\xef\xbb\xbf)?# limb (\w+), format ", start):
            kind = header[1].decode()
            raise LogError(f"{path} is no log, but a {kind} of soft-limb, which is read as it is.")
        # Half of the bytes of text in UTF-16 are zero, always the same half.
        zeros = [start[::2].count(0), start[1::2].count(0)]
        if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
            encoding = "utf-16"
        elif min(zeros) == 0 and max(zeros) > 0.4 * len(start):
            encoding = "utf-16-le" if zeros[1] else "utf-16-be"
        elif any(zeros):
            raise LogError(f"{path} is not text; save the log as CSV.")
        file.seek(0)
        num_lines = 1
        while piece := file.read(2**20):
            num_lines += max(piece.count(b"\n"), piece.count(b"\r"))
    return encoding, num_lines
