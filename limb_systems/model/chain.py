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

from limb_systems.model.layout import Layout

_NEAR = 0.05  # (across / ahead)² of a chord, below which a series is more accurate
_SERIES = np.array([(-1.0) ** k / (2 * k + 1) for k in range(16)])  # of atan(√z)/√z in z
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

    def gravity_load(self, angles: np.ndarray) -> np.ndarray:
        """∂V/∂q (..., n), N·m: what holds the joints against gravity."""
        _, moments = self._moments(angles)
        return _outside(-np.tensordot(self._gravity, moments, 1))

    def gravity_stiffness(self, angles: np.ndarray) -> np.ndarray:
        """∂²V/∂q² (..., n, n), N·m/rad."""
        axes, moments = self._moments(angles)
        return _symmetric(-_cross(self._gravity, axes), moments)

    def held(self, angles: np.ndarray, springs: np.ndarray) -> tuple[np.ndarray, "Stiffness"]:
        """`gravity_load` (..., n), and its stiffness with that of springs k (n,), N·m/rad."""
        axes, moments = self._moments(angles)
        stiffness = Stiffness(springs, -_cross(self._gravity, axes), moments)
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
        return _symmetric(-np.concatenate([inner, across]), np.concatenate([moments, outer]))

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

    def position_curvature(
        self, angles: np.ndarray, joint: int, point: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """Second derivatives of weights · position by q (..., n, n), for weights (..., 3)."""
        axes, _, moved = self._point(angles, slice(joint + 1), np.zeros(3), point)
        result = np.zeros((*angles.shape, self.num_joints), axes.dtype)
        on = np.moveaxis(weights, -1, 0)[:, None]
        result[..., : joint + 1, : joint + 1] = _symmetric(_cross(on, axes), moved)
        return result

    def bends(self, angles: np.ndarray) -> np.ndarray:
        """Bends of the segments (..., F), rad: the log map of the chord's direction.

        The chord is that from a segment's base to its end, in the frame of its base. In a plane
        its log map is the chord's angle, atan2(t·E2, t·E1).
        """
        result = np.empty((*angles.shape[:-1], self.num_bends), angles.dtype)
        for joints, bends, base, end, across in self._segments:
            _, chord, _ = self._point(angles, joints, base, end)
            sideways = chord[across]
            ratio, _, _ = _angle_over_sine(chord[0], (sideways**2).sum(axis=0))
            result[..., bends] = _outside(sideways * ratio)
        return result

    def expanded_bends(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`bends` (..., F), and their derivatives by q (..., F, n)."""
        values = np.empty((*angles.shape[:-1], self.num_bends), angles.dtype)
        slopes = np.zeros((*values.shape, self.num_joints), angles.dtype)
        for joints, bends, base, end, across in self._segments:
            _, chord, moved = self._point(angles, joints, base, end)
            ahead, sideways = chord[0], chord[across]
            squared = (sideways**2).sum(axis=0)
            ratio, by_squared, _ = _angle_over_sine(ahead, squared)
            by_ahead = -1.0 / (ahead**2 + squared)
            turned = (2 * by_squared * sideways)[:, None] * moved[across]
            turned = by_ahead * moved[0] + turned.sum(axis=0)
            turned = ratio * moved[across] + sideways[:, None] * turned
            values[..., bends] = _outside(sideways * ratio)
            slopes[..., bends, joints] = _outside(_outside(turned))
        return values, slopes

    def bend_curvature(self, angles: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · `bends` by q (..., n, n), for weights (..., F)."""
        result = np.zeros((*angles.shape, self.num_joints), angles.dtype)
        for joints, bends, base, end, across in self._segments:
            axes, chord, moved = self._point(angles, joints, base, end)
            ahead, sideways = chord[0], chord[across]
            squared = (sideways**2).sum(axis=0)
            ratio, by_squared, by_squared_twice = _angle_over_sine(ahead, squared)
            by_ahead = -1.0 / (ahead**2 + squared)
            on = np.moveaxis(weights[..., bends], -1, 0)
            weighted = (on * sideways).sum(axis=0)
            # w(d) = Σ on d_across ratio(ahead, squared), by the chord d
            by_chord = np.zeros_like(chord)
            by_chord[0] = weighted * by_ahead
            by_chord[across] = on * ratio + 2 * weighted * by_squared * sideways
            curved = np.zeros((3, *chord.shape), chord.dtype)
            curved[0, 0] = 2 * weighted * ahead * by_ahead**2
            curved[0, across] = on * by_ahead + 2 * weighted * by_ahead**2 * sideways
            curved[across, 0] = curved[0, across]
            for row, left in enumerate(across):
                for column, right in enumerate(across):
                    both = on[row] * sideways[column] + on[column] * sideways[row]
                    curved[left, right] = 2 * by_squared * (both + weighted * (row == column))
                    curved[left, right] += (
                        4 * weighted * by_squared_twice * sideways[row] * sideways[column]
                    )
            moved_back = _outside(_outside(moved))  # (..., 3, m)
            curved_back = _outside(_outside(curved))
            result[..., joints, joints] = moved_back.swapaxes(-1, -2) @ (
                curved_back @ moved_back
            ) + _symmetric(_cross(by_chord[:, None], axes), moved)
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


class Stiffness:
    """K + ∂²V/∂q² of the joints of a chain, in factors that take O(n).

    An element of the second term, i inboard of j, is p_i · h_j of vectors of the joints alone.
    From the tip on, what is outboard of a joint acts on it by one matrix M (3, 3), which
    makes u = h + M p, the pivot d = k + p · u, and M - u uᵀ/d for the joint before.

    - ``is_stable``: whether all pivots are positive, and with them the matrix (...).

    Args:
        springs: k (n,).
        inboard, outboard: p and h (3, n, ...).
    """

    def __init__(self, springs: np.ndarray, inboard: np.ndarray, outboard: np.ndarray):
        self._inboard, self._pivots = inboard, np.empty_like(inboard[0])
        self._shares = np.empty_like(inboard)  # u/d
        gathered = np.zeros((3, *inboard[:, 0].shape), inboard.dtype)
        for joint in reversed(range(len(springs))):
            turned = outboard[:, joint] + (gathered * inboard[:, joint]).sum(axis=1)
            pivot = springs[joint] + (inboard[:, joint] * turned).sum(axis=0)
            self._pivots[joint], self._shares[:, joint] = pivot, turned / pivot
            gathered -= turned[:, None] * self._shares[:, joint]
        self.is_stable = (self._pivots.real > 0).all(axis=0)

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Changes of q (..., n, k), rad, under forces on the joints (..., n, k), N·m."""
        loads = np.moveaxis(forces, (-2, -1), (0, 1))
        inboard, shares, pivots = self._inboard[:, :, None], self._shares[:, :, None], self._pivots
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


def _symmetric(inboard: np.ndarray, outboard: np.ndarray) -> np.ndarray:
    """The symmetric matrix (..., m, m) whose element i inboard of j is inboard_i · outboard_j.

    Both are (components, m, ...).
    """
    products = _outside(_outside(inboard)).swapaxes(-1, -2) @ _outside(_outside(outboard))
    for joint in range(products.shape[-1] - 1):
        products[..., joint + 1 :, joint] = products[..., joint, joint + 1 :]
    return products


def _angle_over_sine(ahead: np.ndarray, squared: np.ndarray) -> np.ndarray:
    """atan2(√s, ahead)/√s of s = `squared`, and its first and second derivatives by s (3, ...).

    They are smooth at s = 0, where a series is used.
    """
    near = (squared.real < _NEAR * ahead.real**2) & (ahead.real > 0)
    length, s = np.where(near, ahead, 1.0), np.where(near, 1.0, squared)
    of_series = polyval(np.where(near, squared, 0.0) / length**2, _SERIES)
    whole, root = ahead**2 + s, np.sqrt(s)
    value = 2 * np.arctan(root / (np.sqrt(whole) + ahead)) / root
    first = (ahead / whole - value) / (2 * s)
    second = -(ahead / whole**2 + 3 * first) / (2 * s)
    of_series /= np.stack([length, length**3, length**5])
    return np.where(near, of_series, [value, first, second])
