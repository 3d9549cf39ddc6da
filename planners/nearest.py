"""The plan nearest to a reference within the limits of a limb."""

import numpy as np

from limb_systems import LimbError, Trajectory, split_state
from planners.task import Task
from planners.transcription.quasi_static import solve_quasi_static

# R → 0, without margins and without the smooth end of a plan.
NEAREST_TASK = Task(duty_weight=1e-3, terminal_factor=1.0, duty_hold=0.0)
KNOT_RATE = 5.0  # Hz; ten knots per second change the mean distance by 0.02°


def nearest_plan(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray] | None:
    """Return bend angles and wire temperatures of the plan nearest to a reference within limits.

    The quasi-static program is solved with nearly no weight on duty, from the start of the
    trajectory and within (18)-(20) and ``measured_maximum`` alone, without the trajectory's own
    task. The solver starts from the trajectory, so that no farther optimum is returned. It takes
    about a second for a minute.

    Args:
        trajectory: a plan for the reference.

    Returns:
        φ (F, K), rad, and T (W, K), °C, at the knots; None if there is no such plan.
    """
    # Sample the plan at fewer knots.
    plan = trajectory.since_start()
    model = plan.model
    num_knots = min(len(plan.time), int(np.ceil(plan.duration * KNOT_RATE)) + 1)
    times = np.linspace(0.0, plan.duration, max(2, num_knots))
    reference = plan.interpolated(plan.reference, times)
    states, readings = split_state(model, plan.state_trajectory().vector_values(times))[2:]
    heat = np.vstack([states, readings])
    duty = np.clip(plan.duty_trajectory().vector_values(times), 0.0, 1.0)
    # Solve from there.
    warm_up = max(0.0, model.parameters.temperature_limits.warm_up_time - float(trajectory.time[0]))
    try:
        program, solution = solve_quasi_static(
            model, times, reference, heat[:, 0], NEAREST_TASK, warm_up, start=(heat, duty)
        )
    except LimbError:  # infeasible, or the limb folds
        return None

    def at_knots(rows: np.ndarray) -> np.ndarray:
        return np.array([np.interp(plan.time, times, row) for row in rows])

    heat = solution.x[program.heat].T
    return at_knots(solution.x[program.bends].T), at_knots(heat[: program.wires.num_wires])


def nearest_bend_angle(trajectory: Trajectory) -> np.ndarray | None:
    """Return the bend angles φ (F, K) of `nearest_plan`, rad; None if there is none.

    There is none for a plan with constraints of ``customize``, which limit it, too, and which are
    not in its file.
    """
    if trajectory.check.added_constraints:
        return None
    nearest = nearest_plan(trajectory)
    return nearest and nearest[0]
