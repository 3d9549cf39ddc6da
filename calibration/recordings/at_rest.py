"""What recordings show of a limb while it is cold: the room, the rest angle, where wires start."""

from collections.abc import Iterable

import numpy as np

from calibration.errors import CalibrationError
from calibration.estimate import Estimate
from calibration.recordings.kinds import bend_sensor_of, gravity_bends
from calibration.recordings.repair import without_missing
from limb_systems import Recording

START = 1.0  # s, over which the first readings are averaged
LATE = 2.0  # s, at the end of recordings without heat
COLD = 3.0  # °C, by which readings of cold wires may differ
FAR_BELOW = 10.0  # °C, by which a connected thermocouple is not colder than others
SENSOR_SPREAD = 0.25  # °C, by which thermocouples of a kind differ


def before_heat(recording: Recording) -> np.ndarray:
    """Whether a wire was not yet heated (W, K); the first sample counts.

    The duty at a sample was in force since the sample before, and that of the first one
    before the recording.
    """
    later = np.cumsum(recording.duty[:, 1:] > 0, axis=1) == 0
    return np.column_stack([np.ones(len(later), bool), later])


def at_start(recording: Recording) -> np.ndarray:
    """Whether a sample is of the first second, before its wire is heated (W, K), and not missing.

    Where all of these are missing, the first that is not counts.
    """
    since, shown = recording.time - recording.time[0], ~recording.missing
    soon = before_heat(recording) & (since <= max(START, 2.5 / recording.sample_rate)) & shown
    soon[~soon.any(axis=1), np.argmax(shown)] = True
    return soon


def first_readings(recording: Recording) -> np.ndarray:
    """V at the beginning (W,), °C."""
    readings = zip(recording.measured_temperature, at_start(recording), strict=True)
    return np.array([measured[shown].mean() for measured, shown in readings])


def ambient_temperature(recordings: Iterable[Recording]) -> Estimate:
    """T0 as thermocouples read it while their wires are cold.

    From each recording in which a wire stays unheated its median, and from each of
    others its first second. Those within 3 °C of the lowest count, as others were not
    cold. A thermocouple far below the others is disconnected, and one that never moves
    is dead, unless it agrees with others. T0 is the mean over thermocouples of the
    median of each. The standard error is that of their scatter, and of what two
    thermocouples differ by, as one reads alike in all recordings.

    Raises:
        CalibrationError: if no thermocouple shows it.
    """
    readings, expected = [], []
    for recording in map(without_missing, recordings):
        expected.append(recording.parameters.ambient_temperature)
        for name, duty, measured, soon in zip(
            recording.parameters.wire_names,
            recording.duty,
            recording.measured_temperature,
            at_start(recording),
            strict=True,
        ):
            heated = bool(duty.any())
            reading = float(np.median(measured[soon] if heated else measured))
            readings.append((name, heated, bool(np.ptp(measured) > 0), reading))
    moving = {name for name, _, moves, _ in readings if moves}
    if not moving:
        raise CalibrationError(
            "No thermocouple ever moves in these recordings, so that T0 cannot be told: are they "
            "connected?"
        )
    coldest = [min(r for n, _, moves, r in readings if moves and n == name) for name in moving]
    usual = min(coldest, key=lambda reading: abs(reading - np.mean(expected)))
    lowest = min(reading for reading in coldest if reading > usual - FAR_BELOW)
    each = []
    for name in dict.fromkeys(name for name, *_ in readings):
        own = [(h, r) for n, h, _, r in readings if n == name and abs(r - lowest) < COLD]
        unheated = [reading for heated, reading in own if not heated]
        if own:
            group = unheated or [reading for _, reading in own]
            each.append((np.median(group), np.std(group) / np.sqrt(len(group))))
    medians, errors = np.array(each).T
    spread = np.hypot(max(np.std(medians), SENSOR_SPREAD), errors.max()) / np.sqrt(len(each))
    return Estimate(float(medians.mean()), float(spread), "°C")


def rest_angle(recordings: Iterable[Recording], ambient: float) -> Estimate:
    """The bend angle at rest, as the mean over level recordings that show it.

    Ring-downs show it at their end, heated recordings at their beginning, if all
    wires are cold then. Its standard error is that of the sensor's drift, or of the
    recordings' scatter. Zero where none shows it.
    """
    angles, drifts = [], []
    for recording in recordings:
        if gravity_bends(recording.parameters):
            continue
        heated = recording.duty.any()
        recording = without_missing(recording)
        shown = (
            at_start(recording).all(axis=0)
            if heated
            else recording.time > recording.time[-1] - LATE
        )
        if (recording.measured_temperature[:, shown].mean(axis=1) > ambient + COLD).any():
            continue
        sensor = bend_sensor_of(recording)
        angles.append(float(np.median(sensor.corrected(recording.bend_angle[0, shown]))))
        drifts.append(sensor.drift)
    if not angles:
        return Estimate(0.0, 0.0, "rad")
    spread = np.hypot(np.std(angles), np.mean(drifts)) / np.sqrt(len(angles))
    return Estimate(float(np.median(angles)), float(spread), "rad")
