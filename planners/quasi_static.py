"""The quasi-static plan: a convex program, from which the trajectory program starts.

The mechanics is fast (5 Hz) and the heat is slow (0.1 Hz), so the joint angles
nearly are where the wires' torques hold them: K θ = f(x). With this, the cost
(15) is quadratic in the wires' states and duty, whose dynamics (6) and bounds
(18)-(20) are linear. If a law's torque is not affine, it is replaced by its
tangents at the previous solution, a few times.
"""

import functools
from collections.abc import Callable

import numpy as np
from pydrake.solvers import (
    ClarabelSolver,
    LinearEqualityConstraint,
    MathematicalProgram,
    SolverOptions,
)

from limb_systems import LimbParameters, Wires, joint_angles_from_bend_angle
from planners.defects import linear_defect_terms
from planners.program import add_duty_cost, add_thermal_limits, hold_duty
from planners.solving import PlanningError
from planners.task import Task

MAX_TANGENTS = 6  # times that the torque is linearized
SAME_STATES = 0.01  # in typical changes; within this, the tangents are not updated


class InfeasibleError(PlanningError):
    """No duty within [0, 1] meets the temperature constraints (19)-(20)."""


def check_temperature_limits(
    parameters: LimbParameters,
    times: np.ndarray,
    initial_states: np.ndarray,
    warm_up_time: float,
) -> None:
    """Checks whether (19)-(20) can be met at all, wire by wire.

    More duty means more heat at all later times, so the temperatures at full
    and at zero duty enclose all others.

    Args:
        times: of the knots (K,), s.
        initial_states: x of the wires at the start (N,), as in `Wires`.
        warm_up_time: k_warm, s from the first knot.

    Raises:
        InfeasibleError: names the wire, the constraint and the time from which
            it could be met.
    """
    limits, wires = parameters.temperature_limits, Wires(parameters)
    warm_knots = times > warm_up_time

    def course(level: float, which: int | slice, until: np.ndarray) -> np.ndarray:
        """T of a wire (K,), or of several (K, ..), at times (K,) with all wires at this duty."""
        duty = np.full(wires.num_wires, level)
        return wires.at_constant_duty(initial_states, duty, until)[:, which]

    each = slice(0, wires.num_wires)
    cooled = course(0.0, each, times[1:2])[0]
    first = times[np.argmax(warm_knots)]
    hottest = course(1.0, each, np.array([first]))[0]
    for index, name in enumerate(parameters.wire_names):
        start = initial_states[index]
        if cooled[index] > limits.maximum:
            below = _time_to_reach(wires, functools.partial(course, 0.0, index), limits.maximum)
            raise InfeasibleError(
                f"The {name} wire starts at {start:.4g} °C, above T_max = {limits.maximum:g} °C "
                f"(19); let it cool for {below:.3g} s first."
            )
        if hottest[index] >= limits.warm or not warm_knots.any():
            continue
        reached = _time_to_reach(wires, functools.partial(course, 1.0, index), limits.warm)
        steady = course(1.0, index, np.array([_settling_time(wires)]))[0]
        advice = (
            f"it could from {reached:.3g} s on, so set temperature_limits.warm_up_time to that"
            if np.isfinite(reached)
            else f"it never gets above {steady:.4g} °C"
        )
        raise InfeasibleError(
            f"The {name} wire cannot be at T_warm = {limits.warm:g} °C (20) by {first:g} s: at "
            f"full duty from {start:.4g} °C it reaches {hottest[index]:.4g} °C by then; {advice}."
        )


def solve_quasi_static(
    parameters: LimbParameters,
    times: np.ndarray,
    reference: np.ndarray,
    initial_states: np.ndarray,
    rest_angles: np.ndarray,
    compliance: np.ndarray,
    task: Task,
    warm_up_time: float,
) -> tuple[np.ndarray, np.ndarray]:
    """States and duty of the wires in the best quasi-static plan.

    Args:
        times: of the knots (K,), s.
        reference: φ_ref at the knots (S, K), rad.
        initial_states: x of the wires at the start (N,), as in `Wires`.
        rest_angles: θ with cold wires (n,), rad.
        compliance: joint deflection per generalized force (n, n), rad/(N·m).
        warm_up_time: k_warm, s from the first knot.

    Returns:
        x (N, K), of which the first W are T in °C, and D (W, K).

    Raises:
        InfeasibleError: if the convex program has no solution.
    """
    wires = Wires(parameters)
    num_knots, num_states, num_wires = len(times), wires.num_states, wires.num_wires

    prog = MathematicalProgram()
    states = prog.NewContinuousVariables(num_knots, num_states, "x")
    duty = prog.NewContinuousVariables(num_knots, num_wires, "D")
    A, B, c = wires.affine_rates()
    P, Q, R = linear_defect_terms(A, np.column_stack([B, c]))  # (6), with an input that is one
    one = 2 * num_states + np.array([num_wires, 2 * num_wires + 1])
    heating = {}
    for k, h in enumerate(np.diff(times)):
        if h not in heating:
            defect = P / h + Q + R * h
            heating[h] = LinearEqualityConstraint(
                np.delete(defect, one, axis=1), -defect[:, one].sum(axis=1)
            )
        prog.AddConstraint(heating[h], np.r_[states[k], states[k + 1], duty[k], duty[k + 1]])

    target = joint_angles_from_bend_angle(parameters, reference).T
    angle_weights, _ = task.weights(times)
    costs = [
        prog.AddQuadraticCost(np.eye(num_states), np.zeros(num_states), x, is_convex=True)
        for x in states
    ]
    add_duty_cost(prog, times, duty, task)
    hold_duty(prog, times, duty, task)
    prog.AddBoundingBoxConstraint(initial_states, initial_states, states[0])
    add_thermal_limits(prog, parameters, times, states, duty, task, warm_up_time)

    warm = 0.5 * (parameters.temperature_limits.warm + parameters.temperature_limits.maximum)
    found = np.tile(wires.settled_states(np.full(num_wires, warm)), (num_knots, 1))
    for _ in range(MAX_TANGENTS):
        before = found
        angles, slopes = quasi_static_angles(wires, before, rest_angles, compliance)
        offsets = angles - np.einsum("kij,kj->ki", slopes, before) - target
        for cost, weight, to_angles, offset in zip(
            costs, angle_weights, slopes, offsets, strict=True
        ):
            weighted = weight * to_angles.T
            cost.evaluator().UpdateCoefficients(
                weighted @ to_angles, weighted @ offset, is_convex=True
            )
        result = ClarabelSolver().Solve(prog, None, SolverOptions())
        if not result.is_success():
            also = " and the task's max_temperature_rate" if task.max_temperature_rate else ""
            raise InfeasibleError(
                "The temperature constraints (19)-(20) cannot all be met with duty between 0 and 1"
                f"{also} (the quasi-static program: "
                f"{result.get_solution_result().name})."
            )
        found = result.GetSolution(states)
        moved = np.abs(found - before) / wires.heat_scales[:num_states]
        if wires.torque_is_affine or moved.max() < SAME_STATES:
            break
    return found.T, np.clip(result.GetSolution(duty).T, 0.0, 1.0)


def quasi_static_angles(
    wires: Wires, states: np.ndarray, rest_angles: np.ndarray, compliance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles that the wires hold, θ = K⁻¹ f(x) by eqns (2), (4), near the limb at rest.

    Args:
        states: x (K, N).
        rest_angles, compliance: as for `solve_quasi_static`.

    Returns:
        θ (K, n), rad, and its derivatives by x (K, n, N).
    """
    rest = np.broadcast_to(rest_angles, (len(states), len(rest_angles)))
    forces = wires.forces(states, rest) - wires.forces(wires.cold_states, rest_angles)
    slopes = compliance @ wires.force_derivatives(states, rest)[0]
    return rest + forces @ compliance.T, np.broadcast_to(slopes, (len(states), *slopes.shape[1:]))


def _settling_time(wires: Wires) -> float:
    """Time after which wires at constant duty have settled, s."""
    return 12.0 / np.abs(np.linalg.eigvals(wires.affine_rates()[0])).min()


def _time_to_reach(
    wires: Wires, course: Callable[[np.ndarray], np.ndarray], target: float
) -> float:
    """When T, a function of times, gets to a temperature for the first time, s or inf."""
    start, end = 0.0, _settling_time(wires)
    for _ in range(2):  # coarsely, then within the interval that was found
        times = np.linspace(start, end, 1000)
        above = course(times) > target
        crossings = np.flatnonzero(above[1:] != above[:-1])
        if len(crossings) == 0:
            return np.inf
        start, end = times[crossings[0] : crossings[0] + 2]
    return float(end)
