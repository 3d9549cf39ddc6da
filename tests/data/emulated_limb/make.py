"""Record emulated limb 7 at 4 Hz, and calibrate it; see the README beside this file."""

import dataclasses
from pathlib import Path

import numpy as np
from loggers import logged

from calibration import calibrate, collect_from_twin, save_recordings
from hardware import LimbTwin

FOLDER = Path(__file__).parent

recordings = collect_from_twin(
    LimbTwin(seed=7), num_angles=3, longest=40.0, cooling_time=200.0, sag_trials=3, ring_downs=1
)
for kind, group in recordings.items():
    if kind != "ring_down":
        slow = [logged(recording, 4.0) for recording in group]
        recordings[kind] = [dataclasses.replace(r, duty=np.round(r.duty, 4)) for r in slow]
save_recordings(recordings, FOLDER)
calibrate(FOLDER).parameters.save(FOLDER / "calibrated.yaml")
