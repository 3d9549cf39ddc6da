"""The stiffness of a chain of joints under gravity, whose every factor takes O(n)."""

import numpy as np


def nested(inboard: np.ndarray, outboard: np.ndarray) -> np.ndarray:
    """The symmetric matrix (..., n, n) whose element i inboard of j is inboard_i · outboard_j.

    Both are (components, n, ...).
    """
    result = np.moveaxis(inboard, (1, 0), (-2, -1)) @ np.moveaxis(outboard, (0, 1), (-2, -1))
    for joint in range(result.shape[-1] - 1):
        result[..., joint + 1 :, joint] = result[..., joint, joint + 1 :]
    return result


class ChainStiffness:
    """K + ∂²V/∂q² of the joints of a chain, in factors that take O(n).

    The second term is `nested` vectors p and h of the joints.
    From the tip on, what is outboard of a joint acts on it by one matrix M (3, 3), which
    makes u = h + M p, the pivot d = k + p · u, and M - u uᵀ/d for the joint before.

    - ``is_stable``: whether all pivots are positive, and with them the matrix (...).

    Args:
        springs: k (n,).
        inboard, outboard: p and h (3, n, ...).
    """

    def __init__(self, springs: np.ndarray, inboard: np.ndarray, outboard: np.ndarray):
        self._springs, self._inboard, self._outboard = springs, inboard, outboard
        self._pivots = np.empty_like(inboard[0])
        self._shares = np.empty_like(inboard)  # u/d
        gathered = np.zeros((3, *inboard[:, 0].shape), inboard.dtype)
        for joint in reversed(range(len(springs))):
            turned = outboard[:, joint] + (gathered * inboard[:, joint]).sum(axis=1)
            pivot = springs[joint] + (inboard[:, joint] * turned).sum(axis=0)
            self._pivots[joint], self._shares[:, joint] = pivot, turned / pivot
            gathered -= turned[:, None] * self._shares[:, joint]
        self.is_stable = (self._pivots.real > 0).all(axis=0)

    def matrix(self) -> np.ndarray:
        """The matrix itself (..., n, n)."""
        return np.diag(self._springs) + nested(self._inboard, self._outboard)

    def solve(self, forces: np.ndarray, downhill: bool = False) -> np.ndarray:
        """Changes of q (..., n, k), rad, under forces on the joints (..., n, k), N·m.

        Args:
            downhill: whether pivots count by their size, so that work is done on all changes.
        """
        loads = np.moveaxis(forces, (-2, -1), (0, 1))
        inboard, shares = self._inboard[:, :, None], self._shares[:, :, None]
        pivots = self._pivots * np.sign(self._pivots.real) if downhill else self._pivots
        shape = np.broadcast_shapes(loads[0].shape, pivots[0].shape)
        turned = np.empty((len(pivots), *shape), np.result_type(forces, pivots))
        gathered = np.zeros((3, *shape), turned.dtype)
        for joint in reversed(range(len(pivots))):
            turned[joint] = loads[joint] - (inboard[:, joint] * gathered).sum(axis=0)
            gathered += shares[:, joint] * turned[joint]
        gathered[:] = 0.0
        for joint in range(len(pivots)):
            turned[joint] /= pivots[joint]
            turned[joint] -= (shares[:, joint] * gathered).sum(axis=0)
            gathered += inboard[:, joint] * turned[joint]
        return np.moveaxis(turned, (0, 1), (-2, -1))
