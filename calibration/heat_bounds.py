"""Bounds for the board: between which rates of heating all readings lie."""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from hardware.firmware import heat
from limb_systems import LimbParameters, Recording
from limb_systems.model.heat_bounds import HeatBounds

MARGIN = 0.1  # share by which bounds are widened: other motions show somewhat more
NOISE = (2.0, 1.0)  # °C that readings may be above and below their bounds
SHORTEST = 1.0  # s at full duty, from which on heat tells a rate
STEPS = 5  # of bisection


def fit_heat_bounds(
    recordings: Iterable[Recording], described: LimbParameters, margin: float = MARGIN
) -> list[HeatBounds]:
    """The bounds of each wire (W) that contain all readings, as the board looks at them.

    Two of them are made tighter than those of the described kind of wire: the
    slowest cooling, as fast as the highest readings allow with the most
    heating, and the least heating, as much as the lowest readings allow with
    the fastest cooling. How fast a wire heats at first, hidden by the
    thermocouple's lag, and that lag are not told by readings, so that
    the other bounds are those described.

    Args:
        recordings: with heat, each of a limb that was cold at the beginning.
        described: the kind of limb.
        margin: share by which the fitted rates are widened.

    Returns:
        bounds; those described for a wire that was not heated.
    """
    recordings = list(recordings)
    return [
        _fit_wire(recordings, wire, bounds, margin)
        for wire, bounds in enumerate(described.heat_bounds)
    ]


def _fit_wire(
    recordings: Sequence[Recording], wire: int, bounds: HeatBounds, margin: float
) -> HeatBounds:
    heating, rate = np.inf, np.inf
    for recording in recordings:
        reading, least, most = _follow(recording, wire, bounds)
        shown = least > SHORTEST * bounds.least_heating
        ratios = (reading + NOISE[1])[shown] / least[shown]
        heating = min(heating, bounds.least_heating * ratios.min(initial=np.inf))
        low, high = bounds.slowest_cooling, bounds.fastest_cooling
        if not shown.any() or (reading - NOISE[0] > most).any():
            continue
        for _ in range(STEPS):
            middle = (low + high) / 2
            faster = dataclasses.replace(bounds, slowest_cooling=middle)
            reading, _, most = _follow(recording, wire, faster)
            low, high = (low, middle) if (reading - NOISE[0] > most).any() else (middle, high)
        rate = min(rate, low)
    fitted = dataclasses.replace(bounds)
    if np.isfinite(heating):
        heating = np.clip((1 - margin) * heating, bounds.least_heating, bounds.most_heating)
        fitted.least_heating = float(heating)
    if np.isfinite(rate):
        fitted.slowest_cooling = float(max(rate / (1 + margin), bounds.slowest_cooling))
    return fitted


def _follow(
    recording: Recording, wire: int, bounds: HeatBounds
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a wire over time (K), °C above the room: its reading, the least that is read, and the most
    that the wire can have; the first two averaged as the board averages them."""
    duty = recording.duty if recording.applied_duty is None else recording.applied_duty
    observer = heat.WireObserver(0.0)
    observer.bounds = dataclasses.astuple(bounds)
    readings = recording.measured_temperature[wire]
    start = readings[recording.time < recording.time[0] + heat.AVERAGING_TIME].mean()
    signals = np.zeros((3, len(recording.time)))
    averages = np.zeros(2)
    for index, interval in enumerate(np.diff(recording.time), 1):
        observer.advance(duty[wire, index - 1], interval, 0.0)
        now = np.array([readings[index] - start, observer.least_reading])
        averages += min(1.0, interval / heat.AVERAGING_TIME) * (now - averages)
        signals[:, index] = *averages, observer.most
    reading, least, most = signals
    return reading, least, most
