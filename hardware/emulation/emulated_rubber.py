"""Torques on the joints in addition to the wires: nonlinear rubber, and a hand."""

import math

import numpy as np
from pydrake.symbolic import MakeVectorVariable
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import SymbolicVectorSystem
from pydrake.trajectories import Trajectory

from hardware.emulation.specimen import Specimen
from limb_systems import LimbModel, LimbParameters
from limb_systems.drake_python import weak_method
from limb_systems.symbolic_chain import tip_position_function

E1 = np.array([1.0, 0.0, 0.0])  # the axis of the straight limb
GRIP_STIFFNESS_RATIO = 20.0  # stiffness of the hand over the limb's bending stiffness
GRIP_DAMPING_TIME = 0.05  # s, damping over stiffness of the hand


class EmulatedRubber(SymbolicVectorSystem):
    """Silicone that stiffens and relaxes beyond the linear eqn (1), with its angle at rest.

        f = k θ_rest - k s (|θ| / θ_45)² θ - k v (θ - q),   q̇ = (θ - q) / τ

    for each joint, whose angle counts from the described angle at rest. It stiffens by the share
    s at a bend of 45°, where |θ| combines both bends of its link; twists do not stiffen. A spring
    v k in series with a damper makes a standard linear solid together with the manipulator's k.

    - input 0: [θ, θ̇] (2n), rad and rad/s
    - output 0: [f (n), q (n)], N·m and rad
    - state, continuous: q (n) minus its value after the limb's last use, rad,
      because the state of a SymbolicVectorSystem starts at zero
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, specimen: Specimen):
        # Joint angles, relaxed angles and angles at rest, as symbols and numbers.
        parameters = specimen.description
        num_joints = parameters.num_joints
        joint_state = MakeVectorVariable(2 * num_joints, "x")
        state = MakeVectorVariable(num_joints, "q")
        rest = specimen.rest_angles()
        described_rest = LimbModel.of(parameters).mechanics.rest_angles
        with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
            relaxed = state + specimen.state.get("rubber", rest)
            bent = joint_state[:num_joints] - described_rest
        # Torque of each joint, and rate of its relaxed angle.
        force = []
        rate = []
        mechanics = LimbModel.of(specimen.mechanics()).mechanics
        layout = mechanics.layout
        bends = np.flatnonzero(mechanics.shape.any(axis=1))
        for segment, chain, joints in zip(
            specimen.segments, mechanics.chains, layout.joints_of, strict=True
        ):
            angle_at_45 = 2 * np.pi / 4 / (2 / chain.equal_angle)  # joint angle, rad, eqn (11)
            for index in range(joints.start, joints.stop):
                theta = joint_state[index]
                q = relaxed[index]
                spring = rest[index] - described_rest[index]
                if index in bends:
                    link = layout.link_of_joint[index]
                    squared = sum(bent[i] ** 2 for i in bends if layout.link_of_joint[i] == link)
                    spring -= segment.stiffening * (bent[index] * squared) / angle_at_45**2
                stiffness = mechanics.stiffness[index]
                force.append(stiffness * (spring - segment.viscous_share * (theta - q)))
                rate.append((theta - q) / segment.relaxation_time)
        super().__init__(state=state, input=joint_state, dynamics=rate, output=[*force, *relaxed])


class RestShift(LeafSystem):
    """An angle at rest that remembers which wire was hot last.

    While a wire transforms on heating, the angle is drawn towards its side:

        ρ̇ = λ Σ_i max(-ξ̇_i, 0) (±Δ - ρ)

    with the martensite fraction ξ of each wire of the segment, so that a whole transformation
    moves ρ by 1 - exp(-λ) of the way. A segment that bends about two axes has a ρ for each, and
    ±Δ is along the wire's lever. The spring k pulls each joint to its share of ρ, eqn (11).
    Euler's method integrates ρ, with the steps of the wires.

    - input 0 ``wires``: state of `ShapeMemoryWires` (4W)
    - output 0 ``generalized_force``: f (n), N·m
    - output 1 ``state``: as below
    - state, discrete: [ρ (F), ξ (W) at the step before], rad and 1
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, specimen: Specimen, period: float):
        """
        Args:
            specimen: the limb, with the state after its last use.
            period: s, of the steps.
        """
        super().__init__()
        parameters = specimen.description
        mechanics = LimbModel.of(specimen.mechanics()).mechanics
        layout = mechanics.layout
        self._num_wires = layout.num_wires
        self._stiffness = mechanics.stiffness
        self._shape = mechanics.shape
        # λ and ±Δ of each wire (column) on each bend (row).
        self._share = np.zeros((layout.num_bends, layout.num_wires))
        self._target = np.zeros((layout.num_bends, layout.num_wires))
        for bend, number in enumerate(layout.bend_segment):
            segment = specimen.segments[number]
            around = layout.wires_of[number]
            levers = mechanics.levers[layout.bend_joints[bend][0], around]
            # A wire of a planar segment leads to ±Δ, for any inclination of its lever.
            sides = np.sign(levers) if parameters.segments[number].axes == 1 else levers
            self._share[bend, around] = segment.memory_share
            self._target[bend, around] = sides * segment.memory_angle
        unused = np.append(np.zeros(layout.num_bends), np.ones(self._num_wires))
        state = self.DeclareDiscreteState(specimen.state.get("rest", unused))
        self.DeclareVectorInputPort("wires", 4 * self._num_wires)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weak_method(self._step))
        self.DeclareVectorOutputPort(
            "generalized_force",
            parameters.num_joints,
            weak_method(self._calc_force),
            {self.discrete_state_ticket(state)},
        )
        self.DeclareStateOutputPort("state", state)

    def _split(self, context) -> list[np.ndarray]:
        state = context.get_discrete_state_vector().value()
        return np.split(state, [len(state) - self._num_wires])

    def _step(self, context, discrete_state):
        rest, previous_martensite = self._split(context)
        martensite = self.get_input_port().Eval(context).reshape(4, -1)[2]
        transformed = np.maximum(previous_martensite - martensite, 0.0)
        shift = self._share * transformed * (self._target - rest[:, np.newaxis])
        discrete_state.set_value(np.append(rest + shift.sum(axis=1), martensite))

    def _calc_force(self, context, output):
        rest, _ = self._split(context)
        output.SetFromVector(self._stiffness * (self._shape @ rest))


class Hand(LeafSystem):
    """A hand that pushes the limb's tip across its chord to bend it, then releases it.

    It controls the bend angle that an exact sensor of the limb's kind would read. It is stiffer
    than the limb, but not rigid, and holds the limb until the end of its motion. It pushes along
    E2 turned with the chord and, where the limb bends about two axes, also along E3.

    - input 0 ``joint_state``: [θ, θ̇] (2n), rad and rad/s
    - output 0 ``generalized_force``: f (n), N·m

    For limbs of one segment.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, parameters: LimbParameters, motion: Trajectory):
        """
        Args:
            parameters: description of the limb.
            motion: bend angles (F) over time, rad, to which the hand moves the limb.
        """
        super().__init__()
        self._motion = motion
        mechanics = LimbModel.of(parameters).mechanics
        self._num_joints = mechanics.layout.num_joints
        # E2 and, where the limb bends about two axes, E3.
        self._axes = np.eye(3)[1 : 1 + mechanics.layout.num_bends]
        (segment,) = parameters.segments
        (self._segment_chain,) = mechanics.chains
        self._tip = tip_position_function(mechanics)
        # A torque at the tip turns the chord by about (n + 1) / 2 joints' worth of angle.
        self._stiffness = GRIP_STIFFNESS_RATIO * segment.stiffness * self._segment_chain.equal_angle
        self._length = segment.length
        self._sensor = segment.bend_sensor
        self.DeclareVectorInputPort("joint_state", 2 * parameters.num_joints)
        self.DeclareVectorOutputPort(
            "generalized_force", parameters.num_joints, weak_method(self._calc_force)
        )

    def _calc_force(self, context, output):
        """Set the torques on the joints, N·m, by which the hand pushes the tip; 0 after its motion.

        The hand acts as a spring and damper between the bend of the motion and the present bend.
        """
        time = context.get_time()
        if time >= self._motion.end_time():
            output.SetZero()
            return
        # Find the directions across the chord from base to tip, in which the hand pushes: E2 and E3
        # after the least rotation that turns E1 along the chord.
        joint_state = self.get_input_port().Eval(context)
        angles = joint_state[: self._num_joints]
        rates = joint_state[self._num_joints :]
        chord, tip_jacobian = self._tip.first(angles)
        along = chord / math.sqrt(chord @ chord)
        tilt = self._axes @ along / (1 + along[0])
        across = self._axes - tilt[:, np.newaxis] * (along + E1)
        # Motion of the tip along these directions by each joint (F, n), m/rad.
        jacobian = across @ tip_jacobian
        # Push, N, by the error of the bend, rad, and the rate of the tip over the length, rad/s.
        bend = self._sensor.exact_bends(self._segment_chain, angles)
        error = self._motion.value(time).ravel() - bend
        rate = jacobian @ rates / self._length
        push = self._stiffness * (error - GRIP_DAMPING_TIME * rate) / self._length
        output.SetFromVector(push @ jacobian)
