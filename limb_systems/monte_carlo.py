"""Many limbs at once: draws from the covariance of a calibration, and their open-loop simulation.

Heat and torque follow the laws of the wires. The limb follows its wires without
delay: it rings at some hertz, and they heat within seconds. On a segment
without gravity all joints have the same angle, and each bend sensor reads φ.
"""

import copy
import dataclasses
import itertools
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
from limb_systems.smooth_function import Compiled, SmoothFunction, build_once
from limb_systems.wire_laws.wire_law import WireLaw, runge_kutta

NUM_SUBSTEPS = (1, 2, 4)  # tried in this order until no simulation diverges
NUM_ANGLE_ITERATIONS = 8  # of torques that depend on the angle, and change it by less than itself
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
        *,
        near_first: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return T, V and φ at the ends of the steps, by the classical Runge-Kutta method.

        Args:
            law: with fields of shape (B, 1, W).
            ambient: T0 of each run (B, R), °C.
            initial: states of the wires, then V, at the start, each (B, R, W).
            rubber: ``stiffness``, N·m/rad, and ``rest_angle``, rad, each (B,);
                optionally ``stiffening``, and ``shift``, rad, and ``rate``,
                1/rad, of the rest angle's memory.
            near_first: whether all sets are so near the first that heat is linear in their
                differences from it, as finite differences need it.

        Returns:
            T and V (K + 1, B, R, W), °C, and φ (K + 1, B, R), rad.
        """
        start = np.array(initial)
        _clamp_memory(_memory_ranges(law), start)
        T0 = _broadcast_copy(ambient[..., None], start.shape[1:])
        # Parameter sets that differ only in other wires heat a wire in the same way: simulate once.
        distinct, set_indices = _distinct_sets(law, T0, start)
        distinct_law = _map_fields(law, lambda field: _select_sets(field, distinct))
        distinct_T0 = _select_sets(T0, distinct)
        distinct_start = _select_sets(start, distinct)
        # Simulate the heat, with the runs sorted by their lengths.
        sorted_T0 = distinct_T0[:, self._order]
        sorted_start = distinct_start[..., self._order, :]
        if near_first and _symbolic_step(law, self.step):
            sorted_heat = self._linear_heat(distinct_law, sorted_T0, sorted_start, set_indices[:1])
        else:
            sorted_heat, num_substeps = self._heat(distinct_law, sorted_T0, sorted_start)
            sorted_heat = sorted_heat[::num_substeps]
        heat = sorted_heat[..., np.argsort(self._order), :]
        # Find the torques on straight links.
        states = list(np.moveaxis(heat[:, :-1], 1, 0))
        straight_torques = distinct_law.torque(states, distinct_T0, 0.0)
        torques = _select_sets(np.asarray(straight_torques), set_indices)

        def torques_at_angles(theta: np.ndarray) -> np.ndarray:
            wire_states = list(np.moveaxis(_select_sets(heat[:, :-1], set_indices), 1, 0))
            return np.asarray(law.torque(wire_states, T0, theta[..., None] * self._directions))

        # A torque that is nan at an unknown angle depends on the angle.
        first_states = [state[0] for state in states]
        needs_angle = np.isnan(distinct_law.torque(first_states, distinct_T0, np.nan)).any()
        bends = self._bends(torques, rubber, torques_at_angles if needs_angle else None)
        temperature = _select_sets(heat[:, 0], set_indices)
        reading = _select_sets(heat[:, -1], set_indices)
        return temperature, reading, bends

    def _heat(self, law: WireLaw, T0: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, int]:
        """Return the states of the wires and V, with the runs sorted, and the number of substeps.

        A law whose heat, stress and transformation act on each other may be too fast for the step.
        If one parameter set diverges, all are simulated again in the same shorter steps, because
        they are compared with each other.

        Returns:
            Heat (K S + 1, X + 1, B, R, W) and S.
        """
        for num_substeps in NUM_SUBSTEPS:
            with np.errstate(over="ignore", invalid="ignore"):
                heat = self._heat_in_substeps(law, T0, start, num_substeps)
            if (np.abs(heat) < DIVERGED_TEMPERATURE).all():
                break
        return heat, num_substeps

    def _heat_in_substeps(
        self, law: WireLaw, T0: np.ndarray, start: np.ndarray, num_substeps: int
    ) -> np.ndarray:
        """Return the heat as `_heat`, with each step divided into substeps."""
        memory_ranges = _memory_ranges(law)
        duty = np.repeat(self._duty, num_substeps, axis=0)
        num_unfinished = np.repeat(self._num_unfinished, num_substeps)
        course = np.empty((len(duty) + 1, *start.shape))
        course[0] = start
        begin = 0
        for num_runs, steps in itertools.groupby(num_unfinished.tolist()):
            # Drop the runs that have ended, whose states stay, and bind the substep to the others.
            course[begin + 1 :, ..., num_runs:, :] = course[begin, ..., num_runs:, :]
            heat = course[begin, ..., :num_runs, :].copy()
            next_heat = np.empty_like(heat)
            level = np.empty(heat.shape[1:])
            step = self.step / num_substeps
            advance = _bound_step(law, T0[:, :num_runs], step, heat, level, next_heat)
            # Integrate these runs until the next one ends.
            end = begin + len(list(steps))
            for step_index in range(begin, end):
                level[...] = duty[step_index, :num_runs]
                advance()
                _clamp_memory(memory_ranges, next_heat)
                heat[...] = next_heat
                course[step_index + 1, ..., :num_runs, :] = heat
            begin = end
        return course

    def _linear_heat(
        self, law: WireLaw, T0: np.ndarray, start: np.ndarray, first: np.ndarray
    ) -> np.ndarray:
        """Return the heat (K + 1, X + 1, B, R, W), linear in the differences from the first set.

        Args:
            law, T0, start: as for `_heat`.
            first: place of the first set among these, for each wire (1, W).
        """
        # Simulate the first set alone.
        first_law = _map_fields(law, lambda field: _select_sets(field, first))
        first_T0 = _select_sets(T0, first)
        first_start = _select_sets(start, first)
        course, num_substeps = self._heat(first_law, first_T0, first_start)
        # Differentiate all steps of unfinished runs by the heat before them, T0 and the fields.
        num_unfinished = np.repeat(self._num_unfinished, num_substeps)
        steps, runs = np.nonzero(np.arange(start.shape[2]) < num_unfinished[:, None])
        constants = _step_constants(law, T0)
        first_constants = _step_constants(first_law, first_T0)
        points = np.concatenate(
            [course[steps, :, 0, runs], first_constants[:, 0].swapaxes(0, 1)[runs]], axis=1
        )
        duty = np.repeat(self._duty, num_substeps, axis=0)[steps, runs]
        symbolic_step = _symbolic_step(law, self.step / num_substeps)
        assert symbolic_step
        values, slopes = symbolic_step.derivatives.first(points.swapaxes(1, 2), duty[..., None])
        # Memories that reach their bounds stay there.
        for row, (low, high) in _memory_ranges(law).items():
            slopes[(values[..., row] < low) | (values[..., row] > high), row] = 0.0
        # Follow the differences from step to step.
        differences = np.concatenate([start - first_start, constants - first_constants])
        differences = np.ascontiguousarray(differences.transpose(2, 3, 0, 1))
        num_states = len(start)
        heat = np.empty((len(self._duty) + 1, *start.shape))
        heat[0] = start
        end = 0
        for step_index, count in enumerate(num_unfinished.tolist(), 1):
            begin = end
            end += count
            with np.errstate(over="ignore", invalid="ignore"):
                after = slopes[begin:end] @ differences[:count]
            differences[:count, :, :num_states] = after
            if step_index % num_substeps == 0:
                change = differences[:, :, :num_states].transpose(2, 3, 0, 1)
                np.add(course[step_index], change, out=heat[step_index // num_substeps])
        return heat

    def _bends(
        self,
        straight_torques: np.ndarray,
        rubber: Mapping[str, np.ndarray],
        torques_at_angles: Callable[[np.ndarray], np.ndarray] | None,
    ) -> np.ndarray:
        """Return φ (K + 1, B, R), rad.

        Args:
            straight_torques: of the wires on straight links (K + 1, B, R, W), N·m.
            rubber: as for `simulate`.
            torques_at_angles: function of the links' angles θ (K + 1, B, R), rad, that gives the
                torques; None if torques do not depend on θ.
        """
        bend_by_angle = self._chain.bend_by_equal_angle  # (11)
        rest = rubber["rest_angle"][:, None]
        angles = self._joint_angles(straight_torques, rubber)
        if torques_at_angles is not None:
            for _ in range(NUM_ANGLE_ITERATIONS):
                torques = torques_at_angles(angles + rest / bend_by_angle)
                angles = self._joint_angles(torques, rubber)
        return rest + bend_by_angle * angles

    def _joint_angles(self, torques: np.ndarray, rubber: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the angle of each joint from rest (K + 1, B, R), rad, under torques of wires."""
        bend_by_angle = self._chain.bend_by_equal_angle
        stiffness = rubber["stiffness"][:, None]
        angles = torques @ self._directions / stiffness
        if "shift" in rubber:
            # Memory moves the rest angle towards the side of the wires that heat.
            bends_alone = np.abs(torques * self._directions)
            bends_alone *= bend_by_angle / stiffness[..., None]
            angles += self._rest_shifts(bends_alone, self._sides[:, None], rubber)[..., 0] / (
                bend_by_angle
            )
        if "stiffening" in rubber:
            # The real root θ of θ + c θ³ = angle.
            angle_at_45_deg = np.pi / 4 / bend_by_angle
            cubic = np.maximum(rubber["stiffening"], 1e-12)[:, None] / angle_at_45_deg**2
            root = np.sqrt(3.0 * cubic)
            angles = 2.0 / root * np.sinh(np.arcsinh(1.5 * root * angles) / 3.0)
        return angles

    def _rest_shifts(
        self, bends_alone: np.ndarray, directions: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Return how far memory moves the rest angle (K + 1, B, R, F), rad; see `NonlinearRubber`.

        Args:
            bends_alone: bend that each wire would hold alone (K + 1, B, R, W), rad.
            directions: directions of the wires ([B,] W, F).
            rubber: ``shift`` and ``rate``, as for `simulate`.
        """
        progress = self.step * ramp(np.diff(bends_alone, axis=0) / self.step)
        progress *= rubber["rate"][:, None, None]
        # The implicit Euler method.
        drawn_shifts = rubber["shift"][:, None, None] * (progress @ directions)
        remaining = 1 / (1 + progress.sum(axis=-1, keepdims=True))
        shifts = np.zeros((len(bends_alone), *drawn_shifts.shape[1:]))
        for number, (drawn_shift, share) in enumerate(zip(drawn_shifts, remaining, strict=True)):
            shifts[number + 1] = share * (shifts[number] + drawn_shift)
        return shifts


@dataclasses.dataclass(frozen=True, eq=False)
class _SymbolicStep:
    """A step of the classical Runge-Kutta method: heat [x, V] after it, of one wire.

    - ``compiled``: function of the heat before it, the duty, and T0 with the law's fields.
    - ``derivatives``: the same by the heat, T0 and fields together, with the duty.
    """

    compiled: Compiled
    derivatives: SmoothFunction


def _array_fields(law: WireLaw) -> dict[str, np.ndarray]:
    """Return the fields of a law that are arrays."""
    return {name: value for name, value in vars(law).items() if isinstance(value, np.ndarray)}


def _symbolic_step(law: WireLaw, step: float) -> _SymbolicStep | None:
    """Return a step of a law in symbols; None if the law's rates take numbers alone."""
    names = list(_array_fields(law))

    def build() -> _SymbolicStep | None:
        heat = ca.SX.sym("x", len(law.states) + 1)
        duty = ca.SX.sym("D")
        constants = ca.SX.sym("p", 1 + len(names))
        T0, *fields = ca.vertsplit(constants)
        symbolic_law = with_fields(
            type(law), {**vars(law), **dict(zip(names, fields, strict=True))}
        )

        def rates(heat: ca.SX, duty: ca.SX) -> ca.SX:
            *states, reading = ca.vertsplit(heat)
            state_rates = symbolic_law.rates(states, duty, T0)
            return ca.vertcat(*state_rates, symbolic_law.reading_rate(reading, states))

        try:
            after = ca.densify(runge_kutta(rates, heat, (duty, duty, duty), step))
        except Exception:  # of any kind: a lab's law may do anything with its fields
            return None
        # Numpy may turn symbols into nan in silence.
        default_law = type(law)()
        probe = [20.0, *(getattr(default_law, name) for name in names)]
        cold = [*default_law.cold_states(20.0), 20.0]
        after_probe = ca.Function("step", [heat, duty, constants], [after])(cold, 0.5, probe)
        if np.isnan(after_probe.full()).any():
            return None
        return _SymbolicStep(
            Compiled([heat, duty, constants], [after]),
            SmoothFunction(after, ca.vertcat(heat, constants), duty),
        )

    # Limbs with laws of one class share the compiled step.
    other_fields = {name: value for name, value in vars(law).items() if name not in names}
    key = ("runge_kutta", type(law), step, tuple(names), repr(other_fields))
    return build_once(key, build)


def _step_constants(law: WireLaw, T0: np.ndarray) -> np.ndarray:
    """Return T0 and the fields of a law that are arrays, broadcast (1 + F, B, R, W)."""
    return np.array(
        [np.broadcast_to(each, T0.shape) for each in (T0, *_array_fields(law).values())]
    )


def _bound_step(
    law: WireLaw,
    T0: np.ndarray,
    step: float,
    heat: np.ndarray,
    duty: np.ndarray,
    next_heat: np.ndarray,
) -> Callable[[], object]:
    """Return a function that integrates a step from ``heat`` to ``next_heat`` (X + 1, B, R, W).

    Args:
        law: with fields of shape (B, 1, W).
        T0, duty: arrays (B, R, W).
        step: s.
    """
    if symbolic_step := _symbolic_step(law, step):
        arrays = (heat, duty[None], _step_constants(law, T0), next_heat)
        return symbolic_step.compiled.bound(*(each.reshape(len(each), -1) for each in arrays))
    rates = _numeric_rates(law, T0, heat)

    def advance() -> None:
        next_heat[...] = runge_kutta(rates, heat, (duty, duty, duty), step)

    return advance


def _numeric_rates(
    law: WireLaw, T0: np.ndarray, heat: np.ndarray
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return the rates of heat by heat and duty, of a law that takes numbers alone."""

    def rates_of(law: WireLaw, heat: np.ndarray, duty: np.ndarray, T0: np.ndarray) -> np.ndarray:
        states = list(heat[:-1])
        return np.array([*law.rates(states, duty, T0), law.reading_rate(heat[-1], states)])

    full_law = _map_fields(law, lambda field: _broadcast_copy(field, T0.shape))
    fields = _array_fields(full_law)

    def of_all(heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        return rates_of(full_law, heat, duty, T0)

    def of_each(heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        rates = np.empty_like(heat)
        for place in np.ndindex(T0.shape):
            values = {name: float(value[place]) for name, value in fields.items()}
            one_law = with_fields(type(law), vars(law) | values)
            rates[:, *place] = rates_of(one_law, heat[:, *place], duty[place], T0[place])
        return rates

    # Evaluate all wires at once only if that gives what each gives alone, at states unlike any.
    random = np.random.default_rng(0)
    probe = heat + random.random(heat.shape), random.random(T0.shape)
    try:
        is_elementwise = np.allclose(of_all(*probe), of_each(*probe))
    except (TypeError, ValueError):  # of shapes
        is_elementwise = False
    return of_all if is_elementwise else of_each


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
    fields = _array_fields(law).values()
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
    changed = {name: change(value) for name, value in _array_fields(law).items()}
    return with_fields(type(law), vars(law) | changed)


def _broadcast_copy(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return an array that is broadcast to a shape and copied."""
    return np.ascontiguousarray(np.broadcast_to(array, shape))


def _memory_ranges(law: WireLaw) -> dict[int, tuple[float, float]]:
    """Return the ranges of states that are memories and bounded, by their row."""
    ranges = {}
    for row, state in enumerate(law.states):
        if np.isfinite(law.memory.get(state, np.inf)).any():
            ranges[row] = law.memory[state]
    return ranges


def _clamp_memory(memory_ranges: Mapping[int, tuple[float, float]], heat: np.ndarray) -> None:
    """Clamp states that are memories to their ranges: starts and long steps may leave them."""
    for row, (low, high) in memory_ranges.items():
        np.minimum(np.maximum(heat[row], low), high, out=heat[row])
