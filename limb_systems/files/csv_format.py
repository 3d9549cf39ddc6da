"""The CSV format of recordings, trajectories and gaits.

A file is a table between a header and an end line, which are comments that start with ``#``:

    # limb recording, format 3
    # sample_rate_hz: 20.0
    # ... more YAML, in comments ...
    time_s,duty_left,duty_right,...
    0.0,0.0,0.25,...
    # end, 1 rows, sha256 1b4f0e98...

A table that ended before its time has a line ``# interrupted: why`` before its end line.
The end line shows truncation at any byte, and its digest any other change. Angles are in
degrees in the file and in radians in memory. All numbers read back as the same doubles.
An empty cell, or ``nan``, is a value that is missing.
"""

import decimal
import hashlib
import itertools
import math
import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.files.input import LARGEST_TABLE, MOST_COLUMNS, FirstLine, first_line

FORMAT_VERSION = 3
KILLED_REASON = "the program that recorded it was killed"
MAKERS = {
    "recording": "collect, replay and teach write recordings, and Recording.save, of other data",
    "trajectory": "soft-limb plan makes a trajectory of a reference",
    "gait": "soft-limb gait writes gaits",
}
_INTERRUPTED = "# interrupted: "
_ROW = re.compile(r"[-+0-9.eE,naif]*")  # `float` also takes texts that other programs do not
_DECIMAL = decimal.Context(prec=40)  # different radians may be the same degrees as doubles
_DEGREES = _DECIMAL.divide(
    decimal.Decimal(180), decimal.Decimal("3.141592653589793238462643383279502884197169")
)


class FileFormatError(LimbError):
    """A recording or trajectory file is damaged, of another kind or of another version."""


class Table(NamedTuple):
    """The contents of a table's file.

    - ``header``: YAML text.
    - ``columns``: values (K,) by name, angles in rad.
    - ``interrupted``: the reason why the table ended early; empty if it did not.
    """

    header: str
    columns: dict[str, np.ndarray]
    interrupted: str


class TableText:
    """The text of a table's file, in parts that are to be written in order.

    - ``head``: all lines before the rows.
    - ``num_rows``: number of rows so far.
    """

    def __init__(self, kind: str, header: str, names: Iterable[str]):
        """
        Args:
            kind: such as "recording".
            header: YAML text that describes the table.
            names: names of the columns.
        """
        self.num_rows = 0
        self._size = 0
        self._digest = hashlib.sha256()
        lines = [str(FirstLine(kind, FORMAT_VERSION))]
        lines += [f"# {line}" for line in header.splitlines()]
        self.head = self._counted("\n".join([*lines, ",".join(names)]) + "\n")

    def rows(self, columns: Mapping[str, np.ndarray]) -> str:
        """Return the text of further rows, of columns as `format_rows` takes them.

        Raises:
            FileFormatError: if the file would be larger than the limit for reading.
        """
        text = self._counted(format_rows(columns))
        self.num_rows += text.count("\n")
        return text

    def end(self, interrupted: str = "") -> str:
        """Return the lines after the rows.

        Args:
            interrupted: the reason why the table ended early; empty if it did not.
        """
        if interrupted:
            # One line, of which no character moves a cursor or starts another line.
            line = "".join(c if c.isprintable() else "?" for c in " ".join(interrupted.split()))
            interrupted = self._counted(f"{_INTERRUPTED}{line}\n", spare=len(line) + 50)
        digest = self._digest.hexdigest()
        return f"{interrupted}# end, {self.num_rows} rows, sha256 {digest}\n"

    def _counted(self, text: str, spare: int = 0) -> str:
        """Add a text to the size and the checksum, and return it; errors as in `rows`."""
        if self._size + len(text) > LARGEST_TABLE + spare:
            raise FileFormatError(
                f"The table has reached the {LARGEST_TABLE / 1e6:g} MB that are read again; save a "
                "part of it, or fewer samples per second."
            )
        self._size += len(text)
        self._digest.update(text.encode())
        return text


def format_rows(columns: Mapping[str, np.ndarray]) -> str:
    """Return the rows of a table as text.

    Args:
        columns: name to values (K,). Names ending in ``_deg`` or ``_deg_s`` are converted from
            rad or rad/s.
    """
    cells = [_format_cells(name, values) for name, values in columns.items()]
    return "".join(",".join(row) + "\n" for row in zip(*cells, strict=True))


def parse_table(
    data: bytes, kind: str, *, unfinished: bool = False, readings: tuple[str, ...] = ()
) -> Table:
    """Parse the contents of a file into a table.

    Args:
        data: the bytes of the file.
        kind: the kind of the file, such as "recording", which its first line has to name.
        unfinished: whether the end line may be missing, because the program that wrote the table
            died. An incomplete last line is then left out, and the table has `KILLED_REASON` as the
            reason of its interruption.
        readings: prefixes of the names of columns whose values may be missing.

    Raises:
        FileFormatError: if the contents are damaged; its message says what is wrong and where.
    """
    try:
        text = data.decode().replace("\r\n", "\n")  # as some ways of copying text leave it
    except UnicodeDecodeError as error:
        raise FileFormatError(f"byte {error.start} is not text; the file is damaged.") from error
    lines = text.split("\n")
    _check_first_line(lines[0], kind)
    # Take off the end line, and the line with the reason of an interruption.
    # A complete file ends with a line break, after which the last of the lines is empty.
    end = re.fullmatch(r"# end, ([0-9]{1,15}) rows, sha256 ([0-9a-f]{64})", lines[-2:][0])
    last_line = lines.pop()
    if last_line:  # it is incomplete
        end = None
    if end:
        lines.pop()
    elif not unfinished:
        raise FileFormatError(
            f"the end line is missing after line {len(lines)}; the file is truncated."
        )
    interruption_reason = "" if end else KILLED_REASON
    if lines and lines[-1].startswith(_INTERRUPTED):
        interruption_reason = lines.pop().removeprefix(_INTERRUPTED)
    # Parse the rows below the header, which is in comments.
    head = list(itertools.takewhile(lambda line: line.startswith("# "), lines))
    if len(head) == len(lines):
        raise FileFormatError("there is no line of column names; the file is damaged.")
    columns = _parse_rows(lines[len(head) :], len(head) + 1, readings)
    # Compare rows and checksum with the end line.
    num_rows = len(columns["time_s"])
    if end and num_rows != int(end[1]):
        raise FileFormatError(f"there are {num_rows} rows, but the end line counts {end[1]}.")
    if end and hashlib.sha256(text[: -len(end[0]) - 1].encode()).hexdigest() != end[2]:
        raise FileFormatError(
            "the content does not match the checksum in the end line; "
            "the file was changed or damaged after it was written."
        )
    # Start with an empty line, so that errors count lines as the file does.
    header = "\n".join(["", *(line.removeprefix("# ") for line in head[1:])])
    return Table(header, columns, interruption_reason)


def _check_first_line(line: str, kind: str) -> None:
    """Raise FileFormatError unless the first line is of this kind and version."""
    actual = first_line(line)
    expected = FirstLine(kind, FORMAT_VERSION)
    if not actual or str(actual) != line:
        raise FileFormatError(
            f"this is not a limb {kind}: its first line is not '{expected}'; {MAKERS[kind]}."
        )
    if actual.kind != kind:
        raise FileFormatError(f"this is not a limb {kind}, but a {actual.kind}; {MAKERS[kind]}.")
    if actual.format != FORMAT_VERSION:
        raise FileFormatError(
            f"this {kind} has format {actual.format}, but this program reads format "
            f"{FORMAT_VERSION}."
        )


def _parse_rows(
    lines: list[str], first_line: int, readings: tuple[str, ...]
) -> dict[str, np.ndarray]:
    """Parse the line of names and the rows below it; errors name the line."""
    # Parse the names.
    if (num_columns := lines[0].count(",") + 1) > MOST_COLUMNS:
        raise FileFormatError(
            f"line {first_line} names {num_columns} columns; no robot has more than {MOST_COLUMNS}."
        )
    names = lines[0].split(",")
    if len(set(names)) != len(names) or "time_s" not in names:
        raise FileFormatError(f"line {first_line} is not a list of column names with time_s.")
    # Parse the cells; inf stands for a text that is no number.
    parsers = [_radians if _is_angle(name) else float for name in names]
    values = np.empty((len(lines) - 1, len(names)))
    for index, line in enumerate(lines[1:]):
        cells = line.split(",")
        if len(cells) != len(names):
            raise FileFormatError(
                f"line {first_line + 1 + index} has {len(cells)} values, but there are "
                f"{len(names)} columns."
            )
        try:
            if not _ROW.fullmatch(line):
                raise ValueError
            values[index] = [
                parse(cell or "nan") for parse, cell in zip(parsers, cells, strict=True)
            ]
        except (ValueError, ArithmeticError):
            values[index] = np.inf
    # Find cells that are no numbers, or missing where none may be missing.
    is_needed = [not name.startswith(readings) for name in names]
    is_bad = (np.isinf(values) | (np.isnan(values) & is_needed)).any(axis=1)
    if is_bad.any():
        number = first_line + 1 + int(np.argmax(is_bad))
        raise FileFormatError(f"line {number} contains a cell that is not a number.")
    return dict(zip(names, values.T.copy(), strict=True))


def _is_angle(name: str) -> bool:
    """Return whether a column is an angle or a rate of an angle."""
    return name.endswith(("_deg", "_deg_s"))


def _format_cells(name: str, values: np.ndarray) -> list[str]:
    """Return the cells of a column, in degrees for angles; empty for nan."""
    format_number = _format_degrees if _is_angle(name) else repr
    if len(values) == 1:  # as a journal writes them
        number = float(values[0])
        return ["" if math.isnan(number) else format_number(number)]
    # Sensors have few different readings: make each text once. Compare bits, as -0.0 equals 0.0.
    bits, index = np.unique(np.ascontiguousarray(values, float).view(np.int64), return_inverse=True)
    numbers = bits.view(float).tolist()
    texts = ["" if math.isnan(number) else format_number(number) for number in numbers]
    return list(map(texts.__getitem__, index.tolist()))


def _format_degrees(radians: float) -> str:
    """Return degrees in 15 digits if they read back as the same double, else in 17 digits."""
    text = f"{math.degrees(radians):.15g}"
    if _radians(text) == radians:
        return text
    return f"{_DECIMAL.multiply(decimal.Decimal(radians), _DEGREES):.17g}"


def _radians(degrees: str) -> float:
    """Return the radians of a text in degrees, rounded once."""
    return float(_DECIMAL.divide(decimal.Decimal(degrees), _DEGREES))
