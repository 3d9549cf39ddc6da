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

A point is p = [θ, θ̇, y, D], with the heat y = [x, V] of the wires, at a knot or in the middle of an
interval. F(p) = [θ̈, ẏ] alone is curved. The derivatives of the defects follow from the derivatives
of F at the knots and in the middle.
"""

import copy
from collections.abc import Collection

import casadi as ca
import numpy as np
from pydrake.solvers import Binding

from limb_systems.dynamics import Dynamics
from limb_systems.wires import Wires

ANGLE_SCALE = 0.1  # rad, a typical change, which is scaled to one

_DIFFERENCE = 2e-6  # of central differences, as a share of a time step


class LimbDefects:
    """Defects of a limb's trajectory at K knots as constraints of a program.

    It is a `planners.transcription.ipopt.ConstraintBlock` of K - 1 times 2n + M rows, which are
    in the order of a `Limb`'s states. An interval depends on the points at its knots
    and on its length, [p0, p1, h].

    Args:
        dynamics: F.
        heat_scales: typical changes of the heat (M,).
        states, duty, time_steps: indices of the knots' states (K, 2n + M) and
            duty (K, W), and of the time steps (K - 1), among the program's variables.
        typical_time_step: s, for the scaling of rows.
        replaces: the program's constraints that this stands for.
        free_duration: whether the time steps vary, so that their curvature matters.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        heat_scales: np.ndarray,
        states: np.ndarray,
        duty: np.ndarray,
        time_steps: np.ndarray,
        typical_time_step: float,
        replaces: Collection[Binding] = (),
        free_duration: bool = False,
    ):
        self._dynamics, self.replaces = dynamics, replaces
        self._free_duration = free_duration
        self._points, self._time_steps = np.hstack([states, duty]), time_steps
        self._typical_h, M, h = typical_time_step, len(heat_scales), typical_time_step
        n = self._n = dynamics.num_joints
        self._scale = np.zeros((2 * n + M, 2 * n + M))
        self._scale[:n, :n] = 8 / h * dynamics.acceleration_to_angle
        self._scale[n : 2 * n, n : 2 * n] = dynamics.acceleration_to_angle
        self._scale[2 * n :, 2 * n :] = np.diag(h / heat_scales)
        self._variables = np.column_stack([self._points[:-1], self._points[1:], time_steps])
        self.lower = self.upper = np.zeros(len(time_steps) * (2 * n + M))
        self._expanded: tuple | None = None

        P, pattern = self._points.shape[1], dynamics.pattern.astype(float)
        heat = pattern[None, n:, 2 * n :]
        self._to_middle = np.abs(_by_knots(np.eye(P)[None], n, heat, heat, 0.1)[0, :, :P])
        nonzero = np.ones((2 * n + M, 2 * P + 1))
        nonzero[:n, :-1] = np.tile(np.eye(n, P) + pattern[:n], 2)
        nonzero[n:, :-1] = np.tile(np.eye(n + M, P, n) + pattern + pattern @ self._to_middle, 2)
        self._nonzeros = nonzero.nonzero()
        first_rows = (2 * n + M) * np.arange(len(time_steps))
        self.rows = (first_rows[:, None] + self._nonzeros[0]).ravel()
        self.columns = self._variables[:, self._nonzeros[1]].ravel()
        self._lay_out_hessian(first_curved=0)

    def _lay_out_hessian(self, first_curved: int) -> None:
        """Sets where second derivatives are, by variables of points from a first one on."""
        self._first_curved, P = first_curved, self._points.shape[1]
        of_rates = self._dynamics.curvature.astype(float)
        of_rates[:first_curved] = of_rates[:, :first_curved] = 0.0
        by_step = self._free_duration and not first_curved
        curved = np.full((2 * P + 1, 2 * P + 1), float(by_step))
        by_middle = self._to_middle.T @ of_rates @ self._to_middle
        curved[:-1, :-1] = np.tile(by_middle, (2, 2)) + np.kron(np.eye(2), of_rates)
        self._hessian_nonzeros = rows, columns = np.tril(curved).nonzero()
        self.hessian_rows = self._variables[:, rows].ravel()
        self.hessian_columns = self._variables[:, columns].ravel()

    def with_curvature_of_heat(self) -> "LimbDefects":
        """Return a copy whose ``hessian`` has the second derivatives by heat and duty alone."""
        block = copy.copy(self)
        block._lay_out_hessian(first_curved=2 * self._n)
        return block

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        """Scaled defects, all zero for a feasible trajectory."""
        points, h = x[self._points], x[self._time_steps][:, None]
        n, values = self._n, self._dynamics.values(points)
        steps, sums = np.diff(points, axis=0), points[:-1] + points[1:]
        rows = np.hstack(
            [
                1.5 / h * steps[:, :n] - 0.75 * sums[:, n : 2 * n],
                1.5 / h * steps[:, n : n + values.shape[1]] - 0.25 * (values[:-1] + values[1:]),
            ]
        )
        rows[:, :n] += h / 8 * np.diff(values[:, :n], axis=0)
        rows[:, n:] -= self._dynamics.values(self._middle(points, values, h))
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

        first = self._first_curved
        second = self._dynamics.second if not first else self._dynamics.second_by_heat
        at_knots, curvature = second(points, weights), second(middle, -on_values)
        heat = slopes[:, n:, 2 * n :]
        for _ in range(2):
            curvature = _by_knots(curvature, 0 if first else n, heat[:-1], heat[1:], h[:, :, None])
            curvature = curvature.swapaxes(1, 2)
        hessian = np.zeros((len(h), 2 * P + 1, 2 * P + 1))
        curved = np.r_[first:P, P + first : 2 * P]
        hessian[:, curved[:, None], curved] = curvature
        # A knot's own curvature is in the interval that it begins, the last one's in the last.
        hessian[:, first:P, first:P] += at_knots[:-1]
        hessian[-1, P + first : -1, P + first : -1] += at_knots[-1]
        if self._free_duration and not first:
            moved = _DIFFERENCE * time_steps
            above, below = (
                np.einsum("ki,kij->kj", multipliers, self._jacobian(points, time_steps + side))
                for side in (moved, -moved)
            )
            hessian[:, -1] = (above - below) / (2 * moved[:, None])
        rows, columns = self._hessian_nonzeros
        return hessian[:, rows, columns].ravel()

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
            values, slopes = self._dynamics.first(points)
            middle = self._middle(points, values, time_steps[:, None])
            self._expanded = place, (values, slopes, middle, self._dynamics.first(middle)[1])
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


def heat_defects(
    wires: Wires, first: ca.SX, duty: ca.SX, second: ca.SX, next_duty: ca.SX, step: ca.SX
) -> ca.SX:
    """The defects of the heat y alone over an interval of length h, as expressions (M,).

    They are the defects of (17) times 2 h / 3, with F of the heat:

        y1 - y0 - h/6 (F0 + 4 Fc + F1),  yc = (y0 + y1)/2 + h/8 (F0 - F1),  Dc = (D0 + D1)/2

    Args:
        first, second: y0 and y1 (M,).
        duty, next_duty: D0 and D1 (W,).
        step: h, s.
    """

    def rates(heat: ca.SX, duty: ca.SX) -> ca.SX:
        return wires.symbolic_heat(*ca.vertsplit(heat, [0, wires.num_states, heat.numel()]), duty)

    before, after = rates(first, duty), rates(second, next_duty)
    middle = (first + second) / 2 + step / 8 * (before - after)
    in_middle = rates(middle, (duty + next_duty) / 2)
    return second - first - step / 6 * (before + 4 * in_middle + after)


def _by_knots(
    slopes: np.ndarray,
    n: int,
    first: np.ndarray,
    second: np.ndarray,
    h: np.ndarray | float,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """Turn derivatives by the point in the middle (K, m, P) into ones by the knots (K, m, 2P).

    Args:
        n: number of joints; points begin with their angles and rates.
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
