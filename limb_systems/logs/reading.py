"""Reads a log by its mapping: times, units, gaps, and recordings in even steps."""

import copy
import itertools
from pathlib import Path
from typing import Any

import numpy as np

from limb_systems.bend_sensor import (
    ChordSensor,
    TipTangentSensor,
    bend_angle_from_tip_tangent,
)
from limb_systems.errors import raised_as
from limb_systems.files.signal_table import doses
from limb_systems.limb_parameters import LimbParameters
from limb_systems.logs.evidence import held
from limb_systems.logs.mapping import (
    BEND_ANGLE,
    CELSIUS,
    CHORD,
    OPEN,
    SECONDS,
    TIP_TANGENT,
    LogMapping,
    TimeColumn,
)
from limb_systems.logs.table import FEWEST_ROWS, LogError, LogTable, read_table

DAY = 86_400.0  # s
SAG, EARTH = "sag", 9.81  # beginning of the names of logs of the sag, and m/s²
GAP = 2.0  # s without rows, in which duty may have been anything if it differs before and after
CHANGE = 0.05  # of duty, that counts as another
LONGEST_GAP = 30.0  # s, beyond which it may have been anything at all, unless it was off
LONGEST_PAUSE = 600.0  # s, beyond which a recording ends
RESTART = 3600.0  # s, between parts whose times are not of one clock
SHORTEST = 10.0  # s of a part of a log that is worth keeping
STALE = 2.6, 0.5  # periods and s, the longer of which a reading may be held
REPEATED = 5  # rows in which points of a picture are exactly where they were, and were not seen
COARSE = 0.5  # share of rows whose time is repeated, from which on times are rounded
OVER = 0.05  # by which duty may exceed full duty, and is cut off
READABLE = -60.0, 600.0  # °C, of readings that a thermocouple can have
RARELY = 0.05  # share of rows in which a sensor may fail
BURSTS, FASTEST = 3.0, 1000.0  # times the rate of all rows together; and Hz
MOST = 1_000_000  # samples of a recording; a file of more may be too large to be read again


def read_log(
    path: str | Path,
    mapping: LogMapping,
    parameters: LimbParameters | None = None,
    table: LogTable | None = None,
) -> tuple[list[dict[str, Any]], list[str]]:
    """The parts of a log, as arguments of `Recording`, and what was lost, in sentences.

    Args:
        table: the log's rows; they are read if None.
        parameters: the limb's description; the nominal limb, with the wires of the mapping, if
            None.

    Raises:
        LogError: if the log is not as the mapping says.
    """
    if question := mapping.question:
        raise LogError(f"{path}: {question}")
    table = table or read_table(path, mapping.delimiter, mapping.decimal, mapping.names_line)
    with raised_as(LogError, f"{path}: "):
        if is_reversed(stamps(table, mapping.time)):
            table = table.oldest_first()
        return _parts(table, mapping, described(mapping, parameters), Path(path).name)


def described(mapping: LogMapping, parameters: LimbParameters | None) -> LimbParameters:
    """The limb that a log is of, with the bend sensor that the mapping says.

    Raises:
        LogError: if the mapping has wires that the description lacks.
    """
    limb = copy.deepcopy(parameters or LimbParameters())
    if len(limb.segments) != 1:
        raise LogError(f"The limb has {len(limb.segments)} segments; read a log for each of them.")
    (segment,) = limb.segments
    names = [wire.name for wire in mapping.wires]
    for name in names:
        if name not in limb.wire_names:
            raise LogError(
                f"The mapping has a wire {name!r}, but the limb's wires are "
                f"{', '.join(limb.wire_names)}."
            )
    if parameters is None:
        segment.wires = [wire for wire in segment.wires if wire.name in names]
    if mapping.bend.measures != BEND_ANGLE:
        kind = ChordSensor if mapping.bend.measures == CHORD else TipTangentSensor
        if not isinstance(segment.bend_sensor, kind):
            segment.bend_sensor = kind()
    return limb


def _parts(
    table: LogTable, mapping: LogMapping, limb: LimbParameters, name: str
) -> tuple[list[dict[str, Any]], list[str]]:
    remarks: list[str] = []
    times, duty, readings = _signals(table, mapping, limb, remarks)
    rate = mapping.rate or usual_rate(times)
    measured = ~np.isnan(readings).all(axis=1)
    if count := int(np.isnan(readings[measured]).any(axis=0).sum()):
        remarks.append(f"{count} of {_rows(len(times))} lack a reading, which stays empty.")
    cuts, gaps = _cuts(times, duty), np.diff(times)
    if len(cuts) > 2:
        ends = ", ".join(f"{times[cut - 1]:.0f} s" for cut in cuts[1:-1])
        remarks.append(f"Cut after {ends}: what happened in the gap there is not known.")
    gaps[[cut - 1 for cut in cuts[1:-1]]] = 0.0  # they are cut, and said above
    whole, cuts = len(cuts), _short_enough(cuts, times, duty, rate)
    if len(cuts) > whole:
        remarks.append(
            f"Cut where wires were off the longest, so that no part has more than {MOST} samples."
        )
    if long := int((gaps > GAP).sum()):
        said = f"{long} gap{'s' * (long != 1)} of more than {GAP:g} s"
        remarks.append(f"{said}, the longest of {gaps.max():.1f} s.")
    parts: list[dict[str, Any]] = []
    for number, (start, end) in enumerate(itertools.pairwise(cuts), 1):
        part = slice(start, end)
        if end - start < 2 or (len(cuts) > 2 and times[end - 1] - times[start] < SHORTEST):
            said = f"{_rows(end - start)} from {times[start]:.0f} s on"
            remarks.append(f"{said} are too few to keep.")
            continue
        even = resampled(times[part] - times[start], duty[:, part], readings[:, part], rate)
        where = f", part {number}" if len(cuts) > 2 else ""
        about = {"parameters": limb, "source": f"log {name}{where}", "sample_rate": rate}
        parts.append({**even, **about})
    if not parts:
        raise LogError(f"no part of {SHORTEST:g} s or more has rows without a gap.")
    if name.startswith(SAG) and not duty.any():
        limb.gravity = [0.0, EARTH * (np.sign(np.nanmedian(readings[-1])) or -1.0), 0.0]
        remarks.append("By its name, gravity bends the limb here, to the side of its bend.")
    return parts, remarks


def _signals(
    table: LogTable, mapping: LogMapping, limb: LimbParameters, remarks: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (K,), s, duty (W, K), and readings V, °C, and φ, rad (W + 1, K), of the rows.

    Args:
        remarks: gets what was lost, in sentences.
    """
    if table.odd_rows:
        remarks.append(f"{_rows(table.odd_rows)} with another number of cells left out.")
    times, kept = times_of(table, mapping.time)
    if _is_coarse(stamps(table, mapping.time)):
        remarks.append("Times are repeated in most rows, which are spread evenly between them.")
    if lost := int(len(kept) - kept.sum()):
        said = f"{_rows(lost)} left out"
        remarks.append(f"{said}, whose time is missing, repeated or earlier than before.")
    duty = np.zeros((len(limb.wires), len(times)))
    readings = np.full((len(limb.wires) + 1, len(times)), np.nan)
    for wire in mapping.wires:
        index = limb.wire_names.index(wire.name)
        if wire.duty:
            values = wire.sign * table.numbers(wire.duty)[kept]
            duty[index], unknown = _duty(values, wire.duty, mapping.full)
            if unknown:
                remarks.append(f"The {wire.name} wire's duty is missing in {_rows(unknown)}; held.")
        if wire.temperature:
            factor, offset = CELSIUS[wire.unit]
            values = _without(table.numbers(wire.temperature)[kept], mapping.missing)
            values = factor * values + offset
            unreadable = (values < READABLE[0]) | (values > READABLE[1])
            if unreadable.mean() > 0.5:
                raise LogError(
                    f"the column {wire.temperature!r} is beyond {READABLE[0]:g} to "
                    f"{READABLE[1]:g} °C in most rows; correct its unit."
                )
            values[unreadable] = np.nan
            readings[index] = values
        elif wire.duty:
            remarks.append(f"The {wire.name} wire has no thermocouple in this log.")
    readings[-1] = bend_of(table, mapping)[kept]
    if first := _from_first_reading(duty, readings[-1]):
        said = f"{_rows(first)} without a bend left out at the beginning"
        remarks.append(f"{said}, without heat.")
    times, duty, readings = times[first:], duty[:, first:], readings[:, first:]
    if len(times) < 2 or np.isnan(readings[-1]).all():
        raise LogError("no row has a bend; correct the mapping's bend.")
    return times, duty, np.array([_between_rows(times, row) for row in readings])


def _between_rows(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Readings of a sensor that is slower than the rows, with lines between them."""
    shown = ~np.isnan(values)
    own = np.diff(times[shown])
    if len(own) < 2 or (usual := np.median(own)) < 1.5 * np.median(np.diff(times)):
        return values
    near = np.interp(times, times[shown][1:], own, left=own[0])
    there = np.interp(times, times[shown], values[shown], left=np.nan, right=np.nan)
    return np.where(near <= STALE[0] * usual, there, np.nan)


def _rows(count: int) -> str:
    return f"{count} row{'s' * (count != 1)}"


def times_of(table: LogTable, column: TimeColumn) -> tuple[np.ndarray, np.ndarray]:
    """Times of the rows (K,), s from the first, and which rows those are: each later than before.

    Raises:
        LogError: if there are too few.
    """
    times = stamps(table, column)
    times = _with_restarts(times)
    if _is_coarse(times):
        times = _spread(times)
    latest = np.fmax.accumulate(np.where(np.isnan(times), -np.inf, times))
    kept = ~np.isnan(times) & (times > np.append(-np.inf, latest[:-1]))
    if kept.sum() < 2:
        raise LogError(f"the column {column.column!r} holds no time that increases.")
    return times[kept] - times[kept][0], kept


def stamps(table: LogTable, column: TimeColumn) -> np.ndarray:
    """The times that a column says, in s, on from where it begins anew."""
    if column.unit == "date":
        times = table.moments(column.column)
        of_day = np.fmax.reduce(times) < 0  # without a date, which are of the year 1900
        times = _unwrapped(times, DAY) if of_day else _without_months(times)
    elif column.unit == OPEN:
        raise LogError(f"the unit of the column {column.column!r} is not known.")
    else:
        times = table.numbers(column.column) * SECONDS[column.unit]
    if column.wraps_after:
        times = _unwrapped(times, column.wraps_after)
    return times


def _without_months(times: np.ndarray) -> np.ndarray:
    """Moments that go on at midnight where a day was taken for a month: 1/2/2026, 2/2/2026."""
    known = ~np.isnan(times)
    steps = np.diff(times[known])
    if not len(steps):
        return times
    beyond = steps % DAY
    months = (steps > 20 * DAY) & (beyond <= 10 * np.median(steps))
    times = times.copy()
    times[known] -= np.append(0.0, np.cumsum(np.where(months, steps - beyond, 0.0)))
    return times


def is_reversed(times: np.ndarray) -> bool:
    """Whether the newest row comes first."""
    steps = np.diff(times[~np.isnan(times)])
    return bool((steps < 0).sum() > 0.9 * max(1, int((steps != 0).sum())))


def _with_restarts(times: np.ndarray) -> np.ndarray:
    """Times that go on, much later, where they begin anew for good, as those of a new log do."""
    times, known = times.copy(), np.flatnonzero(~np.isnan(times))
    for row in known[1:][np.diff(times[known]) < 0]:
        before, after = float(np.nanmax(times[:row])), times[row:]
        if (after < before).sum() > FEWEST_ROWS:
            times[row:] += before + RESTART - times[row]
    return times


def _is_coarse(times: np.ndarray) -> bool:
    """Whether most rows have the time of the row before, as where fractions of seconds are cut."""
    steps = np.diff(times)
    return bool((steps == 0).mean() > COARSE and (steps > 0).sum() > 1)


def _spread(times: np.ndarray) -> np.ndarray:
    """Times with those that are repeated spread evenly up to the next one."""
    starts = np.flatnonzero(np.append(True, np.diff(times) != 0))
    if starts[-1] == 0:
        return times
    usual = np.median(np.diff(starts))
    # The first time may be of fewer rows than others, as the log begins amid it.
    rows = np.append(starts, starts[-1] + usual)
    rows[0] = min(0, rows[1] - usual)
    stamps = np.append(times[starts], times[starts[-1]] + np.median(np.diff(times[starts])))
    return np.interp(np.arange(len(times)), rows, stamps)


def _unwrapped(times: np.ndarray, period: float) -> np.ndarray:
    shown = ~np.isnan(times)
    times = times.copy()
    times[shown] += period * np.cumsum(np.append(0, np.diff(times[shown]) < -period / 2))
    return times


def _duty(values: np.ndarray, column: str, full: float) -> tuple[np.ndarray, int]:
    """Duty (K,), in [0, 1], held where it is missing; in how many rows it is."""
    missing = np.isnan(values)
    if missing.all():
        raise LogError(f"the column {column!r} holds no duty.")
    duty = held(values) / full
    if duty.max() > 1 + OVER:
        raise LogError(
            f"the column {column!r} reaches {np.nanmax(values):g}, beyond full duty, which is "
            f"{full:g} by the mapping; correct its full."
        )
    return np.clip(duty, 0.0, 1.0), int(missing.sum())


def _without(values: np.ndarray, missing: list[float]) -> np.ndarray:
    return np.where(np.isin(values, missing), np.nan, values)


def bend_of(table: LogTable, mapping: LogMapping) -> np.ndarray:
    """φ in each row (K,), rad; nan where it is missing, or beyond ±180°.

    Raises:
        LogError: if it leaves ±180° for longer than a sensor that fails now and then.
    """
    bend = mapping.bend
    if bend.line:
        angle = np.rad2deg(_directions(table, bend.line, mapping.missing)[0])
        if bend.base_line:
            links = np.rad2deg(_directions(table, bend.base_line, mapping.missing))
            turn = _wrapped(links[-1] - links[0])  # none if there is one link only
            angle = angle - links[-1] - 0.5 * turn
        angle = _wrapped(angle - bend.zero) * bend.scale
    else:
        values = _without(table.numbers(bend.column), mapping.missing)
        with np.errstate(over="ignore"):  # of a number that no sensor has, which is left out below
            angle = (values - bend.zero) * bend.scale
    beyond = np.abs(angle) > 180.0
    if (share := float(beyond.mean())) > RARELY:
        most = float(np.nanquantile(np.abs(angle), 0.99))
        raise LogError(
            f"the bend would be up to {most:.3g}°, and beyond ±180° in {share:.0%} of all rows; "
            "correct bend.scale or bend.zero."
        )
    angle = np.deg2rad(np.where(beyond, np.nan, angle))
    return bend_angle_from_tip_tangent(angle) if bend.measures == TIP_TANGENT else angle


def _directions(table: LogTable, line: list[str], missing: list[float]) -> np.ndarray:
    """Directions of the links between P points in a picture whose y points down (P - 1, K), rad.

    They are nan where a point is at 0, 0, or all have been where they are, to all digits, for
    some rows: so do trackers write that they have lost them.
    """
    columns = np.array([_without(table.numbers(column), missing) for column in line])
    x, y = columns[::2], columns[1::2]
    rows = np.arange(columns.shape[1])
    moved = np.append(True, (np.diff(columns, axis=1) != 0).any(axis=0))
    since = rows - np.maximum.accumulate(np.where(moved, rows, 0))
    lost = ((x == 0) & (y == 0)).any(axis=0) | (since >= REPEATED)
    return np.where(lost, np.nan, np.arctan2(-np.diff(y, axis=0), np.diff(x, axis=0)))


def _wrapped(degrees: np.ndarray) -> np.ndarray:
    return (degrees + 180.0) % 360.0 - 180.0


def _from_first_reading(duty: np.ndarray, bend: np.ndarray) -> int:
    """Rows before the first bend; none of them if a wire is heated there."""
    first = int(np.argmax(~np.isnan(bend)))
    return 0 if duty[:, :first].any() else first


def usual_rate(times: np.ndarray) -> float:
    """The rate of most rows, Hz, as a round number if it is near one.

    Rows that come in bursts have the rate of all of them together.
    """
    steps = np.diff(times)
    together = 1 / float(np.mean(steps[steps <= max(GAP, float(np.median(steps)))]))
    rate = 1 / float(np.median(steps))
    rate = min(rate if rate < BURSTS * together else together, FASTEST)
    near = round(rate) if rate > 3 else round(rate, 1)
    return float(near) if near and abs(rate / near - 1) < 0.03 else rate


def _cuts(times: np.ndarray, duty: np.ndarray) -> list[int]:
    """Where parts begin, and the end: a part ends before a gap in which the duty is not known."""
    steps, changes = np.diff(times), np.abs(np.diff(duty, axis=1)).max(axis=0)
    heated = np.maximum(duty[:, :-1], duty[:, 1:]).max(axis=0) > 0
    unknown = (steps > GAP) & (changes > CHANGE) | (steps > LONGEST_GAP) & heated
    unknown |= steps > LONGEST_PAUSE
    return [0, *(np.flatnonzero(unknown) + 1).tolist(), len(times)]


def _short_enough(cuts: list[int], times: np.ndarray, duty: np.ndarray, rate: float) -> list[int]:
    """Further cuts, such that no part has more samples than `MOST`, where wires are coldest."""
    found = [cuts[0]]
    heated = np.maximum.accumulate(np.where(duty.any(axis=0), times, times[0]))
    for cut in cuts[1:]:
        while (times[cut - 1] - times[found[-1]]) * rate > MOST:
            first, last = np.searchsorted(
                times, times[found[-1]] + np.array([0.5, 1]) * MOST / rate
            )
            off = times[first:last] - heated[first:last]
            found.append(int(first + np.flatnonzero(off >= 0.99 * off.max())[-1]))
        found.append(cut)
    return found


def resampled(
    times: np.ndarray, duty: np.ndarray, readings: np.ndarray, rate: float
) -> dict[str, Any]:
    """Signals of a `Recording` in even steps.

    A row's duty is in force until the next row. Each sample has the readings of the last row
    before it and their age, and the mean duty since the sample before, so that the heat is
    that of the log; its applied duty is the mean between the rows.

    Args:
        times: times of rows (K,), s from the first, increasing.
        duty: (W, K).
        readings: V of W wires, °C, and φ, rad (W + 1, K).
        rate: Hz.
    """
    grid = np.arange(int(np.floor(times[-1] * rate + 1e-9)) + 1) / rate
    row = np.searchsorted(times, grid + 1e-9, side="right") - 1
    age = np.maximum(grid - times[row], 0.0)
    periods, seconds = STALE
    held = np.where(age <= max(periods / rate, seconds), readings[:, row], np.nan)

    def means(ends: np.ndarray) -> np.ndarray:
        """Mean duty between times, and before the first of them that at the first row."""
        later = doses(duty[:, :-1], times, ends) / np.diff(ends)
        return np.clip(np.column_stack([duty[:, 0], later]), 0.0, 1.0)

    shown, index = np.unique(row, return_inverse=True)
    return {
        "time": grid,
        "duty": means(grid),
        "measured_temperature": held[:-1],
        "bend_angle": held[-1:],
        "applied_duty": means(times[shown])[:, index],
        "sample_age": age,
    }
