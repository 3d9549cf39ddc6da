"""Checks of recordings, before anything is fitted to them."""

import itertools

import numpy as np

from calibration.course import despiked, without_missing
from calibration.errors import CalibrationError
from calibration.kinds import FREE_KINDS, heated_kinds, kinds_of
from limb_systems import LimbError, LimbParameters, Recording

HEATED = 2.0  # s of full duty, after which a wire must have warmed
RISE = 3.0  # °C
BENT = np.deg2rad(2.0)
SHORTEST = 10.0  # s, of heated recordings
EARTH = 9.5, 10.1  # m/s²
COOLING_TIME = 15.0  # s, of a wire, roughly
SMOOTH = 1.0  # s, over which signals are averaged
COLDER = 10.0  # °C, by which a connected thermocouple is not colder than all others
JUMPS = 5.0  # °C, by which its readings do not differ from one to the next
FEWEST = 20  # samples
SLOWEST = 5.0  # s, between samples
LOST = 2.0, 0.05  # s of lost samples, and change of duty meanwhile, that are tolerated
STEEPEST = 0.05, 10.0  # °C/s that a wire exceeds somewhere, if it is heated by so many °C


def kind_of(recording: Recording) -> str:
    """What a recording shows, one of `kinds_of` its limb.

    Raises:
        LimbError: if several wires are heated in it, but not all; or if its
            limb is one that is not calibrated.
    """
    parameters = recording.parameters
    kinds = kinds_of(parameters)
    heated = np.flatnonzero(recording.duty.max(axis=1) > 0).tolist()
    if not heated:
        return "sag" if np.hypot(*np.array(parameters.gravity[:2])) > 1.0 else "ring_down"
    for kind, wires in kinds.items():
        if wires == heated:
            return kind
    names = " and ".join(parameters.wire_names[index] for index in heated)
    raise CalibrationError(
        f"only the wires {names} are heated, but a recording must show one wire heated, or all."
    )


def _shows(parameters: LimbParameters, kind: str) -> str:
    """What a recording of a kind must show, in words."""
    if kind == "sag":
        return "no wire is heated and gravity bends the limb"
    if kind == "ring_down":
        return "no wire is heated"
    return f"{_all(parameters)} are heated" if kind == "both" else f"only the {kind} wire is heated"


def _complaint(parameters: LimbParameters, kind: str) -> str:
    """The error if a recording should show a kind, but shows {}."""
    if kind == "sag":
        return (
            "this should show the limb's sag under gravity, unheated, but {}; does its header's "
            "gravity say how the limb was mounted?"
        )
    if kind == "ring_down":
        return "this should show an unheated limb ringing down without gravity, but {}."
    if kind == "both":
        return f"this should show {_all(parameters)} heated, but {{}}."
    return f"this should show the {kind} wire heated and no other, but {{}}."


def _all(parameters: LimbParameters) -> str:
    return "both wires" if len(parameters.wires) == 2 else "all wires"


def check_recording(recording: Recording, expected: str | None = None) -> str:
    """Refuses recordings that calibration must not use.

    Args:
        expected: what the recording is meant to show, as in `kind_of`; any
            if None.

    Returns:
        what it shows.

    Raises:
        CalibrationError: one sentence that names the trouble: gaps, times in
            another unit, values that are not plausible, a dead thermocouple,
            swapped wires, thermocouples or bend sensor, other units, or another
            kind than expected.
    """
    _check_time(recording)
    check_values(recording)
    _check_missing(recording)
    _check_zeros(recording)
    recording = despiked(without_missing(recording))
    _check_duration(recording)
    _check_pace(recording)
    _check_gravity(recording)
    _check_units(recording, may_be_warm=expected in FREE_KINDS)
    if expected in FREE_KINDS:
        if not recording.duty.any():
            raise CalibrationError("this should show heated wires, but no wire is heated.")
        _check_wires(recording)
        _check_readings(recording)
        return expected
    kind = kind_of(recording)
    if expected and kind != expected:
        parameters = recording.parameters
        shown, complaint = _shows(parameters, kind), _complaint(parameters, expected)
        raise CalibrationError(complaint.format(shown))
    if kind in heated_kinds(recording.parameters):
        _check_wires(recording)
        _check_readings(recording)
    return kind


def check_values(recording: Recording) -> None:
    """Refuses recordings with values that no limb has, which would spoil any fit.

    Raises:
        CalibrationError: one sentence that names signal, value and time.
    """
    try:
        recording.check_plausible()
    except LimbError as error:
        raise CalibrationError(f"{str(error)[:-1]}, so record it again.") from error


def check_whole(recording: Recording) -> None:
    """Refuses recordings that were interrupted: their last equilibrium is none.

    Raises:
        CalibrationError: one sentence that says why it was interrupted.
    """
    if recording.interrupted:
        raise CalibrationError(
            f"this was interrupted ({recording.interrupted.rstrip('.')}), so record it again."
        )


def _check_time(recording: Recording) -> None:
    steps, period = np.diff(recording.time), 1 / recording.sample_rate
    if len(steps) < FEWEST:
        raise CalibrationError(f"there are only {len(recording.time)} samples.")
    typical = float(np.median(steps))
    if not 0.9 < typical / period < 1.1:
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
    longest, least = LOST
    constant = np.abs(np.diff(recording.duty, axis=1)).max(axis=0) <= least
    gaps = (steps > 1.5 * period) & ~((steps <= max(longest, 2.5 * period)) & constant)
    if gaps.any():
        worst, count = int(np.argmax(np.where(gaps, steps, 0.0))), int(gaps.sum())
        raise CalibrationError(
            f"there {'is a gap' if count == 1 else f'are {count} gaps'} in the samples, the "
            f"longest of {steps[worst]:.2f} s after {recording.time[worst]:.2f} s; what happened "
            "meanwhile is not known, so record it again, or, if the duty is known, add rows that "
            "have it and empty cells for the readings."
        )


def _check_missing(recording: Recording) -> None:
    """Whether enough readings are there, one of them before the first heat."""
    missing, count = recording.missing, len(recording.time)
    if missing.sum() > count / 2 or count - missing.sum() < FEWEST:
        raise CalibrationError(
            f"{missing.sum()} of {count} samples are missing, so record it again."
        )
    first = int(np.argmin(missing))
    if recording.duty[:, 1 : first + 1].any():
        raise CalibrationError(
            f"no reading is there before {recording.time[first]:.2f} s, when wires were already "
            "heated; where they started is not known, so leave the beginning out."
        )


def _check_zeros(recording: Recording) -> None:
    """Whether loggers or cameras wrote zeros where they had no reading."""
    names = [f"the {name} thermocouple" for name in recording.parameters.wire_names]
    signals = np.vstack([recording.measured_temperature, np.rad2deg(recording.bend_angle)])
    jumps = [*[JUMPS] * len(names), np.rad2deg(BENT)]
    for name, signal, jump in zip([*names, "the bend sensor"], signals, jumps, strict=False):
        signal, time = signal[~np.isnan(signal)], recording.time[~np.isnan(signal)]
        # A limb that swings passes zero as fast as it passes other angles.
        steps = np.abs(np.diff(signal[signal != 0]))
        jump = max(jump, 2 * np.quantile(steps, 0.98) if len(steps) else 0.0)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], signal == 0, [0]])))
        for start, end in edges.reshape(-1, 2):
            around = [*signal[start - 1 : start], *signal[end : end + 1]]
            if end - start > 1 and around and np.abs(around).max() > jump:
                raise CalibrationError(
                    f"{name} reads exactly 0 from {time[start]:.2f} s to {time[end - 1]:.2f} s, "
                    f"and {max(around, key=abs):.1f} beside it: if it had no reading, leave its "
                    "cells empty."
                )


def _check_pace(recording: Recording) -> None:
    """Whether wires heat and cool as fast as wires do."""
    times, window = recording.time, max(1, len(recording.time) // 200)
    steepest, rise = STEEPEST
    for name, duty, measured in zip(
        recording.parameters.wire_names,
        recording.duty,
        recording.measured_temperature,
        strict=True,
    ):
        slope = (measured[window:] - measured[:-window]) / (times[window:] - times[:-window])
        if duty.any() and np.ptp(measured) > rise and np.abs(slope).max() < steepest:
            raise CalibrationError(
                f"the {name} wire warms by {np.ptp(measured):.0f} °C, but nowhere faster than "
                f"{np.abs(slope).max():.3f} °C/s; is time in milliseconds?"
            )


def _check_duration(recording: Recording) -> None:
    duration = recording.time[-1] - recording.time[0]
    if recording.duty.any() and duration < SHORTEST:
        raise CalibrationError(
            f"wires are heated for {duration:.1f} s only; they take seconds to heat and to cool, "
            f"so record {SHORTEST:.0f} s at least."
        )


def _check_gravity(recording: Recording) -> None:
    gravity = recording.parameters.gravity
    size = float(np.linalg.norm(gravity))
    if size and not EARTH[0] < size < EARTH[1]:
        raise CalibrationError(
            f"the header's gravity is {size:.3g} m/s², but it must be 9.81 m/s², or zero for a "
            "limb that lies level; correct the header."
        )
    if recording.duty.any() and np.hypot(gravity[0], gravity[1]) > 1.0:
        raise CalibrationError(
            f"wires are heated while gravity {list(gravity)} bends the limb; record it level, with "
            "gravity zero in the header."
        )


def _check_units(recording: Recording, *, may_be_warm: bool = False) -> None:
    ambient = recording.parameters.ambient_temperature
    first = np.median(recording.measured_temperature[:, : _window(recording)], axis=1)
    if may_be_warm:
        first = np.minimum(first, recording.measured_temperature.min())
    for name, value in zip(recording.parameters.wire_names, first, strict=True):
        if abs(value - (ambient + 273.15)) < 25.0:
            raise CalibrationError(
                f"the {name} thermocouple reads {value:.0f} at the start; it seems to be in "
                "kelvin, but must be in °C."
            )
        if ambient > 10.0 and abs(value - (1.8 * ambient + 32.0)) < 15.0:
            raise CalibrationError(
                f"the {name} thermocouple reads {value:.0f} at the start, where ambient is "
                f"{ambient:g} °C; is it in degrees Fahrenheit, or still hot?"
            )
    largest = np.abs(recording.bend_angle - recording.bend_angle[:, :1]).max()
    heated = recording.duty.sum(axis=1).max() / recording.sample_rate
    warmed = np.ptp(recording.measured_temperature, axis=1).max()
    if heated > HEATED and warmed > 20.0 and 1e-3 < largest < np.deg2rad(1.6):
        raise CalibrationError(
            f"the bend angle is at most {np.rad2deg(largest):.2f}° while a wire warms by "
            f"{warmed:.0f} °C; is it in radians? Files must have degrees."
        )


def _check_readings(recording: Recording) -> None:
    """Whether all sensors are connected."""
    measured, names = recording.measured_temperature, recording.parameters.wire_names
    typical = np.median(measured, axis=1)
    for index, name in enumerate(names):
        others = [recording.parameters.ambient_temperature, *np.delete(typical, index)]
        if typical[index] < min(others) - COLDER:
            raise CalibrationError(
                f"the {name} thermocouple reads {typical[index]:.0f} °C, far below ambient and the "
                "others; is it connected?"
            )
        jump = np.median(np.abs(np.diff(measured[index])))
        if jump > JUMPS:
            raise CalibrationError(
                f"readings of the {name} thermocouple jump by {jump:.0f} °C from one to the next; "
                "is it connected?"
            )
    heated = recording.duty.sum(axis=1).max() / recording.sample_rate
    if heated > HEATED and not np.ptp(recording.bend_angle) > 0:
        raise CalibrationError(
            f"the bend angle stays at {np.rad2deg(recording.bend_angle[0, 0]):.1f}° while wires "
            "are heated; is the bend sensor connected?"
        )


def _exchanged(recording: Recording) -> tuple[int, int] | None:
    """Two wires, if any, each of which is as warm as the duty of the other would have it."""
    # scipy.signal takes longer to import than all the rest.
    from scipy.signal import lfilter

    memory = np.exp(-1 / recording.sample_rate / COOLING_TIME)
    heat = lfilter([1 - memory], [1, -memory], recording.duty, axis=1)
    warmth = recording.measured_temperature
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
    rise = smooth.max(axis=1) - smooth[:, :width].mean(axis=1)
    directions = np.array([wire.direction for wire in recording.parameters.wires])
    for index, name in enumerate(names):
        if dose[index] < HEATED or rise[index] >= RISE:
            continue
        other = int(np.argmax(np.where(dose < HEATED, rise, -np.inf)))
        if dose[other] < HEATED and rise[other] >= RISE:
            angle = recording.bend_angle[0]
            bent = angle[np.argmax(smooth[other])] - np.median(angle[:width])
            if np.sign(directions[index]) * bent < -BENT:
                raise CalibrationError(
                    f"duty for the {name} wire warms the {names[other]} thermocouple and bends the "
                    "limb away from its own side: the wires' outputs are swapped."
                )
            raise CalibrationError(
                f"duty for the {name} wire warms the {names[other]} thermocouple: the "
                "thermocouples are swapped."
            )
        raise CalibrationError(
            f"the {name} thermocouple is dead: it moves by {max(rise[index], 0.0):.1f} °C while "
            f"its wire gets {dose[index]:.1f} s of full duty in all."
        )
    excess = smooth - smooth[:, :width].mean(axis=1, keepdims=True)
    signal = np.convolve(recording.bend_angle[0], kernel, "valid")
    drive = directions @ excess
    moves = np.ptp(signal) > 2 * BENT and np.ptp(drive) > 0
    agreement = np.corrcoef(drive, signal)[0, 1] if moves else 0.0
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
