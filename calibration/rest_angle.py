"""Where a limb rests while its wires are cold."""

from collections.abc import Iterable

import numpy as np

from calibration.bend_sensor import bend_sensor_of
from calibration.course import at_start, without_missing
from calibration.estimate import Estimate
from limb_systems import Recording

LATE = 2.0  # s, at the end of recordings without heat
COLD = 3.0  # °C above T0, within which a wire counts as cold


def rest_angle(recordings: Iterable[Recording], ambient: float) -> Estimate:
    """The bend angle at rest, as the mean over level recordings that show it.

    Ring-downs show it at their end, heated recordings at their beginning, if all
    wires are cold then. Its standard error is that of the sensor's drift, or of the
    recordings' scatter. Zero where none shows it.
    """
    angles, drifts = [], []
    for recording in recordings:
        if np.linalg.norm(recording.parameters.gravity[:2]) > 1.0:
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
