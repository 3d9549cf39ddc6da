"""Joint accelerations and their derivatives, for many states at once.

`Mechanics` is what the transcription asks of a limb; `PlanarChain` is that of
eqn (2), in closed form. All of its constants are read from the `MultibodyPlant`,
and a program compares the
accelerations with those of its `Limb` before it uses them.

In absolute link angles φ = L θ (L lower triangular, all ones) the kinetic
energy of any serial chain in a plane depends on differences of angles only,

    M_ij(φ) = C_ij cos(φi - φj) + S_ij sin(φi - φj),   C symmetric, S skew,

so two mass matrices of the plant give C and S. The potential of gravity is
linear in cos φi and sin φi, so two gravity loads give its coefficients. The
equations of motion are

    M φ̈ + H φ̇² = Q,   H_ij = C_ij sin(φi - φj) - S_ij cos(φi - φj),

with the generalized force Q of springs, damping, gravity and wires.
"""

from typing import Protocol

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ForceElementIndex, RevoluteJoint, RevoluteSpring


class Mechanics(Protocol):
    """Accelerations θ̈ of n joints under generalized forces, and their derivatives, at K states.

    - ``num_joints``: n.
    - ``stiffness``: springs of the joints (n,), N·m/rad.
    - ``straight_mass_matrix``: M(0) (n, n), kg·m²; with the stiffness it scales the accelerations.
    """

    num_joints: int
    stiffness: np.ndarray
    straight_mass_matrix: np.ndarray

    def accelerations(
        self, angles: np.ndarray, rates: np.ndarray, forces: np.ndarray
    ) -> np.ndarray:
        """θ̈ (K, n) for θ, θ̇ and generalized forces f, each (K, n)."""

    def derivatives(
        self, angles: np.ndarray, rates: np.ndarray, forces: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """θ̈ (K, n) and its derivatives by θ, θ̇ and f, each (K, n, n)."""

    def mobilities(self, angles: np.ndarray) -> np.ndarray:
        """Derivatives of θ̈ by f, which only depend on θ (K, n): symmetric, (K, n, n)."""


class PlanarChain:
    """Accelerations θ̈ of eqn (2) and their derivatives, vectorised over K states.

    - ``num_joints``: n.
    - ``stiffness``, ``damping``: springs and dampers of the joints (n,), N·m/rad and N·m·s/rad.
    - ``straight_mass_matrix``: M(0) in joint angles (n, n), kg·m².

    Args:
        plant: finalized; a serial chain of revolute joints about one axis,
            each with a `RevoluteSpring` and linear damping.
    """

    def __init__(self, plant: MultibodyPlant):
        n = self.num_joints = plant.num_positions()
        self._E = np.eye(n) - np.eye(n, k=-1)  # θ = E φ
        self._L = np.tri(n)  # φ = L θ
        context = plant.CreateDefaultContext()

        def mass_matrix(joint_angles):
            plant.SetPositions(context, joint_angles)
            return plant.CalcMassMatrixViaInverseDynamics(context)

        def gravity_load(joint_angles):
            plant.SetPositions(context, joint_angles)
            return self._E.T @ plant.CalcGravityGeneralizedForces(context)

        self.straight_mass_matrix = mass_matrix(np.zeros(n))
        self._C = self._E.T @ self.straight_mass_matrix @ self._E
        knee = np.pi / (n + 1)  # no sine of a multiple below n vanishes
        angles = knee * np.arange(n)
        difference = angles[:, None] - angles
        bent = self._E.T @ mass_matrix(np.full(n, knee)) @ self._E
        self._S = (bent - self._C * np.cos(difference)) / (np.sin(difference) + np.eye(n))
        np.fill_diagonal(self._S, 0.0)
        self._gravity_cos = gravity_load(np.zeros(n))
        self._gravity_sin = gravity_load(np.pi / 2 * np.eye(n)[0])

        self.stiffness, self.damping, self._spring_load = np.zeros((3, n))
        for index in range(plant.num_force_elements()):
            spring = plant.get_force_element(ForceElementIndex(index))
            if isinstance(spring, RevoluteSpring):
                joint, stiffness = spring.joint().position_start(), spring.default_stiffness()
                self.stiffness[joint] += stiffness
                self._spring_load[joint] += stiffness * spring.default_nominal_angle()
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            if isinstance(joint, RevoluteJoint):
                self.damping[joint.velocity_start()] = joint.default_damping()

    def accelerations(
        self, angles: np.ndarray, rates: np.ndarray, forces: np.ndarray
    ) -> np.ndarray:
        """θ̈ (K, n) for θ, θ̇ and generalized forces f, each (K, n)."""
        load, _, _, mass, _ = self._loads(angles, rates, forces)
        return np.linalg.solve(mass, load[:, :, None])[:, :, 0] @ self._E.T

    def derivatives(
        self, angles: np.ndarray, rates: np.ndarray, forces: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """θ̈ (K, n) and its derivatives by θ, θ̇ and f, each (K, n, n)."""
        load, links, link_rates, mass, H = self._loads(angles, rates, forces)
        inverse_mass = np.linalg.inv(mass)
        accelerations = (inverse_mass @ load[:, :, None])[:, :, 0]
        # M φ̈ = Q - H φ̇², differentiated by φ at fixed φ̈. M and H have no
        # φ-dependence on their diagonals.
        moving_mass = mass * (1 - np.eye(self.num_joints))
        by_angle = _differences(moving_mass, link_rates**2) - _differences(H, accelerations)
        by_angle -= self._E.T @ np.diag(self.stiffness) @ self._E
        diagonal = np.arange(self.num_joints)
        by_angle[:, diagonal, diagonal] += self._gravity_sin * np.cos(
            links
        ) - self._gravity_cos * np.sin(links)
        by_rate = -2 * H * link_rates[:, None, :] - self._E.T @ np.diag(self.damping) @ self._E

        inverse = self._E @ inverse_mass
        return (
            accelerations @ self._E.T,
            inverse @ by_angle @ self._L,
            inverse @ by_rate @ self._L,
            inverse @ self._E.T,
        )

    def mobilities(self, angles: np.ndarray) -> np.ndarray:
        """The derivative of θ̈ by f, which only depends on θ (K, n): symmetric, (K, n, n)."""
        return self._E @ np.linalg.inv(self._mass(angles @ self._L.T)[0]) @ self._E.T

    def _mass(self, links):
        """M and H (K, n, n) at φ (K, n)."""
        difference = links[:, :, None] - links[:, None, :]
        cosine, sine = np.cos(difference), np.sin(difference)
        return self._C * cosine + self._S * sine, self._C * sine - self._S * cosine

    def _loads(self, angles, rates, forces):
        """M φ̈, φ, φ̇ (K, n), M and H (K, n, n)."""
        links, link_rates = angles @ self._L.T, rates @ self._L.T
        mass, H = self._mass(links)
        torques = forces + self._spring_load - self.stiffness * angles - self.damping * rates
        load = torques @ self._E
        load += self._gravity_cos * np.cos(links) + self._gravity_sin * np.sin(links)
        load -= np.einsum("kij,kj->ki", H, link_rates**2)
        return load, links, link_rates, mass, H


def _differences(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """∂/∂φ_m of Σ_j F_ij(φi - φj) v_j for -F' = `matrix`: (K, n, n)."""
    result = matrix * vector[:, None, :]
    diagonal = np.arange(matrix.shape[1])
    result[:, diagonal, diagonal] -= result.sum(axis=2)
    return result
