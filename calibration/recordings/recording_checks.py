"""Checks of recordings, before anything is fitted to them."""

import itertools

import numpy as np

from calibration.import_logs.evidence import correlation
from calibration.recordings.at_rest import DISCONNECTED_BELOW
from calibration.recordings.kinds import (
    FREE_KINDS,
    GRAVITY_HINT,
    content_in_words,
    gravity_bends,
    kind_by_signals,
    only_segment,
)
from calibration.recordings.repair import (
    MIN_DURATION,
    MIN_SAMPLES,
    first_read_index,
    unknown_gaps,
    with_interpolated_gaps,
    without_spikes_in,
)
from calibration.remarks import CalibrationError
from limb_systems import Recording
from limb_systems.files.signal_table import stretches
from limb_systems.low_pass import low_pass

MIN_WARMING_DOSE = 2.0  # s of full duty, after which a wire must have warmed
MIN_RISE = 3.0  # °C
MAX_COLDEST_RISE = 200.0  # °C above ambient, below which wires are at some time
# s, and 1/s: less than by this rate no warm wire cools
REST_TIME = 2.0
MIN_COOLING_RATE = 1 / 200
MIN_BEND = np.deg2rad(2.0)
GRAVITY_RANGE = 9.5, 10.1  # m/s²
COOLING_TIME = 15.0  # s, of a wire, roughly
SMOOTHING_TIME = 1.0  # s, over which signals are averaged
MAX_JUMP = 5.0  # °C, by which its readings do not differ from one to the next
MAX_SAMPLE_PERIOD = 5.0  # s, between samples
FULL_DUTY_RISE = 300.0  # °C of a wire at full duty, roughly
MIN_STEEPEST_SLOPE = 0.05, 10.0  # °C/s that a wire exceeds somewhere, if it is heated by so many °C
MIN_FROZEN_TIME = 10.0  # s, for which a sensor that froze repeats a reading at least
HEAT_WINDOW = 5.0  # s, within which heat moves a reading
MIN_STANDING_CHANCE = 1e-9  # by which readings stand that are alive
# Share of the largest change of a wire's heat in a window, from which on readings must move.
DRIVING_HEAT_SHARE = 0.1
# windows with as much heat before, and share that moved
MIN_DRIVEN_WINDOWS = 3
MIN_MOVED_SHARE = 0.9


def check_recording(recording: Recording, expected: str | None = None) -> None:
    """Refuse recordings that calibration must not use.

    Args:
        expected: its kind, if it is known; any if None.

    Raises:
        CalibrationError: one sentence that names the trouble: too few samples, times in
            another unit, values that are not plausible, a dead thermocouple,
            swapped wires, thermocouples or bend sensor, other units, or another
            kind than expected.
    """
    # Check samples, duration and mounting.
    _check_time(recording)
    recording.check_plausible()
    num_bends = int((~np.isnan(recording.bend_angle)).sum(axis=1).min())
    if num_bends < MIN_SAMPLES:
        raise CalibrationError(
            f"the bend angle is there in {num_bends} of {len(recording.time)} samples, which tell "
            "nothing; leave this recording out, and see whether the column is the right one."
        )
    _check_zeros(recording)
    recording = without_spikes_in(with_interpolated_gaps(recording))
    if recording.duty.any() and recording.duration < MIN_DURATION:
        raise CalibrationError(
            f"wires are heated for {recording.duration:.1f} s only; they take seconds to heat and "
            f"to cool, so record {MIN_DURATION:.0f} s at least."
        )
    _check_gravity(recording)
    # Compare with the kind that is expected.
    kind = kind_by_signals(recording)
    if expected in FREE_KINDS and recording.duty.any():
        kind = expected
    if expected and kind != expected:
        expectation = content_in_words(recording.parameters, expected)
        content = content_in_words(recording.parameters, kind)
        hint = GRAVITY_HINT * (expected == "sag")
        raise CalibrationError(f"this should show {expectation}, but shows {content}{hint}.")
    if frozen := frozen_since(recording):
        raise CalibrationError(f"{frozen[1]} while wires are heated; cut the file there.")
    if recording.duty.any():
        _check_wires(recording)
    _check_thermocouples(recording)
    _check_bend(recording)


def _check_time(recording: Recording) -> None:
    """Raise CalibrationError if samples are few, or do not come at the sample rate."""
    steps = np.diff(recording.time)
    period = 1 / recording.sample_rate
    if len(steps) < MIN_SAMPLES:
        raise CalibrationError(f"there are only {len(recording.time)} samples.")
    typical = float(np.median(steps))
    mean = float(steps.mean())
    # The rate of irregular samples may be of most samples, or their number in a second.
    if not (0.9 < typical / period < 1.1 or 0.9 < mean / period < 1.1):
        hint = " Is time in milliseconds?" if 900 < typical / period < 1100 else ""
        raise CalibrationError(
            f"samples come every {typical:g} s, but the sample rate in the header is "
            f"{recording.sample_rate:g} Hz.{hint}"
        )
    if typical > MAX_SAMPLE_PERIOD:
        raise CalibrationError(
            f"samples come every {typical:g} s, but wires heat and cool within seconds; is time in "
            "milliseconds?"
        )


def check_without_gaps(recording: Recording) -> None:
    """Refuse recordings whose duty is not known throughout, for what needs them in one piece.

    Raises:
        CalibrationError: one sentence that says from where to where it can be used.
    """
    first = first_read_index(recording)
    time = recording.time
    if recording.duty[:, 1 : first + 1].any():
        raise CalibrationError(
            f"no reading is there before {time[first]:.2f} s, when wires were already heated; "
            "where they started is not known, so leave the beginning out."
        )
    for gap in unknown_gaps(recording):
        raise CalibrationError(
            f"there is a gap in the samples, of {time[gap + 1] - time[gap]:.2f} s after "
            f"{time[gap]:.2f} s, and what duty there was is not known: cut the file there, or add "
            "rows that have the duty and empty cells for the readings."
        )


def frozen_since(recording: Recording) -> tuple[int, str] | None:
    """Return the sample since which a sensor is frozen, and why, in words; None if none is.

    A frozen sensor repeats one reading to the last digit, while wires are heated by as much as
    changed its reading before. Readings may also repeat because the limb rests, or because the
    sensor is coarse.
    """
    # Measure how much each wire's heat changes within each window, (W, K - window).
    heat = _wire_heat(recording)
    window = max(1, round(HEAT_WINDOW * recording.sample_rate))
    if len(recording.time) <= window:
        return None
    rises = np.abs(heat[:, window:] - heat[:, :-window])
    # A thermocouple follows its own wire, a bend sensor the wire whose heat changes most.
    signals = np.vstack([recording.measured_temperature, recording.bend_angle])
    driving_rises = np.vstack([rises, *[rises.max(axis=0)] * len(recording.bend_angle)])
    frozen = []
    for name, signal, rise in zip(_sensor_names(recording), signals, driving_rises, strict=True):
        # Find the windows in which the reading changes. Missing readings do not count.
        read_rows = np.flatnonzero(~np.isnan(signal))
        changes = np.diff(signal[read_rows]) != 0
        moves = np.zeros(len(signal))
        moves[read_rows[1:]] = changes
        is_moved = np.convolve(moves, np.ones(window), "valid")[1:] > 0.5
        # Find spans in which the reading repeats, as pairs of places in ``changes``.
        is_driven = rise > DRIVING_HEAT_SHARE * rise.max()
        first = np.arange(len(rise))
        num_changes = np.cumsum(changes)
        still_spans = stretches(~changes)
        durations = np.diff(recording.time[read_rows[still_spans]], axis=1)[:, 0]
        for from_change, to_change in still_spans[durations >= MIN_FROZEN_TIME]:
            start, end = read_rows[[from_change, to_change]]
            # Skip a span that may be chance: before it, the reading changed at a usual share of
            # the samples.
            usual_share = num_changes[from_change - 1] / from_change if from_change else 0.0
            chance = (1.0 - usual_share) ** (to_change - from_change)
            if chance > MIN_STANDING_CHANCE:
                continue
            during = is_driven & (first >= start) & (first + window <= end)
            before = is_moved[is_driven & (first + window <= start)]
            has_moved = len(before) >= MIN_DRIVEN_WINDOWS and before.mean() > MIN_MOVED_SHARE
            if during.any() and has_moved:
                sentence = f"{name} repeats one reading from {recording.time[start]:.1f} s on"
                frozen.append((int(start), sentence))
                break
    return min(frozen, default=None)


def _sensor_names(recording: Recording) -> list[str]:
    """Return the names of the thermocouples and of the bend sensor of each bend, in messages."""
    names = [f"the {name} thermocouple" for name in recording.parameters.wire_names]
    return names + ["the bend sensor"] * len(recording.bend_angle)


def _check_zeros(recording: Recording) -> None:
    """Raise CalibrationError if zeros seem to stand where a sensor had no reading."""
    readings = recording.measured_temperature
    signals = np.vstack([readings, np.rad2deg(recording.bend_angle)])
    min_jumps = np.repeat(
        [MAX_JUMP, np.rad2deg(MIN_BEND)], [len(readings), len(recording.bend_angle)]
    )
    for name, signal, min_jump in zip(_sensor_names(recording), signals, min_jumps, strict=True):
        time = recording.time[~np.isnan(signal)]
        signal = signal[~np.isnan(signal)]
        # A limb that swings passes zero as fast as it passes other angles.
        steps = np.abs(np.diff(signal[signal != 0]))
        jump = max(min_jump, 2 * np.quantile(steps, 0.98) if len(steps) else 0.0)
        for start, end in stretches(signal == 0):
            neighbours = [*signal[start - 1 : start], *signal[end : end + 1]]
            if end - start > 1 and neighbours and np.abs(neighbours).max() > jump:
                raise CalibrationError(
                    f"{name} reads exactly 0 from {time[start]:.2f} s to {time[end - 1]:.2f} s, "
                    f"and {max(neighbours, key=abs):.1f} beside it: if it had no reading, leave "
                    "its cells empty."
                )


def _check_gravity(recording: Recording) -> None:
    """Raise CalibrationError if gravity is of another planet, or bends a limb that is heated."""
    gravity = recording.parameters.gravity
    size = float(np.linalg.norm(gravity))
    if size and not GRAVITY_RANGE[0] < size < GRAVITY_RANGE[1]:
        raise CalibrationError(
            f"the header's gravity is {size:.3g} m/s², but it must be 9.81 m/s², or zero for a "
            "limb that lies level; correct the header."
        )
    in_plane = only_segment(recording.parameters).axes == 1
    if in_plane and recording.duty.any() and gravity_bends(recording.parameters):
        raise CalibrationError(
            f"wires are heated while gravity {list(gravity)} bends the limb; record it level, with "
            "gravity zero in the header."
        )


def _check_thermocouples(recording: Recording) -> None:
    """Raise CalibrationError if one is loose, reads no °C, or is slower than wires are."""
    ambient = recording.parameters.ambient_temperature
    times = recording.time
    window = max(1, len(times) // 200)
    (steepest, rise) = MIN_STEEPEST_SLOPE
    typical_readings = np.median(recording.measured_temperature, axis=1)
    signals = zip(recording.duty, recording.measured_temperature, strict=True)
    for index, (duty, measured) in enumerate(signals):
        name = recording.parameters.wire_names[index]
        # Wires warm faster than that: else the time is in another unit.
        slope = (measured[window:] - measured[:-window]) / (times[window:] - times[:-window])
        if duty.any() and np.ptp(measured) > rise and np.abs(slope).max() < steepest:
            raise CalibrationError(
                f"the {name} wire warms by {np.ptp(measured):.0f} °C, but nowhere faster than "
                f"{np.abs(slope).max():.3f} °C/s; is time in milliseconds?"
            )
        # Some readings are near ambient: else they are in another unit.
        if measured.min() > ambient + MAX_COLDEST_RISE:
            raise CalibrationError(
                f"the {name} thermocouple reads {measured.min():.0f} at the lowest; it seems to be "
                "in kelvin, but must be in °C."
            )
        level = _resting_level(duty, measured, recording.sample_rate, ambient)
        if ambient > 10.0 and abs(level - (1.8 * ambient + 32.0)) < 15.0:
            raise CalibrationError(
                f"the {name} thermocouple rests at {level:.0f}, where ambient is {ambient:g} °C; "
                "is it in degrees Fahrenheit?"
            )
        # A connected thermocouple reads about ambient, as others do, and does not jump.
        if not recording.duty.any():
            continue
        coldest = np.fmin.reduce([ambient, *np.delete(typical_readings, index)])
        if typical_readings[index] < coldest - DISCONNECTED_BELOW:
            raise CalibrationError(
                f"the {name} thermocouple reads {typical_readings[index]:.0f} °C, far below "
                "ambient and the others; is it connected?"
            )
        if (jump := np.median(np.abs(np.diff(measured)))) > MAX_JUMP:
            raise CalibrationError(
                f"readings of the {name} thermocouple jump by {jump:.0f} °C from one to the next; "
                "is it connected?"
            )


def _check_bend(recording: Recording) -> None:
    """Raise CalibrationError if the bend sensor is loose, or its file seems to be in radians."""
    largest = np.ptp(recording.bend_angle, axis=1).max()
    warmed = np.fmax.reduce(np.ptp(recording.measured_temperature, axis=1))
    if recording.duty.sum(axis=1).max() / recording.sample_rate <= MIN_WARMING_DOSE:
        return
    if warmed > 20.0 and 1e-3 < largest < np.deg2rad(1.6):
        raise CalibrationError(
            f"the bend angle is at most {np.rad2deg(largest):.2f}° while a wire warms by "
            f"{warmed:.0f} °C; is it in radians? Files must have degrees."
        )
    if not largest > 0:
        raise CalibrationError(
            f"the bend angle stays at {np.rad2deg(recording.bend_angle[0, 0]):.1f}° while wires "
            "are heated; is the bend sensor connected?"
        )


def _resting_level(
    duty: np.ndarray, measured: np.ndarray, sample_rate: float, ambient: float
) -> float:
    """Return the lowest level, °C, at which readings rest without heat; nan if they never do."""
    half = max(2, round(REST_TIME / 2 * sample_rate))
    if len(measured) < 2 * half:
        return np.nan
    means = np.convolve(measured, np.ones(half) / half, "valid")
    level = (means[:-half] + means[half:]) / 2
    change = np.abs(means[half:] - means[:-half])
    off = np.convolve(duty > 0, np.ones(2 * half), "valid") < 0.5
    cooling = MIN_COOLING_RATE * half / sample_rate * (level - ambient)
    rests = off & (change < cooling) & (level < level.min() + MIN_RISE)
    return float(level[rests].min()) if rests.any() else np.nan


def _wire_heat(recording: Recording) -> np.ndarray:
    """Return how warm wires are by their duty (W, K), as a share of what full duty comes to."""
    return low_pass(recording.duty, np.exp(-1 / recording.sample_rate / COOLING_TIME))


def _exchanged_pair(recording: Recording) -> tuple[int, int] | None:
    """Return two wires, if any, whose readings follow each other's duty."""
    heat = _wire_heat(recording)
    warmth = recording.measured_temperature
    is_heated = (np.ptp(heat, axis=1) > 0) & (np.ptp(warmth, axis=1) > 0)
    for one, other in itertools.combinations(np.flatnonzero(is_heated).tolist(), 2):
        agreement = np.corrcoef(heat[[one, other]], warmth[[one, other]])[:2, 2:]
        if np.trace(agreement[::-1]) > np.trace(agreement) + 0.5:
            return one, other
    return None


def _check_wires(recording: Recording) -> None:
    """Raise CalibrationError if a wire warms another thermocouple, or bends the limb away."""
    # Smooth the readings over a second.
    names = recording.parameters.wire_names
    measured = recording.measured_temperature
    dose = recording.duty.sum(axis=1) / recording.sample_rate
    width = max(1, min(round(SMOOTHING_TIME * recording.sample_rate), len(recording.time) // 2))
    kernel = np.ones(width) / width
    smooth = np.apply_along_axis(np.convolve, 1, measured, kernel, "valid")
    signal = np.apply_along_axis(np.convolve, 1, recording.bend_angle, kernel, "valid")
    # A wire may be hot at the start, and cool from there: it has moved, and it has not climbed.
    moved = np.ptp(smooth, axis=1)
    climb = (smooth - np.minimum.accumulate(smooth, axis=1)).max(axis=1)
    heat = _wire_heat(recording)[:, width - 1 :]
    axes = len(recording.bend_angle)
    levers = np.array([wire.lever[:axes] for wire in recording.parameters.wires])
    # Find heated wires whose thermocouple does not climb: another one does, or it is dead.
    for index, name in enumerate(names):
        if dose[index] < MIN_WARMING_DOSE or not climb[index] < MIN_RISE:
            continue
        other = int(np.nanargmax(np.where(dose < MIN_WARMING_DOSE, climb, -np.inf)))
        climbs_unheated = dose[other] < MIN_WARMING_DOSE and climb[other] >= MIN_RISE
        with_own = correlation(heat[index], smooth[index])
        if climbs_unheated and correlation(heat[index], smooth[other]) > with_own:
            hottest = np.argmax(smooth[other])
            coldest = np.argmin(smooth[other])
            bent = signal[:, hottest] - signal[:, coldest]
            side = ""
            what = "thermocouples"
            if levers[index] @ bent < -MIN_BEND * np.linalg.norm(levers[index]):
                side = " and bends the limb away from its own side"
                what = "wires' outputs"
            raise CalibrationError(
                f"duty for the {name} wire warms the {names[other]} thermocouple{side}: the {what} "
                "are swapped."
            )
        if moved[index] >= MIN_RISE:
            continue
        raise CalibrationError(
            f"the {name} thermocouple is dead: it moves by {moved[index]:.1f} °C while "
            f"its wire gets {dose[index]:.1f} s of full duty in all."
        )
    # Compare how the limb bends with how warm wires pull it.
    unread = ~recording.has_thermocouple
    smooth[unread] = FULL_DUTY_RISE * heat[unread]
    drive = levers.T @ smooth
    moves = np.ptp(signal, axis=1).max() > 2 * MIN_BEND and np.ptp(drive) > 0
    driving = drive - drive.mean(axis=1, keepdims=True)
    bent = signal - signal.mean(axis=1, keepdims=True)
    agreement = correlation(driving.ravel(), bent.ravel()) if moves else 0.0
    swapped = _exchanged_pair(recording)
    if swapped and abs(agreement) > 0.5:
        pair = " and ".join(names[index] for index in swapped)
        what = "thermocouples"
        if agreement > 0:
            what = "duty columns or the wires' outputs"
        raise CalibrationError(
            f"the {pair} wires' temperatures follow each other's duty: the {what} are swapped."
        )
    if agreement < -0.5:
        raise CalibrationError(
            "the limb bends away from the wire that is heated: the bend sensor is reversed, or "
            "wires and thermocouples are swapped alike."
        )
