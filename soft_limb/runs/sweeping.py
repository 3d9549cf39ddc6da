"""Sweeps: plan and drive every combination of limbs, motions and controllers."""

import collections
import copy
import csv
import dataclasses
import functools
import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hardware import LimbTwin
from hardware.emulation.specimen import emulated_limb
from hardware.replaying import replay
from limb_systems import LimbError, LimbParameters, Trajectory
from limb_systems.files.output import raising_output_error
from limb_systems.files.schema import short_repr
from limb_systems.tracking import reference_distances, tracking_errors, true_bend
from planners import Task, plan
from soft_limb.runs import OPEN_LOOP
from soft_limb.runs.jobs import run_each
from soft_limb.runs.plan_run import load_reference
from soft_limb.runs.rollout import make_controller

SMOOTHING_TIME = 0.5  # s, over which a recording's bend angle is smoothed
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


@dataclasses.dataclass(frozen=True)
class Case:
    """One run of a sweep.

    - ``group``: cells of its row in the table, by column, that are equal for all seeds.
    - ``limb``: parameters that the plan is made for.
    - ``seed``: emulated limb to drive; None for the limb that ``limb`` was calibrated on.
    """

    group: dict[str, str]
    limb: LimbParameters
    seed: int | None


def make_cases(
    limb: LimbParameters,
    motions: Sequence[str],
    *,
    vary: Mapping[str, Sequence[float]],
    controllers: Sequence[str] = (OPEN_LOOP,),
    seeds: Sequence[int] | None = None,
) -> list[Case]:
    """Return all combinations.

    Args:
        limb: a description, around which the seeds draw emulated limbs, or a calibrated limb.
        motions: names of references, or paths of their files.
        vary: values of fields of the limb, such as ``segments.0.stiffness``.
        controllers: keys in `CONTROLLERS`.
        seeds: seeds of emulated limbs; if None the limb that ``limb`` was calibrated on, or 0.

    Raises:
        LimbError: if there is no such field, a value is not possible, or there are seeds but the
            limb was calibrated on an emulated limb.
    """
    # Choose the emulated limbs.
    calibrated = emulated_limb(limb.board)
    if calibrated and seeds is not None:
        raise LimbError(
            f"This limb was calibrated on the emulated limb {calibrated.seed}, which the sweep "
            "drives; leave --seeds out, or give a description to draw limbs around."
        )
    default: list[int | None] = [None] if calibrated else [0]
    # Combine them with limbs, motions and controllers.
    cases = []
    for values in itertools.product(*vary.values()):
        fields = dict(zip(vary, values, strict=True))
        varied = _with_fields(limb, fields)
        texts = {field: f"{value:.12g}" for field, value in fields.items()}
        for motion, controller, seed in itertools.product(motions, controllers, seeds or default):
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


def sweep(
    cases: Sequence[Case],
    file: Path,
    announce: Callable[[int], object] = lambda done: None,
    *,
    num_processes: int = 1,
    cluster: str | None = None,
) -> list[dict[str, str]]:
    """Plan and drive the cases, and write each row when it is complete.

    Args:
        cases: cases that vary the same fields.
        file: table to write (.csv).
        announce: function that is called with the number of complete cases.
        num_processes, cluster: as for `run_each`.

    Returns:
        The rows of the cases, in their order.
    """
    each = functools.partial(run_each, num_processes=num_processes, cluster=cluster, in_order=True)
    # Make each plan once; it does not depend on the seed.
    planned = {tuple(case.group.values()): case for case in cases}
    plans = dict(zip(planned, each(_make_plan, planned.values()), strict=True))
    # Drive all limbs.
    rows = []
    jobs = [(case, plans[tuple(case.group.values())]) for case in cases]
    columns = [*cases[0].group, "seed", *RESULT_COLUMNS]
    with raising_output_error(file), file.open("w", newline="", encoding="utf-8") as table:
        writer = csv.DictWriter(table, columns, lineterminator="\n")
        writer.writeheader()
        for row in each(_run_case, jobs):
            rows.append(row)
            writer.writerow(row)
            table.flush()
            announce(len(rows))
    return rows


def mean_table(rows: Sequence[dict[str, str]]) -> Iterator[list[str]]:
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
