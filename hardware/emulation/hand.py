"""A hand that bends the emulated limb: to let it ring down, or to teach it."""

import numpy as np
from pydrake.systems.framework import LeafSystem
from pydrake.trajectories import Trajectory

from limb_systems import LimbParameters
from limb_systems.model.ownership import weak_method

GRIP = 20.0  # stiffness of the hand over bending stiffness of the limb
GRIP_TIME = 0.05  # s, of the hand's damping


class Hand(LeafSystem):
    """Pushes the limb's tip across its chord until its bend is as wanted, then releases it.

    The bend is what an exact sensor of the limb's kind would show.

    Like a hand it is stiffer than the limb, but not rigid. It holds the limb
    until the end of its course.

    - input 0 ``joint_state``: [θ, θ̇] (2n), rad and rad/s
    - output 0 ``generalized_force``: f (n), N·m

    For limbs of one segment.
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters, course: Trajectory):
        """
        Args:
            parameters: of the limb.
            course: bend angle over time, rad, to which the hand moves the limb.
        """
        super().__init__()
        self._parameters, self._course = parameters, course
        (segment,) = parameters.segments
        # A torque at the tip turns the chord by about (n + 1) / 2 joints' worth of angle.
        self._stiffness = GRIP * segment.stiffness * 2 / (segment.links + 1)
        self._length, self._sensor = segment.length, segment.bend_sensor
        self.DeclareVectorInputPort("joint_state", 2 * parameters.num_joints)
        self.DeclareVectorOutputPort(
            "generalized_force", parameters.num_joints, weak_method(self._calc)
        )
        self.set_name("hand")

    def _calc(self, context, output):
        num_joints = self._parameters.num_joints
        time = context.get_time()
        if time >= self._course.end_time():
            output.SetFromVector(np.zeros(num_joints))
            return
        angles, rates = np.split(self.get_input_port().Eval(context), 2)
        # The tip as seen from each joint, and a force across the chord of the whole limb.
        directions = np.cumsum(angles)
        links = self._length / num_joints * np.array([np.cos(directions), np.sin(directions)])
        lever = np.cumsum(links[:, ::-1], axis=1)[:, ::-1]
        chord = lever[:, 0]
        across = np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
        jacobian = lever[0] * across[1] - lever[1] * across[0]  # of the tip, along `across`
        error = self._course.value(time).item() - self._sensor.exact_bend_angle(angles)
        rate = jacobian @ rates / self._length
        force = self._stiffness * (error - GRIP_TIME * rate) / self._length
        output.SetFromVector(jacobian * force)
