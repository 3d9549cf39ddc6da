"""Forward kinematics of the planar chain and the conversion of eqn (11).

Angles are in rad. E1 is the axis of the straight limb, E2 the lateral axis.
A bend angle is that of the chord from a segment's base to its tip, in the
frame of its base: φ = atan2(t·E2, t·E1).
"""

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.model.bend_sensor import chord_angle
from limb_systems.model.parameters import LimbParameters


def tip_position(parameters: LimbParameters, joint_angles: ArrayLike) -> np.ndarray:
    """Position of the limb's tip in (E1, E2), m.

    Args:
        joint_angles: θ, (joints,) or (joints, K).

    Returns:
        (2,) or (2, K).
    """
    lengths = [
        segment.length / segment.links
        for segment in parameters.segments
        for _ in range(segment.links)
    ]
    link_angles = np.cumsum(np.asarray(joint_angles, float), axis=0)
    return np.array([lengths @ np.cos(link_angles), lengths @ np.sin(link_angles)])


def bend_angle(parameters: LimbParameters, joint_angles: ArrayLike) -> np.ndarray:
    """Bend angle φ of each segment in the frame of its own base.

    Args:
        joint_angles: θ, (joints,) or (joints, K).

    Returns:
        (segments,) or (segments, K), in (-π, π]; of AutoDiffXd or Expression
        if the joint angles are.
    """
    joint_angles = np.asarray(joint_angles)
    return np.array([chord_angle(joint_angles[joints]) for joints in parameters.joint_slices])


def joint_angles_from_bend_angle(parameters: LimbParameters, bend_angle: ArrayLike) -> np.ndarray:
    """θ_i = 2 φ / (n + 1) for every joint of a segment, eqn (11).

    The links of a segment are equally long, so this is exact for equal joint
    angles: the chord of n unit vectors at θ, 2θ, ... nθ points to (n+1)/2 θ.

    Args:
        bend_angle: φ, (segments,) or (segments, K).

    Returns:
        (joints,) or (joints, K).
    """
    bend_angle = np.asarray(bend_angle, float)
    links = [segment.links for segment in parameters.segments]
    per_joint = [2 * angle / (n + 1) for angle, n in zip(bend_angle, links, strict=True)]
    return np.repeat(per_joint, links, axis=0)


def rest_joint_angles(parameters: LimbParameters) -> np.ndarray:
    """θ (joints,), rad, at which the rubber rests with wires that were never heated, by (11)."""
    return joint_angles_from_bend_angle(parameters, [s.rest_angle for s in parameters.segments])
