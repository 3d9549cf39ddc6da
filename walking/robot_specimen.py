"""The true properties of one emulated robot: its limbs, its masses and its ground.

Ranges are stated as in `specimen`; all of those here are ours.
"""

import copy
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from hardware.emulation.specimen import Specimen
from limb_systems import NoBoard
from walking.robot_parameters import RobotParameters


class RobotSpecimen(Specimen):
    """A particular robot: all its limbs as one `Specimen`, and what carries them.

    - ``robot``: `RobotParameters` as a lab would describe them beforehand.
    - ``drawn``: description with the true masses, places of the limbs, feet and friction.
    - ``foot_friction``: μ between each foot and that ground (L,); empty without a ground.

    In addition to effects of limbs, `without` takes "body", for the described masses and places,
    and "ground", for the described μ.
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
        super().__init__(robot.as_single_limb, seed, extra)
        self.robot = copy.deepcopy(robot)
        for limb in self.robot.limbs:
            self.around_calibrated |= limb.parameters.calibration is not None
            limb.parameters.board = NoBoard()
            limb.parameters.calibration = None
        self._drawn_around = self.robot.to_yaml()
        self.drawn = copy.deepcopy(self.robot)
        uniform = np.random.default_rng([seed, len(robot.limbs)]).uniform
        self._draw_body(uniform)
        self.foot_friction: list[float] = []
        if ground := self.drawn.ground:
            ground.friction *= uniform(0.7, 1.3)  # another floor, dust, wear
            shares = uniform(0.9, 1.1, len(robot.limbs))  # feet differ
            self.foot_friction = (ground.friction * shares).tolist()
        feet = self.drawn.feet
        feet.stiffness *= (share := uniform(0.8, 1.2))  # as pads are cast
        feet.damping *= share

    def _draw_body(self, uniform) -> None:
        """Draw masses to 10%, as parts are cast and glued, and places of the limbs to 1 mm."""
        body = self.drawn.body
        feet = self.drawn.feet
        body.mass *= (share := uniform(0.9, 1.1))
        if body.inertia is not None:
            body.inertia = (share * np.array(body.inertia)).tolist()
        feet.mass *= uniform(0.9, 1.1)
        for limb in self.drawn.limbs:
            limb.position = (limb.position + uniform(-1e-3, 1e-3, 3)).tolist()
            for segment in limb.parameters.segments:
                segment.mass *= uniform(0.9, 1.1)

    def without(self, *effects: str) -> "RobotSpecimen":
        """Return the specimen without some effects, see `Specimen.without`."""
        specimen = super().without(*effects)
        described = copy.deepcopy(self.robot)
        if "body" in effects:
            described.ground = specimen.drawn.ground
            specimen.drawn = described
        if "ground" in effects and self.robot.ground:
            specimen.drawn.ground = copy.deepcopy(self.robot.ground)
            specimen.foot_friction = [self.robot.ground.friction] * len(self.robot.limbs)
        return specimen

    def true_robot(self) -> RobotParameters:
        """Return the true parameters: body and ground of `drawn`, limbs of `mechanics`."""
        robot = copy.deepcopy(self.drawn)
        segments = iter(self.mechanics().segments)
        for limb in robot.limbs:
            limb.parameters.segments = [
                dataclasses.replace(next(segments), mass=drawn.mass, name=drawn.name)
                for drawn in limb.parameters.segments
            ]
        return robot

    def limb(self, name: str) -> "LimbOfRobot":
        """Return an unused limb with its foot alone, to calibrate it on a `LimbTwin`."""
        return LimbOfRobot(self, name)


class LimbOfRobot(Specimen):
    """A limb of a `RobotSpecimen` alone, which carries its foot as payload.

    Args:
        robot: the robot.
        name: name of the limb.
    """

    def __init__(self, robot: RobotSpecimen, name: str):
        super().__init__(robot.drawn.limb_alone(name), robot.seed, robot.extra)
        number = robot.drawn.limb_names.index(name)
        places = [len(limb.parameters.segments) for limb in robot.drawn.limbs]
        start = sum(places[:number])
        self.wires = robot.wires[robot.drawn.wires_of[number]]
        self.segments = robot.segments[start : start + places[number]]
        self.ambient = robot.ambient
        self.absent = robot.absent
        self._board = dataclasses.replace(robot.board, limb=name)

    @property
    def board(self) -> Any:
        """The identity of the limb, and of the board that drives it alone."""
        return self._board
