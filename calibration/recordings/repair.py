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

SPIKE = 6.0  # robust standard deviations from the median of five samples, beyond which one counts
STEEP = 1.5  # of the range of its neighbours, within which a sample is no spike
READ = 2.0  # s, within which readings are missed least
PASSES = 2  # after which spikes beside each other are gone
PAUSE = 60.0  # s without heat, after which wires may be cold
COLD = 8.0  # °C above their lowest readings, within which they are
REST = 5.0  # s before its heat with which a piece begins
STILL = 3.0  # s without heat, in which readings show where a wire that is not cold starts
SHORTEST, FEWEST = 10.0, 20  # s of heated recordings, and samples of any
LONGEST = 900.0  # s, as the time that fits take grows with its square
LONGEST_GAP = 60.0  # s, that are filled with the duty beside them
UNKNOWN = 0.5  # s of full duty, by which the dose in a gap may be wrong


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
    ends = np.append(recording.time[0] - 1 / recording.sample_rate, recording.time)
    applied = recording.applied_duty[:, [*first, -1]]

    def when_taken(row: np.ndarray) -> np.ndarray:
        return np.where(np.isnan(row), np.nan, filled(recording.time, row[first], taken))

    return _with_readings(
        recording,
        when_taken,
        duty=np.clip(doses(applied, breaks, ends) / np.diff(ends), 0.0, 1.0),
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


def in_pieces(recording: Recording) -> tuple[list[Recording], list[Remark]]:
    """The pieces of a heated recording, and what is left out of it, in words.

    It is cut before the heat that follows a pause in which all wires have cooled, after a quarter
    of an hour without, and at gaps in the samples whose duty is not known. What comes after
    such a gap begins where wires rest.

    Raises:
        CalibrationError: if no piece is left.
    """
    time = recording.time
    pieces = []
    for whole in _unbroken(recording):
        starts = [whole.start, *(c for c in _after_pauses(recording) if whole.start < c)]
        starts = [start for start in starts if start < whole.stop]
        starts = list(_shortened(recording, [*starts, whole.stop]))
        for start, stop in zip(starts, [*starts[1:], whole.stop], strict=True):
            pieces.append(part(recording, np.arange(start, stop)))
    pieces = [piece for piece in pieces if _tells(piece)]
    if not pieces:
        raise CalibrationError(
            f"nothing is left of it to fit: no {SHORTEST:.0f} s of it begin where wires rest, show "
            "heat and readings, and have no gap whose duty is not known."
        )
    remarks = []
    kept = sum(piece.duration + 1.5 / recording.sample_rate for piece in pieces)
    if (left_out := recording.duration - kept) > 1.0:
        said = f"Of {title_of(recording)}, {left_out:.0f} s are left out"
        gaps = " and ".join(f"{time[gap]:.1f} s" for gap in gaps_of(recording))
        said += f": what duty there was in the gap at {gaps} is not known" * bool(gaps)
        remarks.append(Remark("left out", f"{said}; pieces begin where wires rest, and have heat."))
    if len(pieces) > 1:
        for piece in pieces:
            piece.title = f"{title_of(piece)} from {piece.time[0] - time[0]:.0f} s"
    return pieces, remarks


def _unbroken(recording: Recording) -> list[slice]:
    """Stretches of a recording in which the duty is known, each from where its wires rest."""
    off = np.asarray(~recording.duty.any(axis=0))
    first, gaps = first_read(recording), list(gaps_of(recording))
    starts = [0 if off[1 : first + 1].all() else _rest(recording, first)]
    starts += [_rest(recording, gap + 1) for gap in gaps]
    stops = [*(gap + 1 for gap in gaps), len(off)]
    return [slice(a, b) for a, b in zip(starts, stops, strict=True) if b - a > 1]


def first_read(recording: Recording) -> int:
    """The first sample by which the bend was read, and each thermocouple that there is."""
    rows = np.vstack([recording.bend_angle, recording.measured_temperature])
    return max((int(np.argmax(read)) for read in ~np.isnan(rows) if read.any()), default=0)


def gaps_of(recording: Recording) -> Iterator[int]:
    """The samples before which and after which the duty differs too much for what is between."""
    time, steps = recording.time, np.diff(recording.time)
    for index in np.flatnonzero(steps > 1.5 / recording.sample_rate).tolist():
        gap = steps[index]
        near = (time >= time[index] - gap) & (time <= time[index + 1] + gap)
        change = np.ptp(recording.duty[:, near], axis=1).max()
        if gap > LONGEST_GAP or (change * gap > UNKNOWN and gap > 2.5 / recording.sample_rate):
            yield index


def _rest(recording: Recording, since: int) -> int:
    """The first sample from one on at which wires rest, as long as shows where they start."""
    heat = np.concatenate([[0], np.cumsum(recording.duty.any(axis=0))])
    count = len(heat) - 1
    heated = recording.duty.any(axis=1)
    before = 0.0 if recording.has_thermocouple[heated].all() else PAUSE
    earlier, later = (round(span * recording.sample_rate) for span in (before, STILL))
    samples = np.arange(since, count - later)
    samples = samples[samples - earlier >= 0]
    resting = heat[samples + later + 1] == heat[samples - earlier + 1]
    return int(samples[np.argmax(resting)]) if resting.any() else count


def _after_pauses(recording: Recording) -> Iterator[int]:
    """The samples some seconds before the heat that follows a pause with cold wires at its end."""
    time, heated = recording.time, np.flatnonzero(recording.duty.any(axis=0))
    readings = recording.measured_temperature[recording.has_thermocouple]
    lowest = np.nanquantile(readings, 0.02, axis=1) if len(readings) else np.empty(0)
    for last, following in itertools.pairwise(heated):
        end = time[following - 1]  # the duty at a sample was in force since the one before
        if end - time[last] < PAUSE:
            continue
        before = (time >= end - REST) & (time <= end)
        shown = np.ma.masked_invalid(readings[:, before]).mean(axis=1).filled(lowest)
        if (shown < lowest + COLD).all():
            yield int(np.argmax(before))


def _shortened(recording: Recording, ends: list[int]) -> Iterator[int]:
    """The samples with which pieces begin, of which the longest are cut again where wires rest."""
    time = recording.time
    for start, stop in itertools.pairwise(ends):
        while start < stop:
            yield start
            late = int(np.searchsorted(time, time[start] + LONGEST))
            start = _rest(recording, late) if late < stop else stop


def _tells(piece: Recording) -> bool:
    """Whether a piece shows heat, for long enough."""
    bends = (~np.isnan(piece.bend_angle)).sum()
    return bool(piece.duty[:, 1:].any() and piece.duration >= SHORTEST and bends >= FEWEST)
