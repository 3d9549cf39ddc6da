"""Read a log as a table of numbers, whatever wrote it."""

import codecs
import csv
import dataclasses
import io
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from calibration.import_logs.cells import AMOUNT, is_moment, is_name, is_number, moment, number
from calibration.import_logs.words import parse_unit
from limb_systems.errors import LimbError
from limb_systems.files.input import LARGEST_TABLE, check_file
from limb_systems.progress import Progress

# The names that mappings have for delimiters; "space" is any white space.
DELIMITERS = {",": ",", ";": ";", "tab": "\t", "|": "|", "space": None}
SAMPLE_ROWS = 200  # which show the form of the lines
MIN_ROWS = 10
MIN_FIRST_ROWS = 4  # rows of numbers, one after the other, with which the numbers begin
MAX_HEAD_LINES = 10_000  # lines before the first row of numbers
MAX_LINE_LENGTH = 100_000  # characters
BLOCK_CHARACTERS = 2**21  # characters that are in memory as text
_CLOCK = r"\d\d?:\d\d:\d\d(?:[.,]\d+)?(?:\s*[AaPp][Mm])?"
_DATED = rf"(?:\d{{4}}-\d\d-\d\d[ T]|\d\d?[./]\d\d?[./]\d{{4}} )?{_CLOCK}"
# A terminal's time before a line: "14:02:11.451 -> ", "[14:02:11.451] ", "14:02:11.451 1,2,3".
_STAMP = re.compile(rf"\s*\[?({_DATED})(?:\]\s*|\s*->\s*|\s+(?=[^\s,;|]+\s*[,;|\t]))")
_LABELLED = re.compile(r"\s*\{?\s*\"?([^\W\d][^:=\"]*?)\"?\s*[:=]\s*([^:=]*?)\}?\s*")


class LogError(LimbError):
    """A log cannot be read, or not by its mapping."""


@dataclasses.dataclass(frozen=True, eq=False)
class LogTable:
    """The rows of a log, as numbers.

    - ``names``: names of the N columns; ``column_1`` and so on where the log has none.
    - ``units``: units from a row of units or from the cells; empty texts if there are none.
    - ``values``: the number in each cell (N, K); nan where a cell has none.
    - ``dates``: names of columns whose numbers are moments, s, of dates or times of day.
    - ``delimiter``: what is between cells, one of `DELIMITERS`.
    - ``decimal``: decimal mark of numbers.
    - ``names_line``: number of the line of names, from 1; 0 if there is none.
    - ``has_names``: whether columns have names, in a line or in each cell.
    - ``odd_rows``: number of rows with another number of cells, which were left out.
    """

    names: list[str]
    units: list[str]
    values: np.ndarray
    dates: frozenset[str]
    delimiter: str = ","
    decimal: str = "."
    names_line: int = 1
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
        kept = [index for index, name in enumerate(self.names) if name in names]
        if len(kept) == len(self.names) or not names <= {*self.names}:  # some are given by number
            return self
        own_names = [self.names[index] for index in kept]
        own_units = [self.units[index] for index in kept]
        return dataclasses.replace(self, names=own_names, units=own_units, values=self.values[kept])

    def rows(self, which: np.ndarray | slice) -> "LogTable":
        """Return the table with some of its rows, or with its rows in another order."""
        return dataclasses.replace(self, values=self.values[:, which])


@dataclasses.dataclass(frozen=True)
class _Form:
    """The form of a log's lines.

    - ``delimiter``, ``decimal``: as in `LogTable`.
    - ``stamped``: whether a terminal wrote the time before each line.
    - ``labels``: names, if each cell is ``label:value``.
    - ``rows``: cells of lines in the middle, of which most have ``width`` cells.
    - ``score``: how well the form fits, 0 to 1.
    """

    delimiter: str
    decimal: str
    stamped: bool = False
    labels: tuple[str, ...] = ()
    rows: tuple[list[str], ...] = ()
    width: int = 0
    score: float = 0.0

    @classmethod
    def of(cls, lines: list[str], delimiter: str, decimal: str) -> "_Form":
        """Return the form of lines with a delimiter; the lines show the decimal mark if empty."""
        # Terminals write a time before each line; sketches write a label before each number.
        stamped = sum(bool(_STAMP.match(line)) for line in lines) > 0.9 * len(lines)
        form = cls(delimiter, decimal or ".", stamped)
        found = Counter(tuple(label for label, _ in form.labelled(line)) for line in lines)
        labels, count = found.most_common(1)[0]
        form = dataclasses.replace(form, labels=labels if count > 0.8 * len(lines) else ())
        # The form fits as well as its rows are numbers of one decimal mark.
        rows = [form.cells(line) for line in lines]
        width, count = Counter(map(len, rows)).most_common(1)[0]
        rows = [row for row in rows if len(row) == width]
        cells = [cell for row in rows for cell in row if cell]
        if width < 2 or not cells:
            return form
        scores = {}
        for mark in [decimal] if decimal else [".", ","]:
            share = sum(_is_written(cell, mark) for cell in cells) / len(cells)
            scores[mark] = share * count / len(lines)
        mark = max(scores, key=lambda mark: scores[mark])
        return dataclasses.replace(
            form, decimal=mark, rows=tuple(rows), width=width, score=scores[mark]
        )

    def without_stamp(self, line: str) -> tuple[list[str], str]:
        """Return the time that a terminal wrote before a line, if any, and the line."""
        stamp = _STAMP.match(line) if self.stamped else None
        return ([stamp[1]], line[stamp.end() :]) if stamp else ([], line)

    def labelled(self, line: str) -> list[tuple[str, str]]:
        """Return label and value of each cell of a line; nothing if a cell has none."""
        line = re.sub(r"\s*([:=])\s+", r"\1", self.without_stamp(line)[1])
        cells = [cell for cell in split_cells(line.replace('"', ""), self.delimiter) if cell]
        matches = [_LABELLED.fullmatch(cell) for cell in cells]
        return [(match[1], match[2]) for match in matches if match] if all(matches) else []

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line; none if its labels are others."""
        first, rest = self.without_stamp(line)
        if not self.labels:
            return [*first, *split_cells(rest, self.delimiter)]
        labels_and_values = self.labelled(line)
        is_alike = tuple(label for label, _ in labels_and_values) == self.labels
        return [*first, *(value for _, value in labels_and_values)] if is_alike else []

    def numbers(self, lines: list[str], is_date: list[bool]) -> tuple[np.ndarray, int]:
        """Return the numbers in lines (N, K), and how many lines have other numbers of cells."""
        # Read lines of numbers and nothing else at once.
        if not (self.stamped or self.labels or any(is_date)) and self.decimal == ".":
            try:
                parsed = np.loadtxt(
                    lines, comments=None, delimiter=DELIMITERS[self.delimiter], ndmin=2
                )
            except ValueError:
                parsed = np.empty((0, 0))
            if parsed.shape[1] == self.width:
                parsed[~np.isfinite(parsed)] = np.nan
                return parsed.T, 0
        # Read others cell by cell.
        rows = [self.cells(line) for line in lines]
        full = [row for row in rows if len(row) == self.width and any(row)]
        values = np.empty((self.width, len(full)))
        for index, cells in enumerate(zip(*full, strict=True)):
            distinct = set(cells)
            read = {c: moment(c) if is_date[index] else number(c, self.decimal) for c in distinct}
            values[index] = [read[cell] for cell in cells]
        return values, sum(map(any, rows)) - len(full)


def read_table(
    path: str | Path, delimiter: str = "", decimal: str = "", names_line: int | None = None
) -> LogTable:
    """Read a log whatever wrote it, and show the progress on a terminal.

    Args:
        delimiter, decimal, names_line: as in `LogTable`; the log itself shows them if left out.

    Raises:
        LogError: with one sentence, if it is no table of text with rows of numbers.
    """
    check_file(path, "log", LARGEST_TABLE, LogError)
    encoding, num_lines = _survey_encoding(Path(path))
    blocks = _line_blocks(Path(path), encoding)
    # Find the form of the lines in the middle of the first block.
    first = next(blocks, [])
    full_lines = [line for line in first if line.strip() and len(line) < MAX_LINE_LENGTH]
    middle = max(0, (len(full_lines) - SAMPLE_ROWS) // 2)
    sample = full_lines[middle : middle + SAMPLE_ROWS]
    choices = [delimiter] if delimiter else list(DELIMITERS)
    forms = [_Form.of(sample, choice, decimal) for choice in choices] if sample else []
    form = max(forms, key=lambda form: form.score, default=_Form("", ""))
    if form.width < 2:
        raise LogError(f"{path} has no rows of numbers between delimiters; is it a log?")
    # Read its head, up to where the numbers begin.
    head = _head(first, form, names_line or 0, path)
    if names_line is None:
        names_line = 0 if form.labels else _names_line(head, form.width)
    names = _names(head, names_line, form, form.cells(first[len(head)]))
    if len(names) != form.width:
        raise LogError(
            f"{path} has {len(names)} names in line {names_line}, but {form.width} cells in the "
            "rows below; give each column a name, or none in the line."
        )
    names = unique_names(names)
    units = _units(head, names_line, form)
    # Read the numbers.
    columns = list(zip(*form.rows, strict=True))
    is_date = [_is_of_moments(cells, form.decimal) for cells in columns]
    values = np.empty((form.width, num_lines))
    count = 0
    odd_rows = 0
    for lines in itertools.chain([first[len(head) :]], blocks):
        block_values, odd = form.numbers(lines, is_date)
        values[:, count : count + block_values.shape[1]] = block_values
        count += block_values.shape[1]
        odd_rows += odd
    if count < MIN_ROWS:
        raise LogError(f"{path} has only {count} rows of numbers.")
    dates = frozenset(itertools.compress(names, is_date))
    has_names = bool(names_line or form.labels)
    return LogTable(
        names, units, values[:, :count], dates, form.delimiter, form.decimal, names_line, has_names,
        odd_rows,
    )  # fmt: skip


def split_cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; delimiters within quotes are text."""
    character = DELIMITERS[delimiter]
    if not character:
        return line.split()
    # A quote that is never closed is a character of its cell.
    is_quoted = '"' in line and line.count('"') % 2 == 0
    cells = next(csv.reader([line], delimiter=character)) if is_quoted else line.split(character)
    return [cell.strip() for cell in cells]


def unique_names(names: Iterable[str]) -> list[str]:
    """Return a name for each column, none twice; ``column_3`` for the third if it has none."""
    counts: Counter[str] = Counter()
    names_so_far = []
    for number_, name_or_empty in enumerate(names, 1):
        name = name_or_empty or f"column_{number_}"
        counts[name] += 1
        names_so_far.append(name if counts[name] == 1 else f"{name}_{counts[name]}")
    return names_so_far


def _is_written(cell: str, mark: str) -> bool:
    """Return whether a cell is a moment, or a number with a decimal mark and no other."""
    has_other = "," in cell if mark == "." else "." in cell and "," not in cell
    return is_moment(cell) or (not has_other and is_number(cell, mark))


def _is_of_moments(cells: tuple[str, ...], decimal: str) -> bool:
    full = [cell for cell in cells if cell]
    of_moments = sum(map(is_moment, full))
    return of_moments > sum(is_number(cell, decimal) for cell in full)


def _survey_encoding(path: Path) -> tuple[str, int]:
    """Return the encoding of a log, and the most lines that it can have."""
    encoding = "utf-8-sig"
    num_lines = 1
    decoder = codecs.getincrementaldecoder("utf-8")()
    with path.open("rb") as file:
        start = file.read(4096)
        if header := re.match(rb"(?:\xef\xbb\xbf)?# limb (\w+), format ", start):
            raise LogError(
                f"{path} is no log, but a {header[1].decode()} of soft-limb, which is read as it "
                "is."
            )
        # Half of the bytes of text in UTF-16 are zero, always the same half.
        zeros = start.count(b"\0")
        if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
            encoding = "utf-16"
        elif zeros and start[1::2].count(b"\0") == zeros > 0.4 * len(start):
            encoding = "utf-16-le"
        elif zeros and start[::2].count(b"\0") == zeros > 0.4 * len(start):
            encoding = "utf-16-be"
        elif zeros:
            raise LogError(f"{path} is not text; save the log as CSV.")
        file.seek(0)
        while piece := file.read(2**20):
            num_lines += max(piece.count(b"\n"), piece.count(b"\r"))
            try:
                decoder.decode(piece if encoding == "utf-8-sig" else b"")
            except UnicodeDecodeError:
                encoding = "cp1252"
    return encoding, num_lines


def _line_blocks(path: Path, encoding: str) -> Iterator[list[str]]:
    """Yield the lines of a log in blocks."""
    size = round(path.stat().st_size / 1e6, 1)
    with (
        path.open("rb") as raw,
        io.TextIOWrapper(raw, encoding, errors="replace") as file,
        Progress(f"reading {path.name}", size, "MB") as progress,
    ):
        while lines := file.readlines(BLOCK_CHARACTERS):
            yield lines
            progress.update(raw.tell() / 1e6)


def _head(lines: list[str], form: _Form, names_line: int, path: str | Path) -> list[list[str]]:
    """Return the rows before the numbers, as cells."""
    head: list[list[str]] = []
    in_a_row = 0
    for line in lines[:MAX_HEAD_LINES]:
        row = form.cells(line)
        full = [cell for cell in row if cell]
        num_numbers = sum(is_number(cell, form.decimal) or is_moment(cell) for cell in full)
        is_of_numbers = len(row) == form.width and num_numbers >= max(2, 0.3 * len(full))
        in_a_row = in_a_row + 1 if is_of_numbers and len(head) >= names_line else 0
        head.append(row)
        if in_a_row == MIN_FIRST_ROWS:
            break
    if not in_a_row:
        raise LogError(f"{path} has no rows of numbers between delimiters; is it a log?")
    return head[:-in_a_row]


def _names_line(head: list[list[str]], width: int) -> int:
    """Return the number of the last line that has names for all cells; 0 if there is none."""
    for widths in ((width,), (width - 1, width + 1)):  # it may lack a cell, or begin with "#"
        for line in range(len(head), 0, -1):
            row = head[line - 1]
            full = [cell for cell in row if cell]
            num_units = sum(
                cell.strip(" []()-1") == "" or bool(parse_unit(cell)[0]) for cell in row
            )
            has_names_above = line > 1 and len(head[line - 2]) == len(row)
            is_of_units = num_units >= (0.5 if has_names_above else 1.0) * len(row)
            num_names = sum(map(is_name, full))
            if len(row) in widths and not is_of_units and num_names > 0.5 * len(full):
                return line
    return 0


def _names(head: list[list[str]], names_line: int, form: _Form, row: list[str]) -> list[str]:
    """Return the names of the columns, as many as the head has."""
    if form.labels:
        return [*["time"] * form.stamped, *form.labels]
    if not names_line:
        return ["time" if form.stamped else "", *[""] * (form.width - 1)]
    names = [name.lstrip("#% ").strip("\"'") for name in head[names_line - 1]]
    # The line may have begun with a "#", rows may end with a delimiter or begin with a date.
    is_plain = bool(re.fullmatch(r"[-+]?\d*[.,]?\d+", row[0]))
    if len(names) > len(row):
        names = [name for name in names if name]
    elif len(names) == len(row) - 1 and not row[-1]:
        names = [*names, ""]
    elif len(names) == len(row) - 1 and (form.delimiter == "space" or form.stamped or not is_plain):
        names = ["time" if form.stamped else "", *names]
    if form.stamped and is_moment(names[0]):
        names[0] = "time"
    # Names that are there twice, such as X and Y of points, begin with what a row above says.
    repeated = {name for name, count in Counter(names).items() if count > 1 and name}
    above = [row_above for row_above in head[: names_line - 1] if len(row_above) == len(names)]
    above.sort(
        key=lambda row_above: not {"name", "bodyparts"} & {cell.lower() for cell in row_above[:2]}
    )
    for row_above in above if repeated else ():
        pairs = zip(row_above, names, strict=True)
        joined = [f"{x} {name}".strip() if name in {*repeated, ""} else name for x, name in pairs]
        if len(set(joined) - {""}) == len(joined) - joined.count(""):
            return joined
    return names


def _units(head: list[list[str]], names_line: int, form: _Form) -> list[str]:
    """Return the units of columns: of a row below the names or above them, or in each cell."""
    units_by_column = [""] * form.width
    for row in [*head[names_line:], *head[: max(0, names_line - 1)][::-1]]:
        num_units = sum(bool(parse_unit(cell)[0]) for cell in row)
        if len(row) == form.width and num_units >= max(2, 0.5 * sum(map(bool, row))):
            units_by_column = [cell if parse_unit(cell)[0] else "" for cell in row]
            break
    for index, cells in enumerate(zip(*form.rows, strict=True)):
        amounts = [AMOUNT.fullmatch(cell) for cell in cells]
        units = [match[2] for match in amounts if match and parse_unit(match[2])[0]]
        if units and not units_by_column[index]:
            units_by_column[index] = units[0]
    return units_by_column
