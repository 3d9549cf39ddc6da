"""Kinematics of a limb in numbers: bends and tip of joint angles.

Angles are in rad; `limb_systems.symbolic_chain` defines the frames.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.limb_model import LimbModel
from limb_systems.limb_parameters import LimbParameters
from limb_systems.smooth_function import build_once
from limb_systems.symbolic_chain import tip_position_function


def wrap_angle(angle: Any, turn: float = 2 * np.pi) -> Any:
    """Return an angle, or angles, above minus half a turn and up to half a turn, in its unit."""
    return turn / 2 - (turn / 2 - angle) % turn


def tip_position(parameters: LimbParameters | LimbModel, joint_angles: ArrayLike) -> np.ndarray:
    """Return the tip's position, m: in (E1, E2), or in (E1, E2, E3) if the limb bends in space.

    Args:
        joint_angles: θ, (joints,) or (joints, K).

    Returns:
        (2,) or (2, K); (3,) or (3, K) in space.
    """
    model = LimbModel.of(parameters)
    # The position depends on these properties only.
    shape = [(s.joints, s.centred_joints, s.length) for s in model.parameters.segments]
    tip_of = build_once(("tip", repr(shape)), lambda: tip_position_function(model.mechanics))
    tip = tip_of.values(np.transpose(np.asarray(joint_angles, float))).T
    return tip[:2] if model.layout.is_planar else tip


def bend_angle(parameters: LimbParameters | LimbModel, joint_angles: ArrayLike) -> np.ndarray:
    """Return the bend angles φ of each segment in the frame of its own base, towards E2, then E3.

    Args:
        joint_angles: θ, (joints,) or (joints, K).

    Returns:
        (bends,) or (bends, K), in (-π, π]; of AutoDiffXd or Expression
        if the joint angles are.
    """
    return LimbModel.of(parameters).mechanics.bend_angle(joint_angles)


def joint_angles_from_bend_angle(
    parameters: LimbParameters | LimbModel, bend_angle: ArrayLike
) -> np.ndarray:
    """Return θ_i = 2 φ / (n + 1) for every joint of a bend, eqn (11); 2 φ / n for centred joints.

    The links of a segment are equally long, so this is exact for equal joint
    angles in a plane: the chord of n unit vectors at θ, 2θ, ... nθ points to (n+1)/2 θ.

    Args:
        bend_angle: φ, (bends,) or (bends, K).

    Returns:
        (joints,) or (joints, K).
    """
    return LimbModel.of(parameters).mechanics.shape @ np.asarray(bend_angle, float)
