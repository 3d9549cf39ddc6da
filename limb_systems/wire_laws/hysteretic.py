"""Heat in wire and silicone, and torque of a transformation with hysteresis."""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from limb_systems.files.schema import quantity
from limb_systems.wire_laws.saturating import SaturatingLaw
from limb_systems.wire_laws.two_mass import _TwoMassHeat
from limb_systems.wire_laws.wire_law import (
    FULL_TORQUE,
    MIDDLE,
    SLOW_HEATING,
    TEMPERATURE_SCALE,
    WIDTH,
    Prior,
    WireLaw,
    logistic,
    softplus,
)

# Backlash b and softness ε, °C, and time τ, s, of the temperature B that distinguishes heating from
# cooling. A reversal costs 2 b without transformation, which public records cannot distinguish
# from none. B follows changes down to a few mK/s. τ is as short as simulation steps allow.
BACKLASH, SOFTNESS, FOLLOWING_TIME = 1.0, 0.15, 0.3
# ε, °C, and τ, s, of paths that turn so gradually that solvers follow them easily
GRADUAL_TURNING = 0.7, 0.8


@dataclasses.dataclass
class HystereticLaw(_TwoMassHeat):
    """Heat in wire and silicone; torque follows the transformation, which has hysteresis.

    The transformed share ξ follows one S-shaped curve while the wire heats and
    another one while it cools, by Duhem's differential law. Along it runs a
    temperature B that follows T with a little backlash b, so that the rates of B
    distinguish heating from cooling, however slow:

        Ḃ = p(T - B) - p(B - T),  p(z) = (ε / τ) ln(1 + exp((z - b) / ε))
        ξ̇ = (1 - ξ) s((T - T_h) / w) / w p(T - B) - ξ s((T_c - T) / w) / w p(B - T)
        torque = M ξ

    with the logistic function s. Both terms end where ξ does, and so it stays
    from 0 to 1. While the temperature stays, so does ξ. The heat follows `TwoMassLaw`.

    """

    states: ClassVar[dict[str, float]] = {
        **_TwoMassHeat.states,
        "B": TEMPERATURE_SCALE,
        "xi": 0.5,
    }
    memory: ClassVar[dict[str, tuple[float, float]]] = {"B": (-np.inf, np.inf), "xi": (0.0, 1.0)}
    below: ClassVar[dict[str, str]] = {"cooling_middle": "heating_middle"}
    turning: ClassVar[tuple[float, float]] = SOFTNESS, FOLLOWING_TIME

    full_torque: float = quantity(
        0.038, "N·m", 1e-8, 100.0, "M, joint torque of the transformed wire", FULL_TORQUE
    )
    heating_middle: float = quantity(
        66.0,
        "°C",
        -20.0,
        300.0,
        "T_h, at which half of the wire is transformed as it heats",
        MIDDLE,
    )
    cooling_middle: float = quantity(
        58.0,
        "°C",
        -20.0,
        300.0,
        "T_c, at which half of the wire is transformed as it cools",
        Prior(8.0, 0.7, 0.3, SLOW_HEATING),
    )
    width: float = quantity(9.0, "°C", 1.0, 100.0, "w, width of both curves", WIDTH)

    def rates(self, x: Sequence[Any] | np.ndarray, D: Any, T0: Any) -> Sequence[Any]:
        """Return the rates of T, S, B and ξ, see the class."""
        T, _, B, xi = x
        rise, fall = self._play(T, B, BACKLASH)
        xi_rate = self._transforming(T, xi, rise, fall)
        return [*super().rates(x[:2], D, T0), rise - fall, xi_rate]

    def _play(self, T: Any, P: Any, half_width: Any) -> tuple[Any, Any]:
        """Return the rates, °C/s, of rise and fall of P, which follows T with a backlash.

        Ṗ is rise - fall.
        """
        softness, following_time = self.turning
        rise = softness / following_time * softplus((T - P - half_width) / softness)
        fall = softness / following_time * softplus((P - T - half_width) / softness)
        return rise, fall

    @property
    def _middle(self) -> Any:
        """(T_h + T_c) / 2, °C."""
        return 0.5 * (self.heating_middle + self.cooling_middle)

    def _transforming(self, T: Any, xi: Any, rise: Any, fall: Any) -> Any:
        """Return ξ̇, 1/s, where B rises and falls at these rates, °C/s."""
        heating = logistic((T - self.heating_middle) / self.width)
        cooling = logistic((self.cooling_middle - T) / self.width)
        return ((1.0 - xi) * heating * rise - xi * cooling * fall) / self.width

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """Return M ξ."""
        return self.full_torque * x[3]

    def cold_states(self, T0: float) -> Sequence[float]:
        """Return states without transformation and backlash, so that heat acts at once."""
        return [T0, T0, T0 - BACKLASH, 0.0]

    def smoothed(self) -> WireLaw:
        """Return the law with a path that turns gradually."""
        return _GradualLaw(**vars(self))

    def warm_states(self, T: Any, T0: float) -> Sequence[Any]:
        """Return states on the curve of heating, which starts at ambient temperature with ξ = 0."""
        at_ambient = 1.0 + np.exp((T0 - self.heating_middle) / self.width)
        at_T = 1.0 + np.exp((T - self.heating_middle) / self.width)
        return [T, T0, T - BACKLASH, 1.0 - at_ambient / at_T]


class _GradualLaw(HystereticLaw):
    """The hysteretic law whose path turns gradually, for the start of plans."""

    turning: ClassVar[tuple[float, float]] = GRADUAL_TURNING

    def smoothed(self) -> WireLaw:
        """Return the law without hysteresis, whose curve is midway between the two."""
        return SaturatingLaw(**heat_fields(_TwoMassHeat, self), **midway(self))


def heat_fields(heat: type[WireLaw], law: WireLaw) -> dict[str, float]:
    """Return the fields of a law that belong to its heat."""
    return {field.name: getattr(law, field.name) for field in dataclasses.fields(heat)}  # type: ignore[arg-type]


def midway(law: HystereticLaw) -> dict[str, float]:
    """Return the curve of `SaturatingLaw` midway between the curves of heating and cooling."""
    return {"full_torque": law.full_torque, "middle": law._middle, "width": law.width}
