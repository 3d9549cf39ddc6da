"""Statics of a chain of revolute joints in space: its weight, its points and its bends.

A joint i inboard of a point p turns it about its axis a_i through its origin o_i, and all that is
outboard of i with it. Each derivative by a joint angle therefore puts a cross product with one
more axis before what the joints outboard of it make:

    ∂p/∂q_j = a_j × (p - o_j),   ∂²p/∂q_i ∂q_j = a_i × (a_j × (p - o_j)),   i inboard of j,

and so on for the third. The gravity potential is V = -g · Σ m c of the bodies' centres c, whose
derivatives have outboard sums of m (c - o_j) in the place of p - o_j.

Points are the last axis of arrays inside, where numpy is fast, and the first axes outside.
"""

from collections.abc import Sequence

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from limb_systems.model.chain_stiffness import ChainStiffness, nested
from limb_systems.model.layout import Layout

_NEAR = 0.01  # (across / ahead)² of a chord, below which a series is more accurate
_SERIES = np.array([(-1.0) ** k / (2 * k + 1) for k in range(10)])  # of atan(√z)/√z in z
_SERIES = np.array([np.pad(polyder(_SERIES, k), (0, k)) for k in range(3)]).T  # and derivatives


class Chain:
    """Gravity, points and bends of n joints in series, at any number of joint angles.

    Frames of joints are parallel to the base frame (E1, E2, E3) when all angles are zero. Angles q
    have the joints along their last axis and any number of points before it, (..., n); they
    are of floats, or of complex numbers, with which all values are analytic.

    - ``num_joints``: n.
    - ``weighs``: whether gravity turns any joint.

    Args:
        layout: axes and offsets of the joints, bodies, and ends and bends of the segments; each
            axis is along E1, E2 or E3, or against it.
        gravity: acceleration in the base frame (3,), m/s².
    """

    def __init__(self, layout: Layout, gravity: Sequence[float]):
        self.num_joints = len(layout.axes)
        self._about = np.abs(layout.axes).argmax(axis=1).tolist()
        self._sense = layout.axes.sum(axis=1).tolist()
        self._offsets, self._gravity = layout.offsets, np.asarray(gravity, float)
        self.weighs = bool(np.cross(self._gravity, layout.axes).any())
        self._masses, self._centres = np.zeros(self.num_joints), np.zeros((self.num_joints, 3))
        for joint, mass, centre in zip(
            layout.body_joints, layout.body_masses, layout.body_centres, strict=True
        ):
            if joint >= 0:  # else it is fixed to the base
                self._masses[joint] += mass
                self._centres[joint] += mass / self._masses[joint] * (centre - self._centres[joint])
        self._segments = []
        base = np.zeros(3)  # end of the segment before, in its last joint's frame
        for joints, end, bends in zip(
            layout.joints_of, layout.end_offset, layout.bends_of, strict=True
        ):
            across = [1 + direction for direction in layout.bend_direction[bends]]
            self._segments.append((joints, bends, base, end, across))
            base = end
        self.num_bends = len(layout.bend_direction)

    def held(self, angles: np.ndarray, springs: np.ndarray) -> tuple[np.ndarray, ChainStiffness]:
        """∂V/∂q (..., n), N·m, and ∂²V/∂q² with the stiffness of springs k (n,), N·m/rad."""
        axes, moments = self._moments(angles)
        stiffness = ChainStiffness(springs, -_cross(self._gravity, axes), moments)
        return _outside(-np.tensordot(self._gravity, moments, 1)), stiffness

    def gravity_curvature(self, angles: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · ∂V/∂q by q (..., n, n), for weights (..., n)."""
        axes, moments = self._moments(angles)
        across = _cross(self._gravity, axes)
        on = np.moveaxis(weights, -1, 0)
        # A joint k with weight is inboard of i, between i and j, or outboard of j (i inboard of j).
        turned, weighted = np.cumsum(on * axes, axis=1), np.cumsum(on * across, axis=1)
        outboard = _outboard_sums(on * moments) - on * moments
        inner = _cross(weighted, axes) - _cross(across, turned)
        outer = _cross(turned, moments) + _cross(axes, outboard)
        return nested(-np.concatenate([inner, across]), np.concatenate([moments, outer]))

    def expanded_position(
        self, angles: np.ndarray, joint: int, point: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Position of a point in the base frame (..., 3), m, and its derivatives (..., 3, n).

        Args:
            joint: index of the joint to whose frame the point is fixed.
            point: place in that frame (3,), m.
        """
        _, place, moved = self._point(angles, slice(joint + 1), np.zeros(3), point)
        slopes = np.zeros((*angles.shape[:-1], 3, self.num_joints), place.dtype)
        slopes[..., : joint + 1] = _outside(_outside(moved))
        return _outside(place), slopes

    def bends(self, angles: np.ndarray) -> np.ndarray:
        """Bends of the segments (..., F), rad: the log map of the chord's direction.

        The chord is that from a segment's base to its end, in the frame of its base. In a plane
        its log map is the chord's angle, atan2(t·E2, t·E1).
        """
        return self.expanded_bends(angles)[0]

    def expanded_bends(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`bends` (..., F), and their derivatives by q (..., F, n)."""
        values = np.empty((*angles.shape[:-1], self.num_bends), angles.dtype)
        slopes = np.zeros((*values.shape, self.num_joints), angles.dtype)
        for joints, bends, base, end, across in self._segments:
            _, chord, moved = self._point(angles, joints, base, end)
            ratio, by_chord, _ = _angle_over_sine(chord, across)
            turned = (by_chord[:, None] * moved).sum(axis=0)
            values[..., bends] = _outside(ratio * chord[across])
            slopes[..., bends, joints] = _outside(
                _outside(ratio * moved[across] + chord[across, None] * turned)
            )
        return values, slopes

    def bend_curvature(self, angles: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · `bends` by q (..., n, n), for weights (..., F)."""
        result = np.zeros((*angles.shape, self.num_joints), angles.dtype)
        for joints, bends, base, end, across in self._segments:
            axes, chord, moved = self._point(angles, joints, base, end)
            ratio, by_chord, curved = _angle_over_sine(chord, across)
            on = np.zeros_like(chord)
            on[across] = np.moveaxis(weights[..., bends], -1, 0)
            weighted, mixed = (on * chord).sum(axis=0), on[:, None] * by_chord
            curved = _outside(_outside(mixed + mixed.swapaxes(0, 1) + weighted * curved))
            by_joint = _outside(_outside(moved))
            on_chord = ratio * on + weighted * by_chord
            result[..., joints, joints] = by_joint.swapaxes(-1, -2) @ curved @ by_joint
            result[..., joints, joints] += nested(_cross(on_chord[:, None], axes), moved)
        return result

    def _moments(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Axes a, and a × Σ m (c - o) of what is outboard of each joint, (3, n, ...)."""
        axes, origins, centres = self._places(angles, slice(None), np.zeros(3), self._centres)
        masses = self._masses.reshape(-1, *[1] * (angles.ndim - 1))
        centres *= masses
        arms = _outboard_sums(centres)
        arms -= _outboard_sums(masses, 0) * origins
        return axes, _cross(axes, arms)

    def _point(
        self, angles: np.ndarray, joints: slice, base: np.ndarray, point: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Axes a (3, m, ...), place p (3, ...) of a point fixed to the last joint, a × (p - o)."""
        points = np.zeros((self.num_joints, 3))
        points[joints.stop - 1] = point
        axes, origins, places = self._places(angles, joints, base, points)
        place = places[:, -1]
        return axes, place, _cross(axes, place[:, None] - origins)

    def _places(
        self, angles: np.ndarray, joints: slice, base: np.ndarray, points: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Axes and origins of m joints, and places of points fixed to them, (3, m, ...).

        All are in the frame before the first joint, and places are from `base` in it.
        """
        turned = np.moveaxis(angles[..., joints], -1, 0)
        cosines, sines = np.cos(turned), np.sin(turned)
        axes, origins, places = np.empty((3, 3, *turned.shape), turned.dtype)
        straight = [1] * (turned.ndim - 1)
        frame, origin = list(np.eye(3).reshape(3, 3, *straight)), -base.reshape(3, *straight)
        for index, joint in enumerate(range(*joints.indices(self.num_joints))):
            about, sense = self._about[joint], self._sense[joint]
            origin = _moved(origin, frame, self._offsets[joint])
            axes[:, index], origins[:, index] = sense * frame[about], origin
            one, other = (about + 1) % 3, (about + 2) % 3
            cosine, sine = cosines[index], sense * sines[index]
            frame[one], frame[other] = (
                cosine * frame[one] + sine * frame[other],
                cosine * frame[other] - sine * frame[one],
            )
            places[:, index] = _moved(origin, frame, points[joint])
        return axes, origins, places


def _moved(place: np.ndarray, frame: list[np.ndarray], by: np.ndarray) -> np.ndarray:
    """The place that is `by` (3,) from a place in a frame of three axes (3, ...)."""
    for axis, distance in zip(frame, by.tolist(), strict=True):
        if distance:
            place = place + distance * axis
    return place


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a × b of vectors along the first axes."""
    return np.stack([a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)])


def _outboard_sums(values: np.ndarray, axis: int = 1) -> np.ndarray:
    """Sums over each joint and those outboard of it."""
    return np.flip(np.cumsum(np.flip(values, axis), axis=axis), axis)


def _outside(values: np.ndarray) -> np.ndarray:
    return np.moveaxis(values, 0, -1)


def _angle_over_sine(
    chord: np.ndarray, across: list[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """atan2(√s, d1)/√s of a chord d (3, ...), with s the square of its part across.

    It is smooth at s = 0, where a series is used.

    Returns:
        The ratio (...), and its first and second derivatives by d (3, ...) and (3, 3, ...).
    """
    seen = np.zeros_like(chord)
    seen[[0, *across]] = chord[[0, *across]]
    ahead, whole = chord[0], (seen**2).sum(axis=0)
    squared = (seen[1:] ** 2).sum(axis=0)
    near = (squared.real < _NEAR * ahead.real**2) & (ahead.real > 0)
    length, s = np.where(near, ahead, 1.0), np.where(near, 1.0, squared)
    of_series = polyval(np.where(near, squared, 0.0) / length**2, _SERIES)
    of_series /= np.stack([length, length**3, length**5])
    value = 2 * np.arctan(np.sqrt(s) / (np.sqrt(ahead**2 + s) + ahead)) / np.sqrt(s)
    first = (ahead / whole - value) / (2 * s)
    second = -(ahead / whole**2 + 3 * first) / (2 * s)
    ratio, by_s, by_s_twice = np.where(near, of_series, [value, first, second])
    by_chord = 2 * by_s * seen
    by_chord[0] = -1 / whole
    curved = 4 * by_s_twice * seen[:, None] * seen
    curved[0] = curved[:, 0] = 2 * seen / whole**2
    curved[across, across] += 2 * by_s
    return ratio, by_chord, curved
