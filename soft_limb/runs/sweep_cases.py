"""Sweeps: plan and drive every combination of limbs, motions, tasks and controllers."""

import collections
import copy
import csv
import dataclasses
import functools
import hashlib
import io
import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake import trajectories

from hardware import LimbTwin
from hardware.emulation.specimen import emulated_limb
from hardware.emulation.twin import specimen_class
from hardware.replaying import replay
from limb_systems import LimbError, LimbParameters, Trajectory
from limb_systems.files.output import write_atomically
from limb_systems.files.schema import short_repr
from limb_systems.tracking import reference_distances, tracking_errors, true_bend
from planners import Task, plan
from soft_limb.runs.jobs import run_each
from soft_limb.runs.plan_run import load_reference
from soft_limb.runs.rollout import OPEN_LOOP, make_controller

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

    - ``motion``: "fig5", or the path of a file, which is read where the case is run.
    - ``smoothing_time``: window over which a recording's bend angle is smoothed, s.
    - ``limb``: parameters that the plan is made for.
    - ``fields``: varied fields of the limb, with their values.
    - ``task``, ``weights``: name of the task, and the task; None for the default task.
    - ``problem``: hash of limb, reference and task.
    - ``controller``: key in `CONTROLLERS`.
    - ``physics``, ``seed``: emulated limb to drive; the limb that ``limb`` was calibrated on if
      the seed is None.
    """

    motion: str
    smoothing_time: float
    limb: LimbParameters
    fields: tuple[tuple[str, float], ...]
    task: str
    weights: Task | None
    problem: str
    controller: str
    physics: str
    seed: int | None

    @property
    def name(self) -> dict[str, str]:
        """The cells that identify the row of this case in the table."""
        return {
            "problem": self.problem,
            **{field: f"{value:.12g}" for field, value in self.fields},
            "motion": self.motion,
            "task": self.task,
            "controller": self.controller,
            "physics": self.physics,
            "seed": "" if self.seed is None else str(self.seed),
        }


def make_cases(
    limb: LimbParameters,
    motions: Sequence[str],
    *,
    smoothing_time: float = 0.5,
    vary: Sequence[tuple[str, Sequence[float]]] = (),
    tasks: dict[str, Task] | None = None,
    controllers: Sequence[str] = (OPEN_LOOP,),
    physics: Sequence[str] = ("lumped",),
    seeds: Sequence[int] | None = None,
) -> list[Case]:
    """Return all combinations; the cases of one plan follow each other.

    Args:
        limb: a description, around which the seeds draw emulated limbs, or a calibrated limb.
        motions, smoothing_time: see `Case`.
        vary: fields of the limb, such as ``segments.0.stiffness``, and their values.
        tasks: tasks by name; if None the default task, or `Task.closed_loop` with a controller.
        controllers: keys in `CONTROLLERS`.
        physics: keys in `hardware.emulation.twin.SPECIMENS`.
        seeds: seeds of emulated limbs; if None the limb that ``limb`` was calibrated on, or 0.

    Raises:
        LimbError: if there is no such field or physics, a value is not possible, or there are
            seeds but the limb was calibrated on an emulated limb.
    """
    # Choose the emulated limbs.
    calibrated = emulated_limb(limb.board)
    if calibrated and seeds is not None:
        raise LimbError(
            f"This limb was calibrated on the emulated limb {calibrated.seed}, which the sweep "
            "drives; leave --seeds out, or give a description to draw limbs around."
        )
    specimens: list[tuple[str, int | None]] = [(calibrated.physics, None)] if calibrated else []
    if not specimens:
        specimens += itertools.product(physics, [0] if seeds is None else seeds)
    for name, _ in specimens:
        specimen_class(name)  # raises LimbError if there are no such physics
    # Combine them with limbs, motions, controllers and tasks.
    cases = []
    names = [name for name, _ in vary]
    for values in itertools.product(*(values for _, values in vary)):
        fields = tuple(zip(names, values, strict=True))
        varied = _with_fields(limb, fields)
        for motion, controller in itertools.product(motions, controllers):
            default = (
                {"default": None}
                if controller == OPEN_LOOP
                else {"closed loop": Task.closed_loop()}
            )
            for task, weights in (tasks or default).items():
                problem = _digest(varied, load_reference(motion, smoothing_time), weights)
                plan_fields = (motion, smoothing_time, varied, fields, task, weights, problem)
                cases += [Case(*plan_fields, controller, *specimen) for specimen in specimens]
    return cases


def _digest(limb: LimbParameters, motion: trajectories.Trajectory, weights: Task | None) -> str:
    """Return a hash of limb, reference and task."""
    times = np.linspace(motion.start_time(), motion.end_time(), 1001)
    inputs = limb.digest, times.tolist(), motion.vector_values(times).tolist(), weights
    return hashlib.sha256(repr(inputs).encode()).hexdigest()[:12]


def _with_fields(described: LimbParameters, fields: Sequence[tuple[str, float]]) -> LimbParameters:
    """Return a limb with new values in some fields, such as ``segments.0.stiffness``."""
    limb: Any = copy.deepcopy(described)
    for path, value in fields:
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


# The last plan of this process; the cases of one plan come one after the other.
_last_plan: dict[str, tuple[Trajectory, float]] = {}


def _plan_case(case: Case) -> tuple[Trajectory, float]:
    """Return the plan of a case, and the time that planning took, s."""
    if case.problem not in _last_plan:
        start = time.perf_counter()
        reference = load_reference(case.motion, case.smoothing_time)
        trajectory = plan(case.limb, reference, task=case.weights)
        _last_plan.clear()
        _last_plan[case.problem] = trajectory, time.perf_counter() - start
    return _last_plan[case.problem]


def run_case(case: Case) -> dict[str, str]:
    """Plan a case, drive the emulated limb along the plan, and return the row."""
    row = dict.fromkeys(RESULT_COLUMNS, "")
    try:
        # Plan, and drive the emulated limb.
        trajectory, seconds = _plan_case(case)
        row["planning_s"] = f"{seconds:.3g}"
        if case.seed is None:
            twin = LimbTwin.of(case.limb)
        else:
            twin = LimbTwin(case.limb, seed=case.seed, physics=case.physics)
        controller = make_controller(case.controller, trajectory)
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
    return case.name | row


def sweep(
    wanted: Sequence[Case],
    file: Path,
    tell: Callable[[int], object] = lambda done: None,
    *,
    num_processes: int = 1,
    cluster: str | None = None,
) -> list[dict[str, str]]:
    """Run the cases that a file does not have yet, and append each row when it is complete.

    Args:
        wanted: cases that vary the same fields.
        file: table (.csv) to continue; rows of other cases stay in it.
        tell: function that is called with the number of complete cases.
        num_processes, cluster: as for `run_each`.

    Returns:
        The rows of the cases, in their order.

    Raises:
        LimbError: if the file is not the table of a sweep of these fields.
    """
    names = [case.name for case in wanted]
    columns = [*names[0], *RESULT_COLUMNS]

    def key(row: dict[str, str]) -> tuple[str, ...]:
        return tuple(row[column] for column in names[0])

    # Drop a row that an interruption has cut off.
    rows = _complete_rows(file, columns)
    write_atomically(file, _table([columns, *(list(row.values()) for row in rows)]))
    # Run the cases that have no row.
    row_of = {key(row): row for row in rows}
    missing = [case for case in wanted if key(case.name) not in row_of]
    num_done = len(wanted) - len(missing)
    tell(num_done)
    for row in run_each(run_case, missing, num_processes, cluster=cluster):
        row_of[key(row)] = row
        with file.open("a", newline="", encoding="utf-8") as table:
            table.write(_table([list(row.values())]))
        num_done += 1
        tell(num_done)
    return [row_of[key(name)] for name in names]


def _complete_rows(file: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Return the complete rows of a table; none if there is no file."""
    if not file.exists():
        return []
    with file.open(newline="", encoding="utf-8") as table:
        reader = csv.DictReader(table)
        if reader.fieldnames != columns:
            raise LimbError(
                f"{file} is not the table of a sweep of these fields; give another name, or "
                "--force to replace it."
            )
        return [row for row in reader if None not in row.values()]


def _table(rows: Sequence[Sequence[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def mean_table(rows: Sequence[dict[str, str]]) -> Iterator[list[str]]:
    """Yield a header, and a row for each combination: mean angles, highest V and T over limbs."""
    groupers = [name for name in rows[0] if name not in ("problem", "seed", *RESULT_COLUMNS)]
    yield [*groupers, "runs", "from reference", "plan from it", "from plan", "V", "T", "troubles"]
    # Group the rows by all but the limb.
    groups = collections.defaultdict(list)
    for row in rows:
        groups[tuple(row[name] for name in groupers)].append(row)
    # Average the runs that were driven; others have an error.
    for group, runs in groups.items():
        driven = [row for row in runs if row["reference_deg"]]
        numbers = np.array([[float(row[name]) for name in RESULT_COLUMNS[:5]] for row in driven])
        cells = [""] * 5
        if driven:
            cells = [f"{mean:.2f}°" for mean in numbers[:, :3].mean(axis=0)]
            cells += [f"{highest:.0f} °C" for highest in numbers[:, 3:].max(axis=0)]
        yield [*group, str(len(runs)), *cells, str(sum(bool(row["trouble"]) for row in runs))]
