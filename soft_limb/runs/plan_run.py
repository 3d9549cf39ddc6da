"""Plan from files, as commands do."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake import trajectories

from hardware.board.signals import default_signal_handlers
from limb_systems import LimbParameters, Recording, Trajectory, resting_state
from planners import Task, TaskError, plan, references
from soft_limb.results.read_result import guess_file_kind

NAMED_REFERENCES = {
    "ramps": references.ramps,
    "fig5": references.step_and_decaying_sine,
    "circle": lambda: references.circle(np.deg2rad(15.0), 50.0),
    "eight": lambda: references.eight(np.deg2rad(15.0), np.deg2rad(8.0), 80.0),
}


def plan_from_files(
    reference: str,
    limb: LimbParameters | Path | None = None,
    smoothing_time: float = 0.5,
    tip: bool = False,
    start: ArrayLike | None = None,
    **settings: Any,
) -> Trajectory:
    """Plan for a command; a signal ends the process at once while it plans.

    Args:
        reference: a name of `NAMED_REFERENCES`, or the path of a recording or of a CSV (s, °).
        limb: parameters, or their path; None for the nominal limb.
        smoothing_time: window over which a recording's bend angle is smoothed, s.
        tip: whether the reference is a path of the tip, a CSV of time and mm.
        start: readings V of the resting limb at the start, °C; ambient temperature if None.
        settings: further arguments of `planners.plan`, whose errors are raised.
    """
    parameters = LimbParameters.of(limb)
    if tip:
        motion = references.load_tip_path(reference, parameters)
    else:
        motion = load_reference(reference, smoothing_time)
    if start is not None:
        settings["initial_state"] = resting_state(parameters, start)
    with default_signal_handlers():
        return plan(parameters, motion, **settings)


def load_task(name: str, limb: LimbParameters | None = None) -> Task:
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
    """Return a named reference, or a reference from a file; see `plan_from_files`."""
    if name in NAMED_REFERENCES:
        return NAMED_REFERENCES[name]()
    if guess_file_kind(Path(name)) == "recording":
        return references.from_recording(Recording.load(name), smoothing_time)
    return references.load(name)
