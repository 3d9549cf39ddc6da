"""Kinematics and inverse dynamics of a limb: its chain of joints in symbols.

Angles are in rad. E1 is the axis of the straight limb, E2 and E3 are lateral. Vectors are in the
frame (E1, E2, E3) of the limb's base, to which the frames of all joints are parallel when all
angles are zero. A bend angle is the angle of the chord from a segment's base to its tip, in the
frame of its base: φ = atan2(t·E2, t·E1) in a plane, and in space the two angles of
`limb_systems.segment_chain.log_map_angles`.
"""

import casadi as ca
import numpy as np

from limb_systems.limb_mechanics import LimbMechanics
from limb_systems.segment_chain import chord, joint_poses, log_map_angles
from limb_systems.smooth_function import SmoothFunction


class Chain:
    """The joints of a limb at angles θ, as expressions of θ.

    - ``origins``, ``frames``: origin (3,), m, and frame (3, 3) of each joint (n).

    Args:
        mechanics: joints and bodies; each axis is along E1, E2 or E3, or against it.
        angles: θ (n,), rad.
    """

    def __init__(self, mechanics: LimbMechanics, angles: ca.SX):
        self._mechanics = mechanics
        self._angles = angles
        self._axes, self.origins, self.frames = joint_poses(
            mechanics.axes, mechanics.offsets, angles
        )

    def position(self, joint: int, point: np.ndarray) -> ca.SX:
        """Return the position (3,), m, of a point (3,), m, in the frame of a joint."""
        return self.origins[joint] + self.frames[joint] @ ca.DM(point)

    def bends(self) -> ca.SX:
        """Return the bends of the segments (F,), rad: the log map of the chord's direction.

        The chord is from a segment's base to its end, in the frame of its base. In a plane
        its log map is the chord's angle, atan2(t·E2, t·E1).
        """
        mechanics = self._mechanics
        layout = mechanics.layout
        base = np.zeros(3)
        bends = []
        for joints, end, of_segment in zip(
            layout.joints_of, mechanics.end_offset, layout.bends_of, strict=True
        ):
            axes = mechanics.axes[joints]
            offsets = mechanics.offsets[joints]
            direction = chord(axes, offsets, self._angles[joints], end, base)
            bends.append(log_map_angles(direction, planar=of_segment.stop - of_segment.start == 1))
            base = end  # in the frame of the last joint, from which the next segment starts
        return ca.vertcat(*bends)

    def inverse_dynamics(self, rates: ca.SX, accelerations: ca.SX, gravity: ca.SX | ca.DM) -> ca.SX:
        """Return the torques on the joints (n,), N·m: the inertia and gravity side of eqn (2).

        By the recursive Newton-Euler method: velocities and accelerations from the base outward,
        then forces inward. Gravity is an upward acceleration of the base.

        Args:
            rates, accelerations: θ̇ and θ̈ (n,), rad/s and rad/s².
            gravity: (3,), m/s².
        """
        mechanics = self._mechanics
        num_joints = len(self.origins)
        # From the base outward, find the motion of each joint and the forces on its bodies.
        spin = turning = previous_origin = ca.SX(3, 1)  # ω, ω̇, and the origin of the joint before
        moved = -gravity
        # Of the bodies on each joint, about its origin.
        forces = []
        moments = []
        for joint, (axis, origin, frame) in enumerate(
            zip(self._axes, self.origins, self.frames, strict=True)
        ):
            moved += _acceleration(turning, spin, origin - previous_origin)
            turning += axis * accelerations[joint] + ca.cross(spin, axis * rates[joint])
            spin += axis * rates[joint]
            previous_origin = origin
            force = ca.SX(3, 1)
            moment = ca.SX(3, 1)
            for body in np.flatnonzero(mechanics.body_joints == joint).tolist():
                centre = frame @ ca.DM(mechanics.body_centres[body])
                pull = mechanics.body_masses[body] * (moved + _acceleration(turning, spin, centre))
                inertia = frame @ ca.diag(ca.DM(mechanics.body_moments[body])) @ frame.T
                force += pull
                moment += inertia @ turning + ca.cross(spin, inertia @ spin)
                moment += ca.cross(centre, pull)
            forces.append(force)
            moments.append(moment)
        # From the tip inward, add the forces up.
        torques = []
        outboard = ca.SX(3, 1)
        moment = ca.SX(3, 1)
        for joint in reversed(range(num_joints)):
            if joint + 1 < num_joints:
                moment += ca.cross(self.origins[joint + 1] - self.origins[joint], outboard)
            outboard += forces[joint]
            moment += moments[joint]
            torques.append(ca.dot(self._axes[joint], moment))
        return ca.vertcat(*reversed(torques))


def tip_position_function(mechanics: LimbMechanics) -> SmoothFunction:
    """Return the tip's position in the base's frame (3,), m, as a function of θ (n,), rad."""
    num_joints = mechanics.layout.num_joints
    angles = ca.SX.sym("q", num_joints)
    tip = Chain(mechanics, angles).position(num_joints - 1, mechanics.end_offset[-1])
    return SmoothFunction(tip, angles)


def _acceleration(turning: ca.SX, spin: ca.SX, arm: ca.SX) -> ca.SX:
    """Return the acceleration (3,) of the end of an arm (3,) that turns with ω̇ and ω."""
    return ca.cross(turning, arm) + ca.cross(spin, ca.cross(spin, arm))
