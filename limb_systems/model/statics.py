"""Static equilibria of the limb: K θ = f(T) + gravity, eqn (2) at rest."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.multibody.plant import MultibodyPlant_
from pydrake.multibody.tree import MultibodyForces_

from limb_systems.errors import LimbError
from limb_systems.model.manipulator import make_manipulator
from limb_systems.model.parameters import LimbParameters
from limb_systems.model.wires import Wires

NEWTON_STEPS = 2  # of angles that torques depend on


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
    wires = Wires(parameters)
    states = wires.settled_states(wire)
    plant = make_manipulator(parameters).ToAutoDiffXd()
    angles = np.zeros(parameters.num_joints)
    for _ in range(50):
        load, stiffness = _spring_and_gravity(plant, angles)
        force, (_, by_angle) = wires.forces(states, angles), wires.force_derivatives(states, angles)
        if by_angle is not None:
            stiffness = stiffness - np.diag(by_angle)
        step = np.linalg.solve(stiffness, force - load)
        # Steps of at most one radian per joint, so that no joint turns over.
        angles = angles + step / max(1.0, np.abs(step).max())
        if np.abs(step).max() < 1e-12:
            break
    else:
        raise LimbError(
            "There is no static equilibrium that Newton's method finds; is the limb too soft?"
        )
    if np.linalg.eigvalsh((stiffness + stiffness.T) / 2).min() <= 0:
        raise LimbError("The limb's equilibrium is unstable: gravity folds it; is it too soft?")
    return angles, np.linalg.inv(stiffness)


class HeldAngles:
    """Joint angles that wires hold at rest, θ = θ_rest + K⁻¹ (f(x, θ) - f(x_cold, θ_rest)).

    K, with gravity, is that of the limb at rest with cold wires, from which wires bend it by
    (2) and (4). Arrays have any number of points before their last axis.

    - ``rest_angles``: θ_rest (n,), rad.
    - ``compliance``: K⁻¹ (n, n), rad/(N·m).
    - ``wires``: the limb's `Wires`.

    Args:
        parameters: description of the limb.
    """

    def __init__(self, parameters: LimbParameters):
        self.wires = Wires(parameters)
        self.rest_angles, self.compliance = static_equilibrium(parameters)
        self._cold = self.wires.forces(self.wires.cold_states, self.rest_angles)

    def angles(self, states: np.ndarray) -> np.ndarray:
        """θ (..., n), rad, at states x (..., N) of the wires."""
        at_rest = np.broadcast_to(self.rest_angles, (*states.shape[:-1], len(self.rest_angles)))
        angles = at_rest + self._turned(states, at_rest)
        if self.wires.torque_needs_angle:
            for _ in range(NEWTON_STEPS):  # torque changes little with its joint's angle
                missed = at_rest + self._turned(states, angles) - angles
                _, by_angle = self.wires.force_derivatives(states, angles)
                assert by_angle is not None
                step = np.linalg.solve(self._stiffness(by_angle), missed[..., None])
                angles = angles + step[..., 0]
        return angles

    def expanded(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """θ (..., n), and its derivatives by the states (..., n, N)."""
        angles = self.angles(states)
        by_state, by_angle = self.wires.force_derivatives(states, angles)
        slopes = self.compliance @ by_state
        if by_angle is not None:
            slopes = np.linalg.solve(self._stiffness(by_angle), slopes)
        return angles, np.broadcast_to(slopes, (*angles.shape, states.shape[-1]))

    def curvature(self, states: np.ndarray, angles: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · θ by the states (..., N, N), but for what stiffens.

        Args:
            states, angles: x (..., N), and their θ (..., n).
            weights: (..., n).
        """
        _, by_angle = self.wires.force_derivatives(states, angles)
        if by_angle is not None:
            stiffness = self._stiffness(by_angle).swapaxes(-1, -2)
            weights = np.linalg.solve(stiffness, weights[..., None])[..., 0]
        return self.wires.force_hessian(states, angles, weights @ self.compliance)

    def _turned(self, states: np.ndarray, angles: np.ndarray) -> np.ndarray:
        return (self.wires.forces(states, angles) - self._cold) @ self.compliance.T

    def _stiffness(self, force_by_angle: np.ndarray) -> np.ndarray:
        """How much stiffer than K the joints are whose torques depend on their angles."""
        return np.eye(len(self.compliance)) - self.compliance * force_by_angle[..., None, :]


def mean_bend_by_temperature(
    parameters: LimbParameters, bend: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Bend of each segment by each wire's T (S, W), rad/°C, on average from T_warm to T_max.

    It is zero for the wires of other segments, by whose bend gravity bends a segment, too.

    Args:
        bend: bend of the segments (S,), rad, that wires at T (W,), °C, hold; those that do not
            get warmer are at T_warm.
    """
    limits, wires = parameters.temperature_limits, np.eye(len(parameters.wires))
    rise = limits.maximum - limits.warm
    warm = bend(np.full(len(wires), limits.warm))
    slopes = np.transpose([(bend(limits.warm + rise * hot) - warm) / rise for hot in wires])
    own = [wires[around].sum(axis=0) for around in parameters.wire_slices]
    return slopes * own


def _spring_and_gravity(
    plant: MultibodyPlant_[AutoDiffXd], angles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The generalized force that holds the limb at rest (n,), and its Jacobian."""
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, InitializeAutoDiff(angles)[:, 0])
    forces = MultibodyForces_[AutoDiffXd](plant)
    plant.CalcForceElementsContribution(context, forces)
    no_acceleration = np.full(len(angles), AutoDiffXd(0.0))
    load = plant.CalcInverseDynamics(context, no_acceleration, forces)
    return ExtractValue(load)[:, 0], ExtractGradient(load)
