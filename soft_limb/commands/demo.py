"""The command that shows what there is, without files or a robot."""

import argparse
from pathlib import Path

from limb_systems import LimbParameters
from limb_systems.output import check_outputs
from soft_limb.commands.options import Command, Option, print_summary, say_duration
from soft_limb.results.summaries import plan_summary
from soft_limb.runs.planning import plan_from_files

PLAN, REPORT = "first_plan.csv", "report.html"


def _demo(options: argparse.Namespace) -> int:
    outputs = [options.folder / PLAN, options.folder / REPORT]
    check_outputs(outputs, force=options.force)
    say_duration("about two minutes on two cores")
    print("planning ramps for the limb as described ...", flush=True)
    trajectory = plan_from_files("ramps", LimbParameters())
    trajectory.save(outputs[0])
    print_summary(options, plan_summary(trajectory), outputs[:1])
    # Takes as long to import as all the rest.
    from soft_limb.evaluation.experiment import Settings
    from soft_limb.evaluation.reproduce import reproduce_in

    demo = Settings(0, compare=False, disturb=False, quick=True)
    return reproduce_in(options.folder, [demo])


COMMANDS = {
    "demo": Command(
        _demo,
        "Plans ramps, then takes an emulated limb through the paper: records it, calibrates the "
        "model, plans the ramps, the motion of Fig. 5 and two motions that were taught, and drives "
        "the limb in open loop, by feedback and with learning. Takes two minutes on two cores. The "
        "folder has report.html, replay.html, pictures, recordings and plans.",
        "force",
        [
            Option(
                "folder",
                nargs="?",
                default="out",
                type=Path,
                help="for all results, out by default",
            )
        ],
        stopped="stopped; what is finished is kept",
        examples=["soft-limb demo out"],
    )
}
