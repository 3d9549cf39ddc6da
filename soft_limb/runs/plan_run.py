"""Plan from files, as commands do, and drive a limb along the plan at once."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake import trajectories

from hardware import present_readings
from hardware.board.journal import closing
from hardware.board.signals import default_signal_handlers
from hardware.live_feed import LiveView
from limb_systems import LimbParameters, LimbSystem, Recording, Trajectory, resting_state
from limb_systems.limb_system import check_limb
from limb_systems.summary import Summary
from planners import Task, TaskError, plan, references
from soft_limb.reports.plan_report import write_rollout_report
from soft_limb.results.folder import guess_file_kind
from soft_limb.runs.rollout import DEFAULT_FEEDBACK, Rollout, roll_out

FOLLOW_FILES = ("plan.csv", "recording.csv", "report.html")  # of `plan_and_follow`
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


def plan_and_follow(
    reference: str,
    make_limb: Callable[[LimbParameters], LimbSystem],
    folder: str | Path,
    *,
    limb: LimbParameters | Path | None = None,
    task: Task | None = None,
    knot_rate: float = 10.0,
    smoothing_time: float = 0.5,
    controller: str = DEFAULT_FEEDBACK,
    real_time: bool = False,
    announce: Callable[[str], object] = lambda step: None,
    live: LiveView | None = None,
) -> tuple[Rollout, Summary]:
    """Plan for feedback from the present state of a limb, and drive it along the plan.

    The folder gets the files `FOLLOW_FILES`. If the limb fails, the folder has the plan, and the
    unfinished recording of a robot.

    Args:
        reference, limb, smoothing_time: as for `plan_from_files`.
        make_limb: function that returns the limb for the parameters of the plan; it is called
            before planning as well, to read the limb.
        task, knot_rate: as for `planners.plan`; the default task is `Task.closed_loop`.
        announce: function that is called with each step in words.
        controller, real_time, live: as for `roll_out`, whose errors are raised.
    """
    plan_file, recording_file, report = (Path(folder) / name for name in FOLLOW_FILES)

    def begin_step(step: str) -> None:
        announce(step)
        if live:
            live.say(step)

    # Read the temperatures at which the plan will start.
    begin_step(f"Planning {reference}")
    parameters = LimbParameters.of(limb)
    resting_limb = check_limb(make_limb(copy.deepcopy(parameters)))
    with closing(resting_limb):
        start = present_readings(resting_limb)
    # Plan from there.
    trajectory = plan_from_files(
        reference,
        parameters,
        smoothing_time,
        start=start,
        task=task or Task.closed_loop(parameters),
        knot_rate=knot_rate,
    )
    trajectory.save(plan_file)
    # Drive the limb along the plan.
    begin_step(f"Following {reference} for {trajectory.duration:g} s, controller {controller}")
    rollout = roll_out(
        trajectory,
        lambda: make_limb(trajectory.parameters),
        recording_file,
        controller=controller,
        real_time=real_time,
        live=live,
    )
    summary = rollout.summary()
    data = {"plan": plan_file, "recording": recording_file}
    write_rollout_report(rollout, summary, report, data)
    return rollout, summary
