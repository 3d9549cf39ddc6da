"""The room, the rest angle and the first readings of wires, by recordings of a cold limb."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

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


class ColdReading(NamedTuple):
    """A thermocouple's reading of its wire in a recording, while the wire seems to be cold.

    - ``is_heated``: whether the wire is heated later.
    - ``moves``: whether the thermocouple ever reads something else.
    - ``start``, ``lowest``: reading at the start, or median without heat, and lowest reading, °C.
    """

    is_heated: bool
    moves: bool
    start: float
    lowest: float


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
    is_start = at_start(recording)
    readings = np.ma.masked_array(recording.measured_temperature, ~is_start)
    return readings.mean(axis=1).filled(np.nan)


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
    # Collect a cold reading of each thermocouple in each recording, by wire.
    readings: dict[str, list[ColdReading]] = {}
    rooms = []
    for recording in recordings:
        rooms.append(recording.parameters.ambient_temperature)
        is_start = at_start(recording)
        for index in np.flatnonzero(is_start.any(axis=1)).tolist():
            measured = recording.measured_temperature[index]
            read = measured[~np.isnan(measured)]
            heats = bool(recording.duty[index].any())
            start = float(np.median(measured[is_start[index]] if heats else read))
            lowest = float(np.quantile(read, 0.02))
            reading = ColdReading(heats, bool(np.ptp(read) > 0), start, lowest)
            readings.setdefault(recording.parameters.wire_names[index], []).append(reading)
    described = float(np.mean(rooms))
    if not readings:
        return Estimate(described, 0.0, "°C")
    # If all recordings start warm, their coldest readings count.
    lowest = _lowest_room(readings, "start", described)
    coldest = _lowest_room(readings, "lowest", described)
    if coldest < lowest - COLD_SPREAD:
        if described + COLD_SPREAD < coldest < described + MAX_ROOM_ERROR:
            return Estimate(described, (coldest - described) / 2, "°C")
        lowest = coldest
        counted = "lowest"
    else:
        counted = "start"
    # Take the median of each thermocouple, of unheated wires if there are any.
    medians = []
    errors = []
    for of_wire in readings.values():
        temperatures = np.array([getattr(reading, counted) for reading in of_wire])
        is_heated = np.array([reading.is_heated for reading in of_wire])
        is_cold = np.abs(temperatures - lowest) < COLD_SPREAD
        if not is_cold.any():
            continue
        is_cold_unheated = is_cold & ~is_heated
        group = temperatures[is_cold_unheated if is_cold_unheated.any() else is_cold]
        medians.append(np.median(group))
        errors.append(np.std(group) / np.sqrt(len(group)))
    mean = float(np.mean(medians))
    if mean > described + MAX_ROOM_ERROR:
        raise CalibrationError(
            f"The lowest readings of all recordings are {mean:.0f} °C, where ambient is "
            f"{described:g} °C: are they in degrees Fahrenheit? If not, record the limb from cold, "
            "or until it is cold."
        )
    spread = np.hypot(max(np.std(medians), SENSOR_SPREAD), max(errors)) / np.sqrt(len(medians))
    return Estimate(mean, float(spread), "°C")


def _lowest_room(readings: dict[str, list[ColdReading]], field: str, described: float) -> float:
    """Return the lowest reading, °C, of thermocouples that move and are not far below others.

    Raises:
        CalibrationError: if no thermocouple moves.
    """
    lows = []
    for of_wire in readings.values():
        of_moving = [getattr(reading, field) for reading in of_wire if reading.moves]
        if of_moving:
            lows.append(min(of_moving))
    if not lows:
        raise CalibrationError(
            "No thermocouple ever moves in these recordings, so that T0 cannot be told: are they "
            "connected?"
        )
    # Leave out disconnected thermocouples.
    sorted_lows = np.sort(lows)
    usual_low = sorted_lows[np.argmin(np.abs(sorted_lows - described))]
    return float(sorted_lows[sorted_lows > usual_low - DISCONNECTED_BELOW][0])


def rest_angles(recordings: Sequence[Recording], ambient: float) -> list[Estimate]:
    """Return the bend angle at rest towards each axis, as the mean over level recordings.

    Ring-downs show it at their end, heated recordings at their beginning, or else at their
    end, if all wires are cold then. Its standard error follows from the sensor's drift, or from the
    recordings' scatter. Zero where none shows it.
    """
    # Ring-downs rest at their end, heated recordings at their beginning, or else at their end.
    at_once: list[tuple[Recording, np.ndarray]] = []
    cooled: list[tuple[Recording, np.ndarray]] = []
    num_bends = 1
    for recording in recordings:
        num_bends = max(num_bends, len(recording.bend_angle))
        if gravity_bends(recording.parameters):
            continue
        end = _is_end(recording, END_TIME)
        start = before_heat(recording).all(axis=0) & _first_second(recording)
        at_once.append((recording, start if recording.duty.any() else end))
        if not recording.duty[:, _is_end(recording, COOLING_TIME)].any():
            cooled.append((recording, end))
    angles, drifts = _cold_angles(at_once, ambient)
    if not angles:
        angles, drifts = _cold_angles(cooled, ambient)
    if not angles:
        return [Estimate(0.0, 0.0, "rad")] * num_bends
    # The scatter of recordings, or the sensor's drift, is the error.
    spreads = np.hypot(np.std(angles, axis=0), np.mean(drifts)) / np.sqrt(len(angles))
    medians = np.median(angles, axis=0)
    return list(map(Estimate, medians.tolist(), spreads.tolist(), ["rad"] * len(medians)))


def _is_end(recording: Recording, duration: float) -> np.ndarray:
    """Return whether each sample is within a duration, s, of the recording's end (K,)."""
    return recording.time > recording.time[-1] - duration


def _cold_angles(
    stretches: Iterable[tuple[Recording, np.ndarray]], ambient: float
) -> tuple[list[np.ndarray], list[float]]:
    """Return bend angles (F,) and sensors' drifts, rad, of samples (K,) with cold wires."""
    angles = []
    drifts = []
    for recording, stretch in stretches:
        is_used = stretch & ~recording.missing
        readings = recording.measured_temperature[recording.has_thermocouple][:, is_used]
        if is_used.any() and not (readings.mean(axis=1) > ambient + COLD_SPREAD).any():
            sensor = bend_sensor_of(recording)
            bends = sensor.unrolled_bends(recording.bend_angle[:, is_used])
            angles.append(np.median(bends, axis=1))
            drifts.append(sensor.drift)
    return angles, drifts
