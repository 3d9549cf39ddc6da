"""Direct collocation of a whole limb trajectory at once, eqn (17).

Drake's `DirectCollocationConstraint` requires, for each interval of length h, that the cubic
through the knots (x0, ẋ0), (x1, ẋ1) obeys the dynamics at its middle:

    x_c = (x0 + x1)/2 + h/8 (ẋ0 - ẋ1),    u_c = (u0 + u1)/2
    ẋ_c = 3/(2h) (x1 - x0) - (ẋ0 + ẋ1)/4 = f(x_c, u_c)

`MotionDefects` are these equations for the chain, for all intervals in numpy, with sparse
derivatives. They differ in two ways that leave the solutions as they are:

- The midpoint rate is θ̇_c = 3/(2h) (θ1 - θ0) - (θ̇0 + θ̇1)/4, which equals the
  θ̇_c above wherever the θ rows hold. The midpoint state is then linear in the
  knots, without accelerations in it that are large and stiff.
- Rows are scaled to the size of the states: accelerations by K⁻¹ M(0), which
  turns them into the static deflections they stand for.

`heat_block` and `fixed_time_heat_blocks` have the equations for the heat, which is no function of
the motion.
"""

import copy
from collections.abc import Collection

import casadi as ca
import numpy as np
from pydrake.solvers import Binding

from limb_systems.limb_model import LimbModel
from limb_systems.smooth_function import SmoothFunction
from limb_systems.wires import Wires, among_zeros
from planners.transcription.function_block import FunctionBlock
from planners.transcription.ipopt import ConstraintBlock


class MotionDefects:
    """The defects (17) of the chain's motion in the K - 1 intervals between K knots.

    It is a `planners.transcription.ipopt.ConstraintBlock`. The first rows are of θ (n, K - 1), then
    of θ̇ (n, K - 1). An interval depends on z = [p0, p1, h], with p = [θ, θ̇, x, D] at its two
    knots and its length h:

        3/(2h) (θ1 - θ0) - 3/4 (θ̇0 + θ̇1) + h/8 (a1 - a0)    times 8/h K⁻¹ M(0)
        3/(2h) (θ̇1 - θ̇0) - (a0 + a1)/4 - a_c                 times K⁻¹ M(0)

    The accelerations a at the knots and a_c in the middle solve the limb's equation of motion
    r(θ, θ̇, x, a) = 0, whose derivatives give the accelerations' derivatives: M ∂a = -∂r.

    Args:
        model: the limb.
        states, duty, time_steps: indices of the knots' states (K, 2n + M) and
            duty (K, W), and of the time steps (K - 1), among the program's variables.
        typical_time_step: s, for the scaling of rows.
        replaces: the program's constraints that this block replaces.
        free_duration: whether the time steps vary; there are no derivatives by them if not.
    """

    def __init__(
        self,
        model: LimbModel,
        states: np.ndarray,
        duty: np.ndarray,
        time_steps: np.ndarray,
        typical_time_step: float,
        replaces: Collection[Binding] = (),
        free_duration: bool = False,
    ):
        self._dynamics = dynamics = model.dynamics
        self.replaces = replaces
        self._is_free = free_duration
        self._n = n = dynamics.num_joints
        # Indices of [θ, θ̇, x, D] at the knots (K, P), and of z (2P + 1, K - 1).
        self._points = np.hstack([states[:, : 2 * n + dynamics.num_states], duty])
        self._time_steps = time_steps
        self._variables = np.vstack([self._points[:-1].T, self._points[1:].T, time_steps])
        # Scales of the rows.
        self._typical_h = typical_time_step
        self._on_rates = dynamics.acceleration_to_angle
        self._on_angles = 8 / typical_time_step * self._on_rates
        self.lower = self.upper = np.zeros(2 * n * len(time_steps))
        self._cached: tuple | None = None
        # Places in z of the heat at both knots, which moves forces and states in the middle.
        P = self._points.shape[1]
        self._heat = np.r_[2 * n : P, P + 2 * n : 2 * P]
        name = f"motion of an interval, {free_duration}"
        functions = model.once(name, lambda: self._symbolic_interval(model.wires))
        self._x_middle, self._middle_force, self._all_forces, self._equations = functions
        self._set_jacobian_pattern()
        self._is_whole = True

    def _symbolic_interval(self, wires: Wires) -> list[SmoothFunction]:
        """Return functions of an interval for the middle and for curvatures.

        Returns:
            x in the middle, the force there, and the forces at both knots and in the middle, all by
            the heat; the rows and the equations of motion, by z and the accelerations.
        """
        n, N, P = self._n, wires.num_states, self._points.shape[1]
        z = ca.SX.sym("z", 2 * P)
        h = ca.SX.sym("h")
        parts = np.cumsum([0, n, n, N, wires.num_wires]).tolist()
        q0, v0, x0, D0 = ca.vertsplit(z[:P], parts)
        q1, v1, x1, D1 = ca.vertsplit(z[P:], parts)

        # The states in the middle.
        readings = ca.SX(wires.num_wires, 1)  # which heat nothing
        change = wires.symbolic_heat(x0, readings, D0) - wires.symbolic_heat(x1, readings, D1)
        q_middle = (q0 + q1) / 2 - h / 8 * (v1 - v0)
        v_middle = 1.5 / h * (q1 - q0) - (v0 + v1) / 4
        x_middle = (x0 + x1) / 2 + h / 8 * change[:N]

        # Functions of the heat, at given angles.
        heat = ca.vertcat(x0, D0, x1, D1)
        angles = ca.SX.sym("q", 3 * n)
        at_begin, at_end, in_middle = ca.vertsplit(angles, n)
        force = wires.symbolic_force
        middle_state = SmoothFunction(x_middle, heat, h)
        if self._is_free:
            middle_force = SmoothFunction(
                force(x_middle, in_middle), ca.vertcat(heat, h), in_middle
            )
        else:
            given = ca.vertcat(in_middle, h)
            middle_force = SmoothFunction(force(x_middle, in_middle), heat, given)
        forces = ca.vertcat(force(x0, at_begin), force(x1, at_end), force(x_middle, in_middle))
        all_forces = SmoothFunction(forces, heat, ca.vertcat(angles, h))

        # The rows but for the accelerations in the middle, and the equations of motion.
        a0, a1, a_middle = (ca.SX.sym(name, n) for name in ("a0", "a1", "ac"))
        motion = self._dynamics.residual
        equations = ca.vertcat(
            1.5 / h * (q1 - q0) + h / 8 * (a1 - a0),
            1.5 / h * (v1 - v0),
            -motion(q0, v0, x0, a0),
            -motion(q1, v1, x1, a1),
            -motion(q_middle, v_middle, x_middle, a_middle),
        )
        by, step = (ca.vertcat(z, h), None) if self._is_free else (z, h)
        residuals = SmoothFunction(equations, ca.vertcat(by, a0, a1, a_middle), step)
        return [middle_state, middle_force, all_forces, residuals]

    def _set_jacobian_pattern(self) -> None:
        """Set the sparsity pattern of `jacobian`: the rows and columns of its nonzeros.

        The pattern of one interval has the rows of the defects (2n) and the columns of z (2P + 1),
        in which the second knot begins at P, and the time step is at 2P.
        """
        n = self._n
        P = self._points.shape[1]
        num_intervals = len(self._time_steps)
        # Find the columns of p = [θ, θ̇, x] by which the accelerations at a knot have derivatives.
        rows, columns = self._dynamics.by_state.slope_places
        self._moving_columns, places = np.unique(columns, return_inverse=True)
        self._slope_entries = rows, places  # of the nonzeros, in an array of these columns alone
        # Find the columns of z, except the motion, by which the rows of θ̇ have derivatives.
        by_force = np.append(self._heat, 2 * P)[self._middle_force.slope_places[1]]
        at_knots = self._moving_columns[2 * n :]
        by_heat = {*by_force.tolist(), *at_knots.tolist(), *(P + at_knots).tolist()}
        if self._is_free:
            by_heat.add(2 * P)
        self._by_heat = np.array(sorted(by_heat), int)
        # List the dense blocks of one interval as (rows, columns), in the order of `jacobian`.
        motion = np.arange(2 * n)
        rows_of_angles = np.arange(n)
        rows_of_rates = n + rows_of_angles
        blocks = [
            (rows_of_angles, np.r_[self._moving_columns, P + self._moving_columns]),
            (rows_of_rates, np.r_[motion, P + motion]),
            (rows_of_rates, self._by_heat),
        ]
        if self._is_free:
            blocks.append((rows_of_angles, np.array([2 * P])))
        # Place these entries for all intervals: rows as in `evaluate`, columns as the program's.
        grids = [np.array(np.meshgrid(*block, indexing="ij")).reshape(2, -1) for block in blocks]
        self._entry_pairs = rows, columns = np.hstack(grids)
        self.rows = (rows[:, None] * num_intervals + np.arange(num_intervals)).ravel()
        self.columns = self._variables[columns].ravel()

    @property
    def _curved_pairs(self) -> np.ndarray:
        """The places in z of the nonzeros of `hessian` (2, Z)."""
        if self._is_whole:
            return np.array(np.tril_indices(2 * self._points.shape[1] + self._is_free))
        return self._heat[self._all_forces.curvature_places]

    @property
    def hessian_rows(self) -> np.ndarray:
        return self._variables[self._curved_pairs[0]].ravel()

    @property
    def hessian_columns(self) -> np.ndarray:
        return self._variables[self._curved_pairs[1]].ravel()

    def with_curvature_of_heat(self) -> "MotionDefects":
        """Return a copy whose ``hessian`` has the second derivatives by heat and duty alone."""
        block = copy.copy(self)
        block._is_whole = False
        return block

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        """Return the scaled defects, all zero for a feasible trajectory."""
        points, h, _, accelerations, _ = self._accelerations_at(x)
        K, n = len(points), self._n
        steps = np.diff(points[:, : 2 * n], axis=0) * (1.5 / h)
        rates = points[:, n : 2 * n]
        at_knots = accelerations[:K]
        of_angles = steps[:, :n] - 0.75 * (rates[:-1] + rates[1:])
        of_angles += h / 8 * np.diff(at_knots, axis=0)
        of_rates = steps[:, n:] - 0.25 * (at_knots[:-1] + at_knots[1:]) - accelerations[K:]
        return np.vstack([self._on_angles @ of_angles.T, self._on_rates @ of_rates.T]).ravel()

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the nonzeros of the derivative of `evaluate`."""
        points, h, places, accelerations, mass = self._accelerations_at(x)
        K, n, P = len(points), self._n, points.shape[1]
        h = h[:, 0]
        on_angles = self._on_angles[..., None]
        on_rates = self._on_rates[..., None]

        # The scaled accelerations by what moves them, (n, ..., K) at the knots and in the middle.
        mobility = -self._on_rates @ np.linalg.inv(mass)
        slopes = np.zeros((len(places), n, len(self._moving_columns)))
        slopes[:, *self._slope_entries] = self._dynamics.by_state.slopes(places, accelerations)
        slopes = np.moveaxis(mobility @ slopes, 0, -1)
        first, second, middle = slopes[..., : K - 1], slopes[..., 1:K], slopes[..., K:]

        # The scaled accelerations in the middle by the heat at both knots.
        forces = np.zeros((K - 1, n, 2 * P + 1))
        rows, columns = self._middle_force.slope_places
        heat = self._heat_at_both_knots(points)
        angles = places[K:, :n]
        if self._is_free:
            force_slopes = self._middle_force.slopes(np.column_stack([heat, h]), angles)
        else:
            force_slopes = self._middle_force.slopes(heat, np.column_stack([angles, h]))
        forces[:, rows, np.append(self._heat, 2 * P)[columns]] = force_slopes
        by_heat = np.moveaxis(mobility[K:] @ forces[..., self._by_heat], 0, -1).copy()

        # The rows of θ by each knot.
        shares = h / self._typical_h
        of_angles = np.empty((n, 2, len(self._moving_columns), K - 1))
        np.multiply(first, -shares, out=of_angles[:, 0])
        np.multiply(second, shares, out=of_angles[:, 1])
        of_angles[:, 0, :n] -= 1.5 / h * on_angles
        of_angles[:, 1, :n] += 1.5 / h * on_angles
        of_angles[:, :, n : 2 * n] -= 0.75 * on_angles[:, None]

        # The rows of θ̇ by the motion of each knot, and by the heat.
        by_angle = middle[:, :n]
        by_rate = middle[:, n : 2 * n]
        motion = np.empty((n, 2, 2 * n, K - 1))
        for knot, sign, at_knot in ((0, -1.0, first), (1, 1.0, second)):
            np.multiply(at_knot[:, : 2 * n], -0.25, out=motion[:, knot])
            motion[:, knot, :n] -= 0.5 * by_angle + sign * 1.5 / h * by_rate
            motion[:, knot, n:] += 0.25 * by_rate + sign * (h / 8 * by_angle + 1.5 / h * on_rates)
            columns = np.searchsorted(self._by_heat, knot * P + self._moving_columns[2 * n :])
            by_heat[:, columns] -= 0.25 * at_knot[:, 2 * n :]
        parts = [of_angles, motion, by_heat]

        # All rows by the time step, which is the last column of ``by_heat``.
        if self._is_free:
            steps = np.diff(points[:, : 2 * n], axis=0)
            change = np.diff(accelerations[:K], axis=0)
            by_step = -1.5 / h[:, None] ** 2 * steps
            to_middle = np.hstack([-steps[:, n:] / 8, by_step[:, :n]])
            by_heat[:, -1] += self._on_rates @ by_step[:, n:].T
            by_heat[:, -1] -= np.einsum("imk,km->ik", middle[:, : 2 * n], to_middle)
            parts.append(self._on_angles @ (by_step[:, :n] + change / 8).T)
        return np.concatenate([part.ravel() for part in parts])

    def slopes_by_motion(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the slopes of an interval's rows by [θ, θ̇] at both knots, each (K - 1, 2n, 2n)."""
        num_intervals = len(self._time_steps)
        P = self._points.shape[1]
        motion = 2 * self._n
        slopes = np.zeros((num_intervals, motion, 2 * P + 1))
        slopes[:, *self._entry_pairs] = self.jacobian(x).reshape(-1, num_intervals).T
        return slopes[:, :, :motion], slopes[:, :, P : P + motion]

    def hessian(self, x: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return the nonzeros of the Hessian of multipliers · `evaluate`.

        The rows' weights of the accelerations become weights λ of the equations of motion, by the
        adjoint M λ = w.
        """
        if not self._curved_pairs.size:
            return np.zeros(0)
        points, h, places, accelerations, mass = self._accelerations_at(x)
        K = len(points)
        n = self._n
        of_angles, of_rates = multipliers.reshape(2, n, K - 1)
        of_angles = of_angles.T @ self._on_angles
        of_rates = of_rates.T @ self._on_rates
        # Weights of the accelerations in the rows, and of the equations of motion.
        weights = np.zeros_like(accelerations)
        weights[: K - 1] = -h / 8 * of_angles - 0.25 * of_rates
        weights[1:K] += h / 8 * of_angles - 0.25 * of_rates
        weights[K:] = -of_rates
        adjoint = np.linalg.solve(mass, weights[..., None])[..., 0]
        # The curvature of a knot counts in the interval that it begins; of the last, in the last.
        last = np.zeros((K - 1, n))
        last[-1] = adjoint[K - 1]
        weights = np.hstack([adjoint[: K - 1], last, adjoint[K:]])
        # Curvatures by the heat alone, or all.
        if not self._is_whole:
            angles = np.hstack([points[:-1, :n], points[1:, :n], places[K:, :n]])
            parameters = np.hstack([angles, h])
            return self._all_forces.curvatures(
                self._heat_at_both_knots(points), weights, parameters
            ).T.ravel()
        return self._whole_hessian(x, np.hstack([of_angles, of_rates, weights]))

    def _whole_hessian(self, x: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return the nonzeros of the Hessian, by weights (K - 1, 5n) of an interval's equations."""
        points, h, places, accelerations, mass = self._accelerations_at(x)
        K = len(points)
        n = self._n
        P = points.shape[1]
        size = 2 * P + self._is_free

        # The accelerations at both knots and in the middle (K - 1, 3n), and their slopes by z.
        slopes = np.zeros((len(places), n, P))
        rows, columns = self._dynamics.by_state.slope_places
        slopes[:, rows, columns] = self._dynamics.by_state.slopes(places, accelerations)
        slopes = -np.linalg.solve(mass, slopes)
        along = np.zeros((K - 1, size + 3 * n, size))
        along[:, :size] = np.eye(size)
        along[:, size : size + n, :P] = slopes[: K - 1]
        along[:, size + n : size + 2 * n, P : 2 * P] = slopes[1:K]
        # The slopes of the accelerations in the middle follow from the slopes of the rows of θ̇.
        of_rates = np.zeros((2 * n, 2 * P + 1, K - 1))
        of_rates[*self._entry_pairs] = self.jacobian(x).reshape(-1, K - 1)
        of_rates = np.linalg.solve(self._on_rates, of_rates[n:].reshape(n, -1))
        in_middle = -of_rates.reshape(n, -1, K - 1).transpose(2, 0, 1)[..., :size]
        in_middle -= 0.25 * (along[:, size : size + n] + along[:, size + n : size + 2 * n])
        in_middle[:, :, n : 2 * n] -= 1.5 / h[:, :, None] * np.eye(n)
        in_middle[:, :, P + n : P + 2 * n] += 1.5 / h[:, :, None] * np.eye(n)
        if self._is_free:
            in_middle[:, :, -1] -= 1.5 / h**2 * np.diff(points[:, n : 2 * n], axis=0)
        along[:, size + 2 * n :] = in_middle

        a = accelerations
        # The curvature of the equations, along these slopes.
        point = np.hstack([points[:-1], points[1:], h, a[: K - 1], a[1:K], a[K:]])
        if self._is_free:
            curved = self._equations.second(point, weights)
        else:
            curved = self._equations.second(np.delete(point, 2 * P, axis=1), weights, h)
        hessian = along.swapaxes(1, 2) @ curved @ along
        rows, columns = self._curved_pairs
        return hessian[:, rows, columns].T.ravel()

    def _accelerations_at(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the accelerations at the knots and in the middle, and where they are.

        IPOPT asks for rows, Jacobian and Hessian at the same point, one after the other, so that
        the last result is kept.

        Returns:
            The points at the knots (K, P); time steps (K - 1, 1); states [θ, θ̇, x]
            (2K - 1, 2n + N) at the knots, then in the middle; accelerations there (2K - 1, n);
            mass matrices there (2K - 1, n, n).
        """
        points = x[self._points]
        h = x[self._time_steps][:, None]
        key = np.append(points.ravel(), h)
        if self._cached is not None and np.array_equal(self._cached[0], key):
            return self._cached[1]
        n = self._n
        num_states = 2 * n + self._dynamics.num_states
        # The states in the middle.
        steps = np.diff(points, axis=0)
        sums = points[:-1] + points[1:]
        angles = 0.5 * sums[:, :n] - h / 8 * steps[:, n : 2 * n]
        rates = 1.5 / h * steps[:, :n] - 0.25 * sums[:, n : 2 * n]
        heat = self._x_middle.values(self._heat_at_both_knots(points), h)
        places = np.vstack([points[:, :num_states], np.hstack([angles, rates, heat])])
        # The equation of motion.
        mass, load = self._dynamics.mass_and_load(places)
        accelerations = -np.linalg.solve(mass, load[..., None])[..., 0]
        self._cached = key, (points, h, places, accelerations, mass)
        return self._cached[1]

    def _heat_at_both_knots(self, points: np.ndarray) -> np.ndarray:
        """Return [x, D] at both knots of each interval (K - 1, 2 (N + W))."""
        heat = points[:, 2 * self._n :]
        return np.hstack([heat[:-1], heat[1:]])


def heat_block(
    model: LimbModel, heat: np.ndarray, duty: np.ndarray, time_steps: np.ndarray
) -> FunctionBlock:
    """Return (17) of the heat, as `heat_defects`, at all intervals.

    Args:
        model: the limb.
        heat, duty, time_steps: indices of the knots' [x, V] (K, M) and duty (K, W), and of the
            time steps (K - 1), among the program's variables.
    """
    wires = model.wires

    def build() -> SmoothFunction:
        y0, y1 = (ca.SX.sym(name, len(wires.heat_scales)) for name in ("y0", "y1"))
        D0, D1 = (ca.SX.sym(name, wires.num_wires) for name in ("D0", "D1"))
        h = ca.SX.sym("h")
        return SmoothFunction(heat_defects(wires, y0, D0, y1, D1, h), ca.vertcat(y0, D0, y1, D1, h))

    points = np.column_stack([heat[:-1], duty[:-1], heat[1:], duty[1:], time_steps])
    function = model.once("heat defects", build)
    return FunctionBlock(function, points, scales=wires.heat_scales / 1.5)


def fixed_time_heat_blocks(
    model: LimbModel, heat: np.ndarray, duty: np.ndarray, time_steps: np.ndarray
) -> list[ConstraintBlock]:
    """Return `heat_block` at fixed time steps: a block for each group of equal wires.

    Wires that do not heat each other are points of one function, which is shorter than a function
    of all wires.

    Args:
        model, duty, time_steps: as for `heat_block`.
        heat: indices of the knots' [x, V] (K, M), or of x (K, N) alone.
    """
    wires = model.wires
    with_readings = heat.shape[1] > wires.num_states
    functions = model.once(
        f"heat defects of groups, {with_readings}",
        lambda: [
            _heat_function(wires, states[0], group[0], with_readings)
            for states, group in wires.equal_wires()
        ],
    )
    blocks: list[ConstraintBlock] = []
    for function, (states, group) in zip(functions, wires.equal_wires(), strict=True):
        # Variables of each wire, or of all wires of a group, are a point in each interval.
        columns = np.hstack([states, wires.num_states + group]) if with_readings else states
        knots = np.concatenate([heat[:, columns], duty[:, group]], axis=-1)
        points = np.concatenate([knots[:-1], knots[1:]], axis=-1)
        steps = np.repeat(time_steps, len(group))[:, None]
        blocks.append(
            FunctionBlock(
                function,
                points.reshape(-1, points.shape[-1]),
                scales=wires.heat_scales[columns[0]] / 1.5,
                parameters=steps,
            )
        )
    return blocks


def _heat_function(
    wires: Wires, states: np.ndarray, group: np.ndarray, with_readings: bool
) -> SmoothFunction:
    """Return `heat_defects` of some states and wires, as a function of [y0, D0, y1, D1] and h."""
    rows = np.append(states, wires.num_states + group) if with_readings else states
    y0, y1 = (ca.SX.sym(name, len(rows)) for name in ("y0", "y1"))
    D0, D1 = (ca.SX.sym(name, len(group)) for name in ("D0", "D1"))
    h = ca.SX.sym("h")
    # All other wires stay at zero.
    size = len(wires.heat_scales)
    first, second = (among_zeros(y, rows, size) for y in (y0, y1))
    duty, next_duty = (among_zeros(D, group, wires.num_wires) for D in (D0, D1))
    defects = heat_defects(wires, first, duty, second, next_duty, h)
    return SmoothFunction(defects[rows.tolist()], ca.vertcat(y0, D0, y1, D1), h)


def heat_defects(
    wires: Wires, first: ca.SX, duty: ca.SX, second: ca.SX, next_duty: ca.SX, step: ca.SX
) -> ca.SX:
    """Return the defects of the heat y alone over an interval of length h, as expressions (M,).

    They are the defects of (17) times 2 h / 3, with F of the heat:

        y1 - y0 - h/6 (F0 + 4 Fc + F1),  yc = (y0 + y1)/2 + h/8 (F0 - F1),  Dc = (D0 + D1)/2

    Args:
        first, second: y0 and y1 (M,).
        duty, next_duty: D0 and D1 (W,).
        step: h, s.
    """

    def rates(heat: ca.SX, duty: ca.SX) -> ca.SX:
        return wires.symbolic_heat(*ca.vertsplit(heat, [0, wires.num_states, heat.numel()]), duty)

    before = rates(first, duty)
    after = rates(second, next_duty)
    middle = (first + second) / 2 + step / 8 * (before - after)
    in_middle = rates(middle, (duty + next_duty) / 2)
    return second - first - step / 6 * (before + 4 * in_middle + after)
