"""The command ``soft-limb sweep``: many combinations of limbs, motions and controllers."""

import argparse
import collections
import copy
import csv
import functools
import itertools
import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hardware import LimbTwin, replay
from hardware.emulation.specimen import emulated_limb
from limb_systems import LimbError, LimbParameters, Trajectory
from limb_systems.files.output import raising_output_error
from limb_systems.files.schema import short_repr
from limb_systems.progress import Progress
from limb_systems.summary import Summary
from limb_systems.tracking import reference_distances, tracking_errors, true_bend
from planners import Task, plan
from soft_limb.commands.options import (
    SMOOTHING_TIME,
    Command,
    Option,
    checked_outputs,
    count,
    print_duration,
    print_summary,
    print_table,
    shared,
)
from soft_limb.commands.planners import load_reference
from soft_limb.runs import CONTROLLERS, OPEN_LOOP
from soft_limb.runs.jobs import run_each
from soft_limb.runs.rollout import make_controller

# Columns of the results of a run; angles are mean distances of the true bend, in degrees.
RESULT_COLUMNS = (
    "reference_deg",
    "planned_deg",
    "plan_deg",
    "highest_reading_c",
    "highest_wire_c",
    "planning_s",
    "trouble",
)


class Case(NamedTuple):
    """One run of a sweep.

    - ``group``: cells of its row in the table, by column, that are equal for all seeds.
    - ``limb``: parameters that the plan is made for.
    - ``seed``: emulated limb to drive; None for the limb that ``limb`` was calibrated on.
    """

    group: dict[str, str]
    limb: LimbParameters
    seed: int | None


def _make_cases(options: argparse.Namespace) -> list[Case]:
    """Return all combinations of limbs, motions, controllers and seeds.

    Raises:
        LimbError: if there is no such field, a value is not possible, or there are seeds but the
            limb was calibrated on an emulated limb.
    """
    # Choose the emulated limbs.
    limb = LimbParameters.of(options.limb)
    calibrated = emulated_limb(limb.board)
    if calibrated and options.seeds is not None:
        raise LimbError(
            f"This limb was calibrated on the emulated limb {calibrated.seed}, which the sweep "
            "drives; leave --seeds out, or give a description to draw limbs around."
        )
    seeds = options.seeds or ([None] if calibrated else [0])
    # Combine them with limbs, motions and controllers.
    vary = dict(options.vary)
    if len(vary) < len(options.vary):
        raise LimbError("--vary has a field twice; give all values of a field at once.")
    controllers = options.controller or [OPEN_LOOP]
    cases = []
    for values in itertools.product(*vary.values()):
        fields = dict(zip(vary, values, strict=True))
        varied = _with_fields(limb, fields)
        texts = {field: f"{value:.12g}" for field, value in fields.items()}
        for motion, controller, seed in itertools.product(options.references, controllers, seeds):
            group = texts | {"motion": motion, "controller": controller}
            cases.append(Case(group, varied, seed))
    return cases


def _with_fields(described: LimbParameters, fields: Mapping[str, float]) -> LimbParameters:
    """Return a limb with new values in some fields, such as ``segments.0.stiffness``."""
    limb: Any = copy.deepcopy(described)
    for path, value in fields.items():
        # Find the owner of the field, and set it to a number of its type.
        *parents, last = path.split(".")
        try:
            owner = functools.reduce(_get_part, parents, limb)
            is_count = isinstance(_get_part(owner, last), int) and float(value).is_integer()
            setattr(owner, last, int(value) if is_count else float(value))
        except (AttributeError, IndexError, TypeError, ValueError):
            raise LimbError(
                f"{short_repr(path)} is no number in the description of this limb; name a field "
                "as in segments.0.stiffness or segments.0.wires.1.law.a2."
            ) from None
    limb.validate()
    return limb


def _get_part(owner: Any, name: str) -> Any:
    """Return an item of a list or an attribute; raise TypeError if it is no number or part."""
    part = owner[int(name)] if isinstance(owner, list) else getattr(owner, name)
    if part is None or isinstance(part, str | bool) or callable(part):
        raise TypeError
    return part


Planned = tuple[Trajectory | str, float]  # the plan or the error, and the time for it, s


def _make_plan(case: Case) -> Planned:
    """Plan the motion of a case, for feedback if a controller drives the limb."""
    start = time.perf_counter()
    task = None if case.group["controller"] == OPEN_LOOP else Task.closed_loop()
    reference = load_reference(case.group["motion"], SMOOTHING_TIME)
    try:
        made: Trajectory | str = plan(case.limb, reference, task=task)
    except LimbError as error:
        made = " ".join(str(error).split())
    return made, time.perf_counter() - start


def _run_case(job: tuple[Case, Planned]) -> dict[str, str]:
    """Drive the emulated limb of a case along the plan, and return the row."""
    case, (trajectory, planning_time) = job
    row = case.group | {"seed": "" if case.seed is None else str(case.seed)}
    row |= dict.fromkeys(RESULT_COLUMNS, "") | {"planning_s": f"{planning_time:.3g}"}
    if isinstance(trajectory, str):
        return row | {"trouble": trajectory}
    try:
        # Drive the emulated limb.
        twin = LimbTwin.of(case.limb, case.seed or 0)
        controller = make_controller(case.group["controller"], trajectory)
        recording = replay(trajectory, twin.after_rest(truth=True), controller=controller)
        # Compare the true bend with reference and plan.
        truth = true_bend(recording)
        distances = reference_distances(trajectory, [truth])
        error = tracking_errors(trajectory, [truth]).mean
        assert distances.measured is not None  # there is a recording
        assert recording.wire_temperature is not None  # the emulation knows it
        row["reference_deg"] = f"{np.rad2deg(distances.measured):.4f}"
        row["planned_deg"] = f"{np.rad2deg(distances.planned):.4f}"
        row["plan_deg"] = f"{np.rad2deg(error):.4f}"
        row["highest_reading_c"] = f"{recording.measured_temperature.max():.2f}"
        row["highest_wire_c"] = f"{recording.wire_temperature.max():.2f}"
        row["trouble"] = recording.interrupted or ""
    except LimbError as error:
        row["trouble"] = " ".join(str(error).split())
    return row


def _mean_table(rows: Sequence[dict[str, str]]) -> Iterator[list[str]]:
    """Yield a header, and a row for each combination: mean angles, highest V and T over limbs."""
    columns = list(rows[0])
    num_groupers = columns.index("seed")
    header = [*columns[:num_groupers], "runs", "from reference", "plan from it", "from plan"]
    yield [*header, "V", "T", "troubles"]
    # Group the rows by all but the limb.
    groups = collections.defaultdict(list)
    for row in rows:
        groups[tuple(row.values())[:num_groupers]].append(row)
    for group, runs in groups.items():
        # Average the runs that were driven; others have an error.
        numbers = []
        num_troubles = 0
        for row in runs:
            num_troubles += bool(row["trouble"])
            if row["reference_deg"]:
                numbers.append([float(row[name]) for name in RESULT_COLUMNS[:5]])
        cells = [""] * 5
        if numbers:
            cells = [f"{mean:.2f}°" for mean in np.mean(numbers, axis=0)[:3]]
            cells += [f"{highest:.0f} °C" for highest in np.max(numbers, axis=0)[3:]]
        yield [*group, str(len(runs)), *cells, str(num_troubles)]


def _sweep(options: argparse.Namespace) -> int:
    # Check the files before the first run.
    checked_outputs(options, options.limb, *options.references)
    for reference in options.references:
        load_reference(reference, SMOOTHING_TIME)
    cases = _make_cases(options)
    print_duration(f"some seconds for a run ({len(cases)} in all), {options.jobs} at a time")
    # Make each plan once; it does not depend on the seed.
    each = functools.partial(
        run_each, num_processes=options.jobs, cluster=options.cluster, in_order=True
    )
    planned = {tuple(case.group.values()): case for case in cases}
    plans = dict(zip(planned, each(_make_plan, planned.values()), strict=True))
    # Drive all limbs, and write each row when it is complete.
    jobs = [(case, plans[tuple(case.group.values())]) for case in cases]
    columns = [*cases[0].group, "seed", *RESULT_COLUMNS]
    rows = []
    with (
        Progress("sweep", len(cases), "runs") as progress,
        raising_output_error(options.output),
        options.output.open("w", newline="", encoding="utf-8") as table,
    ):
        writer = csv.DictWriter(table, columns, lineterminator="\n")
        writer.writeheader()
        for row in each(_run_case, jobs):
            rows.append(row)
            writer.writerow(row)
            table.flush()
            progress.update(len(rows))
    # Print the means over limbs.
    if not options.json:
        title = "means over limbs: mean distances of the true bend, highest V and T"
        print_table(title, list(_mean_table(rows)))
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
        new_seeds = range(int(first), int(last or first) + 1)
        if not new_seeds:
            raise argparse.ArgumentTypeError(
                f"{part!r} is no range of seeds; its end is below {first}"
            )
        seeds += new_seeds
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
