"""Kinematics of one segment: a chain of equal links that bends about one axis or two.

Each joint turns two axes of the frame after it in their plane: E1 and E2 for a bend
towards E2, E1 and E3 for a bend towards E3, E2 and E3 for a twist. Arrays are of any of
Drake's scalar types, with joints along their first axis and any axes after it.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.symbolic import Expression

TURNS = {"e2": (0, 1), "e3": (0, 2), "twist": (1, 2)}  # axes that a joint turns, from and towards
_SMALL = 1e-4  # squared sine, below which an arc is its series


class SegmentChain:
    """The links of a segment between its base and its tip.

    - ``is_planar``: whether all joints bend towards E2.
    - ``kinds``: kind of each joint, as in `TURNS` (n).
    - ``last_joints``: last joint of each link (L,).
    - ``first_length``, ``lengths``: lengths of what is fixed to the base and of each link (L,), as
      shares of the pieces that the segment is cut into.

    Args:
        joints: kinds of the joints of each link, base first.
        centred: whether joints are in the middle of their pieces, not at their bases.
    """

    def __init__(self, joints: Sequence[Sequence[str]], centred: bool = False):
        self.kinds = [kind for link in joints for kind in link]
        self.is_planar = set(self.kinds) == {"e2"}
        self.last_joints = np.cumsum([len(link) for link in joints]) - 1
        self.first_length = 0.5 if centred else 0.0
        self.lengths = np.ones(len(joints))
        self.lengths[-1] -= self.first_length

    @property
    def bend_by_equal_angle(self) -> float:
        """Bend where each joint turns by one (11)."""
        links = len(self.lengths)
        return links / 2 if self.first_length else (links + 1) / 2

    @property
    def equal_angle(self) -> float:
        """Angle of each joint where all are equal and the bend is one (11)."""
        return 1 / self.bend_by_equal_angle

    def frames(self, joint_angles: ArrayLike) -> list[np.ndarray]:
        """Frames of the links in that of the base, their axes side by side (3, 3, ...).

        Args:
            joint_angles: θ (n, ...), rad.
        """
        angles = np.asarray(joint_angles)
        axes = [np.multiply.outer(axis, np.ones(angles.shape[1:])) for axis in np.eye(3)]
        frames = []
        with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
            for number, (kind, angle) in enumerate(zip(self.kinds, angles, strict=True)):
                i, k = TURNS[kind]
                cosine, sine = np.cos(angle), np.sin(angle)
                axes[i], axes[k] = (
                    axes[i] * cosine + axes[k] * sine,
                    axes[k] * cosine - axes[i] * sine,
                )
                if number in self.last_joints:
                    frames.append(np.stack(axes, axis=1))
        return frames

    def bend_angle(self, joint_angles: ArrayLike) -> np.ndarray:
        """Bend φ of the chord from base to tip, from θ (n, ...), rad.

        Returns:
            Its angle atan2(t·E2, t·E1) in a plane, (1, ...), or else `angles_of` it, (2, ...).
        """
        if not self.is_planar:
            frames = self.frames(joint_angles)
            parts = [length * f[:, 0] for length, f in zip(self.lengths, frames, strict=True)]
            chord = np.sum(parts, axis=0)
            chord[0] = chord[0] + self.first_length
            return angles_of(chord)
        with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
            links = np.cumsum(np.asarray(joint_angles), axis=0)
            along, across = np.cos(links), np.sin(links)
            if self.first_length:
                along[-1], across[-1] = self.lengths[-1] * along[-1], self.lengths[-1] * across[-1]
            along_chord, across_chord = along.sum(axis=0), across.sum(axis=0)
            return np.array([np.arctan2(across_chord, along_chord + self.first_length)])

    def tip_bend(self, joint_angles: ArrayLike) -> np.ndarray:
        """Half the angle of the tip tangent α (8), as `bend_angle`, such that equal angles give φ.

        The directions of the chain's links are the tangents of a rod at the middle of
        each link. If joints are at their bases, the tip is half a link beyond the last of them,
        where the tangent has turned by half of the last joint's angle more. The joint at the clamp
        is half a link before the first middle, yet counts whole in (11). Hence the factor

            α/2 = (n + 1) / (2 n + 1) (Σ θ_i + θ_n / 2)

        with which (8) is exact for constant curvature. If joints are centred, α is Σ θ_i.
        """
        angles, links = np.asarray(joint_angles), len(self.lengths)
        beyond = 0.0 if self.first_length else 0.5
        factor = (links + 1) / (2 * links + 1) if beyond else 0.5
        if self.is_planar:  # any number of turns
            return np.array([factor * (angles.sum(axis=0) + angles[-1] * beyond)])
        last_link = np.arange(len(angles)) > (self.last_joints[-2] if links > 1 else -1)
        weights = np.where(last_link, 1.0 + beyond, 1.0).reshape(-1, *[1] * (angles.ndim - 1))
        return factor * angles_of(self.frames(weights * angles)[-1][:, 0])


def angles_of(direction: np.ndarray) -> np.ndarray:
    """Angles (2, ...) towards E2 and E3 by which E1 turns, about one axis, into a direction.

    It is the logarithm map (φ2, φ3) = atan2(s, c1) (c2, c3) / s with s = |(c2, c3)|, which is
    atan2(c2, c1) in a plane. It is smooth but opposite to E1.

    Args:
        direction: (3, ...), of any length.
    """
    along, across = direction[0], direction[1:]
    squared = across[0] ** 2 + across[1] ** 2
    if direction.dtype == object:
        return across * np.vectorize(_arc, otypes=[object])(along, squared)
    near = (squared < _SMALL * along**2) & (along > 0)
    series = _series(np.where(near, squared, 0.0), np.where(near, along, 1.0))
    length = np.sqrt(np.where(near, 1.0, squared))
    return across * np.where(near, series, np.arctan2(length, along) / length)


def _arc(along, squared):
    """The angle from E1 over the length across it, in one of Drake's scalar types."""
    known = not isinstance(along, Expression) and along.value() > 0
    if known and squared.value() < _SMALL * along.value() ** 2:
        return _series(squared, along)
    length = np.sqrt(squared)
    return np.arctan2(length, along) / length


def _series(squared, along):
    """atan(s / c1) / s for small s, to the last bit."""
    ratio = squared / along**2
    return (1 - ratio * (1 / 3 - ratio * (1 / 5 - ratio * (1 / 7 - ratio / 9)))) / along
