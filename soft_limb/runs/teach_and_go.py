"""Teach and go: plans a motion, and drives a limb along the plan by feedback."""

from collections.abc import Callable
from pathlib import Path

from limb_systems import LimbParameters, LimbSystem
from limb_systems.summary import Summary
from planners import Task
from soft_limb.live.page import LivePage
from soft_limb.reports.plan import write_rollout_report
from soft_limb.runs.planning import plan_from_files
from soft_limb.runs.rollout import NEAREST, Rollout, roll_out

PLAN, RECORDING, PICTURE, REPORT = "plan.csv", "recording.csv", "tracking.png", "report.html"


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
    live: LivePage | None = None,
) -> tuple[Rollout, Summary]:
    """Plans with margins for feedback, and drives a limb along the plan.

    The folder has ``plan.csv``, ``recording.csv``, ``tracking.png`` and ``report.html``.
    If the limb fails, the plan is there, and of a robot an unfinished recording.

    Args:
        reference, limb, smoothing_time: as for `plan_from_files`.
        make_limb: function that gives the limb for the parameters of the plan.
        task, knot_rate: as for `planners.plan`; no task stands for `Task.closed_loop`.
        controller, real_time, live: as for `roll_out`.

    Raises:
        PlanningError: if there is no plan.
        ReplayError, HardwareError, OutputError: as `hardware.replay.replay` does.
        LimbError: if a file cannot be read.
    """
    folder = Path(folder)
    say = live.say if live else lambda _: None
    say(f"Planning {reference}")
    parameters = LimbParameters.of(limb)
    trajectory = plan_from_files(
        reference,
        parameters,
        smoothing_time,
        task=task or Task.closed_loop(parameters),
        knot_rate=knot_rate,
    )
    trajectory.save(folder / PLAN)
    say(f"Following {reference}, controller {controller}")
    rollout = roll_out(
        trajectory,
        lambda: make_limb(trajectory.parameters),
        folder / RECORDING,
        controller=controller,
        real_time=real_time,
        live=live,
    )
    # Matplotlib takes as long to import as all the rest.
    from limb_systems.views.plots import plot_tracking, save_figure

    save_figure(plot_tracking(trajectory, [rollout.recording]), folder / PICTURE)
    summary = rollout.summary()
    data = {"plan": folder / PLAN, "recording": folder / RECORDING, "picture": folder / PICTURE}
    write_rollout_report(rollout, summary, folder / REPORT, data)
    return rollout, summary
