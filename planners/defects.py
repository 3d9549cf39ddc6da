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

from limb_systems import LimbParameters, make_manipulator, torque_matrix
from planners.chain import PlanarChain

# Changes that matter, which scaling takes as one.
ANGLE_SCALE = 0.1  # rad
TEMPERATURE_SCALE = 50.0  # °C

_IMAGINARY_STEP = 1e-30


class LimbDefects:
    """Defects of a limb's trajectory at N knots, and their derivatives.

    A trajectory is states (N, 2n + 2W), ordered as those of `Limb`, duty
    (N, W) and time steps (N - 1). An interval has 2n + 2W rows in the order
    of the states, and its variables are [x0, x1, u0, u1, h].

    - ``num_intervals``: N - 1.
    - ``acceleration_to_angle``: K⁻¹ M(0) (n, n), s².
    - ``rows``, ``columns``: for each nonzero of an interval's Jacobian its
      row, and its column among the interval's variables.
    - ``hessian_rows``, ``hessian_columns``: for each nonzero of an
      interval's symmetric Hessian, once, its two variables.

    Args:
        num_knots: N.
        typical_time_step: s, for the scaling of rows.
    """

    def __init__(
        self,
        parameters: LimbParameters,
        num_knots: int,
        typical_time_step: float,
    ):
        self._chain = chain = PlanarChain(make_manipulator(parameters))
        self._typical_h = typical_time_step
        self._ambient = parameters.ambient_temperature
        self._torques = torque_matrix(parameters)
        self._a1, self._a2, a3 = (
            np.array([getattr(wire, name) for wire in parameters.wires])
            for name in ("a1", "a2", "a3")
        )
        self.acceleration_to_angle = chain.straight_mass_matrix / chain.stiffness[:, None]
        self.num_intervals = num_knots - 1

        # Eqns (6)-(7) are linear: d/dt [T, V] = A [T, V] + B D above ambient.
        none = np.zeros((len(a3), len(a3)))
        A = np.block([[np.diag(self._a1), none], [-np.diag(a3), np.diag(a3)]])
        B = np.vstack([np.diag(self._a2), none])
        self._thermal = [
            typical_time_step / TEMPERATURE_SCALE * term for term in linear_defect_terms(A, B)
        ]
        self._lay_out_derivatives()

    def evaluate(self, states: np.ndarray, duty: np.ndarray, time_steps: np.ndarray) -> np.ndarray:
        """Scaled defects (N - 1, 2n + 2W), all zero for a feasible trajectory."""
        h = time_steps[:, None]
        angles, rates, wire, _ = self._split(states)
        accelerations = self.accelerations(states)
        middle = self._chain.accelerations(*self._midpoints(angles, rates, wire, duty, h))
        angle_rows = (
            1.5 / h * np.diff(angles, axis=0)
            - 0.75 * (rates[:-1] + rates[1:])
            + h / 8 * np.diff(accelerations, axis=0)
        )
        rate_rows = (
            1.5 / h * np.diff(rates, axis=0)
            - 0.25 * (accelerations[:-1] + accelerations[1:])
            - middle
        )
        P, Q, R = (self._thermal_variables(states, duty) @ term.T for term in self._thermal)
        scale = self.acceleration_to_angle.T
        return np.hstack(
            [8 / self._typical_h * angle_rows @ scale, rate_rows @ scale, P / h + Q + R * h]
        )

    def jacobian(self, states: np.ndarray, duty: np.ndarray, time_steps: np.ndarray) -> np.ndarray:
        """Nonzeros (N - 1, len(rows)) of the derivative of `evaluate`."""
        h, n = time_steps[:, None], self._chain.num_joints
        angles, rates, wire, _ = self._split(states)
        accelerations, by_angle, by_rate, by_force = self._chain.derivatives(
            angles, rates, self._forces(wire)
        )
        by_wire = by_force @ self._torques
        _, mid_angle, mid_rate, mid_force = self._chain.derivatives(
            *self._midpoints(angles, rates, wire, duty, h)
        )
        mid_wire = mid_force @ self._torques
        angle_step, rate_step = np.diff(angles, axis=0), np.diff(rates, axis=0)
        wire_rate_step = np.diff(self._wire_rates(wire, duty), axis=0)

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
            -0.25 * by_wire[:-1] - mid_wire * (0.5 + h / 8 * self._a1),
            -0.25 * by_angle[1:] - 0.5 * mid_angle - 1.5 / h * mid_rate,
            1.5 / h * one - 0.25 * by_rate[1:] + h / 8 * mid_angle + 0.25 * mid_rate,
            -0.25 * by_wire[1:] - mid_wire * (0.5 - h / 8 * self._a1),
            -h / 8 * mid_wire * self._a2,
            h / 8 * mid_wire * self._a2,
            -1.5 / h**2 * column(rate_step)
            + mid_angle @ column(rate_step) / 8
            + 1.5 / h**2 * mid_rate @ column(angle_step)
            + mid_wire @ column(wire_rate_step) / 8,
        ]
        h = time_steps[:, None]
        P, Q, R = (term[self._thermal_nonzeros] for term in self._thermal)
        variables = self._thermal_variables(states, duty)
        blocks = [
            8 / self._typical_h * self.acceleration_to_angle @ np.concatenate(angle_rows, axis=2),
            self.acceleration_to_angle @ np.concatenate(rate_rows, axis=2),
            P / h + Q + R * h,
            variables @ self._thermal[2].T - variables @ self._thermal[0].T / h**2,
        ]
        return np.hstack([block.reshape(self.num_intervals, -1) for block in blocks])

    def hessian(
        self,
        states: np.ndarray,
        duty: np.ndarray,
        time_steps: np.ndarray,
        multipliers: np.ndarray,
    ) -> np.ndarray:
        """Nonzeros (N - 1, len(hessian_rows)) of the Hessian of Σ multipliers · evaluate.

        By complex steps of θ, θ̇ and h in the Jacobian, which are exact to
        rounding. An interval has one even and one odd knot, so all even knots
        move at once, and then all odd ones.

        Args:
            multipliers: (N - 1, 2n + 2W).
        """
        n, num_states = self._chain.num_joints, states.shape[1]
        num_local = self.hessian_rows.max() + 1
        gather = np.zeros((len(self.columns), num_local))
        gather[np.arange(len(self.columns)), self.columns] = 1.0
        weights = multipliers[:, self.rows]

        def derivative(states, time_steps):
            """Of the Lagrangian's gradient by the variables with imaginary parts."""
            change = self.jacobian(states, duty, time_steps).imag / _IMAGINARY_STEP
            return (weights * change) @ gather

        hessian = np.zeros((self.num_intervals, num_local, num_local))
        is_odd = np.arange(self.num_intervals) % 2 == 1
        for index in range(2 * n):
            for parity in (0, 1):
                moved = states.astype(complex)
                moved[parity::2, index] += 1j * _IMAGINARY_STEP
                change = derivative(moved, time_steps)
                first = is_odd == bool(parity)  # the intervals whose first knot moved
                hessian[first, index] = change[first]
                hessian[~first, num_states + index] = change[~first]
        hessian[:, -1] = derivative(states, time_steps + 1j * _IMAGINARY_STEP)
        return hessian[:, self.hessian_rows, self.hessian_columns]

    def accelerations(self, states: np.ndarray) -> np.ndarray:
        """θ̈ (K, n) of states (K, 2n + 2W), rad/s²."""
        angles, rates, wire, _ = self._split(states)
        return self._chain.accelerations(angles, rates, self._forces(wire))

    def _lay_out_derivatives(self) -> None:
        n, num_wires = self._chain.num_joints, len(self._a1)
        num_states = 2 * n + 2 * num_wires
        moving = np.arange(2 * n + num_wires)  # θ, θ̇, T of a knot
        moving = np.r_[moving, num_states + moving]
        heat = np.arange(2 * n, num_states)  # T, V of a knot
        inputs = 2 * num_states + np.arange(2 * num_wires)
        time_step = 2 * num_states + 2 * num_wires
        joints = np.arange(n)
        grids = [
            np.meshgrid(joints, np.r_[moving, time_step], indexing="ij"),
            np.meshgrid(n + joints, np.r_[moving, inputs, time_step], indexing="ij"),
        ]
        self._thermal_nonzeros = np.nonzero(np.abs(self._thermal).sum(axis=0))
        thermal_rows, thermal_columns = self._thermal_nonzeros
        thermal_variables = np.r_[heat, num_states + heat, inputs]
        self.rows = np.concatenate(
            [grid[0].ravel() for grid in grids] + [2 * n + thermal_rows, heat]
        )
        self.columns = np.concatenate(
            [grid[1].ravel() for grid in grids]
            + [thermal_variables[thermal_columns], np.full(len(heat), time_step)]
        )

        # Products of θ, θ̇ and h with anything; T, V and D enter linearly. The
        # rows of the former are those that `hessian` calculates.
        bends = np.zeros((time_step + 1, time_step + 1), bool)
        curved = np.r_[np.arange(2 * n), num_states + np.arange(2 * n)]
        bends[np.ix_(curved, np.r_[moving, inputs])] = True
        bends[time_step] = True
        upper = np.triu(bends, 1).T
        rows, columns = np.nonzero(np.tril(bends) | upper)
        given = bends[rows, columns]
        self.hessian_rows = np.where(given, rows, columns)
        self.hessian_columns = np.where(given, columns, rows)

    def _midpoints(self, angles, rates, wire, duty, h):
        """θ, θ̇ and f at the middle of each interval."""
        wire_rate_step = np.diff(self._wire_rates(wire, duty), axis=0)
        return (
            0.5 * (angles[:-1] + angles[1:]) - h / 8 * np.diff(rates, axis=0),
            1.5 / h * np.diff(angles, axis=0) - 0.25 * (rates[:-1] + rates[1:]),
            self._forces(0.5 * (wire[:-1] + wire[1:]) - h / 8 * wire_rate_step),
        )

    def _wire_rates(self, wire, duty):
        return self._a1 * (wire - self._ambient) + self._a2 * duty

    def _forces(self, wire):
        return (wire - self._ambient) @ self._torques.T

    def _thermal_variables(self, states, duty):
        """[T0, V0, T1, V1, D0, D1] above ambient of each interval."""
        heat = states[:, 2 * self._chain.num_joints :] - self._ambient
        return np.hstack([heat[:-1], heat[1:], duty[:-1], duty[1:]])

    def _split(self, states):
        n, num_wires = self._chain.num_joints, len(self._a1)
        return np.split(states, np.cumsum([n, n, num_wires]), axis=1)


def linear_defect_terms(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Direct collocation of ẏ = A y + B u over one interval of length h.

    Returns:
        P, Q, R of the defect ẏ_c - f(y_c, u_c) = (P/h + Q + R h) [y0, y1, u0, u1].
    """
    one, nothing = np.eye(len(A)), np.zeros_like(B)
    P = 1.5 * np.hstack([-one, one, nothing, nothing])
    Q = -0.75 * np.hstack([A, A, B, B])
    R = -A @ np.hstack([A, -A, B, -B]) / 8
    return P, Q, R
