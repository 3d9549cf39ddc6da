"""Many limbs at once: draws from the covariance of a calibration, and their open-loop simulation.

Heat and torque are those of the wires' laws. The limb follows its wires without
delay: it rings at some hertz, and they heat within seconds. On a segment
without gravity all joints turn alike, and each bend sensor then reads φ.
"""

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from limb_systems.model.parameters import (
    LimbParameters,
    ParameterError,
    RestMemory,
    SegmentParameters,
)
from limb_systems.model.rubber import ramp
from limb_systems.model.wire_law import WireLaw, runge_kutta


def draw_ensemble(parameters: LimbParameters, count: int, seed: int = 0) -> list[LimbParameters]:
    """Limbs with parameters around the calibrated ones, as likely as their covariance says.

    Quantities that cannot change their sign are drawn in their logarithms.

    Args:
        parameters: with a `CalibrationRecord`, of one segment.
        count: number of limbs.
        seed: seed of the draws.

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
    plain = dataclasses.replace(parameters, calibration=None)  # whose record takes long to copy
    for numbers in np.clip(drawn, ranges[:, 0], ranges[:, 1]):
        limb = copy.deepcopy(plain)
        limb.calibration = record
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
    elif before == "bend_sensor":
        owners = [segment.bend_sensor]
    elif before:
        owners = [
            owner for wire in segment.wires if wire.name == before for owner in (wire.law, wire)
        ]
    for owner in owners:
        if hasattr(owner, field):
            return owner, field
    raise ParameterError(
        f"The calibration names {name}, which this limb does not have; calibrate it again."
    )


def _range(owner: Any, name: str) -> tuple[float, float]:
    fields = {field.name: field for field in dataclasses.fields(owner)}
    return fields[name].metadata["range"] if name in fields else (-np.inf, np.inf)


class OpenLoop:
    """R runs of one segment of W wires, over K steps.

    Arrays begin with B, the number of sets of parameters that are simulated at
    once, where they differ between these.

    Args:
        duty: its mean over each step (K, R, W), in [0, 1].
        step: s.
        segment: whose links and wires' directions count.
    """

    def __init__(self, duty: np.ndarray, step: float, segment: SegmentParameters):
        self._duty, self.step, self._chain = duty, step, segment.chain
        self._directions = np.array([wire.lever[0] for wire in segment.wires])
        self._sides = np.sign(self._directions)

    def simulate(
        self,
        law: WireLaw,
        ambient: np.ndarray,
        initial: Sequence[np.ndarray],
        rubber: Mapping[str, np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """T, V and φ at the ends of the steps, by the classical Runge-Kutta method.

        Args:
            law: with fields of shape (B, 1, W).
            ambient: T0 of each run (B, R), °C.
            initial: states of the wires, then V, at the start, each (B, R, W).
            rubber: ``stiffness``, N·m/rad, and ``rest_angle``, rad, each (B,);
                optionally ``stiffening``, and ``shift``, rad, and ``rate``,
                1/rad, of the rest angle's memory.

        Returns:
            T and V (K + 1, B, R, W), °C, and φ (K + 1, B, R), rad.
        """
        heat = np.array(initial)
        # All of one shape, because numpy takes half as long again to stretch small arrays.
        every = heat.shape[1:]
        law, room = _stretched(law, every), _full(ambient[..., None], every)
        _keep_within(law, heat)

        def heat_rates(heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
            rates, x = np.empty_like(heat), list(heat[:-1])
            for row, rate in zip(rates, law.rates(x, duty, room), strict=False):
                row[...] = rate
            rates[-1] = law.reading_rate(heat[-1], x)
            return rates

        course = np.empty((len(self._duty) + 1, *heat.shape))
        course[0] = heat
        for number, levels in enumerate(self._duty):
            duty = _full(levels, every)
            heat = runge_kutta(heat_rates, heat, (duty, duty, duty), self.step)
            _keep_within(law, heat)
            course[number + 1] = heat
        return course[:, 0], course[:, -1], self._bends(law, room, course[:, :-1], rubber)

    def _bends(
        self, law: WireLaw, room: np.ndarray, course: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """φ (K + 1, B, R), rad, while the wires are in states (K + 1, X, B, R, W)."""
        bends = np.empty((*course.shape[:1], *course.shape[2:4]))
        to_bend = self._chain.bend_by_equal_angle  # (11)
        stiffness, rest = rubber["stiffness"][:, None], rubber["rest_angle"][:, None]
        angle = np.zeros(bends.shape[1:])  # of each joint, from rest
        alone = np.zeros(course.shape[2:])  # bend angle that each wire would hold alone
        shift = np.zeros(bends.shape[1:])  # of the rest angle by its memory
        for number, states in enumerate(course):
            theta = (angle + rest / to_bend)[..., None]
            torques = law.torque(list(states), room, theta) * self._directions
            before, alone = alone, to_bend / stiffness[..., None] * np.abs(torques)
            if "shift" in rubber and number:
                progress = self.step * ramp((alone - before) / self.step)
                towards = rubber["shift"][:, None] * (progress * self._sides).sum(axis=-1)
                pace = rubber["rate"][:, None]
                shift = (shift + pace * towards) / (1 + pace * progress.sum(axis=-1))
            pull = torques.sum(axis=-1) / stiffness + shift / to_bend
            angle = self._at_rest(pull, angle, rubber)
            bends[number] = rest + to_bend * angle
        return bends

    def _at_rest(
        self, pull: np.ndarray, angle: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Joint angle that a torque over k holds, from the angle before, by Newton's method."""
        if "stiffening" not in rubber:
            return pull
        at_45 = np.pi / 4 / self._chain.bend_by_equal_angle
        cubic = rubber["stiffening"][:, None] / at_45**2
        for _ in range(2):
            excess = angle + cubic * angle**3 - pull
            angle = angle - excess / (1 + 3 * cubic * angle**2)
        return angle


def with_fields(law: type[WireLaw], fields: Mapping[str, np.ndarray]) -> WireLaw:
    """A law of a class with arrays for fields, for calculations alone."""
    together = copy.copy(law())
    for name, values in fields.items():
        setattr(together, name, values)
    return together


def _stretched(law: WireLaw, shape: tuple[int, ...]) -> WireLaw:
    arrays = {name: value for name, value in vars(law).items() if isinstance(value, np.ndarray)}
    return with_fields(type(law), {**vars(law), **{n: _full(a, shape) for n, a in arrays.items()}})


def _full(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    return np.ascontiguousarray(np.broadcast_to(array, shape))


def _keep_within(law: WireLaw, heat: np.ndarray) -> None:
    """Keeps what the law remembers in its range: starts and long steps may be beyond."""
    for row, state in zip(heat, law.states, strict=False):
        if np.isfinite(law.memory.get(state, np.inf)).any():
            np.clip(row, *law.memory[state], out=row)
