"""The signals of a limb over time: their sizes, their limits, their columns in files.

A signal is an array (size, K), a column for each of K samples, as Drake logs
them; times are (K,). Recordings and trajectories are made of these.
"""

import dataclasses
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.files.tables import FileFormatError
from limb_systems.model.parameters import LimbParameters
from limb_systems.model.wires import Wires

_UNITS = {  # in files
    "time": "s",
    "duty": "1",
    "applied_duty": "1",
    "board_time": "s",
    "sample_age": "s",
    "measured_temperature": "°C",
    "bend_angle": "°",
    "reference": "°",
    "wire_temperature": "°C",
    "joint_state": "°",
}
TIMES = ("time", "board_time", "sample_age")  # signals with one number for each sample


def column_names(parameters: LimbParameters) -> dict[str, list[str]]:
    """For each signal the names of its columns; the unit is in the name.

    Signals of joints are split into angles and rates. Columns of wires have the
    wires' names; with several segments, the number of the segment follows. The
    signal ``other_wire_state`` is there only if wires have states other than T.
    """
    wires, suffixes = parameters.wire_names, parameters.segment_suffixes
    joints = range(1, parameters.num_joints + 1)
    others = Wires(parameters).state_names[len(wires) :]
    return {
        "time": ["time_s"],
        "duty": [f"duty_{wire}" for wire in wires],
        "applied_duty": [f"applied_duty_{wire}" for wire in wires],
        "board_time": ["board_time_s"],
        "sample_age": ["sample_age_s"],
        "measured_temperature": [f"measured_temperature_{wire}_c" for wire in wires],
        "bend_angle": [f"bend_angle{suffix}_deg" for suffix in suffixes],
        "reference": [f"reference_angle{suffix}_deg" for suffix in suffixes],
        "wire_temperature": [f"wire_temperature_{wire}_c" for wire in wires],
        "joint_state": [f"joint_angle_{i}_deg" for i in joints]
        + [f"joint_rate_{i}_deg_s" for i in joints],
        **({"other_wire_state": [f"wire_state_{name}" for name in others]} if others else {}),
    }


def column_units(parameters: LimbParameters) -> dict[str, str]:
    """The unit of each column in files; empty for states of wires, which their laws define."""
    units: dict[str, str] = {}
    for signal, names in column_names(parameters).items():
        unit = _UNITS.get(signal, "")
        units |= {name: "°/s" if name.startswith("joint_rate") else unit for name in names}
    return units


def columns_of(kind: type, parameters: LimbParameters) -> dict[str, list[str]]:
    """`column_names` of the signals that a class of samples has."""
    signals = {field.name for field in dataclasses.fields(kind)} | {"bend_angle"}
    return {name: names for name, names in column_names(parameters).items() if name in signals}


def check_samples(
    samples: Any, optional: Collection[str] = (), measured: Collection[str] = ()
) -> None:
    """Turns the signals of an object into arrays and checks them.

    Args:
        samples: a dataclass with ``parameters``, ``time`` (K,) and some of
            the signals.
        optional: the signals that may be None.
        measured: the signals that may leave their range, because what was
            measured is what it is, and be nan where a sample is missing.

    Raises:
        LimbError: if shapes disagree or values are not finite, if time does
            not increase, duty leaves [0, 1] or an angle leaves [-π, π].
    """
    samples.time = np.asarray(samples.time, float)
    names = column_names(samples.parameters)
    for name in (field.name for field in dataclasses.fields(samples)):
        value = getattr(samples, name)
        if name == "time" or name not in names or (value is None and name in optional):
            continue
        columns, value = names[name], np.asarray(value, float)
        setattr(samples, name, value)
        shape = (len(columns), len(samples.time))[name in TIMES :]
        if value.shape != shape:
            raise LimbError(
                f"{name} has the shape {value.shape}, but this limb and the "
                f"{len(samples.time)} samples of time need {shape}."
            )
        if (np.isinf(value) if name in measured else ~np.isfinite(value)).any():
            raise LimbError(f"{name} holds values that are not finite.")
        if name not in measured and samples_outside(samples, [name]).any():
            raise LimbError(first_outside(samples, [name]))
    if not np.isfinite(samples.time).all() or (np.diff(samples.time) <= 0).any():
        raise LimbError("time must be finite and increasing.")


def group_columns(
    columns: Mapping[str, np.ndarray],
    names: Mapping[str, list[str]],
    optional: Collection[str] = (),
) -> dict[str, np.ndarray]:
    """The signals (size, K) that a table's columns make up; those in `TIMES` are (K,).

    Raises:
        FileFormatError: if a column is missing or belongs to no signal.
    """
    known = {column for group in names.values() for column in group}
    for column in columns:
        if column not in known:
            raise FileFormatError(f"the column {column} does not belong here.")
    signals = {}
    for name, group in names.items():
        missing = [column for column in group if column not in columns]
        if not missing:
            signals[name] = np.array([columns[column] for column in group])
        elif name not in optional or len(missing) < len(group):
            raise FileFormatError(f"the column {missing[0]} is missing.")
    return {name: signal[0] if name in TIMES else signal for name, signal in signals.items()}


def ungroup_columns(samples: Any, names: Mapping[str, list[str]]) -> dict[str, np.ndarray]:
    """The columns of an object's signals, without those that are None."""
    columns: dict[str, np.ndarray] = {}
    for name, group in names.items():
        value = getattr(samples, name)
        if value is not None:
            columns.update(zip(group, np.atleast_2d(value), strict=True))
    return columns


def without_rounding(duty: np.ndarray) -> np.ndarray:
    """Duty within rounding of [0, 1] brought into it; more is a mistake, and left to be named."""
    clipped = np.clip(duty, 0.0, 1.0)
    return clipped if np.abs(clipped - duty).max() < 1e-9 else duty


def bend_range(bend_angle: np.ndarray) -> str:
    """The range of bend angles (S, K), rad, in words and degrees."""
    low, high = np.rad2deg([np.nanmin(bend_angle), np.nanmax(bend_angle)])
    return f"bend {low:.0f}° to {high:.0f}°"


# A value outside these is a mistake, of units or of a sensor.
_RANGES = {
    "duty": (0.0, 1.0, ""),
    "applied_duty": (0.0, 1.0, ""),
    "sample_age": (0.0, np.inf, " s"),
    "measured_temperature": (-60.0, 600.0, " °C"),
    "wire_temperature": (-60.0, 600.0, " °C"),
    "bend_angle": (-np.pi, np.pi, " rad"),
}


def samples_outside(samples: Any, names: Collection[str]) -> np.ndarray:
    """Whether some of an object's signals leave their ranges, at each sample (K,)."""
    outside = np.zeros(len(samples.time), bool)
    for name in names:
        low, high, _ = _range(name)
        value = np.atleast_2d(getattr(samples, name))
        outside |= ((value < low) | (value > high)).any(axis=0)
    return outside


def first_outside(samples: Any, names: Collection[str]) -> str:
    """One sentence on the first sample at which some signals leave their ranges."""
    index = int(np.argmax(samples_outside(samples, names)))
    for name in names:
        low, high, unit = _range(name)
        value = np.atleast_2d(getattr(samples, name))[:, index]
        if ((value < low) | (value > high)).any():
            return (
                f"{name} is {value.tolist()}{unit} at {samples.time[index]:g} s; "
                f"it must stay from {low:g} to {high:g}{unit}."
            )
    raise AssertionError("all signals are in their ranges")


def _range(name: str) -> tuple[float, float, str]:
    return _RANGES.get(name, (-np.inf, np.inf, ""))
