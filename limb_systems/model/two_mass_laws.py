"""Laws of wires in warm silicone, whose torque is linear, sets in, saturates or remembers.

Published recordings of limbs of this family are predicted best by them: the
silicone around a wire is a second thermal mass, or two, and torque has a threshold. The
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
        rise, fall = self._play(T, B, BACKLASH)
        return [*super().rates(x[:2], D, T0), rise - fall, self._transforming(T, xi, rise, fall)]

    def _play(self, T: Any, P: Any, half_width: Any) -> tuple[Any, Any]:
        """Rates at which P rises and falls, °C/s, that follows T with a backlash ± half_width."""
        # Both ways at once, because calls of numpy take longer than what they do.
        ahead, (softness, following) = np.array([T - P, P - T]), self.turning
        rise, fall = softness / following * _softplus((ahead - half_width) / softness)
        return rise, fall

    @property
    def _middle(self) -> Any:
        """(T_h + T_c) / 2, °C."""
        return 0.5 * (self.heating_middle + self.cooling_middle)

    def _transforming(self, T: Any, xi: Any, rise: Any, fall: Any) -> Any:
        """ξ̇, 1/s, where B rises or falls at these rates."""
        beyond = np.array([T - self.heating_middle, self.cooling_middle - T])
        heating, cooling = _logistic(beyond / self.width)
        return ((1.0 - xi) * heating * rise - xi * cooling * fall) / self.width

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
        return SaturatingLaw(**_of(_TwoMassHeat, self), **_midway(self))


@dataclasses.dataclass
class _ThreeMassHeat(_TwoMassHeat):
    """Heat of wire, silicone around it and outer silicone, R; the wire cools to the room, too."""

    states: ClassVar[dict[str, float]] = {**_TwoMassHeat.states, "R": TEMPERATURE_SCALE}

    outer_warming: float = quantity(0.005, "1/s", 0.0, 1.0)
    outer_cooling: float = quantity(0.008, "1/s", 1e-4, 1.0)
    direct_cooling: float = quantity(0.01, "1/s", 0.0, 1.0)
    convection: float = quantity(1e-4, "1/(s·°C)", 0.0, 0.1)
    silicone_share: float = quantity(0.1, "1", 0.0, 0.9)

    def rates(self, x: Sequence[Any] | np.ndarray, D: Any, T0: Any) -> Sequence[Any]:
        """Those of wire, silicone and outer silicone, as in `CoupledLaw`, without ż."""
        T, S, R = x
        above = T - T0
        lost = self.direct_cooling * above + self.convection * above**2
        return [
            self.a1 * (T - S) - lost + self.a2 * D,
            self.silicone_warming * (T - S) - self.silicone_cooling * (S - R),
            self.outer_warming * (S - R) - self.outer_cooling * (R - T0),
        ]

    def reading_rate(self, V, x):
        """V̇ = a3 (V - (1 - μ) T - μ S)."""
        return self.a3 * (V - x[0] - self.silicone_share * (x[1] - x[0]))


@dataclasses.dataclass
class CoupledLaw(_ThreeMassHeat, HystereticLaw):
    """Heat in three masses, coupled to a transformation under stress; rubber that creeps.

        Ṫ = a1 (T - S) - (h0 + h1 (T - T0)) (T - T0) + a2 (1 - ρ ξ) D - L ż
        Ṡ = kS (T - S) - kA (S - R)
        Ṙ = kR (S - R) - kO (R - T0)
        V̇ = a3 (V - (1 - μ) T - μ S)
        z = (1 - m) ξ + m (F(P) - F(T0 - r)),  F(P) = s((P - (T_h + T_c) / 2) / w)
        Ċ = kC (z - C)
        torque = M ((1 - c) z + c C)

    ξ is that of `HystereticLaw`, with the backlash b of B, at the temperature T - σ ξ: stress moves
    its curves upwards in proportion to the pull (Clausius-Clapeyron). P follows this temperature in
    the same way, with the backlash r = (T_h - T_c) / 2, as a play of the Prandtl-Ishlinskii model:
    minor loops close along it, while those of Duhem's law creep. Wires are in between.

    Rubber that bends at once and creeps on (a standard linear solid) holds a limb at rest as one
    does whose spring is elastic, and whose torque comes late in part: C is that part. Loads other
    than wires do not make it creep.

    - ``a1``, ``a2``, ``a3``, ``silicone_warming``, ``full_torque``, ``heating_middle``,
      ``cooling_middle``, ``width``: as in `HystereticLaw`.
    - ``silicone_cooling``: kA, rate at which the silicone cools to the outer silicone, 1/s.
    - ``outer_warming``, ``outer_cooling``: kR, kO, rates at which the outer silicone warms, and
      cools to ambient, 1/s.
    - ``direct_cooling``, ``convection``: h0, rate at which the wire cools to ambient by itself,
      1/s, and h1, its rise per degree, 1/(s·°C).
    - ``silicone_share``: μ, of the silicone's temperature in what the thermocouple shows.
    - ``heating_drop``: ρ, share of the heating that is lost as the wire's resistance changes.
    - ``latent_heat``: L, of the whole transformation, as °C of the wire.
    - ``backlash``: b, °C.
    - ``play_share``: m.
    - ``stress_shift``: σ, at full pull, °C.
    - ``creep_share``, ``creep_rate``: c, share of the bend that comes late, and kC, 1/s.
    """

    states: ClassVar[dict[str, float]] = {
        **_ThreeMassHeat.states,
        **dict.fromkeys(["B", "P"], TEMPERATURE_SCALE),
        "xi": 0.5,
        "C": 0.5,
    }
    memory: ClassVar[dict[str, tuple[float, float]]] = {
        **HystereticLaw.memory,
        "P": (-np.inf, np.inf),
    }

    heating_drop: float = quantity(0.0, "1", -0.25, 0.25)
    latent_heat: float = quantity(8.0, "°C", 0.0, 60.0)
    backlash: float = quantity(BACKLASH, "°C", 0.0, 20.0)
    play_share: float = quantity(0.5, "1", 0.0, 1.0)
    stress_shift: float = quantity(0.0, "°C", 0.0, 40.0)
    creep_share: float = quantity(0.0, "1", 0.0, 0.6)
    creep_rate: float = quantity(0.2, "1/s", 0.02, 4.0)

    def rates(self, x: Sequence[Any] | np.ndarray, D: Any, T0: Any) -> Sequence[Any]:
        """See the class."""
        T, *_, B, P, xi, C = x
        free = T - self.stress_shift * xi  # of stress
        rise, fall = self._play(free, B, self.backlash)
        transforming = self._transforming(free, xi, rise, fall)
        along = np.subtract(*self._play(free, P, self._half_loop))
        F = self._along(P)
        gained = F * (1.0 - F) / self.width * along
        gained = transforming + self.play_share * (gained - transforming)
        heating = (1.0 - self.heating_drop * xi) * D
        heated, *others = _ThreeMassHeat.rates(self, x[:3], heating, T0)
        heated = heated - self.latent_heat * gained
        creeping = self.creep_rate * (self._transformed(P, xi, T0) - C)
        return [heated, *others, rise - fall, along, transforming, creeping]

    @property
    def _half_loop(self) -> Any:
        """r, °C."""
        return 0.5 * (self.heating_middle - self.cooling_middle)

    def _along(self, P: Any) -> Any:
        """F(P)."""
        return _logistic((P - self._middle) / self.width)

    def _transformed(self, P: Any, xi: Any, T0: Any) -> Any:
        """z."""
        along = self._along(P) - self._along(T0 - self._half_loop)
        return xi + self.play_share * (along - xi)

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """M ((1 - c) z + c C)."""
        *_, P, xi, C = x
        z = self._transformed(P, xi, T0)
        return self.full_torque * (z + self.creep_share * (C - z))

    def cold_states(self, T0: float) -> Sequence[float]:
        """Nothing is transformed, and heat meets no backlash, so that plans see it act."""
        return [T0, T0, T0, T0 - self.backlash, T0 - self._half_loop, 0.0, 0.0]

    def warm_states(self, T: Any, T0: float) -> Sequence[Any]:
        """On the curve of heating, which starts at ambient temperature with z = 0."""

        def on_curve(free: float) -> float:
            return super(CoupledLaw, self).warm_states(free, T0)[-1]

        def excess(free: float) -> float:
            return free + self.stress_shift * on_curve(free) - T

        from scipy.optimize import brentq  # takes long to import

        free = brentq(excess, T - self.stress_shift - 1.0, T + 1.0) if self.stress_shift else T
        P, xi = free - self._half_loop, on_curve(free)
        return [T, T0, T0, free - self.backlash, P, xi, self._transformed(P, xi, T0)]

    def typical_rates(self) -> dict[str, float]:
        """Rates as of `HystereticLaw`, with the heating of a wire that is half transformed."""
        return {**super().typical_rates(), "heating": self.a2 * (1.0 - 0.5 * self.heating_drop)}

    def easier(self) -> WireLaw:
        """Return the law with paths that turn gradually."""
        return _GradualCoupledLaw(**vars(self))


class _GradualCoupledLaw(CoupledLaw):
    """The coupled law whose paths turn gradually, for the start of plans."""

    turning: ClassVar[tuple[float, float]] = GRADUAL, GRADUAL

    def easier(self) -> WireLaw:
        """Return the law without hysteresis, latent heat and creep, whose curve is midway.

        Stress moves the middle of a curve of T by σ / 2, and its slope there, 1 / (4 w), to
        1 / (4 w + σ).
        """
        curve, shift = _midway(self), self.stress_shift
        curve |= {"middle": curve["middle"] + shift / 2, "width": curve["width"] + shift / 4}
        return _WarmLaw(**_of(_ThreeMassHeat, self), **curve)


@dataclasses.dataclass
class _WarmLaw(_ThreeMassHeat, SaturatingLaw):
    """The coupled law without its memory."""

    states: ClassVar[dict[str, float]] = _ThreeMassHeat.states


def _of(heat: type[WireLaw], law: WireLaw) -> dict[str, float]:
    """The fields of a law that say how its wire heats."""
    return {field.name: getattr(law, field.name) for field in dataclasses.fields(heat)}  # type: ignore[arg-type]


def _midway(law: HystereticLaw) -> dict[str, float]:
    """The curve of `SaturatingLaw` midway between those of heating and cooling."""
    return {"full_torque": law.full_torque, "middle": law._middle, "width": law.width}


def _logistic(z):
    return 0.5 * (1.0 + np.tanh(0.5 * z))


def _softplus(z):
    """ln(1 + exp(z)), where exp(z) may be too large for a number, too."""
    size = np.sqrt(z**2 + 1e-12)  # |z|, whose derivative all scalar types have at 0
    return 0.5 * (z + size) + np.log(1.0 + np.exp(-size))
