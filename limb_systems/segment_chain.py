"""Chains of revolute joints in symbols: where joints are, and how a segment of equal links bends.

Each joint turns two axes of the frame after it in their plane: E1 and E2 for a bend
towards E2, E1 and E3 for a bend towards E3, E2 and E3 for a twist.
"""

import functools
from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from limb_systems.smooth_function import Compiled

ROTATION_PLANES = {
    "e2": (0, 1),
    "e3": (0, 2),
    "twist": (1, 2),
}  # axes that a joint turns, from and towards
_SERIES_LIMIT = 0.01  # (across / ahead)² of a chord, below which a series is more accurate
_ATAN_SERIES = [(-1.0) ** k / (2 * k + 1) for k in range(10)]  # of atan(√z)/√z in z


class SegmentChain:
    """The links of a segment between its base and its tip. Lengths are shares of a piece.

    A piece is the length of the segment over the number of its links.

    - ``is_planar``: whether all joints bend towards E2.
    - ``kinds``: kind of each joint, as in `ROTATION_PLANES` (n).
    - ``axes``: unit axis of each joint (n, 3): +E3 for a bend towards E2, -E2 for one towards E3,
      E1 for a twist.
    - ``offsets``: from each joint's origin to that of the joint before, or the base (n,).
    - ``first_joints``, ``last_joints``: first and last joint of each link (L,).
    - ``first_length``, ``lengths``: lengths of what is fixed to the base and of each link (L,).

    Args:
        joints: kinds of the joints of each link, base first.
        centred: whether joints are in the middle of their pieces, not at their bases.
    """

    def __init__(self, joints: Sequence[Sequence[str]], centred: bool = False):
        self.kinds = [kind for link in joints for kind in link]
        self.is_planar = set(self.kinds) == {"e2"}
        towards = np.eye(3)[np.array([ROTATION_PLANES[kind] for kind in self.kinds])]
        self.axes = np.cross(towards[:, 0], towards[:, 1])
        self.last_joints = np.cumsum([len(link) for link in joints]) - 1
        self.first_joints = np.append(0, self.last_joints[:-1] + 1)
        self.first_length = 0.5 if centred else 0.0
        self.lengths = np.ones(len(joints))
        self.lengths[-1] -= self.first_length
        self.offsets = np.zeros(len(self.kinds))
        self.offsets[self.first_joints[1:]] = 1.0
        self.offsets[0] = self.first_length
        self._key = tuple(map(tuple, joints)), centred

    @property
    def bend_by_equal_angle(self) -> float:
        """Bend where each joint turns by one (11)."""
        links = len(self.lengths)
        return links / 2 if self.first_length else (links + 1) / 2

    @property
    def equal_angle(self) -> float:
        """Angle of each joint where all are equal and the bend is one (11)."""
        return 1 / self.bend_by_equal_angle

    def bend_angle(self, joint_angles: ArrayLike) -> np.ndarray:
        """Bend φ of the chord from base to tip, rad: `log_map_angles` it.

        Args:
            joint_angles: θ (n, ...), rad, numbers or one of Drake's scalars.

        Returns:
            (1, ...) in a plane, or else (2, ...).
        """
        return _evaluated(_chord_bend(*self._key), joint_angles)

    def tip_bend(self, joint_angles: ArrayLike) -> np.ndarray:
        """Half the angle of the tip tangent α (8), as `bend_angle`, such that equal angles give φ.

        The directions of the chain's links are the tangents of a rod at the middle of
        each link. If joints are at their bases, the tip is half a link beyond the last of them,
        where the tangent has turned by half of the last joint's angle more. The joint at the clamp
        is half a link before the first middle, yet counts whole in (11). Hence the factor

            α/2 = (n + 1) / (2 n + 1) (Σ θ_i + θ_n / 2)

        with which (8) is exact for constant curvature. If joints are centred, α is Σ θ_i.
        """
        return _evaluated(_tip_bend(*self._key), joint_angles)


@functools.lru_cache(maxsize=64)
def _chord_bend(joints: Sequence[Sequence[str]], centred: bool) -> Compiled:
    chain = SegmentChain(joints, centred)
    angles, e1 = ca.SX.sym("q", len(chain.kinds)), np.eye(3)[0]
    offsets, end = np.outer(chain.offsets, e1), chain.lengths[-1] * e1
    direction = chord(chain.axes, offsets, angles, end)
    return Compiled([angles], [log_map_angles(direction, chain.is_planar)])


@functools.lru_cache(maxsize=64)
def _tip_bend(joints: Sequence[Sequence[str]], centred: bool) -> Compiled:
    chain, links = SegmentChain(joints, centred), len(joints)
    angles = ca.SX.sym("q", len(chain.kinds))
    factor, beyond = (0.5, 0.0) if centred else ((links + 1) / (2 * links + 1), 0.5)
    if chain.is_planar:  # any number of turns
        return Compiled([angles], [factor * (ca.sum1(angles) + angles[-1] * beyond)])
    weights = 1.0 + beyond * (np.arange(len(chain.kinds)) >= chain.first_joints[-1])
    _, _, frames = joint_poses(chain.axes, np.zeros((len(weights), 3)), ca.DM(weights) * angles)
    return Compiled([angles], [factor * log_map_angles(frames[-1][:, 0])])


def _evaluated(bends: Compiled, joint_angles: ArrayLike) -> np.ndarray:
    angles = np.asarray(joint_angles)
    return bends(angles if angles.dtype == object else angles.astype(float))[0]


def joint_poses(
    axes: np.ndarray, offsets: np.ndarray, angles: ca.SX, base: ArrayLike = (0.0, 0.0, 0.0)
) -> tuple[list[ca.SX], list[ca.SX], list[ca.SX]]:
    """Axes (3,), origins (3,) from `base`, and frames (3, 3) of joints at angles (n,), rad.

    They are in the frame before the first joint. Joints in a row about one axis add their
    angles, so that in a plane only absolute angles are under sines.

    Args:
        axes: unit axis of each joint (n, 3) in the frame before it, along E1, E2 or E3.
        offsets: origin of each joint in the frame before it (n, 3), m.
        base: in the frame before the first joint, m.
    """
    frame = straight = ca.SX.eye(3)
    origin, run, angle = -ca.SX(ca.DM(np.asarray(base))), None, ca.SX(0.0)
    turned, origins, frames = [], [], []
    for joint, (direction, offset) in enumerate(zip(axes, offsets, strict=True)):
        about, sense = int(np.abs(direction).argmax()), float(direction.sum())
        origin = origin + frame @ ca.DM(offset)
        turned.append(sense * frame[:, about])
        if run != about:
            run, straight, angle = about, frame, ca.SX(0.0)
        angle = angle + sense * angles[joint]
        frame = straight @ rotation(about, angle)
        origins.append(origin)
        frames.append(frame)
    return turned, origins, frames


def chord(
    axes: np.ndarray,
    offsets: np.ndarray,
    angles: ca.SX,
    end: np.ndarray,
    base: ArrayLike = (0.0, 0.0, 0.0),
) -> ca.SX:
    """The chord (3,), m, from `base` to an end (3,), m, in the frame of the last joint."""
    _, origins, frames = joint_poses(axes, offsets, angles, base)
    return origins[-1] + frames[-1] @ ca.DM(end)


def log_map_angles(direction: ca.SX, planar: bool = False) -> ca.SX:
    """Angles (2,) towards E2 and E3 by which E1 turns, about one axis, into a direction (3,).

    It is the logarithm map (φ2, φ3) = atan2(s, c1) (c2, c3) / s with s = |(c2, c3)|, which is
    atan2(c2, c1) in a plane, (1,). It is smooth but opposite to E1: at s = 0 it is a series.
    """
    ahead, across = direction[0], direction[1:]
    if planar:
        return ca.atan2(across[0], ahead)
    squared = ca.sumsqr(across)
    near = ca.logic_and(squared < _SERIES_LIMIT * ahead**2, ahead > 0)
    ratio = ca.polyval(ca.DM(_ATAN_SERIES[::-1]), squared / ahead**2) / ahead
    length = ca.sqrt(ca.if_else(near, 1.0, squared))
    return ca.if_else(near, ratio, ca.atan2(length, ahead) / length) * across


def rotation(about: int, angle: ca.SX) -> ca.SX:
    """The rotation (3, 3) about an axis, number 0, 1 or 2."""
    one, other = (about + 1) % 3, (about + 2) % 3
    turned = ca.SX(3, 3)
    turned[about, about] = 1.0
    turned[one, one] = turned[other, other] = ca.cos(angle)
    turned[other, one], turned[one, other] = ca.sin(angle), -ca.sin(angle)
    return turned
