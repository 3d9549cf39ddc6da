"""What a lab may expect of a new limb: many emulated ones, each taken from the shelf to its plans.

The seeds are not those of the evaluation. Besides the physics of the evaluation, "lumped", limbs
may be of two others that share no law with it nor with the model: "continuum", and "other", which
is other_limbs.py. Each limb is recorded, calibrated, planned for, and driven along Fig. 5, ramps
and two motions that are taught. Shown are

- how well each recording was predicted before it was fitted, in the order in which they are made:
  what a lab may expect when it stops there;
- mean distances of the true bend, of the plan and of the best plan within the limits from the
  reference; from the plan as read and of the true bend; and the highest V and T;
- the share of open-loop plans in which a reading passes the limit of the board, as predicted from
  the calibration's covariance, and as seen.

All are emulations. A limb takes some two minutes of one core. What is finished is in the file, and
a run that was stopped goes on from there; give it the same options.

    python benchmarks/unseen_limbs.py FILE [--physics other] [--limbs 200] [--ways follow]
"""

import argparse
import dataclasses
import functools
import json
import os
import re
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: a process for each core
sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))  # for reproduce_paper

import numpy as np
from other_limbs import OTHER, limb_of
from reproduce_paper.experiment import HANDS, MOTIONS, NUM_ANGLES, hand_course, plan_motion
from reproduce_paper.tables import Followed, nearest_distance
from reproduce_paper.ways import CONTROLLERS, FEEDBACK, OPEN_LOOP, PAUSE, Way

from calibration import calibrate, collect_from_twin
from hardware import present_readings, replay, watch
from hardware.emulation.twin import SPECIMENS
from limb_systems import LimbError, band
from limb_systems.progress import Progress
from soft_limb.runs.jobs import run_each

TOLD = re.compile(r"(?P<name>.+): predicted to (?P<bend>[\d.]+)° and (?P<heat>[\d.]+) °C")
# Gravity does not bend limbs of the other physics.
EXCITATION = {"sag_trials": 0, "ring_downs": 1, "protocol": "excitation"}
COLUMNS = ("true_reference", "planned", "nearest", "read", "true")  # means, °


def take(seed: int, physics: str, ways: list[str]) -> dict:
    """A limb from its first recording to its last rollout; angles in degrees."""
    limb = limb_of(physics, seed)
    told: list[str] = []
    few = EXCITATION if physics == OTHER else {}
    kinds = collect_from_twin(limb, seed=seed, num_angles=NUM_ANGLES, tell=told.append, **few)
    calibration = calibrate({kind: group for kind, group in kinds.items() if group})
    parameters, taught, runs = calibration.parameters, {}, []
    for name in HANDS:
        hand = hand_course(name)
        taught[name] = watch(limb.again(PAUSE, hand=hand), hand.end_time())
    for motion in MOTIONS:
        for way in ways:
            run = {"motion": motion, "way": way}
            runs.append(run)
            loop, kind = OPEN_LOOP if way == OPEN_LOOP else FEEDBACK, CONTROLLERS.get(way)
            try:
                rested = limb.again(PAUSE, truth=True)
                trajectory = plan_motion(parameters, motion, taught, loop, present_readings(rested))
                controller = kind and kind(trajectory)
                made = Followed.of(
                    Way(trajectory, [replay(trajectory, rested, controller=controller)])
                )
            except LimbError as error:
                run["failure"] = str(error)
                continue
            around = band(trajectory)
            run |= dataclasses.asdict(made) | {
                "read": made.read,
                "nearest": nearest_distance(trajectory),
                "predicted": around.aborted_share if around else np.nan,
            }
    matches = [TOLD.match(line) for line in told]
    return {
        "seed": seed,
        "law": calibration.prediction.best.name,
        "bend_error": np.rad2deg(parameters.calibration.bend_error),
        "temperature_error": parameters.calibration.temperature_error,
        "recordings": [[m["name"], float(m["bend"]), float(m["heat"])] for m in matches if m],
        "runs": runs,
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
    laws = [limb["law"] for limb in limbs]
    print("laws chosen:", ", ".join(f"{law} {laws.count(law)}" for law in sorted(set(laws))))
    every = [run | {"seed": limb["seed"]} for limb in limbs for run in limb["runs"]]
    runs = [run for run in every if "failure" not in run]
    print(f"\n{'mean distance, °':<32}" + "".join(f"{c:>16}" for c in COLUMNS) + "  V and T, °C")
    for motion, way in dict.fromkeys((run["motion"], run["way"]) for run in runs):
        these = [run for run in runs if (run["motion"], run["way"]) == (motion, way)]
        means = np.nanmean([[run[c] for c in COLUMNS] for run in these], axis=0, dtype=float)
        hottest = (max(run[f"highest_{x}"] for run in these) for x in ("reading", "temperature"))
        print(
            f"{f'{motion}, {way}':<32}"
            + "".join(f"{mean:>16.2f}" for mean in means)
            + "".join(f"{x:>8.1f}" for x in hottest)
        )
    opened = [run for run in runs if run["way"] == OPEN_LOOP]
    if opened:
        predicted, aborted = (np.mean([r[key] for r in opened]) for key in ("predicted", "aborted"))
        print(f"V passes the limit in open loop: predicted {predicted:.2%}, seen {aborted:.2%}")
    for run in every:
        if "failure" in run or run["aborted"]:
            print(f"  limb {run['seed']}: {run}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, help="for the results, a line for each limb")
    parser.add_argument("--physics", choices=(*SPECIMENS, OTHER), default="lumped")
    parser.add_argument("--limbs", type=int, default=200, help="default %(default)s")
    parser.add_argument("--first", type=int, default=1000, help="seed of the first limb")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default %(default)s)")
    parser.add_argument("--ways", nargs="+", choices=(OPEN_LOOP, *CONTROLLERS), default=[OPEN_LOOP])
    options = parser.parse_args()
    lines = options.file.read_text().splitlines() if options.file.exists() else []
    limbs = [json.loads(line) for line in lines]
    seeds = set(range(options.first, options.first + options.limbs))
    seeds -= {limb["seed"] for limb in limbs}
    work = functools.partial(take, physics=options.physics, ways=options.ways)
    with Progress("limbs", len(seeds), "limbs") as progress:
        for done, limb in enumerate(run_each(work, sorted(seeds), options.jobs), 1):
            limbs.append(limb)
            with options.file.open("a") as file:
                file.write(json.dumps(limb, ensure_ascii=False) + "\n")
            progress.update(done)
    if limbs:
        show(sorted(limbs, key=lambda limb: limb["seed"]))


if __name__ == "__main__":
    main()
