"""The equation of motion (2), stated once, and the accelerations that solve it."""

import functools

import casadi as ca
import numpy as np

from limb_systems.kinematics import Chain, rest_joint_angles
from limb_systems.layout import Layout
from limb_systems.limb_parameters import LimbParameters
from limb_systems.smooth_function import SmoothFunction
from limb_systems.wires import Wires


def equation_of_motion(
    parameters: LimbParameters,
    wires: Wires,
    angles: ca.SX,
    rates: ca.SX,
    accelerations: ca.SX,
    states: ca.SX,
) -> ca.SX:
    """The residual of (2) on each joint (n,), N·m, which is zero in every motion.

        M(θ) θ̈ + C(θ, θ̇) θ̇ + ∇V(θ) + σ θ̇ + K (θ - θ_0) - f(x, θ)

    The springs K rest at θ_0, V is the potential of gravity, and f is the force of the wires and
    of nonlinear rubber (4).

    Args:
        parameters: description of the limb.
        wires: the limb's wires.
        angles, rates, accelerations: θ, θ̇ and θ̈ (n,), rad, rad/s and rad/s².
        states: x (N,) of the wires.
    """
    layout = Layout(parameters)
    gravity = ca.DM(parameters.gravity)
    inertia = Chain(layout, angles).inverse_dynamics(rates, accelerations, gravity)
    springs = ca.DM(layout.stiffness) * (angles - ca.DM(rest_joint_angles(parameters)))
    return inertia + springs + ca.DM(layout.damping) * rates - wires.symbolic_force(states, angles)


class Dynamics:
    """The time derivatives of a limb's motion and heat at points [θ, θ̇, x, V, D] (..., P).

    Its values are [θ̈, ẋ, V̇] (..., n + N + W). It has the methods of a `SmoothFunction`. It is not
    one, because θ̈ solves (2): with the residual r(p, θ̈) = 0, the derivatives of θ̈ by p are
    -M⁻¹ ∂r/∂p. The second derivatives of w · θ̈ follow from the Hessian of -λ · r with M λ = w.

    - ``num_joints``: n.
    - ``acceleration_to_angle``: K⁻¹ M(0) (n, n), s²: static deflections for accelerations.
    - ``pattern``: true where a value depends on a variable (n + N + W, P).
    - ``curvature``: true where a pair of variables may have a second derivative (P, P).

    Args:
        parameters: description of the limb.
    """

    def __init__(self, parameters: LimbParameters):
        self._wires = wires = Wires(parameters)
        self.num_joints = n = parameters.num_joints
        N = wires.num_states
        q, v, a = (ca.SX.sym(name, n) for name in ("q", "v", "a"))
        x = ca.SX.sym("x", N)
        residual = equation_of_motion(parameters, wires, q, v, a, x)
        self._residual = SmoothFunction(residual, ca.vertcat(q, v, x), a)
        self._with_acceleration = SmoothFunction(residual, ca.vertcat(q, v, x, a))
        self._force = SmoothFunction(wires.symbolic_force(x, q), x, q)
        still = ca.substitute(residual, a, ca.SX.zeros(n))
        mass = ca.vec(ca.jacobian(residual, a))
        self._motion = SmoothFunction(ca.vertcat(still, mass), ca.vertcat(q, v, x))
        self._moving = 2 * n + N  # variables on which θ̈ depends
        straight = self._mass_and_load(np.zeros(self._moving))[0]
        self.acceleration_to_angle = straight / Layout(parameters).stiffness[:, None]

    @functools.cached_property
    def pattern(self) -> np.ndarray:
        n, heat = self.num_joints, self._wires.heat
        pattern = np.zeros((n + heat.num_values, 2 * n + heat.num_variables), bool)
        pattern[:n, : self._moving] = True
        rows, columns = heat.slope_places
        pattern[n + rows, 2 * n + columns] = True
        return pattern

    @functools.cached_property
    def curvature(self) -> np.ndarray:
        n, moving, P = self.num_joints, self._moving, self.pattern.shape[1]
        pattern = np.zeros((P, P), bool)
        rows, columns = self._with_acceleration.curvature_places
        own = (rows < moving) & (columns < moving)
        pattern[rows[own], columns[own]] = True
        with_acceleration = np.unique(columns[~own])
        pattern[with_acceleration, :moving] = True
        pattern[tuple(2 * n + self._wires.heat.curvature_places)] = True
        return pattern | pattern.T

    def values(self, points: np.ndarray) -> np.ndarray:
        """[θ̈, ẋ, V̇] (..., n + N + W)."""
        heat_rates = self._wires.heat.values(points[..., 2 * self.num_joints :])
        return np.concatenate([self.accelerations(points), heat_rates], axis=-1)

    def first(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`values`, and their derivatives by the points (..., n + N + W, P)."""
        n, moving = self.num_joints, self._moving
        accelerations, by_moving, _ = self._expanded(points)
        heat_rates, by_heat = self._wires.heat.first(points[..., 2 * n :])
        values = np.concatenate([accelerations, heat_rates], axis=-1)
        slopes = np.zeros((*values.shape, points.shape[-1]))
        slopes[..., :n, :moving] = by_moving
        slopes[..., n:, 2 * n :] = by_heat
        return values, slopes

    def second(self, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · `values` by the points (..., P, P)."""
        n, moving = self.num_joints, self._moving
        accelerations, by_moving, mobility = self._expanded(points)
        adjoint = -(mobility @ weights[..., :n, None])[..., 0]
        point = np.concatenate([points[..., :moving], accelerations], axis=-1)
        curved = self._with_acceleration.second(point, adjoint)
        own, mixed = curved[..., :moving, :moving], curved[..., :moving, moving:] @ by_moving
        result = np.zeros((*points.shape, points.shape[-1]))
        result[..., :moving, :moving] = own + mixed + mixed.swapaxes(-1, -2)
        heat = slice(2 * n, None)
        result[..., heat, heat] += self._wires.heat.second(points[..., heat], weights[..., n:])
        return result

    def second_by_heat(self, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · `values` by [x, V, D] alone (..., P - 2n, P - 2n)."""
        n, N = self.num_joints, self._wires.num_states
        angles, _, heat = np.split(points, [n, 2 * n], axis=-1)
        result = self._wires.heat.second(heat, weights[..., n:])
        mass, _ = self._mass_and_load(points[..., : self._moving])
        on_force = np.linalg.solve(mass, weights[..., :n, None])[..., 0]
        result[..., :N, :N] += self._force.second(heat[..., :N], on_force, angles)
        return result

    def accelerations(self, points: np.ndarray) -> np.ndarray:
        """θ̈ (..., n), rad/s²."""
        mass, load = self._mass_and_load(points[..., : self._moving])
        return -np.linalg.solve(mass, load[..., None])[..., 0]

    def _mass_and_load(self, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """M (..., n, n), and the residual without acceleration (..., n)."""
        values = self._motion.values(moving)
        load, mass = np.split(values, [self.num_joints], axis=-1)
        return mass.reshape(*load.shape, self.num_joints), load

    def _expanded(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """θ̈ (..., n), its derivatives by [θ, θ̇, x] (..., n, 2n + N), and M⁻¹ (..., n, n)."""
        moving = points[..., : self._moving]
        mass, load = self._mass_and_load(moving)
        mobility = np.linalg.inv(mass)
        accelerations = -(mobility @ load[..., None])[..., 0]
        _, slopes = self._residual.first(moving, accelerations)
        return accelerations, -mobility @ slopes, mobility
