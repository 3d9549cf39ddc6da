"""Where Drake's plant of a limb has its links."""

import numpy as np

from limb_systems import LimbModel, LimbParameters, make_manipulator


def link_positions(parameters: LimbParameters, joint_angles: np.ndarray) -> np.ndarray:
    """The beginning of each piece, base first, and the tip, m (P, 3)."""
    plant = make_manipulator(parameters)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, joint_angles)
    frames = []
    for pieces in LimbModel(parameters).mechanics.pieces:
        frames += [plant.GetFrameByName(body) for body, _ in pieces]
    frames.append(plant.GetFrameByName("tip"))
    return np.array([frame.CalcPoseInWorld(context).translation() for frame in frames])
