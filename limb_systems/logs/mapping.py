"""A mapping from the columns of a log to a limb's duty, temperatures and bend; its YAML file."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from limb_systems.errors import raised_as
from limb_systems.files.input import read_text
from limb_systems.files.output import write_atomically
from limb_systems.files.schema import Strict, dump_typed, load_typed, quantity
from limb_systems.logs.table import DELIMITERS, LogError, LogTable

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
SECONDS["date"] = 1.0
CELSIUS = {"C": (1.0, 0.0), "F": (1 / 1.8, -32 / 1.8), "K": (1.0, -273.15)}  # factor, offset
BEND_ANGLE, CHORD, TIP_TANGENT = "bend_angle", "chord", "tip_tangent"
OPEN = "?"  # in place of a column that is not known
MEASURES = (BEND_ANGLE, CHORD, TIP_TANGENT)


@dataclasses.dataclass
class TimeColumn(Strict):
    """The column of time.

    - ``unit``: "s", "ms", "us", "ns", "min", "h" or "d"; "date" for dates or times of day;
      `OPEN` if it is not known.
    - ``wraps_after``: period after which the numbers begin anew, such as a day, s; 0 for never.
    """

    column: str
    unit: str = "s"
    wraps_after: float = quantity(0.0, "s", 0.0, 1e9)


@dataclasses.dataclass
class WireColumns(Strict):
    """The columns of a wire.

    - ``name``: name of the wire in the limb's description, such as "left".
    - ``duty``: column of its duty; empty if it was never heated.
    - ``sign``: 1, or -1 where it is negative numbers of a signed column that heat this wire.
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
    """The columns of the bend: of an angle, or of points in a picture.

    - ``column``: column of an angle; empty if the direction of a line between points shows it.
    - ``line``: columns x, y of a point of the limb and x, y of one nearer to its tip, in a picture
      whose y points down.
    - ``base_line``: columns x, y of two or three points before the base and at it, if what the
      limb is mounted on moves: the direction at the last of them is subtracted.
    - ``zero``: number, or direction of the line, °, of the straight limb.
    - ``scale``: degrees that one unit is; negative if the limb bends to its +E2 side, that of
      the right wire, when numbers decrease; 0 if it is not known.
    - ``measures``: "bend_angle" for φ; "chord" for the angle of the line from base to tip;
      "tip_tangent" for α, which is halved (8).
    """

    column: str = ""
    line: list[str] = dataclasses.field(default_factory=list)
    base_line: list[str] = dataclasses.field(default_factory=list)
    zero: float = quantity(0.0, "", -1e12, 1e12)
    scale: float = quantity(1.0, "", -1e6, 1e6)
    measures: str = BEND_ANGLE


@dataclasses.dataclass
class LogMapping(Strict):
    """A mapping from a log's columns to a limb of one segment.

    - ``time``, ``wires``, ``bend``: the columns.
    - ``full``: number that is full duty, such as 1, 100 or 255; 0 if it is not known.
    - ``rate``: rate at which the log is sampled evenly, Hz; 0 for that of most of its rows.
    - ``missing``: numbers that stand for a reading that is missing, such as -999.
    - ``delimiter``, ``decimal``, ``names_line``: as in `LogTable`.

    Raises:
        LogError: at construction, if a word is none of those above, or two signals have one column.
    """

    time: TimeColumn
    wires: list[WireColumns]
    bend: BendColumns
    full: float = quantity(1.0, "", 0.0, 1e9)
    rate: float = quantity(0.0, "Hz", 0.0, 1000.0)
    missing: list[float] = dataclasses.field(default_factory=list)
    delimiter: str = ","
    decimal: str = "."
    names_line: int = quantity(1, "", 0, 1000)

    def __post_init__(self) -> None:
        words: list[tuple[str, str, Iterable[str]]] = [
            ("time.unit", self.time.unit, SECONDS),
            ("bend.measures", self.bend.measures, MEASURES),
            ("decimal", self.decimal, (".", ",")),
            ("delimiter", self.delimiter, DELIMITERS),
        ]
        words += [(f"wires[{i}].unit", wire.unit, CELSIUS) for i, wire in enumerate(self.wires)]
        for where, word, known in words:
            if word not in known and not (word == OPEN and where.endswith("unit")):
                raise LogError(f"{where} is {word!r}; it must be one of {', '.join(known)}.")
        if len(self.bend.line) not in (0, 4) or len(self.bend.base_line) not in (0, 4, 6):
            raise LogError(
                "bend.line must have 4 columns, x, y, x and y, or none; base_line may have 6."
            )
        if bool(self.bend.column) == bool(self.bend.line):
            raise LogError("bend must have either a column or a line.")
        if not self.wires:
            raise LogError("wires must have at least one wire.")
        for wire in self.wires:
            if wire.sign not in (-1.0, 1.0):
                raise LogError(
                    f"sign of the {wire.name} wire is {wire.sign:g}; it must be 1 or -1."
                )
        names = [wire.name for wire in self.wires]
        if twice := next((name for name in names if names.count(name) > 1), ""):
            raise LogError(f"wires has two wires of the name {twice!r}.")
        self._check_columns()

    def _check_columns(self) -> None:
        """Raises LogError if a column stands for two signals."""
        taken: dict[str, tuple[str, float]] = {}
        for signal, column, sign, _ in self._signals():
            other, sign_of_other = taken.setdefault(column, (signal, sign))
            # A signed column heats one wire by its positive numbers, another by its negative ones.
            if column != OPEN and other != signal and not sign * sign_of_other < 0:
                raise LogError(
                    f"the column {column!r} is given for {other} and for {signal}; give "
                    "each its own."
                )

    def _signals(self) -> list[tuple[str, str, float, bool]]:
        """Each signal with a column, the column, a duty's sign, and whether its unit is known."""
        found = [
            ("time", self.time.column, 0.0, self.time.unit != OPEN),
            ("the bend", self.bend.column, 0.0, bool(self.bend.scale)),
        ]
        for wire in self.wires:
            reading = f"temperature of the {wire.name} wire"
            found.append((f"duty of the {wire.name} wire", wire.duty, wire.sign, bool(self.full)))
            found.append((reading, wire.temperature, 0.0, wire.unit != OPEN))
        return [signal for signal in found if signal[1]]

    @classmethod
    def of(
        cls,
        table: LogTable,
        time: TimeColumn,
        wires: list[WireColumns],
        bend: BendColumns,
        **more: Any,
    ) -> "LogMapping":
        """A mapping of these columns, in the table's form."""
        form = ("delimiter", "decimal", "names_line")
        more |= {name: getattr(table, name) for name in form}
        return cls(time, wires, bend, **more)

    @property
    def columns(self) -> set[str]:
        """The columns that it names."""
        return {column for _, column, *_ in self._signals()} | {
            *self.bend.line,
            *self.bend.base_line,
        }

    @property
    def question(self) -> str:
        """What it has to say before its log can be read, in a sentence; empty if nothing."""
        signals = self._signals()
        if unknown := [signal for signal, column, *_ in signals if column == OPEN]:
            return f"no column is known for {', '.join(unknown)}; give it in the mapping."
        units = list(dict.fromkeys(column for _, column, _, known in signals if not known))
        if units == [self.bend.column]:
            return (
                f"what a unit of {self.bend.column!r} is cannot be known: give the degrees that it "
                "is as bend.scale in the mapping, negative if the limb bends towards the right "
                "wire when the numbers decrease, and the number of the straight limb as bend.zero."
            )
        asked = f"the unit of {', '.join(units)} cannot be known; give it in the mapping."
        return asked if units else ""

    def save(self, path: str | Path, remarks: Iterable[str] = ()) -> None:
        """Writes YAML, with remarks above it as comments."""
        comments = "".join(f"# {line}".rstrip() + "\n" for line in remarks)
        write_atomically(path, comments + dump_typed(self))

    @classmethod
    def load(cls, path: str | Path) -> "LogMapping":
        """Reads YAML.

        Raises:
            LogError: with one sentence naming the file and the field.
        """
        text = read_text(path, "mapping", LogError)
        with raised_as(LogError, f"{path}: "):
            return load_typed(cls, text)
