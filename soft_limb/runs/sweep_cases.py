"""Sweeps: every combination of limbs, motions, tasks and controllers, planned and driven."""

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
from limb_systems.files.schema import shown
from limb_systems.tracking import reference_distances, tracking_errors, true_bend
from planners import Task, plan
from soft_limb.runs.jobs import run_each
from soft_limb.runs.plan_run import reference_from_file
from soft_limb.runs.rollout import OPEN, controller_of

# Of a run, beside what names it; angles in degrees, mean distances of the true bend.
RESULTS = (
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
    - ``task``, ``weights``: name of the task, and the task; None for the default one.
    - ``controller``: key in `CONTROLLERS`.
    - ``problem``: digits that differ for any other limb, reference or task.
    - ``physics``, ``seed``: emulated limb that is driven; the limb that ``limb`` was calibrated on
      if the seed is None.
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
        """The row's cells that tell it from others."""
        return {
            "problem": self.problem,
            **{field: f"{value:.12g}" for field, value in self.fields},
            "motion": self.motion,
            "task": self.task,
            "controller": self.controller,
            "physics": self.physics,
            "seed": "" if self.seed is None else str(self.seed),
        }


def cases(
    limb: LimbParameters,
    motions: Sequence[str],
    *,
    smoothing_time: float = 0.5,
    vary: Sequence[tuple[str, Sequence[float]]] = (),
    tasks: dict[str, Task] | None = None,
    controllers: Sequence[str] = (OPEN,),
    physics: Sequence[str] = ("lumped",),
    seeds: Sequence[int] | None = None,
) -> list[Case]:
    """Return all combinations; those with the same plan are beside each other.

    Args:
        limb: the description, around which limbs are drawn by their seeds, or the calibrated limb.
        motions, smoothing_time: see `Case`.
        vary: fields of the limb, such as ``segments.0.stiffness``, and their values.
        tasks: tasks by name; if None the default, and with a controller `Task.closed_loop`.
        controllers: keys in `CONTROLLERS`.
        physics: keys in `hardware.emulation.twin.SPECIMENS`.
        seeds: limbs' seeds; if None the limb that this one was calibrated on, or seed 0.

    Raises:
        LimbError: if there is no such field or physics, a value is not possible, or there are
            seeds but the limb was calibrated on an emulated one.
    """
    calibrated = emulated_limb(limb.board)
    if calibrated and seeds is not None:
        raise LimbError(
            f"This limb was calibrated on the emulated limb {calibrated.seed}, which it drives; "
            "leave --seeds out, or give the description that limbs are drawn around."
        )
    drawn: list[tuple[str, int | None]] = [(calibrated.physics, None)] if calibrated else []
    drawn = drawn or [(p, seed) for p in physics for seed in (seeds if seeds is not None else [0])]
    for name, _ in drawn:
        specimen_class(name)
    found = []
    for values in itertools.product(*(values for _, values in vary)):
        fields = tuple(zip((field for field, _ in vary), values, strict=True))
        varied = _with_fields(limb, fields)
        for motion, controller in itertools.product(motions, controllers):
            default = (
                {"default": None} if controller == OPEN else {"closed loop": Task.closed_loop()}
            )
            for task, weights in (tasks or default).items():
                problem = _digest(varied, reference_from_file(motion, smoothing_time), weights)
                case = functools.partial(
                    Case, motion, smoothing_time, varied, fields, task, weights, problem, controller
                )
                found += [case(*which) for which in drawn]
    return found


def _digest(limb: LimbParameters, course: trajectories.Trajectory, weights: Task | None) -> str:
    """Return digits that differ for any other limb, reference or task."""
    times = np.linspace(course.start_time(), course.end_time(), 1001)
    whole = limb.digest, times.tolist(), course.vector_values(times).tolist(), weights
    return hashlib.sha256(repr(whole).encode()).hexdigest()[:12]


def _with_fields(described: LimbParameters, fields: Sequence[tuple[str, float]]) -> LimbParameters:
    """A limb with other values of some fields."""
    limb: Any = copy.deepcopy(described)
    for path, value in fields:
        *way, last = path.split(".")
        try:
            owner = functools.reduce(_part, way, limb)
            whole = isinstance(_part(owner, last), int) and float(value).is_integer()
            setattr(owner, last, int(value) if whole else float(value))
        except (AttributeError, IndexError, TypeError, ValueError):
            raise LimbError(
                f"{shown(path)} is no number in the description of this limb; fields of its parts "
                "are written as segments.0.stiffness or segments.0.wires.1.law.a2."
            ) from None
    limb.validate()
    return limb


def _part(owner: Any, name: str) -> Any:
    part = owner[int(name)] if isinstance(owner, list) else getattr(owner, name)
    if part is None or isinstance(part, str | bool) or callable(part):
        raise TypeError
    return part


# The last plan of this process, as cases of one plan come one after the other.
_last: dict[str, tuple[Trajectory, float]] = {}


def _planned(case: Case) -> tuple[Trajectory, float]:
    """Return a plan, and how long it took, s."""
    if case.problem not in _last:
        start = time.perf_counter()
        reference = reference_from_file(case.motion, case.smoothing_time)
        trajectory = plan(case.limb, reference, task=case.weights)
        _last.clear()
        _last[case.problem] = trajectory, time.perf_counter() - start
    return _last[case.problem]


def run(case: Case) -> dict[str, str]:
    """Plan a case, drive the emulated limb along the plan, and return the row."""
    row = dict.fromkeys(RESULTS, "")
    try:
        trajectory, seconds = _planned(case)
        row["planning_s"] = f"{seconds:.3g}"
        if case.seed is None:
            twin = LimbTwin.of(case.limb)
        else:
            twin = LimbTwin(case.limb, seed=case.seed, physics=case.physics)
        controller = controller_of(case.controller, trajectory)
        recording = replay(trajectory, twin.after_rest(truth=True), controller=controller)
        truth = true_bend(recording)
        from_reference = reference_distances(trajectory, [truth])
        assert from_reference.done is not None  # of a recording
        angles = {
            "reference_deg": from_reference.done,
            "planned_deg": from_reference.planned,
            "plan_deg": tracking_errors(trajectory, [truth]).mean,
        }
        row |= {name: f"{np.rad2deg(angle):.4f}" for name, angle in angles.items()}
        assert recording.wire_temperature is not None
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
    """Runs the cases that a file does not have yet, and writes each row when it is there.

    Args:
        wanted: with the same fields.
        file: table (.csv), which goes on where it ended; rows of other cases stay in it.
        tell: is called with how many of the rows there are.
        num_processes, cluster: as for `run_each`.

    Returns:
        The rows of the cases, in their order.

    Raises:
        LimbError: if the file is not that of a sweep of these fields.
    """
    names = [case.name for case in wanted]
    columns = [*names[0], *RESULTS]

    def key(row: dict[str, str]) -> tuple[str, ...]:
        return tuple(row[column] for column in names[0])

    rows = _rows(file, columns)
    write_atomically(file, _table([columns, *(list(row.values()) for row in rows)]))
    found = {key(row): row for row in rows}
    missing = [case for case, name in zip(wanted, names, strict=True) if key(name) not in found]
    done = len(wanted) - len(missing)
    tell(done)
    for row in run_each(run, missing, num_processes, cluster=cluster):
        found[key(row)] = row
        with file.open("a", newline="", encoding="utf-8") as table:
            table.write(_table([list(row.values())]))
        tell(done := done + 1)
    return [found[key(name)] for name in names]


def _rows(file: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Return the whole rows of a file; none if there is no file."""
    if not file.exists():
        return []
    with file.open(newline="", encoding="utf-8") as table:
        reader = csv.DictReader(table)
        if reader.fieldnames != columns:
            raise LimbError(
                f"{file} is not the table of a sweep of these fields; give another name, or "
                "--force to replace it."
            )
        return [row for row in reader if None not in row.values()]  # a row may be half-written


def _table(rows: Sequence[Sequence[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def means(rows: Sequence[dict[str, str]]) -> Iterator[list[str]]:
    """A header, and a row for the limbs of each combination: means of angles, highest V and T."""
    sorts = [name for name in rows[0] if name not in ("problem", "seed", *RESULTS)]
    yield [*sorts, "runs", "from reference", "plan from it", "from plan", "V", "T", "troubles"]
    groups: dict[tuple[str, ...], list[dict[str, str]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in sorts), []).append(row)
    for group, runs in groups.items():
        driven = [row for row in runs if row["reference_deg"]]
        columns = np.array([[float(row[name]) for name in RESULTS[:5]] for row in driven])
        cells = [""] * 5
        if driven:
            cells = [f"{mean:.2f}°" for mean in columns[:, :3].mean(axis=0)]
            cells += [f"{highest:.0f} °C" for highest in columns[:, 3:].max(axis=0)]
        yield [*group, str(len(runs)), *cells, str(sum(bool(row["trouble"]) for row in runs))]
