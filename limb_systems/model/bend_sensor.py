"""Converts between the reading of a bend sensor and the bend angle of its segment."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.schema import Tagged


def bend_angle_from_tip_tangent(tip_tangent: ArrayLike) -> np.ndarray:
    """φ = α/2 for the sensor's tip tangent angle α, constant curvature (8)."""
    return np.asarray(tip_tangent, float) / 2


def tip_tangent_from_bend_angle(bend_angle: ArrayLike) -> np.ndarray:
    """α = 2 φ, what the sensor reads, for constant curvature (8)."""
    return 2 * np.asarray(bend_angle, float)


class BendSensor(Tagged):
    """The bend sensor of a segment; subclasses are dataclasses."""

    def bend_angle(self, reading: ArrayLike) -> np.ndarray:
        """φ, rad, of any shape, from the sensor's reading, rad."""
        raise NotImplementedError

    def reading(self, bend_angle: ArrayLike) -> np.ndarray:
        """The sensor's reading, rad, of any shape, from φ, rad."""
        raise NotImplementedError


@dataclasses.dataclass
class TipTangentSensor(BendSensor):
    """The paper's: it reads the tip tangent angle α, and curvature is constant (8)."""

    def bend_angle(self, reading: ArrayLike) -> np.ndarray:
        """φ = α/2."""
        return bend_angle_from_tip_tangent(reading)

    def reading(self, bend_angle: ArrayLike) -> np.ndarray:
        """α = 2 φ."""
        return tip_tangent_from_bend_angle(bend_angle)
