"""A heated recording in even steps, as open-loop simulation and comparison need it."""

import dataclasses
from typing import Any

import numpy as np

from calibration.bend_sensor import bend_sensor_of
from limb_systems import Recording

STEP = 0.5  # s, of simulation and of averages; wires heat and cool within seconds
SPIKE = 6.0  # robust standard deviations from the median of five samples, beyond which one counts
STEEP = 1.5  # of the range of its neighbours, within which a sample is no spike
PASSES = 2  # after which spikes beside each other are gone
START = 1.0  # s, over which the first readings are averaged


@dataclasses.dataclass(frozen=True, eq=False)
class Course:
    """A recording of W wires over K steps, with the mean of its M half-seconds that have samples.

    - ``source``: what was recorded.
    - ``duty``: its mean over each step (K, W).
    - ``times``: mean times of the samples (M,), s from the first.
    - ``temperature``, ``bend``: means of the readings V, °C (M, W), and φ, rad (M,).
    - ``counts``: number of samples in each mean (M,).
    - ``first``: V at the beginning (W,), °C.
    - ``slope``: rate of V there, before the wire is heated (W,), °C/s; nan where less than a
      second shows it.
    """

    source: str
    duty: np.ndarray
    times: np.ndarray
    temperature: np.ndarray
    bend: np.ndarray
    counts: np.ndarray
    first: np.ndarray
    slope: np.ndarray

    @classmethod
    def of(cls, recording: Recording) -> "Course":
        """A recording's, without samples that are missing, or far from their neighbours."""
        recording = despiked(at_sample_times(recording))
        bend = bend_sensor_of(recording).corrected(recording.bend_angle[0])
        times = recording.time - recording.time[0]
        num_steps = max(1, int(np.ceil(times[-1] / STEP - 1e-6)))
        edges = STEP * np.arange(num_steps + 1)
        # The duty at a sample was in force since the sample before.
        dose = np.cumsum(recording.duty[:, 1:] * np.diff(times), axis=1)
        duty = [np.diff(np.interp(edges, times, np.append(0.0, d))) / STEP for d in dose]
        shown = ~recording.missing
        bins = (times[shown] / STEP).astype(int)
        counts = np.bincount(bins)
        filled = counts > 0

        def means(values: np.ndarray) -> np.ndarray:
            return np.bincount(bins, values[shown])[filled] / counts[filled]

        temperature = recording.measured_temperature
        soon = before_heat(recording) & (times <= max(3 * START, 5.0 / recording.sample_rate))
        soon &= shown
        slope = [_slope(times[s], v[s]) for v, s in zip(temperature, soon, strict=True)]
        return cls(
            source=recording.source,
            duty=np.array(duty).T,
            times=means(times),
            temperature=np.array([means(v) for v in temperature]).T,
            bend=means(bend),
            counts=counts[filled],
            first=first_readings(recording),
            slope=np.array(slope),
        )

    def interpolated(self, readings: np.ndarray, bends: np.ndarray) -> tuple[np.ndarray, ...]:
        """Signals (.., ...) at the ends of steps, of this or a longer recording, at the samples."""
        steps = self.times / STEP
        before = np.minimum(steps.astype(int), len(bends) - 2)
        after = steps - before
        return tuple(
            signal[before] * (1 - share) + signal[before + 1] * share
            for signal in (readings, bends)
            for share in [after.reshape(-1, *[1] * (signal.ndim - 1))]
        )

    def held_out(self, least: float, most: float) -> tuple["Course", "Course"]:
        """Its samples but the last, and the last; each has the duty of all.

        The last are those of a share of the time, or of the same share of the heat if that
        begins earlier: the end of a recording may show a limb at rest alone.

        Args:
            least: share of time and heat.
            most: share of the time, beyond which the heat does not count.
        """
        heat = np.cumsum(self.duty.sum(axis=1))
        late = STEP * float(np.searchsorted(heat, (1 - least) * heat[-1]))
        end = self.times[-1]
        early = self.times < np.clip(late, (1 - most) * end, (1 - least) * end)
        return self._samples(early), self._samples(~early)

    def _samples(self, which: np.ndarray) -> "Course":
        return dataclasses.replace(
            self,
            times=self.times[which],
            temperature=self.temperature[which],
            bend=self.bend[which],
            counts=self.counts[which],
        )


def before_heat(recording: Recording) -> np.ndarray:
    """Whether a wire was not yet heated (W, K); the first sample counts.

    The duty at a sample was in force since the sample before, and that of the first one
    before the recording.
    """
    later = np.cumsum(recording.duty[:, 1:] > 0, axis=1) == 0
    return np.column_stack([np.ones(len(later), bool), later])


def at_start(recording: Recording) -> np.ndarray:
    """Whether a sample is of the first second, before its wire is heated (W, K), and not missing.

    Where all of these are missing, the first that is not counts.
    """
    since, shown = recording.time - recording.time[0], ~recording.missing
    soon = before_heat(recording) & (since <= max(START, 2.5 / recording.sample_rate)) & shown
    soon[~soon.any(axis=1), np.argmax(shown)] = True
    return soon


def first_readings(recording: Recording) -> np.ndarray:
    """V at the beginning (W,), °C."""
    readings = zip(recording.measured_temperature, at_start(recording), strict=True)
    return np.array([measured[shown].mean() for measured, shown in readings])


def _slope(times: np.ndarray, values: np.ndarray) -> float:
    """Of the line through samples; nan if they show less than a second."""
    if np.ptp(times) < 0.99 * START:
        return np.nan
    since = times - times.mean()
    return float(since @ values / (since @ since))


def without_spikes(signal: np.ndarray) -> np.ndarray:
    """A signal (K,) whose samples far from their neighbours are replaced by their median.

    Neighbours that differ as much from each other are those of fast changes, as slow
    loggers record them.
    """
    shown = ~np.isnan(signal)
    values = signal[shown]
    if len(values) < 3:
        return signal
    for _ in range(PASSES):
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, 2, mode="reflect"), 5)
        medians = np.median(windows, axis=1)
        # One of the neighbours may be a spike as well.
        near = np.sort(np.abs(windows[:, [0, 1, 3, 4]] - medians[:, None]), axis=1)[:, 2]
        away = np.abs(values - medians)
        spread = 1.48 * np.median(away) + 1e-3 * np.std(medians) + 1e-12
        spikes = (away > SPIKE * spread) & (away > STEEP * 2 * near)
        values = np.where(spikes, medians, values)
    result = signal.copy()
    result[shown] = values
    return result


def despiked(recording: Recording) -> Recording:
    """A recording whose readings are `without_spikes`."""
    return dataclasses.replace(
        recording,
        measured_temperature=np.array([without_spikes(v) for v in recording.measured_temperature]),
        bend_angle=np.array([without_spikes(angle) for angle in recording.bend_angle]),
    )


def at_sample_times(recording: Recording) -> Recording:
    """A robot's recording with the applied duty, and its readings when they were taken.

    The times of its samples follow from their age; readings are interpolated
    linearly. The duty at a sample is taken as in force since the previous
    sample, and averaged over each interval. A recording without applied duty or
    age is returned unchanged.
    """
    if recording.applied_duty is None or recording.sample_age is None:
        return recording
    taken, first = np.unique(np.round(recording.time - recording.sample_age, 6), return_index=True)
    end = max(taken[-1], recording.time[-1]) + 1.0  # the last duty lasts
    breaks = np.array([taken[0] - 1.0, *taken, end])

    def at_times(readings: np.ndarray) -> np.ndarray:
        rows = []
        for row in readings:
            shown = ~np.isnan(row[first])
            interpolated = np.interp(recording.time, taken[shown], row[first][shown])
            rows.append(np.where(np.isnan(row), np.nan, interpolated))
        return np.array(rows)

    def means(duty: np.ndarray) -> np.ndarray:
        since_start = np.append(0.0, np.cumsum(np.append(duty[first], duty[-1]) * np.diff(breaks)))
        ends = np.append(recording.time[0] - 1 / recording.sample_rate, recording.time)
        return np.diff(np.interp(ends, breaks, since_start)) / np.diff(ends)

    return dataclasses.replace(
        recording,
        duty=np.clip([means(duty) for duty in recording.applied_duty], 0.0, 1.0),
        measured_temperature=at_times(recording.measured_temperature),
        bend_angle=at_times(recording.bend_angle),
        sample_age=np.zeros_like(recording.time),
    )


def with_lost_rows(recording: Recording) -> Recording:
    """A recording with a sample that is missing for each that its times leave out.

    The duty of such samples is that of the next one, which was in force since the one before.
    """
    period = 1 / recording.sample_rate
    lost = np.maximum(np.round(np.diff(recording.time) / period).astype(int) - 1, 0)
    if not lost.any():
        return recording
    after = np.append(0, np.repeat(np.arange(1, len(lost) + 1), lost + 1))
    real = np.isin(np.arange(len(after)), np.append(0, np.cumsum(lost + 1)))
    steps = np.append(0.0, np.repeat(np.diff(recording.time) / (lost + 1), lost + 1))
    signals: dict[str, Any] = {"time": recording.time[0] + np.cumsum(steps)}
    for name in ("duty", "measured_temperature", "bend_angle", *Recording.OPTIONAL):
        if (value := getattr(recording, name)) is not None:
            signals[name] = value[..., after]
    for name in Recording.MEASURED:
        signals[name] = np.where(real, signals[name], np.nan)
    return dataclasses.replace(recording, **signals)


def without_missing(recording: Recording) -> Recording:
    """A recording without the samples that are missing; the duty is the mean in between."""
    shown = ~recording.missing
    if shown.all():
        return recording
    dose = np.cumsum(recording.duty[:, 1:] * np.diff(recording.time), axis=1)
    dose = np.column_stack([np.zeros(len(dose)), dose])[:, shown]
    steps = np.diff(recording.time[shown])
    duty = np.column_stack([recording.duty[:, shown][:, :1], np.diff(dose) / steps])
    duty = np.clip(duty, 0.0, 1.0)  # but for rounding
    return dataclasses.replace(_part(recording, shown), duty=duty)


def before_missing(recording: Recording) -> Recording:
    """The beginning of a recording, up to the first sample that is missing."""
    return _part(recording, np.cumsum(recording.missing) == 0)


def _part(recording: Recording, which: np.ndarray) -> Recording:
    signals: dict[str, Any] = {}
    for name in ("time", "duty", *Recording.MEASURED, *Recording.OPTIONAL):
        if (value := getattr(recording, name)) is not None:
            signals[name] = value[..., which]
    return dataclasses.replace(recording, **signals)


def interpolated(recording: Recording) -> Recording:
    """A recording with lines between readings where some are missing, for what needs even steps."""
    measured: dict[str, Any] = {
        name: np.array([filled(recording.time, row) for row in getattr(recording, name)])
        for name in Recording.MEASURED
    }
    return dataclasses.replace(recording, **measured)


def filled(times: np.ndarray, signal: np.ndarray) -> np.ndarray:
    """A signal (K,) with lines where it is nan."""
    shown = ~np.isnan(signal)
    return np.interp(times, times[shown], signal[shown]) if shown.any() else signal
