"""Robots of several limbs, on a ground or without one, as one Drake diagram."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.eigen_geometry import Quaternion
from pydrake.common.value import Value
from pydrake.geometry import AddContactMaterial, Box, ProximityProperties
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import FixedOffsetFrame, PlanarJoint, RevoluteJoint
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    InputPort,
    InputPortIndex,
    LeafSystem,
    OutputPort,
    System,
)
from pydrake.systems.primitives import MatrixGain, PortSwitch

from limb_systems.contact import NEAR_RIGID_THRESHOLD, TIME_STEP, ContactForces
from limb_systems.drake_python import weak_method
from limb_systems.limb import add_joint_springs, check_time_step
from limb_systems.limb_parameters import LimbParameters
from limb_systems.limb_system import ACCURACY
from limb_systems.wire_blocks import VectorFunction, add_wire_blocks
from urdf import robot_urdf
from urdf.generate import CONTACT_STIFFNESS, RELAXATION_TIME
from walking.robot_parameters import RobotParameters

GROUND_SIZE = 200.0, 200.0, 1.0  # m, of a box about the origin, of whose half space Drake warns
PLANE_ROTATION = RotationMatrix(
    np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
)  # x, z, -y


class Robot(Diagram):
    """A robot of L limbs on a body: duty in; temperatures, bends, pose and contact forces out.

    All limbs and the body are one MultibodyPlant. On a ground, it is discrete, with steps of
    1 ms and Drake's SAP contact; else it is continuous. Its wires are like the wires of `Limb`. A
    robot of one welded limb without a ground equals that limb.

    For F bends, n joints, W wires and N states of wires in all, the first limb's first:

    - input 0 ``duty``: D (W), in [0, 1]
    - inputs 1 to L, ``rear.duty`` and so on with each limb's name: D of its wires, which is taken
      in place of its part of ``duty`` if it is connected; then ``duty`` may be left unconnected
    - output 0 ``measured_temperature``: V (W), °C
    - output 1 ``bend_angle``: φ (F), rad
    - output 2 ``wire_temperature``: T (W), °C
    - output 3 ``joint_state``: [θ, θ̇] (2n), rad and rad/s, of the limbs' joints
    - output 4 ``measurement``: [V (W), φ (F)], °C and rad
    - outputs ``rear.measured_temperature``, ``rear.bend_angle`` and so on: the signals of each limb
    - output ``body_pose``, unless the body is welded: x, z, m, and θ, rad, from +x towards +z, in
      the plane; or x, y, z, m, and roll, pitch and yaw, rad
    - output ``contact_force``, if there is a ground: force from the ground on each foot, N, along x
      and z (2L), or along x, y and z (3L) if the body is not planar; over the mechanics' step that
      begins with the state that there is
    - state: [positions, velocities] of the plant, the body's first, and x (N), V (W) of the wires;
      by default at rest, at the rest angles, at ambient temperature, with the lowest foot of
      straight limbs at the ground; limbs that differ then first settle
    """

    __slots__ = ()  # see limb_systems.drake_python

    is_model = True

    def __init__(
        self,
        robot: RobotParameters | LimbParameters | str | Path | None = None,
        *,
        time_step: float = TIME_STEP,
        name: str = "",
    ):
        """
        Args:
            robot: description of the robot, or of a limb, or its YAML file; the crawler if
                None. The system keeps a copy, its attribute ``robot``; its attribute
                ``parameters`` describes all limbs together.
            time_step: s, of the mechanics if there is a ground.
            name: name of the system; Drake gives it one in a diagram if empty.

        Raises:
            ParameterError: if a parameter is out of its range, or the limbs are too stiff for
                their mass and damping to be simulated in such steps.
        """
        super().__init__()
        self.robot = robot = RobotParameters.of(robot)
        self.parameters = parameters = robot.as_single_limb
        self.source = "model"
        self.accuracy = None if robot.ground else ACCURACY  # None: heat in the mechanics' steps

        # Connect wires and mechanics.
        builder = DiagramBuilder()
        plant, joint_state, force = add_plant(builder, robot, time_step)
        ports, duty = add_wire_blocks(builder, parameters, joint_state)
        builder.Connect(ports["torque"], force)

        # Export the ports of the limbs, the body and the feet.
        export_limbs(builder, robot, ports, duty)
        if pose := body_pose_port(builder, plant, robot):
            builder.ExportOutput(pose, "body_pose")
        export_contact_force(builder, plant, robot)
        builder.BuildInto(self)
        self.set_name(name)


def add_contact_plant(builder: DiagramBuilder, time_step: float = TIME_STEP) -> MultibodyPlant:
    """Add an empty discrete plant with SAP contact, and its SceneGraph, to a diagram."""
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    plant.set_sap_near_rigid_threshold(NEAR_RIGID_THRESHOLD)
    plant.SetUseSampledOutputPorts(False)  # forces are those by the state that there is
    return plant


def make_robot(
    builder: DiagramBuilder, robot: RobotParameters, time_step: float = TIME_STEP
) -> MultibodyPlant:
    """Add the robot's finalized plant to a diagram, with a SceneGraph if there is a ground.

    Raises:
        ParameterError: as `Robot`.
    """
    if robot.ground:
        plant = add_contact_plant(builder, time_step)
    else:
        plant = builder.AddNamedSystem("plant", MultibodyPlant(0.0))
    add_robot(plant, robot)
    plant.Finalize()
    if robot.ground:
        check_time_step(plant, limb_joints(plant, robot), robot.as_single_limb)
    return plant


def add_plant(
    builder: DiagramBuilder, robot: RobotParameters, time_step: float = TIME_STEP
) -> tuple[MultibodyPlant, OutputPort, InputPort]:
    """Add a plant by `make_robot`; return it with the ports of the limbs' joints.

    Returns:
        The plant, its output port [θ, θ̇] (2n), rad and rad/s, and its input port of torques (n),
        N·m.
    """
    plant = make_robot(builder, robot, time_step)
    joints = limb_joints(plant, robot)
    selector = plant.MakeStateSelectorMatrix([joint.index() for joint in joints])
    spreader = selector[len(joints) :, plant.num_positions() :].T
    select, spread = map(builder.AddSystem, map(MatrixGain, (selector, spreader)))
    builder.Connect(plant.get_state_output_port(), select.get_input_port())
    builder.Connect(spread.get_output_port(), plant.get_applied_generalized_force_input_port())
    return plant, select.get_output_port(), spread.get_input_port()


def add_robot(plant: MultibodyPlant, robot: RobotParameters) -> None:
    """Parse the robot's URDF into a plant, mount its body and add springs, gravity and ground.

    The plant is not finalized, so that you can add to it. Joints are named ``rear_joint_1``, ...;
    the joint of a body that moves in the plane of x and z is ``body``, with the positions x, z, m,
    and θ, rad, from +x towards +z. Torques of wires enter at ``applied_generalized_force``.

    Args:
        plant: not finalized; registered with a SceneGraph if the robot has a ground.
        robot: description of the robot.
    """
    robot.validate()

    # Add body and limbs, and mount the body.
    Parser(plant).AddModelsFromString(robot_urdf(robot), "urdf")
    body = plant.GetFrameByName("body")
    world = plant.world_frame()
    if robot.body.mount == "welded":
        plant.WeldFrames(world, body)
    elif robot.body.mount == "planar":
        frames = [
            plant.AddFrame(FixedOffsetFrame(name, parent, RigidTransform(PLANE_ROTATION)))
            for name, parent in (("ground_plane", world), ("body_plane", body))
        ]
        plant.AddJoint(PlanarJoint("body", *frames))
    add_joint_springs(plant, limb_joints(plant, robot), robot.as_single_limb)

    # Stand the robot on its ground by default.
    height = robot.standing_height if robot.ground else 0.0
    if robot.body.mount == "planar":
        plant.GetJointByName("body").set_default_translation([0.0, height])
    elif robot.body.mount == "free":
        plant.SetDefaultFloatingBaseBodyPose(
            plant.GetBodyByName("body"), RigidTransform([0.0, 0.0, height])
        )
    plant.mutable_gravity_field().set_gravity_vector(robot.world_gravity)

    # Add the ground, a box whose upper side is z = 0.
    if robot.ground:
        friction = CoulombFriction(robot.ground.friction, robot.ground.friction)
        properties = ProximityProperties()
        AddContactMaterial(None, CONTACT_STIFFNESS, friction, properties)
        properties.AddProperty("material", "relaxation_time", RELAXATION_TIME)
        shape = Box(*GROUND_SIZE)
        below = RigidTransform([0.0, 0.0, -GROUND_SIZE[2] / 2])
        plant.RegisterCollisionGeometry(plant.world_body(), below, shape, "ground", properties)


def limb_joints(plant: MultibodyPlant, robot: RobotParameters) -> list[RevoluteJoint]:
    """Return the joints of the limbs (n), limb by limb, each from base to tip."""
    return [
        plant.GetJointByName(f"{limb.name}_joint_{number}")
        for limb in robot.limbs
        for number in range(1, limb.parameters.num_joints + 1)
    ]


def set_positions(
    plant: MultibodyPlant,
    context: Context,
    robot: RobotParameters,
    body_pose: ArrayLike | None,
    joint_angles: ArrayLike,
) -> None:
    """Put a robot into a pose.

    Args:
        plant: finalized, with the robot.
        context: the plant's own.
        robot: description of the robot.
        body_pose: as the port ``body_pose`` of `Robot`; where the body is by default if None.
        joint_angles: θ (n,), rad.
    """
    positions = plant.GetDefaultPositions()
    if body_pose is not None:
        pose = body_positions(body_pose)
        positions[: len(pose)] = pose
    angles = np.asarray(joint_angles, float)
    for joint, angle in zip(limb_joints(plant, robot), angles, strict=True):
        positions[joint.position_start()] = angle
    plant.SetPositions(context, positions)


def body_positions(body_pose: ArrayLike) -> np.ndarray:
    """Return positions of a body in its plant, from its pose as in the port ``body_pose``."""
    pose = np.asarray(body_pose, float)
    if len(pose) == 3:
        return pose
    return np.concatenate([RollPitchYaw(pose[3:]).ToQuaternion().wxyz(), pose[:3]])


def export_limbs(
    builder: DiagramBuilder,
    robot: RobotParameters,
    ports: Mapping[str, OutputPort],
    duty: InputPort,
) -> None:
    """Export the duty of all limbs and of each, and each limb's temperatures and bends.

    Without duty of single limbs, which is decided once, no step of a simulation calls Python.

    Args:
        builder, robot: diagram and description of the robot.
        ports: ``measured_temperature`` and ``bend_angle`` of all limbs.
        duty: input port of the duty of all limbs.
    """
    # Take the duty of all limbs, or the joined duty of single limbs.
    joined = builder.AddSystem(_JoinedDuty(robot))
    switch = builder.AddSystem(PortSwitch(duty.size()))
    for index in range(joined.num_input_ports()):
        port = joined.get_input_port(index)
        builder.ExportInput(port, port.get_name())
    builder.ConnectInput("duty", switch.DeclareInputPort("duty"))
    builder.Connect(joined.GetOutputPort("joined"), switch.DeclareInputPort("joined"))
    builder.Connect(joined.GetOutputPort("chosen"), switch.get_port_selector_input_port())
    builder.Connect(switch.get_output_port(), duty)

    # Export the signals of each limb.
    slices_of_limbs = {"measured_temperature": robot.wires_of, "bend_angle": robot.bends_of}
    for number, limb in enumerate(robot.limbs):
        for signal, slices in slices_of_limbs.items():
            rows = np.eye(ports[signal].size())[slices[number]]
            selector = builder.AddSystem(MatrixGain(rows))
            builder.Connect(ports[signal], selector.get_input_port())
            builder.ExportOutput(selector.get_output_port(), f"{limb.name}.{signal}")


def body_pose_port(
    builder: DiagramBuilder, plant: MultibodyPlant, robot: RobotParameters
) -> OutputPort | None:
    """Return a port with the body's pose, see ``body_pose`` of `Robot`; None if it is welded."""
    size = plant.num_multibody_states()
    if robot.body.mount == "welded":
        return None
    pose: System = builder.AddSystem(
        MatrixGain(np.eye(3, size))
        if robot.body.mount == "planar"
        else VectorFunction(_pose_in_space, [size], 6)
    )
    builder.Connect(plant.get_state_output_port(), pose.get_input_port(0))
    return pose.get_output_port(0)


def export_contact_force(
    builder: DiagramBuilder, plant: MultibodyPlant, robot: RobotParameters
) -> None:
    """Export the output port ``contact_force``, if there is a ground."""
    if robot.ground:
        feet = [[plant.GetBodyByName(f"{limb.name}_foot").index()] for limb in robot.limbs]
        axes = [0, 2] if robot.force_size == 2 else [0, 1, 2]
        forces = builder.AddSystem(ContactForces(plant, feet, axes))
        builder.Connect(plant.get_contact_results_output_port(), forces.get_input_port())
        builder.ExportOutput(forces.get_output_port(), "contact_force")


class _JoinedDuty(LeafSystem):
    """Duty of all wires, given for all or limb by limb.

    - input 0 ``duty``: D (W)
    - inputs 1 to L, ``rear.duty`` and so on: D of each limb's wires, in place of its part of
      ``duty`` if it is connected
    - output 0 ``joined``: D (W)
    - output 1 ``chosen``: the port of a switch that has it, 1 if that is ``duty`` alone, else 2
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, robot: RobotParameters):
        super().__init__()
        self._wires_of = robot.wires_of
        self._size = robot.wires_of[-1].stop
        self.DeclareVectorInputPort("duty", self._size)
        for limb, wires in zip(robot.limbs, robot.wires_of, strict=True):
            self.DeclareVectorInputPort(f"{limb.name}.duty", wires.stop - wires.start)
        tickets = {self.all_input_ports_ticket()}
        self.DeclareVectorOutputPort("joined", self._size, weak_method(self._join), tickets)
        self.DeclareAbstractOutputPort(
            "chosen", Value[InputPortIndex], weak_method(self._choose), tickets
        )

    def _choose(self, context, output):
        """Choose the joined duty if the duty of any single limb is connected."""
        limb_ports = map(self.get_input_port, range(1, self.num_input_ports()))
        is_any_connected = any(port.HasValue(context) for port in limb_ports)
        output.set_value(InputPortIndex(2 if is_any_connected else 1))

    def _join(self, context, output):
        """Put the duty of single limbs in place of their parts of the duty of all."""
        duty_port, *limb_ports = map(self.get_input_port, range(self.num_input_ports()))
        connected = [port.HasValue(context) for port in limb_ports]
        duty = np.zeros(self._size) if all(connected) else duty_port.Eval(context).copy()
        for port, is_connected, wires in zip(limb_ports, connected, self._wires_of, strict=True):
            if is_connected:
                duty[wires] = port.Eval(context)
        output.SetFromVector(duty)


def _pose_in_space(state: np.ndarray) -> np.ndarray:
    """Return x, y, z, roll, pitch and yaw of a free body, whose quaternion begins the state."""
    rotation = Quaternion(state[:4] / np.linalg.norm(state[:4]))
    return np.concatenate([state[4:7], RollPitchYaw(rotation).vector()])
