"""Heat in three masses, coupled to a transformation under stress; rubber that creeps."""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from limb_systems.files.schema import quantity
from limb_systems.wire_laws.hysteretic import (
    BACKLASH,
    GRADUAL_TURNING,
    HystereticLaw,
    heat_fields,
    midway,
)
from limb_systems.wire_laws.saturating import SaturatingLaw
from limb_systems.wire_laws.two_mass import _TwoMassHeat
from limb_systems.wire_laws.wire_law import TEMPERATURE_SCALE, Prior, WireLaw, logistic

NUM_BISECTIONS = 50  # of a shift of some °C, to rounding

# Priors. Latent heat: 6 to 20 J/g of NiTi wires and 0.5 to 0.9 J/(g K), of which coils in silicone
# show a part. Direct losses: of leads, and free convection by the fourth root of the temperature
# difference. Heating: resistance of austenite is 10 to 20% below martensite's, at constant
# current or voltage. Stress: 7 to 14 MPa/°C of such wires. Creep: silicones relax by a tenth or two
# within some seconds, in the same way for all wires.


@dataclasses.dataclass
class _ThreeMassHeat(_TwoMassHeat):
    """Heat of wire, silicone around it and outer silicone, R; the wire cools to the room, too."""

    states: ClassVar[dict[str, float]] = {**_TwoMassHeat.states, "R": TEMPERATURE_SCALE}

    outer_warming: float = quantity(
        0.005,
        "1/s",
        0.0,
        1.0,
        "kR, rate at which the outer silicone warms",
        Prior(0.005, 0.02, 0.002),
    )
    outer_cooling: float = quantity(
        0.008,
        "1/s",
        1e-4,
        1.0,
        "kO, rate at which the outer silicone cools to ambient",
        Prior(0.008, 0.6, 0.2),
    )
    direct_cooling: float = quantity(
        0.01,
        "1/s",
        0.0,
        1.0,
        "h0, rate at which the wire cools to ambient by itself",
        Prior(0.01, 0.03, 0.003),
    )
    convection: float = quantity(
        1e-4, "1/(s·°C)", 0.0, 0.1, "h1, rise of this rate per degree", Prior(1e-4, 3e-4, 3e-5)
    )
    silicone_share: float = quantity(
        0.1,
        "1",
        0.0,
        0.9,
        "μ, share of the silicone's temperature in what the thermocouple shows",
        Prior(0.1, 0.15, 0.1),
    )

    def rates(self, x: Sequence[Any] | np.ndarray, D: Any, T0: Any) -> Sequence[Any]:
        """Return Ṫ, Ṡ and Ṙ as in `CoupledLaw`, without ż."""
        T, S, R = x
        rise = T - T0
        direct_loss = self.direct_cooling * rise + self.convection * rise**2
        return [
            self.a1 * (T - S) - direct_loss + self.a2 * D,
            self.silicone_warming * (T - S) - self.silicone_cooling * (S - R),
            self.outer_warming * (S - R) - self.outer_cooling * (R - T0),
        ]

    def reading_rate(self, V, x):
        """Return V̇ = a3 (V - (1 - μ) T - μ S)."""
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

    ξ follows `HystereticLaw`, with the backlash b of B, at the temperature T - σ ξ: stress moves
    its curves upwards in proportion to the pull (Clausius-Clapeyron). P follows this temperature in
    the same way, with the backlash r = (T_h - T_c) / 2, as a play of the Prandtl-Ishlinskii model:
    its minor loops close, while the minor loops of Duhem's law creep. Wires are in between.

    Rubber that bends at once and creeps on (a standard linear solid) is modelled as an elastic
    spring under a torque of which a part, C, is late. Loads other than wires do not make it creep.

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

    heating_drop: float = quantity(
        0.0,
        "1",
        -0.25,
        0.25,
        "ρ, share of the heating that is lost as the wire's resistance changes",
        Prior(0.0, 0.1, 0.02),
    )
    latent_heat: float = quantity(
        8.0,
        "°C",
        0.0,
        60.0,
        "L, heat of the whole transformation, as a temperature of the wire",
        Prior(8.0, 6.0, 1.0),
    )
    backlash: float = quantity(
        BACKLASH, "°C", 0.0, 20.0, "b, half-width of the play of B", Prior(1.0, 1.5, 0.3)
    )
    play_share: float = quantity(
        0.5, "1", 0.0, 1.0, "m, share of the play in the torque", Prior(0.5, 0.5, 0.05)
    )
    stress_shift: float = quantity(
        0.0, "°C", 0.0, 40.0, "σ, shift of the curves at full pull", Prior(6.0, 6.0, 1.0)
    )
    creep_share: float = quantity(
        0.0, "1", 0.0, 0.6, "c, share of the bend that comes late", Prior(0.1, 0.15, 0.003)
    )
    creep_rate: float = quantity(
        0.2, "1/s", 0.02, 4.0, "kC, rate at which it comes", Prior(0.25, 0.7, 0.02)
    )

    def rates(self, x: Sequence[Any] | np.ndarray, D: Any, T0: Any) -> Sequence[Any]:
        """Return the rates of T, S, R, B, P, ξ and C, see the class."""
        T, *_, B, P, xi, C = x
        free_temperature = T - self.stress_shift * xi  # without stress
        # The rates of B, ξ and P.
        rise, fall = self._play(free_temperature, B, self.backlash)
        xi_rate = self._transforming(free_temperature, xi, rise, fall)
        P_rate = np.subtract(*self._play(free_temperature, P, self._half_loop))
        # The rate of z, with F' = F (1 - F) / w.
        F = self._logistic_of_play(P)
        F_rate = F * (1.0 - F) / self.width * P_rate
        z_rate = xi_rate + self.play_share * (F_rate - xi_rate)
        # The rates of heat and creep.
        heating = (1.0 - self.heating_drop * xi) * D
        T_rate, *silicone_rates = _ThreeMassHeat.rates(self, x[:3], heating, T0)
        T_rate = T_rate - self.latent_heat * z_rate
        C_rate = self.creep_rate * (self._transformed(F, xi, T0) - C)
        return [T_rate, *silicone_rates, rise - fall, P_rate, xi_rate, C_rate]

    @property
    def _half_loop(self) -> Any:
        """Half the width of the hysteresis loop r, °C."""
        return 0.5 * (self.heating_middle - self.cooling_middle)

    def _logistic_of_play(self, P: Any) -> Any:
        """Return F(P)."""
        return logistic((P - self._middle) / self.width)

    def _transformed(self, F: Any, xi: Any, T0: Any) -> Any:
        """Return the transformed share z, for F = F(P)."""
        gained = F - self._logistic_of_play(T0 - self._half_loop)
        return xi + self.play_share * (gained - xi)

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """Return M ((1 - c) z + c C)."""
        *_, P, xi, C = x
        z = self._transformed(self._logistic_of_play(P), xi, T0)
        return self.full_torque * (z + self.creep_share * (C - z))

    def cold_states(self, T0: float) -> Sequence[float]:
        """Return states without transformation and backlash, so that heat acts at once."""
        return [T0, T0, T0, T0 - self.backlash, T0 - self._half_loop, 0.0, 0.0]

    def warm_states(self, T: Any, T0: float) -> Sequence[Any]:
        """Return states on the curve of heating, which starts at ambient temperature with z = 0."""

        def transformed_share(free_temperature: float) -> float:
            return super(CoupledLaw, self).warm_states(free_temperature, T0)[-1]

        # Find the temperature without stress by bisection: stress raises it by its shift at most.
        low = T - self.stress_shift
        high = T
        for _ in range(NUM_BISECTIONS if self.stress_shift else 0):
            middle = 0.5 * (low + high)
            if middle + self.stress_shift * transformed_share(middle) < T:
                low = middle
            else:
                high = middle
        free_temperature = high
        xi = transformed_share(free_temperature)
        P = free_temperature - self._half_loop
        z = self._transformed(self._logistic_of_play(P), xi, T0)
        return [T, T0, T0, free_temperature - self.backlash, P, xi, z]

    def typical_rates(self) -> dict[str, float]:
        """Return the rates of `HystereticLaw`, with the heating of a half transformed wire."""
        return {**super().typical_rates(), "heating": self.a2 * (1.0 - 0.5 * self.heating_drop)}

    def smoothed(self) -> WireLaw:
        """Return the law with paths that turn gradually."""
        return _GradualCoupledLaw(**vars(self))


class _GradualCoupledLaw(CoupledLaw):
    """The coupled law whose paths turn gradually, for the start of plans."""

    turning: ClassVar[tuple[float, float]] = GRADUAL_TURNING

    def smoothed(self) -> WireLaw:
        """Return the law without hysteresis, latent heat and creep, whose curve is midway.

        Stress moves the middle of a curve of T by σ / 2, and its slope there, 1 / (4 w), to
        1 / (4 w + σ).
        """
        curve = midway(self)
        curve["middle"] += self.stress_shift / 2
        curve["width"] += self.stress_shift / 4
        return _WarmLaw(**heat_fields(_ThreeMassHeat, self), **curve)


@dataclasses.dataclass
class _WarmLaw(_ThreeMassHeat, SaturatingLaw):
    """The coupled law without its memory."""

    states: ClassVar[dict[str, float]] = _ThreeMassHeat.states
