"""The CSV format that recordings and trajectories share.

A file is a table between a header and an end line, comments that start with ``#``:

    # limb recording, format 3
    # sample_rate_hz: 20.0
    # ... more YAML, in comments ...
    time_s,duty_left,duty_right,...
    0.0,0.0,0.25,...
    # end, 1 rows, sha256 1b4f0e98...

A table that ended before its time has a line ``# interrupted: why`` before its end line.
The end line shows truncation at any byte, and its digest any other change. Angles are in
degrees in the file and in radians in memory. All numbers read back as the same doubles.
A reading of a recording that is missing is an empty cell, or ``nan``.
"""

import decimal
import hashlib
import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.input import LARGEST_TABLE, read_bytes

FORMAT_VERSION = 3
KILLED = "the program that recorded it was killed"
MAKERS = {
    "recording": "collect, replay and teach write recordings, and Recording.save, of other data",
    "trajectory": "soft-limb plan makes a trajectory of a reference",
    "gait": "soft-limb gait writes gaits",
    "learning": "soft-limb learn writes what was learned",
}
_INTERRUPTED = "# interrupted: "
_MAY_MISS = {"recording": ("measured_temperature", "bend_angle")}  # columns with readings, by kind
ROWS_AT_ONCE = 20_000  # rows that are texts at a time
_ROW = re.compile(r"[-+0-9.eE,naif]*")  # what `float` takes beyond these are no numbers to others
_DECIMAL = decimal.Context(prec=40)  # degrees as doubles would not tell all radians apart
_DEGREES = _DECIMAL.divide(
    decimal.Decimal(180), decimal.Decimal("3.141592653589793238462643383279502884197169")
)


class FileFormatError(LimbError):
    """A recording or trajectory file is damaged, of another kind or of another version."""


class Table(NamedTuple):
    """What is in a table's file.

    - ``header``: YAML text.
    - ``columns``: values (K,) by name, angles in rad.
    - ``interrupted``: why the table ended before its time; empty if it did not.
    """

    header: str
    columns: dict[str, np.ndarray]
    interrupted: str


def format_table(
    kind: str, header: str, columns: Mapping[str, np.ndarray], interrupted: str = ""
) -> Iterator[str]:
    """The text of a table's file, in parts; see the module's docstring.

    Args:
        kind: "recording" or "trajectory".
        header: YAML text that describes the table.
        columns: name to values (K,). Names ending in ``_deg`` or ``_deg_s``
            are converted from rad or rad/s.
        interrupted: as in `Table`.

    Raises:
        FileFormatError: if a value is not finite, time is not increasing or
            the file would be larger than is read.
    """
    _check_values(kind, columns, lambda index: f"sample {index}")
    num_rows, size, digest = len(columns["time_s"]), 0, hashlib.sha256()
    rows = (
        format_rows(
            {name: values[start : start + ROWS_AT_ONCE] for name, values in columns.items()}
        )
        for start in range(0, num_rows, ROWS_AT_ONCE)
    )
    for part in itertools.chain([format_head(kind, header, columns)], rows):
        size += len(part)
        if size > LARGEST_TABLE:
            raise FileFormatError(
                f"This {kind} of {num_rows} samples needs more than the {LARGEST_TABLE / 1e6:g} MB "
                "that are read again; save a part of it, or fewer samples per second."
            )
        digest.update(part.encode())
        yield part
    yield from end_of_table(digest, num_rows, interrupted)


def format_head(kind: str, header: str, names: Iterable[str]) -> str:
    """All lines of a table before its rows."""
    lines = [f"# limb {kind}, format {FORMAT_VERSION}"]
    lines += [f"# {line}" for line in header.splitlines()]
    return "\n".join([*lines, ",".join(names)]) + "\n"


def format_rows(columns: Mapping[str, np.ndarray]) -> str:
    """The rows of a table."""
    cells = [_format_cells(name, values) for name, values in columns.items()]
    return "".join(",".join(row) + "\n" for row in zip(*cells, strict=True))


def end_of_table(digest: Any, num_rows: int, interrupted: str) -> list[str]:
    """The lines after the rows of a table.

    Args:
        digest: hash object of all that is before; what is added here is added to it.
        num_rows: number of rows.
        interrupted: as in `Table`.
    """
    lines = []
    if interrupted:
        # One line, of which no character moves a cursor or starts another line.
        printed = "".join(c if c.isprintable() else "?" for c in " ".join(interrupted.split()))
        lines.append(f"{_INTERRUPTED}{printed}\n")
        digest.update(lines[0].encode())
    return [*lines, f"# end, {num_rows} rows, sha256 {digest.hexdigest()}\n"]


def read_table(path: str | Path, kind: str, *, unfinished: bool = False) -> Table:
    """Reads what `format_table` or a `TableWriter` made.

    Args:
        unfinished: whether the end line may be missing, because the program
            that wrote the table died; an incomplete last line is then left
            out, and the table is an interrupted one.

    Raises:
        FileFormatError: one sentence that says what is wrong and where.
    """
    data = read_bytes(path, kind, LARGEST_TABLE, FileFormatError)
    try:
        return parse_table(data, kind, unfinished=unfinished)
    except FileFormatError as error:
        raise FileFormatError(f"{path}: {error}") from error


def parse_table(data: bytes, kind: str, *, unfinished: bool = False) -> Table:
    """The table in a text of `format_table`; arguments and errors as for `read_table`."""
    try:
        text = data.decode().replace("\r\n", "\n")  # as some ways of copying text leave it
    except UnicodeDecodeError as error:
        raise FileFormatError(f"byte {error.start} is not text; the file is damaged.") from error
    lines = text.split("\n")
    _check_first_line(lines[0], kind)
    end = re.fullmatch(r"# end, ([0-9]{1,15}) rows, sha256 ([0-9a-f]{64})", lines[-2:][0])
    if lines.pop():  # an incomplete line
        end = None
    if end:
        lines.pop()
    elif not unfinished:
        raise FileFormatError(
            f"the end line is missing after line {len(lines)}; the file is truncated."
        )
    interrupted = "" if end else KILLED
    if lines and lines[-1].startswith(_INTERRUPTED):
        interrupted = lines.pop().removeprefix(_INTERRUPTED)
    head = list(itertools.takewhile(lambda line: line.startswith("# "), lines))
    if len(head) == len(lines):
        raise FileFormatError("there is no line of column names; the file is damaged.")
    columns = _parse_rows(kind, lines[len(head) :], len(head) + 1)
    num_rows = len(columns["time_s"])
    if end and num_rows != int(end[1]):
        raise FileFormatError(f"there are {num_rows} rows, but the end line counts {end[1]}.")
    if end and hashlib.sha256(text[: -len(end[0]) - 1].encode()).hexdigest() != end[2]:
        raise FileFormatError(
            "the content does not match the checksum in the end line; "
            "the file was changed or damaged after it was written."
        )
    # An empty line for the first one, so that errors count lines as the file does.
    header = "\n".join(["", *(line.removeprefix("# ") for line in head[1:])])
    return Table(header, columns, interrupted)


def _check_first_line(line: str, kind: str) -> None:
    first = re.fullmatch(r"# limb (\w+), format ([0-9]{1,9})", line)
    if not first:
        raise FileFormatError(
            f"this is not a limb {kind}: its first line is not "
            f"'# limb {kind}, format {FORMAT_VERSION}'; {MAKERS[kind]}."
        )
    if first[1] != kind:
        raise FileFormatError(f"this is not a limb {kind}, but a {first[1]}; {MAKERS[kind]}.")
    if int(first[2]) != FORMAT_VERSION:
        raise FileFormatError(
            f"this {kind} has format {first[2]}, but this program reads format {FORMAT_VERSION}."
        )


def _parse_rows(kind: str, lines: list[str], first_line: int) -> dict[str, np.ndarray]:
    """Parses the line of names and the rows below it; errors name the line."""
    names = lines[0].split(",")
    if len(set(names)) != len(names) or "time_s" not in names:
        raise FileFormatError(f"line {first_line} is not a list of column names with time_s.")
    parsers = [_radians if _is_angle(name) else float for name in names]
    values = np.empty((len(lines) - 1, len(names)))
    for index, line in enumerate(lines[1:]):
        cells, number = line.split(","), first_line + 1 + index
        if len(cells) != len(names):
            raise FileFormatError(
                f"line {number} has {len(cells)} values, but there are {len(names)} columns."
            )
        try:
            if not _ROW.fullmatch(line):
                raise ValueError
            values[index] = [
                parse(cell or "nan") for parse, cell in zip(parsers, cells, strict=True)
            ]
        except (ValueError, ArithmeticError) as error:
            raise FileFormatError(f"line {number} contains a cell that is not a number.") from error
    columns = dict(zip(names, values.T.copy(), strict=True))
    _check_values(kind, columns, lambda index: f"line {first_line + 1 + index}")
    return columns


def _check_values(
    kind: str, columns: Mapping[str, np.ndarray], where: Callable[[int], str]
) -> None:
    for name, values in columns.items():
        good = np.isfinite(values)
        if name.startswith(_MAY_MISS.get(kind, ())):
            good |= np.isnan(values)
        if not good.all():
            index = int(np.argmin(good))
            raise FileFormatError(f"{name} is {values[index]} at {where(index)}.")
    steps = np.diff(columns["time_s"])
    if (steps <= 0).any():
        index = int(np.argmax(steps <= 0))
        before, after = columns["time_s"][index : index + 2]
        raise FileFormatError(
            f"time goes from {before:g} s to {after:g} s at {where(index + 1)}; it must increase."
        )


def _is_angle(name: str) -> bool:
    return name.endswith(("_deg", "_deg_s"))


def _format_cells(name: str, values: np.ndarray) -> list[str]:
    form = _format_degrees if _is_angle(name) else repr
    return ["" if math.isnan(value) else form(value) for value in values.tolist()]


def _format_degrees(radians: float) -> str:
    """Degrees, in 15 digits if they read back as the same double, else in 17, which do."""
    text = f"{math.degrees(radians):.15g}"
    if _radians(text) == radians:
        return text
    return f"{_DECIMAL.multiply(decimal.Decimal(radians), _DEGREES):.17g}"


def _radians(degrees: str) -> float:
    return float(_DECIMAL.divide(decimal.Decimal(degrees), _DEGREES))
