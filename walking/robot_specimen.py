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
        super().__init__(robot.as_single_limb, seed, extra)
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

    def limb(self, name: str) -> "LimbOfRobot":
        """A limb with its foot, unused, taken off and weighed, to calibrate it on a `LimbTwin`."""
        return LimbOfRobot(self, name)


class LimbOfRobot(Specimen):
    """A limb of a `RobotSpecimen` alone, which carries its foot as payload.

    Args:
        robot: the robot.
        name: name of the limb.
    """

    def __init__(self, robot: RobotSpecimen, name: str):
        super().__init__(robot.drawn.limb_alone(name), robot.seed, robot.extra)
        number = [limb.name for limb in robot.drawn.limbs].index(name)
        places = [len(limb.parameters.segments) for limb in robot.drawn.limbs]
        start = sum(places[:number])
        self.wires = robot.wires[robot.drawn.wires_of[number]]
        self.segments = robot.segments[start : start + places[number]]
        self.ambient, self.absent = robot.ambient, robot.absent
        self._board = dataclasses.replace(robot.board, limb=name)

    @property
    def board(self) -> Any:
        """The identity of the limb, and of the board that drives it alone."""
        return self._board
