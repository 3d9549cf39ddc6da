"""From wire temperature to joint torque, eqn (4)."""

import numpy as np
from pydrake.systems.primitives import AffineSystem

from limb_systems.model.parameters import LimbParameters, ParameterError
from limb_systems.model.wires import Wires


class TorqueMap(AffineSystem):
    """Generalized force of the wires on the joints, eqn (4).

        f(T) = β_r (T_r - T0) 1 - β_l (T_l - T0) 1   for each segment

    Each wire's torque has the direction of its lever. For laws whose torque is
    linear; `LawFunction` takes its place for others.

    - input 0: x (N) of the wires, which begins with T (W), °C
    - output 0: generalized force f (n), N·m
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: of the limb, for its wires.

        Raises:
            ParameterError: if the torque of a wire is not linear.
        """
        wires, n = Wires(parameters), parameters.num_joints
        if not wires.torque_is_affine:
            raise ParameterError(
                "The torque of a wire of this limb is not linear in its temperature; use "
                "LawFunction in place of TorqueMap."
            )
        nothing, straight = np.zeros(wires.num_states), np.zeros(n)
        matrix, _ = wires.force_derivatives(nothing, straight)
        super().__init__(
            A=np.zeros((0, 0)),
            B=np.zeros((0, wires.num_states)),
            f0=np.zeros(0),
            C=np.zeros((n, 0)),
            D=matrix,
            y0=wires.forces(nothing, straight),
        )
        self.set_name("torque_map")
