"""The paper's evaluation, end to end, on emulated limbs.

Records limbs whose physics is richer than the model, calibrates the model to
the recordings, plans the motion of Fig. 5 and two that are taught by hand,
replays each plan five times open loop and with each controller, learns it over
ten repetitions, disturbs the limbs, and writes Table I, Figs. 4 to 7, where
the error comes from, and all the data to a folder. Nothing but what is called
true, and the split of the error, knows what an emulated limb is made of.

    python examples/reproduce_paper.py [FOLDER] [--quick] [--limbs N] [--others N]

`reproduce` does the same on any executor; with --cluster it is that of a Dask cluster.
"""

import argparse
import concurrent.futures
import dataclasses
import itertools
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

# Of each process, and before numpy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from calibration import save_recordings
from evaluation.experiment import (
    NUM_ANGLES,
    NUM_REPETITIONS,
    NUM_ROLLOUTS,
    NUM_STEPS,
    Experiment,
    Settings,
    evaluate,
)
from evaluation.figures import figures
from evaluation.report import EMULATED, write_report
from evaluation.tables import (
    APPROACH_HEADER,
    DISTURBANCE_HEADER,
    PAPER_TABLE_1,
    TABLE_1_HEADER,
    Summary,
    approach_table,
    disturbance_table,
    findings,
    summarize,
    table_1,
)
from evaluation.ways import FEEDBACK, LEARNING, OPEN_LOOP
from hardware.emulation.specimen import EFFECTS, EXTRA_EFFECTS
from limb_systems import write_meshcat_replay
from limb_systems.output import write_atomically
from limb_systems.views.plots import save_figure
from soft_limb.command import run_command
from soft_limb.reports.calibration import write_report as write_calibration_report
from soft_limb.results.summaries import calibration_summary
from soft_limb.runs.jobs import executor_of, run_all


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="exit status: 0 done, 1 it could not be done, 2 wrong usage, 130 stopped by Ctrl-C",
    )
    parser.add_argument("folder", nargs="?", default="out", type=Path, help="for all results")
    parser.add_argument("--limbs", type=int, default=10, help="how many (default %(default)s)")
    parser.add_argument(
        "--others",
        type=int,
        default=0,
        help="how many limbs of another physics besides (default %(default)s)",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="one limb, --no-compare, and of closed loop feedback and learning of Fig. 5 alone",
    )
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
        "--repetitions",
        type=int,
        default=NUM_REPETITIONS,
        help="of each plan that is learned (default %(default)s)",
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
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="of a Dask scheduler, whose workers have this folder on their PYTHONPATH; "
        "processes on this machine if left out",
    )
    options = parser.parse_args()
    if options.others < 0:
        parser.error("--others must be zero or more")
    if min(options.limbs, options.rollouts, options.repetitions, options.angles) < 1:
        parser.error("--limbs, --rollouts, --repetitions and --angles must be one or more")
    stopped = f"stopped; limbs that were finished are in {options.folder}"
    return run_command(lambda: _reproduce(options), stopped)


def _reproduce(options) -> int:
    folder, started = options.folder, time.perf_counter()
    jobs = _jobs(options)
    steps = itertools.count(1)

    def tell(step: str) -> None:
        if len(jobs) == 1:
            print(f"{next(steps)}/{NUM_STEPS + 1} {step} ...", flush=True)

    with executor_of(options.cluster, min(os.cpu_count() or 1, 3 * len(jobs))) as executor:
        # One more than can be worked on here, so that there is always something to do.
        at_once = None if options.cluster else (os.cpu_count() or 1) + 1
        summaries, shown = reproduce(jobs, executor, folder, at_once=at_once, tell=tell)
        tell("drawing figures, and writing the report")
        pictures = figures(shown)
        drawn = [
            executor.submit(save_figure, figure, folder / f"{name}.png")
            for name, (figure, _) in pictures.items()
        ]
        motion = shown.motions[0]
        write_meshcat_replay(
            folder / "replay.html",
            motion.open_loop.rollouts[0],
            plan=motion.open_loop.trajectory,
            title="Steps and sinusoid, on an emulated limb",
        )
        data = _data(folder, shown, pictures)
        write_report(folder / "report.html", summaries, shown, pictures, data)
        for figure in drawn:
            figure.result()

    print(f"\n{calibration_summary(shown.calibration)}\n")
    print(
        "Table I: mean |φ_REF - φ| from the reference, |φ* - φ| from the plan, in degrees; "
        f"rollouts per plan: {options.rollouts}"
    )
    _print_table([TABLE_1_HEADER, *table_1(summaries)])
    if rows := disturbance_table(summaries):
        print("\nDisturbances, in the motion of Fig. 5: mean distances in degrees")
        _print_table([DISTURBANCE_HEADER, *rows])
    print(
        "\nPlans with each calibrated model: mean distance of the true bend from the reference; "
        "of the bend from the plan, read / true, in degrees"
    )
    _print_table([APPROACH_HEADER, *approach_table(summaries)])
    print(EMULATED, *findings(summaries), sep="\n")
    print(f"\nwritten in {time.perf_counter() - started:.0f} s:")
    for path in sorted(folder.iterdir()):
        print(f"  {path}")
    return 0


def _jobs(options) -> list[Settings]:
    """What is done with each limb."""
    seeds, extra = range(1 if options.quick else options.limbs), tuple(options.extra)
    whole = Settings(
        0,
        extra,
        rollouts=options.rollouts,
        repetitions=options.repetitions,
        compare=not (options.quick or options.no_compare),
        protocol=options.protocol,
        num_angles=options.angles,
    )
    if options.quick:
        closed_loop = {next(iter(PAPER_TABLE_1)): (FEEDBACK, LEARNING)}
        whole = dataclasses.replace(whole, closed_loop=closed_loop, disturbances=())
    jobs = [dataclasses.replace(whole, seed=seed) for seed in seeds]
    other = dataclasses.replace(
        whole, physics="continuum", extra=(), compare=False, disturbances=()
    )
    jobs += [dataclasses.replace(other, seed=seed) for seed in range(options.others)]
    if options.effects:
        # What limbs are without, to see what each effect costs; all of them at last.
        absences = [(effect,) for effect in EFFECTS + extra if effect != "stress"]
        absences.append(EFFECTS + extra)
        fewer = dataclasses.replace(
            whole, rollouts=1, compare=False, closed_loop={}, disturbances=()
        )
        jobs += [
            dataclasses.replace(fewer, seed=seed, absent=absent)
            for seed in seeds
            for absent in absences
        ]
    return jobs


def reproduce(
    jobs: Sequence[Settings],
    executor: concurrent.futures.Executor,
    folder: Path,
    *,
    at_once: int | None = None,
    tell: Callable[[str], object] = lambda step: None,
) -> tuple[list[Summary], Experiment]:
    """The evaluation of limbs on an executor; files are written where this is called.

    Args:
        jobs: what is done with each limb; the first is without nothing.
        executor: as for `soft_limb.runs.jobs.run_all`.
        folder: gets a folder of files of each limb, and ``results.json`` with the limbs that
            are finished.
        at_once: how many limbs are begun before one is finished; all if None.
        tell: is called with what comes next for a limb.

    Returns:
        The numbers of each job, and the first one's experiment.
    """
    found: dict[int, Summary] = {}
    shown = None
    for number, experiment in run_all([evaluate(job, tell) for job in jobs], executor, at_once):
        found[number] = summary = summarize(experiment)
        shown = experiment if number == 0 else shown
        if not jobs[number].absent:
            kind = "limb" if summary.physics == "lumped" else summary.physics
            _save(experiment, folder / f"{kind}_{summary.seed}")
        _write_results(folder, [found[done] for done in sorted(found)])
        if len(jobs) > 1:
            print(f"{len(found):>3} of {len(jobs)}: {_line(summary)}", flush=True)
    assert shown is not None
    return [found[number] for number in range(len(jobs))], shown


def _line(summary: Summary) -> str:
    """A limb's mean errors, open loop and then with what else it was driven by."""
    without = f" without {', '.join(summary.absent)}" if summary.absent else ""
    names = dict.fromkeys(name for ways in summary.ways.values() for name in ways)
    parts = []
    for name in names:
        errors = [ways[name].read for ways in summary.ways.values() if name in ways]
        if name == LEARNING:
            errors = [repetitions[-1].read for repetitions in summary.repetitions.values()]
        parts.append(f"{name} {', '.join(f'{error:.1f}°' for error in errors)}")
    aborted = sum(way.aborted for ways in summary.ways.values() for way in ways.values())
    if aborted:
        parts.append(f"{aborted} rollouts aborted")
    kind = "limb" if summary.physics == "lumped" else f"{summary.physics} limb"
    return f"{kind} {summary.seed}{without}: {'; '.join(parts)}"


def _print_table(rows: Sequence[Sequence[str]]) -> None:
    """Columns of words to the left, those of numbers to the right."""
    columns = []
    for column in zip(*rows, strict=True):
        width = max(map(len, column))
        words = any(cell[:1].isalpha() for cell in column[1:])
        columns.append([f"{cell:{'<' if words else '>'}{width}}" for cell in column])
    for cells in zip(*columns, strict=True):
        print("  ".join(cells).rstrip())


def _write_results(folder: Path, summaries: list[Summary]) -> None:
    data = [dataclasses.asdict(summary) for summary in summaries]
    write_atomically(folder / "results.json", json.dumps(data, indent=1, ensure_ascii=False))


def _data(folder: Path, shown: Experiment, pictures: Iterable[str]) -> dict[str, Path]:
    """What is in the folder beside the report, by what it is."""
    limb = folder / f"limb_{shown.specimen.seed}"
    files = {
        "3D replay of the first rollout": folder / "replay.html",
        "numbers of all limbs": folder / "results.json",
        "calibration of the limb that is shown": limb / "calibration.html",
        "its parameters": limb / "limb.yaml",
    }
    files |= {name: folder / f"{name}.png" for name in pictures}
    for path in sorted(limb.glob("*/*.csv")):
        if path.parent.name != "recordings":  # the calibration's page has these
            files[f"{path.parent.name}, {path.stem}"] = path
    return files


def _save(experiment: Experiment, folder: Path) -> None:
    recordings = save_recordings(experiment.recordings, folder / "recordings")
    experiment.calibration.parameters.save(folder / "limb.yaml")
    data = {"calibrated limb": folder / "limb.yaml", **{path.stem: path for path in recordings}}
    write_calibration_report(experiment.calibration, folder / "calibration.html", data)
    for motion in experiment.motions:
        name = motion.name.replace("&", "_and_").replace(" ", "_").lower()
        if motion.taught:
            motion.taught.save(folder / name / "taught.csv")
        for loop, way in motion.ways.items():
            kind = "" if loop == OPEN_LOOP else f"{loop.partition(' (')[0].replace(' ', '_')}_"
            way.trajectory.save(folder / name / f"{kind}trajectory.csv")
            for number, rollout in enumerate(way.rollouts, 1):
                # In closed loop rollouts are alike, and repetitions are on their way to the last.
                if not kind or number in (1, len(way.rollouts)):
                    rollout.save(folder / name / f"{kind}rollout_{number}.csv")


if __name__ == "__main__":
    sys.exit(main())
