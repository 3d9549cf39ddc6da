"""The tables of the evaluation: Table I, and the sources of the error.

Each table is a list of rows of text, the header first. Angles are in degrees, temperatures in °C.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

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
        truths = [true_bend(rollout) for rollout in rollouts]
        read = reference_distances(plan, rollouts)
        true = reference_distances(plan, truths)
        distances = np.rad2deg(
            np.array([true.measured, read.measured, read.planned], float)
        ).tolist()
        errors = dataclasses.astuple(tracking_errors(plan, rollouts))
        # Compute the errors of V for each rollout and wire.
        reading_errors = []
        for rollout in rollouts:
            for planned, measured in zip(
                plan.measured_temperature, rollout.measured_temperature, strict=True
            ):
                interpolated = np.interp(rollout.time, plan.time, planned)
                reading_errors.append(np.abs(interpolated - measured).mean())
        wires = [rollout.wire_temperature for rollout in rollouts]
        return cls(
            len(rollouts),
            sum(bool(rollout.interrupted) for rollout in rollouts),
            distances[0],
            distances[1],
            distances[2],
            tuple(np.rad2deg(errors).tolist()),
            float(np.rad2deg(tracking_errors(plan, truths).mean)),
            float(np.mean(reading_errors)),
            float(max(r.measured_temperature.max() for r in rollouts)),
            float(max(t.max() for t in wires if t is not None)),
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

    def numbers(
        groups: dict[str, dict[str, PlanWithRollouts]],
    ) -> dict[str, dict[str, RolloutStatistics]]:
        return {
            group: {name: RolloutStatistics.of(way) for name, way in ways.items()}
            for group, ways in groups.items()
        }

    # Compute the statistics of all rollouts, and of each repetition of learning.
    ways = numbers(experiment.ways)
    learned = {m: driven[LEARNING] for m, driven in experiment.ways.items() if LEARNING in driven}
    best = {motion: driven[OPEN_LOOP] for motion, driven in ways.items()}
    specimen = experiment.specimen
    prediction = experiment.calibration.prediction
    return Summary(
        specimen.seed,
        {m: nearest_distance(way[OPEN_LOOP].trajectory) for m, way in experiment.ways.items()},
        ways,
        {
            motion: [
                RolloutStatistics.of(PlanWithRollouts(way.trajectory, [rollout]))
                for rollout in way.rollouts
            ]
            for motion, way in learned.items()
        },
        numbers(experiment.disturbed),
        experiment.split,
        numbers(experiment.compared) | {PREDICTION: best},
        prediction.best.name if prediction else "",
        Provenance.now(experiment.calibration.parameters, specimen.seed),
        specimen.physics,
    )


def nearest_distance(trajectory: Trajectory) -> float | None:
    """Return mean |φ_REF - φ| of the best plan within the limits, degrees; None if unknown."""
    nearest = reference_distances(trajectory, nearest=nearest_bend_angle(trajectory)).nearest
    return None if nearest is None else float(np.rad2deg(nearest))


def limbs_of_family(summaries: Sequence[Summary], physics: str = LUMPED) -> list[Summary]:
    """Return the summaries of the limbs of one physics."""
    return [s for s in summaries if s.physics == physics]


def _nearest(limbs: Sequence[Summary], motion: str) -> list[float]:
    return [left for limb in limbs if (left := limb.nearest[motion]) is not None]


def distance_table(summaries: Sequence[Summary], physics: str = LUMPED) -> Rows:
    """Return the mean distance of the true bend from the reference, by motion and method."""
    header = ["motion", "best within the limits", "open loop, not calibrated"]
    rows = [[*header, OPEN_LOOP, FOLLOW, LEARNING]]
    limbs = limbs_of_family(summaries, physics)
    for motion, name in MOTION_NAMES.items():
        ways = [limb.ways[motion] for limb in limbs]
        driven = [
            [limb.approaches[AS_DESCRIBED][motion] for limb in limbs],
            *([way[how] for way in ways if how in way] for how in (OPEN_LOOP, FOLLOW)),
            [limb.repetitions[motion][-1] for limb in limbs if motion in limb.repetitions],
        ]
        columns = [[followed.true_reference for followed in group] for group in driven]
        columns = [_nearest(limbs, motion), *columns]
        rows.append([name, *(f"{np.mean(c):.2f}°" if c else "" for c in columns)])
    return rows


def table_1(summaries: Sequence[Summary]) -> Rows:
    """Return Table I: each motion and method, over the limbs of each family, and the paper's."""
    from_plan = "read bend from the plan"
    rows = [
        [
            "trajectory",
            "limbs and way",
            "true bend from the reference: mean",
            "read bend from the reference: mean",
            "plan from the reference: mean",
            *(f"{from_plan}: {name}" for name in ("mean", "median", "90th percentile")),
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
            motion_rows.append([best, mean_and_margin(_nearest(limbs, motion))])
            groups: dict[str, list[RolloutStatistics]] = {}
            for limb in limbs:
                ways = {way: made for way, made in limb.ways[motion].items() if way != LEARNING}
                for count, learned in enumerate(limb.repetitions.get(motion, []), 1):
                    if count in (*SHOWN_REPETITIONS, len(limb.repetitions[motion])):
                        ways[f"{LEARNING}, best of {count} as read"] = learned
                for way, made in ways.items():
                    groups.setdefault(way, []).append(made)
            motion_rows += [[f"{name}, {way}", *_cells(group)] for way, group in groups.items()]
        # Add the paper's row.
        if motion in PAPER_TABLE_1:
            errors = [f"{value:.2f}" for value in PAPER_TABLE_1[motion]]
            motion_rows.append(["the paper's robot", "", "", "", *errors])
        # Put the motion's name into its first row only.
        rows += [["" if number else motion, *row] for number, row in enumerate(motion_rows)]
    return _filled(rows)


def _cells(group: Sequence[RolloutStatistics]) -> list[str]:
    return [
        mean_and_margin([made.true_reference for made in group]),
        f"{np.mean([made.reference for made in group]):.2f}",
        f"{np.mean([made.planned for made in group]):.2f}",
        *map(mean_and_margin, zip(*(made.tracking for made in group), strict=True)),
        f"{np.mean([made.true for made in group]):.2f}",
        *_hottest(group),
    ]


def _hottest(group: Sequence[RolloutStatistics]) -> list[str]:
    """Return highest V and highest T of all rollouts, °C, and the number of aborted rollouts."""
    return [
        f"{max(made.highest_reading for made in group):.0f}",
        f"{max(made.highest_temperature for made in group):.0f}",
        f"{sum(made.aborted for made in group)} of {sum(made.rollouts for made in group)}",
    ]


def _distances(group: Sequence[RolloutStatistics]) -> tuple[str, str]:
    """Return the mean distance of the true bend from the reference, and read / true errors."""
    away, read, true = np.mean([(m.true_reference, m.read, m.true) for m in group], axis=0)
    return f"{away:.2f}", f"{read:.2f} / {true:.2f}"


def _filled(rows: Rows) -> Rows:
    """Fill short rows with empty cells."""
    return [row + [""] * (len(rows[0]) - len(row)) for row in rows]


def disturbance_table(summaries: Sequence[Summary]) -> Rows:
    """Return feedback and open loop by disturbance; the last row is the worst of feedback."""
    columns = "true bend from the reference", "bend from the plan, read / true"
    rows = [
        ["disturbance"]
        + [f"feedback: {name}" for name in (*columns, "highest V", "highest T", "aborted")]
        + [f"open loop: {name}" for name in (*columns, "highest T", "aborted")]
    ]
    limbs = [limb.disturbed for limb in limbs_of_family(summaries) if limb.disturbed]
    every = []
    for name in limbs[0] if limbs else []:
        closed = [limb[name][FEEDBACK] for limb in limbs]
        opened = [limb[name][OPEN_LOOP] for limb in limbs if OPEN_LOOP in limb[name]]
        row = [name, *_distances(closed), *_hottest(closed)]
        rows.append(row + ([*_distances(opened), *_hottest(opened)[1:]] if opened else []))
        every += closed
    if every:
        rows.append(["all, the worst", "", "", *_hottest(every)])
    return _filled(rows)


def approach_table(summaries: Sequence[Summary]) -> Rows:
    """Return mean distances by motion, error of V and aborted rollouts, by calibrated model."""
    limbs = limbs_of_family(summaries)
    rows = [["model", *MOTIONS, "V, °C", "aborted"]]
    for name in dict.fromkeys(name for limb in limbs for name in limb.approaches):
        compared = [limb.approaches[name] for limb in limbs if name in limb.approaches]
        driven = [made for limb in compared for made in limb.values()]
        count = f" ({len(compared)} limb{'s' * (len(compared) > 1)})" * (len(compared) < len(limbs))
        aborted = np.mean([made.aborted / made.rollouts for made in driven])
        rows.append(
            [
                name + count,
                *("; ".join(_distances([limb[motion] for limb in compared])) for motion in MOTIONS),
                f"{np.mean([made.reading for made in driven]):.2f}",
                f"{100 * aborted:.0f}%",
            ]
        )
    return rows


def law_table(summaries: Sequence[Summary]) -> Rows:
    """Return the law of each limb, and its true open-loop distances from reference and plan."""
    rows = [["limb", "law", *MOTIONS]]
    for limb in summaries:
        kind = "" if limb.physics == LUMPED else f"{limb.physics}, "
        made = [limb.ways[motion][OPEN_LOOP] for motion in MOTIONS]
        distances = [f"{m.true_reference:.2f}°, {m.true:.2f}°" for m in made]
        rows.append([f"{kind}seed {limb.seed}", limb.law, *distances])
    return rows


def step_table(summaries: Sequence[Summary]) -> Rows:
    """Return the mean absolute difference of each step of `error_split`."""
    return _split_table(summaries, {step: f"{step}: {what}" for step, what in STEPS.items()}, 0)


def part_table(summaries: Sequence[Summary]) -> Rows:
    """Return the part of each step of `error_split` in the whole error."""
    return _split_table(summaries, {step: step for step in STEPS}, 1)


def _split_table(summaries: Sequence[Summary], names: dict[str, str], which: int) -> Rows:
    splits = [limb.split for limb in limbs_of_family(summaries)]
    rows = [["", *MOTIONS]]
    for step, name in names.items():
        columns = [[split[motion][step][which] for split in splits] for motion in MOTIONS]
        rows.append([name, *map(mean_and_margin, columns)])
    # The parts add up to the mean error.
    errors = [[sum(p for _, p in split[motion].values()) for split in splits] for motion in MOTIONS]
    return [*rows, ["whole error of the first rollout", *map(mean_and_margin, errors)]]


def mean_and_margin(values: Sequence[float]) -> str:
    """Return the mean over limbs and the half-width of its 95% confidence interval (Student's t).

    One limb has no interval, and no limb an empty cell.
    """
    if not values:
        return ""
    text = f"{round(float(np.mean(values)), 2) + 0.0:.2f}"  # and no -0.00
    count = len(values)
    if count == 1:
        return text
    spread = np.std(values, ddof=1) / np.sqrt(count)
    return f"{text} ± {student.ppf(0.975, count - 1) * spread:.2f}"
