"""Bend sensors: the relation of a segment's shape to its recorded bend angle.

A limb has a shape, and a recording of a segment has one number for it. For
constant curvature (8) all sensors agree on that number, the bend angle φ. They
differ where curvature is not constant, as under gravity: a cantilever that sags
under its own weight has an α/2 of two thirds of its chord's angle.
"""

import abc
import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.files.schema import Tagged, quantity
from limb_systems.segment_chain import SegmentChain


def bend_angle_from_tip_tangent(tip_tangent: ArrayLike) -> np.ndarray:
    """Return φ = α/2 for the sensor's tip tangent angle α, constant curvature (8)."""
    return np.asarray(tip_tangent, float) / 2


def roll_bends(bends: np.ndarray, roll: ArrayLike) -> np.ndarray:
    """Return bends (axes, ...) towards E2 and E3 as bends towards axes that are turned about E1.

    Args:
        roll: angle by which the axes are turned, rad.
    """
    if len(bends) == 1:
        return bends
    cosine = np.cos(roll)
    sine = np.sin(roll)
    return np.array([cosine * bends[0] + sine * bends[1], cosine * bends[1] - sine * bends[0]])


@dataclasses.dataclass
class BendSensor(Tagged, abc.ABC):
    """The bend sensor of a segment; subclasses are dataclasses.

    - ``gain``: slope of the recorded bend over the true bend, 1 if it is exact.
    - ``offset``: recorded bend of a straight segment, rad.
    - ``offset_e3``: recorded bend towards E3 of a straight segment with two axes, rad.
    - ``roll``: angle about E1 from E2 to the first axis of the sensor, rad.
    - ``noise``: standard deviation of a sample, rad.
    - ``drift``: standard deviation of a slow drift, rad.

    The paper saw about 2° of error of its sensor in use (Sec. VII); its division into noise and
    drift is ours.
    """

    gain: float = quantity(1.0, "", 0.1, 10.0)
    offset: float = quantity(0.0, "rad", -3.2, 3.2)
    noise: float = quantity(float(np.deg2rad(0.5)), "rad", 0.0, 1.0)
    drift: float = quantity(float(np.deg2rad(1.0)), "rad", 0.0, 1.0)
    offset_e3: float = quantity(0.0, "rad", -3.2, 3.2, rare=True)
    roll: float = quantity(0.0, "rad", -3.2, 3.2, rare=True)

    @abc.abstractmethod
    def bend_angle(self, reading: ArrayLike) -> np.ndarray:
        """Return the bend angle that is recorded, rad, of any shape, from the raw reading, rad."""

    @abc.abstractmethod
    def reading(self, bend_angle: ArrayLike) -> np.ndarray:
        """Return the raw reading, rad, of any shape, that is recorded as a bend angle, rad."""

    @abc.abstractmethod
    def exact_bends(self, chain: SegmentChain, joint_angles: ArrayLike) -> np.ndarray:
        """Return the recorded bends of a segment without gain, offset, noise and drift.

        Args:
            chain: the segment's kinematics.
            joint_angles: θ of the segment, (n,) or (n, K); numbers or AutoDiffXd.

        Returns:
            rad, (axes,) or (axes, K); φ if all joint angles are equal.
        """

    def apparent_bends(self, chain: SegmentChain, joint_angles: ArrayLike) -> np.ndarray:
        """Return the recorded bends (axes, ...), rad: `exact_bends` with gain, offsets and roll."""
        bends = roll_bends(self.exact_bends(chain, joint_angles), self.roll)
        return (self.gain * bends.T + self._offsets(bends)).T

    def corrected_bends(self, bends: np.ndarray) -> np.ndarray:
        """Remove gain and offsets from recorded bends (axes, ...), rad; the roll remains."""
        return ((bends.T - self._offsets(bends)) / self.gain).T

    def _offsets(self, bends: np.ndarray) -> np.ndarray:
        """Return the offset of each axis (axes,), rad, of bends (axes, ...)."""
        return np.array([self.offset, self.offset_e3])[: len(bends)]

    def unrolled_bends(self, bends: np.ndarray) -> np.ndarray:
        """Remove gain, offsets and roll from the bends of a segment (axes, ...), rad."""
        return roll_bends(self.corrected_bends(bends), -self.roll)


@dataclasses.dataclass
class TipTangentSensor(BendSensor):
    """The paper's sensor: it reads the tip tangent angle α, and α/2 is recorded (8).

    `SegmentChain.tip_bend` defines α/2 of a chain of links: φ for equal joint angles.
    """

    def bend_angle(self, reading: ArrayLike) -> np.ndarray:
        """Return α/2."""
        return bend_angle_from_tip_tangent(reading)

    def reading(self, bend_angle: ArrayLike) -> np.ndarray:
        """Return α = 2 φ."""
        return 2 * np.asarray(bend_angle, float)

    def exact_bends(self, chain: SegmentChain, joint_angles: ArrayLike) -> np.ndarray:
        """Return α/2 of the chain."""
        return chain.tip_bend(joint_angles)


@dataclasses.dataclass
class ChordSensor(BendSensor):
    """A sensor that sees base and tip, such as a camera, and reads the angle φ of the chord."""

    def bend_angle(self, reading: ArrayLike) -> np.ndarray:
        """Return the reading, which is φ."""
        return np.asarray(reading, float)

    def reading(self, bend_angle: ArrayLike) -> np.ndarray:
        """Return φ, which is the reading."""
        return np.asarray(bend_angle, float)

    def exact_bends(self, chain: SegmentChain, joint_angles: ArrayLike) -> np.ndarray:
        """Return φ of the chain's chord."""
        return chain.bend_angle(joint_angles)
