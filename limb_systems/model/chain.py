"""A chain of revolute joints in symbols: its frames, points, bends and inverse dynamics.

Vectors are in the frame (E1, E2, E3) of the chain's base. Frames of joints are parallel to it when
all angles are zero.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from limb_systems.model.layout import Layout
from limb_systems.model.segment_chain import angles_of, chord, placed
from limb_systems.model.smooth_function import SmoothFunction


class Chain:
    """The joints of a limb at angles θ, as expressions of θ.

    - ``origins``, ``frames``: origin (3,), m, and frame (3, 3) of each joint (n).

    Args:
        layout: axes and offsets of the joints, bodies, and ends and bends of the segments; each
            axis is along E1, E2 or E3, or against it.
        angles: θ (n,), rad.
    """

    def __init__(self, layout: Layout, angles: ca.SX):
        self._layout, self._angles = layout, angles
        self._axes, self.origins, self.frames = placed(layout.axes, layout.offsets, angles)

    def position(self, joint: int, point: np.ndarray) -> ca.SX:
        """The place of a point (3,), m, that is fixed to the frame of a joint there."""
        return self.origins[joint] + self.frames[joint] @ ca.DM(point)

    def bends(self) -> ca.SX:
        """Bends of the segments (F,), rad: the log map of the chord's direction.

        The chord is that from a segment's base to its end, in the frame of its base. In a plane
        its log map is the chord's angle, atan2(t·E2, t·E1).
        """
        layout, base, bends = self._layout, np.zeros(3), []
        for joints, end, of_segment in zip(
            layout.joints_of, layout.end_offset, layout.bends_of, strict=True
        ):
            axes, offsets = layout.axes[joints], layout.offsets[joints]
            direction = chord(axes, offsets, self._angles[joints], end, base)
            bends.append(angles_of(direction, planar=of_segment.stop - of_segment.start == 1))
            base = end  # in the frame of the last joint, from which the next segment starts
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
            zip(self._axes, self.origins, self.frames, strict=True)
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
                moment += ca.cross(self.origins[joint + 1] - self.origins[joint], outboard)
            outboard += forces[joint]
            moment += moments[joint]
            torques.append(ca.dot(self._axes[joint], moment))
        return ca.vertcat(*reversed(torques))


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


def _acceleration(turning: ca.SX, spin: ca.SX, arm: ca.SX) -> ca.SX:
    """Acceleration (3,) of the end of an arm (3,) that turns with ω̇ and ω."""
    return ca.cross(turning, arm) + ca.cross(spin, ca.cross(spin, arm))
