"""Chains of revolute joints in symbols: poses of the joints, and bends of a segment of equal links.

Each joint turns two axes of the frame after it in their plane: E1 and E2 for a bend
towards E2, E1 and E3 for a bend towards E3, E2 and E3 for a twist.
"""

import functools
import itertools
from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from limb_systems.smooth_function import Compiled

# Axes that a joint turns, from and towards.
ROTATION_PLANES = {"e2": (0, 1), "e3": (0, 2), "twist": (1, 2)}
_SERIES_LIMIT = 0.01  # (across / ahead)² of a chord, below which a series is more accurate
_ATAN_SERIES = [(-1.0) ** k / (2 * k + 1) for k in range(10)]  # of atan(√z)/√z in z


class SegmentChain:
    """The links of a segment between its base and its tip. Lengths are shares of a piece.

    A piece is the length of the segment over the number of its links.

    - ``is_planar``: whether all joints bend towards E2.
    - ``kinds``: kind of each joint, as in `ROTATION_PLANES` (n).
    - ``axes``: unit axis of each joint (n, 3): +E3 for a bend towards E2, -E2 for one towards E3,
      E1 for a twist.
    - ``offsets``: distance of each joint's origin from the joint before, or the base (n,).
    - ``first_joints``, ``last_joints``: first and last joint of each link (L,).
    - ``first_length``, ``lengths``: length of the part that is fixed to the base, and of each link
      (L,).

    Args:
        joints: kinds of the joints of each link, base first.
        centred: whether joints are in the middle of their pieces, not at their bases.
    """

    def __init__(self, joints: Sequence[Sequence[str]], centred: bool = False):
        # Find the joints, and the axes about which they turn.
        self.kinds = [*itertools.chain(*joints)]
        self.is_planar = set(self.kinds) == {"e2"}
        towards = np.eye(3)[np.array([ROTATION_PLANES[kind] for kind in self.kinds])]
        self.axes = np.cross(towards[:, 0], towards[:, 1])
        # Divide the joints and the length among the links.
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
        """The bend over the angle of each joint, where all joints have the same angle (11)."""
        links = len(self.lengths)
        return links / 2 if self.first_length else (links + 1) / 2

    @property
    def equal_angle(self) -> float:
        """The angle of each joint over the bend, where all joints have the same angle (11)."""
        return 1 / self.bend_by_equal_angle

    def bend_angle(self, joint_angles: ArrayLike) -> np.ndarray:
        """Return the bend φ of the chord from base to tip, rad: its `log_map_angles`.

        Args:
            joint_angles: θ (n, ...), rad, numbers or one of Drake's scalars.

        Returns:
            (1, ...) in a plane, or else (2, ...).
        """
        return _evaluated(_chord_bend(*self._key), joint_angles)

    def tip_bend(self, joint_angles: ArrayLike) -> np.ndarray:
        """Return half the angle of the tip tangent α (8), rad; φ if all joint angles are equal.

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
    """Return `SegmentChain.bend_angle` as a function of θ."""
    chain = SegmentChain(joints, centred)
    angles = ca.SX.sym("q", len(chain.kinds))
    e1 = np.array([1.0, 0.0, 0.0])
    direction = chord(chain.axes, np.outer(chain.offsets, e1), angles, chain.lengths[-1] * e1)
    return Compiled([angles], [log_map_angles(direction, chain.is_planar)])


@functools.lru_cache(maxsize=64)
def _tip_bend(joints: Sequence[Sequence[str]], centred: bool) -> Compiled:
    """Return `SegmentChain.tip_bend` as a function of θ."""
    chain = SegmentChain(joints, centred)
    num_links = len(joints)
    num_joints = len(chain.kinds)
    angles = ca.SX.sym("q", num_joints)
    factor = 0.5 if centred else (num_links + 1) / (2 * num_links + 1)
    last_share = 0.0 if centred else 0.5  # of the last joint's angle, added beyond the joint
    if chain.is_planar:  # any number of turns
        return Compiled([angles], [factor * (ca.sum1(angles) + angles[-1] * last_share)])
    # In space, increase the angles of the last link's joints, and take the log map of its tangent.
    weights = 1.0 + last_share * (np.arange(num_joints) >= chain.first_joints[-1])
    no_offsets = np.zeros((num_joints, 3))
    _, _, frames = joint_poses(chain.axes, no_offsets, ca.DM(weights) * angles)
    return Compiled([angles], [factor * log_map_angles(frames[-1][:, 0])])


def _evaluated(bends: Compiled, joint_angles: ArrayLike) -> np.ndarray:
    """Return a function of θ at angles of numbers or of one of Drake's scalars."""
    angles = np.asarray(joint_angles)
    return bends(angles if angles.dtype == object else angles.astype(float))[0]


def joint_poses(
    axes: np.ndarray, offsets: np.ndarray, angles: ca.SX, base: ArrayLike = (0.0, 0.0, 0.0)
) -> tuple[list[ca.SX], list[ca.SX], list[ca.SX]]:
    """Return the axes (3,), origins (3,) from `base`, and frames (3, 3) of joints at angles (n,).

    They are in the frame before the first joint. Consecutive joints about one axis add their
    angles, so that in a plane only absolute angles are under sines.

    Args:
        axes: unit axis of each joint (n, 3) in the frame before it, along E1, E2 or E3.
        offsets: origin of each joint in the frame before it (n, 3), m.
        angles: rad.
        base: in the frame before the first joint, m.
    """
    frame = ca.SX.eye(3)
    origin = -ca.SX(ca.DM(np.asarray(base)))
    # Of the consecutive joints about one axis: the axis, the frame before them, their angle.
    run_axis = None
    run_frame = frame
    run_angle = ca.SX(0.0)
    turned_axes = []
    origins = []
    frames = []
    for joint, (axis, offset) in enumerate(zip(axes, offsets, strict=True)):
        # Place the joint.
        axis_index = int(np.abs(axis).argmax())
        sign = float(axis.sum())
        origin = origin + frame @ ca.DM(offset)
        turned_axes.append(sign * frame[:, axis_index])
        # Turn the frame after it, together with the joints before it about the same axis.
        if run_axis != axis_index:
            run_axis = axis_index
            run_frame = frame
            run_angle = ca.SX(0.0)
        run_angle = run_angle + sign * angles[joint]
        frame = run_frame @ rotation(axis_index, run_angle)
        origins.append(origin)
        frames.append(frame)
    return turned_axes, origins, frames


def chord(
    axes: np.ndarray,
    offsets: np.ndarray,
    angles: ca.SX,
    end: np.ndarray,
    base: ArrayLike = (0.0, 0.0, 0.0),
) -> ca.SX:
    """Return the chord (3,), m, from `base` to an end (3,), m, in the frame of the last joint."""
    _, origins, frames = joint_poses(axes, offsets, angles, base)
    return origins[-1] + frames[-1] @ ca.DM(end)


def log_map_angles(direction: ca.SX, planar: bool = False) -> ca.SX:
    """Return angles (2,) towards E2 and E3 of the rotation that turns E1 into a direction (3,).

    It is the logarithm map (φ2, φ3) = atan2(s, c1) (c2, c3) / s with s = |(c2, c3)|, which is
    atan2(c2, c1) in a plane, (1,). It is smooth except opposite to E1: at s = 0 it is a series.
    """
    ahead = direction[0]
    across = direction[1:]
    if planar:
        return ca.atan2(across[0], ahead)
    # Use the series of atan(√z)/√z near E1, where s / s is not defined.
    squared = ca.sumsqr(across)
    is_near = ca.logic_and(squared < _SERIES_LIMIT * ahead**2, ahead > 0)
    series = ca.polyval(ca.DM(_ATAN_SERIES[::-1]), squared / ahead**2) / ahead
    length = ca.sqrt(ca.if_else(is_near, 1.0, squared))
    return ca.if_else(is_near, series, ca.atan2(length, ahead) / length) * across


def rotation(axis: int, angle: ca.SX) -> ca.SX:
    """Return the rotation matrix (3, 3) about an axis, number 0, 1 or 2."""
    second = (axis + 1) % 3
    third = (axis + 2) % 3
    matrix = ca.SX(3, 3)
    matrix[axis, axis] = 1.0
    matrix[second, second] = ca.cos(angle)
    matrix[third, third] = ca.cos(angle)
    matrix[third, second] = ca.sin(angle)
    matrix[second, third] = -ca.sin(angle)
    return matrix
