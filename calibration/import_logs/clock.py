"""The times of a log's rows: units, midnight, restarts, coarse clocks, and a second file's."""

import numpy as np

from calibration.import_logs.evidence import correlation
from calibration.import_logs.mapping import FRAMES, TIME_OF_DAY, TIME_UNITS, UNKNOWN, TimeColumn
from calibration.import_logs.table import MIN_ROWS, LogError, LogTable
from calibration.import_logs.words import FRAME, TIME, Name, parse_unit

DAY = 86_400.0  # s
WRAP_PERIODS = (DAY, 2**32 / 1e6, 2**16 / 1e3)  # s, after which clocks begin anew
NAMED_RATES = (0.015, 15_000.0)  # Hz, of logs whose unit of time has a name
LIKELY_RATES = (0.4, 201.0)  # Hz, by which units without a name are told apart
NAMED_DURATIONS = (0.5, 2e6)  # s
LIKELY_DURATIONS = (5.0, 2e5)  # s
RESTART_GAP = 3600.0  # s, between parts whose times are not of one clock
MIN_GAP = 2.0  # s without rows
BURST_RATIO = 3.0  # times the rate of all rows together
MAX_RATE = 1000.0  # Hz
MIN_REPEATED_SHARE = 0.05  # of rows with the time of the row before, if times are rounded
MIN_CLOCK_STEP = 0.2  # of the usual step between rows, which the step of a coarse clock is at least
SMOOTHING_ROWS = (100, 20)  # rows or steps of a coarse clock, the longer, whose mean time is right
MIN_OVERLAP = 10.0  # s, in which two files that are aligned must show the same
MIN_AGREEMENT = 0.5  # correlation of two files that show the same
MIN_AGREEMENT_LEAD = 0.05  # by which the best alignment is better than others


def find_time(table: LogTable, names: list[Name]) -> TimeColumn:
    """Return the column that increases as a clock does, else frames; no column if there are none.

    The unit is `UNKNOWN` if the numbers contradict the unit in the name.
    """
    best = TimeColumn()
    best_score = 0.0
    for name in names:
        # Leave out columns of other things.
        is_clock = name.text in table.times_of_day
        says_time = is_clock or (name.role in ("", TIME) and TIME in {name.role, *name.says})
        if not says_time and (name.role or name.quantity):
            continue
        candidate = TimeColumn(name.text)
        times = table.numbers(name.text)
        # Seconds and their fraction may be in two columns, as ROS has them.
        for fraction in names:
            if _is_fraction(table, fraction, name):
                candidate.fraction = fraction.text
                candidate.fraction_unit = fraction.unit
                times = times + table.numbers(fraction.text) * TIME_UNITS[fraction.unit]
        # Leave out columns that go backward, and numbers of rows.
        present = times[~np.isnan(times)]
        steps = np.diff(present) * (-1.0 if is_reversed(present) else 1.0)
        if len(present) < max(5, 0.5 * len(times)) or (steps > 0).sum() < 5:
            continue
        if (steps < 0).sum() > 0.002 * len(steps) + 1 or ((steps == 1).all() and not name.unit):
            continue
        # Find its unit, and when it begins anew.
        if is_clock:
            candidate.unit = TIME_OF_DAY
        elif not candidate.fraction:
            candidate.unit = _time_unit(name, present)
        if table.has_names and not says_time:
            candidate.unit = UNKNOWN
        for period in WRAP_PERIODS:
            if abs(steps.min() * TIME_UNITS.get(candidate.unit, 1.0) + period) < 0.01 * period:
                candidate.wraps_after = period
        # Fine clocks are better than coarse ones.
        score = (steps > 0).mean() + 0.5 * bool(candidate.fraction)
        score -= 0.9 * (candidate.unit == UNKNOWN)
        if candidate.unit and score > best_score:
            best_score = score
            best = candidate
    # Without a clock, frames or numbers of rows come at a rate.
    for name in names:
        is_frame = name.role in (FRAME, TIME) and (np.diff(table.numbers(name.text)) > 0).all()
        if is_frame and not best.column:
            best = TimeColumn(name.text, FRAMES)
    return best


def _is_fraction(table: LogTable, name: Name, seconds_name: Name) -> bool:
    """Return whether a column is the fraction of another one's seconds."""
    stems = []
    for each_name in (name, seconds_name):
        stems.append([word for word in each_name.words if parse_unit(word)[0] != TIME])
    if stems[0] != stems[1] or seconds_name.unit != "s" or name.unit not in ("ns", "us"):
        return False
    return bool(np.nanmax(table.numbers(name.text)) * TIME_UNITS[name.unit] <= 1.0)


def _time_unit(name: Name, present: np.ndarray) -> str:
    """Return the unit in a name, `UNKNOWN` if impossible; else the first that is possible."""
    steps = np.abs(np.diff(present))
    usual = float(np.median(steps[steps > 0]))
    is_named = name.unit in TIME_UNITS
    min_duration, max_duration = NAMED_DURATIONS if is_named else LIKELY_DURATIONS
    min_rate, max_rate = NAMED_RATES if is_named else LIKELY_RATES
    for unit in [name.unit] if is_named else ["s", "ms", "us", "ns", "min", "d"]:
        is_long = min_duration < float(np.ptp(present)) * TIME_UNITS[unit] < max_duration
        if is_long and min_rate < 1 / (usual * TIME_UNITS[unit]) < max_rate:
            return unit
    return UNKNOWN if is_named else ""


def times_of(
    table: LogTable, column: TimeColumn, rate: float = 0.0
) -> tuple[np.ndarray, np.ndarray | slice, bool]:
    """Return the times of rows (K,), s by their clock, which rows those are, and if it is coarse.

    Each row is later than the row before, also if the newest row of the table comes first. Times of
    a coarse clock are made even. ``rate`` is of the rows or frames, Hz, if the log has no time.
    LogError if too few rows are left.
    """
    times = row_times(table, column, rate)
    direction = -1 if is_reversed(times) else 1
    times = times[::direction]
    # Let times that begin anew for good go on much later.
    rows_with_time = np.flatnonzero(~np.isnan(times))
    for row in rows_with_time[1:][np.diff(times[rows_with_time]) < 0]:
        before = float(np.nanmax(times[:row]))
        if (times[row:] < before).sum() > MIN_ROWS:
            times[row:] += before + RESTART_GAP - times[row]
    if step := _clock_step(times[rows_with_time]):
        times[rows_with_time] = _smooth_times(times[rows_with_time], step)
    # Leave out rows that are not later than all before.
    latest = np.fmax.accumulate(np.where(np.isnan(times), -np.inf, times))
    kept = times > np.append(-np.inf, latest[:-1])
    if kept.sum() < 2:
        raise LogError(f"the column {column.column!r} holds no time that increases.")
    if kept.all():
        return times, slice(None, None, direction), step > 0  # long logs are not copied
    return times[kept], np.arange(len(times))[::direction][kept], step > 0


def row_times(table: LogTable, column: TimeColumn, rate: float = 0.0) -> np.ndarray:
    """Return a column's times (K,), s, also where it begins anew; LogError if a field is open."""
    if UNKNOWN in (column.column, column.unit):
        raise LogError("the column of time or its unit is not known.")
    # Rows, or frames with numbers, come at a rate.
    if not column.column or column.unit == FRAMES:
        if not rate:
            raise LogError("the log has no time; give the rate of its rows or frames, Hz.")
        rows = np.arange(table.values.shape[1])
        return (table.numbers(column.column) if column.column else rows) / rate
    # Add the fraction of seconds, and what was lost at midnight.
    times = table.numbers(column.column) * TIME_UNITS.get(column.unit, 1.0)
    if column.fraction:
        times += table.numbers(column.fraction) * TIME_UNITS[column.fraction_unit]
    if period := DAY if column.unit == TIME_OF_DAY else column.wraps_after:
        is_present = ~np.isnan(times)
        begins_anew = np.diff(times[is_present], prepend=0.0) < -period / 2
        times[is_present] += period * np.cumsum(begins_anew)
    return times


def is_reversed(times: np.ndarray) -> bool:
    """Return whether the newest row comes first."""
    steps = np.diff(times[~np.isnan(times)])
    return bool((steps < 0).sum() > 0.9 * max(1, int((steps != 0).sum())))


def alternates(values: np.ndarray, times: np.ndarray) -> bool:
    """Return whether each time has several rows (K,), whose values are of several signals."""
    num_rows = round(len(times) / (1 + np.count_nonzero(np.diff(times))))
    change = np.nansum(np.abs(np.diff(values)))
    own_change = np.nansum(np.abs(values[num_rows:] - values[:-num_rows]))
    return num_rows > 1 and bool(own_change < 0.5 * change)


def usual_rate(times: np.ndarray) -> float:
    """Return the rate of most rows, Hz, as a round number if it is near one.

    Rows that come in bursts have the rate of all of them together.
    """
    steps = np.diff(times)
    usual = float(np.median(steps))
    mean_rate = 1 / float(np.mean(steps[steps <= max(MIN_GAP, usual)]))
    rate = min(mean_rate if 1 / usual >= BURST_RATIO * mean_rate else 1 / usual, MAX_RATE)
    for candidate, margin in ((rate, 0.005), (mean_rate, 0.02), (rate, 0.03)):
        rounded = round(candidate) if candidate > 3 else round(candidate, 1)
        if rounded and abs(candidate / rounded - 1) < margin:
            return float(rounded)
    return rate


def _clock_step(times: np.ndarray) -> float:
    """Return the resolution of a coarse clock, s; 0 if the clock is fine.

    A clock is coarse if times (K,) are rounded, such as to whole seconds or to single precision.
    """
    # Leave out gaps between rows, and rows of the same time.
    steps = np.diff(times)
    short = steps[(steps > 0) & (steps <= MIN_GAP)]
    if len(steps) < MIN_ROWS or (steps > 0).sum() < 2:
        return 0.0
    # The clock is coarse if all steps between rows are multiples of the shortest step.
    step = float(np.quantile(short, 0.02)) if len(short) else 0.0
    if step and step >= MIN_CLOCK_STEP * np.mean(short):
        multiples = short / step
        is_whole = np.abs(multiples - np.round(multiples)) < 0.1
        if is_whole.mean() > 0.98 and np.round(multiples).std() > 0.1:
            return step
    # Else it is coarse if many rows have the time of the row before.
    has_repeated = (steps == 0).mean() > MIN_REPEATED_SHARE
    return float(np.min(steps[steps > 0])) if has_repeated else 0.0


def _smooth_times(times: np.ndarray, clock: float) -> np.ndarray:
    """Return times (K,), s, of a clock with coarse steps, evenly spread between gaps.

    The clock's error, as far as rows come at one rate, is its mean over many of its steps.
    """
    from scipy.ndimage import uniform_filter1d  # slow to import

    smoothed = times.copy()
    gaps = np.flatnonzero(np.abs(np.diff(times)) > max(MIN_GAP, 3 * clock)) + 1
    for rows in np.split(np.arange(len(times)), gaps):
        duration = times[rows[-1]] - times[rows[0]]
        if len(rows) < MIN_ROWS or duration <= 0:
            continue
        line = np.polyval(np.polyfit(rows, times[rows], 1), rows)
        num_rows = max(SMOOTHING_ROWS[0], SMOOTHING_ROWS[1] * clock * len(rows) / duration)
        smoothed[rows] = line + uniform_filter1d(times[rows] - line, round(num_rows), mode="mirror")
    return smoothed


def aligned_offset(
    times: np.ndarray, signal: np.ndarray, second_times: np.ndarray, second_signal: np.ndarray
) -> float:
    """Return the offset, s, to add to a second file's times so that two signals agree best.

    Both signals are of the same run, in any units; times (K,) and (L,) are from each file's first
    row. Their agreement is the absolute value of their correlation. LogError if no offset is
    clearly better than all others.
    """
    # Reduce both signals to the same even steps.
    shortest = min(times[-1], second_times[-1])
    step = max(0.05, shortest / 5000)
    even_signals = []
    for signal_times, values in ((times, signal), (second_times, second_signal)):
        is_present = ~np.isnan(values)
        grid = np.arange(0.0, signal_times[-1], step)
        even_signals.append(np.interp(grid, signal_times[is_present], values[is_present]))
    fixed, shifted = even_signals
    # Compare at each offset at which enough of both files overlaps.
    min_overlap = round(max(MIN_OVERLAP, 0.5 * shortest) / step)
    offsets = np.arange(min_overlap - len(shifted), len(fixed) - min_overlap + 1)
    scores = np.zeros(len(offsets))
    for index, offset in enumerate(offsets):
        start = max(0, offset)
        end = min(len(fixed), offset + len(shifted))
        scores[index] = abs(correlation(fixed[start:end], shifted[start - offset : end - offset]))
    # The best offset must be better than offsets elsewhere.
    best = int(np.argmax(scores)) if len(scores) else 0
    elsewhere = scores[np.abs(offsets - offsets[best : best + 1]) * step > 2.0]
    rival = elsewhere.max(initial=0.0) + MIN_AGREEMENT_LEAD
    if not len(scores) or scores[best] < max(MIN_AGREEMENT, rival):
        raise LogError("the columns of join.align do not tell one offset; give join.offset, s.")
    return float(offsets[best] * step)
