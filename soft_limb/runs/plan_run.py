"""Plans whose inputs are files, and limbs that are driven along them at once."""

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
from planners import Task, plan, references
from soft_limb.reports.plan_report import write_rollout_report
from soft_limb.results.folder import glance
from soft_limb.runs.rollout import NEAREST, Rollout, roll_out

FOLLOWED = ("plan.csv", "recording.csv", "tracking.png", "report.html")  # of `teach_and_go`
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
    start: ArrayLike | None = None,
    **settings: Any,
) -> Trajectory:
    """Plans for a command, which a signal then ends at once.

    Args:
        reference: a name of `NAMED`, or the path of a recording or of a CSV of time and degrees.
        limb: parameters, or their path; None for the nominal limb.
        smoothing_time: window over which a recording's bend angle is smoothed, s.
        tip: whether the reference is a path of the tip, a CSV of time and mm.
        start: readings V of the resting limb that begins, °C, as for `resting_state`; ambient
            temperature if None.
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
    if start is not None:
        settings["initial_state"] = resting_state(parameters, start)
    with default_signal_handlers():
        return plan(parameters, course, **settings)


def task_named(name: str, limb: LimbParameters | None = None) -> Task:
    """The task that a command calls "paper", "closed-loop" or by its file.

    Args:
        limb: the limb to plan for, by which `Task.closed_loop` chooses weights and margins.

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
    if glance(Path(name)) == "recording":
        return references.from_recording(Recording.load(name), smoothing_time)
    return references.load(name)


def teach_and_go(
    reference: str,
    make_limb: Callable[[LimbParameters], LimbSystem],
    folder: str | Path,
    *,
    limb: LimbParameters | Path | None = None,
    task: Task | None = None,
    knot_rate: float = 10.0,
    smoothing_time: float = 0.5,
    controller: str = NEAREST,
    real_time: bool = False,
    live: LiveView | None = None,
) -> tuple[Rollout, Summary]:
    """Plan for feedback from where a limb is, and drive it along the plan.

    The folder gets the files `FOLLOWED`.
    If the limb fails, the plan is there, and of a robot an unfinished recording.

    Args:
        reference, limb, smoothing_time: as for `plan_from_files`.
        make_limb: function that gives the limb for the parameters of the plan; it is called
            before the plan as well, to read the limb.
        task, knot_rate: as for `planners.plan`; no task stands for `Task.closed_loop`.
        controller, real_time, live: as for `roll_out`.

    Raises:
        PlanningError: if there is no plan.
        ReplayError, HardwareError, OutputError: as `hardware.replaying.replay` does.
        LimbError: if a file cannot be read.
    """
    plan_file, recording_file, picture, report = (Path(folder) / name for name in FOLLOWED)
    say = live.say if live else lambda _: None
    say(f"Planning {reference}")
    parameters = LimbParameters.of(limb)
    rested = check_limb(make_limb(copy.deepcopy(parameters)))
    with closing(rested):
        start = present_readings(rested)
    trajectory = plan_from_files(
        reference,
        parameters,
        smoothing_time,
        start=start,
        task=task or Task.closed_loop(parameters),
        knot_rate=knot_rate,
    )
    trajectory.save(plan_file)
    say(f"Following {reference}, controller {controller}")
    rollout = roll_out(
        trajectory,
        lambda: make_limb(trajectory.parameters),
        recording_file,
        controller=controller,
        real_time=real_time,
        live=live,
    )
    # Matplotlib takes as long to import as all the rest.
    from limb_systems.views.plots import plot_tracking, save_figure

    save_figure(plot_tracking(trajectory, [rollout.recording]), picture)
    summary = rollout.summary()
    data = {"plan": plan_file, "recording": recording_file, "picture": picture}
    write_rollout_report(rollout, summary, report, data)
    return rollout, summary
