"""Plans whose inputs are files."""

from pathlib import Path
from typing import Any

import numpy as np
from pydrake import trajectories

from limb_systems import LimbParameters, Recording, Trajectory
from limb_systems.signals import ended_at_once
from planners import Task, plan, references

RECORDED = b"# limb recording"  # beginning of a recording's file
NAMED = {
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
    **settings: Any,
) -> Trajectory:
    """Plans for a command, which a signal then ends at once.

    Args:
        reference: a name of `NAMED`, or the path of a recording or of a CSV of time and degrees.
        limb: parameters, or their path; None for the nominal limb.
        smoothing_time: window over which a recording's bend angle is smoothed, s.
        tip: whether the reference is a path of the tip, a CSV of time and mm.
        settings: further arguments of `planners.plan`.

    Raises:
        PlanningError: if there is no plan, as of `planners.plan`.
        LimbError: if a file cannot be read.
    """
    parameters = LimbParameters.of(limb)
    if tip:
        course = references.load_tip_path(reference, parameters)
    else:
        course = reference_from_file(reference, smoothing_time)
    with ended_at_once():
        return plan(parameters, course, **settings)


def task_named(name: str, limb: LimbParameters | None = None) -> Task:
    """The task that a command calls "paper", "closed-loop" or by its file.

    Args:
        limb: the limb to plan for, by which `Task.closed_loop` chooses margins.

    Raises:
        LimbError: if the file cannot be read.
    """
    if name == "closed-loop":
        return Task.closed_loop(limb)
    return Task.paper() if name == "paper" else Task.load(name)


def reference_from_file(name: str, smoothing_time: float) -> trajectories.Trajectory:
    """A reference by what a command calls it; see `plan_from_files`."""
    if name in NAMED:
        return NAMED[name]()
    path = Path(name)
    if path.is_file():
        with path.open("rb") as file:
            recorded = file.read(len(RECORDED)) == RECORDED
        if recorded:
            return references.from_recording(Recording.load(path), smoothing_time)
    return references.load(path)
