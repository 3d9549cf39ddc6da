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

import numpy as np

from limb_systems.law_functions import (
    array_fields,
    law_points,
    law_step,
    law_torque,
    with_fields,
)
from limb_systems.limb_parameters import (
    LimbParameters,
    ParameterError,
    RestMemory,
    SegmentParameters,
)
from limb_systems.ragged_rows import RaggedRows
from limb_systems.rubber import ramp
from limb_systems.wire_laws.wire_law import WireLaw

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
        ParameterError: if laws are of several classes, or differ in a word.
    """
    segments = [limb.segments[0] for limb in limbs]
    law = stack_laws([[wire.law for wire in segment.wires] for segment in segments])
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
    return law, ambient, rubber


def stack_laws(laws_by_limb: Sequence[Sequence[WireLaw]]) -> WireLaw:
    """Return laws of the W wires of B limbs as one, with fields (B, 1, W); see `stack_limbs`."""
    laws = list(itertools.chain(*laws_by_limb))
    law_types = set(map(type, laws))
    if len(law_types) > 1:
        names = " and ".join(sorted(law_type.__name__ for law_type in law_types))
        raise ParameterError(f"The wires have laws of several classes, {names}; use one for all.")
    (law_type,) = law_types
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(law_type):
        values = [getattr(law, field.name) for law in laws]
        if not isinstance(values[0], str):
            fields[field.name] = np.array(values, float).reshape(len(laws_by_limb), 1, -1)
            continue
        # A word chooses the equations, which are the same for all wires.
        if len(words := sorted(set(values))) > 1:
            raise ParameterError(
                f"The laws of the wires have several words for {field.name}, "
                f"{' and '.join(words)}; use one for all."
            )
        fields[field.name] = values[0]
    return with_fields(law_type, fields)


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
    thermocouple: X + 1 numbers, T and V in °C. Signals at the start and at the ends of the steps of
    all runs are in S ``rows``, see `RaggedRows`, so that a run takes no longer than its own steps.

    In private methods the sets are the last axis: laws have fields (1, W, B), T0 is (R, W, B), °C,
    heat at the start (X + 1, R, W, B), and heat over time (X + 1, S, W, B). Torques are in N·m, and
    ``rubber`` is as for `simulate`.

    Args:
        duty: its mean over each step (K, R, W), in [0, 1].
        step: s.
        segment: the segment; only its links and the directions of its wires count.
        lengths: number of steps of each run (R,); K if None.
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
        self._duty = duty
        self._lengths = np.full(num_runs, num_steps) if lengths is None else np.asarray(lengths)
        self.rows = RaggedRows(self._lengths + 1)
        self._directions = np.array([wire.lever[0] for wire in segment.wires])

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
            near_first: True if all sets are so near the first that heat and torques may be linear
                in their differences from the first, as in finite differences.

        Returns:
            T and V (S, W, B), °C, and the F bends φ (S, F, B), rad.
        """
        # Move the sets to the last axis: fields (1, W, B), T0 (R, W, B), heat (X + 1, R, W, B).
        law = _map_fields(law, lambda field: np.moveaxis(field, 0, -1))
        start = np.moveaxis(np.array(initial), 1, -1)
        T0 = np.broadcast_to(ambient.T[:, None], start.shape[1:])
        _clamp_memory(_memory_ranges(law), start)
        if near_first:
            return self._simulate_near_first(law, T0, start, rubber)
        heat = self._at_steps(*self._heat(law, T0, start))
        torques_at_theta, needs_theta = self._torques(law, heat, T0)
        torques = torques_at_theta(np.zeros(1))
        bends = self._bends(torques, rubber, torques_at_theta if needs_theta else None)
        return heat[0], heat[-1], bends

    def _torques(
        self, law: WireLaw, heat: np.ndarray, T0: np.ndarray
    ) -> tuple[Callable[[np.ndarray], np.ndarray], bool]:
        """Return a function from θ (S, B) to torques (S, W, B), and whether these depend on θ."""
        torque = law_torque(law)
        points = law_points(law, heat, T0[self.rows.sequence], np.nan)
        # A torque that is nan at an unknown θ depends on θ.
        needs_theta = bool(np.isnan(torque.values(np.moveaxis(points[:, :1], 0, -1))).any())

        def torques_at_theta(theta: np.ndarray) -> np.ndarray:
            points[-1] = self._towards_wires(theta)
            return torque.values(np.moveaxis(points, 0, -1))[..., 0]

        return torques_at_theta, needs_theta

    def _towards_wires(self, theta: np.ndarray) -> np.ndarray:
        """Return by how much links turn towards each wire (S, W, B), rad, of θ (S, B)."""
        return theta[..., None, :] * self._directions[:, None]

    def _heat(self, law: WireLaw, T0: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, int]:
        """Simulate the heat in as few substeps as converge.

        A law whose heat, stress and transformation act on each other may be too fast for the step.
        If one parameter set diverges, all are simulated again in the same shorter steps, because
        they are compared with each other.

        Returns:
            Heat in the rows of all substeps (X + 1, rows, W, B), and their number in a step.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            for num_substeps in NUM_SUBSTEPS:
                heat = self._heat_in_substeps(law, T0, start, num_substeps)
                if (np.abs(heat) < DIVERGED_TEMPERATURE).all():
                    break
        return heat, num_substeps

    def _substep_rows(self, num_substeps: int) -> RaggedRows:
        """Return the rows of all runs with each step divided into so many substeps."""
        return self.rows if num_substeps == 1 else RaggedRows(self._lengths * num_substeps + 1)

    def _at_steps(self, heat: np.ndarray, num_substeps: int) -> np.ndarray:
        """Return the heat at the ends of steps (X + 1, S, W, B), of the heat in all substeps."""
        rows = self._substep_rows(num_substeps)
        return heat[:, rows.time % num_substeps == 0] if num_substeps > 1 else heat

    def _heat_in_substeps(
        self, law: WireLaw, T0: np.ndarray, start: np.ndarray, num_substeps: int
    ) -> np.ndarray:
        """Simulate the heat with each step of the duty divided; see `_heat`."""
        rows = self._substep_rows(num_substeps)
        step_function = law_step(law, self.step / num_substeps)
        memory_ranges = _memory_ranges(law)
        # All points at the start, with the runs in the order of the rows.
        runs = rows.sequence[rows.blocks[0]]
        start_points = law_points(law, start[:, runs], T0[runs], 0.0)
        duty = np.repeat(self._duty[:, runs, :, None], num_substeps, axis=0)
        heat = np.empty((len(start), rows.count, *start.shape[2:]))
        heat[:, rows.blocks[0]] = start[:, runs]
        num_runs = 0
        for step_duty, (before, after) in zip(duty, itertools.pairwise(rows.blocks), strict=True):
            # Bind the step to arrays for the runs that go on, which the loop fills and reads.
            if after.stop - after.start != num_runs:
                num_runs = after.stop - after.start
                points = start_points[:, :num_runs].copy()
                heat_after = np.empty((len(start), *points.shape[1:]))
                take_step = step_function.bound(
                    points.reshape(len(points), -1), heat_after.reshape(len(heat_after), -1)
                )
            points[: len(start)] = heat[:, before.start : before.start + num_runs]
            points[-1] = step_duty[:num_runs]
            take_step()
            _clamp_memory(memory_ranges, heat_after)
            heat[:, after] = heat_after
        return heat

    def _simulate_near_first(
        self, law: WireLaw, T0: np.ndarray, start: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Simulate sets by their differences from the first; see `simulate`."""
        # Simulate the first set alone, and find the θ about which torques are linear.
        first_law = _map_fields(law, lambda field: field[..., :1])
        first_T0 = T0[..., :1]
        substep_heat, num_substeps = self._heat(first_law, first_T0, start[..., :1])
        heat = self._at_steps(substep_heat, num_substeps)
        torques_at_theta, needs_theta = self._torques(first_law, heat, first_T0)
        theta = np.zeros((self.rows.count, 1))
        if needs_theta:
            first_rubber = {name: values[:1] for name, values in rubber.items()}
            bends = self._bends(torques_at_theta(theta), first_rubber, torques_at_theta)
            theta = bends[:, 0] / self._chain.bend_by_equal_angle
        # Differentiate T, V and torque by the P variables: initial heat, T0 and fields.
        points = law_points(
            first_law, heat, first_T0[self.rows.sequence], self._towards_wires(theta)
        )
        torques, torque_slopes = law_torque(law).first(np.moveaxis(points[..., 0], 0, -1))
        heat_slopes = self._heat_slopes(first_law, first_T0, substep_heat, num_substeps)
        num_heat = len(start)
        slopes = np.empty((3, *heat_slopes.shape[:2], heat_slopes.shape[-1]))
        slopes[:2] = heat_slopes[..., [0, -1], :].transpose(2, 0, 1, 3)
        slopes[2] = np.einsum("swh,swhp->swp", torque_slopes[..., 0, :num_heat], heat_slopes)
        slopes[2, ..., num_heat:] += torque_slopes[..., 0, num_heat:-1]
        # Follow the differences of the sets (P, R, W, B) in each run.
        variables = law_points(law, start, T0, 0.0)[:-1]
        differences = np.moveaxis(variables - variables[..., :1], 0, 2)
        signals = np.empty((*slopes.shape[:3], T0.shape[-1]))
        for run, rows in enumerate(self.rows.of_sequence):
            changes = slopes[:, rows].swapaxes(1, 2) @ differences[run]
            signals[:, rows] = changes.swapaxes(1, 2)
        signals[0] += heat[0]
        signals[1] += heat[-1]
        signals[2] += torques

        def linear_torques(any_theta: np.ndarray) -> np.ndarray:
            return signals[2] + torque_slopes[..., -1] * self._towards_wires(any_theta - theta)

        bends = self._bends(signals[2], rubber, linear_torques if needs_theta else None)
        return signals[0], signals[1], bends

    def _heat_slopes(
        self, law: WireLaw, T0: np.ndarray, heat: np.ndarray, num_substeps: int
    ) -> np.ndarray:
        """Return derivatives of the heat of one set, whose heat in the rows of substeps is given.

        They are by the initial heat, T0 and the N fields, at the ends of the steps, in each run and
        wire (S, W, X + 1, X + 2 + N).
        """
        # Differentiate each substep by the heat before it, T0 and the fields.
        rows = self._substep_rows(num_substeps)
        after = slice(rows.blocks[0].stop, None)
        runs = rows.sequence[after]
        duty = self._duty[(rows.time[after] - 1) // num_substeps, runs]
        points = law_points(law, heat[:, rows.before], T0[runs], duty[..., None])
        step_function = law_step(law, self.step / num_substeps)
        values, step_slopes = step_function.first(np.moveaxis(points[..., 0], 0, -1))
        # Memories that reach their bounds stay there.
        for row, (low, high) in _memory_ranges(law).items():
            step_slopes[(values[..., row] < low) | (values[..., row] > high), row] = 0.0
        # Chain the derivatives from step to step.
        num_heat = len(heat)
        slopes = np.empty((rows.count, *step_slopes.shape[1:3], step_slopes.shape[-1] - 1))
        slopes[rows.blocks[0]] = np.eye(*slopes.shape[2:])
        begin = 0
        with np.errstate(over="ignore", invalid="ignore"):
            for block_before, block in itertools.pairwise(rows.blocks):
                num_runs = block.stop - block.start
                own_slopes = step_slopes[begin : begin + num_runs, ..., :-1]
                before = slopes[block_before.start : block_before.start + num_runs]
                np.matmul(own_slopes[..., :num_heat], before, out=slopes[block])
                slopes[block, ..., num_heat:] += own_slopes[..., num_heat:]
                begin += num_runs
        return slopes[rows.time % num_substeps == 0] if num_substeps > 1 else slopes

    def _bends(
        self,
        torques: np.ndarray,
        rubber: Mapping[str, np.ndarray],
        torques_at_theta: Callable[[np.ndarray], np.ndarray] | None,
    ) -> np.ndarray:
        """Return the F bends φ (S, F, B), rad, under the torques of the wires.

        The bend is proportional to the angle θ of each joint, and the deflection of a joint is its
        θ less its θ at rest.

        Args:
            torques: torques of the wires (S, W, B), if they do not depend on θ.
            torques_at_theta: see `_torques`; None if torques do not depend on θ.
        """
        bend_by_theta = self._chain.bend_by_equal_angle  # (11)
        deflection = self._deflections(torques, rubber)
        # Repeat with the torques at the angle that they lead to.
        if torques_at_theta is not None:
            for _ in range(NUM_ANGLE_ITERATIONS):
                theta = deflection + rubber["rest_angle"] / bend_by_theta
                deflection = self._deflections(torques_at_theta(theta), rubber)
        return (rubber["rest_angle"] + bend_by_theta * deflection)[:, None]

    def _deflections(self, torques: np.ndarray, rubber: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the angle of each joint from rest (S, B), rad, under wires' torques (S, W, B)."""
        bend_by_theta = self._chain.bend_by_equal_angle
        deflection = self._directions @ torques / rubber["stiffness"]
        if "shift" in rubber:
            # Memory moves the rest angle towards the side of the wires that heat.
            bends_alone = np.abs(self._directions)[:, None] * torques
            bends_alone *= bend_by_theta / rubber["stiffness"]
            sides = np.sign(self._directions)[:, None, None]
            rest_shifts = self._rest_shifts(bends_alone, sides, rubber)
            deflection += rest_shifts[:, 0] / bend_by_theta
        if "stiffening" in rubber:
            # The real root δ of δ + c δ³ = deflection of rubber that does not stiffen.
            theta_at_45_deg = np.pi / 4 / bend_by_theta
            cubic = np.maximum(rubber["stiffening"], 1e-12) / theta_at_45_deg**2
            root = np.sqrt(3.0 * cubic)
            deflection = 2.0 / root * np.sinh(np.arcsinh(1.5 * root * deflection) / 3.0)
        return deflection

    def _rest_shifts(
        self, bends_alone: np.ndarray, directions: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Return how far memory moves the rest angle (S, F, B), rad; see `NonlinearRubber`.

        Args:
            bends_alone: bend that each wire would hold alone (S, W, B), rad.
            directions: directions of the wires, by each of F bends (W, F, B) or (W, F, 1).
        """
        # Each step that bends the limb further draws the rest angle after it.
        first = self.rows.blocks[0].stop
        changes = bends_alone[first:] - bends_alone[self.rows.before]
        progress = self.step * rubber["rate"] * ramp(changes / self.step)
        # Integrate the shifts by the implicit Euler method.
        drawn_shifts = rubber["shift"] * np.einsum("swb,wfb->sfb", progress, directions)
        remaining = 1 / (1 + progress.sum(axis=1, keepdims=True))
        shifts = np.zeros((self.rows.count, *drawn_shifts.shape[1:]))
        for before, after in itertools.pairwise(self.rows.blocks):
            steps = slice(after.start - first, after.stop - first)
            shifts_before = shifts[before.start : before.start + after.stop - after.start]
            shifts[after] = remaining[steps] * (shifts_before + drawn_shifts[steps])
        return shifts


def _map_fields(law: WireLaw, change: Callable[[np.ndarray], np.ndarray]) -> WireLaw:
    """Return a law whose fields that are arrays are changed by a function."""
    changed = {name: change(value) for name, value in array_fields(law).items()}
    return with_fields(type(law), vars(law) | changed)


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
