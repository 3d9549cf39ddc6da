"""What several tests share: an independent model, limbs to try, how errors must read."""

import numpy as np
import pytest

from limb_systems import LimbParameters, LinearLaw, SegmentParameters, WireParameters


class PlanarChain:
    """Lagrangian mechanics of the limb, derived by hand in absolute link angles.

    Link i is a homogeneous box: mass m_i, length l_i, thickness t_i, inertia
    I_i = m_i (l_i² + t_i²) / 12 about its centre. With the link angles
    q_i = θ_1 + ... + θ_i and e(q) = (cos q, sin q) the centre of link k is
    Σ_i c_ki e(q_i), where c_ki is l_i for i < k, l_k / 2 for i = k, else 0.
    With A_ij = Σ_k m_k c_ki c_kj the kinetic energy is
    ½ Σ_ij A_ij cos(q_i - q_j) q̇_i q̇_j + ½ Σ_i I_i q̇_i², and Lagrange gives

        Σ_j A_ij (cos(q_i - q_j) q̈_j + sin(q_i - q_j) q̇_j²) + I_i q̈_i = Q_i,
        Q_i = Σ_k m_k c_ki g · e'(q_i) + (torque on θ_i) - (torque on θ_i+1).
    """

    def __init__(self, parameters: LimbParameters):
        links = [segment for segment in parameters.segments for _ in range(segment.links)]
        self.mass = np.array([link.mass / link.links for link in links])
        self.length = np.array([link.length / link.links for link in links])
        thickness = np.array([link.thickness for link in links])
        self.inertia = self.mass * (self.length**2 + thickness**2) / 12
        self.stiffness = np.array([link.stiffness for link in links])
        self.damping = np.array([link.damping for link in links])
        self.gravity = np.array(parameters.gravity[:2])
        n = len(links)
        self.arms = np.tril(np.tile(self.length, (n, 1)), -1) + np.diag(self.length / 2)

    def acceleration(self, angles, rates, force) -> np.ndarray:
        """θ̈ under generalized forces, springs, damping and gravity."""
        q, q_dot = np.cumsum(angles), np.cumsum(rates)
        coupling = self.arms.T @ np.diag(self.mass) @ self.arms
        difference = q[:, None] - q
        inertia = coupling * np.cos(difference) + np.diag(self.inertia)
        centrifugal = coupling * np.sin(difference) @ q_dot**2
        torque = force - self.stiffness * angles - self.damping * rates
        on_links = torque - np.append(torque[1:], 0.0)
        q_ddot = np.linalg.solve(inertia, self.weight(q) + on_links - centrifugal)
        return np.diff(q_ddot, prepend=0.0)

    def weight(self, q) -> np.ndarray:
        """Generalized force of gravity on the link angles."""
        normal = np.array([-np.sin(q), np.cos(q)])
        return (self.mass @ self.arms) * (self.gravity @ normal)

    def holding_torque(self, angles) -> np.ndarray:
        """Generalized force on the joints that holds the limb at rest."""
        weight = self.weight(np.cumsum(angles))
        return self.stiffness * angles - np.cumsum(weight[::-1])[::-1]

    def potential_energy(self, angles) -> float:
        q = np.cumsum(angles)
        centers = self.arms @ np.column_stack([np.cos(q), np.sin(q)])
        return self.stiffness @ angles**2 / 2 - self.mass @ centers @ self.gravity


@pytest.fixture(scope="session")
def planar_chain():
    """The independent model, to be made from parameters."""
    return PlanarChain


@pytest.fixture
def uneven_limb() -> LimbParameters:
    """A limb of two segments and four wires, none like another."""

    def segment(left, right, **fields) -> SegmentParameters:
        wires = [
            WireParameters(name, e2, law=LinearLaw(*law))
            for name, e2, law in (("left", -0.003, left), ("right", 0.003, right))
        ]
        return SegmentParameters(wires=wires, **fields)

    base = {"links": 3, "length": 0.09, "mass": 0.03, "width": 0.03, "thickness": 0.012}
    tip = {"links": 2, "length": 0.05, "mass": 0.01, "width": 0.02, "thickness": 0.008}
    base |= {"stiffness": 0.2, "damping": 1.5e-3}
    tip |= {"stiffness": 0.1, "damping": 0.7e-3}
    first = segment((-0.05, 15.0, -0.8, 3.0e-4), (-0.09, 25.0, -1.3, 6.0e-4), **base)
    second = segment((-0.11, 30.0, -2.0, 2.0e-4), (-0.06, 18.0, -0.5, 1.0e-4), **tip)
    return LimbParameters(segments=[first, second], ambient_temperature=22.0)
