"""Commands of robots that walk."""

import argparse
import functools
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from pydrake.systems.framework import LeafSystem

from controllers import GaitFeedback, PlanFeedback
from hardware import RobotTwin, SerialLimb
from limb_systems import Gait, LimbError, LimbSystem, Robot, RobotParameters
from limb_systems.progress import Progress
from limb_systems.views.panels import motion_panels
from planners import PlanningError, plan_gait
from planners.gait.schedules import Schedule, schedule_of, schedule_text, sensible_schedules
from planners.gait.walking import walk
from soft_limb.commands.options import (
    Command,
    Option,
    checked_outputs,
    print_summary,
    print_table,
    save_panels,
    say_duration,
    shared,
)
from soft_limb.results.summaries import gait_summary, walk_summary
from soft_limb.runs.jobs import local_executor, run_each
from soft_limb.runs.rollout import OPEN, record_replay

STRIDES, BENDS = "gait-feedback", "plan-feedback"


def _at_least_one(text: str) -> int:
    if not re.fullmatch(r"[1-9]\d{0,3}", text):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of cycles from 1 to 9999")
    return int(text)


def _gait(options: argparse.Namespace) -> int:
    outputs = checked_outputs(options, options.robot)
    robot = RobotParameters.of(options.robot)
    num_feet = len(robot.limbs)
    schedules = [schedule_of(text, num_feet) for text in options.schedule]
    schedules = schedules or sensible_schedules(num_feet)
    each = "half a minute" if options.quick else "two minutes"
    say_duration(
        f"some seconds for each of {len(schedules)} schedules, and about {each} to check one",
    )
    gait, refused = _best_gait(
        schedules,
        functools.partial(
            _planned,
            robot,
            objective=options.objective,
            temperature_margin=options.margin,
            explain=len(schedules) == 1,
        ),
        spread=not options.quick,
    )
    if gait is None:
        raise LimbError(
            f"No schedule of {len(schedules)} gives a gait that walks as planned: "
            + "; ".join(f"{schedule!r}, {reason.rstrip('.')}" for schedule, reason in refused)
            + "."
        )
    if refused and not options.json:
        print_table("schedules that were not taken", refused)
    gait.save(options.output)
    if options.plot:
        # Matplotlib takes as long to import as all the rest.
        from limb_systems.views.plots import save_figure
        from limb_systems.views.walk import draw_walk

        save_figure(draw_walk(gait), options.plot)
    if options.report:
        from soft_limb.reports.gait import gait_report

        gait_report(gait, options.report, {"gait": options.output})
    print_summary(options, gait_summary(gait), outputs)
    return 0


def _best_gait(
    schedules: Sequence[Schedule], plan: Callable[..., "_Trial"], spread: bool
) -> tuple[Gait | None, list[tuple[str, str]]]:
    """Plan a gait of each schedule, and check them, the best first, until one walks as planned.

    Args:
        plan: `_planned` for a robot and an objective.
        spread: whether the check varies ground and parameters.

    Returns:
        The gait that was taken, if any; and each other schedule with why it was not.
    """
    trials = [_Trial(schedule) for schedule in schedules]
    if len(schedules) > 1:
        with (
            local_executor(min(os.cpu_count() or 1, len(schedules))) as executor,
            Progress("planning", len(schedules), "schedules") as progress,
        ):
            trials = []
            for trial in run_each(plan, schedules, executor):
                trials.append(trial)
                done = [trial.schedule for trial in trials]
                left = [schedule_text(each) for each in schedules if each not in done]
                progress.update(len(trials), f"trying {left[0]}" if left else "")
    trials.sort(key=lambda trial: -trial.merit)
    taken, refused = None, []
    for trial in trials:
        if trial.gait and taken:
            reason = f"{1e3 * trial.gait.speed:.2f} mm/s, and another is better"
            trial = trial._replace(reason=reason)
        elif not trial.reason:
            trial = plan(trial.schedule, check=True, spread=spread)
            taken = trial.gait
        if trial.reason:
            refused.append((schedule_text(trial.schedule), trial.reason))
    return taken, refused


class _Trial(NamedTuple):
    """A schedule; its gait, if it was planned; or why there is none, or why it was not taken.

    - ``merit``: speed, m/s, or distance for the heat of a cycle, m/s, which is to be large.
    """

    schedule: Schedule
    gait: Gait | None = None
    reason: str = ""
    merit: float = -np.inf


def _planned(
    robot: RobotParameters,
    schedule: Schedule,
    objective: Literal["speed", "energy"],
    check: bool = False,
    **options: Any,
) -> _Trial:
    try:
        gait = plan_gait(robot, schedule=schedule, objective=objective, check=check, **options)
    except PlanningError as error:
        return _Trial(schedule, reason=str(error))
    if objective == "speed":
        return _Trial(schedule, gait, merit=gait.speed)
    heat = float(np.diff(gait.time) @ gait.duty[:, :-1].sum(axis=0))
    return _Trial(schedule, gait, merit=gait.stride / heat)


def _walk(options: argparse.Namespace) -> int:
    outputs = checked_outputs(options, options.gait)
    gait = Gait.load(options.gait)
    if gait.check.is_missing:
        raise LimbError(
            f"{options.gait} was never checked and is not walked by; plan it again with soft-limb "
            "gait, which checks it by simulation."
        )
    trajectory = walk(gait, options.cycles)
    name = options.controller or (BENDS if options.port else STRIDES)
    controller: LeafSystem | None = None
    if name == STRIDES:
        controller = GaitFeedback(gait, options.cycles)
    elif name == BENDS:
        controller = PlanFeedback(trajectory)
    robot: LimbSystem
    if options.port:
        robot = SerialLimb(options.port, gait.parameters)
    elif options.model:
        robot = Robot(gait.robot)
    else:
        robot = RobotTwin(options.robot or gait.robot, seed=options.emulated or 0, truth=True)
    recording = record_replay(trajectory, robot, options.output, controller=controller)
    save_panels(motion_panels(recording), options.plot)
    start = trajectory.duration - options.cycles * gait.period
    print_summary(options, walk_summary(gait, recording, options.cycles, start), outputs)
    return 1 if recording.interrupted else 0


COMMANDS = {
    "gait": Command(
        _gait,
        "Plans the gait of a robot of several limbs on the ground: a motion that repeats, heat "
        "included. Tries the schedules of contacts that are worth it and says why others were not "
        "taken; simulates the best with contact over eight cycles, and with other friction and "
        "parameters; and writes it to a file that soft-limb walk drives a robot by.",
        "plot report json force",
        [
            Option(
                "robot",
                nargs="?",
                type=Path,
                help="robot parameters (.yaml); a crawler of two limbs if left out",
            ),
            shared("output", help="gait file to write (.csv)"),
            Option(
                "--schedule",
                action="append",
                default=[],
                metavar="TEXT",
                help="what each foot does in each phase, such as 'fs ss sf ss': s sticks, f or b "
                "slides forward or backward, l is lifted; once for each schedule to try",
            ),
            Option(
                "--objective",
                choices=["speed", "energy"],
                default="speed",
                help="the fastest gait, or the one that heats least for its distance (default "
                "%(default)s)",
            ),
            Option(
                "--margin",
                type=float,
                default=5.0,
                metavar="DEGREES",
                help="how far wires stay below T_max, °C, which feedback needs (default "
                "%(default)g)",
            ),
            Option(
                "--quick",
                action="store_true",
                help="simulate it on the described ground alone, not on others",
            ),
        ],
        stopped="stopped; nothing was written",
        examples=["soft-limb gait -o out/gait.csv --schedule 'fs ss sf ss'"],
    ),
    "walk": Command(
        _walk,
        "Walks by a gait: warms the wires up, makes so many cycles, and stops. Without a port it "
        "is an emulated robot that walks, whose limbs, masses and friction are not as described; "
        "its body is seen by an emulated camera.",
        "output driven plot json force",
        [
            Option("gait", type=Path, help="gait file (.csv), as soft-limb gait writes it"),
            Option(
                "-n",
                "--cycles",
                type=_at_least_one,
                default=8,
                help="number of cycles (default %(default)s)",
            ),
            Option(
                "--robot",
                type=Path,
                help="parameters (.yaml) that the emulated robot is drawn around, such as those "
                "before calibration (default: those that the gait was planned for)",
            ),
            Option(
                "--controller",
                choices=[STRIDES, BENDS, OPEN],
                help=f"{STRIDES}: hold the bends, and correct their amplitude and duration by each "
                f"stride; {BENDS}: hold them; {OPEN}: the gait's duty (default {STRIDES}, or "
                f"{BENDS} on a port, where no camera sees the body)",
            ),
        ],
        examples=["soft-limb walk out/gait.csv -n 4 -o out/walk.csv"],
    ),
}
