"""A Kirchhoff rod in space, solved as a boundary-value problem: what chains of links approximate.

The textbook's equations (Antman, Nonlinear Problems of Elasticity, ch. VIII), none of which the
package uses. An inextensible, unshearable rod has a centre line r(s) and a frame R(s) = [d1 d2 d3]
with the tangent d1; it is clamped at s = 0, where R = 1, and carries a dead weight per length and a
dead force at its tip:

    r' = d1,    R' = R [u]x,    n' = -weight,    m' = -d1 x n,    n(L) = payload,    m(L) = 0,

with the force n and the moment m that the part beyond s exerts on the part before. Elastic moments
balance m and what wires along the rod exert, a moment w that is constant in the material frame:

    diag(GJ, EI, EI) u = R^T m + w.

Frames are unit quaternions, q' = q (0, u) / 2, which keep their length by these equations.
"""

import dataclasses

import numpy as np
from scipy.integrate import solve_bvp

FORWARD = np.array([1.0, 0.0, 0.0])  # E1, the axis of the straight rod


@dataclasses.dataclass(frozen=True)
class Rod:
    """A rod that is equally stiff about all axes across it, its loads and its wires.

    - ``length``: L, m.
    - ``bending``, ``torsional``: EI and GJ, N·m².
    - ``weight``: force per length, N/m (3,).
    - ``payload``: force at the tip, N (3,).
    - ``towards_e2``, ``towards_e3``: moment of the wires that bends towards E2 and E3, N·m.
    """

    length: float = 1.0
    bending: float = 1.0
    torsional: float = 2 / 3
    weight: tuple[float, float, float] = (0.0, 0.0, 0.0)
    payload: tuple[float, float, float] = (0.0, 0.0, 0.0)
    towards_e2: float = 0.0
    towards_e3: float = 0.0

    def tip(self, steps: int = 4) -> "Tip":
        """The tip at rest, with loads and wires put on in steps, from the straight rod.

        Raises:
            RuntimeError: if there is no solution within 1e-8.
        """
        s = np.linspace(0.0, self.length, 41)
        y = np.zeros((10, len(s)))  # r, q, m
        y[0], y[3] = s, 1.0
        for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
            actual = solve_bvp(
                lambda s, y, share=share: self._slopes(s, y, share),
                lambda base, tip: np.concatenate([base[:7] - (0, 0, 0, 1, 0, 0, 0), tip[7:]]),
                s,
                y,
                tol=1e-8,
                max_nodes=20_000,
            )
            if not actual.success:
                raise RuntimeError(actual.message)
            s, y = actual.x, actual.y
        return Tip(y[:3, -1], _turned(y[3:7, -1:], FORWARD)[:, 0])

    def _slopes(self, s: np.ndarray, y: np.ndarray, share: float) -> np.ndarray:
        """Derivatives by s of [r, q, m] (10, K), under a share of loads and wires."""
        quaternion, moment = y[3:7], y[7:]
        beyond = np.outer(self.weight, self.length - s) + np.array(self.payload)[:, None]
        wires = share * np.array([[0.0], [-self.towards_e3], [self.towards_e2]])
        stiffness = np.array([[self.torsional], [self.bending], [self.bending]])
        back = quaternion * np.array([[1.0], [-1.0], [-1.0], [-1.0]])
        curvature = (_turned(back, moment) + wires) / stiffness
        tangent = _turned(quaternion, FORWARD)
        return np.concatenate(
            [
                tangent,
                _product(quaternion, np.insert(curvature, 0, 0.0, axis=0)) / 2,
                -share * np.cross(tangent, beyond, axis=0),
            ]
        )


@dataclasses.dataclass(frozen=True)
class Tip:
    """The tip of a rod at rest: its position, m, and the direction of the tangent there (3,)."""

    position: np.ndarray
    tangent: np.ndarray

    @property
    def bend(self) -> np.ndarray:
        """Angle of the chord with E1, rad, times its direction in (E2, E3), (2,)."""
        sideways = np.hypot(*self.position[1:])
        angle = np.arctan2(sideways, self.position[0])
        return angle * self.position[1:] / max(sideways, 1e-300)


def _product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Products of quaternions (4, K)."""
    vectors = p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:], axis=0)
    return np.insert(vectors, 0, p[0] * q[0] - (p[1:] * q[1:]).sum(axis=0), axis=0)


def _turned(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors (3, K) or (3,), turned by quaternions (4, K)."""
    scalar, axis = quaternion[0], quaternion[1:]
    vector = np.broadcast_to(vector.reshape(3, -1), axis.shape)
    twice = 2 * np.cross(axis, vector, axis=0)
    return vector + scalar * twice + np.cross(axis, twice, axis=0)
