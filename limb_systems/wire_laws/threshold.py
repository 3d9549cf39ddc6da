"""Heat in wire and silicone, and torque that sets in at a threshold."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from limb_systems.files.schema import quantity
from limb_systems.wire_laws.two_mass import _TwoMassHeat
from limb_systems.wire_laws.wire_law import SLOW_HEATING, TORQUE_RATE, WIDTH, Prior


@dataclasses.dataclass
class ThresholdLaw(_TwoMassHeat):
    """Heat in wire and silicone; torque sets in at a threshold, then it is linear.

        torque = β w (p((T - T_k) / w) - p((T0 - T_k) / w)),  p(z) = ln(1 + exp(z))

    The heat follows `TwoMassLaw`.

    """

    beta: float = quantity(
        7.0e-4, "N·m/°C", 1e-8, 1.0, "joint torque per degree far above the knee", TORQUE_RATE
    )
    knee: float = quantity(
        48.0,
        "°C",
        -20.0,
        200.0,
        "T_k, about which torque sets in",
        Prior(50.0, 10.0, 4.0, SLOW_HEATING),
    )
    width: float = quantity(7.0, "°C", 1.0, 100.0, "w, width of the knee", WIDTH)

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """Return the torque, see the class."""
        warm = np.log(1.0 + np.exp((x[0] - self.knee) / self.width))
        cold = np.log(1.0 + np.exp((T0 - self.knee) / self.width))
        return self.beta * self.width * (warm - cold)
