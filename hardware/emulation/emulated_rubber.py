"""What turns the joints beside the wires: rubber beyond the linear eqn (1), and a hand."""

import numpy as np
from pydrake.symbolic import MakeVectorVariable
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import SymbolicVectorSystem
from pydrake.trajectories import Trajectory

from hardware.emulation.specimen import Specimen
from limb_systems import LimbModel, LimbParameters
from limb_systems.drake_python import weak_method
from limb_systems.kinematics import rest_joint_angles
from limb_systems.symbolic_chain import tip_position_function

GRIP = 20.0  # stiffness of the hand over bending stiffness of the limb
GRIP_TIME = 0.05  # s, of the hand's damping


class EmulatedRubber(SymbolicVectorSystem):
    """Stiffening and relaxation of silicone, and its angle at rest.

        f = k θ_rest - k s (|θ| / θ_45)² θ - k v (θ - q),   q̇ = (θ - q) / τ

    for each joint, whose angles count from where it rests as described:
    stiffening by the share s at a bend of 45°, where |θ| is that of both bends of its link, and
    a spring v k in series with a damper, which make a standard linear solid together with the k
    of the manipulator. Twists do not stiffen.

    - input 0: [θ, θ̇] (2n), rad and rad/s
    - output 0: [f (n), q (n)], N·m and rad
    - state, continuous: q (n) minus its value after the limb's last use, rad,
      because the state of a SymbolicVectorSystem starts at zero
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, specimen: Specimen):
        parameters = specimen.description
        num_joints = parameters.num_joints
        joint_state = MakeVectorVariable(2 * num_joints, "x")
        state = MakeVectorVariable(num_joints, "q")
        rest, described = specimen.rest_angles(), rest_joint_angles(parameters)
        with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
            relaxed = state + specimen.state.get("rubber", specimen.rest_angles())
            bent = joint_state[:num_joints] - described
        force, rate = [], []
        mechanics = LimbModel.of(specimen.mechanics()).mechanics
        layout = mechanics.layout
        bends = np.flatnonzero(mechanics.shape.any(axis=1))
        for segment, chain, joints in zip(
            specimen.segments, mechanics.chains, layout.joints_of, strict=True
        ):
            at_45 = 2 * np.pi / 4 / (2 / chain.equal_angle)  # eqn (11)
            for index in range(joints.start, joints.stop):
                theta, q, link = joint_state[index], relaxed[index], layout.link_of_joint[index]
                spring = rest[index] - described[index]
                if index in bends:
                    squared = sum(bent[i] ** 2 for i in bends if layout.link_of_joint[i] == link)
                    spring -= segment.stiffening * (bent[index] * squared) / at_45**2
                stiffness = mechanics.stiffness[index]
                force.append(stiffness * (spring - segment.viscous_share * (theta - q)))
                rate.append((theta - q) / segment.relaxation_time)
        super().__init__(state=state, input=joint_state, dynamics=rate, output=[*force, *relaxed])


class RestShift(LeafSystem):
    """Angle at rest that remembers which wire was hot last.

    While a wire transforms on heating, the angle is drawn towards its side:

        ρ̇ = λ Σ_i max(-ξ̇_i, 0) (±Δ - ρ)

    with the martensite fraction ξ of each wire of the segment, so that a whole
    transformation makes up for 1 - exp(-λ) of the way. Where a segment bends about two axes, it
    has a ρ for each, and ±Δ is along the wire's lever. The force on each joint is
    that of the spring k to ρ, eqn (11). Integrated by Euler's method, with the steps
    of the wires.

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
        parameters, physics = specimen.description, specimen.segments
        mechanics = LimbModel.of(specimen.mechanics()).mechanics
        layout = mechanics.layout
        self._num_wires, self._stiffness = layout.num_wires, mechanics.stiffness
        self._shape = mechanics.shape
        # Rows are bends: what a wire's transformation draws each by, and from where.
        self._share, self._target = np.zeros((2, layout.num_bends, layout.num_wires))
        for bend, number in enumerate(layout.bend_segment):
            segment, around = physics[number], layout.wires_of[number]
            levers = mechanics.levers[layout.bend_joints[bend][0], around]
            # A wire of a planar segment leads to ±Δ, however its lever is inclined.
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
            weak_method(self._calc),
            {self.discrete_state_ticket(state)},
        )
        self.DeclareStateOutputPort("state", state)

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
        output.SetFromVector(self._stiffness * (self._shape @ rest))


class Hand(LeafSystem):
    """Pushes the limb's tip across its chord until its bend is as wanted, then releases it.

    The bend is what an exact sensor of the limb's kind would show. Like a hand it is stiffer
    than the limb, but not rigid. It holds the limb until the end of its motion. Where the limb
    bends about two axes, it pushes for each along where E2 or E3 is turned to with the chord.

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
        self._layout = mechanics.layout
        (segment,), (self._segment_chain,) = parameters.segments, mechanics.chains
        self._tip = tip_position_function(mechanics)
        # A torque at the tip turns the chord by about (n + 1) / 2 joints' worth of angle.
        self._stiffness = GRIP * segment.stiffness * self._segment_chain.equal_angle
        self._length, self._sensor = segment.length, segment.bend_sensor
        self.DeclareVectorInputPort("joint_state", 2 * parameters.num_joints)
        self.DeclareVectorOutputPort(
            "generalized_force", parameters.num_joints, weak_method(self._calc)
        )

    def _calc(self, context, output):
        time, num_joints = context.get_time(), self._layout.num_joints
        if time >= self._motion.end_time():
            output.SetFromVector(np.zeros(num_joints))
            return
        angles, rates = np.split(self.get_input_port().Eval(context), 2)
        chord, slopes = self._tip.first(angles)
        along = chord / np.linalg.norm(chord)
        # The least rotation that turns E1 along the chord, of E2 and E3.
        across = np.eye(3)[1:] - np.outer(along[1:], along + np.eye(3)[0]) / (1 + along[0])
        jacobian = across[: self._layout.num_bends] @ slopes  # of the tip, along `across`
        bend = self._sensor.exact_bends(self._segment_chain, angles)
        error = self._motion.value(time).ravel() - bend
        rate = jacobian @ rates / self._length
        output.SetFromVector(self._stiffness * (error - GRIP_TIME * rate) / self._length @ jacobian)
