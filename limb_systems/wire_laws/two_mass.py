"""Heat in wire and silicone, and torque proportional to temperature.

The silicone around a wire is a second thermal mass, by which published recordings of limbs of this
family are predicted best. The default values describe the nominal limb with such wires.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from limb_systems.files.schema import quantity
from limb_systems.wire_laws.wire_law import (
    COLD_HEATING,
    COOLING,
    HEATING,
    LAG,
    TEMPERATURE_SCALE,
    TORQUE_RATE,
    Prior,
    WireLaw,
)


@dataclasses.dataclass
class _TwoMassHeat(WireLaw):
    """Heat flows from the wire, T, to the silicone around it, S, and from there to the room."""

    states: ClassVar[dict[str, float]] = {"T": TEMPERATURE_SCALE, "S": TEMPERATURE_SCALE}

    a1: float = quantity(
        -0.08, "1/s", -10.0, -1e-4, "cooling rate towards the silicone, negative", COOLING
    )
    a2: float = quantity(20.0, "°C/s", 0.1, 1000.0, "heating rate at full duty", HEATING)
    a3: float = quantity(-1.0, "1/s", -100.0, -1e-3, "rate of the measurement lag, negative", LAG)
    silicone_warming: float = quantity(
        0.004,
        "1/s",
        1e-5,
        10.0,
        "kS, rate at which the wire warms the silicone",
        Prior(0.01, 1.5, 0.3, COLD_HEATING),
    )
    silicone_cooling: float = quantity(
        0.012,
        "1/s",
        1e-4,
        10.0,
        "kA, rate at which the silicone cools to ambient",
        Prior(0.02, 1.2, 0.3, COLD_HEATING),
    )

    def rates(self, x: Sequence[Any] | np.ndarray, D: Any, T0: Any) -> Sequence[Any]:
        """Return Ṫ = a1 (T - S) + a2 D and Ṡ = kS (T - S) - kA (S - T0)."""
        T = x[0]
        S = x[1]
        return [
            self.a1 * (T - S) + self.a2 * D,
            self.silicone_warming * (T - S) - self.silicone_cooling * (S - T0),
        ]

    def reading_rate(self, V, x):
        """Return V̇ = a3 (V - T), eqn (7)."""
        return self.a3 * (V - x[0])

    def typical_rates(self):
        """Return cooling at -a1 with cold silicone, and -a1 kA / (kS + kA) with warm silicone."""
        share = self.silicone_cooling / (self.silicone_warming + self.silicone_cooling)
        cooling = {"slowest_cooling": -self.a1 * share, "fastest_cooling": -self.a1}
        return {**cooling, "heating": self.a2, "reading": -self.a3}


@dataclasses.dataclass
class TwoMassLaw(_TwoMassHeat):
    """Heat in wire and silicone; torque proportional to temperature.

    Ṫ = a1 (T - S) + a2 D
    Ṡ = kS (T - S) - kA (S - T0)
    V̇ = a3 (V - T)                  (7)
    torque = β (T - T0)             (4)

    """

    beta: float = quantity(
        4.7e-4, "N·m/°C", 1e-8, 1.0, "joint torque per degree above ambient", TORQUE_RATE
    )

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """Return β (T - T0), eqn (4)."""
        return self.beta * (x[0] - T0)
