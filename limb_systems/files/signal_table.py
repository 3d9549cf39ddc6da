"""The signals of a limb over time: their sizes, their limits, their columns in files.

A signal is an array (size, K), a column for each of K samples, as Drake logs
them; times are (K,). Recordings and trajectories are made of these.
"""

import copy
import dataclasses
import itertools
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from pydrake.trajectories import PiecewisePolynomial

from limb_systems.connected_limbs import ConnectedLimbs
from limb_systems.errors import LimbError, reraise_as
from limb_systems.files.csv_format import FileFormatError, Table, TableText, parse_table
from limb_systems.files.input import LARGEST_TABLE, read_bytes
from limb_systems.files.output import write_atomically
from limb_systems.files.provenance import Provenance
from limb_systems.files.schema import dump_typed, load_fields
from limb_systems.kinematics import bend_angle
from limb_systems.limb_model import LimbModel
from limb_systems.limb_parameters import LimbParameters
from limb_systems.progress import Progress
from limb_systems.summary import Entry, Summarized

ROWS_AT_ONCE = 20_000  # rows that are formatted at one time
TIMES = ("time", "board_time", "sample_age")  # signals with one number for each sample
RANGES = {  # a value outside these is a mistake, of units or of a sensor
    "duty": (0.0, 1.0, ""),
    "applied_duty": (0.0, 1.0, ""),
    "sample_age": (0.0, np.inf, " s"),
    "measured_temperature": (-60.0, 600.0, " °C"),
    "wire_temperature": (-60.0, 600.0, " °C"),
    "bend_angle": (-np.pi, np.pi, " rad"),
}


def column_names(
    parameters: LimbParameters, connected: ConnectedLimbs | None = None
) -> dict[str, list[str]]:
    """Return the names of the columns of each signal; the unit is in the name.

    Signals of joints are split into angles and rates. Columns of wires have the
    wires' names. With several segments, the number of the segment follows; with
    several bends of a segment, their axes follow. The signal ``other_wire_state`` is
    there only if wires have states other than their temperature T, as in a law of two
    masses. Connected limbs, such as a robot's, have further signals.
    """
    wires = parameters.wire_names
    bends = parameters.bend_suffixes
    joints = range(1, parameters.num_joints + 1)
    columns = {
        "time": ["time_s"],
        "duty": _names("duty_{}", wires),  # as commanded
        "applied_duty": _names("applied_duty_{}", wires),  # as the board reports it
        "board_time": ["board_time_s"],  # by the board's own clock
        "sample_age": ["sample_age_s"],  # since the sample arrived
        "measured_temperature": _names("measured_temperature_{}_c", wires),
        "bend_angle": _names("bend_angle{}_deg", bends),
        "reference": _names("reference_angle{}_deg", bends),
        "wire_temperature": _names("wire_temperature_{}_c", wires),
        "joint_state": [
            *_names("joint_angle_{}_deg", joints),
            *_names("joint_rate_{}_deg_s", joints),
        ],
    }
    # Wires have states other than T only with some laws.
    if others := LimbModel.of(parameters).wires.state_names[len(wires) :]:
        columns["other_wire_state"] = _names("wire_state_{}", others)
    return columns | (connected.signal_columns() if connected else {})


def _names(form: str, parts: Iterable[str | int]) -> list[str]:
    """Return the name of the column of each part."""
    return list(map(form.format, parts))


def signal(default: Any = dataclasses.MISSING) -> Any:
    """Return a field of `Samples` that is a signal, which has columns in files.

    Args:
        default: None if the signal may be None.
    """
    return dataclasses.field(default=default, metadata={"in_files": False, "signal": True})


def not_saved(default: Any) -> Any:
    """Return a field of `Samples` that is neither a signal nor in the header of files."""
    return dataclasses.field(default=default, metadata={"in_files": False})


def sample_rate(default: Any) -> Any:
    """Return the field of the samples' nominal rate, Hz."""
    metadata = {"in_files": "sample_rate_hz", "unit": "Hz", "range": (1e-6, 1e6)}
    return dataclasses.field(default=default, metadata=metadata)


class Samples(Summarized):
    """The base of `Recording`, `Trajectory` and `Gait`: a dataclass of signals and of a header.

    The signals are the columns of a file. All other fields are its header, except fields that
    are `not_saved`.
    """

    KIND: ClassVar[str]  # in the first line of the file
    MEASURED: ClassVar[tuple[str, ...]] = ()  # signals that may leave their range, or be missing
    HOLDS_DUTY: ClassVar[bool] = False  # whether duty is held from sample to sample, else linear
    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field]]

    time: np.ndarray
    duty: np.ndarray
    bend_angle: np.ndarray
    measured_temperature: np.ndarray
    parameters: LimbParameters
    robot: ConnectedLimbs | None = None
    provenance: Provenance | None
    interrupted = ""

    @classmethod
    def optional(cls) -> list[str]:
        """Return the names of the signals that may be None."""
        fields = dataclasses.fields(cls)
        return [f.name for f in fields if f.metadata.get("signal") and f.default is None]

    @classmethod
    def columns_of(
        cls, parameters: LimbParameters, robot: ConnectedLimbs | None
    ) -> dict[str, list[str]]:
        """Return `column_names` of the signals that these samples have."""
        signals = {field.name for field in dataclasses.fields(cls)} | {"bend_angle"}
        names = column_names(parameters, robot)
        return {name: names[name] for name in names if name in signals}

    @property
    def model(self) -> LimbModel:
        """The limb's model; a new one if the samples are given other parameters."""
        model = vars(self).get("_model")
        if model is None or model.parameters is not self.parameters:
            model = vars(self)["_model"] = LimbModel(self.parameters)
        return model

    def columns(self) -> dict[str, np.ndarray]:
        """Return the columns (K,) of the file, angles in rad, without signals that are None."""
        columns: dict[str, np.ndarray] = {}
        for name, group in self.columns_of(self.parameters, self.robot).items():
            value = getattr(self, name)
            if value is not None:
                columns.update(zip(group, np.atleast_2d(value), strict=True))
        return columns

    @classmethod
    def load(cls, path: str | Path, *, unfinished: bool = False) -> Self:
        """Load a file.

        Args:
            unfinished: whether a recording's file may lack its end, because the program
                that recorded was killed; it is then ``interrupted``.

        Raises:
            FileFormatError: one sentence that says what is wrong and where.
        """
        data = read_bytes(path, cls.KIND, LARGEST_TABLE, FileFormatError)
        with reraise_as(FileFormatError, f"{path}: "):
            table = parse_table(data, cls.KIND, unfinished=unfinished, readings=cls.MEASURED)
            return cls._from_table(table)

    @classmethod
    def from_text(cls, text: str) -> Self:
        """Parse the text of a file; errors as in `load`."""
        return cls._from_table(parse_table(text.encode(), cls.KIND, readings=cls.MEASURED))

    def to_text(self) -> str:
        """Return the text of the file; errors as in `save`."""
        return "".join(self._text())

    def save(self, path: str | Path) -> None:
        """Write the file whole or not at all.

        Raises:
            LimbError: if a value is not finite or there are too many, or if the check
                of a plan failed. A plan without a check is written, and its file says so.
        """
        count = len(self.time)
        # Show the progress between the parts.
        with Progress(f"writing {Path(path).name}", count, "samples") as progress:

            def parts() -> Iterator[str]:
                for number, part in enumerate(self._text()):
                    progress.update(min(number * ROWS_AT_ONCE, count))
                    yield part

            write_atomically(path, parts())

    def _text(self) -> Iterator[str]:
        """Yield the text of the file, in parts."""
        self._check()  # whatever was changed since the signals were given
        columns = self.columns()
        text = TableText(self.KIND, self.header(), columns)
        yield text.head
        for start in range(0, len(self.time), ROWS_AT_ONCE):
            part = slice(start, start + ROWS_AT_ONCE)
            yield text.rows({name: values[part] for name, values in columns.items()})
        yield text.end(self.interrupted)

    def header(self) -> str:
        """Return the YAML text of all fields that are neither signals nor `not_saved`."""
        header = copy.copy(self)
        if self.robot:
            header.parameters = None  # type: ignore[assignment]  # they follow from the robot
        return dump_typed(header)

    @classmethod
    def _from_table(cls, table: Table) -> Self:
        """Return the samples in a table; errors as in `load`."""
        # Read the header.
        header = load_fields(cls, table.header)
        robot = header.get("robot")
        described = robot or header.get("parameters")
        if described is None:
            raise FileFormatError("parameters is missing.")
        described.validate()
        # Check the columns against the description.
        groups = cls.columns_of(robot.as_single_limb if robot else described, robot)
        known_columns = set(itertools.chain(*groups.values()))
        for column in table.columns:
            if column not in known_columns:
                raise FileFormatError(f"the column {column} does not belong here.")
        # Stack the columns of each signal.
        values: dict[str, Any] = {"interrupted": table.interrupted}
        for name, group in groups.items():
            missing = [column for column in group if column not in table.columns]
            if not missing:
                rows = np.array([table.columns[column] for column in group])
                values[name] = rows[0] if name in TIMES else rows
            elif name not in cls.optional() or len(missing) < len(group):
                raise FileFormatError(f"the column {missing[0]} is missing.")
        # Bends of plans follow from joints and are no field; plans cannot be interrupted.
        fields = {field.name for field in dataclasses.fields(cls)}
        return cls(**header, **{name: values[name] for name in fields & values.keys()})

    def _check(self) -> None:
        """Convert the signals to arrays and check them.

        Raises:
            LimbError: if shapes disagree or values are not finite, if time does
                not increase, duty leaves [0, 1] or an angle leaves [-π, π].
        """
        self.parameters.validate()
        # Check the time.
        time = np.asarray(self.time, float)
        self.time = time
        if time.ndim != 1 or not np.isfinite(time).all():
            raise LimbError("time must be a list of finite numbers.")
        does_not_increase = np.diff(time) <= 0
        if does_not_increase.any():
            index = int(np.argmax(does_not_increase))
            raise LimbError(
                f"time goes from {time[index]:g} s to {time[index + 1]:g} s; it must increase."
            )
        # Check shape, finiteness and range of each other signal.
        names = column_names(self.parameters, self.robot)
        for field in dataclasses.fields(self):
            name = field.name
            value = getattr(self, name)
            is_left_out = value is None and name in self.optional()
            if name == "time" or name not in names or is_left_out:
                continue
            value = np.asarray(value, float)
            setattr(self, name, value)
            shape = (len(time),) if name in TIMES else (len(names[name]), len(time))
            if value.shape != shape:
                raise LimbError(
                    f"{name} has the shape {value.shape}, but this limb and the "
                    f"{len(time)} samples of time need {shape}."
                )
            is_measured = name in self.MEASURED
            is_bad = np.isinf(value) if is_measured else ~np.isfinite(value)
            if is_bad.any():
                first_time = time[np.argmax(np.atleast_2d(is_bad).any(axis=0))]
                raise LimbError(f"{name} holds a value that is not finite at {first_time:g} s.")
            if not is_measured and (sentence := self._first_outside([name])):
                raise LimbError(sentence)

    def _outside(self, names: Collection[str]) -> np.ndarray:
        """Return at which samples (K,) any of some signals leaves its range."""
        outside = np.zeros(len(self.time), bool)
        for name in names:
            low, high, _ = RANGES.get(name, (-np.inf, np.inf, ""))
            value = np.atleast_2d(getattr(self, name))
            outside |= ((value < low) | (value > high)).any(axis=0)
        return outside

    def _first_outside(self, names: Collection[str]) -> str:
        """Return a sentence on the first sample where a signal leaves its range; empty if none."""
        for name in names:
            is_outside = self._outside([name])
            if is_outside.any():
                low, high, unit = RANGES[name]
                index = int(np.argmax(is_outside))
                value = np.atleast_2d(getattr(self, name))[:, index].tolist()
                return (
                    f"{name} is {value}{unit} at {self.time[index]:g} s; "
                    f"it must stay from {low:g} to {high:g}{unit}."
                )
        return ""

    @property
    def origin(self) -> str:
        """A caption: the source of the joint angles that a picture of the limb shows."""
        raise NotImplementedError

    def for_replay(self) -> Self:
        """Return the motion that a page replays."""
        return self

    @property
    def duration(self) -> float:
        """The time from the first to the last sample, s."""
        return float(self.time[-1] - self.time[0])

    def interpolated(self, signal: ArrayLike, times: np.ndarray | float) -> np.ndarray:
        """Return a signal (rows, K) at other times (M,), (rows, M), leaving out missing samples."""
        rows = np.asarray(signal, float)
        is_present = ~np.isnan(rows).any(axis=0)
        sample_times = self.time[is_present]
        return np.array([np.interp(times, sample_times, row[is_present]) for row in rows])

    def _bend_entry(self) -> Entry:
        """Return the range of the bend angles as an entry of the summary."""
        low, high = np.rad2deg([np.nanmin(self.bend_angle), np.nanmax(self.bend_angle)]).tolist()
        return Entry("motion", [low, high], "°", f"bend {low:.0f}° to {high:.0f}°")


class Planned(Samples):
    """The base of plans: joints are given, and bends follow from them."""

    check: Any  # with ``failure`` and ``is_missing``
    joint_state: np.ndarray
    wire_temperature: np.ndarray
    other_wire_state: np.ndarray | None

    def duty_trajectory(self) -> PiecewisePolynomial:
        """Return the duty between the knots, for a `TrajectorySource`."""
        raise NotImplementedError

    @property
    def joint_angles(self) -> np.ndarray:
        """θ at the knots (n, K), rad."""
        return self.joint_state[: self.parameters.num_joints]

    @property
    def joint_rates(self) -> np.ndarray:
        """θ̇ at the knots (n, K), rad/s."""
        return self.joint_state[self.parameters.num_joints :]

    @property
    def bend_angle(self) -> np.ndarray:  # type: ignore[override]
        """φ* at the knots (F, K), rad, by forward kinematics."""
        return bend_angle(self.model, self.joint_angles)

    @property
    def passed(self) -> bool:
        """True if a simulation of the plan agreed with it."""
        return self.check.failure() is None

    @property
    def _check_entry(self) -> Entry:
        """The result of the plan's check, as an entry of the summary."""
        judged = "passed its check" if self.passed else "failed its check"
        return Entry("check", "not checked" if self.check.is_missing else judged)

    @property
    def wire_states(self) -> np.ndarray:
        """x at the knots (N, K): T, then the other states of the wires' laws."""
        others = [] if self.other_wire_state is None else [self.other_wire_state]
        return np.vstack([self.wire_temperature, *others])


def stretches(where: np.ndarray) -> np.ndarray:
    """Return the first index of each stretch of True, and the index after its last (S, 2)."""
    return np.flatnonzero(np.diff(np.r_[False, where, False])).reshape(-1, 2)


def doses(levels: np.ndarray, breaks: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return integrals (W, E), from end to end (E + 1,), of levels (W, K) held from break to break.

    Args:
        levels: one value for each interval between breaks (W, K).
        breaks: times between which levels hold (K + 1,), s.
        ends: times between which to integrate (E + 1,), s.
    """
    sums = np.cumsum(levels * np.diff(breaks), axis=1)
    return np.diff([np.interp(ends, breaks, np.append(0.0, of_row)) for of_row in sums])


def clip_rounding(duty: np.ndarray) -> np.ndarray:
    """Clip duty that is outside [0, 1] by rounding; keep larger excess for an error message."""
    clipped = np.clip(duty, 0.0, 1.0)
    return clipped if np.abs(clipped - duty).max() < 1e-9 else duty
