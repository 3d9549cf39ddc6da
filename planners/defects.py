"""The collocation constraints of a whole limb trajectory at once.

Drake's `DirectCollocationConstraint` says, for each interval of length h,
that the cubic through the knots (x0, ẋ0), (x1, ẋ1) obeys the dynamics at its
middle:

    x_c = (x0 + x1)/2 + h/8 (ẋ0 - ẋ1),    u_c = (u0 + u1)/2
    ẋ_c = 3/(2h) (x1 - x0) - (ẋ0 + ẋ1)/4 = f(x_c, u_c)

`LimbDefects` evaluates the same equations for all intervals in numpy, with a
sparse Jacobian, and differs in two ways that leave the solutions as they are:

- The midpoint rate is θ̇_c = 3/(2h) (θ1 - θ0) - (θ̇0 + θ̇1)/4, which equals the
  θ̇_c above wherever the θ rows hold. The midpoint state is then linear in the
  knots, without accelerations in it that are large and stiff.
- Rows are scaled to the size of the states: accelerations by K⁻¹ M(0), which
  turns them into the static deflections they stand for.
"""

import numpy as np

from limb_systems import Limb, Wires
from planners.chain import PlanarChain

ANGLE_SCALE = 0.1  # rad, a typical change, which is scaled to one

_IMAGINARY_STEP = 1e-30


class LimbDefects:
    """Defects of a limb's trajectory at K knots, and their derivatives.

    A trajectory is states (K, 2n + M), ordered as those of `Limb`, with the
    heat y = [x, V] (M) of its wires, duty (K, W) and time steps (K - 1). An
    interval has 2n + M rows in the order of the states, and its variables are
    [x0, x1, u0, u1, h]. The derivatives of the mechanics are written out;
    those of the wires come from their laws.

    - ``num_intervals``: K - 1.
    - ``acceleration_to_angle``: K⁻¹ M(0) (n, n), s².
    - ``heat_scales``: typical changes of the heat (M,).
    - ``rows``, ``columns``: for each nonzero of an interval's Jacobian its
      row, and its column among the interval's variables.
    - ``hessian_rows``, ``hessian_columns``: for each nonzero of an
      interval's symmetric Hessian, once, its two variables.
    - ``wire_hessian_rows``, ``wire_hessian_columns``: the same of `wire_hessian`.

    Args:
        limb: whose manipulator and wires it is for.
        num_knots: K.
        typical_time_step: s, for the scaling of rows.
    """

    def __init__(self, limb: Limb, num_knots: int, typical_time_step: float):
        self._chain = chain = PlanarChain(limb.GetSubsystemByName("manipulator"))
        self._wires = Wires(limb.parameters)
        self._typical_h = typical_time_step
        self.acceleration_to_angle = chain.straight_mass_matrix / chain.stiffness[:, None]
        self.num_intervals = num_knots - 1
        self.heat_scales = self._wires.heat_scales
        self._lay_out_derivatives()
        self._linear_heat = None
        if self._wires.rates_are_affine:
            none = np.zeros((1, len(self.heat_scales))), np.zeros((1, self._wires.num_wires))
            self._linear_heat = self._heat_parts(*[self._wires.heat_jacobian(*none)] * 3)

    def evaluate(self, states: np.ndarray, duty: np.ndarray, time_steps: np.ndarray) -> np.ndarray:
        """Scaled defects (K - 1, 2n + M), all zero for a feasible trajectory."""
        h, wires = time_steps[:, None], self._wires
        angles, rates, heat = self._split(states)
        heat_rates = wires.heat_rates(heat, duty)
        mid_angles, mid_rates, mid_heat, mid_duty = _middle(
            angles, rates, heat, heat_rates, duty, h
        )
        accelerations = self.accelerations(states)
        angle_rows = (
            1.5 / h * np.diff(angles, axis=0)
            - 0.75 * (rates[:-1] + rates[1:])
            + h / 8 * np.diff(accelerations, axis=0)
        )
        rate_rows = (
            1.5 / h * np.diff(rates, axis=0)
            - 0.25 * (accelerations[:-1] + accelerations[1:])
            - self._accelerations(mid_angles, mid_rates, mid_heat)
        )
        heat_rows = (
            1.5 / h * np.diff(heat, axis=0)
            - 0.25 * (heat_rates[:-1] + heat_rates[1:])
            - wires.heat_rates(mid_heat, mid_duty)
        )
        scale = self.acceleration_to_angle.T
        return np.hstack(
            [
                8 / self._typical_h * angle_rows @ scale,
                rate_rows @ scale,
                self._typical_h / self.heat_scales * heat_rows,
            ]
        )

    def jacobian(self, states: np.ndarray, duty: np.ndarray, time_steps: np.ndarray) -> np.ndarray:
        """Nonzeros (K - 1, len(rows)) of the derivative of `evaluate`."""
        h, wires = time_steps[:, None], self._wires
        n, num_states = self._chain.num_joints, wires.num_states
        angles, rates, heat = self._split(states)
        heat_rates = wires.heat_rates(heat, duty)
        mid_angles, mid_rates, mid_heat, mid_duty = _middle(
            angles, rates, heat, heat_rates, duty, h
        )
        accelerations, by_angle, by_rate, by_wire = self._derivatives(angles, rates, heat)
        _, mid_angle, mid_rate, mid_wire = self._derivatives(mid_angles, mid_rates, mid_heat)
        angle_step, rate_step = np.diff(angles, axis=0), np.diff(rates, axis=0)
        heat_step, heat_rate_step = np.diff(heat, axis=0), np.diff(heat_rates, axis=0)

        # Of the heat's rates at the knots and in the middle, by [x, V, D]; the same at all points
        # if the laws are affine. Only the wires' states x move the limb.
        by_heat, mid_by_heat = (
            wires.heat_jacobian(heat, duty),
            wires.heat_jacobian(mid_heat, mid_duty),
        )
        first, second = (by_heat[:-1], by_heat[1:]) if len(by_heat) > 1 else (by_heat, by_heat)
        num_heat = heat.shape[1]
        x0, u0 = x1, u1 = self._split_by_wires(mid_wire @ self._moving(first))
        if second is not first:
            x1, u1 = self._split_by_wires(mid_wire @ self._moving(second))

        def column(vectors):
            return vectors[:, :, None]

        h, one = column(h), np.eye(n)
        angle_rows = [
            -1.5 / h * one - h / 8 * by_angle[:-1],
            -0.75 * one - h / 8 * by_rate[:-1],
            -h / 8 * by_wire[:-1],
            1.5 / h * one + h / 8 * by_angle[1:],
            -0.75 * one + h / 8 * by_rate[1:],
            h / 8 * by_wire[1:],
            -1.5 / h**2 * column(angle_step) + column(np.diff(accelerations, axis=0)) / 8,
        ]
        rate_rows = [
            -0.25 * by_angle[:-1] - 0.5 * mid_angle + 1.5 / h * mid_rate,
            -1.5 / h * one - 0.25 * by_rate[:-1] - h / 8 * mid_angle + 0.25 * mid_rate,
            -0.25 * by_wire[:-1] - 0.5 * mid_wire - h / 8 * x0,
            -0.25 * by_angle[1:] - 0.5 * mid_angle - 1.5 / h * mid_rate,
            1.5 / h * one - 0.25 * by_rate[1:] + h / 8 * mid_angle + 0.25 * mid_rate,
            -0.25 * by_wire[1:] - 0.5 * mid_wire + h / 8 * x1,
            -h / 8 * u0,
            h / 8 * u1,
            -1.5 / h**2 * column(rate_step)
            + mid_angle @ column(rate_step) / 8
            + 1.5 / h**2 * mid_rate @ column(angle_step)
            + mid_wire @ column(heat_rate_step[:, :num_states]) / 8,
        ]
        h = time_steps[:, None]
        scale = self._typical_h / self.heat_scales
        P, Q, R = self._linear_heat or self._heat_parts(first, second, mid_by_heat)
        heat_by_step = (
            -1.5 / h**2 * heat_step
            + (mid_by_heat[:, :, :num_heat] @ column(heat_rate_step))[:, :, 0] / 8
        )
        blocks = [
            8 / self._typical_h * self.acceleration_to_angle @ np.concatenate(angle_rows, axis=2),
            self.acceleration_to_angle @ np.concatenate(rate_rows, axis=2),
            P / h + Q + R * h,
            scale * heat_by_step,
        ]
        return np.hstack([block.reshape(self.num_intervals, -1) for block in blocks])

    def hessian(
        self,
        states: np.ndarray,
        duty: np.ndarray,
        time_steps: np.ndarray,
        multipliers: np.ndarray,
    ) -> np.ndarray:
        """Nonzeros (K - 1, len(hessian_rows)) of the Hessian of Σ multipliers · evaluate.

        By complex steps in the Jacobian of all that does not enter linearly,
        which are exact to rounding. An interval has one even and one odd knot,
        so all even knots move at once, and then all odd ones.

        Args:
            multipliers: (K - 1, 2n + M).
        """
        num_states, num_wires = states.shape[1], duty.shape[1]
        num_local = self.hessian_rows.max() + 1
        gather = np.zeros((len(self.columns), num_local))
        gather[np.arange(len(self.columns)), self.columns] = 1.0
        weights = multipliers[:, self.rows]

        def derivative(states, duty, time_steps):
            """Of the Lagrangian's gradient by the variables with imaginary parts."""
            change = self.jacobian(states, duty, time_steps).imag / _IMAGINARY_STEP
            return (weights * change) @ gather

        hessian = np.zeros((self.num_intervals, num_local, num_local))
        is_odd = np.arange(self.num_intervals) % 2 == 1
        # The first knot's index among an interval's variables, and how far behind is the second's.
        moves = [(states, index, index, num_states) for index in self._curved_states]
        moves += [(duty, index, 2 * num_states + index, num_wires) for index in self._curved_inputs]
        for moving, index, variable, behind in moves:
            for parity in (0, 1):
                moved = moving.astype(complex)
                moved[parity::2, index] += 1j * _IMAGINARY_STEP
                point = (moved, duty) if moving is states else (states, moved)
                change = derivative(*point, time_steps)
                first = is_odd == bool(parity)  # the intervals whose first knot moved
                hessian[first, variable] = change[first]
                hessian[~first, variable + behind] = change[~first]
        hessian[:, -1] = derivative(states, duty, time_steps + 1j * _IMAGINARY_STEP)
        return hessian[:, self.hessian_rows, self.hessian_columns]

    def wire_hessian(
        self,
        states: np.ndarray,
        duty: np.ndarray,
        time_steps: np.ndarray,
        multipliers: np.ndarray,
    ) -> np.ndarray:
        """Nonzeros (K - 1, len(wire_hessian_rows)) of the Hessian by heat and duty alone.

        That is the curvature of the wires' laws. As the mechanics is linear in
        the wires' forces, it is exactly this part of `hessian`, and written out.

        Args:
            multipliers: (K - 1, 2n + M).
        """
        wires, h = self._wires, time_steps[:, None]
        N, M = wires.num_states, len(self.heat_scales)
        angles, rates, heat = self._split(states)
        heat_rates = wires.heat_rates(heat, duty)
        mid_angles, _, mid_heat, mid_duty = _middle(angles, rates, heat, heat_rates, duty, h)
        on_angles, on_rates, on_heat = self._split(multipliers)
        on_angles = 8 / self._typical_h * on_angles @ self.acceleration_to_angle
        on_rates = on_rates @ self.acceleration_to_angle
        on_heat = self._typical_h / self.heat_scales * on_heat

        # The weights of forces and of heat rates in the Lagrangian, at the knots and in the middle.
        on_force = _times(
            self._chain.mobilities(angles),
            _at_knots(-h / 8 * on_angles - 0.25 * on_rates, h / 8 * on_angles - 0.25 * on_rates),
        )
        on_mid_force = _times(self._chain.mobilities(mid_angles), -on_rates)
        middle = np.zeros((self.num_intervals, M + wires.num_wires, M + wires.num_wires))
        middle[:, :N, :N] = wires.force_hessian(mid_heat[:, :N], mid_angles, on_mid_force)
        at_knots = np.zeros((len(states), *middle.shape[1:]))
        at_knots[:, :N, :N] = wires.force_hessian(heat[:, :N], angles, on_force)
        slopes = wires.heat_jacobian(heat, duty)
        first, second = slopes, slopes
        if not wires.rates_are_affine:
            first, second = slopes[:-1], slopes[1:]
            mid_slopes = wires.heat_jacobian(mid_heat, mid_duty)[:, :, :M]
            force_slopes, _ = wires.force_derivatives(mid_heat[:, :N], mid_angles)
            on_mid_heat = -_times(mid_slopes.swapaxes(1, 2), on_heat)
            on_mid_heat[:, :N] += _times(force_slopes.swapaxes(1, 2), on_mid_force)
            on_slopes = _at_knots(
                h / 8 * on_mid_heat - 0.25 * on_heat, -h / 8 * on_mid_heat - 0.25 * on_heat
            )
            middle += wires.heat_hessian(mid_heat, mid_duty, -on_heat)
            at_knots += wires.heat_hessian(heat, duty, on_slopes)
        to_middle = _to_middle(first, second, h[:, :, None])
        result = to_middle.swapaxes(1, 2) @ middle @ to_middle
        # A knot's own curvature is in the interval that it begins, the last one's in the last.
        begins, ends = self._of_knots
        result[:, begins[:, None], begins] += at_knots[:-1]
        result[-1, ends[:, None], ends] += at_knots[-1]
        return result[:, *self._wire_pairs]

    def _heat_parts(self, first, second, middle):
        """The nonzeros of P, Q, R of `_heat_terms`, scaled as the rows are."""
        scale = (self._typical_h / self.heat_scales)[:, None]
        terms = _heat_terms(first, second, middle)
        return [(scale * term)[:, *self._heat_nonzeros] for term in terms]

    def accelerations(self, states: np.ndarray) -> np.ndarray:
        """θ̈ (K, n) of states (K, 2n + M), rad/s²."""
        return self._accelerations(*self._split(states))

    def _accelerations(self, angles, rates, heat):
        forces = self._wires.forces(heat[:, : self._wires.num_states], angles)
        return self._chain.accelerations(angles, rates, forces)

    def _derivatives(self, angles, rates, heat):
        """θ̈ (K, n), and its derivatives by θ, θ̇ (K, n, n) and x (K, n, N)."""
        states = heat[:, : self._wires.num_states]
        forces = self._wires.forces(states, angles)
        force_by_state, force_by_angle = self._wires.force_derivatives(states, angles)
        result, by_angle, by_rate, by_force = self._chain.derivatives(angles, rates, forces)
        if force_by_angle is not None:
            by_angle = by_angle + by_force * force_by_angle[:, None, :]
        return result, by_angle, by_rate, by_force @ force_by_state

    def _lay_out_derivatives(self) -> None:
        n, wires = self._chain.num_joints, self._wires
        num_wires, num_heat = wires.num_wires, wires.num_states + wires.num_wires
        num_states = 2 * n + num_heat
        moving = np.arange(2 * n + wires.num_states)  # θ, θ̇, x of a knot
        moving = np.r_[moving, num_states + moving]
        heat = np.arange(2 * n, num_states)  # x, V of a knot
        inputs = 2 * num_states + np.arange(2 * num_wires)
        time_step = 2 * num_states + 2 * num_wires
        joints = np.arange(n)
        grids = [
            np.meshgrid(joints, np.r_[moving, time_step], indexing="ij"),
            np.meshgrid(n + joints, np.r_[moving, inputs, time_step], indexing="ij"),
        ]
        pattern = wires.heat_pattern[np.newaxis].astype(float)
        self._heat_nonzeros = np.nonzero(
            sum(np.abs(term[0]) for term in _heat_terms(pattern, pattern, pattern))
        )
        heat_rows, heat_columns = self._heat_nonzeros
        heat_variables = np.r_[heat, num_states + heat, inputs]
        self.rows = np.concatenate([grid[0].ravel() for grid in grids] + [2 * n + heat_rows, heat])
        self.columns = np.concatenate(
            [grid[1].ravel() for grid in grids]
            + [heat_variables[heat_columns], np.full(len(heat), time_step)]
        )

        # Products of θ, θ̇ and h with anything; heat and duty enter linearly where the laws are
        # affine. The rows of what is curved are those that `hessian` calculates.
        affine = wires.rates_are_affine and wires.torque_is_affine
        self._curved_states = np.arange(2 * n if affine else num_states)
        self._curved_inputs = np.arange(0 if affine else num_wires)
        curved = np.r_[
            self._curved_states,
            num_states + self._curved_states,
            2 * num_states + self._curved_inputs,
            2 * num_states + num_wires + self._curved_inputs,
        ]
        bends = np.zeros((time_step + 1, time_step + 1), bool)
        bends[np.ix_(curved, np.r_[moving, inputs, curved])] = True
        bends[time_step] = True
        upper = np.triu(bends, 1).T
        rows, columns = np.nonzero(np.tril(bends) | upper)
        given = bends[rows, columns]
        self.hessian_rows = np.where(given, rows, columns)
        self.hessian_columns = np.where(given, columns, rows)

        # The curvature of the wires, of each heat and duty by those that share a formula with it,
        # at a knot or in the middle.
        M = num_heat
        begins = np.r_[:M, 2 * M : 2 * M + num_wires]
        self._of_knots = begins, np.r_[M : 2 * M, 2 * M + num_wires : 2 * M + 2 * num_wires]
        curvature = wires.heat_curvature.astype(float)
        curvature[: wires.num_states, : wires.num_states] += wires.torque_curvature
        to_middle = np.abs(_to_middle(pattern, pattern, np.array([[[0.1]]]))[0])
        pairs = to_middle.T @ curvature @ to_middle
        for of_knot in self._of_knots:
            pairs[np.ix_(of_knot, of_knot)] += curvature
        self._wire_pairs = np.nonzero(np.tril(pairs))
        rows, columns = self._wire_pairs
        self.wire_hessian_rows, self.wire_hessian_columns = (
            heat_variables[rows],
            heat_variables[columns],
        )

    def _moving(self, heat_jacobian):
        """Derivatives of the wires' states alone, by these and by duty (.., N, N + W)."""
        N, W = self._wires.num_states, self._wires.num_wires
        return np.concatenate([heat_jacobian[:, :N, :N], heat_jacobian[:, :N, N + W :]], axis=2)

    def _split_by_wires(self, derivatives):
        """Parts of derivatives by states and by duty."""
        N = self._wires.num_states
        return derivatives[:, :, :N], derivatives[:, :, N:]

    def _split(self, states):
        """θ, θ̇ and y of states (K, 2n + M)."""
        n = self._chain.num_joints
        return states[:, :n], states[:, n : 2 * n], states[:, 2 * n :]


def _middle(angles, rates, heat, heat_rates, duty, h):
    """θ, θ̇, y and D at the middle of each interval."""
    return (
        0.5 * (angles[:-1] + angles[1:]) - h / 8 * np.diff(rates, axis=0),
        1.5 / h * np.diff(angles, axis=0) - 0.25 * (rates[:-1] + rates[1:]),
        0.5 * (heat[:-1] + heat[1:]) - h / 8 * np.diff(heat_rates, axis=0),
        0.5 * (duty[:-1] + duty[1:]),
    )


def _to_middle(first: np.ndarray, second: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Derivatives of y_c and u_c by [y0, y1, u0, u1] (K, M + W, 2M + 2W).

    Args:
        first, second: of the heat's rates at the knots, as for `_heat_terms`.
        h: time steps (K, 1, 1).
    """
    M, size = first.shape[1:]
    half = 0.5 * np.eye(size)
    before, after = np.broadcast_to(half, (2, len(h), size, size)).copy()
    before[:, :M] += h / 8 * first
    after[:, :M] -= h / 8 * second
    return np.concatenate([before[..., :M], after[..., :M], before[..., M:], after[..., M:]], 2)


def _at_knots(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Sums at K knots of what the K - 1 intervals have at their first and at their second knot."""
    none = np.zeros_like(before[:1])
    return np.concatenate([before, none]) + np.concatenate([none, after])


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Products of matrices (K, m, n) and vectors (K, n)."""
    return (matrices @ vectors[:, :, None])[:, :, 0]


def _heat_terms(
    first: np.ndarray, second: np.ndarray, middle: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Direct collocation of ẏ = f(y, u) over intervals of length h, differentiated.

    Args:
        first, second, middle: derivatives of f by [y, u] at the knots and in
            the middle, (K, M, M + W); or (1, M, M + W), the same for all intervals.

    Returns:
        P, Q, R, each (K, M, 2M + 2W): the defect ẏ_c - f(y_c, u_c) has the
        derivative P/h + Q + R h by [y0, y1, u0, u1].
    """
    M = first.shape[1]
    one = np.eye(*first.shape[1:])
    by_state = middle[:, :, :M]
    terms = (
        (-1.5 * one[None], 1.5 * one[None]),
        (-0.25 * first - 0.5 * middle, -0.25 * second - 0.5 * middle),
        (-by_state @ first / 8, by_state @ second / 8),
    )
    P, Q, R = (
        np.concatenate([a[..., :M], b[..., :M], a[..., M:], b[..., M:]], axis=2) for a, b in terms
    )
    return P, Q, R


def linear_defect_terms(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Direct collocation of ẏ = A y + B u over one interval of length h.

    Returns:
        P, Q, R of the defect ẏ_c - f(y_c, u_c) = (P/h + Q + R h) [y0, y1, u0, u1].
    """
    derivatives = np.hstack([A, B])[None]
    P, Q, R = (term[0] for term in _heat_terms(derivatives, derivatives, derivatives))
    return P, Q, R
