"""Checks of recordings, before anything is fitted to them."""

import itertools

import numpy as np

from calibration.import_logs.evidence import correlation
from calibration.recordings.kinds import (
    FREE_KINDS,
    GRAVITY_HINT,
    gravity_bends,
    only_segment,
    shown_kind,
    shows,
)
from calibration.recordings.repair import (
    FEWEST,
    SHORTEST,
    despiked,
    first_read,
    gaps_of,
    interpolated,
)
from calibration.remarks import CalibrationError
from limb_systems import Recording
from limb_systems.files.signal_table import stretches
from limb_systems.low_pass import low_pass

HEATED = 2.0  # s of full duty, after which a wire must have warmed
RISE = 3.0  # °C
HOTTEST = 200.0  # °C above ambient, below which wires are at some time
REST, SLOWEST_COOLING = 2.0, 1 / 200  # s, and 1/s: less than by this rate no warm wire cools
BENT = np.deg2rad(2.0)
EARTH = 9.5, 10.1  # m/s²
COOLING_TIME = 15.0  # s, of a wire, roughly
SMOOTH = 1.0  # s, over which signals are averaged
COLDER = 10.0  # °C, by which a connected thermocouple is not colder than all others
JUMPS = 5.0  # °C, by which its readings do not differ from one to the next
SLOWEST = 5.0  # s, between samples
WARMTH = 300.0  # °C of a wire at full duty, roughly
STEEPEST = 0.05, 10.0  # °C/s that a wire exceeds somewhere, if it is heated by so many °C
FROZEN = 10.0  # s, for which a sensor that froze repeats a reading at least
WINDOW = 5.0  # s, within which heat moves a reading
LEAST_CHANCE = 1e-9  # by which readings stand that are alive
MUCH_HEAT = (
    0.1  # of the largest change of a wire's heat in a window, from which on readings must move
)
FEWEST_MOVES, MOST_MOVE = 3, 0.9  # windows with as much heat before, and share that moved


def check_recording(recording: Recording, expected: str | None = None) -> str:
    """Refuses recordings that calibration must not use.

    Args:
        expected: its kind, if it is known; any if None.

    Returns:
        what it shows.

    Raises:
        CalibrationError: one sentence that names the trouble: too few samples, times in
            another unit, values that are not plausible, a dead thermocouple,
            swapped wires, thermocouples or bend sensor, other units, or another
            kind than expected.
    """
    _check_time(recording)
    recording.check_plausible()
    _check_missing(recording)
    _check_zeros(recording)
    recording = despiked(interpolated(recording))
    _check_duration(recording)
    _check_gravity(recording)
    kind = shown_kind(recording)
    if expected in FREE_KINDS and recording.duty.any():
        kind = expected
    if expected and kind != expected:
        wanted, shown = (shows(recording.parameters, k) for k in (expected, kind))
        hint = GRAVITY_HINT * (expected == "sag")
        raise CalibrationError(f"this should show {wanted}, but shows {shown}{hint}.")
    if frozen := frozen_since(recording):
        raise CalibrationError(f"{frozen[1]} while wires are heated; cut the file there.")
    if recording.duty.any():
        _check_wires(recording)
    _check_thermocouples(recording)
    _check_bend(recording)
    return kind


def _check_time(recording: Recording) -> None:
    steps, period = np.diff(recording.time), 1 / recording.sample_rate
    if len(steps) < FEWEST:
        raise CalibrationError(f"there are only {len(recording.time)} samples.")
    typical, mean = float(np.median(steps)), float(steps.mean())
    # Of irregular samples the rate may be that of most, or the number in a second.
    if not (0.9 < typical / period < 1.1 or 0.9 < mean / period < 1.1):
        hint = " Is time in milliseconds?" if 900 < typical / period < 1100 else ""
        raise CalibrationError(
            f"samples come every {typical:g} s, but the sample rate in the header is "
            f"{recording.sample_rate:g} Hz.{hint}"
        )
    if typical > SLOWEST:
        raise CalibrationError(
            f"samples come every {typical:g} s, but wires heat and cool within seconds; is time in "
            "milliseconds?"
        )


def check_without_gaps(recording: Recording) -> None:
    """Refuses recordings whose duty is not known throughout, for what needs them in one piece.

    Raises:
        CalibrationError: one sentence that says from where to where it can be used.
    """
    first, time = first_read(recording), recording.time
    if recording.duty[:, 1 : first + 1].any():
        raise CalibrationError(
            f"no reading is there before {time[first]:.2f} s, when wires were already heated; "
            "where they started is not known, so leave the beginning out."
        )
    for gap in gaps_of(recording):
        raise CalibrationError(
            f"there is a gap in the samples, of {time[gap + 1] - time[gap]:.2f} s after "
            f"{time[gap]:.2f} s, and what duty there was is not known: cut the file there, or add "
            "rows that have the duty and empty cells for the readings."
        )


def frozen_since(recording: Recording) -> tuple[int, str] | None:
    """Return the sample since which a sensor is frozen, and why, in words; None if none is.

    A frozen sensor repeats one reading to the last digit while a wire is heated as much as moved
    the reading before. Readings may stand where the limb rests, or where the sensor is coarse.
    """
    heat = _heat(recording)
    window = max(1, round(WINDOW * recording.sample_rate))
    if len(recording.time) <= window:
        return None
    rises = np.abs(heat[:, window:] - heat[:, :-window])
    names = [f"the {name} thermocouple" for name in recording.parameters.wire_names]
    signals = list(zip(names, recording.measured_temperature, rises[:, None], strict=True))
    signals += [("the bend sensor", bend, rises) for bend in recording.bend_angle]
    frozen = []
    for name, signal, of_wires in signals:
        # Missing readings neither stand nor move.
        shown = np.flatnonzero(~np.isnan(signal))
        changes = np.diff(signal[shown]) != 0
        moves = np.zeros(len(signal))
        moves[shown[1:]] = changes
        moved = np.convolve(moves, np.ones(window), "valid")[1:] > 0.5
        rise = of_wires.max(axis=0)
        driven = rise > MUCH_HEAT * rise.max()
        first = np.arange(len(rise))
        num_changes = np.cumsum(changes)
        still = stretches(~changes)
        durations = np.diff(recording.time[shown[still]], axis=1)[:, 0]
        for from_change, to_change in still[durations >= FROZEN]:
            start, end = shown[[from_change, to_change]]
            # How improbable it is that so many readings stand, by what the sensor did before.
            usual = num_changes[from_change - 1] / from_change if from_change else 0.0
            chance = (1.0 - usual) ** (to_change - from_change)
            if chance > LEAST_CHANCE:
                continue
            during = driven & (first >= start) & (first + window <= end)
            before = moved[driven & (first + window <= start)]
            if during.any() and len(before) >= FEWEST_MOVES and before.mean() > MOST_MOVE:
                frozen.append((int(start), name))
                break
    if not frozen:
        return None
    start, name = min(frozen)
    return start, f"{name} repeats one reading from {recording.time[start]:.1f} s on"


def _check_missing(recording: Recording) -> None:
    """Whether enough readings of the bend are there."""
    count = len(recording.time)
    bends = int((~np.isnan(recording.bend_angle)).sum(axis=1).min())
    if bends < FEWEST:
        raise CalibrationError(
            f"the bend angle is there in {bends} of {count} samples, which tell nothing; leave "
            "this recording out, and see whether the column is the right one."
        )


def _check_zeros(recording: Recording) -> None:
    """Whether loggers or cameras wrote zeros where they had no reading."""
    names = [f"the {name} thermocouple" for name in recording.parameters.wire_names]
    signals = np.vstack([recording.measured_temperature, np.rad2deg(recording.bend_angle)])
    count = len(recording.bend_angle)
    jumps = [*[JUMPS] * len(names), *[np.rad2deg(BENT)] * count]
    names += ["the bend sensor"] * count
    for name, signal, jump in zip(names, signals, jumps, strict=True):
        signal, time = signal[~np.isnan(signal)], recording.time[~np.isnan(signal)]
        # A limb that swings passes zero as fast as it passes other angles.
        steps = np.abs(np.diff(signal[signal != 0]))
        jump = max(jump, 2 * np.quantile(steps, 0.98) if len(steps) else 0.0)
        for start, end in stretches(signal == 0):
            around = [*signal[start - 1 : start], *signal[end : end + 1]]
            if end - start > 1 and around and np.abs(around).max() > jump:
                raise CalibrationError(
                    f"{name} reads exactly 0 from {time[start]:.2f} s to {time[end - 1]:.2f} s, "
                    f"and {max(around, key=abs):.1f} beside it: if it had no reading, leave its "
                    "cells empty."
                )


def _check_duration(recording: Recording) -> None:
    """Whether wires heat and cool for long enough to be seen."""
    if recording.duty.any() and recording.duration < SHORTEST:
        raise CalibrationError(
            f"wires are heated for {recording.duration:.1f} s only; they take seconds to heat and "
            f"to cool, so record {SHORTEST:.0f} s at least."
        )


def _check_gravity(recording: Recording) -> None:
    gravity = recording.parameters.gravity
    size = float(np.linalg.norm(gravity))
    if size and not EARTH[0] < size < EARTH[1]:
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
    """Whether each is connected, reads °C, and rises and falls as fast as wires do."""
    ambient, times = recording.parameters.ambient_temperature, recording.time
    window, (steepest, rise) = max(1, len(times) // 200), STEEPEST
    typical = np.median(recording.measured_temperature, axis=1)
    signals = zip(recording.duty, recording.measured_temperature, strict=True)
    for index, (duty, measured) in enumerate(signals):
        name = recording.parameters.wire_names[index]
        slope = (measured[window:] - measured[:-window]) / (times[window:] - times[:-window])
        if duty.any() and np.ptp(measured) > rise and np.abs(slope).max() < steepest:
            raise CalibrationError(
                f"the {name} wire warms by {np.ptp(measured):.0f} °C, but nowhere faster than "
                f"{np.abs(slope).max():.3f} °C/s; is time in milliseconds?"
            )
        if measured.min() > ambient + HOTTEST:
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
        if not recording.duty.any():
            continue
        if typical[index] < np.fmin.reduce([ambient, *np.delete(typical, index)]) - COLDER:
            raise CalibrationError(
                f"the {name} thermocouple reads {typical[index]:.0f} °C, far below ambient and the "
                "others; is it connected?"
            )
        if (jump := np.median(np.abs(np.diff(measured)))) > JUMPS:
            raise CalibrationError(
                f"readings of the {name} thermocouple jump by {jump:.0f} °C from one to the next; "
                "is it connected?"
            )


def _check_bend(recording: Recording) -> None:
    """Whether the bend sensor is connected, and its angles are in degrees in their file."""
    largest = np.ptp(recording.bend_angle, axis=1).max()
    warmed = np.fmax.reduce(np.ptp(recording.measured_temperature, axis=1))
    if recording.duty.sum(axis=1).max() / recording.sample_rate <= HEATED:
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
    """The lowest readings (K,) where they rest without heat, °C, as no warm wire does; else nan."""
    half = max(2, round(REST / 2 * sample_rate))
    if len(measured) < 2 * half:
        return np.nan
    means = np.convolve(measured, np.ones(half) / half, "valid")
    level, change = (means[:-half] + means[half:]) / 2, np.abs(means[half:] - means[:-half])
    off = np.convolve(duty > 0, np.ones(2 * half), "valid") < 0.5
    cooling = SLOWEST_COOLING * half / sample_rate * (level - ambient)
    rests = off & (change < cooling) & (level < level.min() + RISE)
    return float(level[rests].min()) if rests.any() else np.nan


def _heat(recording: Recording) -> np.ndarray:
    """How warm wires are by their duty (W, K), as a share of what full duty comes to."""
    return low_pass(recording.duty, np.exp(-1 / recording.sample_rate / COOLING_TIME))


def _exchanged(recording: Recording) -> tuple[int, int] | None:
    """Two wires, if any, each of which is as warm as the duty of the other would have it."""
    heat, warmth = _heat(recording), recording.measured_temperature
    heated = [i for i in range(len(heat)) if np.ptp(heat[i]) > 0 and np.ptp(warmth[i]) > 0]
    for one, other in itertools.combinations(heated, 2):
        agreement = np.corrcoef(heat[[one, other]], warmth[[one, other]])[:2, 2:]
        if np.trace(agreement[::-1]) > np.trace(agreement) + 0.5:
            return one, other
    return None


def _window(recording: Recording) -> int:
    """Samples of a second, at least one."""
    return max(1, min(round(SMOOTH * recording.sample_rate), len(recording.time) // 2))


def _check_wires(recording: Recording) -> None:
    """Whether each wire warms its own thermocouple and bends the limb to its side."""
    names = recording.parameters.wire_names
    measured = recording.measured_temperature
    dose = recording.duty.sum(axis=1) / recording.sample_rate
    width = _window(recording)
    kernel = np.ones(width) / width
    smooth = np.array([np.convolve(v, kernel, "valid") for v in measured])
    signal = np.array([np.convolve(bend, kernel, "valid") for bend in recording.bend_angle])
    # A wire may be hot at the start, and cool from there: it has moved, and it has not climbed.
    moved = np.ptp(smooth, axis=1)
    climb = (smooth - np.minimum.accumulate(smooth, axis=1)).max(axis=1)
    heat = _heat(recording)[:, width - 1 :]
    axes = len(recording.bend_angle)
    levers = np.array([wire.lever[:axes] for wire in recording.parameters.wires])
    for index, name in enumerate(names):
        if dose[index] < HEATED or not climb[index] < RISE:
            continue
        other = int(np.nanargmax(np.where(dose < HEATED, climb, -np.inf)))
        of_other, own = (correlation(heat[index], smooth[i]) for i in (other, index))
        if dose[other] < HEATED and climb[other] >= RISE and of_other > own:
            hottest, coldest = np.argmax(smooth[other]), np.argmin(smooth[other])
            bent = signal[:, hottest] - signal[:, coldest]
            side, what = "", "thermocouples"
            if levers[index] @ bent < -BENT * np.linalg.norm(levers[index]):
                side, what = " and bends the limb away from its own side", "wires' outputs"
            raise CalibrationError(
                f"duty for the {name} wire warms the {names[other]} thermocouple{side}: the {what} "
                "are swapped."
            )
        if moved[index] >= RISE:
            continue
        raise CalibrationError(
            f"the {name} thermocouple is dead: it moves by {moved[index]:.1f} °C while "
            f"its wire gets {dose[index]:.1f} s of full duty in all."
        )
    unread = ~recording.has_thermocouple
    smooth[unread] = WARMTH * heat[unread]
    drive = levers.T @ smooth
    moves = np.ptp(signal, axis=1).max() > 2 * BENT and np.ptp(drive) > 0
    driving, bent = (rows - rows.mean(axis=1, keepdims=True) for rows in (drive, signal))
    agreement = correlation(driving.ravel(), bent.ravel()) if moves else 0.0
    swapped = _exchanged(recording)
    if swapped and abs(agreement) > 0.5:
        pair, what = " and ".join(names[index] for index in swapped), "thermocouples"
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
