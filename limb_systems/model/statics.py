"""Static equilibria of the limb: K θ = f(T) + gravity, eqn (2) at rest."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.errors import LimbError
from limb_systems.model.chain import Chain
from limb_systems.model.kinematics import rest_joint_angles
from limb_systems.model.layout import Layout
from limb_systems.model.parameters import LimbParameters
from limb_systems.model.wires import Wires

NEWTON_STEPS = 50
CONVERGED = 1e-12  # rad
SHRINKS = 0.01  # of the step before; steps that shrink less take the stiffness anew


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
    states = balance.wires.settled_states(wire)
    straight = np.zeros(parameters.num_joints)
    return balance.settled(states, straight, np.diag(1.0 / balance.springs))


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
        self._last = (np.empty(0), np.empty(0), np.empty(0))

    def angles(self, states: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
        """θ (..., n), rad, at states x (..., N) of the wires.

        Args:
            start: angles (..., n) that are near, such as those at states that were near.
        """
        return self._settled(states, start)[0]

    def expanded(
        self, states: np.ndarray, start: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """`angles` θ (..., n), and their derivatives by the states (..., n, N)."""
        angles, compliance = self._settled(states, start)
        by_state, _ = self.wires.force_derivatives(states, angles)
        return angles, np.broadcast_to(compliance @ by_state, (*angles.shape, states.shape[-1]))

    def curvature(self, states: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · θ by the states (..., N, N), for weights (..., n)."""
        return self._curvature(states, weights, 0.0)

    def bends(self, states: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
        """φ (..., F), rad, of the equilibria at states x (..., N); `start` as of `angles`."""
        return self.chain.bends(self.angles(states, start))

    def expanded_bends(
        self, states: np.ndarray, start: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """`bends` φ (..., F), and their derivatives by the states (..., F, N)."""
        angles, slopes = self.expanded(states, start)
        bends, by_angle = self.chain.expanded_bends(angles)
        return bends, by_angle @ slopes

    def bend_curvature(self, states: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · φ by the states (..., N, N), for weights (..., F)."""
        angles = self.angles(states)
        _, by_angle = self.chain.expanded_bends(angles)
        on_angles = (weights[..., None, :] @ by_angle)[..., 0, :]
        return self._curvature(states, on_angles, self.chain.bend_curvature(angles, weights))

    def _settled(
        self, states: np.ndarray, start: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """θ (..., n), and ∂θ/∂f (..., n, n) there."""
        last_states, last_angles, compliance = self._last
        if np.array_equal(last_states, states):
            return last_angles, compliance
        if start is None or last_angles.shape != start.shape:
            compliance = self.compliance
        if start is None or self._balance.is_linear:
            at_rest = np.broadcast_to(self.rest_angles, (*states.shape[:-1], len(self.rest_angles)))
            turned = (self.wires.forces(states, at_rest) - self._cold) @ self.compliance.T
            start = at_rest + turned
        if self._balance.is_linear:
            return start, self.compliance
        self._last = (states.copy(), *self._balance.settled(states, start, compliance))
        return self._last[1:]

    def _curvature(
        self, states: np.ndarray, weights: np.ndarray, bent: np.ndarray | float
    ) -> np.ndarray:
        """Second derivatives by the states of weights · θ + θ_x · bent · θ_x / 2.

        Those of r = K (θ - θ_0) + ∇V - f, weighted with the adjoint λ, are put on θ_x.
        """
        angles, compliance = self._settled(states)
        adjoint = (weights[..., None, :] @ compliance)[..., 0, :]
        if self.chain.weighs:
            bent = bent - self.chain.gravity_curvature(angles, adjoint)
        result = self.wires.force_hessian(states, angles, adjoint)
        if isinstance(bent, float):
            return result
        _, slopes = self.expanded(states)
        return result + slopes.swapaxes(-1, -2) @ bent @ slopes


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
        self.springs, self._relaxed = layout.stiffness, rest_joint_angles(parameters)
        self.is_linear = not (self.chain.weighs or self.wires.torque_needs_angle)

    def settled(
        self, states: np.ndarray, start: np.ndarray, compliance: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """θ (..., n) where r = 0 at states (..., N), and ∂θ/∂f (..., n, n), by Newton's method.

        Args:
            start, compliance: about what they are.

        Raises:
            LimbError: if there is no stable equilibrium.
        """
        angles, before, chord = start, np.inf, True
        for _ in range(NEWTON_STEPS):
            force = self._force(states, angles)[..., None]
            if chord:
                step = compliance @ force
            else:
                step = np.linalg.solve(self._stiffness(states, angles), force)
            largest = np.abs(step).max(axis=-2)
            # Steps of at most one radian per joint, so that no joint turns over.
            angles = angles + step[..., 0] / np.maximum(1.0, largest)
            if (largest < CONVERGED).all():
                break
            chord = chord and largest.max() < SHRINKS * before
            before = largest.max()
        else:
            raise LimbError(
                f"There is no static equilibrium that Newton's method finds"
                f"{_where(largest[..., 0] >= CONVERGED)}; is the limb too soft?"
            )
        stiffness = self._stiffness(states, angles)
        try:
            np.linalg.cholesky(stiffness)
        except np.linalg.LinAlgError as error:
            unstable = np.linalg.eigvalsh(stiffness)[..., 0] <= 0
            raise LimbError(
                f"The limb's equilibrium{_where(unstable)} is unstable: gravity folds it; is it "
                "too soft?"
            ) from error
        return angles, np.linalg.inv(stiffness)

    def _force(self, states: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """-r (..., n), N·m."""
        force = self.wires.forces(states, angles) - self.springs * (angles - self._relaxed)
        return force - self.chain.gravity_load(angles) if self.chain.weighs else force

    def _stiffness(self, states: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Derivatives of r by θ (..., n, n), N·m/rad."""
        stiffness = np.diag(self.springs)
        _, by_angle = self.wires.force_derivatives(states, angles)
        if by_angle is not None:
            stiffness = stiffness - by_angle
        return stiffness + self.chain.gravity_stiffness(angles) if self.chain.weighs else stiffness


def _where(refused: np.ndarray) -> str:
    """Says which of several points is refused."""
    if not refused.ndim:
        return ""
    return f" at point {int(np.argmax(refused))} of {refused.size} ({int(refused.sum())} in all)"
