"""From wire temperature to joint torque, eqn (4)."""

import numpy as np
from pydrake.symbolic import DecomposeAffineExpressions
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import AffineSystem, Multiplexer, SymbolicVectorSystem

from limb_systems.model.parameters import LimbParameters
from limb_systems.model.wires import Wires, as_expressions, make_expressions


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
        state = make_expressions("x", wires.num_states)
        joints = make_expressions("q", 2 * num_joints if wires.torque_needs_angle else 0)
        angles = joints[:num_joints] if len(joints) else np.zeros(num_joints)
        with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
            forces = as_expressions(wires.forces(state, angles))
        symbols = [next(iter(v.GetVariables())) for v in (*state, *joints)]

        builder = DiagramBuilder()
        if wires.torque_is_affine:
            matrix, offset = DecomposeAffineExpressions(forces, symbols)
            function = builder.AddSystem(
                AffineSystem(
                    A=np.zeros((0, 0)),
                    B=np.zeros((0, len(symbols))),
                    f0=np.zeros(0),
                    C=np.zeros((num_joints, 0)),
                    D=matrix,
                    y0=offset,
                )
            )
        else:
            function = builder.AddSystem(
                SymbolicVectorSystem(input=np.array(symbols), output=forces)
            )
        if len(joints):
            join = builder.AddSystem(Multiplexer([len(state), len(joints)]))
            builder.Connect(join.get_output_port(), function.get_input_port())
            builder.ExportInput(join.get_input_port(0), "wire_state")
            builder.ExportInput(join.get_input_port(1), "joint_state")
        else:
            builder.ExportInput(function.get_input_port(), "wire_state")
        builder.ExportOutput(function.get_output_port(), "generalized_force")
        builder.BuildInto(self)
        self.set_name("torque_map")
