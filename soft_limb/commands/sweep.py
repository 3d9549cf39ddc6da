"""The command that needs no robot: many combinations of limbs, motions and tasks."""

import argparse
import os
import re

import numpy as np

from limb_systems import LimbParameters
from limb_systems.progress import Progress
from limb_systems.summary import Summary
from soft_limb.commands.options import (
    Command,
    Option,
    checked_outputs,
    count,
    print_duration,
    print_summary,
    print_table,
    shared,
)
from soft_limb.runs import CONTROLLERS, OPEN_LOOP
from soft_limb.runs.plan_run import load_task
from soft_limb.runs.sweep_cases import make_cases, mean_table, sweep


def _sweep(options: argparse.Namespace) -> int:
    tasks = options.task or []
    checked_outputs(options, options.limb, *options.references, *tasks, goes_on=True)
    wanted = make_cases(
        LimbParameters.of(options.limb),
        options.references,
        smoothing_time=options.smooth,
        vary=options.vary,
        tasks={name: load_task(name) for name in tasks},
        controllers=options.controller or [OPEN_LOOP],
        physics=options.physics or ["lumped"],
        seeds=options.seeds,
    )
    if options.force:
        options.output.unlink(missing_ok=True)
    print_duration(f"some seconds for each run, of {len(wanted)} in {options.jobs} at a time")
    with Progress("sweep", len(wanted), "runs") as progress:
        rows = sweep(
            wanted,
            options.output,
            progress.update,
            num_processes=options.jobs,
            cluster=options.cluster,
        )
    if not options.json:
        title = "mean_table over limbs of mean distances of the true bend, highest V and T"
        print_table(title, list(mean_table(rows)))
    print_summary(options, Summary.of({}, {"runs": rows}), [options.output])
    return 0


def _seeds(text: str) -> list[int]:
    """Seeds such as 0-9 or 0,3,7-9."""
    if not re.fullmatch(r"\d+(-\d+)?(,\d+(-\d+)?)*", text):
        raise argparse.ArgumentTypeError(f"{text!r} is not seeds, such as 0-9 or 0,3,7-9")
    ends = [[int(end) for end in part.split("-")] for part in text.split(",")]
    return list(dict.fromkeys(seed for end in ends for seed in range(end[0], end[-1] + 1)))


def _field(text: str) -> tuple[str, list[float]]:
    """A field and its values, such as segments.0.stiffness=0.08:0.16:5 or =0.1,0.12."""
    field, _, values = text.partition("=")
    try:
        if ":" in values:
            low, high, count = values.split(":")
            numbers = np.linspace(float(low), float(high), int(count)).tolist()
        else:
            numbers = [float(value) for value in values.split(",")]
        if not numbers or not np.isfinite(numbers).all():
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a field and its values, such as segments.0.stiffness=0.08:0.16:5, "
            "from, to and how many, or segments.0.stiffness=0.1,0.12"
        ) from None
    return field, numbers


COMMANDS = {
    "sweep": Command(
        _sweep,
        "Plans every combination of motions, limbs, tasks and controllers, and drives emulated "
        "limbs along the plans. The table has a row for each run: mean distances of the true bend "
        "from the reference and from the plan, of the plan from the reference, the highest "
        "temperatures, and what went wrong. Started again, it goes on from there.",
        "limb smooth json",
        [
            Option(
                "references",
                nargs="*",
                default=["fig5"],
                metavar="REFERENCE",
                help="motions, each as for soft-limb plan (default fig5)",
            ),
            shared("output", help="table to write (.csv), or to go on with"),
            Option(
                "--seeds",
                type=_seeds,
                help="those of the emulated limbs, such as 0-9 or 0,3,7-9; if left out, the limb "
                "that --limb was calibrated on, or else 0",
            ),
            Option(
                "--vary",
                action="append",
                type=_field,
                default=[],
                metavar="FIELD=VALUES",
                help="a field of the limb's file and its values: FROM:TO:COUNT, or several with "
                "commas between them, such as segments.0.stiffness=0.08:0.16:5",
            ),
            Option(
                "--task",
                action="append",
                help="task: a file (.yaml), 'paper' or 'closed-loop'; if left out the default one, "
                "and with a controller closed-loop",
            ),
            Option(
                "--controller",
                action="append",
                choices=CONTROLLERS,
                help=f"what drives them, as for soft-limb replay (default {OPEN_LOOP})",
            ),
            Option(
                "--physics",
                action="append",
                help="family of emulated limbs (default lumped); --import names the module of any "
                "other",
            ),
            Option(
                "-j",
                "--jobs",
                type=count,
                default=os.cpu_count() or 1,
                help="processes (default %(default)s)",
            ),
            Option(
                "--cluster",
                metavar="ADDRESS",
                help="of a Dask scheduler, whose workers run it in place of these processes",
            ),
            Option("--force", action="store_true", help="begin the table anew"),
        ],
        stopped="stopped; the table has the runs that were finished",
        examples=["soft-limb sweep mine.csv -l limb.yaml --seeds 0-9 -o out/sweep.csv"],
    ),
}
