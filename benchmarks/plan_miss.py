"""The share of plans that miss by what a calibration says, on emulated limbs of two physics.

Each limb is recorded by `excitations`, and calibrated from all recordings ("all") and from its
pulses alone ("pulses"). Three motions are planned with each calibration, and driven in open loop:
by the limb as it is after five minutes without heat, and in a room that is 3 °C warmer with 3% more
supply. Shown are what the verdict says and the mean
|φ* - φ| as read; then how many are in the range that was said, and below its upper end. All are
emulations.

A limb takes about a minute and a half of one core.

    python benchmarks/plan_miss.py [--limbs 4] [--first 500] [--jobs 2]
"""

import argparse
import copy
import multiprocessing
import os
import sys
from collections import Counter
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: a process for each core
sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))  # for reproduce_paper

import numpy as np
import witness  # noqa: F401 (its physics)
from reproduce_paper.driving import PAUSE
from reproduce_paper.experiment import HANDS, taught_motion

from calibration import calibrate, collect_from_twin
from hardware import LimbTwin, replay
from hardware.emulation.twin import SPECIMENS
from limb_systems import LimbError
from limb_systems.tracking import tracking_errors
from planners import plan, references

PULSES = 2  # number of the recording of pulses among the heated ones
OTHER_DAY = {"ambient": 3.0, "supply": 1.03}


def take(limb: tuple[str, int]) -> list[dict]:
    """Return the expected and the actual miss of each plan of a limb, degrees."""
    physics, seed = limb
    twin = LimbTwin(seed=seed, physics=physics)
    kinds = collect_from_twin(twin, seed=seed, sag_trials=0, ring_downs=1, protocol="excitation")
    motions = {"Fig. 5": references.step_and_decaying_sine()}
    motions |= {name: taught_motion(name) for name in HANDS}
    rows = []
    for data, recordings in (("all", kinds), ("pulses", {"heated": [kinds["heated"][PULSES]]})):
        row = {"physics": physics, "seed": seed, "data": data}
        try:
            calibration = calibrate(recordings)
        except LimbError as error:
            rows.append({**row, "said": str(error), "missed": {}})
            continue
        miss = calibration.plan_miss
        missed = {}
        for name, reference in motions.items():
            try:
                trajectory = plan(calibration.parameters, reference)
            except LimbError as error:
                missed[name] = str(error)
                continue
            for day in ("same day", "other day"):
                specimen = copy.deepcopy(twin.specimen)
                if day == "other day":
                    specimen = specimen.disturbed(**OTHER_DAY)
                driven = replay(trajectory, LimbTwin(specimen=specimen).after_rest(PAUSE))
                error = tracking_errors(trajectory, [driven]).mean
                missed[f"{name}, {day}"] = float(np.rad2deg(error))
        judged = float(np.rad2deg(calibration.prediction.best.bend_error))
        said = dict(zip(("low", "high"), np.rad2deg([miss.low, miss.high]).tolist(), strict=True))
        rows.append(
            {**row, "said": calibration.verdict, "judged": judged, **said, "missed": missed}
        )
    return rows


def show(rows: list[dict]) -> None:
    counts: dict[tuple[str, str, str], Counter] = {}
    for row in rows:
        print(f"{row['physics']} {row['seed']}, {row['data']}: {row['said']}")
        for name, missed in row["missed"].items():
            if isinstance(missed, str):
                print(f"    {name}: {missed}")
                continue
            print(f"    {name}: {missed:.1f}°")
            count = counts.setdefault((row["physics"], row["data"], name.split(", ")[1]), Counter())
            count.update(
                plans=1,
                within=row["low"] <= missed <= row["high"],
                below=missed <= row["high"],
                judged=missed <= row["judged"],
            )
    for names, c in counts.items():
        print(
            f"{', '.join(names)}: {c['plans']} plans, {c['within']} in the range, {c['below']} "
            f"below its upper end, {c['judged']} below the mean error of what judged the laws"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--limbs", type=int, default=4, help="of each physics")
    parser.add_argument("--first", type=int, default=500, help="seed of the first limb")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default %(default)s)")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.limbs)
    limbs = [(physics, seed) for physics in SPECIMENS for seed in seeds]
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        show([row for rows in pool.imap(take, limbs) for row in rows])


if __name__ == "__main__":
    main()
