"""The start of a trajectory program from the quasi-static plan: motion, and multipliers.

The motion [θ, θ̇] of all knots follows from the heat by the rows (17) of `MotionDefects`, and the
multipliers of these rows follow from the cost by the adjoint of the rows. The multipliers of the
heat and of its bounds are the quasi-static plan's multipliers.
"""

import numpy as np

from limb_systems import LimbError
from planners.recurrence import LinearRecurrence
from planners.transcription.program import TrajectoryProgram
from planners.transcription.quasi_static import QuasiStaticProgram
from planners.transcription.solving import Solution

FEASIBILITY_TOLERANCE = 1e-9  # of the scaled rows of the motion
SLOPE_TOLERANCE = 1e-2  # rad and rad/s; after a smaller step, slopes are nearly the same
MAX_ITERATIONS = 20


def solve_motion(
    program: TrajectoryProgram, x: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return decision variables whose motion obeys (17), by Newton's method from a motion near it.

    Args:
        x: all decision variables.

    Returns:
        All decision variables; the slopes of `_step_to_next_knot` near them.

    Raises:
        LimbError: if Newton's method finds no motion.
    """
    x = x.copy()
    motion = program.motion
    inverse, to_next = _step_to_next_knot(program, x)
    steps = LinearRecurrence(to_next)
    change = 0.0
    for _ in range(MAX_ITERATIONS):
        rows = program.defects.evaluate(x).reshape(motion.shape[1], -1).T
        if np.abs(rows).max() < FEASIBILITY_TOLERANCE:
            return x, (inverse, to_next)
        # Linearize the rows again, unless the last step was small.
        if change > SLOPE_TOLERANCE:
            inverse, to_next = _step_to_next_knot(program, x)
            steps = LinearRecurrence(to_next)
        # Correct the motion from knot to knot.
        gaps = -(inverse @ rows[:, :, None])[:, :, 0]
        moved = steps.solve(gaps)
        x[motion] += moved
        change = np.abs(moved).max()
        if not np.isfinite(change):
            break
    raise LimbError("Newton's method does not find the motion of the quasi-static plan.")


def estimate_multipliers(
    program: TrajectoryProgram,
    x: np.ndarray,
    slopes: tuple[np.ndarray, np.ndarray],
    quasi_static: QuasiStaticProgram,
    solution: Solution,
) -> tuple[np.ndarray, np.ndarray]:
    """Return multipliers of the constraints and of the bounds of a program near its solution.

    Args:
        x, slopes: as returned by `solve_motion`.
        quasi_static, solution: the quasi-static program of the same plan, and its solution.
    """
    # The multipliers of the motion, by the adjoint from the last knot to the first.
    inverse, to_next = slopes
    by_motion: np.ndarray = np.zeros(program.motion.shape)
    by_angles = program.cost_by_angles(x)
    by_motion[:, : by_angles.shape[1]] = by_angles
    to_knot_before = np.roll(to_next, -1, axis=0)[::-1].swapaxes(1, 2)
    adjoint = LinearRecurrence(to_knot_before).solve(by_motion[:0:-1])[:0:-1]
    of_motion = -np.einsum("kij,ki->kj", inverse, adjoint)

    # The multipliers of the heat and of the bounds are the quasi-static ones.
    if solution.multipliers is None:
        raise LimbError("The quasi-static program was not solved by its cheap blocks.")
    of_rows, of_bounds = solution.multipliers
    assert quasi_static.cheap_blocks  # they are the same for heat
    num_block_rows = sum(len(block.lower) for block in quasi_static.cheap_blocks)
    num_heat_rows = num_block_rows - quasi_static.bends.size
    of_heat = of_rows[:num_heat_rows]
    of_rows = np.concatenate([of_motion.T.ravel(), of_heat, of_rows[num_block_rows:]])
    bounds = np.zeros(len(x))
    bounds[program.heat] = of_bounds[quasi_static.heat]
    bounds[program.duty] = of_bounds[quasi_static.duty]
    return of_rows, bounds


def _step_to_next_knot(program: TrajectoryProgram, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the inverse of the rows' slopes by the next motion, and its slopes by the motion."""
    before, after = program.defects.slopes_by_motion(x)
    inverse = np.linalg.inv(after)
    return inverse, -inverse @ before
