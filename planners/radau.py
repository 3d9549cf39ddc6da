"""The simulation of a planned duty by Radau IIA of the limb's own equations, all steps at once.

A step of length h from (q, v) has three stages, at shares c of it, whose accelerations a are the
unknowns:

    q_i = q + c_i h v + h² Σ_j (A²)_ij a_j,    v_i = v + h Σ_j A_ij a_j,    r(q_i, v_i, a_i) = 0

The last stage is where the next step starts. Newton's method starts from the plan, which is near:
it solves the stages of all steps for the states at which they start, and then follows these states
from step to step. The method has order 5 and damps stiff modes.
"""

import dataclasses
from collections.abc import Callable

import casadi as ca
import numpy as np

from limb_systems import LimbError, Trajectory, split_state
from limb_systems.limb_mechanics import ANGLE_SCALE
from limb_systems.smooth_function import SmoothFunction
from limb_systems.wires import Wires, among_zeros
from planners.recurrence import LinearRecurrence

MAX_STEP = 0.1  # s
CONVERGENCE_TOLERANCE = 1e-5  # of the scales of the states; the next step would be far smaller
SLOPE_TOLERANCE = 1e-2  # of the scales; from there on, slopes are nearly the same
MAX_ITERATIONS = 20
STEP_TOLERANCE = 6e-6  # rad, of what a step adds to q; a longer step is cut in pieces
MAX_REFINEMENTS = 6
# The error that a step adds to q, by h² times the jump of its acceleration between two steps, and
# by h times the fourth difference of a plan's rates.
JUMP_ERROR_FACTOR = 1 / 60
BEND_ERROR_FACTOR = 3e-3

NODES = np.array([(4 - 6**0.5) / 10, (4 + 6**0.5) / 10, 1.0])
_POWERS = np.arange(3)
_TO_POWERS = np.linalg.inv(NODES[:, None] ** _POWERS)  # of the quadratic through three stages
_START_WEIGHTS = _TO_POWERS[0]  # weights of the stages in their quadratic at the start of the step


def _integral_weights(shares: np.ndarray) -> np.ndarray:
    """Return weights (..., 3) of the stages in their quadratic's integral over shares (...)."""
    return shares[..., None] ** (_POWERS + 1) / (_POWERS + 1) @ _TO_POWERS


def _integral_weights_twice(shares: np.ndarray) -> np.ndarray:
    """Return weights (..., 3) of the stages in the double integral of their quadratic."""
    powers = shares[..., None] ** (_POWERS + 2)
    return powers / ((_POWERS + 1) * (_POWERS + 2)) @ _TO_POWERS


A = _integral_weights(NODES)
A_SQUARED = _integral_weights_twice(NODES)


@dataclasses.dataclass
class MotionSteps:
    """A motion q (n,) in K steps.

    - ``times``: times between the steps (K + 1,), s.
    - ``start``: [q, v] at the beginning of each step (K, 2n).
    - ``accelerations``: q̈ at the stages (K, 3, n).
    """

    times: np.ndarray
    start: np.ndarray
    accelerations: np.ndarray

    @property
    def stage_times(self) -> np.ndarray:
        """The times of the stages (K, 3), s."""
        return self.times[:-1, None] + np.diff(self.times)[:, None] * NODES

    def stages(self) -> tuple[np.ndarray, np.ndarray]:
        """Return q and v at the stages (K, 3, n)."""
        h = np.diff(self.times)[:, None, None]
        q, v = np.split(self.start[:, None], 2, axis=-1)
        moved = h * NODES[:, None] * v + h**2 * (A_SQUARED @ self.accelerations)
        return q + moved, v + h * (A @ self.accelerations)

    def at(self, times: np.ndarray) -> np.ndarray:
        """Return q (M, n) at times (M,)."""
        last = len(self.start) - 1
        step = np.searchsorted(self.times, times, side="right").clip(1, last + 1) - 1
        h = np.diff(self.times)[step, None]
        share = (times - self.times[step]) / h[:, 0]
        q, v = np.split(self.start[step], 2, axis=-1)
        bent = (_integral_weights_twice(share)[:, None] @ self.accelerations[step])[:, 0]
        return q + share[:, None] * h * v + h**2 * bent

    def errors(self) -> np.ndarray:
        """Estimate the largest error of q that each step adds (K,), by jumps of accelerations."""
        jumps = np.zeros(len(self.start))
        begins = np.einsum("j,kjn->kn", _START_WEIGHTS, self.accelerations[1:])
        jumps[1:] = np.abs(begins - self.accelerations[:-1, 2]).max(axis=-1)
        jumps[:-1] = np.maximum(jumps[:-1], jumps[1:])
        return JUMP_ERROR_FACTOR * np.diff(self.times) ** 2 * jumps


def solve_steps(
    residual: Callable[[np.ndarray, np.ndarray], np.ndarray],
    slopes: Callable[[np.ndarray, np.ndarray], np.ndarray],
    guess: MotionSteps,
    parameters: np.ndarray,
    scales: np.ndarray,
) -> MotionSteps:
    """Return the solution of r(q, v, a) = 0 at all stages, from the first state of a guess.

    Args:
        residual: returns r (K, 3, n) at points [q, v, a] (K, 3, 3n) and parameters.
        slopes: returns the slopes of r by the points (K, 3, n, 3n), which may be approximate.
        guess: a motion that is near the solution.
        parameters: further arguments of the residual at the stages (K, 3, size).
        scales: typical changes of [q, v] (2n,).

    Raises:
        LimbError: if Newton's method finds no solution.
    """
    steps = MotionSteps(guess.times, guess.start.copy(), guess.accelerations.copy())
    h = np.diff(steps.times)[:, None, None]
    (K, _, n) = steps.accelerations.shape
    change = np.inf
    for _ in range(MAX_ITERATIONS):
        q, v = steps.stages()
        points = np.concatenate([q, v, steps.accelerations], axis=-1)
        if change > SLOPE_TOLERANCE:
            inverse, by_start, to_end = _linearize_stages(slopes(points, parameters), h)
            starts = LinearRecurrence(to_end[:-1])
        values = residual(points, parameters)
        # The stages of each step, as if its start were right.
        correction = -(inverse @ values.reshape(K, 3 * n, 1)).reshape(K, 3, n, 1)
        ends = np.concatenate([q[:, 2], v[:, 2]], axis=-1)
        ends += _change_over_step(correction, h)[..., 0]
        # The starts, one after the other.
        moved = starts.solve(ends[:-1] - steps.start[1:])
        steps.start += moved
        steps.accelerations += (correction + by_start @ moved[:, None, :, None])[..., 0]
        change = np.abs(moved / scales).max()
        if change < CONVERGENCE_TOLERANCE:
            return steps
        if not np.isfinite(change):
            break
    raise LimbError("Newton's method does not find the motion of the limb.")


def _linearize_stages(
    slopes: np.ndarray, h: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the derivatives of the stages of steps of length h (K, 1, 1).

    Args:
        slopes: of the residual by [q, v, a] (K, 3, n, 3n).

    Returns:
        The inverse of the residual's derivative by the accelerations (K, 3n, 3n); the accelerations
        by the start (K, 3, n, 2n); the end by the start (K, 2n, 2n).
    """
    by_q, by_v, by_a = np.split(slopes, 3, axis=-1)
    K, _, n, _ = by_q.shape
    by_stage = (h * A)[:, :, None, :, None] * by_v[:, :, :, None]
    by_stage += (h**2 * A_SQUARED)[:, :, None, :, None] * by_q[:, :, :, None]
    for stage in range(3):
        by_stage[:, stage, :, stage] += by_a[:, stage]
    inverse = np.linalg.inv(by_stage.reshape(K, 3 * n, 3 * n))
    by_rate = by_v + h[..., None] * NODES[:, None, None] * by_q
    start = np.concatenate([by_q, by_rate], axis=-1).reshape(K, 3 * n, 2 * n)
    by_start = -(inverse @ start).reshape(K, 3, n, 2 * n)
    to_end = _change_over_step(by_start, h) + np.eye(2 * n)
    to_end[:, :n, n:] += h * np.eye(n)
    return inverse, by_start, to_end


def _change_over_step(accelerations: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Return the change of [q, v] (K, 2n, m) by accelerations (K, 3, n, m) over steps h."""
    q, v = (np.einsum("s,ksnm->knm", weights, accelerations) for weights in (A_SQUARED[2], A[2]))
    return np.concatenate([h**2 * q, h * v], axis=1)


def simulate_plan(trajectory: Trajectory, times: np.ndarray) -> np.ndarray:
    """Return the joint angles (n, M), rad, at times (M,), s, under the duty of a plan.

    The limb starts from the plan's first state.

    Args:
        trajectory: a plan that starts at time 0.

    Raises:
        LimbError: if Newton's method finds no solution.
    """
    knots = trajectory.time
    model = trajectory.model
    wires = model.wires
    groups = wires.equal_wires()
    heatings = model.once(
        "heating", lambda: [_heating_residual(wires, group[0][0], group[1][0]) for group in groups]
    )
    angles, rates, states, _ = split_state(model, trajectory.state)
    motion_scales = np.repeat([ANGLE_SCALE, 1.0], len(angles))

    # Begin with steps from knot to knot, shorter ones where the plan's accelerations are bent.
    bends = np.zeros(len(knots))
    if len(knots) > 4:
        bends = np.pad(np.abs(np.diff(rates, 4)).max(axis=0), 2, mode="edge")
    errors = BEND_ERROR_FACTOR * np.diff(knots) * np.maximum(bends[:-1], bends[1:])
    pieces = np.maximum(np.diff(knots) / MAX_STEP, _num_pieces(errors))
    ends = _subdivide(knots, pieces)
    for _ in range(MAX_REFINEMENTS):
        # Integrate the heat, wire by wire, and the motion under it.
        guess = _initial_steps(trajectory, ends, angles, rates)
        duty = [np.interp(guess.stage_times, knots, row) for row in trajectory.duty]
        heat = np.empty((len(ends) - 1, len(NODES), len(states)))
        for heating, group in zip(heatings, groups, strict=True):
            for columns, wire in zip(*group, strict=True):
                of_wire = states[columns]
                start = _initial_steps(trajectory, ends, np.zeros_like(of_wire), of_wire)
                levels = np.stack([duty[index] for index in wire], axis=-1)
                scales = np.append(np.full(len(columns), np.inf), wires.heat_scales[columns])
                slopes = heating.dense_slopes
                heat[..., columns] = solve_steps(
                    heating.values, slopes, start, levels, scales
                ).stages()[1]
        dynamics = model.dynamics
        steps = solve_steps(
            dynamics.by_motion.values, dynamics.slow_slopes, guess, heat, motion_scales
        )
        # Cut the steps with large errors.
        errors = steps.errors()
        if (errors <= STEP_TOLERANCE).all():
            break
        ends = _subdivide(ends, _num_pieces(errors))
    return steps.at(times).T


def _initial_steps(
    trajectory: Trajectory, times: np.ndarray, q: np.ndarray, v: np.ndarray
) -> MotionSteps:
    """Return steps that end at some times, of q and v (n, K) at the knots of a plan."""
    motion = np.array([np.interp(times, trajectory.time, row) for row in (*q, *v)])
    slopes = np.diff(motion[len(q) :]) / np.diff(times)
    return MotionSteps(times, motion[:, :-1].T, np.repeat(slopes.T[:, None], 3, axis=1))


def _num_pieces(errors: np.ndarray) -> np.ndarray:
    """Return the numbers of pieces (K,) of steps for which errors, rad, are half the tolerance."""
    return (2 * errors / STEP_TOLERANCE) ** (1 / 4)


def _subdivide(times: np.ndarray, pieces: np.ndarray) -> np.ndarray:
    """Return times of steps (K + 1,) with each step cut into at least so many pieces (K,)."""
    counts = np.ceil(pieces - 1e-9).clip(1).astype(int)
    starts = np.repeat(np.arange(len(counts)), counts)
    within = np.concatenate([np.arange(count) / count for count in counts])
    return np.append(times[starts] + within * np.diff(times)[starts], times[-1])


def _heating_residual(wires: Wires, states: np.ndarray, group: np.ndarray) -> SmoothFunction:
    """Return ẋ less its value by (6), as a function of [∫x, x, ẋ] and the duty of some wires."""
    integral, x, rates = (ca.SX.sym(name, len(states)) for name in ("integral", "x", "rates"))
    duty = ca.SX.sym("D", len(group))
    # All other wires stay at zero.
    all_states = among_zeros(x, states, wires.num_states)
    all_duty = among_zeros(duty, group, wires.num_wires)
    readings = ca.SX(wires.num_wires, 1)
    residual = rates - wires.symbolic_heat(all_states, readings, all_duty)[states.tolist()]
    return SmoothFunction(residual, ca.vertcat(integral, x, rates), duty)
