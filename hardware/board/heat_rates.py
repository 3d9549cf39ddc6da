"""The fit of a wire's heating, cooling and thermocouple to its duty and readings."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from hardware.firmware import heat
from limb_systems.heat_bounds import RATE_FACTORS, HeatBounds
from limb_systems.low_pass import feed_back, low_pass

# Bounds raise the slowest cooling to this many times the slowest cooling of the wire's kind.
MAX_COOLING_FACTOR = 1.75
# Cooling is visible if it takes at most this many time constants of the thermocouple.
VISIBLE_TIME_CONSTANTS = 5.0
# Parameters of the fit: heating, cooling, reading over cooling, and the silicone's share. Reading
# is faster than cooling, because swapping these two rates would not change the readings much.
INITIAL_RATES = 20.0, 0.06, 10.0, 0.25
LOWEST_RATES = 0.5, 0.005, 1.2, 0.02
HIGHEST_RATES = 200.0, 0.5, 200.0, heat.SILICONE_SHARE


@dataclasses.dataclass
class HeatRates:
    """Rates of eqns (6) and (7) in silicone, by the board's model (`hardware.firmware.heat`).

    - ``heating``: a2 of the wire times the share of its rise that its thermocouple shows, °C/s;
      readings cannot tell these two apart.
    - ``cooling``: -a1, 1/s, which does not depend on that share.
    - ``reading``: -a3, 1/s.
    """

    heating: float
    cooling: float
    reading: float

    def bounds(self, kind: HeatBounds, max_heating: float, margin: float) -> HeatBounds:
        """Return the bounds of heating, cooling and reading for the board, around these rates.

        Low readings never lower the largest heating of the wire's kind: they may come from a
        thermocouple that shows only a share of the rise. High readings raise it: the description is
        wrong then, and the wire with the largest heating gives the bound for all wires. The slowest
        cooling is at most `MAX_COOLING_FACTOR` times the slowest cooling of the wire's kind.

        Args:
            kind: bounds that hold for any wire of its kind.
            max_heating: largest ``heating`` of all wires of the limb, °C/s.
            margin: share by which the rates are widened.
        """
        # Limit the slowest cooling, 1/s, also to cooling that the thermocouple can show.
        visible_cooling = max(kind.slowest_cooling, self.reading / VISIBLE_TIME_CONSTANTS)
        max_slowest_cooling = min(visible_cooling, MAX_COOLING_FACTOR * kind.slowest_cooling)
        # Widen the rates by the margin, and take the kind's bounds where these are wider.
        most_heating = max_heating * max(RATE_FACTORS["most_heating"], 1 + margin)
        bounds = {
            "slowest_cooling": min(self.cooling / (1 + margin), max_slowest_cooling),
            "fastest_cooling": max(self.cooling * (1 + margin), kind.fastest_cooling),
            "least_heating": self.heating * (1 - margin),
            "most_heating": max(most_heating, kind.most_heating),
            "slowest_reading": min(self.reading / (1 + margin), kind.slowest_reading),
        }
        # Stay within the ranges that a board accepts.
        for field in dataclasses.fields(kind):
            low, high = field.metadata["range"]
            bounds[field.name] = float(min(max(bounds[field.name], low), high))
        return detectable_bounds(HeatBounds(**bounds))


def detectable_bounds(bounds: HeatBounds) -> HeatBounds:
    """Return bounds by which the board can detect overheating, if necessary with slower cooling."""
    if heat.can_detect_overheating(dataclasses.astuple(bounds), np.inf):
        return bounds
    allowed = heat.HIGHEST_RISE * (1 - heat.SILICONE_SHARE)
    slowest = heat.LITTLE_DUTY * bounds.most_heating / allowed
    # Frames have steps of 1/1000 1/s.
    return dataclasses.replace(bounds, slowest_cooling=np.floor(1000 * slowest).item() / 1000)


def fit_heat_rates(heatings: Sequence[tuple[np.ndarray, np.ndarray, float]]) -> HeatRates | None:
    """Return the rates that come closest to the readings of a wire.

    Args:
        heatings: a row for each heating: duty (K), rise of the reading after each step (K), °C,
            and interval of the steps, s.

    Returns:
        The rates; None if the wire was not heated.
    """
    if not any(duty.any() for duty, _, _ in heatings):
        return None
    from scipy.optimize import least_squares  # slow to import

    def errors(logarithms: np.ndarray) -> np.ndarray:
        heating, cooling, reading_ratio, share = np.exp(logarithms)
        differences = []
        for duty, rise, interval in heatings:
            wire = unit_temperature_rise(duty, cooling, share, interval)
            reading = first_order_lag(wire, reading_ratio * cooling, interval)
            differences.append(heating * reading - rise)
        return np.concatenate(differences)

    # Fit logarithms, as all parameters are positive.
    limits = np.log(LOWEST_RATES), np.log(HIGHEST_RATES)
    fit = least_squares(errors, np.log(INITIAL_RATES), bounds=limits)
    heating, cooling, reading_ratio, _ = np.exp(fit.x).tolist()
    return HeatRates(heating, cooling, reading_ratio * cooling)


def interpolate_gaps(readings: np.ndarray) -> np.ndarray:
    """Return readings (K,) with interpolated values where they are missing (nan)."""
    samples = np.arange(len(readings))
    is_read = np.isfinite(readings)
    return np.interp(samples, samples[is_read], readings[is_read])


def unit_temperature_rise(
    duty: np.ndarray, cooling: float, share: float, interval: float
) -> np.ndarray:
    """Return the rise (K), °C, after each step, of a wire whose a2 is one."""
    silicone = heat.SILICONE_RATE
    steps = interval * np.array([[-cooling, cooling], [silicone * share, -silicone]]) + np.eye(2)
    heat_of_duty = interval * np.convolve(duty, [1.0, -steps[1, 1]])[: len(duty)]
    return feed_back(heat_of_duty, [np.trace(steps), -np.linalg.det(steps)])


def first_order_lag(signal: np.ndarray, rate: float, interval: float) -> np.ndarray:
    """Return a signal (K,) behind a first-order lag of a rate, 1/s, that starts at zero."""
    return low_pass(signal, max(0.0, 1.0 - interval * rate))
