"""Calibrate a limb from the CSV files of your own data logger.

    python examples/calibrate_from_csv.py [FOLDER] [-l LIMB.yaml] [-o FOLDER]

Adapt `to_recording` to your columns. Files are named sag_1, ring_down_1, left_1, right_1, both_1.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

import calibration
from hardware import LimbTwin
from limb_systems import LimbParameters, Recording
from soft_limb.reports.calibration import write_report
from soft_limb.results.summaries import calibration_summary


def to_recording(path, limb):
    log = np.genfromtxt(path, delimiter=",", names=True)
    sag = path.stem.startswith("sag")  # mounted so that gravity bends it to the left
    return Recording(
        time=log["ms"] / 1000,
        duty=[log["duty_l"], log["duty_r"]],
        measured_temperature=[log["temp_l"], log["temp_r"]],
        bend_angle=[np.deg2rad(log["degrees"])],
        parameters=dataclasses.replace(limb, gravity=[0.0, -9.81 if sag else 0.0, 0.0]),
        source=str(path),
        sample_rate=1000 / np.median(np.diff(log["ms"])),
    )


def log_emulated_limb(limb, folder):
    """What a lab's logger might write, of fewer and shorter equilibria than one should record."""
    few = {"num_angles": 2, "longest": 25, "cooling_time": 60, "ring_downs": 1, "protocol": "paper"}
    csv = {"delimiter": ",", "comments": "", "header": "ms,duty_l,duty_r,temp_l,temp_r,degrees"}
    folder.mkdir(parents=True, exist_ok=True)
    for kind, group in calibration.collect_from_twin(LimbTwin(limb), **few).items():
        for number, r in enumerate(group, 1):
            columns = 1000 * r.time, *r.duty, *r.measured_temperature, *np.rad2deg(r.bend_angle)
            np.savetxt(folder / f"{kind}_{number}.csv", np.transpose(columns), "%.6g", **csv)
    return folder


parser = argparse.ArgumentParser(description="Calibrates a limb from a data logger's files.")
parser.add_argument("folder", nargs="?", type=Path, help="of CSV files; emulated if left out")
parser.add_argument("-l", "--limb", type=LimbParameters.load, default=LimbParameters())
parser.add_argument("-o", "--out", type=Path, default="out", help="folder for the results")
options = parser.parse_args()
folder = options.folder or log_emulated_limb(options.limb, options.out / "emulated_log")
recordings = {
    kind: [to_recording(path, options.limb) for path in sorted(folder.glob(f"{kind}*.csv"))]
    for kind in calibration.kinds_of(options.limb)
}
result = calibration.calibrate(recordings, options.limb)
result.parameters.save(options.out / "limb.yaml")
write_report(result, options.out / "calibration.html")
print(calibration_summary(result), f"written               {options.out}, from {folder}", sep="\n")
