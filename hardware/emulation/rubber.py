"""The emulated rubber: its effects beyond the linear spring and damper of eqn (1)."""

import numpy as np
from pydrake.symbolic import MakeVectorVariable
from pydrake.systems.primitives import SymbolicVectorSystem

from hardware.emulation.specimen import Specimen


class Rubber(SymbolicVectorSystem):
    """Stiffening and relaxation of silicone, and its angle at rest.

        f = k θ_rest - k s (θ / θ_45)² θ - k v (θ - q),   q̇ = (θ - q) / τ

    for each joint: stiffening by the share s at a bend of 45°, and a spring v k
    in series with a damper, which make a standard linear solid together with the
    k of the manipulator.

    - input 0: [θ, θ̇] (2n), rad and rad/s
    - output 0: [f (n), q (n)], N·m and rad
    - state, continuous: q (n) minus its value after the limb's last use, rad,
      because the state of a SymbolicVectorSystem starts at zero
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, specimen: Specimen):
        parameters = specimen.description
        num_joints = parameters.num_joints
        joint_state = MakeVectorVariable(2 * num_joints, "x")
        state = MakeVectorVariable(num_joints, "q")
        with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
            relaxed = state + specimen.state.get("rubber", specimen.rest_angles())
        force, rate = [], []
        for segment, joints in zip(specimen.segments, parameters.joint_slices, strict=True):
            links = joints.stop - joints.start
            at_45 = 2 * np.pi / 4 / (links + 1)  # eqn (11)
            rest = specimen.rest_angles()[joints]
            for theta, q, origin in zip(joint_state[joints], relaxed[joints], rest, strict=True):
                spring = origin - segment.stiffening * theta**3 / at_45**2
                force.append(segment.stiffness * (spring - segment.viscous_share * (theta - q)))
                rate.append((theta - q) / segment.relaxation_time)
        super().__init__(state=state, input=joint_state, dynamics=rate, output=[*force, *relaxed])
        self.set_name("rubber")
