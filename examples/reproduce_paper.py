"""The paper's evaluation, end to end, on emulated limbs.

Records limbs whose physics is richer than the model, calibrates the model to
the recordings, plans the motion of Fig. 5 and two that are taught by hand,
replays each plan five times open loop, and writes Table I, Figs. 4 to 7, where
the error comes from, and all the data to a folder. Nothing but the split of the
error knows what an emulated limb is made of.

    python examples/reproduce_paper.py [FOLDER] [--quick] [--limbs N] [--protocol paper]
"""

import argparse
import concurrent.futures
import dataclasses
import itertools
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

from calibration import save_recordings
from calibration.report import calibration_summary
from calibration.report import write_report as write_calibration_report
from evaluation.experiment import NUM_ANGLES, NUM_ROLLOUTS, NUM_STEPS, Experiment, run_experiment
from evaluation.figures import figures
from evaluation.report import EMULATED, write_report
from evaluation.tables import (
    ABORTED,
    APPROACH_HEADER,
    STATISTICS,
    Summary,
    approach_table,
    findings,
    summarize,
    table_1,
)
from hardware.emulation.specimen import EFFECTS, EXTRA_EFFECTS, Specimen
from limb_systems import LimbParameters, write_meshcat_replay
from limb_systems.command import run_command
from limb_systems.output import write_atomically
from limb_systems.views.plots import save_figure


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="exit status: 0 done, 1 it could not be done, 2 wrong usage, 130 stopped by Ctrl-C",
    )
    parser.add_argument("folder", nargs="?", default="out", type=Path, help="for all results")
    parser.add_argument("--limbs", type=int, default=10, help="how many (default %(default)s)")
    parser.add_argument("--quick", action="store_true", help="one limb, and --no-compare")
    parser.add_argument(
        "--no-compare",
        action="store_true",
        help="no plans with the paper's calibration and with other laws; half of the time",
    )
    parser.add_argument(
        "--effects", action="store_true", help="also limbs without one of their effects each"
    )
    parser.add_argument(
        "--rollouts", type=int, default=NUM_ROLLOUTS, help="of each plan (default %(default)s)"
    )
    parser.add_argument(
        "--protocol",
        choices=("all", "paper"),
        default="all",
        help="recordings to calibrate to: all, or the paper's alone (default %(default)s)",
    )
    parser.add_argument(
        "--angles",
        type=int,
        default=NUM_ANGLES,
        help="equilibria of each recording of the paper's (default %(default)s)",
    )
    parser.add_argument(
        "--extra",
        action="append",
        default=[],
        choices=EXTRA_EFFECTS,
        help="an effect that all limbs have beside those of every limb",
    )
    options = parser.parse_args()
    if min(options.limbs, options.rollouts, options.angles) < 1:
        parser.error("--limbs, --rollouts and --angles must be one or more")
    stopped = f"stopped; limbs that were finished are in {options.folder}"
    return run_command(lambda: _reproduce(options), stopped)


def _reproduce(options) -> int:
    folder, started = options.folder, time.perf_counter()
    seeds = range(1 if options.quick else options.limbs)
    extra = tuple(options.extra)
    compare = not (options.quick or options.no_compare)
    jobs = [(seed, extra, (), options.rollouts, compare) for seed in seeds]
    if options.effects:
        # What limbs are without, to see what each effect costs; all of them at last.
        absences = [(effect,) for effect in EFFECTS + extra if effect != "stress"]
        absences.append(EFFECTS + extra)
        jobs += [(seed, extra, absent, 1, False) for seed in seeds for absent in absences]
    if len(jobs) == 1:
        steps = itertools.count(1)

        def tell(step: str) -> None:
            print(f"{next(steps)}/{NUM_STEPS + 1} {step} ...", flush=True)

        results = [_run(*jobs[0], options, tell)]
        tell("drawing figures, and writing the report")
    else:
        results = _run_all(jobs, options)
    summaries = [summary for summary, _ in results]
    shown = results[0][1]

    pictures = figures(shown)
    for name, (figure, _) in pictures.items():
        save_figure(figure, folder / f"{name}.png")
    command = f"python examples/reproduce_paper.py {' '.join(sys.argv[1:])}".strip()
    write_report(folder / "report.html", summaries, shown, pictures, command)
    _write_results(folder, summaries)
    motion = shown.motions[0]
    write_meshcat_replay(
        folder / "replay.html",
        motion.rollouts[0],
        plan=motion.trajectory,
        title="Steps and sinusoid, on an emulated limb",
    )

    print(f"\n{calibration_summary(shown.calibration)}\n")
    print(f"Table I: tracking error |φ* - φ|, rollouts per plan: {options.rollouts}, in degrees")
    line = "{:<12}{:<20}{:>16}{:>16}{:>18}{:>18}"
    print(line.format("", "", *STATISTICS, ABORTED))
    for row in table_1(summaries):
        print(line.format(*row))
    print("\nMean errors, read / true, of plans with each calibrated model:")
    for row in [APPROACH_HEADER, *approach_table(summaries)]:
        print("{:<42}{:>25}{:>20}{:>20}{:>8}{:>9}".format(*row))
    print(EMULATED, *findings(summaries), sep="\n")
    print(f"\nwritten in {time.perf_counter() - started:.0f} s:")
    for path in sorted(folder.iterdir()):
        print(f"  {path}")
    return 0


def _run_all(jobs: list, options: argparse.Namespace) -> list[tuple[Summary, Experiment | None]]:
    """All jobs on all cores, in their order."""
    context = multiprocessing.get_context("spawn")
    results = {}
    with concurrent.futures.ProcessPoolExecutor(mp_context=context, initializer=_hush) as pool:
        futures = {pool.submit(_run, *job, options): job for job in jobs}
        try:
            for future in concurrent.futures.as_completed(futures):
                seed, _, absent, *_ = job = futures[future]
                results[job] = future.result()
                _write_results(options.folder, [summary for summary, _ in results.values()])
                errors = ", ".join(f"{e:.1f}°" for e in results[job][0].first.values())
                without = f" without {', '.join(absent)}" if absent else ""
                aborted = sum(results[job][0].aborted.values())
                told = f"{errors}; {aborted} rollouts aborted" if aborted else errors
                print(f"{len(results):>3} of {len(jobs)}: limb {seed}{without}: {told}", flush=True)
        except BaseException:
            for process in multiprocessing.active_children():
                process.terminate()  # or the pool would wait for what they are at
            raise
    return [results[job] for job in jobs]


def _write_results(folder: Path, summaries: list[Summary]) -> None:
    data = [dataclasses.asdict(summary) for summary in summaries]
    write_atomically(folder / "results.json", json.dumps(data, indent=1, ensure_ascii=False))


def _hush() -> None:
    """Keeps the progress of several processes off one terminal."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def _run(
    seed: int,
    extra: tuple[str, ...],
    absent: tuple[str, ...],
    num_rollouts: int,
    compare: bool,
    options: argparse.Namespace,
    tell: Callable[[str], object] = lambda step: None,
) -> tuple[Summary, Experiment | None]:
    """One limb; its files are written, and the first limb is returned as well."""
    specimen = Specimen(LimbParameters(), seed, extra).without(*absent)
    experiment = run_experiment(
        specimen,
        num_rollouts,
        tell,
        compare=compare,
        protocol=options.protocol,
        num_angles=options.angles,
    )
    if not absent:
        _save(experiment, options.folder / f"limb_{seed}")
    return summarize(experiment), None if seed or absent else experiment


def _save(experiment: Experiment, folder: Path) -> None:
    save_recordings(experiment.recordings, folder / "recordings")
    experiment.calibration.parameters.save(folder / "limb.yaml")
    write_calibration_report(experiment.calibration, folder / "calibration.html")
    for motion in experiment.motions:
        name = motion.name.replace("&", "_and_").replace(" ", "_").lower()
        if motion.taught:
            motion.taught.save(folder / name / "taught.csv")
        motion.trajectory.save(folder / name / "trajectory.csv")
        for number, rollout in enumerate(motion.rollouts, 1):
            rollout.save(folder / name / f"rollout_{number}.csv")


if __name__ == "__main__":
    sys.exit(main())
