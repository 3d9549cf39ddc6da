"""The command ``soft-limb plan``, and references and tasks of other commands."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake import trajectories

from hardware.board.signals import default_signal_handlers
from limb_systems import LimbParameters, Recording, Trajectory, resting_state
from limb_systems.views.panels import tracking_panels
from planners import Task, TaskError, plan, references
from planners.planning import MAX_KNOTS
from soft_limb.commands.options import (
    Command,
    Option,
    checked_outputs,
    print_summary,
    save_panels,
    shared,
)
from soft_limb.reports.plan_report import write_plan_report
from soft_limb.results.read_result import guess_file_kind
from soft_limb.results.summaries import plan_summary

NAMED_REFERENCES = {
    "ramps": references.ramps,
    "fig5": references.step_and_decaying_sine,
    "circle": lambda: references.circle(np.deg2rad(15.0), 50.0),
    "eight": lambda: references.eight(np.deg2rad(15.0), np.deg2rad(8.0), 80.0),
}


def load_task(name: str, limb: LimbParameters) -> Task:
    """Return the task "paper", the task "closed-loop" for a limb, or a task from a file."""
    if name == "closed-loop":
        return Task.closed_loop(limb)
    if name == "paper":
        return Task.paper()
    if not Path(name).exists():
        raise TaskError(
            f"There is no task {name!r}, nor a file of this name; give 'paper', 'closed-loop' or a "
            "YAML file."
        )
    return Task.load(name)


def load_reference(name: str, smoothing_time: float) -> trajectories.Trajectory:
    """Return a named reference, or a reference from a recording or a CSV of s and °."""
    if name in NAMED_REFERENCES:
        return NAMED_REFERENCES[name]()
    if guess_file_kind(Path(name)) == "recording":
        return references.from_recording(Recording.load(name), smoothing_time)
    return references.load(name)


def plan_reference(
    options: argparse.Namespace,
    limb: LimbParameters,
    task: Task | None,
    start: ArrayLike | None,
    **settings: Any,
) -> Trajectory:
    """Plan the reference of a command; a signal ends the process at once while it plans.

    Args:
        start: readings V of the resting limb at the start, °C; ambient temperature if None.
        settings: further arguments of `planners.plan`, whose errors are raised.
    """
    if vars(options).get("tip"):
        motion = references.load_tip_path(options.reference, limb)
    else:
        motion = load_reference(options.reference, options.smooth)
    if start is not None:
        settings["initial_state"] = resting_state(limb, start)
    with default_signal_handlers():
        return plan(limb, motion, task=task, knot_rate=options.knot_rate, **settings)


def _temperatures(text: str) -> list[float]:
    """Return temperatures, °C, from a text with commas, for the type of an option."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a list of temperatures in °C, such as 31.5 or 31.5,30.2"
        ) from None


def _plan(options: argparse.Namespace) -> int:
    # Plan.
    outputs = checked_outputs(options, options.reference, options.limb, options.task)
    limb = LimbParameters.of(options.limb)
    task = load_task(options.task, limb) if options.task else None
    trajectory = plan_reference(
        options,
        limb,
        task,
        options.start,
        max_knots=options.max_knots,
        tolerance_deg=options.tolerance,
    )
    # Write the trajectory and its pictures.
    trajectory.save(options.output)
    save_panels(tracking_panels(trajectory), options.plot)
    if options.diagnostics:
        # Importing Matplotlib takes as long as importing everything else.
        from limb_systems.views.plots import save_figure
        from planners.diagnostics import plot_diagnostics

        save_figure(plot_diagnostics(trajectory), options.diagnostics)
    # Write the report, with links to the files behind it.
    summary = plan_summary(trajectory)
    if options.report:
        data = {"trajectory": options.output}
        if Path(options.reference).is_file():
            data["reference"] = Path(options.reference)
        if options.limb:
            data["limb"] = options.limb
        write_plan_report(trajectory, summary, options.report, data)
    print_summary(options, summary, outputs)
    return 0


COMMANDS = {
    "plan": Command(
        _plan,
        "Plan the feasible trajectory of a limb that is nearest to a reference bend angle. The "
        "plan is checked by simulation and saved for soft-limb replay.",
        "reference limb task plot report smooth knot-rate json force",
        [
            shared("output", help="trajectory file to write (.csv)"),
            Option(
                "--tip",
                action="store_true",
                help="the reference is a path of the tip: a CSV of time in s and the distance of "
                "the tip from the straight limb in mm, along E2, and E3 if the limb bends in space",
            ),
            Option(
                "--start",
                type=_temperatures,
                metavar="V[,V]",
                help="wire readings at the start of the plan, when the limb is at rest, °C: one "
                "number, or one for each wire; the ambient temperature if left out",
            ),
            Option(
                "--diagnostics",
                type=Path,
                help="picture to write, with constraint violations and the sparsity of the "
                "Jacobian",
            ),
            Option(
                "--max-knots",
                type=int,
                default=MAX_KNOTS,
                help="most knots of a plan; a reference that needs more is refused (default "
                "%(default)s)",
            ),
            Option(
                "--tolerance",
                type=float,
                help="largest difference allowed between the plan and its simulation, degrees "
                "(default 0.1; 1 for a limb that bends in space)",
            ),
        ],
        stopped="stopped; nothing was written",
        examples=[
            "soft-limb plan mine.csv -o out/plan.csv --plot out/plan.png",
            "soft-limb plan fig5 -l out/calibrated.yaml -o out/plan.csv --report out/plan.html",
        ],
    )
}
