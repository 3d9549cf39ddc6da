"""Repair of recordings: spikes, samples that are missing, lost or old, and cuts into pieces.

A piece of a recording is fitted from a start of its own. It must therefore show where its wires
start: at the end of a pause, or where they rest for some seconds.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from calibration.recordings.kinds import title_of
from calibration.remarks import CalibrationError, Remark
from limb_systems import Recording
from limb_systems.files.signal_table import doses

# Robust standard deviations from the median of five samples, from which on a sample is a spike.
SPIKE_DEVIATIONS = 6.0
SPIKE_RANGE = 1.5  # of the range of its neighbours, within which a sample is no spike
MAX_UNREAD_TIME = 2.0  # s, within which readings are missed least
NUM_SPIKE_PASSES = 2  # after which spikes beside each other are gone
PAUSE_TIME = 60.0  # s without heat, after which wires may be cold
COLD_MARGIN = 8.0  # °C above their lowest readings, within which they are
LEAD_IN_TIME = 5.0  # s before its heat with which a piece begins
RESTING_TIME = 3.0  # s without heat, in which readings show where a wire that is not cold starts
# s of heated recordings, and samples of any
MIN_DURATION = 10.0
MIN_SAMPLES = 20
MAX_PIECE_DURATION = 900.0  # s, as the time that a fit takes grows with its longest piece
MAX_GAP = 60.0  # s, that are filled with the duty beside them
MAX_UNKNOWN_DOSE = 0.5  # s of full duty, by which the dose in a gap may be wrong


def without_spikes(signal: np.ndarray) -> np.ndarray:
    """Return a signal (K,) whose samples far from their neighbours are replaced by their median.

    Neighbours that differ as much from each other are part of fast changes, as slow
    loggers record them.
    """
    is_read = ~np.isnan(signal)
    values = signal[is_read]
    if len(values) < 3:
        return signal
    for _ in range(NUM_SPIKE_PASSES):
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, 2, mode="reflect"), 5)
        medians = np.median(windows, axis=1)
        # One of the neighbours may be a spike as well.
        nearby = np.sort(np.abs(windows[:, [0, 1, 3, 4]] - medians[:, None]), axis=1)[:, 2]
        deviations = np.abs(values - medians)
        spread = 1.48 * np.median(deviations) + 1e-3 * np.std(medians) + 1e-12
        spikes = (deviations > SPIKE_DEVIATIONS * spread) & (deviations > SPIKE_RANGE * 2 * nearby)
        values = np.where(spikes, medians, values)
    result = signal.copy()
    result[is_read] = values
    return result


def without_spikes_in(recording: Recording) -> Recording:
    """Return a recording whose readings are `without_spikes`."""
    return _with_readings(recording, without_spikes)


def at_sample_times(recording: Recording) -> Recording:
    """Return a robot's recording with the applied duty, and its readings when they were taken.

    The times of its samples follow from their age; readings are interpolated
    linearly. The duty at a sample is taken as in force since the previous
    sample, and averaged over each interval. A recording without applied duty or
    age is returned unchanged.
    """
    if recording.applied_duty is None or recording.sample_age is None:
        return recording
    # Times at which samples were taken, in order.
    times, first = np.unique(np.round(recording.time - recording.sample_age, 6), return_index=True)
    end = max(times[-1], recording.time[-1]) + 1.0  # the last duty lasts
    breaks = np.array([times[0] - 1.0, *times, end])
    ends = np.append(recording.time[0] - 1 / recording.sample_rate, recording.time)
    applied = recording.applied_duty[:, [*first, -1]]

    def when_taken(row: np.ndarray) -> np.ndarray:
        return np.where(np.isnan(row), np.nan, fill_gaps(recording.time, row[first], times))

    return _with_readings(
        recording,
        when_taken,
        duty=np.clip(doses(applied, breaks, ends) / np.diff(ends), 0.0, 1.0),
        sample_age=np.zeros_like(recording.time),
    )


def with_lost_rows(recording: Recording) -> Recording:
    """Return a recording with a sample that is missing for each that its times leave out.

    Such samples have the duty of the next sample, which was in force since the sample before.
    """
    period = 1 / recording.sample_rate
    # Count the samples that are lost before each sample.
    num_lost = np.maximum(np.round(np.diff(recording.time) / period).astype(int) - 1, 0)
    if not num_lost.any():
        return recording
    next_row = np.append(0, np.repeat(np.arange(1, len(num_lost) + 1), num_lost + 1))
    is_recorded = np.isin(np.arange(len(next_row)), np.append(0, np.cumsum(num_lost + 1)))
    steps = np.append(0.0, np.repeat(np.diff(recording.time) / (num_lost + 1), num_lost + 1))
    signals = _mapped(recording, lambda signal: signal[..., next_row])
    signals |= {name: np.where(is_recorded, signals[name], np.nan) for name in Recording.MEASURED}
    signals["time"] = recording.time[0] + np.cumsum(steps)
    return dataclasses.replace(recording, **signals)


def before_missing(recording: Recording) -> Recording:
    """Return the beginning of a recording, until a thermocouple is not read for some time."""
    time = recording.time
    end = recording.time[-1]
    for readings in recording.measured_temperature[recording.has_thermocouple]:
        read_times = np.concatenate([time[:1], time[~np.isnan(readings)], time[-1:]])
        end = min([end, *read_times[:-1][np.diff(read_times) > MAX_UNREAD_TIME]])
    return select_samples(with_interpolated_gaps(recording), time <= end)


def select_samples(recording: Recording, chosen: np.ndarray) -> Recording:
    """Return some samples of a recording (K,)."""
    return dataclasses.replace(recording, **_mapped(recording, lambda signal: signal[..., chosen]))


def _mapped(recording: Recording, change: Callable[[np.ndarray], np.ndarray]) -> dict[str, Any]:
    """Return all signals that a recording has, changed alike."""
    signals: dict[str, Any] = {}
    for name in ("time", "duty", *Recording.MEASURED, *Recording.optional()):
        signal = getattr(recording, name)
        if signal is not None:
            signals[name] = change(signal)
    return signals


def with_interpolated_gaps(recording: Recording) -> Recording:
    """Return a recording whose missing readings are interpolated, for signals in even steps."""
    return _with_readings(recording, lambda row: fill_gaps(recording.time, row))


def _with_readings(
    recording: Recording, change: Callable[[np.ndarray], np.ndarray], **signals: Any
) -> Recording:
    """Return a recording with changed rows of readings (K,), and further signals replaced."""
    for name in Recording.MEASURED:
        signals[name] = np.apply_along_axis(change, 1, getattr(recording, name))
    return dataclasses.replace(recording, **signals)


def fill_gaps(
    times: np.ndarray, signal: np.ndarray, sample_times: np.ndarray | None = None
) -> np.ndarray:
    """Interpolate a signal at times (K,) where it is nan; its own times may be others (L,)."""
    sample_times = times if sample_times is None else sample_times
    is_read = ~np.isnan(signal)
    if not is_read.any():
        return np.nan * times
    return np.interp(times, sample_times[is_read], signal[is_read])


def in_pieces(recording: Recording) -> tuple[list[Recording], list[Remark]]:
    """Return the pieces of a heated recording, and what is left out of it, in words.

    It is cut before the heat that follows a pause in which all wires have cooled, after a quarter
    of an hour without, and at gaps in the samples whose duty is not known. What comes after
    such a gap begins where wires rest.

    Raises:
        CalibrationError: if no piece is left.
    """
    time = recording.time
    # Cut unbroken stretches after pauses, and where they are too long.
    pieces = []
    after_pauses = np.array([*_starts_after_pauses(recording)], int)
    for stretch in _unbroken_stretches(recording):
        is_within = (stretch.start < after_pauses) & (after_pauses < stretch.stop)
        ends = [stretch.start, *after_pauses[is_within].tolist(), stretch.stop]
        starts = [*_piece_starts(recording, ends), stretch.stop]
        for start, stop in itertools.pairwise(starts):
            piece = select_samples(recording, np.arange(start, stop))
            num_bends = (~np.isnan(piece.bend_angle)).sum()
            is_long = piece.duration >= MIN_DURATION and num_bends >= MIN_SAMPLES
            if is_long and piece.duty[:, 1:].any():
                pieces.append(piece)
    if not pieces:
        raise CalibrationError(
            f"nothing is left of it to fit: no {MIN_DURATION:.0f} s of it begin where wires rest, "
            "show heat and readings, and have no gap whose duty is not known."
        )
    # Say how much is left out.
    remarks = []
    kept = sum(piece.duration + 1.5 / recording.sample_rate for piece in pieces)
    if (left_out := recording.duration - kept) > 1.0:
        text = f"Of {title_of(recording)}, {left_out:.0f} s are left out"
        gaps = " and ".join(f"{time[gap]:.1f} s" for gap in unknown_gaps(recording))
        text += f": what duty there was in the gap at {gaps} is not known" * bool(gaps)
        remarks.append(Remark("left out", f"{text}; pieces begin where wires rest, and have heat."))
    if len(pieces) > 1:
        for piece in pieces:
            piece.title = f"{title_of(piece)} from {piece.time[0] - time[0]:.0f} s"
    return pieces, remarks


def _unbroken_stretches(recording: Recording) -> list[slice]:
    """Return the stretches with known duty, each from a sample at which its wires rest."""
    off = np.asarray(~recording.duty.any(axis=0))
    first = first_read_index(recording)
    start = 0 if off[1 : first + 1].all() else _first_rest(recording, first)
    stretches = []
    for last_before_gap in [*unknown_gaps(recording), len(off) - 1]:
        stop = last_before_gap + 1
        if stop - start > 1:
            stretches.append(slice(start, stop))
        start = _first_rest(recording, stop)
    return stretches


def first_read_index(recording: Recording) -> int:
    """Return the first sample by which the bend was read, and each thermocouple that there is."""
    is_read = ~np.isnan(np.vstack([recording.bend_angle, recording.measured_temperature]))
    return int(np.argmax(is_read, axis=1).max())  # 0 of a row without readings


def unknown_gaps(recording: Recording) -> Iterator[int]:
    """Yield the samples before gaps across which the duty is not known."""
    time = recording.time
    steps = np.diff(recording.time)
    for index in np.flatnonzero(steps > 1.5 / recording.sample_rate).tolist():
        gap = steps[index]
        is_near = (time >= time[index] - gap) & (time <= time[index + 1] + gap)
        change = np.ptp(recording.duty[:, is_near], axis=1).max()
        if gap > MAX_GAP or (change * gap > MAX_UNKNOWN_DOSE and gap > 2.5 / recording.sample_rate):
            yield index


def _first_rest(recording: Recording, since: int) -> int:
    """Return the first sample from ``since`` on at which wires rest long enough to start there."""
    # Count the heated samples before each sample; where the count stands, wires rest.
    heat = np.concatenate([[0], np.cumsum(recording.duty.any(axis=0))])
    count = len(heat) - 1
    heated = recording.duty.any(axis=1)
    before = 0.0 if recording.has_thermocouple[heated].all() else PAUSE_TIME
    earlier = round(before * recording.sample_rate)
    later = round(RESTING_TIME * recording.sample_rate)
    samples = np.arange(since, count - later)
    samples = samples[samples - earlier >= 0]
    resting = heat[samples + later + 1] == heat[samples - earlier + 1]
    return int(samples[np.argmax(resting)]) if resting.any() else count


def _starts_after_pauses(recording: Recording) -> Iterator[int]:
    """Yield the samples some seconds before heat that follows a pause with cold wires."""
    time = recording.time
    heated = np.flatnonzero(recording.duty.any(axis=0))
    readings = recording.measured_temperature[recording.has_thermocouple]
    lowest = np.nanquantile(readings, 0.02, axis=1) if len(readings) else np.empty(0)
    for last_heated, next_heated in itertools.pairwise(heated):
        end = time[next_heated - 1]  # the duty at a sample was in force since the sample before
        if end - time[last_heated] < PAUSE_TIME:
            continue
        is_before = (time >= end - LEAD_IN_TIME) & (time <= end)
        end_readings = np.ma.masked_invalid(readings[:, is_before]).mean(axis=1).filled(lowest)
        if (end_readings < lowest + COLD_MARGIN).all():
            yield int(np.argmax(is_before))


def _piece_starts(recording: Recording, ends: list[int]) -> Iterator[int]:
    """Yield the first samples of pieces; long pieces are cut again where wires rest."""
    time = recording.time
    for start, stop in itertools.pairwise(ends):
        while start < stop:
            yield start
            late = int(np.searchsorted(time, time[start] + MAX_PIECE_DURATION))
            start = _first_rest(recording, late) if late < stop else stop
