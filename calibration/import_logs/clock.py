"""The times of a log's rows: units, midnight, restarts, coarse clocks, and a second file's."""

import numpy as np

from calibration.import_logs.evidence import correlation
from calibration.import_logs.mapping import DATE, FRAMES, OPEN, SECONDS, TimeColumn
from calibration.import_logs.table import FEWEST_ROWS, LogError, LogTable

DAY = 86_400.0  # s
RESTART = 3600.0  # s, between parts whose times are not of one clock
GAP = 2.0  # s without rows
BURSTS = 3.0  # times the rate of all rows together
FASTEST = 1000.0  # Hz
REPEATED = 0.05  # share of rows with the time of the row before, from which on times are rounded
COARSE = 0.2  # share of the usual step that a clock's step is at least, if the clock is coarse
OVERLAP = 10.0  # s, in which two files that are aligned must show the same
AGREES = 0.5  # correlation of two files that show the same
CLEARLY = 0.05  # by which the best alignment is better than others
ALIGNED_STEP = 0.05  # s


def times_of(
    table: LogTable, column: TimeColumn, rate: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the times of rows (K,), s from the first, and which rows those are.

    Each row is later than the row before. Times of a coarse clock are made even.

    Args:
        rate: of the rows or frames, Hz, if the log has no time or counts frames.

    Raises:
        LogError: if there are too few.
    """
    times = with_restarts(stamps(table, column, rate))
    if is_coarse(times):
        times = _even(times)
    latest = np.fmax.accumulate(np.where(np.isnan(times), -np.inf, times))
    kept = ~np.isnan(times) & (times > np.append(-np.inf, latest[:-1]))
    if kept.sum() < 2:
        raise LogError(f"the column {column.column!r} holds no time that increases.")
    times = times[kept]
    return times - times[0], kept


def stamps(table: LogTable, column: TimeColumn, rate: float = 0.0) -> np.ndarray:
    """Return the times that a column says, s; they go on where it begins anew."""
    if OPEN in (column.column, column.unit):
        raise LogError(f"the time and its unit are not known; the mapping says {column.column!r}.")
    if not column.column or column.unit == FRAMES:
        if not rate:
            raise LogError("the log has no time; give the rate of its rows or frames as rate, Hz.")
        frames = table.numbers(column.column) if column.column else np.arange(table.num_rows)
        return frames / rate
    if column.unit == DATE:
        times = table.moments(column.column)
        of_day = np.fmax.reduce(times) < 0  # without a date, which are of the year 1900
        times = _unwrapped(times, DAY) if of_day else _without_months(times)
    else:
        times = table.numbers(column.column) * SECONDS[column.unit]
    if column.fraction:
        times = times + table.numbers(column.fraction) * SECONDS[column.fraction_unit]
    return _unwrapped(times, column.wraps_after) if column.wraps_after else times


def is_reversed(times: np.ndarray) -> bool:
    """Whether the newest row comes first."""
    steps = np.diff(times[~np.isnan(times)])
    return bool((steps < 0).sum() > 0.9 * max(1, int((steps != 0).sum())))


def usual_rate(times: np.ndarray) -> float:
    """Return the rate of most rows, Hz, as a round number if it is near one.

    Rows that come in bursts have the rate of all of them together.
    """
    steps = np.diff(times)
    together = 1 / float(np.mean(steps[steps <= max(GAP, float(np.median(steps)))]))
    rate = 1 / float(np.median(steps))
    coarse = _clock_step(steps) > 0.0
    rate = min(together if coarse or rate >= BURSTS * together else rate, FASTEST)
    near = round(rate) if rate > 3 else round(rate, 1)
    return float(near) if near and abs(rate / near - 1) < 0.03 else rate


def with_restarts(times: np.ndarray) -> np.ndarray:
    """Return times that go on, much later, where they begin anew for good."""
    times = times.copy()
    known = np.flatnonzero(~np.isnan(times))
    for row in known[1:][np.diff(times[known]) < 0]:
        before = float(np.nanmax(times[:row]))
        after = times[row:]
        if (after < before).sum() > FEWEST_ROWS:
            times[row:] += before + RESTART - times[row]
    return times


def is_coarse(times: np.ndarray) -> bool:
    """Whether a clock has steps as long as the time between rows: whole seconds, float32."""
    steps = np.diff(times[~np.isnan(times)])
    if len(steps) < FEWEST_ROWS or (steps > 0).sum() < 2:
        return False
    return bool((steps == 0).mean() > REPEATED) or _clock_step(steps) > 0.0


def _clock_step(steps: np.ndarray) -> float:
    """Return the step of a coarse clock, of which all steps are multiples, s; 0 if it is fine."""
    later = steps[steps > 0]
    usual = float(np.mean(later[later <= GAP])) if (later <= GAP).any() else 0.0
    step = float(np.quantile(later, 0.02))
    if not usual or step < COARSE * usual:
        return 0.0
    multiples = later / step
    short = later <= GAP
    whole = np.abs(multiples - np.round(multiples)) < 0.1
    varied = np.round(multiples[short]).std() > 0.1
    return step if varied and whole[short].mean() > 0.98 else 0.0


def _even(times: np.ndarray) -> np.ndarray:
    """Return times of a coarse clock, even where rows come at one rate, else spread evenly."""
    known = ~np.isnan(times)
    own = times[known]
    steps = np.diff(own)
    later = steps[steps > 0]
    clock = max(_clock_step(steps), float(np.min(later)))
    # Between gaps, rows that come at one rate are at most a step of the clock from a line.
    ends = np.flatnonzero(steps > max(GAP, 3 * clock)) + 1
    even = own.copy()
    for part in np.split(np.arange(len(own)), ends):
        if len(part) > FEWEST_ROWS:
            count = np.arange(len(part))
            slope, start = np.polyfit(count, own[part], 1)
            line = start + slope * count
            even[part] = line if np.abs(line - own[part]).max() <= 1.05 * clock else np.nan
    if np.isnan(even).any() and (steps == 0).mean() > REPEATED:
        even = _spread(own)
    elif np.isnan(even).any():
        even = own
    result = times.copy()
    result[known] = even
    return result


def _spread(times: np.ndarray) -> np.ndarray:
    """Return times with those that are repeated spread evenly up to the next one."""
    starts = np.flatnonzero(np.append(True, np.diff(times) != 0))
    if starts[-1] == 0:
        return times
    usual = np.median(np.diff(starts))
    # The first time may be of fewer rows than others, as the log begins amid it.
    rows = np.append(starts, starts[-1] + usual)
    rows[0] = min(0, rows[1] - usual)
    own = np.append(times[starts], times[starts[-1]] + np.median(np.diff(times[starts])))
    return np.interp(np.arange(len(times)), rows, own)


def _without_months(times: np.ndarray) -> np.ndarray:
    """Return moments that go on at midnight where a day was taken for a month: 1/2, 2/2."""
    known = ~np.isnan(times)
    steps = np.diff(times[known])
    if not len(steps):
        return times
    beyond = steps % DAY
    months = (steps > 20 * DAY) & (beyond <= 10 * np.median(steps))
    times = times.copy()
    times[known] -= np.append(0.0, np.cumsum(np.where(months, steps - beyond, 0.0)))
    return times


def _unwrapped(times: np.ndarray, period: float) -> np.ndarray:
    shown = ~np.isnan(times)
    times = times.copy()
    times[shown] += period * np.cumsum(np.append(0, np.diff(times[shown]) < -period / 2))
    return times


def aligned_offset(
    times: np.ndarray, signal: np.ndarray, other_times: np.ndarray, other: np.ndarray
) -> float:
    """Return the time on one file's clock, s, of another file's time 0, by cross-correlation.

    Args:
        times, signal: of the one file (K,), s from its first row.
        other_times, other: of the other file (L,), which shows the same, whatever its unit.

    Raises:
        LogError: if no alignment is clearly better than all others.
    """
    shortest = min(times[-1], other_times[-1])
    step = max(ALIGNED_STEP, shortest / 5000)
    grid = np.arange(0.0, times[-1], step)
    own = np.interp(grid, times[~np.isnan(signal)], signal[~np.isnan(signal)])
    shown = ~np.isnan(other)
    other_grid = np.arange(0.0, other_times[-1], step)
    moved = np.interp(other_grid, other_times[shown], other[shown])
    least = round(max(OVERLAP, 0.5 * shortest) / step)
    if least > min(len(own), len(moved)):
        raise LogError(f"the files of join have less than {OVERLAP:g} s that may be the same.")
    # Compare at each offset at which enough of both files overlaps.
    offsets = np.arange(least - len(moved), len(own) - least + 1)
    scores = np.empty(len(offsets))
    for index, offset in enumerate(offsets):
        start = max(0, offset)
        end = min(len(own), offset + len(moved))
        scores[index] = abs(correlation(own[start:end], moved[start - offset : end - offset]))
    best = int(np.argmax(scores))
    elsewhere = scores[np.abs(offsets - offsets[best]) * step > 2.0]
    rival = float(elsewhere.max()) if len(elsewhere) else 0.0
    if scores[best] < AGREES or scores[best] < rival + CLEARLY:
        raise LogError(
            f"the columns of join.align agree best at {offsets[best] * step:.1f} s (r = "
            f"{scores[best]:.2f}), but elsewhere almost as well ({rival:.2f}); give join.offset."
        )
    return float(offsets[best] * step)
