"""Evaluate emulated limbs, and write report, pictures and files."""

import collections
import dataclasses
import json
import os
import time
from collections.abc import Sequence
from pathlib import Path

from calibration import save_recordings
from limb_systems import write_meshcat_replay
from limb_systems.files.output import write_atomically
from limb_systems.views.panels import Panel
from limb_systems.views.plots import Figure, draw, save_figure
from reproduce_paper.driving import FOLLOW, LEARNING, OPEN_LOOP
from reproduce_paper.experiment import RAMPS, Experiment, Settings, evaluate
from reproduce_paper.figures import figures
from reproduce_paper.report import EMULATED, write_report
from reproduce_paper.tables import LUMPED, Summary, distance_table, summarize
from soft_limb.commands.options import print_table
from soft_limb.reports.calibration_report import write_report as write_calibration_report
from soft_limb.results.summaries import calibration_summary
from soft_limb.runs.jobs import run_each


def reproduce_in(folder: Path, jobs: Sequence[Settings]) -> int:
    """Run the evaluation as a command: print its steps and tables, and write all files.

    Args:
        folder: folder for ``report.html``, pictures, and the files of `reproduce`.
        jobs: settings of each limb.

    Returns:
        Exit status 0.
    """
    # Evaluate the limbs, and write figures and report.
    started = time.perf_counter()
    summaries, experiment = reproduce(jobs, folder, os.cpu_count() or 1)
    if len(jobs) == 1:
        announce("5/5 drawing figures, and writing the report")
    _draw(folder, summaries, experiment)
    # Print the calibration, the distances and the files.
    print(f"\n{calibration_summary(experiment.calibration)}\n")
    for physics in dict.fromkeys(summary.physics for summary in summaries):
        title = "mean distance of the true bend from the reference"
        print_table(title, distance_table(summaries, physics))
    print(EMULATED)
    print(f"\nwritten in {time.perf_counter() - started:.0f} s:")
    for path in sorted(folder.iterdir()):
        print(f"  {path}")
    return 0


def reproduce(
    jobs: Sequence[Settings], folder: Path, num_processes: int
) -> tuple[list[Summary], Experiment]:
    """Evaluate limbs: a single one in several processes, and several limbs one in each process.

    Args:
        jobs: settings of each limb.
        folder: folder for a folder of each limb, and for ``results.json`` of the complete limbs.
        num_processes: as for `soft_limb.runs.jobs.run_each`.

    Returns:
        The numbers of each job, and the first one's experiment.
    """
    if len(jobs) == 1:
        experiments = iter([evaluate(jobs[0], num_processes, announce)])
    else:
        experiments = run_each(evaluate, jobs, num_processes)
    completed: dict[tuple[str, int], Summary] = {}
    first = None
    for experiment in experiments:
        summary = summarize(experiment)
        key = (summary.physics, summary.seed)
        completed[key] = summary
        if key == (jobs[0].physics, jobs[0].seed):
            first = experiment
        # Save its files, and the numbers of all complete limbs.
        _save(experiment, folder / f"{_family(summary)}_{summary.seed}")
        done = []
        for job in jobs:
            if (job.physics, job.seed) in completed:
                done.append(completed[job.physics, job.seed])
        data = list(map(dataclasses.asdict, done))
        text = json.dumps(data, indent=1, ensure_ascii=False)
        write_atomically(folder / "results.json", text)
        # Print a line for each of several limbs.
        if len(jobs) > 1:
            print(f"{len(completed):>3} of {len(jobs)}: {_line(summary)}", flush=True)
    assert first is not None
    return done, first


def announce(step: str) -> None:
    """Print the next step of a single limb."""
    print(f"{step} ...", flush=True)


def save_picture(figure: Figure | list[Panel], path: Path) -> None:
    """Save one of `figures` as a picture."""
    save_figure(draw(figure) if isinstance(figure, list) else figure, path)


def _family(summary: Summary) -> str:
    return "limb" if summary.physics == LUMPED else summary.physics


def _line(summary: Summary) -> str:
    """Return a line with a limb's mean distances from its plans, as read, by method."""
    # Collect the mean error of each motion by method.
    errors = collections.defaultdict(list)
    aborted = 0
    for motion, ways in summary.ways.items():
        for name, way in ways.items():
            aborted += way.aborted
            read = summary.repetitions[motion][-1].read if name == LEARNING else way.read
            errors[name].append(f"{read:.1f}°")
    parts = [f"{name} {', '.join(texts)}" for name, texts in errors.items()]
    if aborted:
        parts.append(f"{aborted} rollouts aborted")
    return f"{_family(summary)} {summary.seed}: {'; '.join(parts)}"


def _draw(folder: Path, summaries: Sequence[Summary], experiment: Experiment) -> None:
    """Write the pictures and the 3D replay of one limb, and the report of all."""
    pictures = figures(experiment)
    for name, (figure, _) in pictures.items():
        save_picture(figure, folder / f"{name}.png")
    # Write the 3D replay.
    way = experiment.ways[RAMPS][FOLLOW]
    replay = folder / "replay.html"
    title = "Ramps, on an emulated limb"
    write_meshcat_replay(replay, way.rollouts[0], plan=way.trajectory, title=title)
    # Write the report, with links to all files of the limb.
    limb = folder / f"limb_{experiment.specimen.seed}"
    data = {
        "3D replay of the ramps": replay,
        "numbers of all limbs": folder / "results.json",
        "calibration of the limb in the figures": limb / "calibration.html",
        "its parameters": limb / "limb.yaml",
        **{name: folder / f"{name}.png" for name in pictures},
    }
    for path in sorted(limb.glob("*/*.csv")):
        if path.parent.name != "recordings":  # the calibration's page has these
            data[f"{path.parent.name}, {path.stem}"] = path
    write_report(folder / "report.html", summaries, experiment, pictures, data)


def _save(experiment: Experiment, folder: Path) -> None:
    recordings = save_recordings(experiment.recordings, folder / "recordings")
    experiment.calibration.parameters.save(folder / "limb.yaml")
    data = {"calibrated limb": folder / "limb.yaml", **{path.stem: path for path in recordings}}
    write_calibration_report(experiment.calibration, folder / "calibration.html", data)
    # Save the plans and rollouts of each motion.
    for motion, ways in experiment.ways.items():
        motion_folder = folder / motion.replace("&", "_and_").replace(" ", "_").lower()
        if motion in experiment.taught:
            experiment.taught[motion].save(motion_folder / "taught.csv")
        for loop, way in ways.items():
            kind = "" if loop == OPEN_LOOP else f"{loop.replace(' ', '_')}_"
            way.trajectory.save(motion_folder / f"{kind}trajectory.csv")
            for number, rollout in enumerate(way.rollouts, 1):
                # In closed loop, the first and the last rollout are enough.
                if not kind or number in (1, len(way.rollouts)):
                    rollout.save(motion_folder / f"{kind}rollout_{number}.csv")
