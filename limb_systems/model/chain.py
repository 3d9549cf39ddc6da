"""A chain of revolute joints in symbols: its frames, points, bends and inverse dynamics.

Vectors are in the frame (E1, E2, E3) of the chain's base. Frames of joints are parallel to it when
all angles are zero.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from limb_systems.model.layout import Layout
from limb_systems.model.smooth_function import SmoothFunction

_NEAR = 0.01  # (across / ahead)² of a chord, below which a series is more accurate
_SERIES = [(-1.0) ** k / (2 * k + 1) for k in range(10)]  # of atan(√z)/√z in z


class Chain:
    """The joints of a limb at angles θ, as expressions of θ.

    Args:
        layout: axes and offsets of the joints, bodies, and ends and bends of the segments; each
            axis is along E1, E2 or E3, or against it.
        angles: θ (n,), rad.
    """

    def __init__(self, layout: Layout, angles: ca.SX):
        self._layout, self._angles = layout, angles
        self._axes, self._origins, self._frames = self._placed(slice(None), np.zeros(3))

    def position(self, joint: int, point: np.ndarray) -> ca.SX:
        """The place of a point (3,), m, that is fixed to the frame of a joint there."""
        return self._origins[joint] + self._frames[joint] @ ca.DM(point)

    def bends(self) -> ca.SX:
        """Bends of the segments (F,), rad: the log map of the chord's direction.

        The chord is that from a segment's base to its end, in the frame of its base. In a plane
        its log map is the chord's angle, atan2(t·E2, t·E1).
        """
        layout, base, bends = self._layout, np.zeros(3), []
        for joints, end, axes in zip(
            layout.joints_of, layout.end_offset, layout.bends_of, strict=True
        ):
            _, origins, frames = self._placed(joints, base)
            chord = origins[-1] + frames[-1] @ ca.DM(end)
            base = end  # in the frame of the last joint, from which the next segment starts
            if axes.stop - axes.start == 1:
                bends.append(ca.atan2(chord[1], chord[0]))
            else:
                bends.append(_angle_over_sine(chord) * chord[1:])
        return ca.vertcat(*bends)

    def inverse_dynamics(self, rates: ca.SX, accelerations: ca.SX, gravity: ca.SX | ca.DM) -> ca.SX:
        """Torques on the joints (n,), N·m: the inertia and gravity side of eqn (2).

        By the recursive Newton-Euler method: velocities and accelerations from the base outward,
        then forces inward. Gravity is an upward acceleration of the base.

        Args:
            rates, accelerations: θ̇ and θ̈ (n,), rad/s and rad/s².
            gravity: (3,), m/s².
        """
        layout = self._layout
        spin = turning = before = ca.SX(3, 1)  # ω, ω̇, and the origin of the joint before
        moved = -gravity
        forces, moments = [], []  # of the bodies on each joint, about its origin
        for joint, (axis, origin, frame) in enumerate(
            zip(self._axes, self._origins, self._frames, strict=True)
        ):
            moved += _acceleration(turning, spin, origin - before)
            turning += axis * accelerations[joint] + ca.cross(spin, axis * rates[joint])
            spin += axis * rates[joint]
            before, force, moment = origin, ca.SX(3, 1), ca.SX(3, 1)
            for body in np.flatnonzero(layout.body_joints == joint).tolist():
                centre = frame @ ca.DM(layout.body_centres[body])
                pull = layout.body_masses[body] * (moved + _acceleration(turning, spin, centre))
                inertia = frame @ ca.diag(ca.DM(layout.body_moments[body])) @ frame.T
                force += pull
                moment += inertia @ turning + ca.cross(spin, inertia @ spin)
                moment += ca.cross(centre, pull)
            forces.append(force)
            moments.append(moment)
        torques, outboard, moment = [], ca.SX(3, 1), ca.SX(3, 1)
        for joint in reversed(range(layout.num_joints)):
            if joint + 1 < layout.num_joints:
                moment += ca.cross(self._origins[joint + 1] - self._origins[joint], outboard)
            outboard += forces[joint]
            moment += moments[joint]
            torques.append(ca.dot(self._axes[joint], moment))
        return ca.vertcat(*reversed(torques))

    def _placed(
        self, joints: slice, base: np.ndarray
    ) -> tuple[list[ca.SX], list[ca.SX], list[ca.SX]]:
        """Axes (3,), origins (3,) from `base`, and frames (3, 3) of joints.

        They are in the frame before the first joint. Joints in a row about one axis add their
        angles, so that in a plane only absolute angles are under sines.
        """
        layout = self._layout
        frame = straight = ca.SX.eye(3)
        origin, run, angle = -ca.SX(ca.DM(base)), None, ca.SX(0.0)
        axes, origins, frames = [], [], []
        for joint in range(*joints.indices(layout.num_joints)):
            direction = layout.axes[joint]
            about, sense = int(np.abs(direction).argmax()), float(direction.sum())
            origin = origin + frame @ ca.DM(layout.offsets[joint])
            axes.append(sense * frame[:, about])
            if run != about:
                run, straight, angle = about, frame, ca.SX(0.0)
            angle = angle + sense * self._angles[joint]
            frame = straight @ _rotation(about, angle)
            origins.append(origin)
            frames.append(frame)
        return axes, origins, frames


def weight_of_angles(layout: Layout, gravity: Sequence[float]) -> SmoothFunction:
    """The torques that hold a chain against gravity (3,), m/s², (n,), N·m, of θ (n,), rad."""
    angles, still = ca.SX.sym("q", layout.num_joints), ca.SX(layout.num_joints, 1)
    weight = Chain(layout, angles).inverse_dynamics(still, still, ca.DM(gravity))
    return SmoothFunction(weight, angles)


def tip_of_angles(layout: Layout) -> SmoothFunction:
    """The tip's place in the base's frame (3,), m, of θ (n,), rad."""
    angles = ca.SX.sym("q", layout.num_joints)
    tip = Chain(layout, angles).position(layout.num_joints - 1, layout.end_offset[-1])
    return SmoothFunction(tip, angles)


def _rotation(about: int, angle: ca.SX) -> ca.SX:
    """The rotation about E1, E2 or E3, number 0, 1 or 2 (3, 3)."""
    one, other = (about + 1) % 3, (about + 2) % 3
    rotation = ca.SX(3, 3)
    rotation[about, about] = 1.0
    rotation[one, one] = rotation[other, other] = ca.cos(angle)
    rotation[other, one], rotation[one, other] = ca.sin(angle), -ca.sin(angle)
    return rotation


def _acceleration(turning: ca.SX, spin: ca.SX, arm: ca.SX) -> ca.SX:
    """Acceleration (3,) of the end of an arm (3,) that turns with ω̇ and ω."""
    return ca.cross(turning, arm) + ca.cross(spin, ca.cross(spin, arm))


def _angle_over_sine(chord: ca.SX) -> ca.SX:
    """atan2(√s, d1)/√s of a chord d (3,), with s the square of its part across E1.

    It is smooth at s = 0, where a series is used.
    """
    ahead, squared = chord[0], ca.sumsqr(chord[1:])
    near = ca.logic_and(squared < _NEAR * ahead**2, ahead > 0)
    ratio = ca.polyval(ca.DM(_SERIES[::-1]), squared / ahead**2) / ahead
    length = ca.sqrt(ca.if_else(near, 1.0, squared))
    return ca.if_else(near, ratio, ca.atan2(length, ahead) / length)
