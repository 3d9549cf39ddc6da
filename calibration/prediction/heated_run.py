"""A heated recording in even steps, as open-loop simulation and comparison need it."""

import dataclasses

import numpy as np

from calibration.recordings.at_rest import START_TIME, before_heat, first_readings
from calibration.recordings.kinds import bend_sensor_of, title_of
from calibration.recordings.repair import at_sample_times, without_spikes_in
from limb_systems import Recording
from limb_systems.files.signal_table import doses

STEP = 0.5  # s, of simulation and of averages; wires heat and cool within seconds


@dataclasses.dataclass(frozen=True, eq=False)
class HeatedRun:
    """A recording of W wires and F bends in K steps of half a second, M of which have samples.

    - ``source``: the recording's title.
    - ``duty``: mean duty over each step (K, W).
    - ``times``: mean times of the samples of a step (M,), s from the first.
    - ``temperature``, ``bend``: mean readings V, °C (M, W), and φ, rad (M, F), without the sensor's
      gain and offset; nan where missing.
    - ``counts``: number of samples in each mean, of φ and of V (M, F + W).
    - ``first``: V at the beginning (W,), °C; nan without a thermocouple.
    - ``slope``: rate of V at the beginning, before the wire is heated (W,), °C/s; nan
      where less than a second shows it.
    - ``load``: gravity in the frame of the limb's base, m/s², and payload, kg (4,).
    """

    source: str
    duty: np.ndarray
    times: np.ndarray
    temperature: np.ndarray
    bend: np.ndarray
    counts: np.ndarray
    first: np.ndarray
    slope: np.ndarray
    load: np.ndarray

    @classmethod
    def of(cls, recording: Recording) -> "HeatedRun":
        """Average a recording over steps, without readings that are far from their neighbours."""
        recording = without_spikes_in(at_sample_times(recording))
        bends = bend_sensor_of(recording).corrected_bends(recording.bend_angle)
        # Average the duty over even steps.
        times = recording.time - recording.time[0]
        num_steps = max(1, int(np.ceil(times[-1] / STEP - 1e-6)))
        edges = STEP * np.arange(num_steps + 1)
        # The duty at a sample was in force since the sample before.
        duty = doses(recording.duty[:, 1:], times, edges) / STEP
        # Average the readings in each step, where there are any.
        temperature = recording.measured_temperature
        is_read = ~np.isnan([*bends, *temperature])
        is_row_read = np.vstack([is_read.any(axis=0), is_read])
        bins = (times / STEP).astype(int)
        # Row 0 counts and averages the times of samples with any reading.
        values = np.where(is_row_read, np.vstack([times, *bends, *temperature]), 0.0)
        counts = np.apply_along_axis(lambda row: np.bincount(bins, row), 1, is_row_read)
        sums = np.apply_along_axis(lambda row: np.bincount(bins, row), 1, values)
        filled = counts[0] > 0
        counts = counts[:, filled]
        means = np.where(counts > 0, sums[:, filled] / np.maximum(counts, 1), np.nan)
        averaged = means[1:].T
        # Fit the rate at which readings change before the first heat.
        early = before_heat(recording) & (times <= max(3 * START_TIME, 5.0 / recording.sample_rate))
        early &= is_read[len(bends) :]
        slopes = []
        for readings, is_early in zip(temperature, early, strict=True):
            slopes.append(_initial_slope(times[is_early], readings[is_early]))
        return cls(
            source=title_of(recording),
            duty=duty.T,
            times=means[0],
            temperature=averaged[:, len(bends) :],
            bend=averaged[:, : len(bends)],
            counts=counts[1:].T,
            first=first_readings(recording),
            slope=np.array(slopes),
            load=np.array([*recording.parameters.gravity, recording.parameters.payload]),
        )

    @property
    def is_read(self) -> bool:
        """Return whether any thermocouple is read."""
        return bool(self.counts[:, self.bend.shape[1] :].any())

    @property
    def signals(self) -> np.ndarray:
        """The readings φ, rad, and V, °C, side by side (M, F + W)."""
        return np.column_stack([self.bend, self.temperature])

    def interpolated(self, signals: np.ndarray) -> np.ndarray:
        """Interpolate signals from the ends of steps (K + 1, ...) to the samples (M, ...)."""
        before, share = self.steps_before()
        after = share.reshape(-1, *[1] * (signals.ndim - 1))
        return signals[before] * (1 - after) + signals[before + 1] * after

    def steps_before(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the step in which each sample is (M,), and the share of it before the sample."""
        steps = self.times / STEP
        indices = np.minimum(steps.astype(int), len(self.duty) - 1)
        return indices, steps - indices

    def last_part_start(self, min_share: float, max_share: float) -> float:
        """Return when the last part begins, s.

        It is a share of the time, or the same share of the heat if that begins earlier: the end of
        a recording may show a limb at rest alone.

        Args:
            min_share: share of time and heat.
            max_share: share of the time, beyond which the heat does not count.
        """
        heat = np.cumsum(self.duty.sum(axis=1))
        late = STEP * float(np.searchsorted(heat, (1 - min_share) * heat[-1]))
        end = self.times[-1]
        return float(np.clip(late, (1 - max_share) * end, (1 - min_share) * end))

    def without(self, start: float, end: float) -> tuple["HeatedRun", "HeatedRun"]:
        """Return the samples outside and inside of a span, s; both parts have the whole duty."""
        inside = (self.times >= start) & (self.times < end)
        return self._with_samples(~inside), self._with_samples(inside)

    def _with_samples(self, chosen: np.ndarray) -> "HeatedRun":
        """Return the run with the chosen (M,) of its samples alone."""
        return dataclasses.replace(
            self,
            times=self.times[chosen],
            temperature=self.temperature[chosen],
            bend=self.bend[chosen],
            counts=self.counts[chosen],
        )


def _initial_slope(times: np.ndarray, values: np.ndarray) -> float:
    """Return the slope of the line through samples; nan if they show less than a second."""
    if len(times) < 2 or np.ptp(times) < 0.99 * START_TIME:
        return np.nan
    since = times - times.mean()
    return float(since @ values / (since @ since))
