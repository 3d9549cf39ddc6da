"""The emulated robot: emulated limbs on a body of its own masses, on a ground of its own friction.

Ranges are stated as in `specimen`; all of those here are ours.
"""

import copy
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydrake.geometry import ProximityProperties, RoleAssign, SceneGraph
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.systems.framework import Diagram, DiagramBuilder

from hardware.emulation.lumped import add_physics
from hardware.emulation.specimen import Specimen
from hardware.emulation.twin import SPACE_ACCURACY, SWING_TIME, LimbTwin, rest
from limb_systems import Layout, LimbParameters, NoBoard, RobotParameters, SerialBoard
from limb_systems.model.robot import (
    TIME_STEP,
    add_plant,
    body_pose_port,
    export_contact_force,
    export_limbs,
    limb_joints,
)
from limb_systems.simulation import PERIOD

RESTING_STEP = 5e-3  # s, at most, of a robot that has cooled and slides no more


class RobotSpecimen(Specimen):
    """A particular robot: all its limbs as one `Specimen`, and what carries them.

    - ``robot``: `RobotParameters` as a lab would know them beforehand.
    - ``drawn``: description with the true masses, places of the limbs and friction of the ground.
    - ``foot_friction``: μ between each foot and that ground (L,); empty without a ground.

    Beside the effects of limbs it may be `without` "body", so that masses and places are as
    described, and without "ground", so that μ is.
    """

    kind = RobotParameters
    effects = (*Specimen.effects, "body", "ground")

    def __init__(self, robot: RobotParameters, seed: int, extra: Sequence[str] = ()):
        """
        Args:
            robot: parameters around which it is drawn.
            seed, extra: as for `Specimen`.

        Raises:
            LimbError: as `Specimen`.
        """
        super().__init__(robot.together, seed, extra)
        self.robot = copy.deepcopy(robot)
        for limb in self.robot.limbs:
            self.around_calibrated |= limb.parameters.calibration is not None
            limb.parameters.board, limb.parameters.calibration = NoBoard(), None
        self._drawn_around = self.robot.to_yaml()
        self.drawn = copy.deepcopy(self.robot)
        uniform = np.random.default_rng([seed, len(robot.limbs)]).uniform
        self._draw_body(uniform)
        self.foot_friction: list[float] = []
        if ground := self.drawn.ground:
            ground.friction *= uniform(0.7, 1.3)  # another floor, dust, wear
            shares = uniform(0.9, 1.1, len(robot.limbs))  # feet are not alike
            self.foot_friction = (ground.friction * shares).tolist()

    def _draw_body(self, uniform) -> None:
        """Draws masses to 10%, as parts are cast and glued, and places of the limbs to 1 mm."""
        body, feet = self.drawn.body, self.drawn.feet
        body.mass *= (share := uniform(0.9, 1.1))
        if body.inertia is not None:
            body.inertia = [share * moment for moment in body.inertia]
        feet.mass *= uniform(0.9, 1.1)
        for limb in self.drawn.limbs:
            limb.position = (limb.position + uniform(-1e-3, 1e-3, 3)).tolist()
            for segment in limb.parameters.segments:
                segment.mass *= uniform(0.9, 1.1)

    def without(self, *effects: str) -> "RobotSpecimen":
        """As `Specimen.without`, with the effects of the class."""
        specimen, described = super().without(*effects), copy.deepcopy(self.robot)
        if "body" in effects:
            described.ground, specimen.drawn = specimen.drawn.ground, described
        if "ground" in effects and self.robot.ground:
            specimen.drawn.ground = copy.deepcopy(self.robot.ground)
            specimen.foot_friction = [self.robot.ground.friction] * len(self.robot.limbs)
        return specimen

    def true_robot(self) -> RobotParameters:
        """Parameters of the mechanics: as `drawn`, and of the limbs as of `mechanics`."""
        robot = copy.deepcopy(self.drawn)
        segments = iter(self.mechanics().segments)
        for limb in robot.limbs:
            limb.parameters.segments = [
                dataclasses.replace(next(segments), mass=own.mass, name=own.name)
                for own in limb.parameters.segments
            ]
        return robot

    def limb(self, name: str) -> Specimen:
        """A limb alone, unused and weighed, for a `LimbTwin` on which to calibrate it."""
        return _LimbSpecimen(self, name)

    def board_of(self, limb: str) -> SerialBoard:
        """The identity of a limb, and of the board that drives it alone."""
        named = dataclasses.replace(self.board, description=f"{limb} of {self._drawn_around}")
        return SerialBoard(named.serial_number)


class _LimbSpecimen(Specimen):
    def __init__(self, robot: RobotSpecimen, name: str):
        super().__init__(robot.drawn.limb(name), robot.seed, robot.extra)
        number = [limb.name for limb in robot.drawn.limbs].index(name)
        places = [len(limb.parameters.segments) for limb in robot.drawn.limbs]
        start = sum(places[:number])
        self.wires = robot.wires[robot.drawn.wires_of[number]]
        self.segments = robot.segments[start : start + places[number]]
        self.ambient, self.absent = robot.ambient, robot.absent
        self._board = robot.board_of(name)

    @property
    def board(self) -> SerialBoard:
        """That of the limb on the robot."""
        return self._board


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

    __slots__ = ()  # see limb_systems.model.ownership

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
            limb.parameters.board = specimen.board_of(limb.name)
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
        self.set_name("robot_twin")

    def again(
        self, pause: float = 0.0, *, bend_rate: float = 20.0, truth: bool = False
    ) -> "RobotTwin":
        """The same robot in its present state, or after a pause without heat.

        Args:
            pause: s, to cool down where it stands.
            bend_rate, truth: as for the constructor.
        """
        layout = Layout(self.specimen.mechanics())
        stable = (layout.damping / layout.stiffness).min()  # half of what the springs would allow
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
        properties, own = (
            ProximityProperties(described),
            friction * ground / (2 * ground - friction),
        )
        properties.UpdateProperty("material", "coulomb_friction", CoulombFriction(own, own))
        scene_graph.AssignRole(plant.get_source_id(), foot, properties, RoleAssign.kReplace)
