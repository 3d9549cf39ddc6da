"""The paper's law: linear heat, linear lag, and torque proportional to temperature."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from limb_systems.files.schema import quantity
from limb_systems.wire_laws.wire_law import COOLING, HEATING, LAG, TORQUE_RATE, WireLaw


@dataclasses.dataclass
class LinearLaw(WireLaw):
    """The paper's law: linear heat, linear lag, and torque proportional to temperature."""

    a1: float = quantity(
        -0.07, "1/s", -10.0, -1e-4, "cooling rate towards ambient, negative (6)", COOLING
    )
    a2: float = quantity(20.0, "°C/s", 0.1, 1000.0, "heating rate at full duty (6)", HEATING)
    a3: float = quantity(
        -1.0, "1/s", -100.0, -1e-3, "rate of the measurement lag, negative (7)", LAG
    )
    beta: float = quantity(
        4.7e-4,
        "N·m/°C",
        1e-8,
        1.0,
        "joint torque per degree above ambient, with the length of the wire's lever (4)",
        TORQUE_RATE,
    )

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """Return β (T - T0), eqn (4)."""
        return self.beta * (x[0] - T0)

    def rates(self, x: Sequence[Any] | np.ndarray, D: Any, T0: Any) -> Sequence[Any]:
        """Return Ṫ = a1 (T - T0) + a2 D, eqn (6)."""
        return [self.a1 * (x[0] - T0) + self.a2 * D]

    def reading_rate(self, V: Any, x: Sequence[Any] | np.ndarray) -> Any:
        """Return V̇ = a3 (V - T), eqn (7)."""
        return self.a3 * (V - x[0])

    def typical_rates(self) -> dict[str, float]:
        """Return the rates -a1, a2 and -a3 of the law."""
        cooling = {"slowest_cooling": -self.a1, "fastest_cooling": -self.a1}
        return {**cooling, "heating": self.a2, "reading": -self.a3}
