"""Simulates a planned duty by Radau IIA of the limb's own equations, all steps at once.

A step of length h from (q, v) has three stages, at shares c of it, whose accelerations a are the
unknowns:

    q_i = q + c_i h v + h² Σ_j (A²)_ij a_j,    v_i = v + h Σ_j A_ij a_j,    r(q_i, v_i, a_i) = 0

The last stage is where the next step starts. Newton's method starts from the plan, which is near:
it solves the stages of all steps for the states at which they start, and then follows these states
from step to step. The method has order 5 and damps what is stiff.
"""

import dataclasses

import casadi as ca
import numpy as np

from limb_systems import LimbError, Trajectory, split_state
from limb_systems.smooth_function import SmoothFunction
from limb_systems.wires import Wires
from planners.transcription.collocation import ANGLE_SCALE

LONGEST_STEP = 0.1  # s
CONVERGED = 1e-7  # of the scales of the states
NEAR = 1e-2  # of the scales; from there on, slopes are nearly the same
MOST_ITERATIONS = 20
TOLERANCE = 6e-6  # rad, of what a step adds to q; a longer step is cut in pieces
MOST_REFINEMENTS = 6
# The error that a step adds to q, by h² times the jump of its acceleration between two steps, and
# by h times the fourth difference of a plan's rates.
ERROR_OF_JUMP, ERROR_OF_BEND = 1 / 60, 3e-3

NODES = np.array([(4 - 6**0.5) / 10, (4 + 6**0.5) / 10, 1.0])
_POWERS = np.arange(3)
_TO_POWERS = np.linalg.inv(NODES[:, None] ** _POWERS)  # of the quadratic through three stages
_AT_START = _TO_POWERS[0]  # weights of the stages in their quadratic at the start of the step


def _once(shares: np.ndarray) -> np.ndarray:
    """Weights (..., 3) of the stages in their quadratic's integral over shares (...) of a step."""
    return shares[..., None] ** (_POWERS + 1) / (_POWERS + 1) @ _TO_POWERS


def _twice(shares: np.ndarray) -> np.ndarray:
    """Weights (..., 3) of the stages in their quadratic's double integral, as `_once`."""
    powers = shares[..., None] ** (_POWERS + 2)
    return powers / ((_POWERS + 1) * (_POWERS + 2)) @ _TO_POWERS


A, A_SQUARED = _once(NODES), _twice(NODES)


@dataclasses.dataclass
class Steps:
    """A motion q (n,) in K steps.

    - ``times``: where the steps begin and end (K + 1,), s.
    - ``start``: [q, v] where each begins (K, 2n).
    - ``accelerations``: q̈ at the stages (K, 3, n).
    """

    times: np.ndarray
    start: np.ndarray
    accelerations: np.ndarray

    @property
    def stage_times(self) -> np.ndarray:
        """Times of the stages (K, 3), s."""
        return self.times[:-1, None] + np.diff(self.times)[:, None] * NODES

    def stages(self) -> tuple[np.ndarray, np.ndarray]:
        """q and v at the stages (K, 3, n)."""
        h = np.diff(self.times)[:, None, None]
        q, v = np.split(self.start[:, None], 2, axis=-1)
        moved = h * NODES[:, None] * v + h**2 * (A_SQUARED @ self.accelerations)
        return q + moved, v + h * (A @ self.accelerations)

    def at(self, times: np.ndarray) -> np.ndarray:
        """q (M, n) at times (M,)."""
        last = len(self.start) - 1
        step = np.searchsorted(self.times, times, side="right").clip(1, last + 1) - 1
        h = np.diff(self.times)[step, None]
        share = (times - self.times[step]) / h[:, 0]
        q, v = np.split(self.start[step], 2, axis=-1)
        bent = (_twice(share)[:, None] @ self.accelerations[step])[:, 0]
        return q + share[:, None] * h * v + h**2 * bent

    def errors(self) -> np.ndarray:
        """About the largest error of q that each step adds (K,), from jumps of accelerations."""
        jumps = np.zeros(len(self.start))
        begins = np.einsum("j,kjn->kn", _AT_START, self.accelerations[1:])
        jumps[1:] = np.abs(begins - self.accelerations[:-1, 2]).max(axis=-1)
        jumps[:-1] = np.maximum(jumps[:-1], jumps[1:])
        return ERROR_OF_JUMP * np.diff(self.times) ** 2 * jumps


def solve_steps(
    residual: SmoothFunction, guess: Steps, parameters: np.ndarray, scales: np.ndarray
) -> Steps:
    """Return the solution of r(q, v, a) = 0 at all stages, from the first state of a guess.

    Args:
        residual: r (n,) of [q, v, a] and parameters.
        guess: a motion that is near the solution.
        parameters: what else the residual depends on at the stages (K, 3, size).
        scales: typical changes of [q, v] (2n,).

    Raises:
        LimbError: if Newton's method finds no solution.
    """
    steps = Steps(guess.times, guess.start.copy(), guess.accelerations.copy())
    h = np.diff(steps.times)[:, None, None]
    (K, _, n), change = steps.accelerations.shape, np.inf
    for _ in range(MOST_ITERATIONS):
        q, v = steps.stages()
        points = np.concatenate([q, v, steps.accelerations], axis=-1)
        if change > NEAR:
            values, slopes = residual.first(points, parameters)
            inverse, by_start, to_end = _linearized(slopes, h)
        else:
            values = residual.values(points, parameters)
        # The stages of each step, as if its start were right.
        correction = -(inverse @ values.reshape(K, 3 * n, 1)).reshape(K, 3, n, 1)
        ends = np.concatenate([q[:, 2], v[:, 2]], axis=-1)
        ends += _at_end(correction, h)[..., 0]
        # The starts, one after the other.
        moved = np.zeros_like(steps.start)
        gaps = ends[:-1] - steps.start[1:]
        for k in range(K - 1):
            moved[k + 1] = gaps[k] + to_end[k] @ moved[k]
        steps.start += moved
        steps.accelerations += (correction + by_start @ moved[:, None, :, None])[..., 0]
        change = np.abs(moved / scales).max()
        if change < CONVERGED:
            return steps
        if not np.isfinite(change):
            break
    raise LimbError("Newton's method does not find the motion of the limb.")


def _linearized(slopes: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how the stages of steps of length h (K, 1, 1) answer the residual and the start.

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
    to_end = _at_end(by_start, h) + np.eye(2 * n)
    to_end[:, :n, n:] += h * np.eye(n)
    return inverse, by_start, to_end


def _at_end(accelerations: np.ndarray, h: np.ndarray) -> np.ndarray:
    """[q, v] (K, 2n, m) that accelerations (K, 3, n, m) make in a step of length h (K, 1, 1)."""
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
    heating = model.once("heating", lambda: _heating(wires))
    motion = model.dynamics.by_motion
    angles, rates, states, _ = split_state(model, trajectory.state)
    heat_scales = np.append(np.full(len(states), np.inf), wires.heat_scales[: len(states)])
    motion_scales = np.repeat([ANGLE_SCALE, 1.0], len(angles))

    # Steps from knot to knot, shorter ones where the plan's accelerations are bent.
    bends = np.zeros(len(knots))
    if len(knots) > 4:
        bends = np.pad(np.abs(np.diff(rates, 4)).max(axis=0), 2, mode="edge")
    errors = ERROR_OF_BEND * np.diff(knots) * np.maximum(bends[:-1], bends[1:])
    pieces = np.maximum(np.diff(knots) / LONGEST_STEP, _pieces(errors))
    ends = _cut(knots, pieces)
    for _ in range(MOST_REFINEMENTS):
        heat = _guess(trajectory, ends, np.zeros_like(states), states)
        duty = [np.interp(heat.stage_times, knots, row) for row in trajectory.duty]
        heat = solve_steps(heating, heat, np.stack(duty, axis=-1), heat_scales)
        guess = _guess(trajectory, ends, angles, rates)
        steps = solve_steps(motion, guess, heat.stages()[1], motion_scales)
        errors = steps.errors()
        if (errors <= TOLERANCE).all():
            break
        ends = _cut(ends, _pieces(errors))
    return steps.at(times).T


def _guess(trajectory: Trajectory, times: np.ndarray, q: np.ndarray, v: np.ndarray) -> Steps:
    """Steps that end at some times, of q and v (n, K) at the knots of a plan."""
    motion = np.array([np.interp(times, trajectory.time, row) for row in (*q, *v)])
    slopes = np.diff(motion[len(q) :]) / np.diff(times)
    return Steps(times, motion[:, :-1].T, np.repeat(slopes.T[:, None], 3, axis=1))


def _pieces(errors: np.ndarray) -> np.ndarray:
    """How many pieces make steps (K,) whose errors, rad, are half the tolerance."""
    return (2 * errors / TOLERANCE) ** (1 / 4)


def _cut(times: np.ndarray, pieces: np.ndarray) -> np.ndarray:
    """Times of steps (K + 1,) with each step cut into at least so many equal pieces (K,)."""
    counts = np.ceil(pieces - 1e-9).clip(1).astype(int)
    starts = np.repeat(np.arange(len(counts)), counts)
    within = np.concatenate([np.arange(count) / count for count in counts])
    return np.append(times[starts] + within * np.diff(times)[starts], times[-1])


def _heating(wires: Wires) -> SmoothFunction:
    """ẋ less its value by (6), of [∫x, x, ẋ] and the duty."""
    names = ("integral", "x", "rates")
    integral, x, rates = (ca.SX.sym(name, wires.num_states) for name in names)
    duty, readings = ca.SX.sym("D", wires.num_wires), ca.SX(wires.num_wires, 1)
    residual = rates - wires.symbolic_heat(x, readings, duty)[: wires.num_states]
    return SmoothFunction(residual, ca.vertcat(integral, x, rates), duty)
