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
in radians in memory. A reading that is missing is an empty cell, or ``nan``.
"""

import decimal
import hashlib
import io
import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.input import LARGEST_TABLE, read_bytes
from limb_systems.output import write_atomically

FORMAT_VERSION = 3
READABLE = (1, 2, FORMAT_VERSION)  # format 1 had fewer columns, and 2 no provenance
KILLED = "the program that recorded it was killed"
MAKERS = {
    "recording": "collect, replay and teach write recordings, and Recording.save, of other data",
    "trajectory": "soft-limb plan makes a trajectory of a reference",
}
_INTERRUPTED = "# interrupted: "
_DECIMAL = decimal.Context(prec=40)
_RADIAN = _DECIMAL.divide(
    decimal.Decimal(180), decimal.Decimal("3.141592653589793238462643383279502884197169")
)
_MAY_MISS = ("measured_temperature", "bend_angle")  # beginnings of columns with readings
_CHARACTERS = b"0123456789+-.eE,\nnaif"  # of rows
_EMPTY_CELLS = [(b",,", b",nan,"), (b",,", b",nan,"), (b",\n", b",nan\n")]  # first overlapping
_LONGEST_CELL = 40  # characters of an angle

# Angles are converted many at a time where the machine's longest doubles tell the result.
_CHUNK, _BLOCK = 20_000, 2_000_000  # rows that are written, bytes that are read at once
_LONG = np.longdouble
_TENS = np.cumprod(np.array([1, *[10] * 27], _LONG))  # exact
_LONG_RADIAN = _LONG("0.0174532925199432957692369076848861271344287188854172545609719")
_MARGIN = 8 * np.finfo(_LONG).eps  # relative, of a product and a quotient of these


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
    _check_values(columns, lambda index: f"sample {index}")
    num_rows = len(columns["time_s"])
    body = "".join([format_head(kind, header, columns), *format_rows(columns)])
    if len(body) > LARGEST_TABLE:
        raise FileFormatError(
            f"This {kind} needs {len(body) / 1e6:.0f} MB, but at most {LARGEST_TABLE / 1e6:g} MB "
            "are read again; save a part of it, or fewer samples per second."
        )
    end = end_of_table(hashlib.sha256(body.encode()), num_rows, interrupted)
    return "".join([body, *end])


def format_head(kind: str, header: str, names: Iterable[str]) -> str:
    """All lines of a table before its rows."""
    lines = [f"# limb {kind}, format {FORMAT_VERSION}"]
    lines += [f"# {line}" for line in header.splitlines()]
    return "\n".join([*lines, ",".join(names)]) + "\n"


def format_rows(columns: Mapping[str, np.ndarray]) -> Iterator[str]:
    """The rows of a table, in texts of some rows each."""
    num_rows = len(next(iter(columns.values())))
    for start in range(0, num_rows, _CHUNK):
        texts = []
        for name, values in columns.items():
            part = values[start : start + _CHUNK]
            cells = _format_angles(part) if _is_angle(name) else list(map(repr, part.tolist()))
            for index in np.flatnonzero(np.isnan(part)):
                cells[index] = ""
            texts.append(cells)
        yield "\n".join([*map(",".join, zip(*texts, strict=True)), ""])


def values_in_files(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The numbers in a table's rows as other programs read them: angles in degrees."""
    return {
        name: np.array(_format_angles(values), float) if _is_angle(name) else values
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
    data = data.replace(b"\r\n", b"\n")  # as some ways of copying text leave it
    lines, rows = _split(data)
    first = re.fullmatch(r"# limb (\w+), format ([0-9]{1,9})", lines[0])
    if not first:
        raise FileFormatError(
            f"this is not a limb {kind}: its first line is not "
            f"'# limb {kind}, format {FORMAT_VERSION}'; {MAKERS[kind]}."
        )
    if first[1] != kind:
        raise FileFormatError(f"this is not a limb {kind}, but a {first[1]}; {MAKERS[kind]}.")
    if int(first[2]) not in READABLE:
        raise FileFormatError(
            f"this {kind} has format {first[2]}, but this program reads format "
            f"{', '.join(map(str, READABLE[:-1]))} and {READABLE[-1]}."
        )
    last = rows[rows.rfind(b"\n", 0, -1) + 1 :]
    end = re.fullmatch(rb"# end, ([0-9]{1,15}) rows, sha256 ([0-9a-f]{64})\n", last)
    if not end:
        num_lines = data.count(b"\n") + 1
        raise FileFormatError(
            f"the end line is missing after line {num_lines}; the file is truncated."
        )
    rows, interrupted = rows[: -len(last)], ""
    before = rows[rows.rfind(b"\n", 0, -1) + 1 :]
    if before.startswith(_INTERRUPTED.encode()):
        rows, interrupted = rows[: -len(before)], before[:-1].decode()
    if not rows or rows.startswith(b"# "):
        raise FileFormatError("there is no line of column names; the file is damaged.")
    columns = _parse_rows(rows, len(lines) + 1)
    num_rows = len(next(iter(columns.values())))
    if num_rows != int(end[1]):
        raise FileFormatError(
            f"there are {num_rows} rows, but the end line counts {end[1].decode()}."
        )
    digest = hashlib.sha256(memoryview(data)[: -len(last)])
    if digest.hexdigest() != end[2].decode():
        raise FileFormatError(
            "the content does not match the checksum in the end line; "
            "the file was changed or damaged after it was written."
        )
    # An empty line for the first one, so that errors count lines as the file does.
    header = "\n".join(["", *(line.removeprefix("# ") for line in lines[1:])])
    return Table(header, columns, interrupted.removeprefix(_INTERRUPTED))


def _split(data: bytes) -> tuple[list[str], bytes]:
    """The lines at the beginning that start with "# ", the first in any case, and the rest."""
    size = data.find(b"\n") + 1 or len(data)
    while data.startswith(b"# ", size) and not data.startswith((b"# end, ", b"# inter"), size):
        size = data.find(b"\n", size) + 1 or len(data)
    try:
        return data[:size].decode("utf-8").split("\n")[:-1] or [""], data[size:]
    except UnicodeDecodeError as error:
        raise FileFormatError(f"byte {error.start} is not text; the file is damaged.") from error


def _parse_rows(data: bytes, first_line: int) -> dict[str, np.ndarray]:
    """Parses the line of names and the rows below it; errors name the line."""
    line, _, rows = data.partition(b"\n")
    names = line.decode("utf-8", "replace").split(",")
    if len(set(names)) != len(names) or "time_s" not in names:
        raise FileFormatError(f"line {first_line} is not a list of column names with time_s.")
    blocks, start = [], 0
    while start < len(rows):
        end = rows.find(b"\n", start + _BLOCK) + 1 or len(rows)
        try:
            blocks.append(_parse_block(rows[start:end], names))
        except (ValueError, ArithmeticError) as error:
            before = rows.count(b"\n", 0, start)
            trouble = _trouble(rows[start:end], names, first_line + 1 + before)
            raise FileFormatError(trouble) from error
        start = end
    parts = zip(*blocks, strict=True) if blocks else [[np.empty(0)] for _ in names]
    columns = {name: np.concatenate(part) for name, part in zip(names, parts, strict=True)}
    _check_values(columns, lambda index: f"line {first_line + 1 + index}")
    return columns


def _parse_block(rows: bytes, names: list[str]) -> list[np.ndarray]:
    """The columns of some rows; raises ValueError or ArithmeticError if one is none."""
    if rows.translate(None, _CHARACTERS):
        raise ValueError
    num_rows = rows.count(b"\n")
    if b",," in rows or b",\n" in rows:
        for empty, cell in _EMPTY_CELLS:
            rows = rows.replace(empty, cell)
    kinds = [f"S{_LONGEST_CELL}" if _is_angle(name) else "f8" for name in names]
    fields = [(f"f{index}", kind) for index, kind in enumerate(kinds)]
    table = np.loadtxt(io.BytesIO(rows), np.dtype(fields), delimiter=",", comments=None, ndmin=1)
    if len(table) != num_rows:
        raise ValueError
    return [
        _parse_angles(table[field]) if _is_angle(name) else np.ascontiguousarray(table[field])
        for name, (field, _) in zip(names, fields, strict=True)
    ]


def _trouble(rows: bytes, names: list[str], first_line: int) -> str:
    """What is wrong with the first row that cannot be parsed."""
    for number, line in enumerate(rows[:-1].split(b"\n"), first_line):
        cells = line.split(b",")
        if len(cells) != len(names):
            return f"line {number} has {len(cells)} values, but there are {len(names)} columns."
        for name, cell in zip(names, cells, strict=True):
            try:
                if cell.translate(None, _CHARACTERS) or len(cell) >= _LONGEST_CELL:
                    raise ValueError
                text = cell.decode() or "nan" * name.startswith(_MAY_MISS)
                _parse_degrees(text) if _is_angle(name) else float(text)
            except (ValueError, ArithmeticError):
                return f"line {number} contains a cell that is not a number."
    raise AssertionError("one of the rows cannot be parsed")


def _check_values(columns: Mapping[str, np.ndarray], where: Callable[[int], str]) -> None:
    for name, values in columns.items():
        good = np.isfinite(values)
        if name.startswith(_MAY_MISS):
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


def _format_angles(radians: np.ndarray) -> list[str]:
    """`_format_degrees` of many angles (K,)."""
    with np.errstate(all="ignore"):
        degrees = np.abs(radians.astype(_LONG)) / _LONG_RADIAN
        size = np.floor(np.log10(degrees.astype(float)))
        plain = (size >= -4) & (size < 14)
        size = np.where(plain, size, 0).astype(int)
        found = np.zeros(len(radians), bool)
        mantissas, places = np.zeros(len(radians), np.int64), np.zeros(len(radians), int)
        unsure = ~plain
        for digits in (15, 16, 17):
            after = digits - 1 - size
            mantissa = np.where(plain, np.rint(degrees * _TENS[after]), 0).astype(np.int64)
            back, sure = _to_radians(mantissa, after)
            unsure |= ~found & ~sure
            these = ~found & ~unsure & (back == np.abs(radians))
            mantissas[these], places[these] = mantissa[these], after[these]
            found |= these
    texts = []
    for value, number, place, good in zip(
        radians.tolist(), mantissas.tolist(), places.tolist(), found.tolist(), strict=True
    ):
        if not good:
            texts.append(_format_degrees(value))
            continue
        text = f"{number:0{place + 1}d}"
        text = f"{text[:-place]}.{text[-place:]}".rstrip("0").rstrip(".")
        texts.append(f"-{text}" if value < 0 else text)
    return texts


def _to_radians(mantissas: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The doubles nearest to mantissas (K,) in degrees with decimal places, and which are sure."""
    exact = mantissas.astype(_LONG) / _TENS[places] * _LONG_RADIAN
    nearest = exact.astype(float)
    half = np.spacing(np.abs(nearest)).astype(_LONG) / 2
    sure = half - np.abs(exact - nearest) > _MARGIN * np.abs(exact)
    # Below a power of two doubles are closer.
    return nearest, sure & (np.abs(np.frexp(nearest)[0]) != 0.5)


def _parse_angles(cells: np.ndarray) -> np.ndarray:
    """`_parse_degrees` of many texts (K,)."""
    letters = np.ascontiguousarray(cells).view(np.uint8).reshape(len(cells), _LONGEST_CELL)
    if letters[:, -1].any():
        raise ValueError("a cell is too long")
    mantissas, places = np.zeros(len(cells), np.int64), np.zeros(len(cells), int)
    count, point = np.zeros(len(cells), int), np.zeros(len(cells), bool)
    plain = np.ones(len(cells), bool)
    for position, column in enumerate(letters.T):
        digit = (column >= ord("0")) & (column <= ord("9"))
        # No overflow: those with more than 18 digits are not plain.
        mantissas = np.where(digit & (count < 18), 10 * mantissas + column - ord("0"), mantissas)
        count += digit & ((mantissas > 0) | (column != ord("0")))
        places += digit & point
        dot = column == ord(".")
        sign = (column == ord("-")) & (position == 0)
        plain &= digit | (dot & ~point) | sign | (column == 0)
        point |= dot
        if not column.any():
            break
    plain &= (count > 0) & (count <= 18) & (places < len(_TENS))
    with np.errstate(all="ignore"):
        radians, sure = _to_radians(np.where(plain, mantissas, 0), np.where(plain, places, 0))
    radians = np.where(letters[:, 0] == ord("-"), -radians, radians)
    for index in np.flatnonzero(~(plain & sure)):
        radians[index] = _parse_degrees(cells[index].decode())
    return radians


def _format_degrees(radians: float) -> str:
    """Degrees, in the fewest digits that come back as the same double."""
    if radians == 0 or not math.isfinite(radians):
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
