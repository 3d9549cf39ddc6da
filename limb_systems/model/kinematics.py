"""Forward kinematics of the limb and the conversion of eqn (11).

Angles are in rad. E1 is the axis of the straight limb, E2 and E3 are lateral.
A bend angle is that of the chord from a segment's base to its tip, in the
frame of its base: φ = atan2(t·E2, t·E1) in a plane, and in space the two
angles of `limb_systems.model.segment_chain.angles_of`.
"""

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from limb_systems.model.chain import Chain
from limb_systems.model.layout import Layout
from limb_systems.model.parameters import LimbParameters
from limb_systems.model.smooth_function import Compiled, stated_once


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
    rest = [
        angle
        for segment in parameters.segments
        for angle in (segment.rest_angle, segment.rest_angle_e3)[: segment.axes]
    ]
    return joint_angles_from_bend_angle(parameters, rest)
