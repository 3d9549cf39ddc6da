"""Bounds of eqns (6) and (7) for each wire, with which the board watches its temperature."""

import dataclasses

from limb_systems.errors import LimbError
from limb_systems.files.schema import Strict, quantity
from limb_systems.wire_laws.wire_law import WireLaw

# How far wires of one kind differ from their description and from the linear law: ranges of
# published recordings and of the properties of shape-memory alloy, as docs/protocol.md lists them.
RATE_FACTORS = {
    "slowest_cooling": 0.6,
    "fastest_cooling": 1.36,
    "least_heating": 0.85,
    "most_heating": 1.15,
    "slowest_reading": 0.5,
}
# Pairs of a lower and an upper bound.
BOUND_PAIRS = (("slowest_cooling", "fastest_cooling"), ("least_heating", "most_heating"))


@dataclasses.dataclass
class HeatBounds(Strict):
    """Within what bounds a wire heats, cools and is read.

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
        """Bounds that hold for any wire of the kind that a law describes.

        Raises:
            LimbError: if one is beyond what a board accepts, or if the law does not
                say its `WireLaw.typical_rates`.
        """
        rates = law.typical_rates()
        values = {
            name: share * rates[name if name in rates else name.split("_")[1]]
            for name, share in RATE_FACTORS.items()
        }
        for field in dataclasses.fields(cls):
            low, high = field.metadata["range"]
            if not low <= values[field.name] <= high:
                raise LimbError(
                    f"This wire's {field.name} would be {values[field.name]:.3g} "
                    f"{field.metadata['unit']} by its law, but a board accepts {low:g} to "
                    f"{high:g}; give the wire heat_bounds."
                )
        return cls(**values)

    def widened_to_any_wire(self) -> "HeatBounds":
        """Return these bounds, widened until they hold for all wires of published recordings."""
        upper = [high for _, high in BOUND_PAIRS]
        widened = {
            name: (max if name in upper else min)(value, getattr(ANY_WIRE_BOUNDS, name))
            for name, value in dataclasses.asdict(self).items()
        }
        return HeatBounds(**widened)


# -a1 from 0.03 to 0.09 1/s, a2 from 10 to 65 °C/s, a lag of up to 9 s. Any wider, and a board that
# was just switched on would not allow the heat by which thermocouples prove what they are worth.
ANY_WIRE_BOUNDS = HeatBounds(0.03, 0.13, 8.0, 65.0, 0.1)
