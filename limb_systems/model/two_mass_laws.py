"""Laws of wires in warm silicone, whose torque is linear, sets in, saturates or remembers.

Published recordings of limbs of this family are predicted best by them: the
silicone around a wire is a second thermal mass, and torque has a threshold. The
default values are those of the nominal limb with such wires.
"""

import dataclasses
from typing import ClassVar

import numpy as np

from limb_systems.model.wire_law import TEMPERATURE_SCALE, WireLaw
from limb_systems.schema import quantity


@dataclasses.dataclass
class _TwoMassHeat(WireLaw):
    """Heat flows from the wire, T, to the silicone around it, S, and from there to the room."""

    states: ClassVar[dict[str, float]] = {"T": TEMPERATURE_SCALE, "S": TEMPERATURE_SCALE}

    a1: float = quantity(-0.08, "1/s", -10.0, -1e-4)
    a2: float = quantity(20.0, "°C/s", 0.1, 1000.0)
    a3: float = quantity(-1.0, "1/s", -100.0, -1e-3)
    silicone_warming: float = quantity(0.004, "1/s", 1e-5, 10.0)
    silicone_cooling: float = quantity(0.012, "1/s", 1e-4, 10.0)

    def rates(self, x, D, T0):
        """Ṫ = a1 (T - S) + a2 D,  Ṡ = kS (T - S) - kA (S - T0)."""
        T, S = x[0], x[1]
        return [
            self.a1 * (T - S) + self.a2 * D,
            self.silicone_warming * (T - S) - self.silicone_cooling * (S - T0),
        ]

    def reading_rate(self, V, x):
        """V̇ = a3 (V - T), eqn (7)."""
        return self.a3 * (V - x[0])

    def typical_rates(self):
        """It cools by -a1 while the silicone is cold, and by -a1 kA / (kS + kA) once it is warm."""
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

    - ``a1``: cooling rate towards the silicone, 1/s, negative.
    - ``a2``: heating rate at full duty, °C/s.
    - ``a3``: rate of the measurement lag, 1/s, negative.
    - ``silicone_warming``: kS, rate at which the wire warms the silicone, 1/s.
    - ``silicone_cooling``: kA, rate at which the silicone cools to ambient, 1/s.
    - ``beta``: joint torque per degree above ambient, N·m/°C.
    """

    beta: float = quantity(4.7e-4, "N·m/°C", 1e-8, 1.0)

    def torque(self, x, T0, theta):
        """β (T - T0), eqn (4)."""
        return self.beta * (x[0] - T0)


@dataclasses.dataclass
class ThresholdLaw(_TwoMassHeat):
    """Heat in wire and silicone; torque sets in at a threshold, then it is linear.

        torque = β w (p((T - T_k) / w) - p((T0 - T_k) / w)),  p(z) = ln(1 + exp(z))

    Heat is that of `TwoMassLaw`.

    - ``a1``, ``a2``, ``a3``, ``silicone_warming``, ``silicone_cooling``: as of `TwoMassLaw`.
    - ``beta``: joint torque per degree far above the knee, N·m/°C.
    - ``knee``: T_k, about which torque sets in, °C.
    - ``width``: w, of the knee, °C.
    """

    beta: float = quantity(7.0e-4, "N·m/°C", 1e-8, 1.0)
    knee: float = quantity(48.0, "°C", -20.0, 200.0)
    width: float = quantity(7.0, "°C", 1.0, 100.0)

    def torque(self, x, T0, theta):
        """See the class."""
        above, cold = (np.log(1.0 + np.exp((T - self.knee) / self.width)) for T in (x[0], T0))
        return self.beta * self.width * (above - cold)


@dataclasses.dataclass
class SaturatingLaw(_TwoMassHeat):
    """Heat in wire and silicone; torque follows temperature along an S-shaped curve.

        torque = M (s((T - T_m) / w) - s((T0 - T_m) / w)),  s(z) = 1 / (1 + exp(-z))

    Heat is that of `TwoMassLaw`.

    - ``a1``, ``a2``, ``a3``, ``silicone_warming``, ``silicone_cooling``: as of `TwoMassLaw`.
    - ``full_torque``: M, joint torque of the transformed wire, N·m.
    - ``middle``: T_m, at which half of the wire is transformed, °C.
    - ``width``: w, of the curve, °C.
    """

    full_torque: float = quantity(0.035, "N·m", 1e-8, 100.0)
    middle: float = quantity(62.0, "°C", -20.0, 300.0)
    width: float = quantity(10.0, "°C", 1.0, 100.0)

    def torque(self, x, T0, theta):
        """See the class."""
        T = x[0]
        return self.full_torque * (
            _logistic((T - self.middle) / self.width) - _logistic((T0 - self.middle) / self.width)
        )


@dataclasses.dataclass
class HystereticLaw(_TwoMassHeat):
    """Heat in wire and silicone; torque follows the transformation, which has hysteresis.

    The transformed share ξ follows one S-shaped curve while the wire heats and
    another one while it cools, by Duhem's differential law:

        dξ/dT = u (1 - ξ) s((T - T_h) / w) / w + (1 - u) ξ s((T_c - T) / w) / w
        u = s(Ṫ / r),  torque = M ξ

    with the logistic function s; u switches smoothly from cooling, 0, to
    heating, 1. While the temperature stays, so does ξ. Heat is that of `TwoMassLaw`.

    - ``a1``, ``a2``, ``a3``, ``silicone_warming``, ``silicone_cooling``: as of `TwoMassLaw`.
    - ``full_torque``: M, joint torque of the transformed wire, N·m.
    - ``heating_middle``, ``cooling_middle``: T_h, T_c, at which half of the
      wire is transformed on either curve, °C.
    - ``width``: w, of the curves, °C.
    - ``switching_rate``: r, rate of temperature over which u switches, °C/s.
    """

    states: ClassVar[dict[str, float]] = {**_TwoMassHeat.states, "xi": 0.5}
    settings: ClassVar[tuple[str, ...]] = ("switching_rate",)

    full_torque: float = quantity(0.038, "N·m", 1e-8, 100.0)
    heating_middle: float = quantity(66.0, "°C", -20.0, 300.0)
    cooling_middle: float = quantity(58.0, "°C", -20.0, 300.0)
    width: float = quantity(9.0, "°C", 1.0, 100.0)
    switching_rate: float = quantity(1.0, "°C/s", 0.01, 100.0)

    def rates(self, x, D, T0):
        """See the class."""
        T, _, xi = x
        heating, warming = super().rates(x, D, T0)
        rising = _logistic(heating / self.switching_rate)
        slope = (
            rising * (1.0 - xi) * _logistic((T - self.heating_middle) / self.width)
            + (1.0 - rising) * xi * _logistic((self.cooling_middle - T) / self.width)
        ) / self.width
        return [heating, warming, slope * heating]

    def torque(self, x, T0, theta):
        """M ξ."""
        return self.full_torque * x[2]

    def cold_states(self, T0):
        """Nothing is transformed."""
        return [T0, T0, 0.0]

    def warm_states(self, T, T0):
        """On the curve of heating, which starts at ambient temperature with ξ = 0."""
        ends = [1.0 + np.exp((t - self.heating_middle) / self.width) for t in (T0, T)]
        return [T, T0, 1.0 - ends[0] / ends[1]]


def _logistic(z):
    return 0.5 * (1.0 + np.tanh(0.5 * z))
