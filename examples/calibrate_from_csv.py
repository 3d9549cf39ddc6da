"""Calibrate a limb from the logs of your own data logger.

    python examples/calibrate_from_csv.py [LOG.csv ...] [-m MAPPING.yaml] [-l LIMB.yaml] [-o FOLDER]

A log named sag_1, ring_down_1, left_1, right_1, both_1 or motion_1 is a recording of that kind; the
kind of any other log is taken from its data. `soft-limb import` does the same.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

import calibration
from calibration.import_logs.importing import import_logs
from calibration.import_logs.mapping import LogMapping
from hardware import LimbTwin
from limb_systems import LimbError, LimbParameters
from soft_limb.reports.calibration_report import write_report
from soft_limb.results.summaries import calibration_summary


def log_emulated_limb(limb, folder):
    """Write logs as a lab's logger might, of few and short equilibria; return their paths."""
    few = {"num_angles": 2, "longest": 25, "cooling_time": 60, "ring_downs": 1, "protocol": "paper"}
    header = "ms,pwm_l [0-255],pwm_r [0-255],temp_l,temp_r,bend_deg"
    csv = {"delimiter": ",", "comments": "", "header": header}
    folder.mkdir(parents=True, exist_ok=True)
    for kind, recordings in calibration.collect_from_twin(LimbTwin(limb), **few).items():
        for number, recording in enumerate(recordings, 1):
            columns = [
                1000 * recording.time,
                *np.round(255 * recording.duty),
                *recording.measured_temperature,
                *np.rad2deg(recording.bend_angle),
            ]
            np.savetxt(folder / f"{kind}_{number}.csv", np.transpose(columns), "%.6g", **csv)
    return sorted(folder.glob("*.csv"))


parser = argparse.ArgumentParser(description="Calibrate a limb from a data logger's files.")
parser.add_argument("logs", nargs="*", type=Path, help="logs; of an emulated limb if left out")
parser.add_argument("-m", "--mapping", type=Path, help="meaning of the columns (.yaml)")
parser.add_argument("-l", "--limb", type=Path, help="description of the limb (.yaml)")
parser.add_argument("-o", "--out", type=Path, default="out", help="folder for the results")
options = parser.parse_args()
out = options.out
try:
    # Read the logs, and save them as recordings.
    mapping = options.mapping and LogMapping.load(options.mapping)
    limb = LimbParameters.of(options.limb)
    imported = import_logs(options.logs or log_emulated_limb(limb, out / "log"), mapping, limb)
    imported[0].limb.mapping.save(out / "mapping.yaml")
    for log in imported:
        print(log.path, *log.limb.notes, *log.remarks, sep="\n  ")
        if log.error:
            raise LimbError(f"{log.error} Correct {out / 'mapping.yaml'} and give it with -m.")
        for name, recording in zip(log.files, log.recordings, strict=True):
            recording.save(out / "recordings" / name)
    # Calibrate the limb.
    result = calibration.calibrate(out / "recordings", limb)
    result.parameters.save(out / "limb.yaml")
    write_report(result, out / "calibration.html")
    print(calibration_summary(result), f"written               {out}", sep="\n")
except LimbError as error:
    sys.exit(f"error: {error}")
