"""Heat in wire and silicone, and torque that follows an S-shaped curve."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from limb_systems.files.schema import quantity
from limb_systems.wire_laws.two_mass import _TwoMassHeat
from limb_systems.wire_laws.wire_law import FULL_TORQUE, MIDDLE, WIDTH, logistic


@dataclasses.dataclass
class SaturatingLaw(_TwoMassHeat):
    """Heat in wire and silicone; torque follows temperature along an S-shaped curve.

        torque = M (s((T - T_m) / w) - s((T0 - T_m) / w)),  s(z) = 1 / (1 + exp(-z))

    The heat follows `TwoMassLaw`.

    """

    full_torque: float = quantity(
        0.035, "N·m", 1e-8, 100.0, "M, joint torque of the transformed wire", FULL_TORQUE
    )
    middle: float = quantity(
        62.0, "°C", -20.0, 300.0, "T_m, at which half of the wire is transformed", MIDDLE
    )
    width: float = quantity(10.0, "°C", 1.0, 100.0, "w, width of the curve", WIDTH)

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """Return the torque, see the class."""
        warm = logistic((x[0] - self.middle) / self.width)
        cold = logistic((T0 - self.middle) / self.width)
        return self.full_torque * (warm - cold)
