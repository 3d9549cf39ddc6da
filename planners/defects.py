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
from pydrake.multibody.plant import MultibodyPlant

from limb_systems import LimbParameters, torque_matrix
from planners.chain import PlanarChain

# Changes that matter, which scaling takes as one.
ANGLE_SCALE = 0.1  # rad
TEMPERATURE_SCALE = 50.0  # °C


class LimbDefects:
    """Defects of a limb's trajectory at N evenly spaced knots, and their Jacobian.

    A trajectory is states (N, 2n + 2W), ordered as those of `Limb`, and duty
    (N, W). An interval has 2n + 2W rows in the order of the states, and its
    variables are [x0, x1, u0, u1].

    - ``num_intervals``: N - 1.
    - ``acceleration_to_angle``: K⁻¹ M(0) (n, n), s².
    - ``rows``, ``columns``: for each nonzero of an interval's Jacobian its
      row, and its column among the interval's variables.
    """

    def __init__(
        self,
        parameters: LimbParameters,
        plant: MultibodyPlant,
        num_knots: int,
        time_step: float,
    ):
        self._chain = PlanarChain(plant)
        self._h = time_step
        self._ambient = parameters.ambient_temperature
        self._torques = torque_matrix(parameters)
        self._a1, self._a2, a3 = (
            np.array([getattr(wire, name) for wire in parameters.wires])
            for name in ("a1", "a2", "a3")
        )
        chain = self._chain
        self.acceleration_to_angle = chain.straight_mass_matrix / chain.stiffness[:, None]
        self.num_intervals = num_knots - 1

        # Eqns (6)-(7) are linear: d/dt [T, V] = A [T, V] + B D above ambient.
        A = np.block([[np.diag(self._a1), np.zeros_like(np.diag(a3))], [-np.diag(a3), np.diag(a3)]])
        B = np.vstack([np.diag(self._a2), np.zeros_like(np.diag(a3))])
        self._thermal = time_step / TEMPERATURE_SCALE * linear_defect_jacobian(A, B, time_step)
        self._lay_out_jacobian()

    def evaluate(self, states: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Scaled defects (N - 1, 2n + 2W), all zero for a feasible trajectory."""
        h = self._h
        angles, rates, wire, measured = self._split(states)
        accelerations = self._chain.accelerations(angles, rates, self._forces(wire))
        middle = self._chain.accelerations(*self._midpoints(angles, rates, wire, duty))

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
        heat = np.hstack([wire, measured]) - self._ambient
        thermal_rows = np.hstack([heat[:-1], heat[1:], duty[:-1], duty[1:]]) @ self._thermal.T
        scale = self.acceleration_to_angle.T
        return np.hstack([8 / h * angle_rows @ scale, rate_rows @ scale, thermal_rows])

    def jacobian(self, states: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Nonzeros (N - 1, len(rows)) of the derivative of `evaluate`."""
        h, n = self._h, self._chain.num_joints
        angles, rates, wire, _ = self._split(states)
        _, by_angle, by_rate, by_force = self._chain.derivatives(angles, rates, self._forces(wire))
        by_wire = by_force @ self._torques
        _, mid_angle, mid_rate, mid_force = self._chain.derivatives(
            *self._midpoints(angles, rates, wire, duty)
        )
        mid_wire = mid_force @ self._torques
        one = np.eye(n)

        angle_rows = [
            -1.5 / h * one - h / 8 * by_angle[:-1],
            -0.75 * one - h / 8 * by_rate[:-1],
            -h / 8 * by_wire[:-1],
            1.5 / h * one + h / 8 * by_angle[1:],
            -0.75 * one + h / 8 * by_rate[1:],
            h / 8 * by_wire[1:],
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
        ]
        thermal = np.broadcast_to(
            self._thermal[self._thermal != 0], (self.num_intervals, np.sum(self._thermal != 0))
        )
        blocks = [
            8 / h * self.acceleration_to_angle @ np.concatenate(angle_rows, axis=2),
            self.acceleration_to_angle @ np.concatenate(rate_rows, axis=2),
            thermal,
        ]
        return np.hstack([block.reshape(self.num_intervals, -1) for block in blocks])

    def largest_disagreement(self, plant: MultibodyPlant) -> float:
        """Largest relative difference of the accelerations from the plant's."""
        return self._chain.largest_disagreement(plant)

    def _lay_out_jacobian(self) -> None:
        n, num_wires = self._chain.num_joints, len(self._a1)
        num_states = 2 * n + 2 * num_wires
        moving = np.arange(2 * n + num_wires)  # θ, θ̇, T of a knot
        heat = np.arange(2 * n, num_states)  # T, V of a knot
        inputs = np.arange(2 * num_states, 2 * num_states + 2 * num_wires)
        joints = np.arange(n)
        angle_grid = np.meshgrid(joints, np.r_[moving, num_states + moving], indexing="ij")
        rate_grid = np.meshgrid(
            n + joints, np.r_[moving, num_states + moving, inputs], indexing="ij"
        )
        thermal_rows, thermal_columns = np.nonzero(self._thermal)
        thermal_variables = np.r_[heat, num_states + heat, inputs]
        self.rows = np.concatenate(
            [angle_grid[0].ravel(), rate_grid[0].ravel(), 2 * n + thermal_rows]
        )
        self.columns = np.concatenate(
            [angle_grid[1].ravel(), rate_grid[1].ravel(), thermal_variables[thermal_columns]]
        )

    def _midpoints(self, angles, rates, wire, duty):
        """θ, θ̇ and f at the middle of each interval."""
        h = self._h
        wire_rates = self._a1 * (wire - self._ambient) + self._a2 * duty
        mid_wire = 0.5 * (wire[:-1] + wire[1:]) - h / 8 * np.diff(wire_rates, axis=0)
        return (
            0.5 * (angles[:-1] + angles[1:]) - h / 8 * np.diff(rates, axis=0),
            1.5 / h * np.diff(angles, axis=0) - 0.25 * (rates[:-1] + rates[1:]),
            self._forces(mid_wire),
        )

    def _forces(self, wire: np.ndarray) -> np.ndarray:
        return (wire - self._ambient) @ self._torques.T

    def _split(self, states: np.ndarray):
        n, num_wires = self._chain.num_joints, len(self._a1)
        return np.split(states, np.cumsum([n, n, num_wires]), axis=1)


def linear_defect_jacobian(A: np.ndarray, B: np.ndarray, time_step: float) -> np.ndarray:
    """Direct collocation of ẏ = A y + B u over one interval.

    Returns:
        The matrix J of the defect ẏ_c - f(y_c, u_c) = J [y0, y1, u0, u1].
    """
    h, one = time_step, np.eye(len(A))
    # The derivatives of ẏ_c and of y_c, u_c by [y0, y1, u0, u1], one after the other.
    rate = np.hstack([-1.5 / h * one - A / 4, 1.5 / h * one - A / 4, -B / 4, -B / 4])
    state = np.hstack([one / 2 + h / 8 * A, one / 2 - h / 8 * A, h / 8 * B, -h / 8 * B])
    inputs = np.hstack([np.zeros((B.shape[1], 2 * len(A))), *[np.eye(B.shape[1]) / 2] * 2])
    return rate - A @ state - B @ inputs
