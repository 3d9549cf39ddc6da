"""Pieces of a recording: cut where the limb has cooled, and where the duty is not known.

A piece is fitted from a start of its own, so that it must show where its wires start: at the
end of a pause, or where they rest for some seconds.
"""

import itertools
from collections.abc import Iterator

import numpy as np

from calibration.errors import CalibrationError
from calibration.recordings.kinds import title_of
from calibration.recordings.repair import part
from calibration.remarks import Remark
from limb_systems import Recording

PAUSE = 60.0  # s without heat, after which wires may be cold
COLD = 8.0  # °C above their lowest readings, within which they are
REST = 5.0  # s before its heat with which a piece begins
STILL = 3.0  # s without heat, in which readings show where a wire that is not cold starts
SHORTEST, FEWEST = 10.0, 20  # s of heated recordings, and samples of any
LONGEST = 900.0  # s, as the time that fits take grows with its square
LONGEST_GAP = 60.0  # s, that are filled with the duty beside them
UNKNOWN = 0.5  # s of full duty, by which the dose in a gap may be wrong


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
    kept = sum(piece.time[-1] - piece.time[0] + 1.5 / recording.sample_rate for piece in pieces)
    if (left_out := time[-1] - time[0] - kept) > 1.0:
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
    read = (~np.isnan(piece.measured_temperature)).sum(axis=1).max(initial=0)
    bends = (~np.isnan(piece.bend_angle)).sum()
    long = piece.time[-1] - piece.time[0] >= SHORTEST
    return bool(piece.duty[:, 1:].any() and long and min(read, bends) >= FEWEST)
