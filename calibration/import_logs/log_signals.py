"""Read a log by its mapping: units, gaps, and recordings in even steps."""

import copy
import dataclasses
import itertools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calibration.import_logs import cells
from calibration.import_logs.clock import (
    GAP,
    aligned_offset,
    is_coarse,
    is_reversed,
    stamps,
    times_of,
    usual_rate,
)
from calibration.import_logs.evidence import forward_fill
from calibration.import_logs.mapping import (
    BEND_ANGLE,
    CELSIUS,
    CHORD,
    DATE,
    FRAMES,
    TIP_TANGENT,
    JoinedLog,
    LogMapping,
)
from calibration.import_logs.table import LogError, LogTable, read_table, unique
from limb_systems.bend_sensor import (
    ChordSensor,
    TipTangentSensor,
    bend_angle_from_tip_tangent,
    roll_bends,
)
from limb_systems.errors import reraise_as
from limb_systems.files.signal_table import doses
from limb_systems.limb_parameters import LimbParameters

SAG = "sag"  # beginning of the names of logs of the sag
EARTH = 9.81  # m/s²
CHANGE = 0.05  # of duty, that counts as another
LONGEST_GAP = 30.0  # s, beyond which duty may have been anything at all, unless it was off
LONGEST_PAUSE = 600.0  # s, beyond which a recording ends
SHORTEST = 10.0  # s of a part of a log that is worth keeping
STALE_PERIODS = 2.6  # periods or ...
STALE_SECONDS = 0.5  # ... seconds, the longer of which a reading may be held
STILL_ROWS = 5  # rows in which points of a picture are exactly where they were, and were not seen
OVER = 0.05  # by which duty may exceed full duty, and is cut off
READABLE = (-60.0, 600.0)  # °C, of readings that a thermocouple can have
RARELY = 0.05  # share of rows in which a sensor may fail
MOST = 1_000_000  # samples of a recording; a file of more may be too large to be read again
EPOCH = 1e8  # s, from which on times are since 1970, so that two files have one clock


def read_log(
    path: str | Path,
    mapping: LogMapping,
    parameters: LimbParameters | None = None,
    table: LogTable | None = None,
) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the parts of a log, as arguments of `Recording`, and what was lost, in sentences.

    Args:
        table: the log's rows; they are read if None.
        parameters: the limb's description; the nominal limb, with the wires of the mapping, if
            None.

    Raises:
        LogError: if the log is not as the mapping says.
    """
    if mapping.open_fields:
        raise LogError(f"{path}: the mapping leaves open {', '.join(mapping.open_fields)}.")
    table = table or read_table(path, mapping.delimiter, mapping.decimal, mapping.names_line)
    with reraise_as(LogError, f"{path}: "):
        if is_reversed(stamps(table, mapping.time, mapping.rate)):
            table = table.rows(slice(None, None, -1))
        limb = described(mapping, parameters)
        return _parts(table, mapping, limb, Path(path))


def described(mapping: LogMapping, parameters: LimbParameters | None) -> LimbParameters:
    """Return the limb that a log is of, with the bend sensor that the mapping says.

    Raises:
        LogError: if the mapping has wires or bends that the description lacks.
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
                f"{', '.join(limb.wire_names)}; describe the limb with -l, or correct the name."
            )
    axes = 2 if mapping.bend.e2 else 1
    if axes != segment.axes:
        has = "one bend" if axes == 1 else "bends towards e2 and e3"
        raise LogError(
            f"The mapping has {has}, but the limb bends about {segment.axes} axes; correct bend, "
            "or describe the limb with -l."
        )
    if parameters is None:
        segment.wires = [wire for wire in segment.wires if wire.name in names]
    if mapping.bend.measures != BEND_ANGLE:
        kind = ChordSensor if mapping.bend.measures == CHORD else TipTangentSensor
        if not isinstance(segment.bend_sensor, kind):
            segment.bend_sensor = kind()
    return limb


class _Signals(NamedTuple):
    """What a log shows in its rows.

    - ``times``: (K,), s.
    - ``duty``: (W, K), in [0, 1].
    - ``readings``: V of W wires, °C, and φ of F bends, rad (W + F, K).
    - ``rate``: usual rate of the rows, Hz.
    """

    times: np.ndarray
    duty: np.ndarray
    readings: np.ndarray
    rate: float


def _parts(
    table: LogTable, mapping: LogMapping, limb: LimbParameters, path: Path
) -> tuple[list[dict[str, Any]], list[str]]:
    remarks: list[str] = []
    signals = _signals(table, mapping, limb, path, remarks)
    times = signals.times
    measured = ~np.isnan(signals.readings).all(axis=1)
    if count := int(np.isnan(signals.readings[measured]).any(axis=0).sum()):
        remarks.append(f"{count} of {_rows(len(times))} lack a reading, which stays empty.")
    # Cut where nobody knows what the duty was, and say so.
    cuts = _cuts(times, signals.duty)
    gaps = np.diff(times)
    if len(cuts) > 2:
        ends = ", ".join(f"{times[cut - 1]:.0f} s" for cut in cuts[1:-1])
        remarks.append(f"Cut after {ends}: what happened in the gap there is not known.")
    gaps[[cut - 1 for cut in cuts[1:-1]]] = 0.0  # they are cut, and said above
    if long := int((gaps > GAP).sum()):
        said = f"{long} gap{'s' * (long != 1)} of more than {GAP:g} s"
        remarks.append(f"{said}, the longest of {gaps.max():.1f} s.")
    num_whole = len(cuts)
    cuts = _short_enough(cuts, times, signals.duty, signals.rate)
    if len(cuts) > num_whole:
        remarks.append(
            f"Cut where wires were off the longest, so that no part has more than {MOST} samples."
        )
    # Resample each part.
    parts: list[dict[str, Any]] = []
    for number, (start, end) in enumerate(itertools.pairwise(cuts), 1):
        if end - start < 2 or (len(cuts) > 2 and times[end - 1] - times[start] < SHORTEST):
            said = f"{_rows(end - start)} from {times[start]:.0f} s on"
            remarks.append(f"{said} are too few to keep.")
            continue
        part = slice(start, end)
        even = resampled(
            times[part] - times[start],
            signals.duty[:, part],
            signals.readings[:, part],
            signals.rate,
        )
        where = f", part {number}" if len(cuts) > 2 else ""
        about = {"parameters": limb, "source": f"log {path.name}{where}"}
        parts.append({**even, **about, "sample_rate": signals.rate})
    if not parts:
        raise LogError(f"no part of {SHORTEST:g} s or more has rows without a gap.")
    if path.name.startswith(SAG) and not signals.duty.any() and not mapping.bend.e2:
        bend = np.nanmedian(signals.readings[-1])
        limb.gravity = [0.0, EARTH * (np.sign(bend) or -1.0), 0.0]
        remarks.append("By its name, gravity bends the limb here, to the side of its bend.")
    return parts, remarks


def _signals(
    table: LogTable, mapping: LogMapping, limb: LimbParameters, path: Path, remarks: list[str]
) -> _Signals:
    """Return what the rows show.

    Args:
        remarks: gets what was lost, in sentences.
    """
    if table.odd_rows:
        remarks.append(f"{_rows(table.odd_rows)} with another number of cells left out.")
    times, kept = times_of(table, mapping.time, mapping.rate)
    if is_coarse(stamps(table, mapping.time, mapping.rate)):
        remarks.append("The clock is coarse; its times are spread evenly between its steps.")
    if lost := int(len(kept) - kept.sum()):
        said = f"{_rows(lost)} left out"
        remarks.append(f"{said}, whose time is missing, repeated or earlier than before.")
    table = table if kept.all() else table.rows(kept)
    is_rate_of_rows = not mapping.time.column or mapping.time.unit == FRAMES
    rate = 0.0 if is_rate_of_rows else mapping.rate
    rate = rate or usual_rate(times)
    if mapping.join:
        times, table, other_rate = _joined(times, table, mapping, path)
        rate = max(rate, other_rate)
    bends = bends_of(table, mapping)
    num_wires = len(limb.wires)
    duty = np.zeros((num_wires, len(times)))
    readings = np.full((num_wires + len(bends), len(times)), np.nan)
    readings[num_wires:] = bends
    for wire in mapping.wires:
        index = limb.wire_names.index(wire.name)
        if wire.duty:
            duty[index], unknown = _duty(table, wire.duty, wire.sign, mapping)
            if unknown and not mapping.join:
                remarks.append(f"The {wire.name} wire's duty is missing in {_rows(unknown)}; held.")
        if wire.temperature:
            readings[index] = _temperature(table, wire.temperature, wire.unit, mapping)
        elif wire.duty:
            remarks.append(f"The {wire.name} wire has no thermocouple in this log.")
    # Begin where the bend is seen, unless a wire is heated before.
    is_bent = ~np.isnan(readings[num_wires:]).any(axis=0)
    first = int(np.argmax(is_bent))
    first = 0 if duty[:, :first].any() else first
    if first:
        said = f"{_rows(first)} without a bend left out at the beginning"
        remarks.append(f"{said}, without heat.")
    if len(times) - first < 2 or not is_bent.any():
        raise LogError("no row has a bend; correct the mapping's bend.")
    times = times[first:]
    for row in readings:
        row[first:] = _between_rows(times, row[first:], bool(mapping.join))
    return _Signals(times, duty[:, first:], readings[:, first:], rate)


def _joined(
    times: np.ndarray, table: LogTable, mapping: LogMapping, path: Path
) -> tuple[np.ndarray, LogTable, float]:
    """Return times and rows of a log and a second file together, and the second's usual rate."""
    join = mapping.join
    assert join
    other = read_table(path.parent / join.file)
    other_times, kept = times_of(other, join.time, join.rate)
    other = other.rows(kept)
    offset = _offset(times, table, other_times, other, mapping, join)
    # Rows of both files in the order of time; a cell is empty where its file has no row.
    order = np.argsort(np.concatenate([times, offset + other_times]), kind="stable")
    empty = np.full(len(times), np.nan)
    other_empty = np.full(len(other_times), np.nan)
    values = [np.concatenate([column, other_empty])[order] for column in table.values]
    values += [np.concatenate([empty, column])[order] for column in other.values]
    together = np.concatenate([times, offset + other_times])[order]
    names = unique([*table.names, *other.names])
    both = dataclasses.replace(
        table, names=names, units=[*table.units, *other.units], values=values, dates={}
    )
    # The recording is of the time in which there are both.
    start = max(0.0, offset)
    end = min(times[-1], offset + other_times[-1])
    shared = (together >= start) & (together <= end) & np.append(True, np.diff(together) > 0)
    if shared.sum() < 2:
        raise LogError(f"{join.file} and the log have no time in common; correct join.offset.")
    return together[shared] - start, both.rows(shared), usual_rate(other_times)


def _offset(
    times: np.ndarray,
    table: LogTable,
    other_times: np.ndarray,
    other: LogTable,
    mapping: LogMapping,
    join: JoinedLog,
) -> float:
    """Return the time of a second file's first row, s from the log's first row."""
    if join.offset is not None:
        return join.offset
    if join.align:
        own = table.numbers(join.align[0])
        return aligned_offset(times, own, other_times, other.numbers(join.align[1]))
    first = float(stamps(table, mapping.time, mapping.rate)[0])
    other_first = float(stamps(other, join.time, join.rate)[0])
    on_one_clock = mapping.time.unit == join.time.unit == DATE and (first < 0) == (other_first < 0)
    if on_one_clock or min(first, other_first) > EPOCH:
        return other_first - first
    raise LogError(
        f"{join.file} and the log have clocks of their own; give join.offset, or join.align with a "
        "column of each that show the same."
    )


def _between_rows(times: np.ndarray, values: np.ndarray, joined: bool) -> np.ndarray:
    """Return readings of a sensor that is slower than the rows, with lines between them."""
    shown = ~np.isnan(values)
    own = np.diff(times[shown])
    if len(own) < 2:
        return values
    usual = np.median(own)
    if usual < 1.5 * np.median(np.diff(times)) and not joined:
        return values
    near = np.interp(times, times[shown][1:], own, left=own[0])
    there = np.interp(times, times[shown], values[shown], left=np.nan, right=np.nan)
    return np.where(near <= STALE_PERIODS * usual, there, np.nan)


def _rows(count: int) -> str:
    return f"{count} row{'s' * (count != 1)}"


def _duty(table: LogTable, column: str, sign: float, mapping: LogMapping) -> tuple[np.ndarray, int]:
    """Return duty (K,), in [0, 1], held where it is missing; and in how many rows it is."""
    values = _without(table.numbers(column), mapping.missing)
    missing = np.isnan(values)
    if missing.all():
        raise LogError(f"the column {column!r} holds no duty.")
    duty = sign * forward_fill(values) / mapping.full
    if mapping.inverted:
        duty = 1.0 - duty
    most = mapping.full * (1 + OVER)
    if (values[~missing] * sign).max() > most:
        raise LogError(
            f"the column {column!r} reaches {np.nanmax(values):g}, beyond full duty, which is "
            f"{mapping.full:g} by the mapping; correct its full."
        )
    signs = {wire.sign for wire in mapping.wires if wire.duty == column}
    if duty.min() < -OVER and len(signs) == 1:
        raise LogError(
            f"the column {column!r} is negative at times, which heats no wire of the mapping; give "
            "the wire that it heats then, with the same duty and sign: -1."
        )
    return np.clip(duty, 0.0, 1.0), int(missing.sum())


def _temperature(table: LogTable, column: str, unit: str, mapping: LogMapping) -> np.ndarray:
    """Return a thermocouple's readings (K,), °C; nan where it has none that can be."""
    factor, offset = CELSIUS[unit]
    values = factor * _without(table.numbers(column), mapping.missing) + offset
    unreadable = (values < READABLE[0]) | (values > READABLE[1])
    if unreadable.mean() > 0.5:
        raise LogError(
            f"the column {column!r} is beyond {READABLE[0]:g} to {READABLE[1]:g} °C in most rows; "
            "correct its unit."
        )
    values[unreadable] = np.nan
    return values


def _without(values: np.ndarray, missing: list[str]) -> np.ndarray:
    """Return numbers with nan for those that stand for no reading; words are nan already."""
    return np.where(np.isin(values, [cells.number(text) for text in missing]), np.nan, values)


def bends_of(table: LogTable, mapping: LogMapping) -> np.ndarray:
    """Return φ of each bend in each row (F, K), rad; nan where it is missing, or beyond ±180°.

    Raises:
        LogError: if it leaves ±180° for longer than a sensor that fails now and then.
    """
    bend = mapping.bend
    if bend.line:
        angles = _angle_of_line(table, mapping)[None]
    else:
        second_scale = bend.scale_e3 or bend.scale
        axes = [(bend.column, bend.zero, bend.scale)]
        if bend.e2:
            axes = [(bend.e2, bend.zero, bend.scale), (bend.e3, bend.zero_e3, second_scale)]
        rows = []
        with np.errstate(over="ignore"):  # of a number that no sensor has, which is left out below
            for column, zero, scale in axes:
                values = _without(table.numbers(column), mapping.missing)
                rows.append((values - zero) * scale)
        angles = np.array(rows)
    if bend.seen:
        angles[:, table.numbers(bend.seen) == 0] = np.nan
    beyond = (np.abs(angles) > 180.0).any(axis=0)
    if (share := float(beyond.mean())) > RARELY:
        most = float(np.nanquantile(np.abs(angles), 0.99))
        raise LogError(
            f"the bend would be up to {most:.3g}°, and beyond ±180° in {share:.0%} of all rows; "
            "correct bend.scale or bend.zero."
        )
    angles[:, beyond] = np.nan
    bends = np.deg2rad(angles)
    if bend.measures == TIP_TANGENT:
        bends = bend_angle_from_tip_tangent(bends)
    return roll_bends(bends, -np.deg2rad(bend.roll))


def _angle_of_line(table: LogTable, mapping: LogMapping) -> np.ndarray:
    """Return the angle of the line between two points in a picture (K,), °."""
    bend = mapping.bend
    angle = np.rad2deg(_directions(table, bend.line, mapping.missing)[0])
    if bend.base_line:
        links = np.rad2deg(_directions(table, bend.base_line, mapping.missing))
        turn = _wrapped(links[-1] - links[0])  # none if there is one link only
        angle = angle - links[-1] - 0.5 * turn
    return _wrapped(angle - bend.zero) * bend.scale


def _directions(table: LogTable, line: list[str], missing: list[str]) -> np.ndarray:
    """Return directions of the links between P points in a picture (P - 1, K), rad.

    In the picture y points down. Directions are nan where a point is at 0, 0, or all have been
    where they are, to all digits, for some rows: so do trackers write that they have lost them.
    """
    columns = np.array([_without(table.numbers(column), missing) for column in line])
    x = columns[::2]
    y = columns[1::2]
    rows = np.arange(columns.shape[1])
    moved = np.append(True, (np.diff(columns, axis=1) != 0).any(axis=0))
    since = rows - np.maximum.accumulate(np.where(moved, rows, 0))
    lost = ((x == 0) & (y == 0)).any(axis=0) | (since >= STILL_ROWS)
    return np.where(lost, np.nan, np.arctan2(-np.diff(y, axis=0), np.diff(x, axis=0)))


def _wrapped(degrees: np.ndarray) -> np.ndarray:
    return (degrees + 180.0) % 360.0 - 180.0


def _cuts(times: np.ndarray, duty: np.ndarray) -> list[int]:
    """Return where parts begin, and the end: a part ends where the duty is not known."""
    steps = np.diff(times)
    long = np.flatnonzero(steps > GAP)
    before = duty[:, long]
    after = duty[:, long + 1]
    changed = np.abs(after - before).max(axis=0) > CHANGE
    heated = np.maximum(before, after).max(axis=0) > 0
    unknown = changed | ((steps[long] > LONGEST_GAP) & heated) | (steps[long] > LONGEST_PAUSE)
    return [0, *(long[unknown] + 1).tolist(), len(times)]


def _short_enough(cuts: list[int], times: np.ndarray, duty: np.ndarray, rate: float) -> list[int]:
    """Return further cuts, where wires are coldest: no part has more than `MOST` samples."""
    found = [cuts[0]]
    heated = np.maximum.accumulate(np.where(duty.any(axis=0), times, times[0]))
    for cut in cuts[1:]:
        while (times[cut - 1] - times[found[-1]]) * rate > MOST:
            middle = times[found[-1]] + np.array([0.5, 1]) * MOST / rate
            first, last = np.searchsorted(times, middle)
            off = times[first:last] - heated[first:last]
            found.append(int(first + np.flatnonzero(off >= 0.99 * off.max())[-1]))
        found.append(cut)
    return found


def resampled(
    times: np.ndarray, duty: np.ndarray, readings: np.ndarray, rate: float
) -> dict[str, Any]:
    """Return the signals of a `Recording` in even steps.

    A row's duty is in force until the next row. Each sample has the readings of the last row
    before it and their age, and the mean duty since the sample before, so that the heat is
    that of the log; its applied duty is the mean between the rows.

    Args:
        times: times of rows (K,), s from the first, increasing.
        duty: (W, K).
        readings: V of W wires, °C, and φ of F bends, rad (W + F, K).
        rate: Hz.
    """
    grid = np.arange(int(np.floor(times[-1] * rate + 1e-6)) + 1) / rate
    row = np.searchsorted(times, grid + 1e-6, side="right") - 1
    age = np.maximum(grid - times[row], 0.0)
    fresh = age <= max(STALE_PERIODS / rate, STALE_SECONDS)
    readings = np.where(fresh, readings[:, row], np.nan)

    def means(ends: np.ndarray) -> np.ndarray:
        """Return mean duty between times, and before the first of them the first row's."""
        later = doses(duty[:, :-1], times, ends) / np.diff(ends)
        return np.clip(np.column_stack([duty[:, 0], later]), 0.0, 1.0)

    used, index = np.unique(row, return_inverse=True)
    return {
        "time": grid,
        "duty": means(grid),
        "measured_temperature": readings[: len(duty)],
        "bend_angle": readings[len(duty) :],
        "applied_duty": means(times[used])[:, index],
        "sample_age": age,
    }
