"""Many limbs at once: draws from the covariance of a calibration, and their open-loop simulation.

Heat and torque follow the laws of the wires. The limb follows its wires without
delay: it rings at some hertz, and they heat within seconds. On a segment
without gravity all joints have the same angle, and each bend sensor reads φ.
"""

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from limb_systems.limb_parameters import (
    LimbParameters,
    ParameterError,
    RestMemory,
    SegmentParameters,
)
from limb_systems.rubber import ramp
from limb_systems.smooth_function import Compiled, build_once
from limb_systems.wire_laws.wire_law import WireLaw, runge_kutta

NUM_SUBSTEPS = (1, 2, 4)  # tried in this order until no simulation diverges
DIVERGED_TEMPERATURE = 1e4  # °C, beyond which a simulation has diverged


def draw_limbs(parameters: LimbParameters, count: int) -> list[LimbParameters]:
    """Draw limbs from the covariance of a calibration.

    Quantities that cannot change their sign are drawn in their logarithms. The limbs are the same
    in each call.

    Args:
        parameters: with a `CalibrationRecord`, of one segment.
        count: number of limbs.

    Raises:
        ParameterError: if the limb is not calibrated, or if the record names a parameter that the
            limb does not have.
    """
    record = parameters.calibration
    if record is None:
        raise ParameterError("This limb is not calibrated, so that its uncertainty is unknown.")
    values = np.array(record.values)
    covariance = np.array(record.covariance)
    ranges = np.array([_range(*parameter_owner(parameters, name)) for name in record.names])
    # Draw steps from the covariance; in logarithms where the range excludes zero.
    has_fixed_sign = (ranges[:, 0] > 0) | (ranges[:, 1] < 0)
    scale = np.where(has_fixed_sign, values, 1.0)
    variances, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    generator = np.random.default_rng(0)
    normal = generator.standard_normal((count, len(values)))
    steps = (normal * np.sqrt(np.maximum(variances, 0.0))) @ axes.T
    drawn = np.where(has_fixed_sign, values * np.exp(np.clip(steps, -3.0, 3.0)), values + steps)
    drawn = np.clip(drawn, ranges[:, 0], ranges[:, 1])
    # Set the drawn values in copies of the limb, without the record, which takes long to copy.
    limbs = []
    plain = dataclasses.replace(parameters, calibration=None)
    for drawn_values in drawn:
        limb = copy.deepcopy(plain)
        limb.calibration = record
        for name, value in zip(record.names, drawn_values, strict=True):
            owner, field = parameter_owner(limb, name)
            setattr(owner, field, float(value))
        limbs.append(limb)
    return limbs


def stack_limbs(
    limbs: Sequence[LimbParameters],
) -> tuple[WireLaw, np.ndarray, dict[str, np.ndarray]]:
    """Stack the parameters of B limbs of one segment into arrays for `OpenLoop`.

    Returns:
        The law with fields (B, 1, W), T0 (B,), °C, and the rubber.

    Raises:
        ParameterError: if laws are of several classes.
    """
    segments = [limb.segments[0] for limb in limbs]
    # Stack the fields of the laws, all of one class.
    law_types = {type(wire.law) for segment in segments for wire in segment.wires}
    if len(law_types) > 1:
        names = " and ".join(sorted(law_type.__name__ for law_type in law_types))
        raise ParameterError(f"The wires have laws of several classes, {names}; use one for all.")
    (law_type,) = law_types
    fields: dict[str, np.ndarray] = {}
    for field in dataclasses.fields(law_type):  # type: ignore[arg-type]
        values = [[getattr(wire.law, field.name) for wire in segment.wires] for segment in segments]
        fields[field.name] = np.array(values)[:, np.newaxis]
    # Stack the properties of the rubber.
    properties = ["stiffness", "rest_angle"]
    if any(segment.stiffening for segment in segments):
        properties.append("stiffening")
    rubber: dict[str, np.ndarray] = {}
    for name in properties:
        rubber[name] = np.array([getattr(segment, name) for segment in segments])
    memories = [segment.rest_memory for segment in segments if segment.rest_memory]
    if memories:
        rubber["shift"] = np.array([memory.shift for memory in memories])
        rubber["rate"] = np.array([memory.rate for memory in memories])
    ambient = np.array([limb.ambient_temperature for limb in limbs])
    return with_fields(law_type, fields), ambient, rubber


def parameter_owner(parameters: LimbParameters, name: str) -> tuple[Any, str]:
    """Return the object whose field is an estimated parameter, and the field's name.

    The object is the limb, its segment, a wire, the wire's law, the sensor or the rest memory.

    Args:
        name: name of the estimate in a `CalibrationRecord`.

    Raises:
        ParameterError: if the limb has no such field.
    """
    # Find the objects that the part of the name before the field stands for.
    segment = parameters.segments[0]
    owner_name, _, field = name.rpartition(".")
    owners: Sequence[Any] = (parameters, segment)
    if owner_name == "rest_memory":
        owners = [segment.rest_memory or RestMemory()]
    elif owner_name == "bend_sensor":
        owners = [segment.bend_sensor]
    elif owner_name:
        owners = []
        for wire in segment.wires:
            if wire.name == owner_name:
                owners = [wire.law, wire]
    # Return the first object that has the field.
    for owner in owners:
        if hasattr(owner, field):
            return owner, field
    raise ParameterError(
        f"The calibration names {name}, which this limb does not have; calibrate it again."
    )


def _range(owner: Any, name: str) -> tuple[float, float]:
    """Return the accepted range of a field; unbounded if it is no field."""
    for field in dataclasses.fields(owner):
        if field.name == name:
            return field.metadata["range"]
    return -np.inf, np.inf


class OpenLoop:
    """Simulation of R runs of one segment of W wires, over K steps, for B parameter sets at once.

    Arrays begin with B where they differ between parameter sets.

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
        num_steps, num_runs = duty.shape[:2]
        self.step = step
        self._chain = segment.chain
        ends = np.full(num_runs, num_steps) if lengths is None else np.asarray(lengths)
        # Sort the runs, longest first, so that the unfinished runs are always the first ones.
        self._order = np.argsort(-ends, kind="stable")
        self._duty = np.ascontiguousarray(duty[:, self._order])
        self._num_unfinished = (ends > np.arange(num_steps)[:, None]).sum(axis=1).tolist()
        self._directions = np.array([wire.lever[0] for wire in segment.wires])
        self._sides = np.sign(self._directions)

    def simulate(
        self,
        law: WireLaw,
        ambient: np.ndarray,
        initial: Sequence[np.ndarray],
        rubber: Mapping[str, np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return T, V and φ at the ends of the steps, by the classical Runge-Kutta method.

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
        T0 = _broadcast_copy(ambient[..., None], start.shape[1:])
        # Parameter sets that differ only in other wires heat a wire in the same way: simulate once.
        distinct, set_indices = _distinct_sets(law, T0, start)
        distinct_law = _map_fields(law, lambda field: _select_sets(field, distinct))
        distinct_T0 = _select_sets(T0, distinct)
        distinct_start = _select_sets(start, distinct)
        # Simulate the heat, with the runs sorted by their lengths.
        sorted_start = distinct_start[..., self._order, :]
        sorted_heat = self._heat(distinct_law, distinct_T0[:, self._order], sorted_start)
        heat = sorted_heat[..., np.argsort(self._order), :]
        # Find the torques on straight links.
        states = list(np.moveaxis(heat[:, :-1], 1, 0))
        straight_torques = distinct_law.torque(states, distinct_T0, 0.0)
        torques = _select_sets(np.asarray(straight_torques), set_indices)

        def torques_at_angle(step_index: int, theta: np.ndarray) -> np.ndarray:
            wire_states = list(_select_sets(heat[step_index, :-1], set_indices))
            return np.asarray(law.torque(wire_states, T0, theta[..., None] * self._directions))

        # A torque that is nan at an unknown angle depends on the angle.
        first_states = [state[0] for state in states]
        needs_angle = np.isnan(distinct_law.torque(first_states, distinct_T0, np.nan)).any()
        bends = self._bends(torques, rubber, torques_at_angle if needs_angle else None)
        temperature = _select_sets(heat[:, 0], set_indices)
        reading = _select_sets(heat[:, -1], set_indices)
        return temperature, reading, bends

    def _heat(self, law: WireLaw, T0: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Return the states of the wires and V (K + 1, X + 1, B, R, W), with the runs sorted.

        A law whose heat, stress and transformation act on each other may be too fast for the step.
        If one parameter set diverges, all are simulated again in the same shorter steps, because
        they are compared with each other.
        """
        for num_substeps in NUM_SUBSTEPS:
            with np.errstate(over="ignore", invalid="ignore"):
                heat = self._heat_in_substeps(law, T0, start, num_substeps)
            if (np.abs(heat) < DIVERGED_TEMPERATURE).all():
                break
        return heat

    def _heat_in_substeps(
        self, law: WireLaw, T0: np.ndarray, start: np.ndarray, num_substeps: int
    ) -> np.ndarray:
        """Return the heat as `_heat`, with each step divided into substeps."""
        course = np.empty((len(self._duty) + 1, *start.shape))
        course[0] = start
        # Collect the ranges of states that are memories.
        memory_ranges = {}
        for row, state in enumerate(law.states):
            if np.isfinite(law.memory.get(state, np.inf)).any():
                memory_ranges[row] = law.memory[state]
        _clamp_memory(memory_ranges, course[0])
        # Compile a substep with T0 and the law's fields as inputs.
        fields = {name: value for name, value in vars(law).items() if isinstance(value, np.ndarray)}
        compiled = _compiled_step(law, list(fields), self.step / num_substeps)
        num_unfinished = None
        for step_index, levels in enumerate(self._duty):
            # Drop the runs that have ended, and bind the substep to arrays of the other runs.
            if num_unfinished != self._num_unfinished[step_index]:
                num_unfinished = self._num_unfinished[step_index]
                heat = course[step_index, ..., :num_unfinished, :].copy()
                shape = heat.shape[1:]
                next_heat = np.empty_like(heat)
                duty = np.empty(shape)
                inputs = (T0[:, :num_unfinished], *fields.values())
                constants = np.array([_broadcast_copy(field, shape) for field in inputs])
                arrays = (heat, duty[None], constants, next_heat)
                advance = compiled.bound(*(array.reshape(len(array), -1) for array in arrays))
            # Integrate the remaining runs; the states of ended runs stay.
            duty[...] = levels[:num_unfinished]
            for _ in range(num_substeps):
                advance()
                heat[...] = next_heat
                _clamp_memory(memory_ranges, heat)
            course[step_index + 1] = course[step_index]
            course[step_index + 1, ..., :num_unfinished, :] = heat
        return course

    def _bends(
        self,
        straight_torques: np.ndarray,
        rubber: Mapping[str, np.ndarray],
        torques_at_angle: Callable[[int, np.ndarray], np.ndarray] | None,
    ) -> np.ndarray:
        """Return φ (K + 1, B, R), rad.

        Args:
            straight_torques: of the wires on straight links (K + 1, B, R, W), N·m.
            rubber: as for `simulate`.
            torques_at_angle: function of the step's index and of the links' angles θ (B, R), rad,
                that gives the torques (B, R, W); None if torques do not depend on θ.
        """
        bend_by_angle = self._chain.bend_by_equal_angle  # (11)
        stiffness = rubber["stiffness"][:, None]
        rest = rubber["rest_angle"][:, None]
        torques = straight_torques * self._directions
        if torques_at_angle is None and not rubber.keys() & {"stiffening", "shift"}:
            return rest + bend_by_angle * (torques.sum(axis=-1) / stiffness)
        bends = np.empty(torques.shape[:-1])
        angle = np.zeros(bends.shape[1:])  # of each joint, from rest
        bend_alone = np.zeros(torques.shape[1:])  # bend angle that each wire would hold alone
        shift = np.zeros(bends.shape[1:])  # of the rest angle by its memory
        for step_index, torque in enumerate(torques):
            if torques_at_angle is not None:
                at_angle = torques_at_angle(step_index, angle + rest / bend_by_angle)
                torque = at_angle * self._directions
            # Move the rest angle towards the side of the wires that heat.
            previous_bend_alone = bend_alone
            bend_alone = bend_by_angle / stiffness[..., None] * np.abs(torque)
            if "shift" in rubber and step_index:
                progress = self.step * ramp((bend_alone - previous_bend_alone) / self.step)
                target = rubber["shift"][:, None] * (progress * self._sides).sum(axis=-1)
                rate = rubber["rate"][:, None]
                shift = (shift + rate * target) / (1 + rate * progress.sum(axis=-1))
            # Find the equilibrium.
            linear_angle = torque.sum(axis=-1) / stiffness + shift / bend_by_angle
            angle = self._stiffened_angle(linear_angle, angle, rubber)
            bends[step_index] = rest + bend_by_angle * angle
        return bends

    def _stiffened_angle(
        self, linear_angle: np.ndarray, start: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Return the joint angle at rest, rad, by Newton's method.

        Args:
            linear_angle: angle without stiffening: torque over k, rad.
            start: angle to start from, rad.
            rubber: as for `simulate`.
        """
        if "stiffening" not in rubber:
            return linear_angle
        angle = start
        angle_at_45_deg = np.pi / 4 / self._chain.bend_by_equal_angle
        cubic = rubber["stiffening"][:, None] / angle_at_45_deg**2
        for _ in range(2):
            excess = angle + cubic * angle**3 - linear_angle
            angle = angle - excess / (1 + 3 * cubic * angle**2)
        return angle


def _compiled_step(law: WireLaw, names: list[str], step: float) -> Compiled:
    """Return a step of the classical Runge-Kutta method: heat [x, V] after it, of one wire.

    The inputs are the heat before it, the duty, and T0 with the named fields of the law.
    """

    def build() -> Compiled:
        heat = ca.SX.sym("x", len(law.states) + 1)
        duty = ca.SX.sym("D")
        T0 = ca.SX.sym("T0")
        fields = ca.SX.sym("p", len(names))
        named_fields = dict(zip(names, ca.vertsplit(fields), strict=True))
        symbolic_law = with_fields(type(law), {**vars(law), **named_fields})

        def rates(heat: ca.SX, duty: ca.SX) -> ca.SX:
            *states, reading = ca.vertsplit(heat)
            state_rates = symbolic_law.rates(states, duty, T0)
            return ca.vertcat(*state_rates, symbolic_law.reading_rate(reading, states))

        after = runge_kutta(rates, heat, (duty, duty, duty), step)
        return Compiled([heat, duty, ca.vertcat(T0, fields)], [ca.densify(after)])

    # Limbs with laws of one class share the compiled step.
    constants = {name: value for name, value in vars(law).items() if name not in names}
    key = ("runge_kutta", type(law), step, tuple(names), repr(constants))
    return build_once(key, build)


def with_fields(law_type: type[WireLaw], fields: Mapping[str, Any]) -> WireLaw:
    """Return a law of a class whose fields are arrays or symbols, for calculations only."""
    law = law_type()
    for name, values in fields.items():
        setattr(law, name, values)
    return law


def _distinct_sets(
    law: WireLaw, T0: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the parameter sets that differ in the heat of each wire.

    Returns:
        Indices of C distinct sets for each wire (C, W), and the position of each set among them
        (B, W).
    """
    fields = [value for value in vars(law).values() if isinstance(value, np.ndarray)]
    num_sets = len(T0)
    num_wires = T0.shape[-1]
    first_sets = []
    positions = []
    for wire in range(num_wires):
        parts = [*fields, T0, *start]
        rows = np.hstack([part[..., wire].reshape(num_sets, -1) for part in parts])
        _, first, position = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        first_sets.append(first)
        positions.append(position.reshape(-1))
    # Wires with fewer distinct sets repeat set 0.
    distinct = np.zeros((max(map(len, first_sets)), num_wires), int)
    for wire, first in enumerate(first_sets):
        distinct[: len(first), wire] = first
    return distinct, np.stack(positions, axis=-1)


def _select_sets(array: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Select sets (C, W) of each wire from an array (..., B, R, W), as (..., C, R, W)."""
    selected = [array[..., wire].take(sets, axis=-2) for wire, sets in enumerate(indices.T)]
    return np.stack(selected, axis=-1)


def _map_fields(law: WireLaw, change: Callable[[np.ndarray], np.ndarray]) -> WireLaw:
    """Return a law whose fields that are arrays are changed by a function."""
    fields = dict(vars(law))
    for name, value in fields.items():
        if isinstance(value, np.ndarray):
            fields[name] = change(value)
    return with_fields(type(law), fields)


def _broadcast_copy(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return an array that is broadcast to a shape and copied."""
    return np.ascontiguousarray(np.broadcast_to(array, shape))


def _clamp_memory(memory_ranges: Mapping[int, tuple[float, float]], heat: np.ndarray) -> None:
    """Clamp states that are memories to their ranges: starts and long steps may leave them."""
    for row, bounds in memory_ranges.items():
        np.clip(heat[row], *bounds, out=heat[row])
