"""What a lab may expect of a new limb: many emulated ones, each taken from the shelf to its plans.

Each limb is recorded, calibrated, planned for and driven once, for the motion
of Fig. 5 and for two that are taught. It is an emulation, and the seeds are not
those of the evaluation. Shown are

- how well each recording was predicted before it was fitted, in the order in
  which they are made: what a lab may expect when it stops there;
- how well plans are followed, and how well motions were said to be predicted;
- in which share of the plans a reading passes the limit of the board, as was
  predicted from the calibration's covariance, and as was seen.

With --feedback each motion is planned again with room for feedback, and driven
with it; shown are errors as read and of the true bend, and the highest V and T.

A limb takes about a minute of one core. What is finished is in the file, and a
run that was stopped goes on from there; give it the same options.

    python benchmarks/unseen_limbs.py FILE [--limbs 200] [--first 1000] [--jobs 2] [--feedback]
"""

import argparse
import dataclasses
import functools
import json
import os
import re
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: a process for each core

import numpy as np

from calibration import calibrate, collect_from_twin
from hardware import LimbTwin
from hardware.emulation.specimen import Specimen
from limb_systems import LimbError, LimbParameters, band
from limb_systems.progress import Progress
from soft_limb.evaluation.experiment import MOTIONS, NUM_ANGLES, plan_motion, teach
from soft_limb.evaluation.tables import Followed
from soft_limb.evaluation.ways import FEEDBACK, OPEN_LOOP, roll_out
from soft_limb.runs.jobs import local_executor, run_each

TOLD = re.compile(r"(?P<name>.+): predicted to (?P<bend>[\d.]+)° and (?P<heat>[\d.]+) °C")


def take(seed: int, feedback: bool) -> dict:
    """A limb from its first recording to its last rollout; angles in degrees."""
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
    rested, taught = teach(specimen)
    plans = []
    for number, name in enumerate(MOTIONS):
        motion = calibration.parameters, name, taught
        try:
            trajectory = plan_motion(*motion, OPEN_LOOP)
        except LimbError as error:
            plans.append({"motion": name, "failure": str(error)})
            continue
        around = band(trajectory)
        assert around is not None
        rollout = Followed.of(roll_out(rested, trajectory, OPEN_LOOP, 1, 2 * number))
        made = {
            "motion": name,
            "solver": trajectory.check.solver,
            "total_time": trajectory.check.total_time,
            "error": rollout.read,
            "true": rollout.true,
            "predicted": around.aborted_share,
            "planned": trajectory.measured_temperature.max(),
            "highest": rollout.highest_reading,
            "highest_temperature": rollout.highest_temperature,
            "aborted": bool(rollout.aborted),
        }
        if feedback:
            try:
                plan = plan_motion(*motion, FEEDBACK)
                closed = roll_out(rested, plan, FEEDBACK, 1, 2 * number + 1)
                made["feedback"] = dataclasses.asdict(Followed.of(closed))
            except LimbError as error:
                made["feedback"] = {"failure": str(error)}
        plans.append(made)
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
    show_feedback(found)
    aborted = sum(made["aborted"] for made in found)
    print(
        f"  V passes the limit: predicted {np.mean([p['predicted'] for p in found]):.2%}, ", end=""
    )
    print(f"seen {aborted / len(found):.2%} ({aborted} of {len(found)})")
    for limb in limbs:
        for made in limb["plans"]:
            failed = "failure" in made or "failure" in made.get("feedback", {})
            if failed or made.get("aborted") or made.get("feedback", {}).get("aborted"):
                print(f"  limb {limb['seed']}: {made}")


def show_feedback(found: list[dict]) -> None:
    """Beside open loop, for plans that were driven with feedback, too."""
    both = [made for made in found if "tracking" in made.get("feedback", {})]
    if not both:
        return
    print(f"  {'mean |φ* - φ|, read / true':<28}{'open loop':>15}{'feedback':>15}")
    for motion in dict.fromkeys(made["motion"] for made in both):
        group = [made for made in both if made["motion"] == motion]
        opened = np.mean([(made["error"], made["true"]) for made in group], axis=0)
        closed = [(made["feedback"]["tracking"][0], made["feedback"]["true"]) for made in group]
        cells = [
            "{:.2f}° / {:.2f}°".format(*errors) for errors in (opened, np.mean(closed, axis=0))
        ]
        print(f"    {motion:<26}{cells[0]:>15}{cells[1]:>15}")
    driven = [made["feedback"] for made in both]
    readings, temperatures = (
        max(made[key] for made in driven) for key in ("highest_reading", "highest_temperature")
    )
    aborted = sum(made["aborted"] for made in driven)
    print(
        f"  with feedback: highest V {readings:.1f} °C, highest T {temperatures:.1f} °C, "
        f"aborted {aborted} of {len(driven)}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, help="for the results, a line for each limb")
    parser.add_argument("--limbs", type=int, default=200, help="default %(default)s")
    parser.add_argument("--first", type=int, default=1000, help="seed of the first limb")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default %(default)s)")
    parser.add_argument("--feedback", action="store_true", help="drive limbs with it, too")
    options = parser.parse_args()
    lines = options.file.read_text().splitlines() if options.file.exists() else []
    limbs = [json.loads(line) for line in lines]
    seeds = set(range(options.first, options.first + options.limbs))
    seeds -= {limb["seed"] for limb in limbs}
    work = functools.partial(take, feedback=options.feedback)
    with (
        local_executor(options.jobs) as executor,
        Progress("limbs", len(seeds), "limbs") as progress,
    ):
        for done, limb in enumerate(run_each(work, sorted(seeds), executor), 1):
            limbs.append(limb)
            with options.file.open("a") as file:
                file.write(json.dumps(limb, ensure_ascii=False) + "\n")
            progress.update(done)
    if limbs:
        show(sorted(limbs, key=lambda limb: limb["seed"]))


if __name__ == "__main__":
    main()
