"""The quasi-static plan: a convex program, the start for the real one.

The mechanics is fast (5 Hz) and the heat is slow (0.1 Hz), so joint angles
nearly are where the wires' torques hold them: K θ = f(T). With that, the cost
(15) is quadratic in the wire temperatures and duty, whose dynamics (6) and
bounds (18)-(20) are linear.
"""

import numpy as np
from pydrake.solvers import (
    ClarabelSolver,
    LinearEqualityConstraint,
    MathematicalProgram,
    SolverOptions,
)

from limb_systems import LimbParameters, joint_angles_from_bend_angle, torque_matrix
from planners.defects import linear_defect_terms
from planners.program import add_duty_cost, add_thermal_limits, hold_duty
from planners.solving import PlanningError
from planners.task import Task


class InfeasibleError(PlanningError):
    """No duty within [0, 1] meets the temperature constraints (19)-(20)."""


def check_temperature_limits(
    parameters: LimbParameters,
    times: np.ndarray,
    initial_temperature: np.ndarray,
    warm_up_time: float,
) -> None:
    """Tells whether (19)-(20) can be met at all, wire by wire.

    More duty is more heat at all later times, so the temperatures at full
    and at zero duty enclose all others.

    Args:
        times: of the knots (N,), s.
        initial_temperature: T of the wires at the start (W,), °C.
        warm_up_time: k_warm, s from the first knot.

    Raises:
        InfeasibleError: with the wire, the constraint and from when it could
            be met.
    """
    limits = parameters.temperature_limits
    warm_knots = times > warm_up_time
    for wire, name, start in zip(
        parameters.wires, parameters.wire_names, initial_temperature, strict=True
    ):
        if _temperature(wire, parameters, start, times[1], duty=0.0) > limits.maximum:
            below = _time_to_reach(wire, parameters, start, limits.maximum, duty=0.0)
            raise InfeasibleError(
                f"The {name} wire starts at {start:.4g} °C, above T_max = {limits.maximum:g} °C "
                f"(19); let it cool for {below:.3g} s first."
            )
        if not warm_knots.any():
            continue
        first = times[np.argmax(warm_knots)]
        hottest = _temperature(wire, parameters, start, first, duty=1.0)
        if hottest >= limits.warm:
            continue
        reached = _time_to_reach(wire, parameters, start, limits.warm, duty=1.0)
        steady = parameters.ambient_temperature - wire.a2 / wire.a1
        advice = (
            f"it could from {reached:.3g} s on, so set temperature_limits.warm_up_time to that"
            if np.isfinite(reached)
            else f"it never gets above {steady:.4g} °C"
        )
        raise InfeasibleError(
            f"The {name} wire cannot be at T_warm = {limits.warm:g} °C (20) by {first:g} s: at "
            f"full duty from {start:.4g} °C it reaches {hottest:.4g} °C by then; {advice}."
        )


def solve_quasi_static(
    parameters: LimbParameters,
    times: np.ndarray,
    reference: np.ndarray,
    initial_temperature: np.ndarray,
    rest_angles: np.ndarray,
    compliance: np.ndarray,
    task: Task,
    warm_up_time: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Wire temperature and duty of the best quasi-static plan.

    Args:
        times: of the knots (N,), s.
        reference: φ_ref at the knots (S, N), rad.
        initial_temperature: T of the wires at the start (W,), °C.
        rest_angles: θ with cold wires (n,), rad.
        warm_up_time: k_warm, s from the first knot.
        compliance: joint deflection per generalized force (n, n), rad/(N·m).

    Returns:
        T (W, N) in °C and D (W, N).

    Raises:
        InfeasibleError: if the convex program has no solution.
    """
    num_knots, num_wires = len(times), len(parameters.wires)
    ambient = parameters.ambient_temperature
    a1 = np.array([wire.a1 for wire in parameters.wires])
    a2 = np.array([wire.a2 for wire in parameters.wires])

    prog = MathematicalProgram()
    wire = prog.NewContinuousVariables(num_knots, num_wires, "T")
    duty = prog.NewContinuousVariables(num_knots, num_wires, "D")
    P, Q, R = linear_defect_terms(np.diag(a1), np.diag(a2))  # (6)
    heating = {}
    for k, h in enumerate(np.diff(times)):
        if h not in heating:
            defect = P / h + Q + R * h
            at_ambient = defect @ np.repeat([ambient, 0.0], 2 * num_wires)
            heating[h] = LinearEqualityConstraint(defect, at_ambient)
        prog.AddConstraint(heating[h], np.r_[wire[k], wire[k + 1], duty[k], duty[k + 1]])

    to_angles = compliance @ torque_matrix(parameters)  # θ = K⁻¹ f(T), eqns (2), (4)
    cold = rest_angles - to_angles @ np.full(num_wires, ambient)
    target = joint_angles_from_bend_angle(parameters, reference) - cold[:, None]
    angle_weights, _ = task.weights(times)
    for k in range(num_knots):
        weighted = angle_weights[k] * to_angles.T
        prog.AddQuadraticCost(
            weighted @ to_angles, -weighted @ target[:, k], wire[k], is_convex=True
        )
    add_duty_cost(prog, times, duty, task)
    hold_duty(prog, times, duty, task)
    prog.AddBoundingBoxConstraint(initial_temperature, initial_temperature, wire[0])
    add_thermal_limits(prog, parameters, times, wire, duty, task, warm_up_time)

    result = ClarabelSolver().Solve(prog, None, SolverOptions())
    if not result.is_success():
        also = " and the task's max_temperature_rate" if task.max_temperature_rate else ""
        raise InfeasibleError(
            "The temperature constraints (19)-(20) cannot all be met with duty between 0 and 1"
            f"{also} (the quasi-static program: "
            f"{result.get_solution_result().name})."
        )
    return result.GetSolution(wire).T, np.clip(result.GetSolution(duty).T, 0.0, 1.0)


def _temperature(wire, parameters: LimbParameters, start: float, time: float, duty: float) -> float:
    """Solution of eqn (6) at constant duty, °C."""
    steady = parameters.ambient_temperature - wire.a2 / wire.a1 * duty
    return steady + (start - steady) * np.exp(wire.a1 * time)


def _time_to_reach(
    wire, parameters: LimbParameters, start: float, target: float, duty: float
) -> float:
    """When the solution of eqn (6) at constant duty gets to a temperature, s or inf."""
    steady = parameters.ambient_temperature - wire.a2 / wire.a1 * duty
    if start == steady or not 0 < (target - steady) / (start - steady) <= 1:
        return np.inf
    return float(np.log((target - steady) / (start - steady)) / wire.a1)
