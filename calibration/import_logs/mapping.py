"""A mapping from the columns of a log to a limb's duty, temperatures and bend; its YAML file.

`docs/logs.md` explains each field.
"""

import dataclasses
import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import yaml

from calibration.import_logs.table import LogError
from limb_systems.bend_sensor import ChordSensor, TipTangentSensor
from limb_systems.errors import reraise_as
from limb_systems.files.input import read_text
from limb_systems.files.output import write_atomically
from limb_systems.files.schema import Strict, dump_typed, load_typed, quantity, rare, validate, word

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
TIME_OF_DAY = "date"  # unit of times of day, with or without dates
FRAMES = "frames"  # unit of numbers of frames at the mapping's rate
# The factor and offset by which numbers in each unit become °C.
TEMPERATURE_UNITS = {"C": (1.0, 0.0), "F": (1 / 1.8, -32 / 1.8), "K": (1.0, -273.15)}
BEND_ANGLE = "bend_angle"
CHORD = "chord"
TIP_TANGENT = "tip_tangent"
MEASURES = {BEND_ANGLE: None, CHORD: ChordSensor, TIP_TANGENT: TipTangentSensor}
UNKNOWN = "?"  # in place of what is not known


@dataclasses.dataclass
class TimeColumn(Strict):
    """The column of time, none if rows come at a rate; ``fraction`` is added, as ``nanosec``."""

    column: str = ""
    unit: str = word("s", [*TIME_UNITS, TIME_OF_DAY, FRAMES, UNKNOWN])
    wraps_after: float = quantity(0.0, "s", 0.0, 1e9)
    fraction: str = rare("")
    fraction_unit: str = word("ns", TIME_UNITS, rare=True)


@dataclasses.dataclass
class WireColumns(Strict):
    """The columns of a wire; antagonistic wires may share a duty, one with the sign -1."""

    name: str
    duty: str
    sign: float = word(1.0, [1.0, -1.0])
    temperature: str = ""
    unit: str = word("C", [*TEMPERATURE_UNITS, UNKNOWN])


@dataclasses.dataclass
class BendColumns(Strict):
    """The columns of an angle, of two angles of a limb in space, or of points in a picture."""

    column: str = ""
    e2: str = rare("")
    e3: str = rare("")
    line: list[str] = dataclasses.field(default_factory=list)
    base_line: list[str] = dataclasses.field(default_factory=list)
    zero: float | None = quantity(0.0, "", -1e12, 1e12)
    zero_e3: float | None = quantity(0.0, "", -1e12, 1e12, rare=True)
    scale: float = quantity(1.0, "", -1e6, 1e6)
    scale_e3: float = quantity(0.0, "", -1e6, 1e6, rare=True)
    measures: str = word(BEND_ANGLE, [*MEASURES, UNKNOWN])
    roll: float = quantity(0.0, "°", -360.0, 360.0, rare=True)
    seen: str = rare("")

    @property
    def columns(self) -> list[str]:
        """The columns that show the bend."""
        return list(filter(None, [self.column, self.e2, self.e3, *self.line, *self.base_line]))


@dataclasses.dataclass
class JoinedLog(Strict):
    """A second file of the same run, whose columns are used as the log's own."""

    file: str
    time: TimeColumn
    rate: float = quantity(0.0, "Hz", 0.0, 1e6)
    offset: float | None = None
    align: list[str] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class LogMapping(Strict):
    """A mapping from a log's columns, by their names or numbers, to a limb of one segment.

    Raises:
        LogError: at construction, if a field has none of its words, or two signals one column.
    """

    time: TimeColumn = dataclasses.field(default_factory=TimeColumn)
    wires: list[WireColumns] = dataclasses.field(default_factory=list)
    bend: BendColumns = dataclasses.field(default_factory=BendColumns)
    full: float = quantity(1.0, "", 0.0, 1e9)
    inverted: bool = rare(False)
    rate: float = quantity(0.0, "Hz", 0.0, 1e6)
    missing: list[str] = dataclasses.field(default_factory=list)
    join: JoinedLog | None = None

    def __post_init__(self) -> None:
        with reraise_as(LogError):
            validate(self)
        # There is one bend, and wires have different names.
        bend = self.bend
        is_given = [bool(bend.column), bool(bend.e2 and bend.e3), bool(bend.line)]
        if sum(is_given) != 1 or bool(bend.e2) != bool(bend.e3):
            raise LogError("bend must have either a column, e2 and e3, or a line.")
        for where, columns, counts in (
            ("bend.line", bend.line, (0, 4)),
            ("bend.base_line", bend.base_line, (0, 4, 6)),
            ("join.align", self.join.align if self.join else [], (0, 2)),
        ):
            if len(columns) not in counts:
                raise LogError(f"{where} has {len(columns)} columns, but must have {counts[1:]}.")
        names = [wire.name for wire in self.wires if wire.name != UNKNOWN]
        if not self.wires or len(set(names)) < len(names):
            raise LogError("wires must have at least one wire, and no name twice.")
        # No column stands for two signals, but a signed one for the duty of two wires.
        signals = [self.time.column, *set(bend.columns)]
        for wire in self.wires:
            signals.append(wire.duty if wire.sign > 0 else f"-{wire.duty}")
            signals.append(wire.temperature)
        for column, count in Counter(signals).items():
            if count > 1 and column.strip(f"-{UNKNOWN}"):
                raise LogError(
                    f"the column {column!r} is given for two signals; give each its own."
                )

    @property
    def columns(self) -> set[str]:
        """The columns that it names, of both files."""
        columns = {self.time.column, self.time.fraction, self.bend.seen, *self.bend.columns}
        for wire in self.wires:
            columns |= {wire.duty, wire.temperature}
        return (columns | set(self.join.align if self.join else ())) - {""}

    @property
    def has_rows_at_rate(self) -> bool:
        """True if rows or frames come at ``rate``: no column is a time."""
        return not self.time.column or self.time.unit == FRAMES

    @property
    def open_fields(self) -> list[str]:
        """The fields that the mapping leaves open, such as "wires[0].duty"."""
        bend_columns = "bend.line" if self.bend.line else "bend.column"
        # Zero, or None, stands for numbers that are not known.
        is_open = {
            "time.column": self.time.column == UNKNOWN,
            "time.unit": self.time.unit == UNKNOWN,
            "rate": self.has_rows_at_rate and not self.rate,
            "full": not self.full and any(wire.duty for wire in self.wires),
            bend_columns: UNKNOWN in self.bend.columns,
            "bend.scale": not self.bend.scale,
            "bend.zero": self.bend.zero is None,
            "bend.zero_e3": self.bend.zero_e3 is None,
            "bend.measures": self.bend.measures == UNKNOWN,
        }
        for index, wire in enumerate(self.wires):
            for field in ("name", "duty", "temperature"):
                is_open[f"wires[{index}].{field}"] = getattr(wire, field) == UNKNOWN
            is_open[f"wires[{index}].unit"] = bool(wire.temperature) and wire.unit == UNKNOWN
        return [field for field, is_asked in is_open.items() if is_asked]

    def with_answers(self, answers: dict[str, str]) -> "LogMapping":
        """Return the mapping with further fields, such as ``{"wires[0].duty": "pwm_left"}``.

        "none" for a field of a wire leaves out the wire. LogError if an answer cannot be.
        """
        # Put each answer into its place in the YAML document.
        document = yaml.safe_load(dump_typed(self))
        left_out = set()
        for field, answer in answers.items():
            target = document
            *parents, last = re.findall(r"\w+", field)
            for parent in parents:
                target = target[int(parent)] if parent.isdigit() else target[parent]
            target[last] = answer.strip("'\"")
            if answer.startswith("["):
                target[last] = list(map(str.strip, answer.strip("[]").split(",")))
            if answer == "none" and parents[:1] == ["wires"]:
                left_out.add(int(parents[1]))
        # Leave out wires that are none.
        for index in sorted(left_out, reverse=True):
            del document["wires"][index]
        with reraise_as(LogError):
            return load_typed(LogMapping, yaml.safe_dump(document, allow_unicode=True))

    def save(self, path: str | Path, remarks: Iterable[str] = ()) -> None:
        """Write YAML, with remarks above it as comments."""
        comments = "".join(f"# {line}".rstrip() + "\n" for line in remarks)
        write_atomically(path, comments + dump_typed(self))

    @classmethod
    def load(cls, path: str | Path) -> "LogMapping":
        """Read YAML; LogError with one sentence that names the file and the field."""
        text = read_text(path, "mapping", LogError)
        with reraise_as(LogError, f"{path}: "):
            return load_typed(cls, text)
