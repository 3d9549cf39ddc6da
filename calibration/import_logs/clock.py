"""The times of a log's rows: units, midnight, restarts, coarse clocks, and a second file's."""

import numpy as np

from calibration.import_logs.evidence import correlation
from calibration.import_logs.mapping import DATE, FRAMES, OPEN, SECONDS, TimeColumn
from calibration.import_logs.table import FEWEST_ROWS, LogError, LogTable
from calibration.import_logs.words import TIME, Name

DAY = 86_400.0  # s
PERIODS = (DAY, 2**32 / 1e6, 2**16 / 1e3)  # s, after which clocks begin anew
RATES = (0.015, 15_000.0)  # Hz, of logs whose unit of time has a name
LIKELY_RATES = (0.4, 201.0)  # Hz, by which units without a name are told apart
DURATIONS = (5.0, 2e5)  # s
RESTART = 3600.0  # s, between parts whose times are not of one clock
GAP = 2.0  # s without rows
BURSTS = 3.0  # times the rate of all rows together
FASTEST = 1000.0  # Hz
REPEATED = 0.05  # share of rows with the time of the row before, from which on times are rounded
COARSE = 0.2  # of the usual step between rows, which the step of a coarse clock is at least
OVERLAP = 10.0  # s, in which two files that are aligned must show the same
AGREES = 0.5  # correlation of two files that show the same
CLEARLY = 0.05  # by which the best alignment is better than others
FRACTIONS = {"nanosec": "ns", "nsec": "ns", "nsecs": "ns", "nanosecs": "ns", "usec": "us"}
UNIT_WORDS = {
    "ms": "ms millis msec milliseconds millisec", "us": "us micros µs microseconds usec",
    "ns": "ns nanos nanoseconds nsec nanosec", "s": "s sec seconds secs sekunden",
    "min": "min minutes minuten", "h": "h hours stunden", "d": "d days tage",
}  # fmt: skip


def rated_time(table: LogTable, name: Name, names: list[Name]) -> tuple[float, TimeColumn]:
    """Return how much speaks for a column as the time, -1 if it is none; and how it is read."""
    none = (-1.0, TimeColumn())
    says_time = name.role == TIME
    values = table.numbers(name.text)
    unit = ""
    if np.isnan(values).mean() > 0.5:
        values = table.moments(name.text)
        unit = DATE
    # Seconds and their fraction may be in two columns, as ROS has them.
    fraction = next((n for n in names if says_time and _is_fraction(n, name)), None)
    fraction_unit = "ns"
    if fraction:
        fraction_unit = next(FRACTIONS[word] for word in fraction.words if word in FRACTIONS)
        values = values + table.numbers(fraction.text) * SECONDS[fraction_unit]
    shown = values[~np.isnan(values)]
    if len(shown) < max(5, 0.5 * len(values)) or not (
        says_time or not (name.role or name.quantity)
    ):
        return none
    steps = np.diff(shown) * (-1.0 if is_reversed(shown) else 1.0)
    is_index = bool((steps == 1).all())
    backward = int((steps < 0).sum())
    if (steps > 0).sum() < 5 or backward > 0.002 * len(steps) + 1 or (is_index and not says_time):
        return none
    if not (unit := unit or ("s" if fraction else _unit(name, shown))):
        return none
    wraps = 0.0
    for period in PERIODS if backward else ():
        if np.abs(steps.min() * SECONDS.get(unit, 1.0) + period) < 0.01 * period:
            wraps = period
    score = 2.0 * says_time + (steps > 0).mean() - 1.5 * is_index - (unit == OPEN)
    text = fraction.text if fraction else ""
    return score + 0.5 * bool(text), TimeColumn(name.text, unit, wraps, text, fraction_unit)


def _is_fraction(name: Name, of: Name) -> bool:
    """Whether a column is the fraction of another one's seconds."""
    rest = [word for word in name.words if word not in FRACTIONS]
    return len(rest) < len(name.words) and rest == [w for w in of.words if w not in ("sec", "secs")]


def _unit(name: Name, shown: np.ndarray) -> str:
    """Return the unit that a name says, `OPEN` if it cannot be; else the first that can be."""
    steps = np.abs(np.diff(shown))
    usual = float(np.median(steps[steps > 0]))

    def can_be(unit: str, rates: tuple[float, float], spare: float) -> bool:
        duration = float(np.ptp(shown)) * SECONDS[unit]
        is_long = DURATIONS[0] / spare < duration < DURATIONS[1] * spare
        return is_long and rates[0] < 1 / (usual * SECONDS[unit]) < rates[1]

    words = {name.unit, *name.words}
    said = [unit for unit, known in UNIT_WORDS.items() if words & set(known.split())]
    if said:
        return next((unit for unit in said if can_be(unit, RATES, 10.0)), OPEN)
    units = ("s", "ms", "us", "ns", "min", "d")
    return next((unit for unit in units if can_be(unit, LIKELY_RATES, 1.0)), "")


def times_of(
    table: LogTable, column: TimeColumn, rate: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the times of rows (K,), s from the first, and which rows those are.

    Each row is later than the row before. Times of a coarse clock are made even.

    Args:
        rate: rate of the rows or frames, Hz, if the log has no time or counts frames.

    Raises:
        LogError: if there are too few.
    """
    times = _with_restarts(stamps(table, column, rate))
    if is_coarse(times):
        times = _even(times)
    latest = np.fmax.accumulate(np.where(np.isnan(times), -np.inf, times))
    kept = ~np.isnan(times) & (times > np.append(-np.inf, latest[:-1]))
    if kept.sum() < 2:
        raise LogError(f"the column {column.column!r} holds no time that increases.")
    times = times[kept]
    return times - times[0], kept


def stamps(table: LogTable, column: TimeColumn, rate: float = 0.0) -> np.ndarray:
    """Return the times that a column says (K,), s; they go on where it begins anew."""
    if OPEN in (column.column, column.unit):
        raise LogError("the column of time or its unit is not known.")
    if not column.column or column.unit == FRAMES:
        if not rate:
            raise LogError("the log has no time; give the rate of its rows or frames, Hz.")
        return (table.numbers(column.column) if column.column else np.arange(table.num_rows)) / rate
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

    Rows that come in bursts, or by a coarse clock, have the rate of all of them together.
    """
    steps = np.diff(times)
    together = 1 / float(np.mean(steps[steps <= max(GAP, float(np.median(steps)))]))
    rate = 1 / float(np.median(steps))
    rate = min(together if _clock_step(steps) or rate >= BURSTS * together else rate, FASTEST)
    for found, margin in ((rate, 0.005), (together, 0.02), (rate, 0.03)):
        near = round(found) if found > 3 else round(found, 1)
        if near and abs(found / near - 1) < margin:
            return float(near)
    return rate


def is_coarse(times: np.ndarray) -> bool:
    """Whether a clock's step is as long as rows are apart: whole seconds, single precision."""
    steps = np.diff(times[~np.isnan(times)])
    if len(steps) < FEWEST_ROWS or (steps > 0).sum() < 2:
        return False
    return bool((steps == 0).mean() > REPEATED) or _clock_step(steps) > 0.0


def _clock_step(steps: np.ndarray) -> float:
    """Return the step of a coarse clock, of which all steps are multiples, s; 0 if it is fine."""
    short = steps[(steps > 0) & (steps <= GAP)]
    step = float(np.quantile(short, 0.02)) if len(short) else 0.0
    if not step or step < COARSE * np.mean(short):
        return 0.0
    multiples = short / step
    whole = np.abs(multiples - np.round(multiples)) < 0.1
    return step if whole.mean() > 0.98 and np.round(multiples).std() > 0.1 else 0.0


def _even(times: np.ndarray) -> np.ndarray:
    """Return times of a coarse clock: even where rows come at one rate, else spread evenly."""
    known = ~np.isnan(times)
    own = times[known]
    steps = np.diff(own)
    clock = _clock_step(steps) or float(np.min(steps[steps > 0]))
    # Between gaps, rows that come at one rate are at most a step of the clock from a line.
    even = own.copy()
    gaps = np.flatnonzero(steps > max(GAP, 3 * clock)) + 1
    for part in np.split(np.arange(len(own)), gaps):
        if len(part) > FEWEST_ROWS:
            line = np.polyval(np.polyfit(part, own[part], 1), part)
            even[part] = line if np.abs(line - own[part]).max() <= 1.05 * clock else np.nan
    if np.isnan(even).any():
        even = _spread(own) if (steps == 0).mean() > REPEATED else own
    result = times.copy()
    result[known] = even
    return result


def _spread(times: np.ndarray) -> np.ndarray:
    """Return times with those that are repeated spread evenly up to the next one."""
    starts = np.flatnonzero(np.append(True, np.diff(times) != 0))
    usual = np.median(np.diff(starts))
    # The first time may be of fewer rows than others, as the log begins amid it.
    rows = np.append(starts, starts[-1] + usual)
    rows[0] = min(0, rows[1] - usual)
    own = np.append(times[starts], times[starts[-1]] + np.median(np.diff(times[starts])))
    return np.interp(np.arange(len(times)), rows, own)


def _with_restarts(times: np.ndarray) -> np.ndarray:
    """Return times that go on, much later, where they begin anew for good."""
    times = times.copy()
    known = np.flatnonzero(~np.isnan(times))
    for row in known[1:][np.diff(times[known]) < 0]:
        before = float(np.nanmax(times[:row]))
        if (times[row:] < before).sum() > FEWEST_ROWS:
            times[row:] += before + RESTART - times[row]
    return times


def _without_months(times: np.ndarray) -> np.ndarray:
    """Return moments that go on at midnight where a day was taken for a month: 1/2, 2/2."""
    known = ~np.isnan(times)
    steps = np.diff(times[known])
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
        times, signal: times (K,), s from the file's first row, and a signal (K,).
        other_times, other: the other file's times (L,) and signal (L,), in any unit.

    Raises:
        LogError: if no offset is clearly better than all others.
    """
    shortest = min(times[-1], other_times[-1])
    step = max(0.05, shortest / 5000)
    series = []
    for clock, values in ((times, signal), (other_times, other)):
        shown = ~np.isnan(values)
        series.append(np.interp(np.arange(0.0, clock[-1], step), clock[shown], values[shown]))
    own, moved = series
    # Compare at each offset at which enough of both files overlaps.
    least = round(max(OVERLAP, 0.5 * shortest) / step)
    offsets = np.arange(least - len(moved), len(own) - least + 1)
    scores = np.zeros(len(offsets))
    for index, offset in enumerate(offsets):
        start = max(0, offset)
        end = min(len(own), offset + len(moved))
        scores[index] = abs(correlation(own[start:end], moved[start - offset : end - offset]))
    best = int(np.argmax(scores)) if len(scores) else 0
    elsewhere = scores[np.abs(offsets - offsets[best : best + 1]) * step > 2.0]
    if not len(scores) or scores[best] < max(AGREES, elsewhere.max(initial=0.0) + CLEARLY):
        raise LogError("the columns of join.align do not tell one offset; give join.offset, s.")
    return float(offsets[best] * step)
