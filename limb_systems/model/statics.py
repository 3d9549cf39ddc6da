"""Static equilibria of the limb: K θ = f(T) + gravity, eqn (2) at rest."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.errors import LimbError
from limb_systems.model.chain import Chain
from limb_systems.model.chain_stiffness import ChainStiffness
from limb_systems.model.kinematics import rest_joint_angles
from limb_systems.model.layout import Layout
from limb_systems.model.parameters import LimbParameters
from limb_systems.model.wires import Wires

NEWTON_STEPS = 50
CONVERGED = 1e-12  # rad; the derivatives there are as exact
FOLDED = np.deg2rad(100.0)  # of a chord; with that, a limb hangs from a fold


def static_equilibrium(
    parameters: LimbParameters, wire_temperature: ArrayLike | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles at rest, and their compliance to generalized forces.

    Args:
        wire_temperature: T (W,), °C, held until the limb has settled; ambient if None.

    Returns:
        θ (n,), rad, and the compliance ∂θ/∂f (n, n), rad/(N·m).

    Raises:
        LimbError: if Newton's method finds no stable equilibrium, for example
            because gravity folds the limb.
    """
    ambient = np.full(len(parameters.wires), parameters.ambient_temperature)
    wire = ambient if wire_temperature is None else np.asarray(wire_temperature, float)
    if wire.shape != ambient.shape or not np.isfinite(wire).all():
        raise LimbError(
            f"wire_temperature is {wire.tolist()}; it must be {ambient.size} finite numbers, "
            "one for each wire."
        )
    balance = _Balance(parameters)
    joints = np.eye(parameters.num_joints)
    angles, stiffness = balance.settled(balance.wires.settled_states(wire), 0.0 * joints[0])
    return angles, stiffness.solve(joints)


class HeldAngles:
    """Joint angles θ and bends φ(θ) that wires hold at rest, K (θ - θ_0) + ∇V(θ) = f(x, θ).

    K are the springs of (2), which rest at θ_0, V is the potential of gravity and f the force of
    the wires and of what stiffens, (4). The equilibrium is exact. Where V and f are no
    functions of θ, θ is linear in f. Arrays have any number of points before their last axis.

    The equilibria of the last states are kept, so that values, slopes and curvature at the same
    states take one solution. All methods raise LimbError where the limb has no stable equilibrium.

    - ``rest_angles``: θ (n,), rad, with wires that were never heated.
    - ``compliance``: ∂θ/∂f (n, n) there, rad/(N·m).
    - ``wires``, ``chain``: the limb's `Wires`, and its `Chain`.

    Args:
        parameters: description of the limb.
    """

    def __init__(self, parameters: LimbParameters):
        self._balance = _Balance(parameters)
        self.wires, self.chain = self._balance.wires, self._balance.chain
        self.rest_angles, self.compliance = static_equilibrium(parameters)
        self._cold = self.wires.forces(self.wires.cold_states, self.rest_angles)
        self._states = self._angles = np.empty(0)
        self._by_force: Callable[[np.ndarray], np.ndarray] = self.compliance.__matmul__

    def angles(self, states: np.ndarray) -> np.ndarray:
        """θ (..., n), rad, at states x (..., N) of the wires."""
        if not self._balance.is_linear and np.array_equal(self._states, states):
            return self._angles
        at_rest = np.broadcast_to(self.rest_angles, (*states.shape[:-1], len(self.rest_angles)))
        angles = at_rest + (self.wires.forces(states, at_rest) - self._cold) @ self.compliance.T
        if self._balance.is_linear:
            return angles
        self._angles, stiffness = self._balance.settled(states, angles)
        self._states, self._by_force = states.copy(), stiffness.solve
        return self._angles

    def expanded(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`angles` θ (..., n), and their derivatives by the states (..., n, N)."""
        angles = self.angles(states)
        by_state, _ = self.wires.force_derivatives(states, angles)
        slopes = self._by_force(by_state)
        return angles, np.broadcast_to(slopes, (*angles.shape, states.shape[-1]))

    def bends(self, states: np.ndarray) -> np.ndarray:
        """φ (..., F), rad, of the equilibria at states x (..., N)."""
        return self.chain.bends(self.angles(states))

    def expanded_bends(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`bends` φ (..., F), and their derivatives by the states (..., F, N)."""
        angles, slopes = self.expanded(states)
        bends, by_angle = self.chain.expanded_bends(angles)
        return bends, by_angle @ slopes

    def bend_curvature(self, states: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · φ by the states (..., N, N), for weights (..., F).

        They are those of φ(θ) less those of r = K (θ - θ_0) + ∇V - f, weighted with the adjoint λ,
        along θ_x. How torques of laws bend with angles is left out.
        """
        angles, slopes = self.expanded(states)
        _, by_angle = self.chain.expanded_bends(angles)
        adjoint = self._by_force(by_angle.swapaxes(-1, -2) @ weights[..., None])[..., 0]
        curvature = self.chain.bend_curvature(angles, weights)
        if self.chain.weighs:
            curvature -= self.chain.gravity_curvature(angles, adjoint)
        if self.wires.torque_needs_angle:
            curvature += self.wires.force_hessian_by_angle(angles, adjoint)
        along = slopes.swapaxes(-1, -2) @ curvature @ slopes
        return along + self.wires.force_hessian(states, angles, adjoint)


def mean_bend_by_temperature(
    parameters: LimbParameters, bend: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Each bend by each wire's T (F, W), rad/°C, on average from T_warm to T_max.

    It is zero for the wires of other segments, by whose bend gravity bends a segment, too.

    Args:
        bend: bend angles (F,), rad, that wires at T (W,), °C, hold; those that do not
            get warmer are at T_warm.
    """
    limits, wires = parameters.temperature_limits, np.eye(len(parameters.wires))
    rise = limits.maximum - limits.warm
    warm = bend(np.full(len(wires), limits.warm))
    slopes = np.transpose([(bend(limits.warm + rise * hot) - warm) / rise for hot in wires])
    layout = Layout(parameters)
    own = [wires[layout.wires_of[segment]].sum(axis=0) for segment in layout.bend_segment]
    return slopes * own


class _Balance:
    """Forces on the joints of a limb at rest, r(x, θ) = K (θ - θ_0) + ∇V(θ) - f(x, θ).

    - ``is_linear``: whether r is linear in θ, with K.
    """

    def __init__(self, parameters: LimbParameters):
        self.wires = Wires(parameters)
        layout = Layout(parameters)
        self.chain = Chain(layout, parameters.gravity)
        self._springs, self._relaxed = layout.stiffness, rest_joint_angles(parameters)
        self.is_linear = not (self.chain.weighs or self.wires.torque_needs_angle)

    def settled(self, states: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, "_Stiffness"]:
        """θ (..., n) where r = 0 at states (..., N), and the stiffness there.

        Newton's method may miss the rest of a limb that is heavy for its springs. Steps that
        go downhill do not, but may end with a limb that hangs from a fold.

        Args:
            start: angles to start from (..., n).

        Raises:
            LimbError: if there is no stable equilibrium, or gravity folds a segment.
        """
        try:
            return self._newton(states, start)
        except LimbError:
            angles, stiffness = self._newton(states, start, downhill=True)
        folded = (np.abs(self.chain.bends(angles)) > FOLDED).any(axis=-1)
        if folded.any():
            raise LimbError(f"Gravity folds the limb{_where(folded)}; is it too soft?")
        return angles, stiffness

    def _newton(
        self, states: np.ndarray, start: np.ndarray, downhill: bool = False
    ) -> tuple[np.ndarray, "_Stiffness"]:
        angles = start
        for _ in range(NEWTON_STEPS):
            force, stiffness = self._expanded(states, angles)
            step = stiffness.solve(force[..., None], downhill)[..., 0]
            largest = np.abs(step).max(axis=-1, keepdims=True)
            # No step is so long that a joint turns over, nor, downhill, that the slope turns.
            angles = angles + step / np.maximum(1.0, largest / (0.2 if downhill else 1.0))
            if (largest < CONVERGED).all():
                break
        else:
            raise LimbError(
                f"There is no static equilibrium that Newton's method finds"
                f"{_where(largest[..., 0] >= CONVERGED)}; is the limb too soft?"
            )
        unstable = ~np.asarray(stiffness.is_stable)
        if unstable.any():
            raise LimbError(
                f"The limb's equilibrium{_where(unstable)} is unstable: gravity folds it; is it "
                "too soft?"
            )
        return angles, stiffness

    def _expanded(self, states: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, "_Stiffness"]:
        """-r (..., n), N·m, and the derivatives of r by θ."""
        force = self.wires.forces(states, angles) - self._springs * (angles - self._relaxed)
        _, by_angle = self.wires.force_derivatives(states, angles)
        if by_angle is not None and not self.chain.weighs:
            return force, _Matrix(np.diag(self._springs) - by_angle)
        load, stiffness = self.chain.held(angles, self._springs)
        if by_angle is None:
            return force - load, stiffness
        return force - load, _Matrix(stiffness.matrix() - by_angle)


class _Matrix:
    """A symmetric stiffness (..., n, n), as a `ChainStiffness`."""

    def __init__(self, matrix: np.ndarray):
        self._matrix = matrix

    @property
    def is_stable(self) -> np.ndarray:
        return np.linalg.eigvalsh(self._matrix)[..., 0] > 0

    def solve(self, forces: np.ndarray, downhill: bool = False) -> np.ndarray:
        if not downhill or self.is_stable.all():
            return np.linalg.solve(self._matrix, forces)
        values, axes = np.linalg.eigh(self._matrix)
        return axes @ ((axes.swapaxes(-1, -2) @ forces) / np.abs(values)[..., None])


_Stiffness = ChainStiffness | _Matrix


def _where(refused: np.ndarray) -> str:
    """Says which of several points is refused."""
    if not refused.ndim:
        return ""
    return f" at point {int(np.argmax(refused))} of {refused.size} ({int(refused.sum())} in all)"
