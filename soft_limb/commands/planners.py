"""The command ``soft-limb plan``."""

import argparse
from pathlib import Path

from limb_systems import LimbParameters
from limb_systems.views.panels import tracking_panels
from planners.planning import MAX_KNOTS
from soft_limb.commands.options import (
    Command,
    Option,
    checked_outputs,
    print_summary,
    save_panels,
    shared,
)
from soft_limb.reports.plan_report import write_plan_report
from soft_limb.results.summaries import plan_summary
from soft_limb.runs.plan_run import load_task, plan_from_files


def _temperatures(text: str) -> list[float]:
    """Return temperatures, °C, from a text with commas, for the type of an option."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a list of temperatures in °C, such as 31.5 or 31.5,30.2"
        ) from None


def _plan(options: argparse.Namespace) -> int:
    # Plan.
    outputs = checked_outputs(options, options.reference, options.limb, options.task)
    limb = LimbParameters.of(options.limb)
    trajectory = plan_from_files(
        options.reference,
        limb,
        options.smooth,
        options.tip,
        options.start,
        task=options.task and load_task(options.task, limb),
        knot_rate=options.knot_rate,
        max_knots=options.max_knots,
        tolerance_deg=options.tolerance,
    )
    # Write the trajectory and its pictures.
    trajectory.save(options.output)
    save_panels(tracking_panels(trajectory), options.plot)
    if options.diagnostics:
        # Importing Matplotlib takes as long as importing everything else.
        from limb_systems.views.plots import save_figure
        from planners.diagnostics import plot_diagnostics

        save_figure(plot_diagnostics(trajectory), options.diagnostics)
    # Write the report, with links to the files behind it.
    summary = plan_summary(trajectory)
    if options.report:
        data = {"trajectory": options.output}
        if Path(options.reference).is_file():
            data["reference"] = Path(options.reference)
        if options.limb:
            data["limb"] = options.limb
        write_plan_report(trajectory, summary, options.report, data)
    print_summary(options, summary, outputs)
    return 0


COMMANDS = {
    "plan": Command(
        _plan,
        "Plan the feasible trajectory of a limb that is nearest to a reference bend angle. The "
        "plan is checked by simulation and saved for soft-limb replay.",
        "reference limb task plot report smooth knot-rate json force",
        [
            shared("output", help="trajectory file to write (.csv)"),
            Option(
                "--tip",
                action="store_true",
                help="the reference is a path of the tip: a CSV of time in s and the distance of "
                "the tip from the straight limb in mm, along E2, and E3 if the limb bends in space",
            ),
            Option(
                "--start",
                type=_temperatures,
                metavar="V[,V]",
                help="wire readings at the start of the plan, when the limb is at rest, °C: one "
                "number, or one for each wire; the ambient temperature if left out",
            ),
            Option(
                "--diagnostics",
                type=Path,
                help="picture to write, with constraint violations and the sparsity of the "
                "Jacobian",
            ),
            Option(
                "--max-knots",
                type=int,
                default=MAX_KNOTS,
                help="most knots of a plan; a reference that needs more is refused (default "
                "%(default)s)",
            ),
            Option(
                "--tolerance",
                type=float,
                help="largest difference allowed between the plan and its simulation, degrees "
                "(default 0.1; 1 for a limb that bends in space)",
            ),
        ],
        stopped="stopped; nothing was written",
        examples=[
            "soft-limb plan mine.csv -o out/plan.csv --plot out/plan.png",
            "soft-limb plan fig5 -l out/calibrated.yaml -o out/plan.csv --report out/plan.html",
        ],
    )
}
