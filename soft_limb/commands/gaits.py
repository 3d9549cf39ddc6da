"""Commands of robots that walk."""

import argparse
import os
from pathlib import Path

from limb_systems import LimbError, RobotParameters
from limb_systems.output import check_outputs
from limb_systems.progress import Progress
from planners.gait.schedules import schedule_of, sensible_schedules
from soft_limb.commands.options import Command, Option, print_summary, print_table, shared
from soft_limb.runs.gaits import find_gait
from soft_limb.runs.jobs import local_executor


def _gait(options: argparse.Namespace) -> int:
    outputs = [options.output, options.plot, options.report]
    check_outputs(
        outputs,
        inputs=[options.robot],
        pictures=[options.plot],
        tables=[options.output],
        force=options.force,
    )
    robot = RobotParameters.of(options.robot)
    num_feet = len(robot.limbs)
    schedules = [schedule_of(text, num_feet) for text in options.schedule]
    schedules = schedules or sensible_schedules(num_feet)
    with (
        local_executor(min(os.cpu_count() or 1, len(schedules))) as executor,
        Progress("planning", len(schedules), "schedules") as progress,
    ):
        trials = find_gait(
            robot,
            schedules,
            executor,
            progress.update,
            objective=options.objective,
            temperature_margin=options.margin,
            spread=not options.quick,
        )
    refused = [(trial.schedule, trial.reason) for trial in trials if trial.reason]
    if refused and not options.json:
        print_table("schedules that were not taken", refused)
    gait = trials[0].gait
    if gait is None or trials[0].reason:
        raise LimbError(
            f"No schedule of {len(trials)} gives a gait that walks as planned: "
            + "; ".join(f"{schedule!r}, {reason.rstrip('.')}" for schedule, reason in refused)
            + "."
        )
    gait.save(options.output)
    if options.plot:
        # Matplotlib takes as long to import as all the rest.
        from limb_systems.views.robot_plots import plot_gait

        from limb_systems.views.plots import save_figure

        save_figure(plot_gait(gait), options.plot)
    if options.report:
        from soft_limb.reports.gait import gait_report

        gait_report(gait, options.report)
    print_summary(options, gait.summary(), outputs)
    return 0


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
                default=0.0,
                metavar="DEGREES",
                help="how far wires stay below T_max, °C (default %(default)g)",
            ),
            Option(
                "--quick",
                action="store_true",
                help="simulate it on the described ground alone, not on others",
            ),
        ],
        stopped="stopped; nothing was written",
    ),
}
