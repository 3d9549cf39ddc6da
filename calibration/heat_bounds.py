"""Bounds for the board: between which rates of heating all readings lie."""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from hardware.firmware import heat
from limb_systems import LimbParameters, Recording
from limb_systems.model.heat_bounds import HeatBounds

MARGIN = 0.1  # share by which bounds are widened: other motions show somewhat more
NOISE = (2.0, 1.0)  # °C that readings may be above and below their bounds
HIDDEN = 1.5  # by how much faster a wire may heat at first than its thermocouple shows
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
    least_share, most_share, rate = np.inf, 0.0, bounds.fastest_cooling
    for course in [_Course(recording, wire) for recording in recordings]:
        least, most = course.bounded(bounds)
        shown = least > SHORTEST * bounds.least_heating
        if not shown.any():
            continue
        # Both bounds are proportional to their rates of heating.
        least_share = min(least_share, ((course.reading + NOISE[1])[shown] / least[shown]).min())
        most_share = max(most_share, ((course.reading - NOISE[0])[shown] / most[shown]).max())
        low, high = bounds.slowest_cooling, rate
        for _ in range(STEPS if most_share < 1 else 0):
            middle = (low + high) / 2
            _, most = course.bounded(dataclasses.replace(bounds, slowest_cooling=middle))
            low, high = (
                (low, middle) if (course.reading - NOISE[0] > most).any() else (middle, high)
            )
        rate = low
    if not most_share:  # it was not heated
        return bounds
    ranges = {field.name: field.metadata["range"] for field in dataclasses.fields(bounds)}
    slowest = max(bounds.slowest_cooling, rate / (1 + margin))
    # Of a limb that is not as it was described the bounds become wider.
    least_share = max(least_share * (1 - margin), min(1.0, least_share))
    most_share = most_share * (1 + margin) * HIDDEN if most_share > 1 else 1.0
    least_heating = max(bounds.least_heating * least_share, ranges["least_heating"][0])
    most_heating = min(bounds.most_heating * most_share, ranges["most_heating"][1])
    return dataclasses.replace(
        bounds,
        slowest_cooling=float(slowest),
        least_heating=float(min(least_heating, bounds.most_heating)),
        most_heating=float(most_heating),
    )


class _Course:
    """A recording of a wire in steps of the board's observer.

    - ``reading``: above the room, averaged as the board averages it (K), °C.
    """

    def __init__(self, recording: Recording, wire: int):
        applied = recording.duty if recording.applied_duty is None else recording.applied_duty
        readings = recording.measured_temperature[wire]
        start = readings[recording.time < recording.time[0] + heat.AVERAGING_TIME].mean()
        stride = max(1, round(heat.LONGEST_STEP * recording.sample_rate))
        # What is applied from one sample to the next, and read at the end of a step.
        duty = np.add.reduceat(applied[wire, :-1], np.arange(0, len(readings) - 1, stride)) / stride
        self._duty, self._interval = duty.tolist(), stride / recording.sample_rate
        ends = np.minimum(np.arange(1, len(duty) + 1) * stride, len(readings) - 1)
        self.reading = self._average((readings[ends] - start).tolist())

    def _average(self, signal: list[float]) -> np.ndarray:
        average, averages = 0.0, []
        for value in signal:
            average += min(1.0, self._interval / heat.AVERAGING_TIME) * (value - average)
            averages.append(average)
        return np.array(averages)

    def bounded(self, bounds: HeatBounds) -> tuple[np.ndarray, np.ndarray]:
        """The least that is read, averaged, and the most that the wire can have (K), °C."""
        observer = heat.WireObserver(0.0)
        observer.bounds = dataclasses.astuple(bounds)
        least, most = [], []
        for duty in self._duty:
            observer.advance(duty, self._interval, 0.0)
            least.append(observer.least_reading)
            most.append(observer.most)
        return self._average(least), np.array(most)
