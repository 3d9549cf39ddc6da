"""Static equilibria of the limb: K θ = f(T) + gravity, eqn (2) at rest."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.multibody.plant import MultibodyPlant_
from pydrake.multibody.tree import MultibodyForces_

from limb_systems.errors import LimbError
from limb_systems.model.manipulator import make_manipulator
from limb_systems.model.parameters import LimbParameters
from limb_systems.model.wires import Wires


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
