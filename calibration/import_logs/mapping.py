"""A mapping from the columns of a log to a limb's duty, temperatures and bend; its YAML file."""

import dataclasses
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from calibration.import_logs.table import DELIMITERS, LogError, LogTable
from limb_systems.errors import raised_as
from limb_systems.input import read_text
from limb_systems.output import write_atomically
from limb_systems.schema import Strict, dump_typed, load_typed, quantity, rare

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
DATE, FRAMES = "date", "frames"  # units of time that are no fixed number of seconds
CELSIUS = {"C": (1.0, 0.0), "F": (1 / 1.8, -32 / 1.8), "K": (1.0, -273.15)}  # factor, offset
BEND_ANGLE, CHORD, TIP_TANGENT = "bend_angle", "chord", "tip_tangent"
OPEN = "?"  # in place of what is not known
MEASURES = (BEND_ANGLE, CHORD, TIP_TANGENT)


@dataclasses.dataclass
class TimeColumn(Strict):
    """The column of time.

    - ``column``: empty if the rows have no time, but come at the mapping's ``rate``.
    - ``unit``: "s", "ms", "us", "ns", "min", "h" or "d"; "date" for dates or times of day;
      "frames" for numbers of frames at the mapping's ``rate``; `OPEN` if it is not known.
    - ``wraps_after``: period after which the numbers begin anew, such as a day, s; 0 for never.
    - ``fraction``, ``fraction_unit``: a second column that is added, such as the ``nanosec`` of
      ROS beside its ``sec``, and its unit.
    """

    column: str = ""
    unit: str = "s"
    wraps_after: float = quantity(0.0, "s", 0.0, 1e9)
    fraction: str = rare("")
    fraction_unit: str = rare("ns")


@dataclasses.dataclass
class WireColumns(Strict):
    """The columns of a wire.

    - ``name``: name of the wire in the limb's description, such as "left".
    - ``duty``: column of its duty; empty if it was never heated.
    - ``sign``: 1, or -1 where it is negative numbers of a signed column that heat this wire. Two
      antagonistic wires may share a column, one with 1 and one with -1.
    - ``temperature``: column of its thermocouple; empty if it has none.
    - ``unit``: "C", "F" or "K"; `OPEN` if it is not known.
    """

    name: str
    duty: str
    sign: float = quantity(1.0, "", -1.0, 1.0)
    temperature: str = ""
    unit: str = "C"


@dataclasses.dataclass
class BendColumns(Strict):
    """The columns of the bend: an angle, two angles of a limb in space, or points in a picture.

    - ``column``: column of an angle.
    - ``e2``, ``e3``: columns of the angles towards E2 and E3, of a limb in space.
    - ``line``: columns x, y of the limb's base and x, y of a point nearer to its tip, in a picture
      whose y points down.
    - ``base_line``: columns x, y of two or three points before the base and at it, if what the
      limb is mounted on moves: the direction at the last of them is subtracted.
    - ``zero``: number, or direction of the line, °, of the straight limb; ``zero_e3`` of ``e3``.
    - ``scale``: degrees that one unit is; negative if the limb bends to its +E2 side, that of
      the right wire, when numbers decrease; 0 if it is not known. ``scale_e3``: of ``e3``; 0 for
      the same as ``scale``.
    - ``measures``: "bend_angle" for φ; "chord" for the angle of the line from base to tip;
      "tip_tangent" for α, which is halved (8); `OPEN` if it is not known.
    - ``roll``: angle about E1 from E2 to the axis that the sensor takes for it, °.
    - ``seen``: column that is 0 in rows without a reading, such as one of a camera's tag.
    """

    column: str = ""
    e2: str = rare("")
    e3: str = rare("")
    line: list[str] = dataclasses.field(default_factory=list)
    base_line: list[str] = dataclasses.field(default_factory=list)
    zero: float = quantity(0.0, "", -1e12, 1e12)
    zero_e3: float = quantity(0.0, "", -1e12, 1e12, rare=True)
    scale: float = quantity(1.0, "", -1e6, 1e6)
    scale_e3: float = quantity(0.0, "", -1e6, 1e6, rare=True)
    measures: str = BEND_ANGLE
    roll: float = quantity(0.0, "°", -360.0, 360.0, rare=True)
    seen: str = rare("")

    @property
    def columns(self) -> list[str]:
        """The columns that show the bend."""
        own = [self.column, self.e2, self.e3, *self.line, *self.base_line]
        return [column for column in own if column]


@dataclasses.dataclass
class JoinedLog(Strict):
    """A second file of the same run, such as a camera's; its columns are used as the log's own.

    - ``file``: its path, from the folder of the log; a column of a name that the log has, too, is
      called ``name_2``.
    - ``time``: its time; ``rate``: of its rows or frames, Hz, if it has no time.
    - ``offset``: s from the log's first row to this file's first row.
    - ``align``: in place of ``offset``, a column of the log and a column of this file that show the
      same; the offset is where they agree best.
    """

    file: str
    time: TimeColumn
    rate: float = quantity(0.0, "Hz", 0.0, 1e6)
    offset: float | None = None
    align: list[str] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class LogMapping(Strict):
    """A mapping from a log's columns to a limb of one segment.

    A column is given by its name, or by its number, from 1, such as ``3`` or ``column_3``.

    - ``time``, ``wires``, ``bend``: the columns.
    - ``full``: number that is full duty, such as 1, 100 or 255; 0 if it is not known.
    - ``inverted``: whether a wire is off at ``full`` and heated by full duty at 0.
    - ``rate``: rate of the rows or frames, Hz, where ``time`` has no column or counts frames;
      otherwise the rate at which the log is sampled evenly, 0 for that of most of its rows.
    - ``missing``: numbers or words in place of a reading that is missing, such as -999.
    - ``join``: a second file of the same run.
    - ``delimiter``, ``decimal``, ``names_line``: as in `LogTable`.

    Raises:
        LogError: at construction, if a word is none of those above, or two signals have one column.
    """

    time: TimeColumn = dataclasses.field(default_factory=TimeColumn)
    wires: list[WireColumns] = dataclasses.field(default_factory=list)
    bend: BendColumns = dataclasses.field(default_factory=BendColumns)
    full: float = quantity(1.0, "", 0.0, 1e9)
    inverted: bool = rare(False)
    rate: float = quantity(0.0, "Hz", 0.0, 1e6)
    missing: list[str] = dataclasses.field(default_factory=list)
    join: JoinedLog | None = None
    delimiter: str = ","
    decimal: str = "."
    names_line: int = quantity(1, "", 0, 10_000)

    def __post_init__(self) -> None:
        self.missing = [str(value) for value in self.missing]
        words: list[tuple[str, str, Iterable[str]]] = [
            ("time.unit", self.time.unit, [*SECONDS, DATE, FRAMES]),
            ("time.fraction_unit", self.time.fraction_unit, SECONDS),
            ("bend.measures", self.bend.measures, MEASURES),
            ("decimal", self.decimal, (".", ",")),
            ("delimiter", self.delimiter, DELIMITERS),
        ]
        words += [(f"wires[{i}].unit", wire.unit, CELSIUS) for i, wire in enumerate(self.wires)]
        for where, word, known in words:
            may_be_open = where.endswith(("unit", "measures"))
            if word not in known and not (word == OPEN and may_be_open):
                raise LogError(f"{where} is {word!r}; it must be one of {', '.join(known)}.")
        if len(self.bend.line) not in (0, 4) or len(self.bend.base_line) not in (0, 4, 6):
            raise LogError(
                "bend.line must have 4 columns, x, y, x and y, or none; base_line may have 6."
            )
        ways = [bool(self.bend.column), bool(self.bend.e2 and self.bend.e3), bool(self.bend.line)]
        if sum(ways) != 1 or bool(self.bend.e2) != bool(self.bend.e3):
            raise LogError("bend must have either a column, e2 and e3, or a line.")
        if self.join and len(self.join.align) not in (0, 2):
            raise LogError("join.align must have 2 columns, one of each file, or none.")
        if not self.wires:
            raise LogError("wires must have at least one wire.")
        for wire in self.wires:
            if wire.sign not in (-1.0, 1.0):
                raise LogError(
                    f"sign of the {wire.name} wire is {wire.sign:g}; it must be 1 or -1."
                )
        names = [wire.name for wire in self.wires if wire.name != OPEN]
        if twice := next((name for name in names if names.count(name) > 1), ""):
            raise LogError(f"wires has two wires of the name {twice!r}.")
        self._check_columns()

    def _check_columns(self) -> None:
        """Raise LogError if a column stands for two signals."""
        taken: dict[str, tuple[str, float]] = {}
        signals = [("time", self.time.column, 0.0)]
        signals += [("the bend", column, 0.0) for column in self.bend.columns]
        for wire in self.wires:
            signals.append((f"duty of the {wire.name} wire", wire.duty, wire.sign))
            signals.append((f"temperature of the {wire.name} wire", wire.temperature, 0.0))
        for signal, column, sign in signals:
            if column in ("", OPEN):
                continue
            other, sign_of_other = taken.setdefault(column, (signal, sign))
            # A signed column heats one wire by its positive numbers, another by its negative ones.
            if other != signal and not sign * sign_of_other < 0:
                raise LogError(
                    f"the column {column!r} is given for {other} and for {signal}; give "
                    "each its own."
                )

    @classmethod
    def of(
        cls,
        table: LogTable,
        time: TimeColumn,
        wires: list[WireColumns],
        bend: BendColumns,
        **more: Any,
    ) -> "LogMapping":
        """Return a mapping of these columns, in the table's form."""
        form = ("delimiter", "decimal", "names_line")
        more |= {name: getattr(table, name) for name in form}
        return cls(time, wires, bend, **more)

    @property
    def columns(self) -> set[str]:
        """The columns that it names, of both files."""
        own = {self.time.column, self.time.fraction, self.bend.seen, *self.bend.columns}
        for wire in self.wires:
            own |= {wire.duty, wire.temperature}
        own |= set(self.join.align) if self.join else set()
        return own - {""}

    @property
    def open_fields(self) -> list[str]:
        """The fields that the mapping leaves open, such as "wires[0].duty"."""
        found = []
        if OPEN in (self.time.column, self.time.unit):
            found.append("time.column" if self.time.column == OPEN else "time.unit")
        frames = not self.time.column or self.time.unit == FRAMES
        if frames and not self.rate:
            found.append("rate")
        for index, wire in enumerate(self.wires):
            for field in ("name", "duty", "temperature", "unit"):
                if getattr(wire, field) == OPEN and not (field == "unit" and not wire.temperature):
                    found.append(f"wires[{index}].{field}")
        if any(wire.duty not in ("", OPEN) for wire in self.wires) and not self.full:
            found.append("full")
        if OPEN in self.bend.columns:
            found.append("bend.line" if self.bend.line else "bend.column")
        if not self.bend.scale:
            found.append("bend.scale")
        if self.bend.measures == OPEN:
            found.append("bend.measures")
        return found

    @property
    def question(self) -> str:
        """The fields that must be given before the log can be read, in a sentence, if any."""
        return f"the mapping leaves open {', '.join(self.open_fields)}." if self.open_fields else ""

    def with_answers(self, answers: dict[str, str]) -> "LogMapping":
        """Return the mapping with further fields, such as ``{"wires[0].duty": "pwm_left"}``.

        The answer "none" to a field of a wire leaves out the wire.

        Raises:
            LogError: if a field cannot have its answer.
        """
        document = yaml.safe_load(dump_typed(self))
        left_out = set()
        for field, answer in answers.items():
            target = document
            *parents, last = re.findall(r"\w+", field)
            for parent in parents:
                target = target[int(parent)] if parent.isdigit() else target[parent]
            if answer == "none" and parents[:1] == ["wires"]:
                left_out.add(int(parents[1]))
            else:
                value = yaml.safe_load(answer) if answer.startswith("[") else answer.strip("'\"")
                target[last] = value
        wires = enumerate(document["wires"])
        document["wires"] = [wire for index, wire in wires if index not in left_out]
        with raised_as(LogError):
            return load_typed(LogMapping, yaml.safe_dump(document, allow_unicode=True))

    def save(self, path: str | Path, remarks: Iterable[str] = ()) -> None:
        """Write YAML, with remarks above it as comments."""
        comments = "".join(f"# {line}".rstrip() + "\n" for line in remarks)
        write_atomically(path, comments + dump_typed(self))

    @classmethod
    def load(cls, path: str | Path) -> "LogMapping":
        """Read YAML.

        Raises:
            LogError: with one sentence naming the file and the field.
        """
        text = read_text(path, "mapping", LogError)
        with raised_as(LogError, f"{path}: "):
            return load_typed(cls, text)
