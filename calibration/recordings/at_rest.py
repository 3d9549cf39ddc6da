"""The room, the rest angle and the first readings of wires, by recordings of a cold limb."""

from collections.abc import Iterable, Sequence

import numpy as np

from calibration.estimate import Estimate
from calibration.recordings.kinds import bend_sensor_of, gravity_bends
from calibration.remarks import CalibrationError
from limb_systems import Recording

START_TIME = 1.0  # s, over which the first readings are averaged
# s, at the end of recordings, and without heat before that
END_TIME = 2.0
COOLING_TIME = 60.0
COLD_SPREAD = 3.0  # °C, by which readings of cold wires may differ
MAX_ROOM_ERROR = 25.0  # °C, by which no room is warmer than its description
DISCONNECTED_BELOW = 10.0  # °C, by which a connected thermocouple is not colder than others
SENSOR_SPREAD = 0.25  # °C, by which thermocouples of a kind differ


def before_heat(recording: Recording) -> np.ndarray:
    """Return whether a wire was not yet heated (W, K); the first sample counts.

    The duty at a sample was in force since the sample before; the first sample's duty, before the
    recording.
    """
    later = np.cumsum(recording.duty[:, 1:] > 0, axis=1) == 0
    return np.column_stack([np.ones(len(later), bool), later])


def at_start(recording: Recording) -> np.ndarray:
    """Return whether a sample is of the first second, before its wire is heated (W, K), and read.

    Where none of these is read, the first that is counts.
    """
    is_read = ~np.isnan(recording.measured_temperature)
    is_start = before_heat(recording) & _first_second(recording) & is_read
    late_wires = np.flatnonzero(~is_start.any(axis=1) & is_read.any(axis=1))
    is_start[late_wires, np.argmax(is_read[late_wires], axis=1)] = True
    return is_start


def _first_second(recording: Recording) -> np.ndarray:
    """Return whether each sample is within the first second, or among the first three (K,)."""
    since = recording.time - recording.time[0]
    return since <= max(START_TIME, 2.5 / recording.sample_rate)


def first_readings(recording: Recording) -> np.ndarray:
    """Return V at the beginning (W,), °C; nan without a thermocouple."""
    readings = zip(recording.measured_temperature, at_start(recording), strict=True)
    return np.array([row[start].mean() if start.any() else np.nan for row, start in readings])


def ambient_temperature(recordings: Iterable[Recording]) -> Estimate:
    """Estimate T0 by the readings of thermocouples while their wires are cold.

    From each recording in which a wire stays unheated its median, and from each of
    others its first second, or its coldest if all of them start warm. Those within 3 °C of
    the lowest count, as others were not cold. If all start warm and none becomes as cold as the
    ambient temperature in their headers, that one counts: wires do not cool below the room. A
    thermocouple far below the others is
    disconnected, and one that never moves is dead, unless it agrees with others. T0 is the
    mean over thermocouples of the median of each. The standard error follows from their
    scatter, and from the difference of two thermocouples, as one reads alike in all recordings.

    Without any thermocouple, T0 is what the headers say.

    Raises:
        CalibrationError: if no thermocouple shows it, or if no room is as warm.
    """
    recordings = list(recordings)
    if not any(recording.has_thermocouple.any() for recording in recordings):
        rooms = [recording.parameters.ambient_temperature for recording in recordings]
        return Estimate(float(np.mean(rooms)), 0.0, "°C")
    # Collect a cold reading of each thermocouple in each recording.
    readings = []
    cooled = []
    expected = []
    for recording in recordings:
        expected.append(recording.parameters.ambient_temperature)
        for name, duty, measured, is_start in zip(
            recording.parameters.wire_names,
            recording.duty,
            recording.measured_temperature,
            at_start(recording),
            strict=True,
        ):
            if not is_start.any():
                continue
            heated = bool(duty.any())
            present = measured[~np.isnan(measured)]
            reading = float(np.median(measured[is_start] if heated else present))
            readings.append((name, heated, bool(np.ptp(present) > 0), reading))
            cooled.append((*readings[-1][:3], float(np.quantile(present, 0.02))))
    moving = {name for name, _, moves, _ in readings if moves}
    if not moving:
        raise CalibrationError(
            "No thermocouple ever moves in these recordings, so that T0 cannot be told: are they "
            "connected?"
        )

    def lowest_of(readings: list[tuple[str, bool, bool, float]]) -> float:
        lows = [min(r for n, _, moves, r in readings if moves and n == name) for name in moving]
        usual_low = min(lows, key=lambda reading: abs(reading - np.mean(expected)))
        return min(reading for reading in lows if reading > usual_low - DISCONNECTED_BELOW)

    # If all recordings start warm, their coldest readings count.
    lowest = lowest_of(readings)
    described = float(np.mean(expected))
    if lowest_of(cooled) < lowest - COLD_SPREAD:
        readings = cooled
        lowest = lowest_of(cooled)
        if described + COLD_SPREAD < lowest < described + MAX_ROOM_ERROR:
            return Estimate(described, (lowest - described) / 2, "°C")
    # Take the median of each thermocouple, of unheated wires if there are any.
    sensors = []
    for name in dict.fromkeys(name for name, *_ in readings):
        usable = [(h, r) for n, h, _, r in readings if n == name and abs(r - lowest) < COLD_SPREAD]
        unheated = [reading for heated, reading in usable if not heated]
        if usable:
            group = unheated or [reading for _, reading in usable]
            sensors.append((np.median(group), np.std(group) / np.sqrt(len(group))))
    medians, errors = np.array(sensors).T
    if medians.mean() > described + MAX_ROOM_ERROR:
        raise CalibrationError(
            f"The lowest readings of all recordings are {medians.mean():.0f} °C, where ambient is "
            f"{described:g} °C: are they in degrees Fahrenheit? If not, record the limb from cold, "
            "or until it is cold."
        )
    spread = np.hypot(max(np.std(medians), SENSOR_SPREAD), errors.max()) / np.sqrt(len(sensors))
    return Estimate(float(medians.mean()), float(spread), "°C")


def rest_angles(recordings: Sequence[Recording], ambient: float) -> list[Estimate]:
    """Return the bend angle at rest towards each axis, as the mean over level recordings.

    Ring-downs show it at their end, heated recordings at their beginning, or else at their
    end, if all wires are cold then. Its standard error follows from the sensor's drift, or from the
    recordings' scatter. Zero where none shows it.
    """
    level = [r for r in recordings if not gravity_bends(r.parameters)]
    # Ring-downs rest at their end, heated recordings at their beginning.
    starts = [
        recording.time > recording.time[-1] - END_TIME
        if not recording.duty.any()
        else before_heat(recording).all(axis=0) & _first_second(recording)
        for recording in level
    ]
    angles, drifts = _cold_angles(level, starts, ambient)
    # Or else limbs that have cooled at the end.
    if not angles:
        ending_cold = [r for r in level if not r.duty[:, r.time > r.time[-1] - COOLING_TIME].any()]
        ends = [recording.time > recording.time[-1] - END_TIME for recording in ending_cold]
        angles, drifts = _cold_angles(ending_cold, ends, ambient)
    if not angles:
        return [Estimate(0.0, 0.0, "rad")] * max((len(r.bend_angle) for r in recordings), default=1)
    spreads = np.hypot(np.std(angles, axis=0), np.mean(drifts)) / np.sqrt(len(angles))
    medians = np.median(angles, axis=0)
    pairs = zip(medians.tolist(), spreads.tolist(), strict=True)
    return [Estimate(median, spread, "rad") for median, spread in pairs]


def _cold_angles(
    recordings: Iterable[Recording], stretches: Iterable[np.ndarray], ambient: float
) -> tuple[list[np.ndarray], list[float]]:
    """Return the bend angles (F,) and sensors' drifts, rad, of stretches (K,) with cold wires."""
    angles = []
    drifts = []
    for recording, stretch in zip(recordings, stretches, strict=True):
        is_used = stretch & ~recording.missing
        readings = recording.measured_temperature[recording.has_thermocouple][:, is_used]
        if is_used.any() and not (readings.mean(axis=1) > ambient + COLD_SPREAD).any():
            sensor = bend_sensor_of(recording)
            bends = sensor.unrolled_bends(recording.bend_angle[:, is_used])
            angles.append(np.median(bends, axis=1))
            drifts.append(sensor.drift)
    return angles, drifts
