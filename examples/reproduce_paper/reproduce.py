"""The whole evaluation of emulated limbs, with its report, pictures and files."""

import concurrent.futures
import dataclasses
import itertools
import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from calibration import save_recordings
from limb_systems import write_meshcat_replay
from limb_systems.files.output import write_atomically
from limb_systems.views.panels import Panel
from limb_systems.views.plots import Figure, draw, save_figure
from reproduce_paper.experiment import NUM_STEPS, RAMPS, Experiment, Settings, evaluate
from reproduce_paper.figures import figures
from reproduce_paper.report import EMULATED, write_report
from reproduce_paper.tables import LUMPED, Summary, distance_table, summarize
from reproduce_paper.ways import FOLLOW, LEARNING, OPEN_LOOP
from soft_limb.commands.options import print_table
from soft_limb.reports.calibration_report import write_report as write_calibration_report
from soft_limb.results.summaries import calibration_summary
from soft_limb.runs.jobs import executor_of, run_all


def reproduce_in(folder: Path, jobs: Sequence[Settings], cluster: str | None = None) -> int:
    """Run the evaluation as a command: print its steps and tables, and write all files.

    Args:
        folder: gets ``report.html``, pictures, and what `reproduce` leaves.
        jobs: what is done with each limb.
        cluster: address of a Dask scheduler; processes on this machine if None.

    Returns:
        Exit status 0.
    """
    started = time.perf_counter()
    # Of each process, before it loads numpy: more threads would only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    steps = itertools.count(1)

    def tell(step: str) -> None:
        if len(jobs) == 1:
            print(f"{next(steps)}/{NUM_STEPS + 1} {step} ...", flush=True)

    with executor_of(cluster, min(os.cpu_count() or 1, 3 * len(jobs))) as executor:
        # One more than can be worked on here, so that there is always something to do.
        at_once = None if cluster else (os.cpu_count() or 1) + 1
        summaries, shown = reproduce(jobs, executor, folder, at_once=at_once, tell=tell)
        tell("drawing figures, and writing the report")
        _draw(folder, summaries, shown, executor)
    print(f"\n{calibration_summary(shown.calibration)}\n")
    for physics in dict.fromkeys(summary.physics for summary in summaries):
        title = "mean distance of the true bend from the reference"
        print_table(title, distance_table(summaries, physics))
    print(EMULATED)
    print(f"\nwritten in {time.perf_counter() - started:.0f} s:")
    for path in sorted(folder.iterdir()):
        print(f"  {path}")
    return 0


def reproduce(
    jobs: Sequence[Settings],
    executor: concurrent.futures.Executor,
    folder: Path,
    *,
    at_once: int | None = None,
    tell: Callable[[str], object] = lambda step: None,
) -> tuple[list[Summary], Experiment]:
    """Evaluate limbs on an executor; files are written where this is called.

    Args:
        jobs: what is done with each limb.
        executor: runs the calls, as for `soft_limb.runs.jobs.run_all`.
        folder: gets a folder of files of each limb, and ``results.json`` with the limbs that
            are finished.
        at_once: number of limbs that are begun before one is finished; all if None.
        tell: function that is called with the next step of a limb.

    Returns:
        The numbers of each job, and the first one's experiment.
    """
    found: dict[int, Summary] = {}
    shown = None
    for number, experiment in run_all([evaluate(job, tell) for job in jobs], executor, at_once):
        found[number] = summary = summarize(experiment)
        shown = experiment if number == 0 else shown
        _save(experiment, folder / f"{_family(summary)}_{summary.seed}")
        data = [dataclasses.asdict(found[done]) for done in sorted(found)]
        text = json.dumps(data, indent=1, ensure_ascii=False)
        write_atomically(folder / "results.json", text)
        if len(jobs) > 1:
            print(f"{len(found):>3} of {len(jobs)}: {_line(summary)}", flush=True)
    assert shown is not None
    return [found[number] for number in range(len(jobs))], shown


def save_picture(figure: Figure | list[Panel], path: Path) -> None:
    """Save one of `figures` as a picture."""
    save_figure(draw(figure) if isinstance(figure, list) else figure, path)


def _family(summary: Summary) -> str:
    return "limb" if summary.physics == LUMPED else summary.physics


def _line(summary: Summary) -> str:
    """A limb's mean distances from its plans as read, by each way of driving it."""
    parts = []
    for name in dict.fromkeys(name for ways in summary.ways.values() for name in ways):
        errors = [ways[name].read for ways in summary.ways.values() if name in ways]
        if name == LEARNING:
            errors = [repetitions[-1].read for repetitions in summary.repetitions.values()]
        parts.append(f"{name} {', '.join(f'{error:.1f}°' for error in errors)}")
    if aborted := sum(way.aborted for ways in summary.ways.values() for way in ways.values()):
        parts.append(f"{aborted} rollouts aborted")
    return f"{_family(summary)} {summary.seed}: {'; '.join(parts)}"


def _draw(
    folder: Path,
    summaries: Sequence[Summary],
    shown: Experiment,
    executor: concurrent.futures.Executor,
) -> None:
    """Write the pictures and the 3D replay of one limb, and the report of all."""
    pictures = figures(shown)
    drawn = [
        executor.submit(save_picture, figure, folder / f"{name}.png")
        for name, (figure, _) in pictures.items()
    ]
    way = shown.ways[RAMPS][FOLLOW]
    replay, title = folder / "replay.html", "Ramps, on an emulated limb"
    write_meshcat_replay(replay, way.rollouts[0], plan=way.trajectory, title=title)
    limb = folder / f"limb_{shown.specimen.seed}"
    data = {
        "3D replay of the ramps": replay,
        "numbers of all limbs": folder / "results.json",
        "calibration of the limb that is shown": limb / "calibration.html",
        "its parameters": limb / "limb.yaml",
        **{name: folder / f"{name}.png" for name in pictures},
    }
    for path in sorted(limb.glob("*/*.csv")):
        if path.parent.name != "recordings":  # the calibration's page has these
            data[f"{path.parent.name}, {path.stem}"] = path
    write_report(folder / "report.html", summaries, shown, pictures, data)
    for figure in drawn:
        figure.result()


def _save(experiment: Experiment, folder: Path) -> None:
    recordings = save_recordings(experiment.recordings, folder / "recordings")
    experiment.calibration.parameters.save(folder / "limb.yaml")
    data = {"calibrated limb": folder / "limb.yaml", **{path.stem: path for path in recordings}}
    write_calibration_report(experiment.calibration, folder / "calibration.html", data)
    for motion, ways in experiment.ways.items():
        own = folder / motion.replace("&", "_and_").replace(" ", "_").lower()
        if motion in experiment.taught:
            experiment.taught[motion].save(own / "taught.csv")
        for loop, way in ways.items():
            kind = "" if loop == OPEN_LOOP else f"{loop.replace(' ', '_')}_"
            way.trajectory.save(own / f"{kind}trajectory.csv")
            for number, rollout in enumerate(way.rollouts, 1):
                # In closed loop rollouts are alike, and repetitions are on their way to the last.
                if not kind or number in (1, len(way.rollouts)):
                    rollout.save(own / f"{kind}rollout_{number}.csv")
