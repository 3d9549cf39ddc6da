"""From a reference to a feasible trajectory that was checked by simulation."""

import time

import numpy as np
from numpy.typing import ArrayLike
from pydrake import trajectories

from limb_systems import (
    ActiveConstraint,
    Limb,
    LimbError,
    LimbParameters,
    PlanCheck,
    Trajectory,
    simulate,
    split_state,
    torque_matrix,
)
from limb_systems.progress import Progress
from limb_systems.statics import static_equilibrium
from planners import ipopt
from planners.defects import TEMPERATURE_SCALE
from planners.program import TrajectoryProgram
from planners.quasi_static import check_temperature_limits, solve_quasi_static

# Accuracy of the simulation that a plan is checked with: a hundred times finer
# moves what it finds for the Fig. 5 reference by 0.003°.
CHECK_ACCURACY = 1e-4


class PlanningError(LimbError):
    """There is no plan: the request is impossible, or the plan failed its check."""


def plan(
    parameters: LimbParameters,
    reference: trajectories.Trajectory,
    *,
    knot_rate: float = 10.0,
    initial_state: ArrayLike | None = None,
    tolerance_deg: float = 0.1,
) -> Trajectory:
    """Plans the feasible trajectory nearest to a reference, eqns (15)-(20).

    Args:
        parameters: of the limb.
        reference: φ_ref in rad, a row for each segment, from time 0 on; it
            need not be feasible, nor continuous. See `planners.references`.
        knot_rate: knots per second, Hz. The duration of the reference is
            rounded to whole intervals.
        initial_state: x_init, a state of `Limb`; by default at rest in
            static equilibrium with wires at ambient temperature.
        tolerance_deg: how far the bend angle of the plan may be from that of
            an accurate simulation of its duty, degrees.

    Returns:
        The trajectory, with its check.

    Raises:
        InfeasibleError: if the temperature constraints cannot be met.
        PlanningError: if an argument makes no sense, IPOPT does not converge
            or the plan fails its check.
    """
    started = time.perf_counter()
    parameters.validate()
    times = _knots(reference, knot_rate)
    angles_ref = _sample_reference(reference, times, len(parameters.segments))
    rest_angles, compliance = static_equilibrium(parameters)
    state = _initial_state(parameters, initial_state, rest_angles)
    wire_temperature = split_state(parameters, state)[2]

    check_temperature_limits(parameters, times, wire_temperature)
    guess_wire, guess_duty = solve_quasi_static(
        parameters, times, angles_ref, wire_temperature, rest_angles, compliance
    )
    program = TrajectoryProgram(parameters, times, angles_ref, state)
    guess = program.variables(
        _fill_in(parameters, times, state, guess_wire, guess_duty, rest_angles, compliance),
        guess_duty,
    )
    with Progress("planning", None, "iterations") as progress:
        solution = ipopt.solve(
            program.prog,
            guess,
            program.defects,
            lambda iteration, cost, violation: progress.update(
                iteration, f"(cost {cost:.6g}, violation {violation:.1e})"
            ),
        )
    if not solution.success:
        raise PlanningError(
            f"IPOPT found no plan in {solution.iterations} iterations: {solution.status}."
        )
    joint_state, wire, measured, duty = program.signals(solution.x)
    trajectory = Trajectory(
        time=times,
        reference=angles_ref,
        duty=duty,
        joint_state=joint_state,
        wire_temperature=wire,
        measured_temperature=measured,
        parameters=parameters,
        check=PlanCheck(
            solver="IPOPT, Gauss-Newton",
            status=solution.status,
            iterations=solution.iterations,
            solve_time=solution.solve_time,
            cost=solution.cost,
            guess_cost=program.cost(guess),
            largest_defect=program.largest_defect(solution.x),
            tolerance_deg=tolerance_deg,
        ),
    )
    check = trajectory.check
    check.active_constraints = active_constraints(trajectory)
    check.largest_difference_deg = simulated_difference_deg(trajectory)
    check.total_time = time.perf_counter() - started
    if failure := check.failure():
        raise PlanningError(f"The plan failed its check: {failure}")
    return trajectory


def simulated_difference_deg(trajectory: Trajectory) -> float:
    """Largest distance of the plan's bend angle from its simulation, degrees.

    The duty of the plan is simulated with an accurate integrator from the
    plan's first state, and compared at the knots.
    """
    recording = simulate(
        Limb(trajectory.parameters),
        trajectory,
        sample_rate=(len(trajectory.time) - 1) / trajectory.duration,
        accuracy=CHECK_ACCURACY,
        initial_state=trajectory.state[:, 0],
    )
    planned = trajectory.bend_angle_at(np.minimum(recording.time, trajectory.time[-1]))
    return float(np.rad2deg(np.abs(recording.bend_angle - planned)).max())


def active_constraints(trajectory: Trajectory) -> list[ActiveConstraint]:
    """Where the plan runs along a bound of (18)-(20), as stretches of time."""
    limits, names = trajectory.parameters.temperature_limits, trajectory.parameters.wire_names
    warm = trajectory.time > limits.warm_up_time
    near_duty, near_temperature = 1e-4, 1e-3 * TEMPERATURE_SCALE
    active = []
    for index, name in enumerate(names):
        duty, wire = trajectory.duty[index], trajectory.wire_temperature[index]
        for bound, where in (
            (f"duty {name} = 0", duty < near_duty),
            (f"duty {name} = 1", duty > 1 - near_duty),
            (f"wire {name} = T_max", wire > limits.maximum - near_temperature),
            (f"wire {name} = T_warm", warm & (wire < limits.warm + near_temperature)),
        ):
            edges = np.flatnonzero(np.diff(np.r_[False, where, False]))
            active += [
                ActiveConstraint(bound, float(trajectory.time[a]), float(trajectory.time[b - 1]))
                for a, b in edges.reshape(-1, 2)
            ]
    return active


def _knots(reference: trajectories.Trajectory, knot_rate: float) -> np.ndarray:
    duration = reference.end_time()
    if not (np.isfinite(knot_rate) and knot_rate > 0):
        raise PlanningError(f"knot_rate is {knot_rate!r} Hz; it must be a positive number.")
    if reference.start_time() > 0 or not (np.isfinite(duration) and duration > 0):
        raise PlanningError(
            f"The reference lasts from {reference.start_time():g} s to {duration:g} s; "
            "it must start at 0 s and end later."
        )
    num_intervals = round(duration * knot_rate)
    if num_intervals < 1:
        raise PlanningError(
            f"A reference of {duration:g} s at {knot_rate:g} knots per second makes one knot; "
            "a plan needs two, so ask for more knots per second."
        )
    return np.linspace(0.0, duration, num_intervals + 1)


def _sample_reference(reference, times: np.ndarray, num_segments: int) -> np.ndarray:
    if reference.cols() != 1 or reference.rows() != num_segments:
        raise PlanningError(
            f"The reference has {reference.rows()} x {reference.cols()} angles; "
            f"this limb has {num_segments} segment{'s' * (num_segments > 1)}."
        )
    angles = reference.vector_values(times)
    bad = ~(np.abs(angles) <= np.pi).all(axis=0)  # also true for NaN
    if bad.any():
        index = int(np.argmax(bad))
        raise PlanningError(
            f"The reference is {np.rad2deg(angles[:, index]).tolist()}° at {times[index]:g} s; "
            "bend angles must be numbers from -180° to 180°."
        )
    return angles


def _initial_state(parameters: LimbParameters, initial_state, rest_angles) -> np.ndarray:
    num_wires = len(parameters.wires)
    temperatures = np.full(2 * num_wires, parameters.ambient_temperature)
    rest = np.concatenate([rest_angles, np.zeros_like(rest_angles), temperatures])
    if initial_state is None:
        return rest
    state = np.asarray(initial_state, float)
    if state.shape != rest.shape or not np.isfinite(state).all():
        raise PlanningError(
            f"initial_state must be {rest.size} finite numbers, a state of this limb's `Limb`."
        )
    return state


def _fill_in(
    parameters: LimbParameters,
    times: np.ndarray,
    initial_state: np.ndarray,
    wire: np.ndarray,
    duty: np.ndarray,
    rest_angles: np.ndarray,
    compliance: np.ndarray,
) -> np.ndarray:
    """States (2n + 2W, N) that go with a quasi-static plan's T and D."""
    ambient = parameters.ambient_temperature
    a1, a2, a3 = (
        np.array([[getattr(wire, name)] for wire in parameters.wires])
        for name in ("a1", "a2", "a3")
    )
    to_angles = compliance @ torque_matrix(parameters)
    angles = rest_angles[:, None] + to_angles @ (wire - ambient)
    rates = to_angles @ (a1 * (wire - ambient) + a2 * duty)
    measured = np.empty_like(wire)
    measured[:, 0] = split_state(parameters, initial_state)[3]
    step, lag = times[1] - times[0], a3[:, 0]
    # V follows T by (7); the exact solution for T linear in between.
    decay = np.exp(lag * step)
    for k in range(len(times) - 1):
        slope = (wire[:, k + 1] - wire[:, k]) / step
        delay = slope / lag
        offset = measured[:, k] - wire[:, k] - delay
        measured[:, k + 1] = wire[:, k + 1] + delay + decay * offset
    states = np.vstack([angles, rates, wire, measured])
    states[:, 0] = initial_state
    return states
