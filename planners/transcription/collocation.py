"""Direct collocation of a whole limb trajectory at once, eqn (17).

Drake's `DirectCollocationConstraint` says, for each interval of length h,
that the cubic through the knots (x0, ẋ0), (x1, ẋ1) obeys the dynamics at its
middle:

    x_c = (x0 + x1)/2 + h/8 (ẋ0 - ẋ1),    u_c = (u0 + u1)/2
    ẋ_c = 3/(2h) (x1 - x0) - (ẋ0 + ẋ1)/4 = f(x_c, u_c)

`LimbDefects` evaluates the same equations for all intervals in numpy, with
sparse derivatives, and differs in two ways that leave the solutions as they are:

- The midpoint rate is θ̇_c = 3/(2h) (θ1 - θ0) - (θ̇0 + θ̇1)/4, which equals the
  θ̇_c above wherever the θ rows hold. The midpoint state is then linear in the
  knots, without accelerations in it that are large and stiff.
- Rows are scaled to the size of the states: accelerations by K⁻¹ M(0), which
  turns them into the static deflections they stand for.

A point is p = [θ, θ̇, y, D], with the heat y = [x, V] of the wires, at a knot or
in the middle of an interval. All that is curved is F(p) = [θ̈, ẏ], so that the
derivatives of the defects follow from those of F at the knots and in the middle.
"""

import copy
from collections.abc import Collection

import numpy as np
from pydrake.solvers import Binding

from limb_systems import Wires
from planners.transcription.mechanics import Mechanics

ANGLE_SCALE = 0.1  # rad, a typical change, which is scaled to one
RATE_SCALE = 1.0  # rad/s, as much

_DIFFERENCE = 2e-6  # of central differences, in typical changes or of a time step


class LimbDefects:
    """Defects of a limb's trajectory at K knots as constraints of a program.

    It is a `planners.transcription.ipopt.ConstraintBlock` of K - 1 times 2n + M rows, which are
    in the order of a `Limb`'s states. An interval depends on the points at its knots
    and on its length, [p0, p1, h].

    - ``acceleration_to_angle``: K⁻¹ M(0) (n, n), s².

    Args:
        mechanics: joint accelerations of the limb; without, points are [y, D], and n is 0.
        wires: heat and forces of the limb.
        states, duty, time_steps: indices of the knots' states (K, 2n + M) and
            duty (K, W), and of the time steps (K - 1), among the program's variables.
        typical_time_step: s, for the scaling of rows.
        replaces: the program's constraints that this stands for.
    """

    def __init__(
        self,
        mechanics: Mechanics | None,
        wires: Wires,
        states: np.ndarray,
        duty: np.ndarray,
        time_steps: np.ndarray,
        typical_time_step: float,
        replaces: Collection[Binding] = (),
    ):
        self._mechanics, self._wires = mechanics, wires
        self._points, self._time_steps = np.hstack([states, duty]), time_steps
        self._typical_h, self.replaces = typical_time_step, replaces
        self.acceleration_to_angle = np.zeros((0, 0))
        if mechanics is not None:
            self.acceleration_to_angle = (
                mechanics.straight_mass_matrix / mechanics.stiffness[:, None]
            )
        n = self._n = len(self.acceleration_to_angle)
        M, h = len(wires.heat_scales), typical_time_step
        self._scale = np.zeros((2 * n + M, 2 * n + M))
        self._scale[:n, :n] = 8 / h * self.acceleration_to_angle
        self._scale[n : 2 * n, n : 2 * n] = self.acceleration_to_angle
        self._scale[2 * n :, 2 * n :] = np.diag(h / wires.heat_scales)
        self._variables = np.column_stack([self._points[:-1], self._points[1:], time_steps])
        self.lower = self.upper = np.zeros(len(time_steps) * (2 * n + M))
        self._expanded: tuple | None = None

        # What F depends on: accelerations on all but V and D.
        P = self._points.shape[1]
        pattern = np.zeros((n + M, P))
        pattern[:n, : 2 * n + wires.num_states] = 1.0
        pattern[n:, 2 * n :] = wires.heat_pattern
        heat = pattern[None, n:, 2 * n :]
        self._to_middle = np.abs(_by_knots(np.eye(P)[None], n, heat, heat, 0.1)[0, :, :P])
        nonzero = np.ones((2 * n + M, 2 * P + 1))
        nonzero[:n, :-1] = np.tile(np.eye(n, P) + pattern[:n], 2)
        nonzero[n:, :-1] = np.tile(np.eye(n + M, P, n) + pattern + pattern @ self._to_middle, 2)
        self._nonzeros = nonzero.nonzero()
        first_rows = (2 * n + M) * np.arange(len(time_steps))
        self.rows = (first_rows[:, None] + self._nonzeros[0]).ravel()
        self.columns = self._variables[:, self._nonzeros[1]].ravel()
        self._lay_out_hessian(of_mechanics=mechanics is not None)

    def _lay_out_hessian(self, of_mechanics: bool) -> None:
        n, wires, P = self._n, self._wires, self._points.shape[1]
        self._curved_joints = n if of_mechanics else 0
        pattern = np.zeros((P, P))
        pattern[2 * n :, 2 * n :] = wires.heat_curvature
        moving = 2 * n + wires.num_states
        if n:
            pattern[2 * n : moving, 2 * n : moving] += wires.torque_curvature
        pattern[: 2 * self._curved_joints, :moving] = 1.0
        pattern[:moving, : 2 * self._curved_joints] = 1.0
        nonzero = np.full((2 * P + 1, 2 * P + 1), float(of_mechanics))
        nonzero[:-1, :-1] = np.tile(self._to_middle.T @ pattern @ self._to_middle, (2, 2))
        nonzero[:-1, :-1] += np.kron(np.eye(2), pattern)
        self._hessian_nonzeros = np.tril(nonzero).nonzero()
        rows, columns = self._hessian_nonzeros
        self.hessian_rows = self._variables[:, rows].ravel()
        self.hessian_columns = self._variables[:, columns].ravel()

    def with_curvature_of_wires(self) -> "LimbDefects":
        """Copy whose ``hessian`` is that by heat and duty alone."""
        block = copy.copy(self)
        block._lay_out_hessian(of_mechanics=False)
        return block

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        """Scaled defects, all zero for a feasible trajectory."""
        points, h = x[self._points], x[self._time_steps][:, None]
        n, values = self._n, self._values(points)
        steps, sums = np.diff(points, axis=0), points[:-1] + points[1:]
        rows = np.hstack(
            [
                1.5 / h * steps[:, :n] - 0.75 * sums[:, n : 2 * n],
                1.5 / h * steps[:, n : n + values.shape[1]] - 0.25 * (values[:-1] + values[1:]),
            ]
        )
        rows[:, :n] += h / 8 * np.diff(values[:, :n], axis=0)
        rows[:, n:] -= self._values(self._middle(points, values, h))
        return (rows @ self._scale.T).ravel()

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Nonzeros of the derivative of `evaluate`."""
        rows, columns = self._nonzeros
        jacobian = self._jacobian(x[self._points], x[self._time_steps])
        return jacobian[:, rows, columns].ravel()

    def hessian(self, x: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Nonzeros of the Hessian of multipliers · `evaluate`."""
        points, time_steps = x[self._points], x[self._time_steps]
        n, P, h = self._n, points.shape[1], time_steps[:, None]
        multipliers = multipliers.reshape(len(h), -1)
        on_angles, on_values = np.split(multipliers @ self._scale, [n], axis=1)
        _, slopes, middle, mid_slopes = self._expand(points, time_steps)
        by_heat = mid_slopes[:, :, 2 * n : n + mid_slopes.shape[1]]

        # The weights of F at the knots: the rates of heat also move the heat in the middle.
        on_middle = -np.einsum("ki,kij->kj", on_values, by_heat)
        by_rates = h / 8 * np.hstack([-on_angles, on_middle])
        weights = np.zeros((len(points), on_values.shape[1]))
        weights[:-1] = by_rates - 0.25 * on_values
        weights[1:] -= by_rates + 0.25 * on_values

        joints = self._curved_joints
        first = 2 * (n - joints)  # of the variables that are curved
        at_knots = self._curvature(points, weights)[:, first:, first:]
        curvature = self._curvature(middle, -on_values)[:, first:, first:]
        heat = slopes[:, n:, 2 * n :]
        for _ in range(2):
            curvature = _by_knots(curvature, joints, heat[:-1], heat[1:], h[:, :, None])
            curvature = curvature.swapaxes(1, 2)
        hessian = np.zeros((len(h), 2 * P + 1, 2 * P + 1))
        curved = np.r_[first:P, P + first : 2 * P]
        hessian[:, curved[:, None], curved] = curvature
        # A knot's own curvature is in the interval that it begins, the last one's in the last.
        hessian[:, first:P, first:P] += at_knots[:-1]
        hessian[-1, P + first : -1, P + first : -1] += at_knots[-1]
        if joints:
            moved = _DIFFERENCE * time_steps
            above, below = (
                np.einsum("ki,kij->kj", multipliers, self._jacobian(points, time_steps + side))
                for side in (moved, -moved)
            )
            hessian[:, -1] = (above - below) / (2 * moved[:, None])
        rows, columns = self._hessian_nonzeros
        return hessian[:, rows, columns].ravel()

    def accelerations(self, states: np.ndarray) -> np.ndarray:
        """θ̈ (K, n) of states (K, 2n + M), rad/s²."""
        n, N = self._n, self._wires.num_states
        angles, rates, x = np.split(states[:, : 2 * n + N], [n, 2 * n], axis=1)
        assert self._mechanics is not None
        return self._mechanics.accelerations(angles, rates, self._wires.forces(x, angles))

    def _values(self, points: np.ndarray) -> np.ndarray:
        """F (K, n + M) at points (K, P)."""
        n, W = self._n, self._wires.num_wires
        heat_rates = self._wires.heat_rates(points[:, 2 * n : -W], points[:, -W:])
        return np.hstack([self.accelerations(points), heat_rates]) if n else heat_rates

    def _acceleration_slopes(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """θ̈ (K, n), and its derivatives by [θ, θ̇, x] (K, n, 2n + N)."""
        n, N = self._n, self._wires.num_states
        angles, rates, x = np.split(points[:, : 2 * n + N], [n, 2 * n], axis=1)
        assert self._mechanics is not None
        forces = self._wires.forces(x, angles)
        force_by_state, force_by_angle = self._wires.force_derivatives(x, angles)
        values, by_angle, by_rate, by_force = self._mechanics.derivatives(angles, rates, forces)
        if force_by_angle is not None:
            by_angle = by_angle + by_force @ force_by_angle
        return values, np.concatenate([by_angle, by_rate, by_force @ force_by_state], axis=2)

    def _slopes(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """F (K, n + M), and its derivatives by the points (K, n + M, P)."""
        n, W = self._n, self._wires.num_wires
        heat, duty = points[:, 2 * n : -W], points[:, -W:]
        heat_rates, by_heat = self._wires.expanded_heat_rates(heat, duty)
        if not n:
            return heat_rates, by_heat
        accelerations, by_moving = self._acceleration_slopes(points)
        values = np.hstack([accelerations, heat_rates])
        slopes = np.zeros((*values.shape, points.shape[1]))
        slopes[:, :n, : by_moving.shape[2]] = by_moving
        slopes[:, n:, 2 * n :] = by_heat
        return values, slopes

    def _curvature(self, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · F by the points (K, P, P)."""
        n, N, W = self._n, self._wires.num_states, self._wires.num_wires
        angles, x = points[:, :n], points[:, 2 * n : 2 * n + N]
        result = np.zeros((*points.shape, points.shape[1]))
        moving = slice(2 * n, 2 * n + N)
        if self._mechanics is not None:
            on_forces = (self._mechanics.mobilities(angles) @ weights[:, :n, None])[:, :, 0]
            result[:, moving, moving] = self._wires.force_hessian(x, angles, on_forces)
        if not self._wires.rates_are_affine:
            heat, duty = points[:, 2 * n : -W], points[:, -W:]
            result[:, 2 * n :, 2 * n :] += self._wires.heat_hessian(heat, duty, weights[:, n:])
        for index in range(2 * self._curved_joints):
            step = np.zeros(points.shape[1])
            step[index] = _DIFFERENCE * (ANGLE_SCALE if index < n else RATE_SCALE)
            above, below = (
                np.einsum("ki,kij->kj", weights[:, :n], self._acceleration_slopes(points + side)[1])
                for side in (step, -step)
            )
            result[:, index, : moving.stop] = (above - below) / (2 * step[index])
            result[:, : moving.stop, index] = result[:, index, : moving.stop]
        return result

    def _middle(self, points: np.ndarray, values: np.ndarray, h: np.ndarray) -> np.ndarray:
        """Points (K - 1, P) in the middle of each interval, from those at the knots and F there."""
        n = self._n
        steps, middle = np.diff(points, axis=0), 0.5 * (points[:-1] + points[1:])
        middle[:, n : 2 * n] = 1.5 / h * steps[:, :n] - 0.5 * middle[:, n : 2 * n]
        middle[:, :n] -= h / 8 * steps[:, n : 2 * n]
        middle[:, 2 * n : n + values.shape[1]] -= h / 8 * np.diff(values[:, n:], axis=0)
        return middle

    def _expand(self, points: np.ndarray, time_steps: np.ndarray) -> tuple[np.ndarray, ...]:
        """F and its derivatives at the knots, the points in the middle, and its derivatives there.

        IPOPT asks for Jacobian and Hessian at the same point, one after the other.
        """
        place = np.append(points.ravel(), time_steps)
        if self._expanded is None or not np.array_equal(self._expanded[0], place):
            values, slopes = self._slopes(points)
            middle = self._middle(points, values, time_steps[:, None])
            self._expanded = place, (values, slopes, middle, self._slopes(middle)[1])
        return self._expanded[1]

    def _jacobian(self, points: np.ndarray, time_steps: np.ndarray) -> np.ndarray:
        """Scaled derivatives (K - 1, 2n + M, 2P + 1) of the defects by [p0, p1, h]."""
        values, slopes, _, mid_slopes = self._expand(points, time_steps)
        n, P, h = self._n, points.shape[1], time_steps[:, None, None]
        size, heat = values.shape[1], slopes[:, n:, 2 * n :]
        on_angles, on_values = self._scale[:n, :n], self._scale[n:, n:]
        # Scaled first, where they are fewer than in the rows.
        slopes, scaled_middle = on_values @ slopes, on_values @ mid_slopes
        rows = np.empty((len(h), n + size, 2 * P + 1))
        np.multiply(slopes[:-1, :n], -h / self._typical_h, out=rows[:, :n, :P])
        np.multiply(slopes[1:, :n], h / self._typical_h, out=rows[:, :n, P:-1])
        _by_knots(-scaled_middle, n, heat[:-1], heat[1:], h, out=rows[:, n:, :-1])
        slopes *= 0.25
        for knot, sign, own in ((0, -1.0, slopes[:-1]), (P, 1.0, slopes[1:])):
            rows[:, n:, knot : knot + P] -= own
            rows[:, :n, knot : knot + n] += sign * 1.5 / h * on_angles
            rows[:, :n, knot + n : knot + 2 * n] -= 0.75 * on_angles
            rows[:, n:, knot + n : knot + n + size] += sign * 1.5 / h * on_values

        steps, value_steps = np.diff(points, axis=0), np.diff(values, axis=0)
        h = h[:, 0]
        middle_by_step = np.zeros_like(steps)
        middle_by_step[:, :n] = -steps[:, n : 2 * n] / 8
        middle_by_step[:, n : 2 * n] = -1.5 / h**2 * steps[:, :n]
        middle_by_step[:, 2 * n : n + size] = -value_steps[:, n:] / 8
        by_step = -1.5 / h**2 * steps[:, : n + size]
        by_step[:, :n] += value_steps[:, :n] / 8
        by_step[:, n:] -= (mid_slopes @ middle_by_step[:, :, None])[:, :, 0]
        rows[:, :, -1] = by_step @ self._scale.T
        return rows


def _by_knots(
    slopes: np.ndarray,
    n: int,
    first: np.ndarray,
    second: np.ndarray,
    h: np.ndarray | float,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """Derivatives by the points at the knots (K, m, 2P), of those by the middle's (K, m, P).

    Args:
        n: number of joints whose angles and rates the points begin with.
        first, second: derivatives of the heat's rates at the knots by [y, D], (K, M, M + W).
        h: time steps (K, 1, 1).
        out: where to write them.
    """
    P = slopes.shape[2]
    if out is None:
        out = np.empty((*slopes.shape[:2], 2 * P))
    by_angle, by_rate, rest = np.split(slopes, [n, 2 * n], axis=2)
    by_heat = h / 8 * rest[:, :, : first.shape[1]]
    for knot, sign, heat in ((0, 1.0, first), (P, -1.0, second)):
        out[:, :, knot : knot + n] = 0.5 * by_angle - sign * 1.5 / h * by_rate
        out[:, :, knot + n : knot + 2 * n] = sign * h / 8 * by_angle - 0.25 * by_rate
        out[:, :, knot + 2 * n : knot + P] = 0.5 * rest + sign * (by_heat @ heat)
    return out
