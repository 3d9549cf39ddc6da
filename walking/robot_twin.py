"""The emulated robot: emulated limbs on a body, its masses and its ground's friction its own."""

import copy
import dataclasses
from collections.abc import Sequence
from pathlib import Path

from pydrake.geometry import ProximityProperties, RoleAssign, SceneGraph
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.systems.framework import Diagram, DiagramBuilder

from hardware.emulation.lumped import add_physics
from hardware.emulation.twin import SPACE_ACCURACY, SWING_TIME, LimbTwin, rest
from limb_systems import EmulatedLimb, LimbModel, LimbParameters
from limb_systems.simulation import PERIOD
from walking.robot import (
    TIME_STEP,
    add_plant,
    body_pose_port,
    export_contact_force,
    export_limbs,
    limb_joints,
)
from walking.robot_parameters import RobotParameters
from walking.robot_specimen import RobotSpecimen

RESTING_STEP = 5e-3  # s, at most, of a robot that has cooled and slides no more


class RobotTwin(Diagram):
    """An emulated robot, with the ports of `Robot` as far as a lab has them.

    It is an emulation, not a measurement of a robot. The seed draws a `RobotSpecimen`: its limbs
    have the lumped physics of `LimbTwin`, all on one plant as that of `Robot`, with contact; its
    masses, the places of its limbs and the friction of each foot are its own. Its body is seen
    by a `camera`.

    For L limbs with F bends, n joints and W wires in all, those of the first limb first:

    - inputs 0 to L: ``duty`` (W), ``rear.duty`` and so on, as of `Robot`
    - output 0 ``measured_temperature``: V (W), °C, as thermocouples read it
    - output 1 ``bend_angle``: φ (F), rad, as bend sensors read it
    - output 2 ``applied_duty``: D (W) in the steps of the PWM
    - output 3 ``measurement``: [V (W), φ (F)], as they are read
    - output 4 ``cut_out``: 1 once a wire was measured at the board's limit, as of `LimbTwin`
    - only if the truth is asked for: ``wire_temperature`` (W), °C, ``joint_state`` [θ, θ̇]
      (2n), rad and rad/s, ``true_body_pose`` and ``contact_force``, as of `Robot`
    - ``body_pose``, unless the body is welded: as of `Robot`, as the camera sees it at 10 Hz
    - ``rear.measured_temperature``, ``rear.bend_angle`` and so on: those of each limb

    ``robot`` describes it as a lab would before calibration, ``parameters`` all limbs together;
    their ``board`` is the robot's identity. It keeps its state after a simulation, as `LimbTwin`.
    """

    __slots__ = ()  # see limb_systems.drake_python

    real_time = False
    without_cut_out = LimbTwin.without_cut_out

    def __init__(
        self,
        robot: RobotParameters | LimbParameters | str | Path | None = None,
        *,
        seed: int = 0,
        extra: Sequence[str] = (),
        specimen: RobotSpecimen | None = None,
        bend_rate: float = 20.0,
        time_step: float = TIME_STEP,
        truth: bool = False,
    ):
        """
        Args:
            robot: description of the kind of robot, or its YAML file; the crawler if None.
                The seed draws the robot around it.
            seed: seed of the particular robot and its sensors' noise.
            extra: effects that its limbs have beside those of every limb, see `Specimen`.
            specimen: the particular robot, in place of these three.
            bend_rate: rate at which the bend sensors are read, Hz.
            time_step: step of the mechanics on a ground, s.
            truth: whether it shows, and recordings have, what no sensor of a robot could.

        Raises:
            ParameterError: if a parameter is out of its range.
            LimbError: if an effect is unknown.
        """
        super().__init__()
        if specimen is None:
            specimen = RobotSpecimen(RobotParameters.of(robot), seed, extra)
        self.specimen, self.robot = specimen, copy.deepcopy(specimen.robot)
        for limb in self.robot.limbs:
            limb.parameters.board = dataclasses.replace(specimen.board, limb=limb.name)
        self.parameters = copy.deepcopy(specimen.description)
        self.parameters.board = specimen.board
        self.source = f"emulated robot, {specimen.label}"
        self.accuracy = None if self.robot.ground else SPACE_ACCURACY

        builder, true = DiagramBuilder(), specimen.true_robot()
        plant, joint_state, force = add_plant(builder, true, time_step)
        if true.ground:
            _set_friction(builder.GetSubsystemByName("scene_graph"), plant, specimen)
        pose = body_pose_port(builder, plant, true)
        ports, duty = add_physics(
            builder,
            specimen,
            joint_state,
            force,
            bend_rate=bend_rate,
            wire_period=PERIOD,
            truth=truth,
            body_pose=pose,
            memory={"plant": plant.get_state_output_port()},
        )
        export_limbs(builder, true, ports, duty)
        if truth:
            if pose:
                builder.ExportOutput(pose, "true_body_pose")
            export_contact_force(builder, plant, true)
        if "plant" in specimen.state:
            plant.SetDefaultPositions(specimen.state["plant"][: plant.num_positions()])
        else:
            for joint, angle in zip(limb_joints(plant, true), specimen.rest_angles(), strict=True):
                joint.set_default_angle(angle)
        builder.BuildInto(self)

    @classmethod
    def of(cls, robot: RobotParameters, seed: int = 0, *, truth: bool = False) -> "RobotTwin":
        """The emulated robot whose limbs a robot's were calibrated on, unused.

        Args:
            robot: if its limbs were not calibrated on those of one emulated robot, a robot of
                its kind is drawn.
            seed: seed of that draw.
            truth: as for the constructor.

        Raises:
            LimbError: if the identity is invalid.
        """
        if isinstance(board := robot.as_single_limb.board, EmulatedLimb):
            return cls(specimen=RobotSpecimen.of(board), truth=truth)
        return cls(robot, seed=seed, truth=truth)

    def after_rest(
        self, pause: float = 0.0, *, bend_rate: float = 20.0, truth: bool = False
    ) -> "RobotTwin":
        """The same robot in its present state, or after a pause without heat.

        Args:
            pause: s, to cool down where it stands.
            bend_rate, truth: as for the constructor.
        """
        mechanics = LimbModel.of(self.specimen.mechanics()).mechanics
        # Half of what the springs would allow.
        stable = (mechanics.damping / mechanics.stiffness).min()
        cooling = min(pause, SWING_TIME)  # and sliding
        longest = min(RESTING_STEP, max(TIME_STEP, stable))
        for duration, step in ((cooling, TIME_STEP), (pause - cooling, longest)):
            if duration > 0:
                robot = RobotTwin(specimen=self.specimen, bend_rate=1.0, time_step=step)
                rest(robot, duration, step if robot.accuracy is None else None)
        return RobotTwin(specimen=self.specimen, bend_rate=bend_rate, truth=truth)


def _set_friction(scene_graph: SceneGraph, plant: MultibodyPlant, specimen: RobotSpecimen) -> None:
    """Sets μ of each foot. Drake takes 2 a b / (a + b) of two bodies' coefficients a and b."""
    assert specimen.drawn.ground
    ground = specimen.drawn.ground.friction
    for limb, friction in zip(specimen.robot.limbs, specimen.foot_friction, strict=True):
        (foot,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName(f"{limb.name}_foot"))
        described = scene_graph.model_inspector().GetProximityProperties(foot)
        properties = ProximityProperties(described)
        own = friction * ground / (2 * ground - friction)
        properties.UpdateProperty("material", "coulomb_friction", CoulombFriction(own, own))
        scene_graph.AssignRole(plant.get_source_id(), foot, properties, RoleAssign.kReplace)
