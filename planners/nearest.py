"""How near a limb could have come to a reference: the best plan that its limits leave."""

import numpy as np

from limb_systems import LimbError, Trajectory, split_state
from planners.task import Task
from planners.transcription.quasi_static import solve_quasi_static

# R → 0, and neither margins nor what smooths the end of a plan.
NEAREST = Task(duty_weight=1e-3, terminal_factor=1.0, duty_hold=0.0)
KNOT_RATE = 5.0  # Hz; ten knots per second change the mean distance by 0.02°


def nearest_plan(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray] | None:
    """Bend angles and wire temperatures of the plan nearest to a reference that the limits allow.

    The quasi-static program is solved with next to no weight on duty, from where the trajectory
    starts and within (18)-(20) and ``measured_maximum`` alone, whatever the trajectory's own task
    was. The solver starts from the trajectory, so that it ends at no optimum farther away. It takes
    about a second for a minute.

    Args:
        trajectory: a plan for the reference.

    Returns:
        φ (F, K), rad, and T (W, K), °C, at the knots; None if there is no such plan.
    """
    plan = trajectory.since_start()
    model = plan.model
    num_knots = min(len(plan.time), int(np.ceil(plan.duration * KNOT_RATE)) + 1)
    times = np.linspace(0.0, plan.duration, max(2, num_knots))
    reference = plan.interpolated(plan.reference, times)
    warm_up = max(0.0, model.parameters.temperature_limits.warm_up_time - float(trajectory.time[0]))
    states, readings = split_state(model, plan.state_trajectory().vector_values(times))[2:]
    heat, duty = np.vstack([states, readings]), plan.duty_trajectory().vector_values(times)
    try:
        program, solution = solve_quasi_static(
            model,
            times,
            reference,
            heat[:, 0],
            NEAREST,
            warm_up,
            start=(heat, np.clip(duty, 0.0, 1.0)),
        )
    except LimbError:  # infeasible, or the limb folds
        return None
    heat = solution.x[program.heat].T
    bend = solution.x[program.bends].T
    bend, temperature = (
        np.array([np.interp(plan.time, times, row) for row in rows])
        for rows in (bend, heat[: program.wires.num_wires])
    )
    return bend, temperature


def nearest_bend_angle(trajectory: Trajectory) -> np.ndarray | None:
    """Return the bend angles φ (F, K) of `nearest_plan`, rad; None if there is none.

    There is none either for a plan with constraints of one's own, which limit it, too, and which
    its file does not have.
    """
    if trajectory.check.added_constraints:
        return None
    found = nearest_plan(trajectory)
    return found and found[0]
