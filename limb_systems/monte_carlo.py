"""Many limbs at once: draws from the covariance of a calibration, and their open-loop simulation.

States and torques follow the laws of the wires. The limb follows its wires without
delay: it rings at some hertz, and they heat within seconds. On a segment
without gravity all joints have the same angle θ, and each bend sensor reads φ.
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
    """Stack the parameters of B limbs of one segment of W wires into arrays for `OpenLoop`.

    Returns:
        The law with fields (B, 1, W), T0 (B,), °C, and the rubber of `OpenLoop.simulate`.

    Raises:
        ParameterError: if laws are of several classes.
    """
    segments = [limb.segments[0] for limb in limbs]
    # Stack the fields of the laws, all of one class.
    laws: list[WireLaw] = []
    for segment in segments:
        laws += [wire.law for wire in segment.wires]
    law_types = set(map(type, laws))
    if len(law_types) > 1:
        names = " and ".join(sorted(law_type.__name__ for law_type in law_types))
        raise ParameterError(f"The wires have laws of several classes, {names}; use one for all.")
    (law_type,) = law_types
    fields: dict[str, np.ndarray] = {}
    for field in dataclasses.fields(law_type):
        values = [getattr(law, field.name) for law in laws]
        fields[field.name] = np.reshape(values, (len(limbs), 1, -1))
    # Stack the properties of the rubber.
    properties = ["stiffness", "rest_angle"]
    if any(segment.stiffening for segment in segments):
        properties.append("stiffening")
    rubber: dict[str, np.ndarray] = {}
    for name in properties:
        rubber[name] = np.array([getattr(segment, name) for segment in segments])
    memories = [segment.rest_memory for segment in segments if segment.rest_memory]
    for name in ("shift", "rate") if memories else ():
        rubber[name] = np.array([getattr(memory, name) for memory in memories])
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

    The heat of a wire is short for its X states x, by its law, and the reading V of its
    thermocouple: X + 1 numbers, T and V in °C. Arrays of heat are (X + 1, B, R, W).

    Args:
        duty: its mean over each step (K, R, W), in [0, 1].
        step: s.
        segment: the segment, of which links and directions of wires count.
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
            initial: heat at the start, each of its rows (B, R, W).
            rubber: ``stiffness``, N·m/rad, and ``rest_angle``, rad, each (B,);
                optionally ``stiffening``, and ``shift``, rad, and ``rate``,
                1/rad, of the rest angle's memory.
            near_first: True if all sets are so near the first that heat may be linear in their
                differences from the first, as in finite differences.

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
        # Simulate the heat (K + 1, X + 1, B, R, W), with the runs sorted by their lengths.
        sorted_T0 = distinct_T0[:, self._order]
        sorted_start = distinct_start[..., self._order, :]
        if near_first and _symbolic_step(law, self.step):
            sorted_heat = self._linear_heat(distinct_law, sorted_T0, sorted_start, set_indices[:1])
        else:
            sorted_heat, num_substeps = self._heat(distinct_law, sorted_T0, sorted_start)
            sorted_heat = sorted_heat[::num_substeps]
        heat = sorted_heat[..., np.argsort(self._order), :]
        # Find the torques of the wires on straight links (K + 1, B, R, W).
        states = list(np.moveaxis(heat[:, :-1], 1, 0))
        straight_torques = distinct_law.torque(states, distinct_T0, 0.0)
        torques = _select_sets(np.asarray(straight_torques), set_indices)

        def torques_at_theta(theta: np.ndarray) -> np.ndarray:
            wire_states = list(np.moveaxis(_select_sets(heat[:, :-1], set_indices), 1, 0))
            return np.asarray(law.torque(wire_states, T0, theta[..., None] * self._directions))

        # A torque that is nan at an unknown θ depends on θ.
        first_states = [*heat[0, :-1]]
        needs_theta = np.isnan(distinct_law.torque(first_states, distinct_T0, np.nan)).any()
        bends = self._bends(torques, rubber, torques_at_theta if needs_theta else None)
        temperature = _select_sets(heat[:, 0], set_indices)
        reading = _select_sets(heat[:, -1], set_indices)
        return temperature, reading, bends

    def _heat(self, law: WireLaw, T0: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, int]:
        """Simulate the heat, with the runs sorted, in as few substeps as converge.

        A law whose heat, stress and transformation act on each other may be too fast for the step.
        If one parameter set diverges, all are simulated again in the same shorter steps, because
        they are compared with each other.

        Args:
            law: with fields (B, 1, W).
            T0: °C (B, R, W).
            start: heat at the start (X + 1, B, R, W).

        Returns:
            Heat at the ends of all substeps (K S + 1, X + 1, B, R, W), and S, their number in a
            step of the duty.
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
        """Simulate the heat with each step of the duty divided into S = ``num_substeps``.

        Args:
            law: with fields (B, 1, W).
            T0: °C (B, R, W).
            start: heat at the start (X + 1, B, R, W).
            num_substeps: S.

        Returns:
            Heat at the ends of all substeps (K S + 1, X + 1, B, R, W).
        """
        memory_ranges = _memory_ranges(law)
        substep = self.step / num_substeps
        duty = np.repeat(self._duty, num_substeps, axis=0)  # (K S, R, W)
        num_unfinished = np.repeat(self._num_unfinished, num_substeps)
        trajectory = np.empty((len(duty) + 1, *start.shape))
        trajectory[0] = start
        begin = 0
        for num_runs, substeps in itertools.groupby(num_unfinished.tolist()):
            # The heat of runs that have ended stays. The first ones, in number num_runs, go on.
            trajectory[begin + 1 :, ..., num_runs:, :] = trajectory[begin, ..., num_runs:, :]
            heat = trajectory[begin, ..., :num_runs, :].copy()
            next_heat = np.empty_like(heat)
            substep_duty = np.empty(heat.shape[1:])
            # This function reads heat and substep_duty, and writes into next_heat.
            write_next_heat = _step_between_arrays(
                law, T0[:, :num_runs], substep, heat, substep_duty, next_heat
            )
            # Integrate these runs until the next one ends.
            end = begin + len(list(substeps))
            for index in range(begin, end):
                substep_duty[...] = duty[index, :num_runs]
                write_next_heat()
                _clamp_memory(memory_ranges, next_heat)
                heat[...] = next_heat
                trajectory[index + 1, ..., :num_runs, :] = heat
            begin = end
        return trajectory

    def _linear_heat(
        self, law: WireLaw, T0: np.ndarray, start: np.ndarray, first: np.ndarray
    ) -> np.ndarray:
        """Simulate the heat (K + 1, X + 1, B, R, W), linear in the differences from the first set.

        Args:
            law: with fields (B, 1, W).
            T0: °C (B, R, W).
            start: heat at the start (X + 1, B, R, W).
            first: index of the first set among these, for each wire (1, W).
        """
        # Simulate the first set alone.
        first_law = _map_fields(law, lambda field: _select_sets(field, first))
        first_T0 = _select_sets(T0, first)
        first_start = _select_sets(start, first)
        trajectory, num_substeps = self._heat(first_law, first_T0, first_start)
        # Differentiate all steps of unfinished runs by the heat before them, T0 and the fields.
        num_unfinished = np.repeat(self._num_unfinished, num_substeps)
        steps, runs = np.nonzero(np.arange(start.shape[2]) < num_unfinished[:, None])
        constants = _step_constants(law, T0)
        first_constants = _step_constants(first_law, first_T0)
        points = np.concatenate(
            [trajectory[steps, :, 0, runs], first_constants[:, 0].swapaxes(0, 1)[runs]], axis=1
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
                np.add(trajectory[step_index], change, out=heat[step_index // num_substeps])
        return heat

    def _bends(
        self,
        straight_torques: np.ndarray,
        rubber: Mapping[str, np.ndarray],
        torques_at_theta: Callable[[np.ndarray], np.ndarray] | None,
    ) -> np.ndarray:
        """Return the bends φ (K + 1, B, R), rad, under the torques of the wires.

        The bend is proportional to the angle θ of each joint, and the deflection of a joint is its
        θ less its θ at rest.

        Args:
            straight_torques: torques of the wires on straight links (K + 1, B, R, W), N·m.
            rubber: ``stiffness``, N·m/rad, ``rest_angle``, rad, and others (B,); see `simulate`.
            torques_at_theta: function of θ (K + 1, B, R), rad, that returns the torques at θ
                (K + 1, B, R, W), N·m; None if torques do not depend on θ.
        """
        bend_by_theta = self._chain.bend_by_equal_angle  # (11)
        rest_bend = rubber["rest_angle"][:, None]  # (B, 1)
        deflection = self._deflections(straight_torques, rubber)
        # Repeat with the torques at the angle that they lead to.
        if torques_at_theta is not None:
            for _ in range(NUM_ANGLE_ITERATIONS):
                theta = deflection + rest_bend / bend_by_theta
                deflection = self._deflections(torques_at_theta(theta), rubber)
        return rest_bend + bend_by_theta * deflection

    def _deflections(self, torques: np.ndarray, rubber: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the angle of each joint from rest (K + 1, B, R), rad, under torques of wires.

        Args:
            torques: torques of the wires (K + 1, B, R, W), N·m.
            rubber: ``stiffness``, N·m/rad, and others (B,); see `simulate`.
        """
        bend_by_theta = self._chain.bend_by_equal_angle
        stiffness = rubber["stiffness"][:, None]
        deflection = torques @ self._directions / stiffness
        if "shift" in rubber:
            # Memory moves the rest angle towards the side of the wires that heat.
            bends_alone = np.abs(torques * self._directions)
            bends_alone *= bend_by_theta / stiffness[..., None]
            rest_shifts = self._rest_shifts(bends_alone, self._sides[:, None], rubber)
            deflection += rest_shifts[..., 0] / bend_by_theta
        if "stiffening" in rubber:
            # The real root δ of δ + c δ³ = deflection of rubber that does not stiffen.
            theta_at_45_deg = np.pi / 4 / bend_by_theta
            cubic = np.maximum(rubber["stiffening"], 1e-12)[:, None] / theta_at_45_deg**2
            root = np.sqrt(3.0 * cubic)
            deflection = 2.0 / root * np.sinh(np.arcsinh(1.5 * root * deflection) / 3.0)
        return deflection

    def _rest_shifts(
        self, bends_alone: np.ndarray, directions: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Return how far memory moves the rest angle (K + 1, B, R, F), rad; see `NonlinearRubber`.

        Args:
            bends_alone: bend that each wire would hold alone (K + 1, B, R, W), rad.
            directions: directions of the wires, by each of F bends ([B,] W, F).
            rubber: ``shift``, rad, and ``rate``, 1/rad (B,).
        """
        # Each step that bends the limb further draws the rest angle after it.
        progress = self.step * ramp(np.diff(bends_alone, axis=0) / self.step)
        progress *= rubber["rate"][:, None, None]
        # Integrate the shifts by the implicit Euler method.
        drawn_shifts = rubber["shift"][:, None, None] * (progress @ directions)
        remaining = 1 / (1 + progress.sum(axis=-1, keepdims=True))
        shifts = np.zeros((len(bends_alone), *drawn_shifts.shape[1:]))
        for number, (drawn_shift, share) in enumerate(zip(drawn_shifts, remaining, strict=True)):
            shifts[number + 1] = share * (shifts[number] + drawn_shift)
        return shifts


@dataclasses.dataclass(frozen=True, eq=False)
class _SymbolicStep:
    """A step of the classical Runge-Kutta method: the heat [x, V] of one wire after it.

    - ``compiled``: function of the heat before the step, the duty, and T0 with the law's N fields.
    - ``derivatives``: the same function, with derivatives by the heat, T0 and fields together.
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
        # State the step of one wire, whose fields are symbols.
        heat = ca.SX.sym("x", len(law.states) + 1)
        duty = ca.SX.sym("D")
        constants = ca.SX.sym("p", 1 + len(names))
        T0, *fields = ca.vertsplit(constants)
        symbols = dict(zip(names, fields, strict=True))
        symbolic_law = with_fields(type(law), vars(law) | symbols)

        def rates(heat: ca.SX, duty: ca.SX) -> ca.SX:
            *states, reading = ca.vertsplit(heat)
            state_rates = symbolic_law.rates(states, duty, T0)
            return ca.vertcat(*state_rates, symbolic_law.reading_rate(reading, states))

        try:
            after = ca.densify(runge_kutta(rates, heat, (duty, duty, duty), step))
        except Exception:  # of any kind: a lab's law may do anything with its fields
            return None
        # Try numbers, as numpy may turn symbols into nan without an error.
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
    number_fields = {name: value for name, value in vars(law).items() if name not in names}
    key = ("runge_kutta", type(law), step, tuple(names), repr(number_fields))
    return build_once(key, build)


def _step_constants(law: WireLaw, T0: np.ndarray) -> np.ndarray:
    """Return T0 (B, R, W) and the N fields of a law that are arrays, broadcast (1 + N, B, R, W)."""
    return np.array(np.broadcast_arrays(T0, *_array_fields(law).values()))


def _step_between_arrays(
    law: WireLaw,
    T0: np.ndarray,
    step: float,
    heat: np.ndarray,
    duty: np.ndarray,
    next_heat: np.ndarray,
) -> Callable[[], object]:
    """Return a function without arguments that integrates a step, and can be called again.

    It reads what the arrays ``heat`` and ``duty`` contain at the call, and writes the heat after
    the step into the array ``next_heat``. The caller changes ``heat`` and ``duty`` in place.

    Args:
        law: with fields of shape (B, 1, W).
        T0: °C (B, R, W).
        step: s.
        heat, next_heat: heat before and after the step (X + 1, B, R, W), contiguous.
        duty: duty during the step (B, R, W), contiguous.
    """
    if symbolic_step := _symbolic_step(law, step):
        arrays = (heat, duty[None], _step_constants(law, T0), next_heat)
        # The compiled function works on the same memory, as a reshaped array is a view.
        return symbolic_step.compiled.bound(*(each.reshape(len(each), -1) for each in arrays))
    rates = _numeric_rates(law, T0, heat)

    def write_next_heat() -> None:
        next_heat[...] = runge_kutta(rates, heat, (duty, duty, duty), step)

    return write_next_heat


def _numeric_rates(
    law: WireLaw, T0: np.ndarray, heat: np.ndarray
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return a function of heat and duty that gives the rates of heat; for any law.

    Args:
        law: with fields of shape (B, 1, W), whose rates may take numbers alone.
        T0: °C (B, R, W).
        heat: heat (X + 1, B, R, W), about which the rates are tried.
    """

    def rates_of(law: WireLaw, heat: np.ndarray, duty: np.ndarray, T0: np.ndarray) -> np.ndarray:
        states = list(heat[:-1])
        return np.array([*law.rates(states, duty, T0), law.reading_rate(heat[-1], states)])

    full_law = _map_fields(law, lambda field: _broadcast_copy(field, T0.shape))
    fields = _array_fields(full_law)

    def rates_at_once(heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        return rates_of(full_law, heat, duty, T0)

    def rates_one_by_one(heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        rates = np.empty_like(heat)
        for index in np.ndindex(T0.shape):
            values = {name: float(field[index]) for name, field in fields.items()}
            wire_law = with_fields(type(law), vars(law) | values)
            rates[:, *index] = rates_of(wire_law, heat[:, *index], duty[index], T0[index])
        return rates

    # Evaluate all wires at once if that gives the rates of each alone, at random heat and duty.
    random = np.random.default_rng(0)
    probe_heat = heat + random.random(heat.shape)
    probe_duty = random.random(T0.shape)
    try:
        alone = rates_one_by_one(probe_heat, probe_duty)
        is_elementwise = np.allclose(rates_at_once(probe_heat, probe_duty), alone)
    except (TypeError, ValueError):  # of shapes
        is_elementwise = False
    return rates_at_once if is_elementwise else rates_one_by_one


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

    Args:
        law: with fields (B, 1, W).
        T0: °C (B, R, W).
        start: heat at the start (X + 1, B, R, W).

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
    """Return the ranges of states that are memories and bounded, by their row in the heat."""
    ranges = {}
    for row, state in enumerate(law.states):
        if np.isfinite(law.memory.get(state, np.inf)).any():
            ranges[row] = law.memory[state]
    return ranges


def _clamp_memory(memory_ranges: Mapping[int, tuple[float, float]], heat: np.ndarray) -> None:
    """Clamp states that are memories to their ranges, in place: long steps may leave them."""
    for row, (low, high) in memory_ranges.items():
        np.minimum(np.maximum(heat[row], low), high, out=heat[row])
