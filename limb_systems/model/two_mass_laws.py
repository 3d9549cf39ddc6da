"""Laws of wires in warm silicone, whose torque is linear, sets in, saturates or remembers.

Published recordings of limbs of this family are predicted best by them: the
silicone around a wire is a second thermal mass, and torque has a threshold. The
default values describe the nominal limb with such wires.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from limb_systems.model.wire_law import TEMPERATURE_SCALE, WireLaw
from limb_systems.schema import quantity

# Of the temperature that tells heating from cooling: b, ε, °C, and τ, s. A reversal costs 2 b
# without transformation, which public records cannot tell from none. Paths are told from rest by
# their direction down to a few mK/s, and τ is as short as the steps of simulations allow.
BACKLASH, SOFTNESS, FOLLOWING = 1.0, 0.15, 0.3
GRADUAL = 1.5  # ε, °C, and τ, s, of paths that turn so gradually that solvers follow them easily


@dataclasses.dataclass
class _TwoMassHeat(WireLaw):
    """Heat flows from the wire, T, to the silicone around it, S, and from there to the room."""

    states: ClassVar[dict[str, float]] = {"T": TEMPERATURE_SCALE, "S": TEMPERATURE_SCALE}

    a1: float = quantity(-0.08, "1/s", -10.0, -1e-4)
    a2: float = quantity(20.0, "°C/s", 0.1, 1000.0)
    a3: float = quantity(-1.0, "1/s", -100.0, -1e-3)
    silicone_warming: float = quantity(0.004, "1/s", 1e-5, 10.0)
    silicone_cooling: float = quantity(0.012, "1/s", 1e-4, 10.0)

    def rates(self, x: Sequence[Any] | np.ndarray, D: Any, T0: Any) -> Sequence[Any]:
        """Ṫ = a1 (T - S) + a2 D,  Ṡ = kS (T - S) - kA (S - T0)."""
        S, warmer = x[1], x[0] - x[1]
        return [
            self.a1 * warmer + self.a2 * D,
            self.silicone_warming * warmer - self.silicone_cooling * (S - T0),
        ]

    def reading_rate(self, V, x):
        """V̇ = a3 (V - T), eqn (7)."""
        return self.a3 * (V - x[0])

    def typical_rates(self):
        """Cooling at -a1 while the silicone is cold, and at -a1 kA / (kS + kA) once it is warm."""
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

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """β (T - T0), eqn (4)."""
        return self.beta * (x[0] - T0)


@dataclasses.dataclass
class ThresholdLaw(_TwoMassHeat):
    """Heat in wire and silicone; torque sets in at a threshold, then it is linear.

        torque = β w (p((T - T_k) / w) - p((T0 - T_k) / w)),  p(z) = ln(1 + exp(z))

    The heat follows `TwoMassLaw`.

    - ``a1``, ``a2``, ``a3``, ``silicone_warming``, ``silicone_cooling``: as in `TwoMassLaw`.
    - ``beta``: joint torque per degree far above the knee, N·m/°C.
    - ``knee``: T_k, about which torque sets in, °C.
    - ``width``: w, width of the knee, °C.
    """

    beta: float = quantity(7.0e-4, "N·m/°C", 1e-8, 1.0)
    knee: float = quantity(48.0, "°C", -20.0, 200.0)
    width: float = quantity(7.0, "°C", 1.0, 100.0)

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """See the class."""
        above, cold = (np.log(1.0 + np.exp((T - self.knee) / self.width)) for T in (x[0], T0))
        return self.beta * self.width * (above - cold)


@dataclasses.dataclass
class SaturatingLaw(_TwoMassHeat):
    """Heat in wire and silicone; torque follows temperature along an S-shaped curve.

        torque = M (s((T - T_m) / w) - s((T0 - T_m) / w)),  s(z) = 1 / (1 + exp(-z))

    The heat follows `TwoMassLaw`.

    - ``a1``, ``a2``, ``a3``, ``silicone_warming``, ``silicone_cooling``: as in `TwoMassLaw`.
    - ``full_torque``: M, joint torque of the transformed wire, N·m.
    - ``middle``: T_m, at which half of the wire is transformed, °C.
    - ``width``: w, of the curve, °C.
    """

    full_torque: float = quantity(0.035, "N·m", 1e-8, 100.0)
    middle: float = quantity(62.0, "°C", -20.0, 300.0)
    width: float = quantity(10.0, "°C", 1.0, 100.0)

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """See the class."""
        T = x[0]
        return self.full_torque * (
            _logistic((T - self.middle) / self.width) - _logistic((T0 - self.middle) / self.width)
        )


@dataclasses.dataclass
class HystereticLaw(_TwoMassHeat):
    """Heat in wire and silicone; torque follows the transformation, which has hysteresis.

    The transformed share ξ follows one S-shaped curve while the wire heats and
    another one while it cools, by Duhem's differential law, along the path of a
    temperature B that follows T with a little backlash b, so that the path says
    by itself whether it goes up or down, however slowly:

        Ḃ = p(T - B) - p(B - T),  p(z) = (ε / τ) ln(1 + exp((z - b) / ε))
        ξ̇ = (1 - ξ) s((T - T_h) / w) / w p(T - B) - ξ s((T_c - T) / w) / w p(B - T)
        torque = M ξ

    with the logistic function s. Both terms end where ξ does, and so it stays
    from 0 to 1. While the temperature stays, so does ξ. The heat follows `TwoMassLaw`.

    - ``a1``, ``a2``, ``a3``, ``silicone_warming``, ``silicone_cooling``: as in `TwoMassLaw`.
    - ``full_torque``: M, joint torque of the transformed wire, N·m.
    - ``heating_middle``, ``cooling_middle``: T_h, T_c, at which half of the
      wire is transformed on either curve, °C.
    - ``width``: w, of the curves, °C.
    """

    states: ClassVar[dict[str, float]] = {
        **_TwoMassHeat.states,
        "B": TEMPERATURE_SCALE,
        "xi": 0.5,
    }
    memory: ClassVar[dict[str, tuple[float, float]]] = {"B": (-np.inf, np.inf), "xi": (0.0, 1.0)}
    below: ClassVar[dict[str, str]] = {"cooling_middle": "heating_middle"}
    turning: ClassVar[tuple[float, float]] = SOFTNESS, FOLLOWING

    full_torque: float = quantity(0.038, "N·m", 1e-8, 100.0)
    heating_middle: float = quantity(66.0, "°C", -20.0, 300.0)
    cooling_middle: float = quantity(58.0, "°C", -20.0, 300.0)
    width: float = quantity(9.0, "°C", 1.0, 100.0)

    def rates(self, x: Sequence[Any] | np.ndarray, D: Any, T0: Any) -> Sequence[Any]:
        """See the class."""
        T, _, B, xi = x
        # Both ways at once, because calls of numpy take longer than what they do.
        ahead, (softness, following) = np.array([T - B, B - T]), self.turning
        rise, fall = softness / following * _softplus((ahead - BACKLASH) / softness)
        beyond = np.array([T - self.heating_middle, self.cooling_middle - T])
        heating, cooling = _logistic(beyond / self.width)
        up, down = (1.0 - xi) * heating / self.width, xi * cooling / self.width
        return [*super().rates(x[:2], D, T0), rise - fall, up * rise - down * fall]

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """M ξ."""
        return self.full_torque * x[3]

    def cold_states(self, T0: float) -> Sequence[float]:
        """Nothing is transformed, and heat meets no backlash, so that plans see it act."""
        return [T0, T0, T0 - BACKLASH, 0.0]

    def easier(self) -> WireLaw:
        """Return the law with a path that turns gradually."""
        return _GradualLaw(**vars(self))

    def warm_states(self, T: Any, T0: float) -> Sequence[Any]:
        """On the curve of heating, which starts at ambient temperature with ξ = 0."""
        ends = [1.0 + np.exp((t - self.heating_middle) / self.width) for t in (T0, T)]
        return [T, T0, T - BACKLASH, 1.0 - ends[0] / ends[1]]


class _GradualLaw(HystereticLaw):
    """The hysteretic law whose path turns gradually, for the start of plans."""

    turning: ClassVar[tuple[float, float]] = GRADUAL, GRADUAL

    def easier(self) -> WireLaw:
        """Return the law without hysteresis, whose curve is midway between the two."""
        heat = {field.name: getattr(self, field.name) for field in dataclasses.fields(_TwoMassHeat)}
        middle = 0.5 * (self.heating_middle + self.cooling_middle)
        return SaturatingLaw(**heat, full_torque=self.full_torque, middle=middle, width=self.width)


def _logistic(z):
    return 0.5 * (1.0 + np.tanh(0.5 * z))


def _softplus(z):
    """ln(1 + exp(z)), where exp(z) may be too large for a number, too."""
    size = np.sqrt(z**2 + 1e-12)  # |z|, whose derivative all scalar types have at 0
    return 0.5 * (z + size) + np.log(1.0 + np.exp(-size))
