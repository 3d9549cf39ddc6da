"""The equation of motion (2), stated once, and the accelerations that solve it."""

import functools

import casadi as ca
import numpy as np

from limb_systems.limb_mechanics import LimbMechanics
from limb_systems.smooth_function import SmoothFunction
from limb_systems.symbolic_chain import Chain
from limb_systems.wires import Wires


def equation_of_motion(
    mechanics: LimbMechanics,
    wires: Wires,
    angles: ca.SX,
    rates: ca.SX,
    accelerations: ca.SX,
    states: ca.SX,
) -> ca.SX:
    """Return the residual of (2) on each joint (n,), N·m, which is zero in every motion.

        M(θ) θ̈ + C(θ, θ̇) θ̇ + ∇V(θ) + σ θ̇ + K (θ - θ_0) - f(x, θ)

    The springs K rest at θ_0, V is the potential of gravity, and f is the force of the wires and
    of nonlinear rubber (4).

    Args:
        mechanics: joints and bodies of the limb.
        wires: the limb's wires.
        angles, rates, accelerations: θ, θ̇ and θ̈ (n,), rad, rad/s and rad/s².
        states: x (N,) of the wires.
    """
    gravity = ca.DM(mechanics.gravity)
    # Add up the terms of (2).
    inertia = Chain(mechanics, angles).inverse_dynamics(rates, accelerations, gravity)
    springs = ca.DM(mechanics.stiffness) * (angles - ca.DM(mechanics.rest_angles))
    damping = ca.DM(mechanics.damping) * rates
    return inertia + springs + damping - wires.symbolic_force(states, angles)


class Dynamics:
    """A limb's equation of motion, and the accelerations that solve it.

    Points are [θ, θ̇, x] (..., 2n + N), with any number of points before the last axis.

    - ``mechanics``, ``wires``: joints and bodies of the limb, and its wires.
    - ``num_joints``, ``num_states``: n and N.
    - ``residual``: the residual r (n,), N·m, of `equation_of_motion` as a CasADi function of θ, θ̇,
      x and θ̈.
    - ``by_state``, ``by_motion``: the same as a `SmoothFunction` of points and θ̈, and of
      [θ, θ̇, θ̈] and x.
    - ``at_rest``: the residual without motion, of [θ, x].
    - ``acceleration_to_angle``: K⁻¹ M(0) (n, n), s²: static deflections for accelerations.

    Args:
        mechanics: joints and bodies of the limb.
        wires: its wires.
    """

    def __init__(self, mechanics: LimbMechanics, wires: Wires):
        self.mechanics = mechanics
        self.wires = wires
        n = mechanics.layout.num_joints
        self.num_joints = n
        self.num_states = wires.num_states
        # State the residual in symbols.
        q = ca.SX.sym("q", n)
        v = ca.SX.sym("v", n)
        a = ca.SX.sym("a", n)
        x = ca.SX.sym("x", wires.num_states)
        residual = equation_of_motion(mechanics, wires, q, v, a, x)
        self.residual = ca.Function("residual", [q, v, x, a], [residual])
        self.by_state = SmoothFunction(residual, ca.vertcat(q, v, x), a)
        self.by_motion = SmoothFunction(residual, ca.vertcat(q, v, a), x)
        # Without motion it is the balance of forces.
        no_motion = ca.SX(n, 1)
        at_rest = self.residual(q, no_motion, x, no_motion)
        self.at_rest = SmoothFunction(at_rest, ca.vertcat(q, x))

    # What equilibria do without is stated when it is first used.
    @functools.cached_property
    def _mass_and_load(self) -> SmoothFunction:
        """The mass matrix and the load; the residual is linear in the accelerations."""
        q, v, x, a = self.residual.sx_in()
        load = self.residual(q, v, x, ca.SX(self.num_joints, 1))
        mass = ca.vec(ca.jacobian(self.residual(q, v, x, a), a))
        return SmoothFunction(ca.vertcat(load, mass), ca.vertcat(q, v, x))

    @functools.cached_property
    def acceleration_to_angle(self) -> np.ndarray:
        straight_mass, _ = self.mass_and_load(np.zeros(2 * self.num_joints + self.num_states))
        return straight_mass / self.mechanics.stiffness[:, None]

    def mass_and_load(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return M (..., n, n), kg·m², and the residual without acceleration (..., n), N·m."""
        values = self._mass_and_load.values(points)
        load, mass = np.split(values, [self.num_joints], axis=-1)
        return mass.reshape(*load.shape, self.num_joints), load

    def slow_slopes(self, points: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Return the slopes (..., n, 3n) of the residual by points [θ, θ̇, θ̈], in a slow motion.

        Stiffness and weight count, damping and mass, but not how inertial forces change with
        angles and rates.

        Args:
            points: [θ, θ̇, θ̈] (..., 3n).
            states: x (..., N).
        """
        n = self.num_joints
        angles = points[..., :n]
        _, stiffness = self.at_rest.first(np.concatenate([angles, states], axis=-1))
        mass, _ = self.mass_and_load(np.concatenate([points[..., : 2 * n], states], axis=-1))
        damping = np.broadcast_to(np.diag(self.mechanics.damping), mass.shape)
        return np.concatenate([stiffness[..., :n], damping, mass], axis=-1)

    def accelerations(self, points: np.ndarray) -> np.ndarray:
        """Return θ̈ (..., n), rad/s²."""
        mass, load = self.mass_and_load(points)
        return -np.linalg.solve(mass, load[..., None])[..., 0]
