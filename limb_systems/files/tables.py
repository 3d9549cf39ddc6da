"""The file format that recordings and trajectories share.

A file is a CSV table between a header and an end line, comments that start
with ``#``:

    # limb recording, format 3
    # sample_rate_hz: 20.0
    # ... more YAML, in comments ...
    time_s,duty_left,duty_right,...
    0.0,0.0,0.25,...
    # end, 1 rows, sha256 1b4f0e98...

A table that is not all that it should be has a line before its end line that
starts with ``# interrupted:`` and says why. With the end line, truncation at any
byte is noticed, and with its digest any other change. Numbers have the fewest
digits that read back as the same doubles; angles are in degrees in the file and
in radians in memory.
"""

import decimal
import hashlib
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.input import LARGEST_TABLE, read_bytes
from limb_systems.output import write_atomically

FORMAT_VERSION = 3
READABLE = (1, 2, FORMAT_VERSION)  # format 1 had fewer columns, and 2 no provenance
KILLED = "the program that recorded it was killed"
_INTERRUPTED = "# interrupted: "
_DECIMAL = decimal.Context(prec=40)
_RADIAN = _DECIMAL.divide(
    decimal.Decimal(180), decimal.Decimal("3.141592653589793238462643383279502884197169")
)


class FileFormatError(LimbError):
    """A recording or trajectory file is damaged, of another kind or of another version."""


class Table(NamedTuple):
    """What is in a table's file.

    - ``header``: YAML text.
    - ``columns``: values (K,) by name, angles in rad.
    - ``interrupted``: why the table is not all that it should be; empty if it is.
    """

    header: str
    columns: dict[str, np.ndarray]
    interrupted: str


def write_table(
    path: str | Path,
    kind: str,
    header: str,
    columns: Mapping[str, np.ndarray],
    interrupted: str = "",
) -> None:
    """Writes a table whole or not at all; see `format_table`."""
    write_atomically(path, format_table(kind, header, columns, interrupted))


def format_table(
    kind: str, header: str, columns: Mapping[str, np.ndarray], interrupted: str = ""
) -> str:
    """The text of a table's file; see the module's docstring.

    Args:
        kind: "recording" or "trajectory".
        header: YAML text that describes the table.
        columns: name to values (K,). Names ending in ``_deg`` or ``_deg_s``
            are converted from rad or rad/s.
        interrupted: why the table is not all that it should be; empty if it is.

    Raises:
        FileFormatError: if a value is not finite, time is not increasing or
            the file would be larger than is read.
    """
    _check_values(columns, [f"sample {index}" for index in range(len(columns["time_s"]))])
    rows = list(format_rows(columns))
    body = f"{format_head(kind, header, columns)}{''.join(rows)}"
    if len(body) > LARGEST_TABLE:
        raise FileFormatError(
            f"This {kind} needs {len(body) / 1e6:.0f} MB, but at most {LARGEST_TABLE / 1e6:g} MB "
            "are read again; save a part of it, or fewer samples per second."
        )
    end = end_of_table(hashlib.sha256(body.encode()), len(rows), interrupted)
    return "".join([body, *end])


def format_head(kind: str, header: str, names: Iterable[str]) -> str:
    """All lines of a table before its rows."""
    lines = [f"# limb {kind}, format {FORMAT_VERSION}"]
    lines += [f"# {line}" for line in header.splitlines()]
    return "\n".join([*lines, ",".join(names)]) + "\n"


def format_rows(columns: Mapping[str, np.ndarray]) -> Iterator[str]:
    """The rows of a table, each with its line's end."""
    texts = [
        map(_format_degrees if _is_angle(name) else repr, values.tolist())
        for name, values in columns.items()
    ]
    return (",".join(row) + "\n" for row in zip(*texts, strict=True))


def values_in_files(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The numbers in a table's rows as other programs read them: angles in degrees."""
    return {
        name: np.array([float(_format_degrees(value)) for value in values.tolist()])
        if _is_angle(name)
        else values
        for name, values in columns.items()
    }


def end_of_table(digest: Any, num_rows: int, interrupted: str) -> list[str]:
    """The lines after the rows of a table.

    Args:
        digest: hash object of all that is before; what is added here is added to it.
        num_rows: how many rows there are.
        interrupted: as for `write_table`.
    """
    lines = []
    if interrupted:
        # One line, of which no character moves a cursor or starts another line.
        printed = "".join(c if c.isprintable() else "?" for c in " ".join(interrupted.split()))
        lines.append(f"{_INTERRUPTED}{printed}\n")
        digest.update(lines[0].encode())
    return [*lines, f"# end, {num_rows} rows, sha256 {digest.hexdigest()}\n"]


def read_table(path: str | Path, kind: str, *, unfinished: bool = False) -> Table:
    """Reads what `write_table` or a `TableWriter` wrote.

    Args:
        unfinished: whether the end line may be missing, because the program
            that wrote the table died; an incomplete last line is then left
            out, and the table is an interrupted one.

    Raises:
        FileFormatError: one sentence that says what is wrong and where.
    """
    data = read_bytes(path, kind, LARGEST_TABLE, FileFormatError)
    try:
        if unfinished and not re.search(rb"\n# end, .*\n$", data):
            data = _finish(data)
        return parse_table(data, kind)
    except FileFormatError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _finish(data: bytes) -> bytes:
    """Adds the end to a table that lacks it."""
    body = data[: data.rfind(b"\n") + 1]
    lines = body.splitlines()
    said = bool(lines) and lines[-1].startswith(_INTERRUPTED.encode())
    rows = [line for line in lines[1:] if not line.startswith(b"# ")][1:]
    end = end_of_table(hashlib.sha256(body), len(rows), "" if said else KILLED)
    return body + "".join(end).encode()


def parse_table(data: bytes, kind: str) -> Table:
    """What is in a text of `format_table`; errors as for `read_table`."""
    try:
        lines = data.decode("utf-8").split("\n")
    except UnicodeDecodeError as error:
        raise FileFormatError(f"byte {error.start} is not text; the file is damaged.") from error
    first = re.fullmatch(r"# limb (\w+), format (\d{1,9})", lines[0])
    if not first or first[1] != kind:
        raise FileFormatError(
            f"this is not a limb {kind}: its first line is not "
            f"'# limb {kind}, format {FORMAT_VERSION}'."
        )
    if int(first[2]) not in READABLE:
        raise FileFormatError(
            f"this {kind} has format {first[2]}, but this program reads format "
            f"{', '.join(map(str, READABLE[:-1]))} and {READABLE[-1]}."
        )
    last = lines[-2] if len(lines) > 2 else ""
    end = re.fullmatch(r"# end, (\d{1,15}) rows, sha256 ([0-9a-f]{64})", last)
    if not end or lines[-1]:
        raise FileFormatError(
            f"the end line is missing after line {len(lines)}; the file is truncated."
        )
    header_size = next(i for i, line in enumerate(lines[1:], 1) if not line.startswith("# "))
    if header_size >= len(lines) - 2:
        raise FileFormatError("there is no line of column names; the file is damaged.")
    interrupted = lines[-3].startswith(_INTERRUPTED)
    columns = _parse_rows(lines[header_size : -3 if interrupted else -2], header_size + 1)
    num_rows = len(next(iter(columns.values())))
    if num_rows != int(end[1]):
        raise FileFormatError(f"there are {num_rows} rows, but the end line counts {end[1]}.")
    body = data[: data.rindex(b"# end")]
    if hashlib.sha256(body).hexdigest() != end[2]:
        raise FileFormatError(
            "the content does not match the checksum in the end line; "
            "the file was changed or damaged after it was written."
        )
    # An empty line for the first one, so that errors count lines as the file does.
    header = "\n".join(["", *(line.removeprefix("# ") for line in lines[1:header_size])])
    return Table(header, columns, lines[-3].removeprefix(_INTERRUPTED) if interrupted else "")


def _parse_rows(lines: list[str], first_line: int) -> dict[str, np.ndarray]:
    """Parses the line of names and the rows below it; errors name the line."""
    names = lines[0].split(",")
    if len(set(names)) != len(names) or "time_s" not in names:
        raise FileFormatError(f"line {first_line} is not a list of column names with time_s.")
    parsers = [_parse_degrees if _is_angle(name) else float for name in names]
    rows = []
    for number, line in enumerate(lines[1:], first_line + 1):
        cells = line.split(",")
        if len(cells) != len(names):
            raise FileFormatError(
                f"line {number} has {len(cells)} values, but there are {len(names)} columns."
            )
        try:
            rows.append([parse(cell) for parse, cell in zip(parsers, cells, strict=True)])
        except (ValueError, ArithmeticError) as error:
            raise FileFormatError(f"line {number} contains a cell that is not a number.") from error
    table = np.array(rows, float).reshape(len(rows), len(names)).T
    columns = dict(zip(names, np.ascontiguousarray(table), strict=True))
    _check_values(columns, [f"line {first_line + 1 + index}" for index in range(len(rows))])
    return columns


def _check_values(columns: Mapping[str, np.ndarray], where: list[str]) -> None:
    for name, values in columns.items():
        if not np.isfinite(values).all():
            index = int(np.argmin(np.isfinite(values)))
            raise FileFormatError(f"{name} is {values[index]} at {where[index]}.")
    steps = np.diff(columns["time_s"])
    if (steps <= 0).any():
        index = int(np.argmax(steps <= 0))
        before, after = columns["time_s"][index : index + 2]
        raise FileFormatError(
            f"time goes from {before:g} s to {after:g} s at {where[index + 1]}; it must increase."
        )


def _is_angle(name: str) -> bool:
    return name.endswith(("_deg", "_deg_s"))


def _format_degrees(radians: float) -> str:
    """Degrees, in the fewest digits that come back as the same double."""
    if radians == 0:
        return repr(radians)
    fewest = 1
    if 1e-300 < abs(radians) < 1e300:
        # Of the numbers with 15 digits or fewer only this one can be near enough.
        about = math.degrees(radians)
        text = f"{about:.15g}"
        if abs(float(text) - about) <= 4 * math.ulp(about) and _parse_degrees(text) == radians:
            return text
        fewest = 16
    degrees = _DECIMAL.multiply(decimal.Decimal(radians), _RADIAN)
    for digits in itertools.count(fewest):
        text = f"{degrees:.{digits}g}"
        if _parse_degrees(text) == radians:
            return text
        if abs(math.frexp(radians)[0]) == 0.5:
            # Doubles are closer below a power of two than above, where farther away may do.
            text = str(decimal.Context(prec=digits, rounding=decimal.ROUND_UP).plus(degrees))
            if _parse_degrees(text) == radians:
                return text
    raise AssertionError("there are digits without end")


def _parse_degrees(text: str) -> float:
    return float(_DECIMAL.divide(decimal.Decimal(text), _RADIAN))
