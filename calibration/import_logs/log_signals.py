"""Read a log by its mapping: units, gaps, and recordings in even steps."""

import copy
import dataclasses
import itertools
from pathlib import Path

import numpy as np

from calibration.import_logs import clock
from calibration.import_logs.evidence import forward_fill
from calibration.import_logs.mapping import MEASURES, TEMPERATURE_UNITS, TIP_TANGENT, LogMapping
from calibration.import_logs.points import link_directions
from calibration.import_logs.table import LogError, LogTable, number, read_table, unique_names
from limb_systems import bend_sensor
from limb_systems.errors import reraise_as
from limb_systems.files.recording import Recording
from limb_systems.files.signal_table import doses
from limb_systems.kinematics import wrap_angle
from limb_systems.limb_parameters import LimbParameters

SAG_PREFIX = "sag"  # beginning of the names of logs of the sag
GRAVITY = 9.81  # m/s²
MIN_DUTY_CHANGE = 0.05  # of duty, that counts as another
MAX_HEATED_GAP = 30.0  # s, beyond which duty may have been anything at all, unless it was off
MAX_PAUSE = 600.0  # s, beyond which a recording ends
MIN_PART_DURATION = 10.0  # s of a part of a log that is worth keeping
STALE_PERIODS = 2.6  # periods or ...
STALE_SECONDS = 0.5  # ... seconds, the longer of which a reading may be held
MAX_EXCESS_DUTY = 0.05  # by which duty may exceed full duty, and is cut off
READABLE_RANGE = (-60.0, 600.0)  # °C, of readings that a thermocouple can have
MAX_FAILING_SHARE = 0.05  # share of rows in which a sensor may fail
MAX_SAMPLES = 1_000_000  # samples of a recording; a file of more may be too large to be read again
MIN_EPOCH_TIME = 1e8  # s, from which on times are since 1970, so that two files have one clock


def read_log(
    path: str | Path,
    mapping: LogMapping,
    parameters: LimbParameters | None = None,
    tables: list[LogTable] | None = None,
) -> tuple[list[Recording], list[str]]:
    """Return the recordings of a log, and remarks on what is left out or assumed, in sentences.

    Args:
        parameters: the limb's description; the nominal limb, with the wires of the mapping, if
            None.
        tables: a list with the log's table, which is taken out of the list so that its memory is
            freed; the table is read from the file if None.

    Raises:
        LogError: if the log is not as the mapping says.
    """
    path = Path(path)
    if mapping.open_fields:
        raise LogError(f"{path}: the mapping leaves open {', '.join(mapping.open_fields)}.")
    table = tables.pop() if tables else read_table(path)
    with reraise_as(LogError, f"{path}: "):
        limb = described_limb(mapping, parameters)
        signals = _Signals(table.only(mapping.columns), mapping, limb, path)
        del table
        # Let gravity act if the name of the file says that it bends the limb.
        if path.name.startswith(SAG_PREFIX) and not signals.duty.any() and not mapping.bend.e2:
            side = np.sign(np.nanmedian(signals.readings[-1])) or -1.0
            limb.gravity = [0.0, GRAVITY * side, 0.0]
            text = "By its name, gravity bends the limb here, to the side of its bend."
            signals.remarks.append(text)
        recordings = signals.recordings(limb)
    # Say which part of the log each recording is of.
    if len(recordings) > 1:
        for number, recording in enumerate(recordings, 1):
            recording.source += f", part {number}"
    return recordings, signals.remarks


def described_limb(mapping: LogMapping, parameters: LimbParameters | None) -> LimbParameters:
    """Return a log's limb and bend sensor; LogError if it lacks wires or bends of the mapping."""
    limb = copy.deepcopy(parameters or LimbParameters())
    if len(limb.segments) != 1:
        raise LogError(f"The limb has {len(limb.segments)} segments; read a log for each of them.")
    (segment,) = limb.segments
    # The mapping must have wires and bends of this limb.
    names = [wire.name for wire in mapping.wires]
    if unknown := set(names) - set(limb.wire_names):
        raise LogError(
            f"The mapping has a wire {min(unknown)!r}, but the limb's wires are "
            f"{', '.join(limb.wire_names)}; describe the limb with -l, or correct the name."
        )
    if (2 if mapping.bend.e2 else 1) != segment.axes:
        has = "bends towards e2 and e3" if mapping.bend.e2 else "one bend"
        raise LogError(
            f"The mapping has {has}, but the limb bends about {segment.axes} axes; correct bend, "
            "or describe the limb with -l."
        )
    # Keep the wires and the bend sensor of the log.
    if parameters is None:
        segment.wires = [wire for wire in segment.wires if wire.name in names]
    kind = MEASURES[mapping.bend.measures]
    if kind and not isinstance(segment.bend_sensor, kind):
        segment.bend_sensor = kind()
    return limb


class _Signals:
    """The signals of a log, row by row.

    - ``times``: times of K rows (K,), s from the first row.
    - ``duty``: duty of W wires (W, K), in [0, 1].
    - ``readings``: temperatures V of W wires, °C, and angles φ of F bends, rad (W + F, K).
    - ``rate``: usual rate of the rows, Hz.
    - ``remarks``: what was lost, in sentences.
    """

    def __init__(self, table: LogTable, mapping: LogMapping, limb: LimbParameters, path: Path):
        self.source = f"log {path.name}"
        self.remarks: list[str] = []
        if table.odd_rows:
            self.remarks.append(f"{_n_rows(table.odd_rows)} with another number of cells left out.")
        # Keep rows whose time increases.
        times, rows, is_coarse = clock.times_of(table, mapping.time, mapping.rate)
        if is_coarse:
            self.remarks.append("The clock is coarse; its times are spread evenly.")
        if lost := table.values.shape[1] - len(times):
            why = "whose time is missing, repeated or earlier than before"
            self.remarks.append(f"{_n_rows(lost)} left out, {why}.")
        table = table.rows(rows)
        given_rate = 0.0 if mapping.has_rows_at_rate else mapping.rate
        self.rate = given_rate or clock.usual_rate(times)
        if mapping.join:
            times, table = _joined(times, table, mapping, path)
        # Turn columns into signals.
        bends = bends_of(table, mapping)
        num_wires = len(limb.wires)
        self.duty = np.zeros((num_wires, len(times)))
        self.readings = np.vstack([np.full(self.duty.shape, np.nan), bends])
        for wire in mapping.wires:
            index = limb.wire_names.index(wire.name)
            if wire.duty:
                self.duty[index], count = _read_duty(table, wire.duty, wire.sign, mapping)
                if count:
                    text = f"The {wire.name} wire's duty is missing in {_n_rows(count)}; held."
                    self.remarks.append(text)
            if wire.temperature:
                self.readings[index] = _temperatures(table, wire.temperature, wire.unit, mapping)
            elif wire.duty:
                self.remarks.append(f"The mapping has no temperature of the {wire.name} wire.")
        # Begin where the bend is seen, unless a wire is heated before.
        is_bent = ~np.isnan(bends).any(axis=0)
        first = int(np.argmax(is_bent))
        first = 0 if self.duty[:, :first].any() else first
        if first:
            self.remarks.append(f"{_n_rows(first)} without bend or heat left out at the beginning.")
        if len(times) - first < 2 or not is_bent.any():
            raise LogError("no row has a bend; correct the mapping's bend.")
        self.times = times[first:] - times[0]
        self.duty = self.duty[:, first:]
        self.readings = self.readings[:, first:]
        for row in self.readings:
            row[:] = _interpolate_slow_sensor(self.times, row)

    def recordings(self, limb: LimbParameters) -> list[Recording]:
        """Return a recording for each part whose duty is known; LogError if all are too short."""
        times = self.times
        is_measured = ~np.isnan(self.readings).all(axis=1)
        if count := int(np.isnan(self.readings[is_measured]).any(axis=0).sum()):
            text = f"{count} of {_n_rows(len(times))} lack a reading, which stays empty."
            self.remarks.append(text)
        cuts = self._cuts()
        # Resample each part that is long enough.
        recordings = []
        for start, end in itertools.pairwise(cuts):
            is_short = len(cuts) > 2 and times[end - 1] - times[start] < MIN_PART_DURATION
            if end - start < 2 or is_short:
                where = f"{_n_rows(end - start)} from {times[start]:.0f} s on"
                self.remarks.append(f"{where} are too few to keep.")
                continue
            recordings.append(self._resampled(slice(start, end), limb))
        if not recordings:
            raise LogError(f"no part of {MIN_PART_DURATION:g} s or more has rows without a gap.")
        return recordings

    def _cuts(self) -> list[int]:
        """Return the first row of each part, and the end.

        A part ends where the duty is unknown, or after `MAX_SAMPLES` samples.
        """
        # The duty is unknown in gaps in which it changed or was on for long.
        gaps = np.diff(self.times)
        long = np.flatnonzero(gaps > clock.MIN_GAP)
        before = self.duty[:, long]
        after = self.duty[:, long + 1]
        is_unknown = np.abs(after - before).max(axis=0) > MIN_DUTY_CHANGE
        is_unknown |= (gaps[long] > MAX_HEATED_GAP) & (np.maximum(before, after).max(axis=0) > 0)
        is_unknown |= gaps[long] > MAX_PAUSE
        cut = long[is_unknown]
        if len(cut):
            ends = ", ".join(f"{time:.0f} s" for time in self.times[cut])
            self.remarks.append(f"Cut after {ends}: what happened in the gap there is not known.")
        if len(kept_gaps := gaps[long[~is_unknown]]):
            text = f"{len(kept_gaps)} gaps of over {clock.MIN_GAP:g} s, the longest of"
            self.remarks.append(f"{text} {kept_gaps.max():.1f} s.")
        # Cut parts that are too long.
        starts = [0]
        for end in [*(cut + 1).tolist(), len(self.times)]:
            while (self.times[end - 1] - self.times[starts[-1]]) * self.rate > MAX_SAMPLES:
                last_time = self.times[starts[-1]] + MAX_SAMPLES / self.rate
                starts.append(int(np.searchsorted(self.times, last_time)))
            starts.append(end)
        if len(starts) > len(cut) + 2:
            self.remarks.append(
                f"The log is cut so that no part has more than {MAX_SAMPLES} samples."
            )
        return starts

    def _resampled(self, rows: slice, limb: LimbParameters) -> Recording:
        """Return a recording of some rows, in even steps.

        A row's duty is in force until the next row. Each sample has the readings of the last row
        before it and their age, and the mean duty since the sample before, which keeps the heat of
        the log; its applied duty is the mean between the rows.
        """
        times = self.times[rows] - self.times[rows.start]
        duty = self.duty[:, rows]
        # Each sample has the last row before it, unless the row is stale.
        grid = np.arange(int(np.floor(times[-1] * self.rate + 1e-6)) + 1) / self.rate
        row = np.searchsorted(times, grid + 1e-6, side="right") - 1
        age = np.maximum(grid - times[row], 0.0)
        is_fresh = age <= max(STALE_PERIODS / self.rate, STALE_SECONDS)
        readings = np.where(is_fresh, self.readings[:, rows][:, row], np.nan)
        # The applied duty is the mean from one used row to the next.
        used_rows, index = np.unique(row, return_inverse=True)
        return Recording(
            time=grid,
            duty=_mean_duty(times, duty, grid),
            measured_temperature=readings[: len(duty)],
            bend_angle=readings[len(duty) :],
            applied_duty=_mean_duty(times, duty, times[used_rows])[:, index],
            sample_age=age,
            sample_rate=self.rate,
            parameters=limb,
            source=self.source,
        )


def _mean_duty(times: np.ndarray, duty: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return mean duty between some ends, and before the first of them the first row's."""
    later_means = doses(duty[:, :-1], times, ends) / np.diff(ends)
    return np.clip(np.column_stack([duty[:, 0], later_means]), 0.0, 1.0)


def _n_rows(count: int) -> str:
    return f"{count} row{'s' * (count != 1)}"


def _joined(
    times: np.ndarray, table: LogTable, mapping: LogMapping, path: Path
) -> tuple[np.ndarray, LogTable]:
    """Return the rows of a log in which a second file has rows, with the second file's columns.

    Each row has the second file's last row before it.
    """
    join = mapping.join
    assert join
    second = read_table(path.parent / join.file)
    second_times, rows, _ = clock.times_of(second, join.time, join.rate)
    second = second.rows(rows)
    # Set the clock of the second file by the log's.
    if join.offset is not None:
        offset = times[0] + join.offset - second_times[0]
    elif join.align:
        signal = table.numbers(join.align[0])
        second_signal = second.numbers(join.align[1])
        since = times - times[0]
        offset = clock.aligned_offset(since, signal, second_times - second_times[0], second_signal)
        offset += times[0] - second_times[0]
    elif mapping.time.unit == join.time.unit == clock.TIME_OF_DAY:
        offset = clock.DAY * round((times[0] - second_times[0]) / clock.DAY)
    elif min(times[0], second_times[0]) > MIN_EPOCH_TIME:
        offset = 0.0
    else:
        raise LogError(
            f"{join.file} and the log have clocks of their own; give join.offset, or join.align "
            "with a column of each that show the same."
        )
    # Keep rows in which the second file has a row, too.
    latest = np.searchsorted(second_times + offset, times + 1e-6, side="right") - 1
    is_shared = (latest >= 0) & (times - offset - second_times[latest] <= clock.MIN_GAP)
    if is_shared.sum() < 2:
        raise LogError(f"{join.file} and the log have no time in common; correct join.offset.")
    # Each row has the last row of the second file before it.
    names = unique_names([*table.names, *second.names])
    values = np.vstack([table.values, second.values[:, latest]])
    table = dataclasses.replace(table, names=names, values=values)
    return times[is_shared], table.rows(is_shared)


def _interpolate_slow_sensor(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return readings of a sensor that is slower than the rows, with lines between them."""
    is_present = ~np.isnan(values)
    sensor_periods = np.diff(times[is_present])
    if len(sensor_periods) < 2 or np.median(sensor_periods) < 1.5 * np.median(np.diff(times)):
        return values
    period = np.interp(times, times[is_present][1:], sensor_periods, left=sensor_periods[0])
    filled = np.interp(times, times[is_present], values[is_present], left=np.nan, right=np.nan)
    return np.where(period <= STALE_PERIODS * np.median(sensor_periods), filled, np.nan)


def _read_duty(
    table: LogTable, column: str, sign: float, mapping: LogMapping
) -> tuple[np.ndarray, int]:
    """Return duty in K rows (K,), in [0, 1], and the number of rows that have the last one."""
    values = sign * _numbers(table, column, mapping)
    is_missing = np.isnan(values)
    if is_missing.all():
        raise LogError(f"the column {column!r} holds no duty.")
    duty = forward_fill(values) / mapping.full
    # Refuse numbers that contradict the mapping.
    if duty.max() > 1 + MAX_EXCESS_DUTY:
        raise LogError(
            f"the column {column!r} reaches {np.nanmax(values):g}, beyond full duty, which is "
            f"{mapping.full:g} by the mapping; correct its full."
        )
    duty = 1.0 - duty if mapping.inverted else duty
    signs = {wire.sign for wire in mapping.wires if wire.duty == column}
    if duty.min() < -MAX_EXCESS_DUTY and len(signs) == 1:
        raise LogError(
            f"the column {column!r} is negative at times, which heats no wire of the mapping; give "
            "the wire that it heats then, with the same duty and sign: -1."
        )
    return np.clip(duty, 0.0, 1.0), int(is_missing.sum())


def _temperatures(table: LogTable, column: str, unit: str, mapping: LogMapping) -> np.ndarray:
    """Return a thermocouple's readings (K,), °C; nan where it has none that can be."""
    factor, offset = TEMPERATURE_UNITS[unit]
    numbers = _numbers(table, column, mapping)
    numbers[numbers == 0] = np.nan  # sensors that fail read 0
    values = factor * numbers + offset
    is_unreadable = (values < READABLE_RANGE[0]) | (values > READABLE_RANGE[1])
    if is_unreadable.mean() > 0.5:
        raise LogError(
            f"the column {column!r} is beyond {READABLE_RANGE[0]:g} to {READABLE_RANGE[1]:g} °C in "
            "most rows; correct its unit."
        )
    values[is_unreadable] = np.nan
    return values


def _numbers(table: LogTable, column: str, mapping: LogMapping) -> np.ndarray:
    """Return a column (K,) with nan for numbers that stand for no reading; words are nan."""
    missing = list(map(number, mapping.missing))
    values = table.numbers(column)
    return np.where(np.isin(values, missing), np.nan, values)


def bends_of(table: LogTable, mapping: LogMapping) -> np.ndarray:
    """Return φ of each bend in each row (F, K), rad; nan where it is missing, or beyond ±180°.

    Raises LogError if it is beyond ±180° for longer than a sensor that fails now and then.
    """
    bend = mapping.bend
    # Read degrees from points, or from columns of angles.
    if bend.line:
        angles = _angle_of_line(table, mapping)[None]
    else:
        angles = np.empty((2 if bend.e3 else 1, table.values.shape[1]))
        with np.errstate(over="ignore"):  # of a number that no sensor has, which is left out below
            numbers = _numbers(table, bend.column or bend.e2, mapping)
            angles[0] = (numbers - bend.zero) * bend.scale
            if bend.e3:
                numbers = _numbers(table, bend.e3, mapping)
                angles[1] = (numbers - bend.zero_e3) * (bend.scale_e3 or bend.scale)
    if bend.seen:
        angles[:, table.numbers(bend.seen) == 0] = np.nan
    # Leave out what no limb does, if it is little.
    is_beyond = (np.abs(angles) > 180.0).any(axis=0)
    share = float(is_beyond.mean())
    largest_step = np.nanmax(np.abs(np.diff(angles)), initial=0.0)
    if share > MAX_FAILING_SHARE and largest_step > 180.0 and np.nanmax(np.abs(angles)) <= 360.0:
        # Turn angles that a compass shows from 0 to 360 into angles from -180 to 180.
        angles = wrap_angle(angles, 360.0)
        is_beyond[:] = False
    elif share > MAX_FAILING_SHARE:
        most = float(np.nanquantile(np.abs(angles), 0.99))
        raise LogError(
            f"the bend would be up to {most:.3g}°, and beyond ±180° in {share:.0%} of all rows; "
            "correct bend.scale or bend.zero."
        )
    angles[:, is_beyond] = np.nan
    # Turn what the sensor measures into bends.
    bends = np.deg2rad(angles)
    if bend.measures == TIP_TANGENT:
        bends = bend_sensor.bend_angle_from_tip_tangent(bends)
    return bend_sensor.roll_bends(bends, -np.deg2rad(bend.roll))


def _angle_of_line(table: LogTable, mapping: LogMapping) -> np.ndarray:
    """Return the angle of the line between two points in a picture (K,), °."""
    bend = mapping.bend
    columns = {column: _numbers(table, column, mapping) for column in bend.columns}
    angle = link_directions(list(map(columns.__getitem__, bend.line)))[0]
    if bend.base_line:
        links = link_directions(list(map(columns.__getitem__, bend.base_line)))
        turn = wrap_angle(links[-1] - links[0], 360.0)  # none if there is one link only
        angle = angle - links[-1] - 0.5 * turn
    return wrap_angle(angle - bend.zero, 360.0) * bend.scale
