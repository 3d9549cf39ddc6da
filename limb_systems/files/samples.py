"""The signals of a limb over time: their sizes, their limits, their columns in files.

A signal is an array (size, K), a column for each of K samples, as Drake logs
them. Recordings and trajectories are made of these.
"""

import dataclasses
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.files.tables import FileFormatError
from limb_systems.model.parameters import LimbParameters
from limb_systems.model.wires import Wires


def column_names(parameters: LimbParameters) -> dict[str, list[str]]:
    """For each signal the names of its columns; the unit is in the name.

    Signals of joints are split in angles and rates, wires go by their names,
    and where there are several segments their number follows. Only wires with
    other states than their temperature have the signal ``other_wire_state``.
    """
    wires, suffixes = parameters.wire_names, parameters.segment_suffixes
    joints = range(1, parameters.num_joints + 1)
    others = Wires(parameters).state_names[len(wires) :]
    return {
        "time": ["time_s"],
        "duty": [f"duty_{wire}" for wire in wires],
        "measured_temperature": [f"measured_temperature_{wire}_c" for wire in wires],
        "bend_angle": [f"bend_angle{suffix}_deg" for suffix in suffixes],
        "reference": [f"reference_angle{suffix}_deg" for suffix in suffixes],
        "wire_temperature": [f"wire_temperature_{wire}_c" for wire in wires],
        "joint_state": [f"joint_angle_{i}_deg" for i in joints]
        + [f"joint_rate_{i}_deg_s" for i in joints],
        **({"other_wire_state": [f"wire_state_{name}" for name in others]} if others else {}),
    }


def check_samples(samples: Any, optional: Collection[str] = ()) -> None:
    """Turns the signals of an object into arrays and checks them.

    Args:
        samples: a dataclass with ``parameters``, ``time`` (K,) and some of
            the signals.
        optional: the signals that may be None.

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
        if value.shape != (len(columns), len(samples.time)):
            raise LimbError(
                f"{name} has the shape {value.shape}, but this limb and the "
                f"{len(samples.time)} samples of time need {(len(columns), len(samples.time))}."
            )
        if not np.isfinite(value).all():
            raise LimbError(f"{name} holds values that are not finite.")
        _check_range(samples, name, value)
    if not np.isfinite(samples.time).all() or (np.diff(samples.time) <= 0).any():
        raise LimbError("time must be finite and increasing.")


def group_columns(
    columns: Mapping[str, np.ndarray],
    names: Mapping[str, list[str]],
    optional: Collection[str] = (),
) -> dict[str, np.ndarray]:
    """The signals (size, K) that a table's columns make up; time is (K,).

    Raises:
        FileFormatError: if a column is missing or none of these signals'.
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
    signals["time"] = signals["time"][0]
    return signals


def ungroup_columns(samples: Any, names: Mapping[str, list[str]]) -> dict[str, np.ndarray]:
    """The columns of an object's signals, without those that are None."""
    columns: dict[str, np.ndarray] = {}
    for name, group in names.items():
        value = getattr(samples, name)
        if value is not None:
            columns.update(zip(group, np.atleast_2d(value), strict=True))
    return columns


# Beyond these a value is a mistake, of units most often, in any recording.
_RANGES = {
    "duty": (0.0, 1.0, ""),
    "measured_temperature": (-60.0, 600.0, " °C"),
    "wire_temperature": (-60.0, 600.0, " °C"),
    "bend_angle": (-np.pi, np.pi, " rad"),
}


def _check_range(samples, name: str, value: np.ndarray) -> None:
    low, high, unit = _RANGES.get(name, (-np.inf, np.inf, ""))
    outside = ((value < low) | (value > high)).any(axis=0)
    if outside.any():
        index = int(np.argmax(outside))
        raise LimbError(
            f"{name} is {value[:, index].tolist()}{unit} at {samples.time[index]:g} s; "
            f"it must stay from {low:g} to {high:g}{unit}."
        )
