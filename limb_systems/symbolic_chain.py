"""Kinematics and inverse dynamics of a limb: its chain in symbols, and numbers from it.

Angles are in rad. E1 is the axis of the straight limb, E2 and E3 are lateral. Vectors are in the
frame (E1, E2, E3) of the limb's base, to which the frames of all joints are parallel when all
angles are zero. A bend angle is the angle of the chord from a segment's base to its tip, in the
frame of its base: φ = atan2(t·E2, t·E1) in a plane, and in space the two angles of
`limb_systems.segment_chain.angles_of`.
"""

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from limb_systems.layout import Layout
from limb_systems.limb_parameters import LimbParameters
from limb_systems.segment_chain import angles_of, chord, placed
from limb_systems.smooth_function import Compiled, SmoothFunction, stated_once


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


def tip_of_angles(layout: Layout) -> SmoothFunction:
    """The tip's place in the base's frame (3,), m, of θ (n,), rad."""
    angles = ca.SX.sym("q", layout.num_joints)
    tip = Chain(layout, angles).position(layout.num_joints - 1, layout.end_offset[-1])
    return SmoothFunction(tip, angles)


def _acceleration(turning: ca.SX, spin: ca.SX, arm: ca.SX) -> ca.SX:
    """Acceleration (3,) of the end of an arm (3,) that turns with ω̇ and ω."""
    return ca.cross(turning, arm) + ca.cross(spin, ca.cross(spin, arm))


def link_positions(parameters: LimbParameters, joint_angles: ArrayLike) -> np.ndarray:
    """Where the links begin, and where the last one ends, in the base's frame, m.

    Args:
        joint_angles: θ, (joints,) or (joints, K).

    Returns:
        Positions of the base, of the links' ends in their order, and so of the tip, (P, 3) or
        (P, 3, K). A segment with centred joints has an end more: that of its fixed part.
    """
    shape = [(s.joints, s.centred_joints, s.length) for s in parameters.segments]
    places = stated_once(("places", repr(shape)), lambda: _places(parameters))
    angles = np.asarray(joint_angles, float)
    (flat,) = places(angles)
    return flat.reshape(-1, 3, *angles.shape[1:])


def _places(parameters: LimbParameters) -> Compiled:
    """`link_positions` (3P,) of θ (n,)."""
    layout, angles = Layout(parameters), ca.SX.sym("q", parameters.num_joints)
    chain, places = Chain(layout, angles), [ca.SX(3, 1)]
    for segment, joints, end in zip(
        layout.chains, layout.joints_of, layout.end_offset, strict=True
    ):
        # Where the joints are at the bases of their pieces, the first is where the segment begins.
        first = segment.first_joints[0 if segment.first_length else 1 :]
        places += [chain.origins[joint] for joint in joints.start + first]
        places.append(chain.position(joints.stop - 1, end))
    return Compiled([angles], [ca.densify(ca.vertcat(*places))])


def tip_position(parameters: LimbParameters, joint_angles: ArrayLike) -> np.ndarray:
    """Position of the limb's tip, m: in (E1, E2), or in (E1, E2, E3) if the limb bends in space.

    Args:
        joint_angles: θ, (joints,) or (joints, K).

    Returns:
        (2,) or (2, K); (3,) or (3, K) in space.
    """
    tip = link_positions(parameters, joint_angles)[-1]
    return tip[:2] if Layout(parameters).is_planar else tip


def bend_angle(parameters: LimbParameters, joint_angles: ArrayLike) -> np.ndarray:
    """Bend angles φ of each segment in the frame of its own base, towards E2, then E3.

    Args:
        joint_angles: θ, (joints,) or (joints, K).

    Returns:
        (bends,) or (bends, K), in (-π, π]; of AutoDiffXd or Expression
        if the joint angles are.
    """
    return Layout(parameters).bend_angle(joint_angles)


def joint_angles_from_bend_angle(parameters: LimbParameters, bend_angle: ArrayLike) -> np.ndarray:
    """θ_i = 2 φ / (n + 1) for every joint that makes a bend, eqn (11); 2 φ / n if they are centred.

    The links of a segment are equally long, so this is exact for equal joint
    angles in a plane: the chord of n unit vectors at θ, 2θ, ... nθ points to (n+1)/2 θ.

    Args:
        bend_angle: φ, (bends,) or (bends, K).

    Returns:
        (joints,) or (joints, K).
    """
    return Layout(parameters).shape @ np.asarray(bend_angle, float)


def rest_joint_angles(parameters: LimbParameters) -> np.ndarray:
    """θ (joints,), rad, at which the rubber rests with wires that were never heated, by (11)."""
    rest = [(segment.joints, segment.joint_rest_angles) for segment in parameters.segments]
    return np.array([angles[kind] for links, angles in rest for link in links for kind in link])
