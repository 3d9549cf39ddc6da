"""Read a log as a table of numbers, whatever wrote it."""

import codecs
import csv
import dataclasses
import io
import itertools
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calibration.import_logs.cells import is_moment, is_name, is_number, moment, number
from calibration.import_logs.words import is_unit, unit_quantity
from limb_systems.errors import LimbError
from limb_systems.files.input import LARGEST_TABLE, check_file
from limb_systems.progress import Progress

# The names that mappings have for delimiters; "space" is any white space.
DELIMITERS = {",": ",", ";": ";", "tab": "\t", "|": "|", "space": None}
LOOKED_AT = 200  # rows that show the delimiter
FEWEST_ROWS = 10
ROWS_IN_A_ROW = 4  # rows of numbers, one after the other, with which the numbers begin
LONGEST_LINE = 100_000  # characters
LONGEST_HEAD = 10_000  # lines before the first row of numbers
PIECE = 2**18  # bytes that show the form of the lines
BLOCK = 2**21  # characters that are in memory as text
_CLOCK = r"\d\d?:\d\d:\d\d(?:[.,]\d+)?(?:\s*[AaPp][Mm])?"
_DATED = rf"(?:\d{{4}}-\d\d-\d\d[ T]|\d\d?[./]\d\d?[./]\d{{4}} )?{_CLOCK}"
# A terminal's time before a line: "14:02:11.451 -> ", "[14:02:11.451] ", "14:02:11.451 1,2,3".
_STAMP = re.compile(rf"\s*\[?({_DATED})(?:\]\s*|\s*->\s*|\s+(?=[^\s,;|]+\s*[,;|\t]))")
_LABELLED = re.compile(r"\s*\{?\s*\"?([^\W\d][^:=\"]*?)\"?\s*[:=]\s*([^:=]*?)\}?\s*")
_AMOUNT = re.compile(r"[-+.,\d]+(?:[eE][-+]?\d+)?\s*([^\d\s].*)")


class LogError(LimbError):
    """A log cannot be read, or not by its mapping."""


@dataclasses.dataclass(frozen=True, eq=False)
class LogTable:
    """The rows of a log, as numbers.

    - ``names``: names of the N columns; ``column_1`` and so on where the log has none.
    - ``units``: units from a row of units or from the cells; empty texts if there are none.
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
    delimiter: str = ","
    decimal: str = "."
    names_line: int = 1
    odd_rows: int = 0

    @property
    def num_rows(self) -> int:
        """The number K of rows."""
        return len(self.values[0])

    def numbers(self, name: str) -> np.ndarray:
        """Return the numbers of a column (K,); LogError if the log has no such column."""
        if name in self.names:
            return self.values[self.names.index(name)]
        if name.isdigit() and 0 < int(name) <= len(self.names):
            return self.values[int(name) - 1]
        raise LogError(f"no column {name!r}; the columns are {', '.join(self.names)}.")

    def moments(self, name: str) -> np.ndarray:
        """Return the dates or times of day of a column (K,), s; nan where a cell has none."""
        return self.dates.get(name, np.full(self.numbers(name).shape, np.nan))

    def only(self, names: set[str]) -> "LogTable":
        """Return the table with some of its columns; the others then need no memory."""
        kept = [index for index, name in enumerate(self.names) if name in names]
        return dataclasses.replace(
            self,
            names=[self.names[index] for index in kept],
            units=[self.units[index] for index in kept],
            values=[self.values[index] for index in kept],
        )

    def rows(self, which: np.ndarray | slice) -> "LogTable":
        """Return the table with some of its rows, or with its rows in another order."""
        values = [column[which] for column in self.values]
        dates = {name: moments[which] for name, moments in self.dates.items()}
        return dataclasses.replace(self, values=values, dates=dates)


@dataclasses.dataclass(frozen=True)
class _Form:
    """The form of a log's lines.

    - ``delimiter``, ``decimal``: as in `LogTable`.
    - ``width``: number of cells in most rows.
    - ``stamped``: whether a terminal wrote the time before each line.
    - ``labels``: names, if each cell is ``label:value``.
    - ``score``: how well the form fits, 0 to 1.
    """

    delimiter: str
    decimal: str
    width: int = 0
    stamped: bool = False
    labels: tuple[str, ...] = ()
    score: float = 0.0

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line; none if it is of another form."""
        stamp = _STAMP.match(line) if self.stamped else None
        first = [stamp[1]] if stamp else []
        line = line[stamp.end() :] if stamp else line
        if not self.labels:
            return [*first, *split(line, self.delimiter)]
        found = _labelled(line, self.delimiter)
        if tuple(label for label, _ in found) != self.labels:
            return []
        return [*first, *(value for _, value in found)]

    @classmethod
    def of(cls, lines: list[str], delimiter: str, decimal: str) -> "_Form":
        """Return the form of lines with a delimiter; the lines show the decimal mark if empty."""
        full = [line for line in lines if line.strip()]
        start = max(0, (len(full) - LOOKED_AT) // 2)
        full = full[start : start + LOOKED_AT]
        # Terminals write a time before each line; sketches write a label before each number.
        stamps = [_STAMP.match(line) for line in full]
        stamped = sum(map(bool, stamps)) > 0.9 * len(full) > 0
        rests = [
            line[stamp.end() :] if stamp and stamped else line
            for line, stamp in zip(full, stamps, strict=True)
        ]
        found = Counter(tuple(label for label, _ in _labelled(r, delimiter)) for r in rests)
        labels, count = found.most_common(1)[0] if found else ((), 0)
        labels = labels if count > 0.8 * len(full) else ()
        form = cls(delimiter, decimal or ".", 0, stamped, labels)
        # The form fits as well as its rows are numbers of one decimal mark.
        rows = [form.cells(line) for line in full]
        width, count = Counter(map(len, rows)).most_common(1)[0] if rows else (0, 0)
        cells = [cell for row in rows if len(row) == width > 1 for cell in row if cell]
        if not cells:
            return form
        marks = [decimal] if decimal else [".", ","]
        shares = [float(np.mean([_is_written(cell, mark) for cell in cells])) for mark in marks]
        mark = marks[int(np.argmax(shares))]
        score = max(shares) * count / len(rows)
        return dataclasses.replace(form, decimal=mark, width=width, score=score)


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
    size = Path(path).stat().st_size
    encoding = _encoding(Path(path))
    # Find the form of the lines in the middle of the log.
    sample = _sample(Path(path), size, encoding)
    choices = [delimiter] if delimiter else list(DELIMITERS)
    forms = [_Form.of(sample, choice, decimal) for choice in choices]
    form = max(forms, key=lambda one: one.score)
    # Read its head, up to where the numbers begin.
    lines = _lines(Path(path), size, encoding)
    head, rows = _head(lines, form, names_line or 0, path)
    if names_line is None:
        names_line = 0 if form.labels else _names_line(head, form.width)
    names = _names(head, names_line, form, form.cells(rows[0]))
    if len(names) != form.width:
        raise LogError(
            f"{path} has {len(names)} names in line {names_line}, but {form.width} cells in the "
            "rows below; give each column a name, or none in the line."
        )
    units = _units(head, names_line, form, sample)
    names = unique(names)
    # Read the numbers.
    values, dates, odd = _columns(itertools.chain([rows], lines), form, len(names))
    if len(values[0]) < FEWEST_ROWS:
        raise LogError(f"{path} has only {len(values[0])} rows of numbers.")
    named_dates = {names[index]: moments for index, moments in dates.items()}
    return LogTable(
        names, units, values, named_dates, form.delimiter, form.decimal, names_line, odd
    )


def split(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; delimiters within quotes are text."""
    if not (character := DELIMITERS[delimiter]):
        return line.split()
    # A quote that is never closed is a character of its cell.
    quoted = line.count('"') % 2 == 0
    cells = next(csv.reader([line], delimiter=character), []) if quoted else line.split(character)
    return [cell.strip() for cell in cells]


def unique(names: list[str]) -> list[str]:
    """Return a name for each column, none twice; ``column_3`` for the third if it has none."""
    given = [name or f"column_{number}" for number, name in enumerate(names, 1)]
    seen: Counter[str] = Counter()
    found = []
    for name in given:
        seen[name] += 1
        found.append(name if seen[name] == 1 else f"{name}_{seen[name]}")
    return found


def _labelled(line: str, delimiter: str) -> list[tuple[str, str]]:
    """Return label and value of each cell of a line; nothing if a cell has none."""
    line = re.sub(r"\s*([:=])\s+", r"\1", line)
    cells = [cell for cell in split(line.replace('"', ""), delimiter) if cell]
    matches = [_LABELLED.fullmatch(cell) for cell in cells]
    return [(match[1], match[2]) for match in matches if match] if all(matches) else []


def _is_written(cell: str, mark: str) -> bool:
    """Whether a cell is a moment, or a number with a decimal mark and no other."""
    if is_moment(cell):
        return True
    other = "." if mark == "," else ","
    alone = other not in cell or (mark == "," in cell)
    return alone and is_number(cell, mark)


def _encoding(path: Path) -> str:
    with path.open("rb") as file:
        start = file.read(4096)
        if own := re.match(rb"(?:\xef\xbb\xbf)?# limb (\w+), format ", start):
            raise LogError(
                f"{path} is no log, but a {own[1].decode()} of soft-limb, which is read as it is."
            )
        if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return "utf-16"
        if zeros := start.count(b"\0"):
            # Half of the bytes of text in UTF-16 are zero, always the same half.
            for encoding, first in (("utf-16-le", 1), ("utf-16-be", 0)):
                if start[first::2].count(b"\0") == zeros > 0.4 * len(start):
                    return encoding
            raise LogError(f"{path} is not text; save the log as CSV.")
        decoder = codecs.getincrementaldecoder("utf-8")()
        try:
            decoder.decode(start)
            while piece := file.read(2**20):
                decoder.decode(piece)
        except UnicodeDecodeError:
            return "cp1252"
    return "utf-8-sig"


def _sample(path: Path, size: int, encoding: str) -> list[str]:
    """Return lines from the middle of a log, without those that are too long for a log."""
    with path.open("rb") as file:
        if size <= PIECE:
            lines = file.read().decode(encoding, errors="replace").splitlines()
        else:
            order = file.read(2)
            file.seek((size - PIECE) // 4 * 2)  # a character of UTF-16 begins at even bytes
            if encoding == "utf-16":
                encoding += "-be" if order == b"\xfe\xff" else "-le"
            piece = file.read(PIECE).decode(encoding, errors="replace")
            lines = piece.splitlines()[1:-1]
    return [line for line in lines if len(line) < LONGEST_LINE]


def _lines(path: Path, size: int, encoding: str) -> Iterator[list[str]]:
    """Yield the lines of a log in blocks, without their ends."""
    count = 0
    rest = ""
    with (
        path.open("rb") as file,
        io.TextIOWrapper(file, encoding, errors="replace") as text,
        Progress(f"reading {path.name}", round(size / 1e6, 1), "MB") as progress,
    ):
        while piece := text.read(BLOCK):
            lines = (rest + piece).split("\n")
            longest = int(np.argmax(list(map(len, lines))))
            if len(lines[longest]) >= LONGEST_LINE:
                place = f"{LONGEST_LINE} characters in line {count + longest + 1}"
                raise LogError(
                    f"{path} has more than {place}; a row of a log is shorter: save the log with "
                    "a line for each row."
                )
            rest = lines.pop()
            count += len(lines)
            progress.update(file.tell() / 1e6)
            yield lines
        yield [rest] if rest else []


def _head(
    blocks: Iterator[list[str]], form: _Form, names_line: int, path: str | Path
) -> tuple[list[list[str]], list[str]]:
    """Return the rows before the numbers, as cells, and the rest of the block they end in."""
    head: list[list[str]] = []
    no_rows = LogError(f"{path} has no rows of numbers between delimiters; is it a log?")
    for block in blocks if form.width > 1 else ():
        in_a_row = 0
        for index, line in enumerate(block):
            row = form.cells(line)
            fits = len(row) == form.width and len(head) >= names_line
            in_a_row = in_a_row + 1 if fits and _is_of_numbers(row, form.decimal) else 0
            head.append(row)
            if in_a_row == ROWS_IN_A_ROW:
                start = index + 1 - ROWS_IN_A_ROW
                return head[:-ROWS_IN_A_ROW], block[start:]
            if len(head) > LONGEST_HEAD:
                raise no_rows
        if in_a_row:  # the log ends
            return head[:-in_a_row], block[-in_a_row:]
    raise no_rows


def _is_of_numbers(row: list[str], decimal: str) -> bool:
    full = [cell for cell in row if cell]
    known = sum(is_number(cell, decimal) or is_moment(cell) for cell in full)
    return known >= max(2, 0.3 * len(full))


def _names_line(head: list[list[str]], width: int) -> int:
    """Return the number of the last line that has names for all cells; 0 if there is none."""
    for widths in ((width,), (width - 1, width + 1)):  # it may lack a cell, or begin with "#"
        for line in range(len(head), 0, -1):
            row = head[line - 1]
            full = [cell for cell in row if cell]
            known = sum(map(is_unit, row))
            below = line > 1 and len(head[line - 2]) == len(row)  # of names, maybe
            is_of_units = known == len(row) or (known >= 0.5 * len(row) and below)
            if len(row) in widths and not is_of_units and sum(map(is_name, full)) > 0.5 * len(full):
                return line
    return 0


def _names(head: list[list[str]], names_line: int, form: _Form, row: list[str]) -> list[str]:
    """Return the names of the columns, as many as the head has."""
    if form.labels:
        return ["time"] * form.stamped + list(form.labels)
    if not names_line:
        return ["time"] * form.stamped + [""] * (form.width - form.stamped)
    names = _as_many_as(head[names_line - 1], form, row)
    if form.stamped and is_moment(names[0]):
        names[0] = "time"
    # Names that are there twice, such as X and Y of points, begin with what a row above says.
    repeated = {name for name, count in Counter(names).items() if count > 1 and name}
    above = [own for own in head[: names_line - 1] if len(own) == len(names)]
    above.sort(key=lambda own: not {"name", "bodyparts"} & {cell.lower() for cell in own[:2]})
    for own in above if repeated else ():
        pairs = zip(own, names, strict=True)
        joined = [f"{cell} {name}" if name in repeated else name for cell, name in pairs]
        if len(set(joined) - {""}) == len(joined) - joined.count(""):
            return joined
    return names


def _as_many_as(names: list[str], form: _Form, row: list[str]) -> list[str]:
    """Return the names in a line, one for each cell of a row below it, if that can be told."""
    names = [name.lstrip("#% ").strip("\"'") for name in names]
    if len(names) > len(row):
        return [name for name in names if name]  # the line began with a "#" of its own
    if len(names) == len(row) - 1:
        if not row[-1]:
            return [*names, ""]  # rows end with a delimiter
        is_plain_number = re.fullmatch(r"[-+]?\d*[.,]?\d+", row[0])
        if form.delimiter == "space" or form.stamped or not is_plain_number:
            return ["time" if form.stamped else "", *names]  # a date, or the name of the row
    return names


def _units(head: list[list[str]], names_line: int, form: _Form, sample: list[str]) -> list[str]:
    """Return the units of columns: of a row below the names or above them, or in each cell."""
    found = [""] * form.width
    below = head[names_line:]
    above = head[: max(0, names_line - 1)][::-1]
    for row in [*below, *above]:
        if len(row) == form.width and sum(bool(unit_quantity(cell)) for cell in row) >= 2:
            found = [cell if unit_quantity(cell) else "" for cell in row]
            break
    for row in map(form.cells, sample[:LOOKED_AT]):
        for index, cell in enumerate(row if len(row) == form.width else []):
            amount = _AMOUNT.fullmatch(cell)
            if not found[index] and amount and unit_quantity(amount[1]):
                found[index] = amount[1]
    return found


def _columns(
    blocks: Iterator[list[str]], form: _Form, width: int
) -> tuple[list[np.ndarray], dict[int, np.ndarray], int]:
    """Return the numbers and the moments of columns, and how many rows are odd."""
    numbers: list[list[np.ndarray]] = [[] for _ in range(width)]
    moments: list[dict[int, np.ndarray]] = [{} for _ in range(width)]  # by block
    odd = 0
    for block, lines in enumerate(blocks):
        if (fast := _fast_numbers(lines, form, width)) is not None:
            for of_numbers, values in zip(numbers, fast.T, strict=True):
                of_numbers.append(values.copy())
            continue
        rows = [form.cells(line) for line in lines]
        full = [row for row in rows if len(row) == width and any(row)]
        odd += sum(any(row) for row in rows) - len(full)
        columns = zip(*full, strict=True) if full else [()] * width
        for cells, of_numbers, of_moments in zip(columns, numbers, moments, strict=True):
            values = _numbers(cells, form.decimal)
            of_numbers.append(values)
            if of_moments or np.isnan(values).all():
                found = np.array([moment(cell) for cell in cells])
                if of_moments or not np.isnan(found).all():
                    of_moments[block] = found
    values, dates = [], {}
    for index, (of_numbers, of_moments) in enumerate(zip(numbers, moments, strict=True)):
        if of_moments:
            parts = [of_moments.get(i, np.full(len(p), np.nan)) for i, p in enumerate(of_numbers)]
            dates[index] = np.concatenate(parts)
        values.append(np.concatenate(of_numbers))
        of_numbers.clear()
    return values, dates, odd


def _fast_numbers(lines: list[str], form: _Form, width: int) -> np.ndarray | None:
    """Return the numbers (rows, width) of lines of numbers and nothing else; None for others."""
    if form.stamped or form.labels or form.decimal != "." or not any(lines):
        return None
    try:
        found = np.loadtxt(
            lines, float, comments=None, delimiter=DELIMITERS[form.delimiter], ndmin=2
        )
    except ValueError:
        return None
    return np.where(np.isfinite(found), found, np.nan) if found.shape[1] == width else None


def _numbers(cells: tuple[str, ...], decimal: str) -> np.ndarray:
    """Return the numbers in a column's cells (K,)."""
    known: dict[str, float] = {}
    for cell in cells:
        if cell not in known:
            known[cell] = number(cell, decimal)
    return np.fromiter(map(known.__getitem__, cells), float, len(cells))
