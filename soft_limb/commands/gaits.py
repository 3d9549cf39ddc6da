"""Commands of robots that walk."""

import argparse
import re
from pathlib import Path

from pydrake.systems.framework import LeafSystem

from controllers import GaitFeedback, PlanFeedback
from hardware import RobotTwin, SerialLimb
from limb_systems import Gait, LimbError, LimbSystem, Robot, RobotParameters
from limb_systems.views.panels import motion_panels
from planners.gait.schedules import schedule_of, schedule_text, sensible_schedules
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
from soft_limb.runs.gaits import find_gait
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
    trials = find_gait(
        robot,
        schedules,
        objective=options.objective,
        temperature_margin=options.margin,
        spread=not options.quick,
    )
    refused = [(schedule_text(trial.schedule), trial.reason) for trial in trials if trial.reason]
    gait = trials[0].gait
    if gait is None or trials[0].reason:
        raise LimbError(
            f"No schedule of {len(trials)} gives a gait that walks as planned: "
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
