"""Repair of recordings: spikes, samples that are missing or lost, and samples of some age."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from limb_systems import Recording

SPIKE = 6.0  # robust standard deviations from the median of five samples, beyond which one counts
STEEP = 1.5  # of the range of its neighbours, within which a sample is no spike
READ = 2.0  # s, within which readings are missed least
PASSES = 2  # after which spikes beside each other are gone


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
    return _with_readings(recording, without_spikes)


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

    def when_taken(row: np.ndarray) -> np.ndarray:
        return np.where(np.isnan(row), np.nan, filled(recording.time, row[first], taken))

    def means(duty: np.ndarray) -> np.ndarray:
        since_start = np.append(0.0, np.cumsum(np.append(duty[first], duty[-1]) * np.diff(breaks)))
        ends = np.append(recording.time[0] - 1 / recording.sample_rate, recording.time)
        return np.diff(np.interp(ends, breaks, since_start)) / np.diff(ends)

    return _with_readings(
        recording,
        when_taken,
        duty=np.clip([means(duty) for duty in recording.applied_duty], 0.0, 1.0),
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
    signals = _each(recording, lambda signal: signal[..., after])
    signals |= {name: np.where(real, signals[name], np.nan) for name in Recording.MEASURED}
    signals["time"] = recording.time[0] + np.cumsum(steps)
    return dataclasses.replace(recording, **signals)


def before_missing(recording: Recording) -> Recording:
    """The beginning of a recording, until a thermocouple is not read for some time."""
    time, end = recording.time, recording.time[-1]
    for readings in recording.measured_temperature[recording.has_thermocouple]:
        known = np.concatenate([time[:1], time[~np.isnan(readings)], time[-1:]])
        end = min([end, *known[:-1][np.diff(known) > READ]])
    return part(interpolated(recording), time <= end)


def part(recording: Recording, which: np.ndarray) -> Recording:
    """Some samples of a recording (K,)."""
    return dataclasses.replace(recording, **_each(recording, lambda signal: signal[..., which]))


def _each(recording: Recording, changed: Callable[[np.ndarray], np.ndarray]) -> dict[str, Any]:
    """All signals that a recording has, changed alike."""
    names = ("time", "duty", *Recording.MEASURED, *Recording.optional())
    signals = {name: getattr(recording, name) for name in names}
    return {name: changed(signal) for name, signal in signals.items() if signal is not None}


def interpolated(recording: Recording) -> Recording:
    """A recording with lines between readings where some are missing, for what needs even steps."""
    return _with_readings(recording, lambda row: filled(recording.time, row))


def _with_readings(
    recording: Recording, changed: Callable[[np.ndarray], np.ndarray], **signals: Any
) -> Recording:
    """A recording with each reading of wires and bend (K,) changed, and other signals given."""
    readings: dict[str, Any] = {
        name: np.array([changed(row) for row in getattr(recording, name)])
        for name in Recording.MEASURED
    }
    return dataclasses.replace(recording, **readings, **signals)


def filled(times: np.ndarray, signal: np.ndarray, taken: np.ndarray | None = None) -> np.ndarray:
    """A signal with lines where it is nan, at times (K,); it may be taken at other times (L,)."""
    taken = times if taken is None else taken
    shown = ~np.isnan(signal)
    return np.interp(times, taken[shown], signal[shown]) if shown.any() else np.nan * times
