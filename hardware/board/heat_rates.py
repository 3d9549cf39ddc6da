"""How a wire heats, cools and is read, fitted to its duty and what its thermocouple read."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from hardware.firmware import heat
from limb_systems.heat_bounds import RATE_FACTORS, HeatBounds
from limb_systems.low_pass import low_pass

NARROWEST = 1.75  # times the slowest cooling of its kind, above which a wire's is not raised
LAGS = 5.0  # time constants of the thermocouple, in which a wire may cool for that to be seen
# Of the fit: heating, cooling, by how much faster it is read, as what is read would be almost
# the same if these two rates were swapped, and the silicone's share, which the board has at
# its largest.
START = 20.0, 0.06, 10.0, 0.25
LOWEST = 0.5, 0.005, 1.2, 0.02
HIGHEST = 200.0, 0.5, 200.0, heat.SILICONE_SHARE


@dataclasses.dataclass
class HeatRates:
    """Rates of eqns (6) and (7) in silicone, as the board has them (`hardware.firmware.heat`).

    - ``heating``: a2 of the wire times the share of its rise that its thermocouple shows, °C/s;
      readings cannot tell these two apart.
    - ``cooling``: -a1, 1/s, which does not depend on that share.
    - ``reading``: -a3, 1/s.
    """

    heating: float
    cooling: float
    reading: float

    def bounds(self, kind: HeatBounds, hottest: float, margin: float) -> HeatBounds:
        """Bounds for the board around these rates.

        A wire that gets less heat and a thermocouple that shows a share of the rise read the
        same, so that readings never make the most heating less than that of the kind. Where they
        show more, the description is wrong, and the most of all wires comes from the one that
        shows most. The slowest cooling is raised by `NARROWEST` at most.

        Args:
            kind: bounds of any wire of its kind.
            hottest: largest ``heating`` of all wires of the limb.
            margin: share by which the rates are widened.
        """
        seen = max(kind.slowest_cooling, self.reading / LAGS)
        cooling = self.cooling / (1 + margin)
        bounds = {
            "slowest_cooling": min(cooling, seen, NARROWEST * kind.slowest_cooling),
            "fastest_cooling": max(self.cooling * (1 + margin), kind.fastest_cooling),
            "least_heating": self.heating * (1 - margin),
            "most_heating": max(
                hottest * max(RATE_FACTORS["most_heating"], 1 + margin), kind.most_heating
            ),
            "slowest_reading": min(self.reading / (1 + margin), kind.slowest_reading),
        }
        for field in dataclasses.fields(kind):
            low, high = field.metadata["range"]
            bounds[field.name] = float(min(max(bounds[field.name], low), high))
        return acceptable(HeatBounds(**bounds))


def acceptable(bounds: HeatBounds) -> HeatBounds:
    """Bounds that a board takes: these, or with a slower cooling if heat need not show by them."""
    if heat.shown(dataclasses.astuple(bounds), np.inf):
        return bounds
    allowed = heat.HIGHEST_RISE * (1 - heat.SILICONE_SHARE)
    slowest = heat.LITTLE_DUTY * bounds.most_heating / allowed
    # Frames have steps of 1/1000.
    return dataclasses.replace(bounds, slowest_cooling=np.floor(1000 * slowest).item() / 1000)


def fit_heat_rates(
    heatings: Sequence[tuple[np.ndarray, np.ndarray, float]],
) -> HeatRates | None:
    """The rates that come closest to what was read of a wire.

    Args:
        heatings: duty (K) of each, reading above that of the cold wire after each step (K),
            °C, and interval of the steps, s.

    Returns:
        rates; None if the wire was not heated.
    """
    if not any(duty.any() for duty, _, _ in heatings):
        return None
    from scipy.optimize import least_squares  # takes longer to import than all the rest

    def errors(logarithms: np.ndarray) -> np.ndarray:
        heating, cooling, faster, share = np.exp(logarithms)
        reading = faster * cooling
        return np.concatenate(
            [
                heating * lagged(warmth(duty, cooling, share, interval), reading, interval) - rise
                for duty, rise, interval in heatings
            ]
        )

    fit = least_squares(errors, np.log(START), bounds=(np.log(LOWEST), np.log(HIGHEST)))
    heating, cooling, faster, _ = np.exp(fit.x).tolist()
    return HeatRates(heating, cooling, faster * cooling)


def without_gaps(readings: np.ndarray) -> np.ndarray:
    """Return readings (K,) with values interpolated where there is none, nan, as of a bad frame."""
    samples = np.arange(len(readings))
    known = np.isfinite(readings)
    return np.interp(samples, samples[known], readings[known])


def warmth(duty: np.ndarray, cooling: float, share: float, interval: float) -> np.ndarray:
    """Temperature above the room of a wire whose a2 is one, after each step (K), °C."""
    from scipy.signal import lfilter  # as above

    silicone = heat.SILICONE_RATE
    steps = interval * np.array([[-cooling, cooling], [silicone * share, -silicone]]) + np.eye(2)
    numerator = [interval, -interval * steps[1, 1]]
    return lfilter(numerator, [1.0, -np.trace(steps), np.linalg.det(steps)], duty)


def lagged(signal: np.ndarray, rate: float, interval: float) -> np.ndarray:
    """A signal (K,) from zero behind a lag of the first order, 1/s, by Euler's method."""
    return low_pass(signal, max(0.0, 1.0 - interval * rate))
