"""The tables of the evaluation: Table I, and the sources of the error.

Each table is a list of rows of text, the header first. Angles are in degrees, temperatures in °C.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from limb_systems import Provenance, Trajectory
from limb_systems.tracking import reference_distances, tracking_errors, true_bend
from planners import nearest_bend_angle
from reproduce_paper.driving import FEEDBACK, FOLLOW, LEARNING, OPEN_LOOP, PlanWithRollouts
from reproduce_paper.error_split import STEPS, Split
from reproduce_paper.experiment import AS_DESCRIBED, MOTIONS, RAMPS, VALIDATION, Experiment

LUMPED = "lumped"  # the family of limbs that most tables are about
PREDICTION = "the law that predicts best"
SHOWN_REPETITIONS = (1, 4, 10)
PAPER_TABLE_1 = {
    "Validation": (3.44, 2.33, 7.43),
    "T&R 1": (3.90, 2.73, 10.61),
    "T&R 2": (5.27, 5.09, 9.20),
}
MOTION_NAMES = {
    RAMPS: "ramps that the limb can follow",
    VALIDATION: "Fig. 5: steps and decaying sinusoid",
    "T&R 1": "taught, faster and narrow",
    "T&R 2": "taught, wide with holds",
}
Rows = list[list[str]]


@dataclasses.dataclass(frozen=True)
class RolloutStatistics:
    """Errors of the rollouts of a plan, until their end or abort; angles in degrees.

    - ``rollouts``, ``aborted``: number of rollouts, and how many the board's limit ended.
    - ``true_reference``, ``reference``: mean |φ_REF - φ| of the true bend, and as it was read.
    - ``planned``: mean |φ_REF - φ*|, the distance of the plan from the reference.
    - ``tracking``: mean, median and 90th percentile of |φ* - φ| as the bend was read.
    - ``true``: mean |φ* - φ| of the true bend.
    - ``reading``: mean |V* - V| of all wires, °C.
    - ``highest_reading``, ``highest_temperature``: V and the true T of the hottest wire, °C.
    """

    rollouts: int
    aborted: int
    true_reference: float
    reference: float
    planned: float
    tracking: tuple[float, ...]
    true: float
    reading: float
    highest_reading: float
    highest_temperature: float

    @classmethod
    def of(cls, way: PlanWithRollouts) -> "RolloutStatistics":
        """Compare the rollouts of a plan with the plan, its reference and the truth."""
        # Compute the distances of readings, true bend and plan from the reference.
        plan = way.trajectory.since_start()
        rollouts = way.rollouts
        truths = list(map(true_bend, rollouts))
        read = reference_distances(plan, rollouts)
        true = reference_distances(plan, truths)
        distances = np.array([true.measured, read.measured, read.planned], float)
        true_distance, read_distance, planned_distance = np.rad2deg(distances).tolist()
        errors = dataclasses.astuple(tracking_errors(plan, rollouts))
        # Compute the errors of V for each rollout and wire, and find the hottest wire.
        reading_errors = []
        highest_reading = -np.inf
        highest_temperature = -np.inf
        for rollout in rollouts:
            for planned, measured in zip(
                plan.measured_temperature, rollout.measured_temperature, strict=True
            ):
                interpolated = np.interp(rollout.time, plan.time, planned)
                reading_errors.append(np.abs(interpolated - measured).mean())
            assert rollout.wire_temperature is not None  # the emulation knows it
            highest_reading = max(highest_reading, rollout.measured_temperature.max())
            highest_temperature = max(highest_temperature, rollout.wire_temperature.max())
        return cls(
            rollouts=len(rollouts),
            aborted=sum(bool(rollout.interrupted) for rollout in rollouts),
            true_reference=true_distance,
            reference=read_distance,
            planned=planned_distance,
            tracking=tuple(np.rad2deg(errors).tolist()),
            true=float(np.rad2deg(tracking_errors(plan, truths).mean)),
            reading=float(np.mean(reading_errors)),
            highest_reading=float(highest_reading),
            highest_temperature=float(highest_temperature),
        )

    @property
    def read(self) -> float:
        """Mean |φ* - φ| of the bend as it was read."""
        return self.tracking[0]


@dataclasses.dataclass(frozen=True)
class Summary:
    """The numbers of one experiment, angles in degrees.

    - ``seed``, ``physics``: number and family of the limb.
    - ``nearest``: mean distance of the best plan within the limits from the reference, of each
      motion; None if it is not known.
    - ``ways``: statistics of each motion and method; for learning, of the best repetitions.
    - ``repetitions``: statistics of the best repetition so far, after each repetition, of each
      learned motion.
    - ``disturbed``: statistics of Fig. 5 under each disturbance, by method.
    - ``split``: parts of the error of each motion's first rollout, see `error_split`.
    - ``approaches``: statistics by approach to calibration and motion, open loop.
    - ``law``: name of the law that the limb was calibrated with.
    - ``provenance``: versions, parameters and seed behind the numbers.
    """

    seed: int
    nearest: dict[str, float | None]
    ways: dict[str, dict[str, RolloutStatistics]]
    repetitions: dict[str, list[RolloutStatistics]]
    disturbed: dict[str, dict[str, RolloutStatistics]]
    split: dict[str, Split]
    approaches: dict[str, dict[str, RolloutStatistics]]
    law: str
    provenance: Provenance | None = None
    physics: str = LUMPED


def summarize(experiment: Experiment) -> Summary:
    """Return the numbers of an experiment."""
    # Compute the statistics of each motion: its best plan, all rollouts, and the repetitions.
    nearest = {}
    repetitions = {}
    best = {}
    ways = _statistics(experiment.ways)
    for motion, driven in experiment.ways.items():
        nearest[motion] = nearest_distance(driven[OPEN_LOOP].trajectory)
        best[motion] = ways[motion][OPEN_LOOP]
        if LEARNING not in driven:
            continue
        repetitions[motion] = []
        for rollout in driven[LEARNING].rollouts:
            repetition = PlanWithRollouts(driven[LEARNING].trajectory, [rollout])
            repetitions[motion].append(RolloutStatistics.of(repetition))
    # Add the statistics of disturbances and other models.
    specimen = experiment.specimen
    prediction = experiment.calibration.prediction
    return Summary(
        seed=specimen.seed,
        nearest=nearest,
        ways=ways,
        repetitions=repetitions,
        disturbed=_statistics(experiment.disturbed),
        split=experiment.split,
        approaches=_statistics(experiment.compared) | {PREDICTION: best},
        law=prediction.best.name if prediction else "",
        provenance=Provenance.now(experiment.calibration.parameters, specimen.seed),
        physics=specimen.physics,
    )


def _statistics(
    groups: dict[str, dict[str, PlanWithRollouts]],
) -> dict[str, dict[str, RolloutStatistics]]:
    statistics: dict[str, dict[str, RolloutStatistics]] = {}
    for group, ways in groups.items():
        statistics[group] = {name: RolloutStatistics.of(way) for name, way in ways.items()}
    return statistics


def nearest_distance(trajectory: Trajectory) -> float | None:
    """Return mean |φ_REF - φ| of the best plan within the limits, degrees; None if unknown."""
    nearest = reference_distances(trajectory, nearest=nearest_bend_angle(trajectory)).nearest
    return None if nearest is None else float(np.rad2deg(nearest))


def limbs_of_family(summaries: Sequence[Summary], physics: str = LUMPED) -> list[Summary]:
    """Return the summaries of the limbs of one physics."""
    return [summary for summary in summaries if summary.physics == physics]


def _of_limbs(limbs: Sequence[Summary], field: str, *keys: str) -> list[Any]:
    """Return an entry in a field of each limb that has it, such as a motion and a method of ways.

    Args:
        field: a field of `Summary` that is a dict.
        keys: keys in that dict, and in the dicts in it.
    """
    entries = []
    for limb in limbs:
        entry = getattr(limb, field)
        for key in keys:
            entry = None if entry is None else entry.get(key)
        if entry is not None:
            entries.append(entry)
    return entries


def _column(group: Sequence[RolloutStatistics], name: str) -> np.ndarray:
    """Return one of the statistics for all members of a group."""
    return np.array([getattr(made, name) for made in group])


def distance_table(summaries: Sequence[Summary], physics: str = LUMPED) -> Rows:
    """Return the mean distance of the true bend from the reference, by motion and method."""
    header = ["motion", "best within the limits", "open loop, not calibrated"]
    rows = [[*header, OPEN_LOOP, FOLLOW, LEARNING]]
    limbs = limbs_of_family(summaries, physics)
    for motion, name in MOTION_NAMES.items():
        # Collect the rollouts of each method, and the last repetition of learning.
        learned = _of_limbs(limbs, "repetitions", motion)
        groups = (
            _of_limbs(limbs, "approaches", AS_DESCRIBED, motion),
            _of_limbs(limbs, "ways", motion, OPEN_LOOP),
            _of_limbs(limbs, "ways", motion, FOLLOW),
            [repetitions[-1] for repetitions in learned],
        )
        columns = [np.array(_of_limbs(limbs, "nearest", motion))]
        for group in groups:
            columns.append(_column(group, "true_reference"))
        cells = [f"{column.mean():.2f}°" if len(column) else "" for column in columns]
        rows.append([name, *cells])
    return rows


def table_1(summaries: Sequence[Summary]) -> Rows:
    """Return Table I: each motion and method, over the limbs of each family, and the paper's."""
    rows = [
        [
            "trajectory",
            "limbs and way",
            "true bend from the reference: mean",
            "read bend from the reference: mean",
            "plan from the reference: mean",
            "read bend from the plan: mean",
            "read bend from the plan: median",
            "read bend from the plan: 90th percentile",
            "true bend from the plan: mean",
            "highest V",
            "highest T",
            "aborted rollouts",
        ]
    ]
    for motion in MOTIONS:
        # Add the rows of each family of limbs: the best plan, and each method.
        motion_rows = []
        for physics in dict.fromkeys(summary.physics for summary in summaries):
            limbs = limbs_of_family(summaries, physics)
            name = f"{'emulated' if physics == LUMPED else physics} limb"
            name = f"{len(limbs)} {name}s" if len(limbs) > 1 else name
            best = f"{name}, best plan within the limits"
            nearest = _of_limbs(limbs, "nearest", motion)
            motion_rows.append([best, mean_and_margin(nearest)])
            groups: dict[str, list[RolloutStatistics]] = {}
            for limb in limbs:
                ways = dict(limb.ways[motion])
                ways.pop(LEARNING, None)
                for count, learned in enumerate(limb.repetitions.get(motion, []), 1):
                    if count in (*SHOWN_REPETITIONS, len(limb.repetitions[motion])):
                        ways[f"{LEARNING}, best of {count} as read"] = learned
                for way, made in ways.items():
                    groups.setdefault(way, []).append(made)
            for way, group in groups.items():
                motion_rows.append([f"{name}, {way}", *_cells(group)])
        # Add the paper's row.
        if motion in PAPER_TABLE_1:
            errors = [f"{value:.2f}" for value in PAPER_TABLE_1[motion]]
            motion_rows.append(["the paper's robot", "", "", "", *errors])
        # Put the motion's name into its first row only.
        title = motion
        for row in motion_rows:
            rows.append([title, *row])
            title = ""
    return _filled(rows)


def _cells(group: Sequence[RolloutStatistics]) -> list[str]:
    return [
        mean_and_margin(_column(group, "true_reference")),
        f"{_column(group, 'reference').mean():.2f}",
        f"{_column(group, 'planned').mean():.2f}",
        *map(mean_and_margin, _column(group, "tracking").T),
        f"{_column(group, 'true').mean():.2f}",
        *_hottest(group),
    ]


def _hottest(group: Sequence[RolloutStatistics]) -> list[str]:
    """Return highest V and highest T of all rollouts, °C, and the number of aborted rollouts."""
    return [
        f"{_column(group, 'highest_reading').max():.0f}",
        f"{_column(group, 'highest_temperature').max():.0f}",
        f"{_column(group, 'aborted').sum()} of {_column(group, 'rollouts').sum()}",
    ]


def _distances(group: Sequence[RolloutStatistics]) -> tuple[str, str]:
    """Return the mean distance of the true bend from the reference, and read / true errors."""
    away = _column(group, "true_reference").mean()
    read = _column(group, "read").mean()
    true = _column(group, "true").mean()
    return f"{away:.2f}", f"{read:.2f} / {true:.2f}"


def _filled(rows: Rows) -> Rows:
    """Fill short rows with empty cells."""
    return [row + [""] * (len(rows[0]) - len(row)) for row in rows]


def disturbance_table(summaries: Sequence[Summary]) -> Rows:
    """Return feedback and open loop by disturbance; the last row is the worst of feedback."""
    rows = [
        [
            "disturbance",
            "feedback: true bend from the reference",
            "feedback: bend from the plan, read / true",
            "feedback: highest V",
            "feedback: highest T",
            "feedback: aborted",
            "open loop: true bend from the reference",
            "open loop: bend from the plan, read / true",
            "open loop: highest T",
            "open loop: aborted",
        ]
    ]
    limbs = limbs_of_family(summaries)
    disturbances = dict.fromkeys(itertools.chain(*(limb.disturbed for limb in limbs)))
    every = []
    # Add a row for each disturbance; open loop has no row where a sensor is disturbed.
    for name in disturbances:
        closed = _of_limbs(limbs, "disturbed", name, FEEDBACK)
        opened = _of_limbs(limbs, "disturbed", name, OPEN_LOOP)
        row = [name, *_distances(closed), *_hottest(closed)]
        if opened:
            row += [*_distances(opened), *_hottest(opened)[1:]]
        rows.append(row)
        every += closed
    if every:
        rows.append(["all, the worst", "", "", *_hottest(every)])
    return _filled(rows)


def approach_table(summaries: Sequence[Summary]) -> Rows:
    """Return mean distances by motion, error of V and aborted rollouts, by calibrated model."""
    limbs = limbs_of_family(summaries)
    rows = [["model", *MOTIONS, "V, °C", "aborted"]]
    for name in dict.fromkeys(itertools.chain(*(limb.approaches for limb in limbs))):
        # Average over the limbs for which this model was made.
        driven = []
        distances = []
        for motion in MOTIONS:
            group = _of_limbs(limbs, "approaches", name, motion)
            driven += group
            distances.append("; ".join(_distances(group)))
        num_limbs = len(_of_limbs(limbs, "approaches", name))
        count = ""
        if num_limbs < len(limbs):
            count = f" ({num_limbs} limb{'s' * (num_limbs > 1)})"
        aborted = np.mean(_column(driven, "aborted") / _column(driven, "rollouts"))
        reading = _column(driven, "reading").mean()
        rows.append([name + count, *distances, f"{reading:.2f}", f"{100 * aborted:.0f}%"])
    return rows


def law_table(summaries: Sequence[Summary]) -> Rows:
    """Return the law of each limb, and its true open-loop distances from reference and plan."""
    rows = [["limb", "law", *MOTIONS]]
    for limb in summaries:
        kind = "" if limb.physics == LUMPED else f"{limb.physics}, "
        distances = []
        for motion in MOTIONS:
            made = limb.ways[motion][OPEN_LOOP]
            distances.append(f"{made.true_reference:.2f}°, {made.true:.2f}°")
        rows.append([f"{kind}seed {limb.seed}", limb.law, *distances])
    return rows


def step_table(summaries: Sequence[Summary]) -> Rows:
    """Return the mean absolute difference of each step of `error_split`."""
    names = [f"{step}: {meaning}" for step, meaning in STEPS.items()]
    return _split_table(summaries, names, 0)


def part_table(summaries: Sequence[Summary]) -> Rows:
    """Return the part of each step of `error_split` in the whole error."""
    return _split_table(summaries, list(STEPS), 1)


def _split_table(summaries: Sequence[Summary], names: Sequence[str], which: int) -> Rows:
    """Return a row for each step, with a number of its `Split`, and a row for the whole error."""
    columns = []
    for motion in MOTIONS:
        # The parts add up to the mean error.
        splits = _of_limbs(limbs_of_family(summaries), "split", motion)
        numbers = np.array([list(split.values()) for split in splits])  # (limbs, steps, 2)
        columns.append([*numbers[..., which].T, numbers[..., 1].sum(axis=1)])
    rows = [["", *MOTIONS]]
    for name, *cells in zip([*names, "whole error of the first rollout"], *columns, strict=True):
        rows.append([name, *map(mean_and_margin, cells)])
    return rows


def mean_and_margin(values: ArrayLike) -> str:
    """Return the mean over limbs and the half-width of its 95% confidence interval (Student's t).

    One limb has no interval, and no limb an empty cell.
    """
    count = np.size(values)
    if not count:
        return ""
    text = f"{round(float(np.mean(values)), 2) + 0.0:.2f}"  # and no -0.00
    if count == 1:
        return text
    spread = np.std(values, ddof=1) / np.sqrt(count)
    return f"{text} ± {stdtrit(count - 1, 0.975) * spread:.2f}"
