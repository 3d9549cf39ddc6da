"""From wire temperature to joint torque, eqn (4)."""

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import AffineSystem, MatrixGain

from limb_systems.model.law_function import LawFunction
from limb_systems.model.parameters import LimbParameters
from limb_systems.model.wires import Wires


class TorqueMap(Diagram):
    """Generalized force of the wires on the joints, eqn (4).

        f(T) = β_r (T_r - T0) 1 - β_l (T_l - T0) 1   for each segment,

    or what the wires' laws say, each in the direction of its wire's lever.

    - input 0 ``wire_state``: x (N), as that of `JouleHeating`
    - input 1 ``joint_state``: [θ, θ̇] (2n), rad and rad/s; only where a law's
      torque depends on the joint's angle
    - output 0 ``generalized_force``: f (n), N·m
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: of the limb, for its wires.
        """
        super().__init__()
        wires, num_joints = Wires(parameters), parameters.num_joints
        builder, num_states = DiagramBuilder(), wires.num_states
        if wires.torque_is_affine and not wires.torque_needs_angle:
            straight, cold = np.zeros(num_joints), np.zeros(num_states)
            matrix = wires.force_derivatives(cold, straight)[0].reshape(num_joints, num_states)
            function = builder.AddSystem(
                AffineSystem(
                    A=np.zeros((0, 0)),
                    B=np.zeros((0, num_states)),
                    f0=np.zeros(0),
                    C=np.zeros((num_joints, 0)),
                    D=matrix,
                    y0=wires.forces(cold, straight),
                )
            )
        elif wires.torque_needs_angle:
            function = builder.AddSystem(
                LawFunction(wires.forces, [num_states, num_joints], num_joints)
            )
            angles = builder.AddSystem(MatrixGain(np.eye(num_joints, 2 * num_joints)))
            builder.Connect(angles.get_output_port(), function.get_input_port(1))
        else:
            angles_do_not_matter = np.zeros(num_joints)
            function = builder.AddSystem(
                LawFunction(
                    lambda states: wires.forces(states, angles_do_not_matter),
                    [num_states],
                    num_joints,
                )
            )
        builder.ExportInput(function.get_input_port(0), "wire_state")
        if wires.torque_needs_angle:
            builder.ExportInput(angles.get_input_port(), "joint_state")
        builder.ExportOutput(function.get_output_port(), "generalized_force")
        builder.BuildInto(self)
        self.set_name("torque_map")
