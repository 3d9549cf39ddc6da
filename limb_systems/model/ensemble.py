"""Limbs that a calibration cannot tell apart: draws from the covariance of its estimates."""

import copy
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from limb_systems.model.open_loop import with_fields
from limb_systems.model.parameters import LimbParameters, ParameterError, RestMemory
from limb_systems.model.wire_law import WireLaw


def draw_ensemble(parameters: LimbParameters, count: int, seed: int = 0) -> list[LimbParameters]:
    """Limbs with parameters around the calibrated ones, as likely as their covariance says.

    Quantities that cannot change their sign are drawn in their logarithms.

    Args:
        parameters: with a `CalibrationRecord`, of one segment.
        count: of the limbs.
        seed: of the draws.

    Raises:
        ParameterError: if the limb is not calibrated, or the record names what it has not.
    """
    record = parameters.calibration
    if record is None:
        raise ParameterError(
            "This limb is not calibrated, so that nothing says how well known it is."
        )
    owners = [_owner(parameters, name) for name in record.names]
    values, covariance = np.array(record.values), np.array(record.covariance)
    ranges = np.array([_range(owner, name) for owner, name in owners])
    signed = (ranges[:, 0] > 0) | (ranges[:, 1] < 0)
    scale = np.where(signed, values, 1.0)
    roots, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    generator = np.random.default_rng(seed)
    normal = generator.standard_normal((count, len(values)))
    steps = (normal * np.sqrt(np.maximum(roots, 0.0))) @ axes.T
    drawn = np.where(signed, values * np.exp(np.clip(steps, -3.0, 3.0)), values + steps)
    result = []
    for numbers in np.clip(drawn, ranges[:, 0], ranges[:, 1]):
        limb = copy.deepcopy(parameters)
        for name, number in zip(record.names, numbers, strict=True):
            owner, field = _owner(limb, name)
            setattr(owner, field, float(number))
        result.append(limb)
    return result


def stacked(
    limbs: Sequence[LimbParameters],
) -> tuple[WireLaw, np.ndarray, dict[str, np.ndarray]]:
    """B limbs of one segment with laws of one class, as `OpenLoop` takes them.

    Returns:
        The law with fields (B, 1, W), T0 (B,), °C, and the rubber.

    Raises:
        ParameterError: if laws are of several classes.
    """
    segments = [limb.segments[0] for limb in limbs]
    kinds = {type(wire.law) for segment in segments for wire in segment.wires}
    if len(kinds) > 1:
        names = " and ".join(sorted(kind.__name__ for kind in kinds))
        raise ParameterError(f"The wires have laws of several classes, {names}; use one for all.")
    (kind,) = kinds
    fields = {
        field.name: np.array(
            [[[getattr(wire.law, field.name) for wire in segment.wires]] for segment in segments]
        )
        for field in dataclasses.fields(kind)  # type: ignore[arg-type]
    }
    properties = ["stiffness", "rest_angle"]
    properties += ["stiffening"] if any(segment.stiffening for segment in segments) else []
    rubber = {name: np.array([getattr(s, name) for s in segments]) for name in properties}
    memories = [segment.rest_memory for segment in segments if segment.rest_memory]
    if memories:
        rubber["shift"] = np.array([memory.shift for memory in memories])
        rubber["rate"] = np.array([memory.rate for memory in memories])
    ambient = np.array([limb.ambient_temperature for limb in limbs])
    return with_fields(kind, fields), ambient, rubber


def _owner(parameters: LimbParameters, name: str) -> tuple[Any, str]:
    """What has the field that an estimate is of, and the field's name."""
    segment = parameters.segments[0]
    before, _, field = name.rpartition(".")
    owners: Sequence[Any] = (parameters, segment)
    if before == "rest_memory":
        owners = [segment.rest_memory or RestMemory()]
    elif before:
        owners = [wire.law for wire in segment.wires if wire.name == before]
    for owner in owners:
        if hasattr(owner, field):
            return owner, field
    raise ParameterError(
        f"The calibration names {name}, which this limb does not have; calibrate it again."
    )


def _range(owner: Any, name: str) -> tuple[float, float]:
    (field,) = (field for field in dataclasses.fields(owner) if field.name == name)
    return field.metadata["range"]
