"""Bounds of eqns (6) and (7) for each wire, with which the board watches its temperature."""

import dataclasses

from limb_systems.errors import LimbError
from limb_systems.files.schema import Strict, quantity
from limb_systems.wire_laws.wire_law import WireLaw

# Ratios of the rates of real wires to the rates of their law: ranges of published recordings and
# of the properties of shape-memory alloy, as docs/protocol.md lists them.
RATE_FACTORS = {
    "slowest_cooling": 0.6,
    "fastest_cooling": 1.36,
    "least_heating": 0.85,
    "most_heating": 1.15,
    "slowest_reading": 0.5,
}
# Pairs of the fields that are a lower and an upper bound of one rate.
BOUND_PAIRS = (("slowest_cooling", "fastest_cooling"), ("least_heating", "most_heating"))


@dataclasses.dataclass
class HeatBounds(Strict):
    """The bounds within which a wire heats, cools and is read.

    - ``slowest_cooling``, ``fastest_cooling``: bounds of -a1 (6), 1/s.
    - ``least_heating``, ``most_heating``: bounds of a2 (6), °C/s.
    - ``slowest_reading``: lower bound of -a3 (7), 1/s.
    """

    slowest_cooling: float = quantity(0.042, "1/s", 0.005, 0.2)
    fastest_cooling: float = quantity(0.095, "1/s", 0.01, 0.5)
    least_heating: float = quantity(17.0, "°C/s", 4.0, 60.0)
    most_heating: float = quantity(23.0, "°C/s", 8.0, 100.0)
    slowest_reading: float = quantity(0.5, "1/s", 0.1, 4.0)

    @classmethod
    def around(cls, law: WireLaw) -> "HeatBounds":
        """Return bounds that hold for any wire of the kind that a law describes.

        Raises:
            LimbError: if a bound is beyond the range that a board accepts, or if the law has no
                `WireLaw.typical_rates`.
        """
        rates = law.typical_rates()
        bounds: dict[str, float] = {}
        for field in dataclasses.fields(cls):
            # Multiply the rate of this bound, or the rate "heating" or "reading" of both bounds.
            rate = rates[field.name if field.name in rates else field.name.split("_")[1]]
            bound = RATE_FACTORS[field.name] * rate
            low, high = field.metadata["range"]
            if not low <= bound <= high:
                raise LimbError(
                    f"This wire's {field.name} would be {bound:.3g} {field.metadata['unit']} by "
                    f"its law, but a board accepts {low:g} to {high:g}; give the wire heat_bounds."
                )
            bounds[field.name] = bound
        return cls(**bounds)

    def widened_to_any_wire(self) -> "HeatBounds":
        """Return these bounds, widened until they hold for all wires of published recordings."""
        # Move each bound outwards.
        upper_names = [high for _, high in BOUND_PAIRS]
        widened: dict[str, float] = {}
        for name, bound in dataclasses.asdict(self).items():
            widest = max if name in upper_names else min
            widened[name] = widest(bound, getattr(ANY_WIRE_BOUNDS, name))
        return HeatBounds(**widened)


# -a1 from 0.03 to 0.09 1/s, a2 from 10 to 65 °C/s, a lag of up to 9 s. With wider bounds a board
# that was just switched on would not allow the heat by which it tests the thermocouples.
ANY_WIRE_BOUNDS = HeatBounds(0.03, 0.13, 8.0, 65.0, 0.1)
