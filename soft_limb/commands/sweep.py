"""The command ``soft-limb sweep``: many combinations of limbs, motions and controllers."""

import argparse
import os
import re

import numpy as np

from limb_systems import LimbError, LimbParameters
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
from soft_limb.runs.plan_run import load_reference
from soft_limb.runs.sweeping import SMOOTHING_TIME, make_cases, mean_table, sweep


def _sweep(options: argparse.Namespace) -> int:
    # Check the files before the first run.
    checked_outputs(options, options.limb, *options.references)
    for reference in options.references:
        load_reference(reference, SMOOTHING_TIME)
    vary = dict(options.vary)
    if len(vary) < len(options.vary):
        raise LimbError("--vary has a field twice; give all values of a field at once.")
    # List all combinations.
    cases = make_cases(
        LimbParameters.of(options.limb),
        options.references,
        vary=vary,
        controllers=options.controller or [OPEN_LOOP],
        seeds=options.seeds,
    )
    # Run them.
    print_duration(f"some seconds for a run ({len(cases)} in all), {options.jobs} at a time")
    with Progress("sweep", len(cases), "runs") as progress:
        rows = sweep(
            cases,
            options.output,
            progress.update,
            num_processes=options.jobs,
            cluster=options.cluster,
        )
    if not options.json:
        title = "means over limbs: mean distances of the true bend, highest V and T"
        print_table(title, list(mean_table(rows)))
    print_summary(options, Summary.of({}, {"runs": rows}), [options.output])
    # A sweep without any result has failed.
    if not any(row["reference_deg"] for row in rows):
        raise LimbError(f"No run gave a result; the trouble of the first: {rows[0]['trouble']}")
    return 0


def _seeds(text: str) -> list[int]:
    """Return the seeds of a text such as 0-9 or 0,3,7-9, for the type of an option."""
    if not re.fullmatch(r"\d+(-\d+)?(,\d+(-\d+)?)*", text):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of seeds, such as 0-9 or 0,3,7-9")
    seeds: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        seeds += range(int(first), int(last or first) + 1)
    return list(dict.fromkeys(seeds))


def _field(text: str) -> tuple[str, list[float]]:
    """Return a field and its values, from a text such as segments.0.stiffness=0.08:0.16:5."""
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
            f"{text!r} is not FIELD=VALUES, such as segments.0.stiffness=0.08:0.16:5 (first, last "
            "and number of values) or segments.0.stiffness=0.1,0.12"
        ) from None
    return field, numbers


COMMANDS = {
    "sweep": Command(
        _sweep,
        "Plan every combination of motions, limbs and controllers, and drive emulated limbs "
        "along the plans. The table has a row for each run: the mean distances of the true bend "
        "from the reference and from the plan, the mean distance of the plan from the reference, "
        "the highest temperatures, and any error.",
        "limb json force",
        [
            Option(
                "references",
                nargs="*",
                default=["fig5"],
                metavar="REFERENCE",
                help="motions to plan, each as for soft-limb plan (default fig5)",
            ),
            shared("output", help="table to write (.csv)"),
            Option(
                "--seeds",
                type=_seeds,
                help="seeds of the emulated limbs, such as 0-9 or 0,3,7-9; if left out, the "
                "emulated limb that --limb was calibrated on, or else 0",
            ),
            Option(
                "--vary",
                action="append",
                type=_field,
                default=[],
                metavar="FIELD=VALUES",
                help="field of the limb's file, and values as FIRST:LAST:COUNT or V,V,..., such as "
                "segments.0.stiffness=0.08:0.16:5; may be repeated",
            ),
            Option(
                "--controller",
                action="append",
                choices=CONTROLLERS,
                help="controller of the limbs, as for soft-limb replay; may be repeated (default "
                f"{OPEN_LOOP})",
            ),
            Option(
                "-j",
                "--jobs",
                type=count,
                default=os.cpu_count() or 1,
                help="number of processes (default %(default)s)",
            ),
            Option(
                "--cluster",
                metavar="ADDRESS",
                help="address of a Dask scheduler; its workers make the runs in place of processes "
                "of this computer",
            ),
        ],
        stopped="stopped; the table has the complete runs",
        examples=["soft-limb sweep mine.csv -l limb.yaml --seeds 0-9 -o out/sweep.csv"],
    ),
}
