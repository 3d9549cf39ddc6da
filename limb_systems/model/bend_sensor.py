"""What the bend in a recording means: sensors between a segment's shape and its bend angle.

A limb has a shape, and a recording of a segment has one number for it. For
constant curvature (8) all sensors agree on that number, the bend angle φ. They
differ where curvature is not constant, as under gravity: a cantilever that sags
under its own weight has an α/2 of two thirds of its chord's angle.
"""

import abc
import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.schema import Tagged, quantity


def bend_angle_from_tip_tangent(tip_tangent: ArrayLike) -> np.ndarray:
    """φ = α/2 for the sensor's tip tangent angle α, constant curvature (8)."""
    return np.asarray(tip_tangent, float) / 2


def chord_angle(joint_angles: ArrayLike) -> np.ndarray:
    """Angle of the chord from the base of a segment to its tip, φ = atan2(t·E2, t·E1).

    Args:
        joint_angles: θ of the segment, (n,) or (n, K); numbers, AutoDiffXd or
            Expression.

    Returns:
        rad, in (-π, π], () or (K,).
    """
    with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
        links = np.cumsum(np.asarray(joint_angles), axis=0)
        return np.arctan2(np.sin(links).sum(axis=0), np.cos(links).sum(axis=0))


@dataclasses.dataclass
class BendSensor(Tagged, abc.ABC):
    """The bend sensor of a segment; subclasses are dataclasses.

    - ``gain``: slope of what it shows, 1 if it is exact.
    - ``offset``: reading where it should be zero, rad.
    - ``noise``: standard deviation of a sample, rad.
    - ``drift``: standard deviation of a slow drift, rad.

    The paper saw about 2° of error of its sensor in use (Sec. VII); how much of
    it is noise and how much drift is ours.
    """

    gain: float = quantity(1.0, "", 0.1, 10.0)
    offset: float = quantity(0.0, "rad", -3.2, 3.2)
    noise: float = quantity(float(np.deg2rad(0.5)), "rad", 0.0, 1.0)
    drift: float = quantity(float(np.deg2rad(1.0)), "rad", 0.0, 1.0)

    @abc.abstractmethod
    def bend_angle(self, reading: ArrayLike) -> np.ndarray:
        """The bend angle that is recorded, rad, of any shape, from the raw reading, rad."""

    @abc.abstractmethod
    def reading(self, bend_angle: ArrayLike) -> np.ndarray:
        """The raw reading, rad, of any shape, that is recorded as a bend angle, rad."""

    @abc.abstractmethod
    def exact_bend_angle(self, joint_angles: ArrayLike) -> np.ndarray:
        """What would be recorded without gain, offset, noise and drift.

        Args:
            joint_angles: θ of the segment, (n,) or (n, K); numbers or AutoDiffXd.

        Returns:
            rad, () or (K,); φ if all joint angles are equal.
        """

    def apparent_bend_angle(self, joint_angles: ArrayLike) -> np.ndarray:
        """What would be recorded of these joint angles, with gain and offset.

        Args:
            joint_angles: θ of the segment, (n,) or (n, K); numbers or AutoDiffXd.

        Returns:
            rad, () or (K,).
        """
        return self.gain * self.exact_bend_angle(joint_angles) + self.offset

    def corrected(self, bend_angle: ArrayLike) -> np.ndarray:
        """A recorded bend angle, rad, of any shape, without gain and offset."""
        return (np.asarray(bend_angle, float) - self.offset) / self.gain


@dataclasses.dataclass
class TipTangentSensor(BendSensor):
    """The paper's: it reads the tip tangent angle α, and α/2 is recorded (8).

    The directions of the chain's links are the tangents of a rod at the middle of
    each link, so that the tip is half a link beyond the last of them, where the
    tangent has turned by half of the last joint's angle more. The joint at the clamp
    is half a link before the first middle, yet counts whole in (11). Hence the factor

        α/2 = (n + 1) / (2 n + 1) (Σ θ_i + θ_n / 2)

    with which (8) is exact for constant curvature: α/2 = φ for equal joint angles.
    """

    def bend_angle(self, reading: ArrayLike) -> np.ndarray:
        """α/2."""
        return bend_angle_from_tip_tangent(reading)

    def reading(self, bend_angle: ArrayLike) -> np.ndarray:
        """α = 2 φ."""
        return 2 * np.asarray(bend_angle, float)

    def exact_bend_angle(self, joint_angles: ArrayLike) -> np.ndarray:
        """α/2 of the chain."""
        angles = np.asarray(joint_angles)
        links = len(angles)
        return (links + 1) / (2 * links + 1) * (angles.sum(axis=0) + angles[-1] / 2)


@dataclasses.dataclass
class ChordSensor(BendSensor):
    """Sensor that sees base and tip, such as a camera, and reads the chord's angle φ itself."""

    def bend_angle(self, reading: ArrayLike) -> np.ndarray:
        """The reading itself."""
        return np.asarray(reading, float)

    def reading(self, bend_angle: ArrayLike) -> np.ndarray:
        """φ itself."""
        return np.asarray(bend_angle, float)

    def exact_bend_angle(self, joint_angles: ArrayLike) -> np.ndarray:
        """φ of the chain's chord."""
        return chord_angle(joint_angles)
