"""What a lab may expect of a new limb: many emulated ones, each taken from the shelf to its plans.

Each limb is recorded, calibrated, planned for and driven once, for the motion
of Fig. 5 and for two that are taught. It is an emulation, and the seeds are not
those of the evaluation. Shown are

- how well each recording was predicted before it was fitted, in the order in
  which they are made: what a lab may expect when it stops there;
- how well plans are followed, and how well motions were said to be predicted;
- in which share of the plans a reading passes the limit of the board, as was
  predicted from the calibration's covariance, and as was seen.

A limb takes about a minute of one core. What is finished is in the file, and a
run that was stopped goes on from there.

    python benchmarks/unseen_limbs.py FILE [--limbs 200] [--first 1000] [--jobs 2]
"""

import argparse
import json
import multiprocessing
import os
import re
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: a process for each core
sys.path.append(str(Path(__file__).parents[1] / "examples"))

import numpy as np

from calibration import calibrate, collect_from_twin
from evaluation.experiment import HANDS, NUM_ANGLES, PAUSE, SMOOTHING_TIME, hand_course
from hardware import LimbTwin, replay, watch
from hardware.emulation.specimen import Specimen
from limb_systems import LimbError, LimbParameters, band
from limb_systems.progress import Progress
from limb_systems.tracking import tracking_errors
from planners import Task, plan, references

TOLD = re.compile(r"(?P<name>.+): predicted to (?P<bend>[\d.]+)° and (?P<heat>[\d.]+) °C")


def take(seed: int) -> dict:
    """A limb from its first recording to its last rollout; angles in degrees."""
    sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - progress of several limbs at once
    specimen, told = Specimen(LimbParameters(), seed), []
    recordings = collect_from_twin(
        LimbTwin(specimen=specimen), seed=seed, num_angles=NUM_ANGLES, tell=told.append
    )
    started = time.perf_counter()
    calibration = calibrate(recordings)
    calibrating = time.perf_counter() - started
    record = calibration.parameters.calibration
    assert record is not None
    assert calibration.prediction is not None
    plans = []
    for name in ("Validation", *HANDS):
        reference = references.step_and_decaying_sine()
        if name in HANDS:
            hand = hand_course(name)
            taught = watch(LimbTwin(specimen=specimen).again(PAUSE, hand=hand), hand.end_time())
            reference = references.from_recording(taught, SMOOTHING_TIME)
        try:
            trajectory = plan(calibration.parameters, reference, task=Task.paper())
        except LimbError as error:
            plans.append({"motion": name, "failure": str(error)})
            continue
        around = band(trajectory)
        assert around is not None
        rollout = replay(trajectory, LimbTwin(specimen=specimen).again(PAUSE))
        plans.append(
            {
                "motion": name,
                "solver": trajectory.check.solver,
                "total_time": trajectory.check.total_time,
                "error": np.rad2deg(tracking_errors(trajectory, [rollout]).mean),
                "predicted": around.aborted_share,
                "planned": trajectory.measured_temperature.max(),
                "highest": rollout.measured_temperature.max(),
                "aborted": bool(rollout.interrupted),
            }
        )
    matches = [TOLD.match(line) for line in told]
    return {
        "seed": seed,
        "law": calibration.prediction.best.name,
        "bend_error": np.rad2deg(record.bend_error),
        "temperature_error": record.temperature_error,
        "calibrating": calibrating,
        "recordings": [[m["name"], float(m["bend"]), float(m["heat"])] for m in matches if m],
        "plans": plans,
    }


def show(limbs: list[dict]) -> None:
    print(f"{len(limbs)} emulated limbs\n")
    print(f"{'recording, predicted before it was fitted':<42}{'mean':>7}{'90%':>8}{'V':>9}")
    for number, (name, _, _) in enumerate(limbs[0]["recordings"]):
        bends, heats = np.array([limb["recordings"][number][1:] for limb in limbs]).T
        bend, most = f"{bends.mean():.1f}°", f"{np.percentile(bends, 90):.1f}°"
        print(f"{name:<42}{bend:>7}{most:>8}{heats.mean():>6.1f} °C")
    bends, heats = (np.mean([limb[key] for limb in limbs]) for key in limbs[0] if "_error" in key)
    print(f"{'motions, by the law that was chosen':<42}{f'{bends:.1f}°':>7}{heats:>14.1f} °C")
    times = [limb["calibrating"] for limb in limbs]
    print(
        f"calibration: {np.median(times):.0f} s, at most {max(times):.0f} s, on one core of several"
    )
    laws = [limb["law"] for limb in limbs]
    print("laws chosen:", ", ".join(f"{law} {laws.count(law)}" for law in sorted(set(laws))))
    plans = [made for limb in limbs for made in limb["plans"]]
    found = [made for made in plans if "failure" not in made]
    print(f"\nplans: {len(plans)}, of which {len(found)} were found")
    for motion in dict.fromkeys(made["motion"] for made in found):
        errors = [made["error"] for made in found if made["motion"] == motion]
        print(
            f"  |φ* - φ| {motion:<12}{np.mean(errors):>6.2f}°, 90% {np.percentile(errors, 90):.2f}°"
        )
    above = [made["highest"] - made["planned"] for made in found]
    mean, most = np.mean(above), max(above)
    print(f"  highest V above the planned: mean {mean:+.2f} °C, at most {most:+.1f} °C")
    aborted = sum(made["aborted"] for made in found)
    print(
        f"  V passes the limit: predicted {np.mean([p['predicted'] for p in found]):.2%}, ", end=""
    )
    print(f"seen {aborted / len(found):.2%} ({aborted} of {len(found)})")
    for limb in limbs:
        for made in limb["plans"]:
            if made.get("aborted") or "failure" in made:
                print(f"  limb {limb['seed']}: {made}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, help="for the results, a line for each limb")
    parser.add_argument("--limbs", type=int, default=200, help="default %(default)s")
    parser.add_argument("--first", type=int, default=1000, help="seed of the first limb")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default %(default)s)")
    options = parser.parse_args()
    lines = options.file.read_text().splitlines() if options.file.exists() else []
    limbs = [json.loads(line) for line in lines]
    seeds = set(range(options.first, options.first + options.limbs))
    seeds -= {limb["seed"] for limb in limbs}
    context = multiprocessing.get_context("spawn")
    with context.Pool(options.jobs) as pool, Progress("limbs", len(seeds), "limbs") as progress:
        for done, limb in enumerate(pool.imap_unordered(take, sorted(seeds)), 1):
            limbs.append(limb)
            with options.file.open("a") as file:
                file.write(json.dumps(limb, ensure_ascii=False) + "\n")
            progress.update(done)
    if limbs:
        show(sorted(limbs, key=lambda limb: limb["seed"]))


if __name__ == "__main__":
    main()
