"""``python -m planners``: plans a trajectory and writes it to a file."""

import argparse
import json
from pathlib import Path

from limb_systems import Trajectory
from limb_systems.output import check_outputs
from planners.planning import MAX_KNOTS
from planners.task import Task
from soft_limb.command import add_force_option, run_command
from soft_limb.reports.plan import plan_facts, plan_summary, write_report
from soft_limb.runs.request import Request, make_plan


def main(arguments: list[str] | None = None, prog: str = "python -m planners") -> int:
    options = _parser(prog).parse_args(arguments)
    return run_command(lambda: _plan(options), "stopped; nothing was written")


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=prog,
        description="Plans the feasible trajectory of a limb that is nearest to a reference bend "
        "angle, checks it by simulation, and writes it to a file that robots replay.",
        epilog="exit status: 0 the plan was written, 1 there is no plan, 2 wrong usage, 130 "
        "stopped by Ctrl-C",
    )
    parser.add_argument(
        "reference",
        help="'fig5' for the paper's two steps and decaying sinusoid; or a recording (teach and "
        "repeat); or a CSV of time in s and bend angle in degrees, as spreadsheets write it",
    )
    parser.add_argument(
        "-o", "--output", required=True, type=Path, help="trajectory file to write (.csv)"
    )
    parser.add_argument(
        "-l", "--limb", type=Path, help="limb parameters (.yaml); the nominal limb if left out"
    )
    task = parser.add_mutually_exclusive_group()
    task.add_argument(
        "--task",
        help="weights and limits: a file (.yaml), or 'paper' for the paper's; the defaults of "
        "planners.Task if left out",
    )
    task.add_argument(
        "--closed-loop",
        action="store_true",
        help="plan for feedback: with margins of temperature and duty, Task.closed_loop",
    )
    parser.add_argument("--plot", type=Path, help="picture of the plan to write (.png, .pdf, .svg)")
    parser.add_argument(
        "--diagnostics",
        type=Path,
        help="picture of constraint violations and the Jacobian's sparsity to write",
    )
    parser.add_argument(
        "--report", type=Path, help="page on the plan to write, with a chart to look into (.html)"
    )
    parser.add_argument(
        "--knot-rate", type=float, default=10.0, help="knots per second (default %(default)g)"
    )
    parser.add_argument(
        "--max-knots",
        type=int,
        default=MAX_KNOTS,
        help="refuse to plan with more knots than this (default %(default)s)",
    )
    parser.add_argument(
        "--tolerance",
        type=float,
        default=0.1,
        help="largest difference of the plan from its simulation, degrees (default %(default)g)",
    )
    parser.add_argument(
        "--smooth",
        type=float,
        default=0.5,
        help="window for smoothing a recording's bend angle, s (default %(default)g)",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_force_option(parser)
    return parser


def _plan(options) -> int:
    pictures = [options.plot, options.diagnostics]
    outputs = [path for path in (options.output, *pictures, options.report) if path]
    check_outputs(
        outputs,
        inputs=[Path(options.reference), options.limb, options.task and Path(options.task)],
        pictures=pictures,
        tables=[options.output],
        force=options.force,
    )
    trajectory = make_plan(
        Request(
            reference=options.reference,
            limb=options.limb,
            task=Task.closed_loop() if options.closed_loop else _task(options.task),
            smoothing_time=options.smooth,
            knot_rate=options.knot_rate,
            max_knots=options.max_knots,
            tolerance_deg=options.tolerance,
        )
    )
    trajectory.save(options.output)
    if any(pictures):
        _draw(trajectory, options)
    if options.report:
        write_report(trajectory, options.report, _data(options))
    written = [str(path) for path in outputs]
    if options.json:
        print(json.dumps({**plan_facts(trajectory), "written": written}))
    else:
        print(plan_summary(trajectory))
        print(f"written     {', '.join(written)}")
    return 0


def _draw(trajectory: Trajectory, options) -> None:
    # Matplotlib takes as long to import as all the rest.
    from limb_systems.views.plots import plot_tracking, save_figure
    from planners.diagnostics import plot_diagnostics

    if options.plot:
        save_figure(plot_tracking(trajectory), options.plot)
    if options.diagnostics:
        save_figure(plot_diagnostics(trajectory), options.diagnostics)


def _data(options) -> dict[str, Path]:
    """The files of a plan, by what they are."""
    reference = Path(options.reference)
    files = {
        "trajectory": options.output,
        "reference": reference if reference.is_file() else None,
        "limb": options.limb,
    }
    return {name: path for name, path in files.items() if path}


def _task(name: str | None) -> Task | None:
    if name is None:
        return None
    return Task.paper() if name == "paper" else Task.load(name)
