"""Many limbs at once: draws from the covariance of a calibration, and their open-loop simulation.

Heat and torque are those of the wires' laws. The limb follows its wires without
delay: it rings at some hertz, and they heat within seconds. On a segment
without gravity all joints turn alike, and each bend sensor then reads φ.
"""

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from limb_systems.limb_parameters import (
    LimbParameters,
    ParameterError,
    RestMemory,
    SegmentParameters,
)
from limb_systems.rubber import ramp
from limb_systems.wire_laws.wire_law import WireLaw, runge_kutta

STEPS = 1, 2, 4  # in each step, until none diverges
DIVERGED_TEMPERATURE = 1e4  # °C, beyond which a simulation has diverged


def draw_limbs(parameters: LimbParameters, count: int) -> list[LimbParameters]:
    """Limbs with parameters around the calibrated ones, as likely as their covariance says.

    Quantities that cannot change their sign are drawn in their logarithms. The limbs are the same
    in each call.

    Args:
        parameters: with a `CalibrationRecord`, of one segment.
        count: number of limbs.

    Raises:
        ParameterError: if the limb is not calibrated, or the record names what it has not.
    """
    record = parameters.calibration
    if record is None:
        raise ParameterError(
            "This limb is not calibrated, so that nothing says how well known it is."
        )
    owners = [parameter_owner(parameters, name) for name in record.names]
    values, covariance = np.array(record.values), np.array(record.covariance)
    ranges = np.array([_range(owner, name) for owner, name in owners])
    signed = (ranges[:, 0] > 0) | (ranges[:, 1] < 0)
    scale = np.where(signed, values, 1.0)
    roots, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    generator = np.random.default_rng(0)
    normal = generator.standard_normal((count, len(values)))
    steps = (normal * np.sqrt(np.maximum(roots, 0.0))) @ axes.T
    drawn = np.where(signed, values * np.exp(np.clip(steps, -3.0, 3.0)), values + steps)
    result = []
    plain = dataclasses.replace(parameters, calibration=None)  # whose record takes long to copy
    for numbers in np.clip(drawn, ranges[:, 0], ranges[:, 1]):
        limb = copy.deepcopy(plain)
        limb.calibration = record
        for name, number in zip(record.names, numbers, strict=True):
            owner, field = parameter_owner(limb, name)
            setattr(owner, field, float(number))
        result.append(limb)
    return result


def stack_limbs(
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


def parameter_owner(parameters: LimbParameters, name: str) -> tuple[Any, str]:
    """The object whose field an estimate is of, such as a wire's law, and the field's name.

    Args:
        name: name of the estimate in a `CalibrationRecord`.

    Raises:
        ParameterError: if the limb has no such field.
    """
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
        lengths: number of steps of each run (R,), after which its states stay; K if None.
    """

    def __init__(
        self,
        duty: np.ndarray,
        step: float,
        segment: SegmentParameters,
        lengths: Sequence[int] | None = None,
    ):
        self.step, self._chain = step, segment.chain
        ends = np.full(duty.shape[1], len(duty)) if lengths is None else np.asarray(lengths)
        # The longest first, so that those that go on are the first ones.
        self._order = np.argsort(-ends, kind="stable")
        self._duty = np.ascontiguousarray(duty[:, self._order])
        self._going_on = (ends > np.arange(len(duty))[:, None]).sum(axis=1).tolist()
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
        start = np.array(initial)
        room = _broadcast_copy(ambient[..., None], start.shape[1:])
        # Sets that differ in other wires alone heat a wire alike, and it is simulated once.
        distinct, which = _distinct_sets(law, room, start)
        own, own_room = (
            _map_fields(law, lambda f: _select_sets(f, distinct)),
            _select_sets(room, distinct),
        )
        heat = self._heat(
            own, own_room[:, self._order], _select_sets(start, distinct)[..., self._order, :]
        )[..., np.argsort(self._order), :]
        states = list(np.moveaxis(heat[:, :-1], 1, 0))
        torques = _select_sets(np.asarray(own.torque(states, own_room, 0.0)), which)
        bent = None
        if np.isnan(own.torque([state[0] for state in states], own_room, np.nan)).any():

            def bent(number: int, theta: np.ndarray) -> np.ndarray:
                course = _select_sets(heat[number, :-1], which)
                return np.asarray(
                    law.torque(list(course), room, theta[..., None] * self._directions)
                )

        bends = self._bends(torques, rubber, bent)
        return _select_sets(heat[:, 0], which), _select_sets(heat[:, -1], which), bends

    def _heat(self, law: WireLaw, room: np.ndarray, heat: np.ndarray) -> np.ndarray:
        """States of the wires and V (K + 1, X + 1, B, R, W) from the start, runs in their order.

        A law whose heat, stress and transformation act on each other may be too fast for the step.
        If a set diverges by it, all are simulated again in shorter steps, alike, as they are
        compared with each other.
        """
        for per_step in STEPS:
            with np.errstate(over="ignore", invalid="ignore"):
                course = self._heat_in_steps(law, room, heat, per_step)
            if (np.abs(course) < DIVERGED_TEMPERATURE).all():
                break
        return course

    def _heat_in_steps(
        self, law: WireLaw, room: np.ndarray, heat: np.ndarray, per_step: int
    ) -> np.ndarray:
        """The same, by so many shorter steps in each step."""
        course = np.empty((len(self._duty) + 1, *heat.shape))
        course[0] = heat
        remembered = {
            row: law.memory[state]
            for row, state in enumerate(law.states)
            if np.isfinite(law.memory.get(state, np.inf)).any()
        }
        _clamp_memory(remembered, course[0])
        going_on = None
        for number, levels in enumerate(self._duty):
            if going_on != self._going_on[number]:
                going_on = self._going_on[number]
                heat = np.ascontiguousarray(course[number, ..., :going_on, :])
                rates, shape = self._heat_rates(law, room[:, :going_on]), heat.shape[1:]
            duty = _broadcast_copy(levels[:going_on], shape)
            for _ in range(per_step):
                heat = runge_kutta(rates, heat, (duty, duty, duty), self.step / per_step)
                _clamp_memory(remembered, heat)
            course[number + 1, ..., :going_on, :] = heat
            course[number + 1, ..., going_on:, :] = course[number, ..., going_on:, :]
        return course

    @staticmethod
    def _heat_rates(
        law: WireLaw, room: np.ndarray
    ) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        # All of one shape, because numpy takes half as long again to stretch small arrays.
        room = np.ascontiguousarray(room)
        law = _map_fields(law, lambda field: _broadcast_copy(field, room.shape))

        def heat_rates(heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
            rates, x = np.empty_like(heat), list(heat[:-1])
            for row, rate in zip(rates, law.rates(x, duty, room), strict=False):
                row[...] = rate
            rates[-1] = law.reading_rate(heat[-1], x)
            return rates

        return heat_rates

    def _bends(
        self,
        torques: np.ndarray,
        rubber: Mapping[str, np.ndarray],
        bent: Callable[[int, np.ndarray], np.ndarray] | None,
    ) -> np.ndarray:
        """φ (K + 1, B, R), rad.

        Args:
            torques: of the wires on straight links (K + 1, B, R, W), N·m.
            rubber: as for `simulate`.
            bent: torques (B, R, W) on links at angles θ (B, R), rad, of a number of steps; None
                if they do not depend on θ.
        """
        to_bend = self._chain.bend_by_equal_angle  # (11)
        stiffness, rest = rubber["stiffness"][:, None], rubber["rest_angle"][:, None]
        torques = torques * self._directions
        if bent is None and not rubber.keys() & {"stiffening", "shift"}:
            return rest + to_bend * (torques.sum(axis=-1) / stiffness)
        bends = np.empty(torques.shape[:-1])
        angle = np.zeros(bends.shape[1:])  # of each joint, from rest
        alone = np.zeros(torques.shape[1:])  # bend angle that each wire would hold alone
        shift = np.zeros(bends.shape[1:])  # of the rest angle by its memory
        for number, held in enumerate(torques):
            if bent is not None:
                held = bent(number, angle + rest / to_bend) * self._directions
            before, alone = alone, to_bend / stiffness[..., None] * np.abs(held)
            if "shift" in rubber and number:
                progress = self.step * ramp((alone - before) / self.step)
                towards = rubber["shift"][:, None] * (progress * self._sides).sum(axis=-1)
                pace = rubber["rate"][:, None]
                shift = (shift + pace * towards) / (1 + pace * progress.sum(axis=-1))
            pull = held.sum(axis=-1) / stiffness + shift / to_bend
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
    together = law()
    for name, values in fields.items():
        setattr(together, name, values)
    return together


def _distinct_sets(
    law: WireLaw, room: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sets (C, W) that differ in what heats each wire, and which of them each set is (B, W)."""
    fields = [value for value in vars(law).values() if isinstance(value, np.ndarray)]
    num_sets = len(room)
    found = []
    for wire in range(room.shape[-1]):
        parts = [*fields, room, *start]
        rows = np.hstack([part[..., wire].reshape(num_sets, -1) for part in parts])
        found.append(np.unique(rows, axis=0, return_index=True, return_inverse=True)[1:])
    distinct = np.zeros((max(len(first) for first, _ in found), len(found)), int)
    for wire, (first, _) in enumerate(found):
        distinct[: len(first), wire] = first
    return distinct, np.stack([which.reshape(-1) for _, which in found], axis=-1)


def _select_sets(array: np.ndarray, which: np.ndarray) -> np.ndarray:
    """An array (..., B, R, W) of other sets (C, W) of each wire, as (..., C, R, W)."""
    return np.stack(
        [array[..., wire].take(sets, axis=-2) for wire, sets in enumerate(which.T)], axis=-1
    )


def _map_fields(law: WireLaw, change: Callable[[np.ndarray], np.ndarray]) -> WireLaw:
    arrays = {n: change(value) for n, value in vars(law).items() if isinstance(value, np.ndarray)}
    return with_fields(type(law), {**vars(law), **arrays})


def _broadcast_copy(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    return np.ascontiguousarray(np.broadcast_to(array, shape))


def _clamp_memory(remembered: Mapping[int, tuple[float, float]], heat: np.ndarray) -> None:
    """Keeps what the law remembers in its range: starts and long steps may be beyond."""
    for row, bounds in remembered.items():
        np.clip(heat[row], *bounds, out=heat[row])
