"""From wire temperature to joint torque, eqn (4)."""

import numpy as np
from pydrake.systems.primitives import AffineSystem

from limb_systems.model.parameters import LimbParameters


def torque_matrix(parameters: LimbParameters) -> np.ndarray:
    """Joint torque per degree above ambient, (joints, wires), N·m/°C.

    Each joint of a segment feels -β of its left wire and +β of its right one.
    """
    matrix = np.zeros((parameters.num_joints, len(parameters.wires)))
    for index, (segment, joints) in enumerate(
        zip(parameters.segments, parameters.joint_slices, strict=True)
    ):
        matrix[joints, 2 * index] = -segment.left.beta
        matrix[joints, 2 * index + 1] = segment.right.beta
    return matrix


class TorqueMap(AffineSystem):
    """Generalized force of the wires on the joints, eqn (4).

        f(T) = β_r (T_r - T0) 1 - β_l (T_l - T0) 1   for each segment

    - input 0: wire temperature T (wires), °C
    - output 0: generalized force f (joints), N·m
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: of the limb, for its wires.
        """
        matrix = torque_matrix(parameters)
        num_joints, num_wires = matrix.shape
        super().__init__(
            A=np.zeros((0, 0)),
            B=np.zeros((0, num_wires)),
            f0=np.zeros(0),
            C=np.zeros((num_joints, 0)),
            D=matrix,
            y0=-matrix @ np.full(num_wires, parameters.ambient_temperature),
        )
        self.set_name("torque_map")
