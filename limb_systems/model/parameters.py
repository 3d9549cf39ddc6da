"""The limb in one YAML file: geometry, mechanics, wires, limits.

Every field of the dataclasses below carries its unit and the range that is
accepted, so that the documentation, the validation and the error messages
cannot drift apart.
"""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.yaml import yaml_dump_typed

from limb_systems.errors import LimbError
from limb_systems.output import write_atomically
from limb_systems.schema import SchemaError, load_typed


class ParameterError(LimbError):
    """A limb description is missing, malformed or outside its range."""


def _quantity(default, unit: str, low: float, high: float):
    """A dataclass field with its unit and closed range of allowed values."""
    return dataclasses.field(default=default, metadata={"unit": unit, "range": (low, high)})


@dataclasses.dataclass
class WireParameters:
    """One shape-memory-alloy wire and its thermocouple, eqns (4), (6), (7).

    - ``a1``: cooling rate towards ambient, 1/s, negative (6).
    - ``a2``: heating rate at full duty, °C/s (6).
    - ``a3``: rate of the measurement lag, 1/s, negative (7).
    - ``beta``: joint torque per degree above ambient, N·m/°C (4).
    """

    a1: float = _quantity(-0.07, "1/s", -10.0, -1e-4)
    a2: float = _quantity(20.0, "°C/s", 0.1, 1000.0)
    a3: float = _quantity(-1.0, "1/s", -100.0, -1e-3)
    beta: float = _quantity(4.7e-4, "N·m/°C", 1e-8, 1.0)


@dataclasses.dataclass
class SegmentParameters:
    """One segment: a silicone beam cut into equal rigid links, with two wires.

    - ``links``: number of rigid links, each with a revolute joint at its base.
    - ``length``: length of the whole segment along E1, m.
    - ``mass``: mass of the whole segment, kg.
    - ``width``: cross-section along the bending axis (E3), m.
    - ``thickness``: cross-section in the bending plane (E2), m.
    - ``stiffness``: torsional spring constant k of each joint, N·m/rad (1).
    - ``damping``: damping constant σ of each joint, N·m·s/rad (1).
    - ``left``, ``right``: the wires; heating the right one bends towards +E2.
    """

    links: int = _quantity(5, "links", 1, 100)
    length: float = _quantity(0.10, "m", 1e-3, 10.0)
    mass: float = _quantity(0.025, "kg", 1e-6, 100.0)
    width: float = _quantity(0.020, "m", 1e-4, 1.0)
    thickness: float = _quantity(0.010, "m", 1e-4, 1.0)
    stiffness: float = _quantity(0.1246, "N·m/rad", 1e-6, 1e4)
    damping: float = _quantity(1.0e-3, "N·m·s/rad", 0.0, 1e2)
    left: WireParameters = dataclasses.field(default_factory=WireParameters)
    right: WireParameters = dataclasses.field(default_factory=WireParameters)


@dataclasses.dataclass
class TemperatureLimits:
    """Bounds on the wire temperature T, eqns (19)-(20).

    - ``maximum``: T_max, °C, never exceeded (19).
    - ``warm``: T_warm, °C, kept after the warm-up (20).
    - ``warm_up_time``: k_warm, s, from the start of a plan (20).
    """

    maximum: float = _quantity(100.0, "°C", -50.0, 500.0)
    warm: float = _quantity(45.0, "°C", -50.0, 500.0)
    warm_up_time: float = _quantity(20.0, "s", 0.0, 3600.0)


@dataclasses.dataclass
class LimbParameters:
    """A limb: segments in series from the base to the tip, and where it is.

    ``LimbParameters()`` is the nominal limb, one segment of five links with
    the paper's 10° sag under gravity.

    - ``segments``: one or more `SegmentParameters`, base first.
    - ``ambient_temperature``: T0, °C (4), (6).
    - ``gravity``: acceleration in the frame (E1, E2, E3), m/s². Zero, the
      default, is the paper's mounting, with the bending axis vertical and
      stiff against gravity; (0, -9.81, 0) is the cantilever of Sec. V-A.
    - ``temperature_limits``: eqns (19)-(20).
    - ``board``: serial number of the board on the limb that these parameters
      were calibrated on; empty if of none.

    The order of wires is [left, right] of the first segment, then of the
    second, and so on; the order of joints is from the base to the tip.
    """

    segments: list[SegmentParameters] = dataclasses.field(
        default_factory=lambda: [SegmentParameters()]
    )
    ambient_temperature: float = _quantity(25.0, "°C", -50.0, 100.0)
    gravity: list[float] = dataclasses.field(
        default_factory=lambda: [0.0, 0.0, 0.0], metadata={"unit": "m/s²", "range": (-100.0, 100.0)}
    )
    temperature_limits: TemperatureLimits = dataclasses.field(default_factory=TemperatureLimits)
    board: str = ""

    @classmethod
    def load(cls, path: str | Path) -> "LimbParameters":
        """Reads and validates a YAML file.

        Raises:
            ParameterError: with one sentence naming the file and the field.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise ParameterError(f"Cannot read the limb parameters: {error}.") from error
        except UnicodeDecodeError as error:
            raise ParameterError(f"{path}: this is no text file, let alone YAML.") from error
        try:
            return cls.from_yaml(text)
        except ParameterError as error:
            raise ParameterError(f"{path}: {error}") from error

    def save(self, path: str | Path) -> None:
        """Validates, then writes a YAML file whole or not at all."""
        write_atomically(path, self.to_yaml())

    @classmethod
    def from_yaml(cls, text: str) -> "LimbParameters":
        """Parses YAML text; every field must be there, none may be unknown.

        Raises:
            ParameterError: with one sentence naming the field.
        """
        try:
            parameters = load_typed(cls, text)
        except SchemaError as error:
            raise ParameterError(str(error)) from error
        parameters.validate()
        return parameters

    def to_yaml(self) -> str:
        """The YAML text of these parameters, every float exact."""
        self.validate()
        return yaml_dump_typed(self)

    def validate(self) -> None:
        """Raises ParameterError for the first field that is out of its range."""
        if not isinstance(self.segments, list) or not self.segments:
            raise ParameterError("segments is empty; a limb has at least one segment.")
        if not isinstance(self.gravity, list) or len(self.gravity) != 3:
            raise ParameterError(
                f"gravity is {self.gravity!r}; it must be a list of three numbers from -100 to "
                "100 m/s², along E1, E2 and E3."
            )
        _validate(self, "")
        limits = self.temperature_limits
        if limits.maximum <= self.ambient_temperature:
            raise ParameterError(
                f"temperature_limits.maximum is {limits.maximum:g} °C; it must be above "
                f"ambient_temperature, which is {self.ambient_temperature:g} °C."
            )
        if limits.warm >= limits.maximum:
            raise ParameterError(
                f"temperature_limits.warm is {limits.warm:g} °C; it must be below "
                f"temperature_limits.maximum, which is {limits.maximum:g} °C."
            )

    @property
    def num_joints(self) -> int:
        """Number of joints of all segments."""
        return sum(segment.links for segment in self.segments)

    @property
    def wires(self) -> list[WireParameters]:
        """All wires: [left, right] of each segment, base first."""
        return [wire for segment in self.segments for wire in (segment.left, segment.right)]

    @property
    def wire_names(self) -> list[str]:
        """Names of the wires: left, right; with a segment number if several."""
        return [f"{side}{suffix}" for suffix in self.segment_suffixes for side in ("left", "right")]

    @property
    def segment_suffixes(self) -> list[str]:
        """What tells the segments apart in names: nothing for one segment."""
        if len(self.segments) == 1:
            return [""]
        return [f"_{number}" for number in range(1, len(self.segments) + 1)]

    @property
    def joint_slices(self) -> list[slice]:
        """For each segment, where its joints are among all joints."""
        ends = np.cumsum([segment.links for segment in self.segments])
        return [
            slice(int(end) - segment.links, int(end))
            for end, segment in zip(ends, self.segments, strict=True)
        ]


def _validate(target, path: str) -> None:
    """Checks a dataclass and what it holds against the ranges in its fields."""
    for field in dataclasses.fields(target):
        value, name = getattr(target, field.name), f"{path}{field.name}"
        kind: Any = field.type  # a type, as annotations are not postponed here
        if field.metadata:
            items = value if kind == list[float] else [value]
            expected = int if kind is int else (int, float)
            for item in items:
                _validate_number(item, name, expected, field.metadata)
        elif isinstance(value, list):
            for index, item in enumerate(value):
                if not isinstance(item, SegmentParameters):
                    raise ParameterError(f"{name}[{index}] is not a SegmentParameters.")
                _validate(item, f"{name}[{index}].")
        elif kind is str:
            if not isinstance(value, str):
                raise ParameterError(f"{name} is {value!r}; it must be text.")
        elif isinstance(value, kind):
            _validate(value, f"{name}.")
        else:
            raise ParameterError(f"{name} is not a {kind.__name__}.")


def _validate_number(value, name: str, expected, metadata) -> None:
    low, high = metadata["range"]
    valid = isinstance(value, expected) and not isinstance(value, bool)
    if not (valid and low <= value <= high):  # NaN is not
        kind = "a whole number" if expected is int else "a number"
        raise ParameterError(
            f"{name} is {value!r}; it must be {kind} from {low:g} to {high:g} {metadata['unit']}."
        )
