"""What turns the joints beside the wires: rubber beyond the linear eqn (1), and a hand."""

import numpy as np
from pydrake.symbolic import MakeVectorVariable
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import SymbolicVectorSystem
from pydrake.trajectories import Trajectory

from hardware.emulation.specimen import Specimen
from limb_systems import Layout, LimbParameters, joint_angles_from_bend_angle
from limb_systems.model.kinematics import rest_joint_angles
from limb_systems.model.ownership import weak_method

GRIP = 20.0  # stiffness of the hand over bending stiffness of the limb
GRIP_TIME = 0.05  # s, of the hand's damping


class EmulatedRubber(SymbolicVectorSystem):
    """Stiffening and relaxation of silicone, and its angle at rest.

        f = k θ_rest - k s (θ / θ_45)² θ - k v (θ - q),   q̇ = (θ - q) / τ

    for each joint, whose angles count from where it rests as described:
    stiffening by the share s at a bend of 45°, and a spring v k in series with a
    damper, which make a standard linear solid together with the k of the manipulator.

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
        rest, described = specimen.rest_angles(), rest_joint_angles(parameters)
        force, rate = [], []
        for segment, joints in zip(specimen.segments, Layout(parameters).joints_of, strict=True):
            links = joints.stop - joints.start
            at_45 = 2 * np.pi / 4 / (links + 1)  # eqn (11)
            for index in range(joints.start, joints.stop):
                theta, q, zero = joint_state[index], relaxed[index], described[index]
                spring = rest[index] - zero - segment.stiffening * (theta - zero) ** 3 / at_45**2
                force.append(segment.stiffness * (spring - segment.viscous_share * (theta - q)))
                rate.append((theta - q) / segment.relaxation_time)
        super().__init__(state=state, input=joint_state, dynamics=rate, output=[*force, *relaxed])
        self.set_name("rubber")


class RestShift(LeafSystem):
    """Angle at rest that remembers which wire was hot last.

    While a wire transforms on heating, the angle is drawn towards its side:

        ρ̇ = λ Σ_i max(-ξ̇_i, 0) (±Δ - ρ)

    with the martensite fraction ξ of each wire of the segment, so that a whole
    transformation makes up for 1 - exp(-λ) of the way. The force on each joint is
    that of the spring k to ρ, eqn (11). Integrated by Euler's method, with the steps
    of the wires.

    - input 0 ``wires``: state of `ShapeMemoryWires` (4W)
    - output 0 ``generalized_force``: f (n), N·m
    - output 1 ``state``: as below
    - state, discrete: [ρ (S), ξ (W) at the step before], rad and 1
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, specimen: Specimen, period: float):
        """
        Args:
            specimen: the limb, with the state after its last use.
            period: s, of the steps.
        """
        super().__init__()
        parameters, physics = specimen.description, specimen.segments
        self._parameters, self._num_wires = parameters, len(specimen.wires)
        stiffness = [segment.stiffness for segment in physics]
        links = [segment.links for segment in parameters.segments]
        self._stiffness = np.repeat(stiffness, links)
        # Rows are segments: what a wire's transformation draws each by, and from where.
        self._share = np.zeros((len(physics), self._num_wires))
        self._target = np.zeros_like(self._share)
        for index, (segment, around) in enumerate(
            zip(physics, Layout(parameters).wires_of, strict=True)
        ):
            sides = np.sign([wire.lever[0] for wire in parameters.segments[index].wires])
            self._share[index, around] = segment.memory_share
            self._target[index, around] = sides * segment.memory_angle
        unused = np.append(np.zeros(len(physics)), np.ones(self._num_wires))
        state = self.DeclareDiscreteState(specimen.state.get("rest", unused))
        self.DeclareVectorInputPort("wires", 4 * self._num_wires)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weak_method(self._step))
        self.DeclareVectorOutputPort(
            "generalized_force",
            parameters.num_joints,
            weak_method(self._calc),
            {self.discrete_state_ticket(state)},
        )
        self.DeclareStateOutputPort("state", state)
        self.set_name("rest_shift")

    def _split(self, context) -> list[np.ndarray]:
        state = context.get_discrete_state_vector().value()
        return np.split(state, [len(state) - self._num_wires])

    def _step(self, context, discrete_state):
        rest, before = self._split(context)
        martensite = self.get_input_port().Eval(context).reshape(4, -1)[2]
        transformed = np.maximum(before - martensite, 0.0)
        drawn = self._share * transformed * (self._target - rest[:, np.newaxis])
        discrete_state.set_value(np.append(rest + drawn.sum(axis=1), martensite))

    def _calc(self, context, output):
        rest, _ = self._split(context)
        output.SetFromVector(self._stiffness * joint_angles_from_bend_angle(self._parameters, rest))


class Hand(LeafSystem):
    """Pushes the limb's tip across its chord until its bend is as wanted, then releases it.

    The bend is what an exact sensor of the limb's kind would show. Like a hand it is stiffer
    than the limb, but not rigid. It holds the limb until the end of its motion.

    - input 0 ``joint_state``: [θ, θ̇] (2n), rad and rad/s
    - output 0 ``generalized_force``: f (n), N·m

    For limbs of one segment.
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters, motion: Trajectory):
        """
        Args:
            parameters: description of the limb.
            motion: bend angle over time, rad, to which the hand moves the limb.
        """
        super().__init__()
        self._parameters, self._motion = parameters, motion
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
        if time >= self._motion.end_time():
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
        error = self._motion.value(time).item() - self._sensor.exact_bend_angle(angles)
        rate = jacobian @ rates / self._length
        force = self._stiffness * (error - GRIP_TIME * rate) / self._length
        output.SetFromVector(jacobian * force)
