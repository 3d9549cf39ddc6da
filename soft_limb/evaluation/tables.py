"""What came of the evaluation in numbers: Table I, and where the error comes from."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from limb_systems import Provenance, Trajectory
from limb_systems.tracking import reference_distances, tracking_errors, true_bend
from planners import nearest_bend_angle
from soft_limb.evaluation.error_split import STEPS
from soft_limb.evaluation.experiment import AS_DESCRIBED, MOTIONS, RAMPS, VALIDATION, Experiment
from soft_limb.evaluation.ways import FEEDBACK, FOLLOW, LEARNING, OPEN_LOOP, Way

STATISTICS = ("mean", "median", "90th percentile")
ABORTED = "aborted rollouts"
TABLE_1_HEADER = [
    "trajectory",
    "limbs and way",
    "true bend from the reference: mean",
    "read bend from the reference: mean",
    "plan from the reference: mean",
    *(f"read bend from the plan: {name}" for name in STATISTICS),
    "true bend from the plan: mean",
    "highest V",
    "highest T",
    ABORTED,
]
SHOWN_REPETITIONS = (1, 4, 10)
DISTURBANCE_HEADER = [
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
PAPER_TABLE_1 = {  # degrees
    "Validation": (3.44, 2.33, 7.43),
    "T&R 1": (3.90, 2.73, 10.61),
    "T&R 2": (5.27, 5.09, 9.20),
}
PREDICTION = "the law that predicts best"
MOTION_NAMES = {
    RAMPS: "ramps that the limb can follow",
    VALIDATION: "Fig. 5: steps and decaying sinusoid",
    "T&R 1": "taught, faster and narrow",
    "T&R 2": "taught, wide with holds",
}
DISTANCE_HEADER = [
    "motion",
    "best within the limits",
    "open loop, not calibrated",
    "open loop",
    "follow",
    "learning",
]
APPROACH_HEADER = [
    "model",
    *MOTIONS,
    "V, °C",
    "aborted",
]


@dataclasses.dataclass(frozen=True)
class Followed:
    """How rollouts of a plan went, as far as they came; angles in degrees.

    - ``rollouts``, ``aborted``: how many there were, and were ended at the board's limit.
    - ``true_reference``, ``reference``: mean |φ_REF - φ| of the true bend, and as it was read.
    - ``planned``: mean |φ_REF - φ*|, what the plan asks for.
    - ``tracking``: `STATISTICS` of |φ* - φ| as the bend was read.
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
    def of(cls, way: Way) -> "Followed":
        trajectory, rollouts = way.trajectory.since_start(), way.rollouts
        wires = [rollout.wire_temperature for rollout in rollouts]
        truths = [true_bend(rollout) for rollout in rollouts]
        errors = tracking_errors(trajectory, rollouts)
        statistics = np.rad2deg([errors.mean, errors.median, errors.percentile_90])
        read, true = (reference_distances(trajectory, runs) for runs in (rollouts, truths))
        distances = np.rad2deg(np.array([true.done, read.done, read.planned], float)).tolist()
        return cls(
            rollouts=len(rollouts),
            aborted=sum(bool(rollout.interrupted) for rollout in rollouts),
            true_reference=distances[0],
            reference=distances[1],
            planned=distances[2],
            tracking=tuple(statistics.tolist()),
            true=float(np.rad2deg(tracking_errors(trajectory, truths).mean)),
            reading=_mean_reading_error(way),
            highest_reading=float(max(r.measured_temperature.max() for r in rollouts)),
            highest_temperature=float(max(t.max() for t in wires if t is not None)),
        )

    @property
    def read(self) -> float:
        """Mean |φ* - φ| as it was read."""
        return self.tracking[0]


def _mean_reading_error(way: Way) -> float:
    trajectory = way.trajectory.since_start()
    errors = [
        np.abs(np.interp(rollout.time, trajectory.time, planned) - measured).mean()
        for rollout in way.rollouts
        for planned, measured in zip(
            trajectory.measured_temperature, rollout.measured_temperature, strict=True
        )
    ]
    return float(np.mean(errors))


@dataclasses.dataclass(frozen=True)
class Summary:
    """The numbers of one experiment, angles in degrees.

    - ``seed``: the limb's number.
    - ``nearest``: mean distance from the reference that the limits leave of each motion, of the
      best plan; None if it is not known.
    - ``ways``: how each motion went in each way to drive it; of learning, the best repetitions
      so far.
    - ``repetitions``: how the best repetition went, after each, of each motion that was learned.
    - ``disturbed``: how the motion of Fig. 5 went under each disturbance, in each way.
    - ``first``: mean error that was read in the first rollout of each motion, open loop.
    - ``split``: parts of each motion's error, see `error_split`.
    - ``approaches``: how each motion went by each approach to calibration, open loop.
    - ``law``: name of the law that the limb was calibrated with.
    - ``provenance``: what made them.
    - ``physics``: family of the limb.
    """

    seed: int
    nearest: dict[str, float | None]
    ways: dict[str, dict[str, Followed]]
    repetitions: dict[str, list[Followed]]
    disturbed: dict[str, dict[str, Followed]]
    first: dict[str, float]
    split: dict[str, dict[str, tuple[float, float]]]
    approaches: dict[str, dict[str, Followed]]
    law: str
    provenance: Provenance | None = None
    physics: str = "lumped"


def summarize(experiment: Experiment) -> Summary:
    motions = experiment.motions
    ways = {
        motion.name: {name: Followed.of(way) for name, way in motion.ways.items()}
        for motion in motions
    }
    repetitions = {
        motion.name: [
            Followed.of(Way(motion.ways[LEARNING].trajectory, [rollout]))
            for rollout in motion.ways[LEARNING].rollouts
        ]
        for motion in motions
        if LEARNING in motion.ways
    }
    first = {
        motion.name: Followed.of(
            Way(motion.open_loop.trajectory, motion.open_loop.rollouts[:1])
        ).read
        for motion in motions
    }
    approaches = {
        name: {motion.name: Followed.of(motion.open_loop) for motion in compared}
        for name, compared in experiment.compared.items()
    }
    approaches[PREDICTION] = {name: driven[OPEN_LOOP] for name, driven in ways.items()}
    specimen, prediction = experiment.specimen, experiment.calibration.prediction
    return Summary(
        specimen.seed,
        {motion.name: nearest_distance(motion.open_loop.trajectory) for motion in motions},
        ways,
        repetitions,
        {
            disturbance: {name: Followed.of(way) for name, way in driven.items()}
            for disturbance, driven in experiment.disturbed.items()
        },
        first,
        experiment.split,
        approaches,
        prediction.best.name if prediction else "",
        Provenance.now(experiment.calibration.parameters, specimen.seed),
        specimen.physics,
    )


def nearest_distance(trajectory: Trajectory) -> float | None:
    """Mean |φ_REF - φ| of the best plan that the limits leave, degrees; None if there is none."""
    nearest = reference_distances(trajectory, nearest=nearest_bend_angle(trajectory)).nearest
    return None if nearest is None else float(np.rad2deg(nearest))


def distance_table(summaries: Sequence[Summary], physics: str = "lumped") -> list[list[str]]:
    """Rows of each motion, as of `DISTANCE_HEADER`: mean distances over a family's limbs."""
    whole = of_family(summaries, physics)
    rows = []
    for motion, name in MOTION_NAMES.items():
        ways = [summary.ways[motion] for summary in whole]
        described = [s.approaches[AS_DESCRIBED][motion] for s in whole]
        learned = [s.repetitions[motion][-1] for s in whole if motion in s.repetitions]
        driven = [[way[how] for way in ways if how in way] for how in (OPEN_LOOP, FOLLOW)]
        columns = [[f.true_reference for f in group] for group in (described, *driven, learned)]
        columns.insert(0, [left for s in whole if (left := s.nearest[motion]) is not None])
        cells = [f"{np.mean(column):.2f}°" if column else "" for column in columns]
        rows.append([name, *cells])
    return rows


def approach_table(summaries: Sequence[Summary]) -> list[list[str]]:
    """Rows of each approach: for each motion mean distances, then V, then aborted."""
    whole = of_family(summaries)
    rows = []
    for name in dict.fromkeys(name for s in whole for name in s.approaches):
        limbs = [s.approaches[name] for s in whole if name in s.approaches]
        cells = []
        for motion in MOTIONS:
            group = [limb[motion] for limb in limbs]
            cells.append("; ".join(_distances(group)))
        driven = [followed for limb in limbs for followed in limb.values()]
        heat = np.mean([followed.reading for followed in driven])
        aborted = np.mean([followed.aborted / followed.rollouts for followed in driven])
        suffix = f" ({len(limbs)} limb{'s' * (len(limbs) > 1)})" if len(limbs) < len(whole) else ""
        rows.append([name + suffix, *cells, f"{heat:.2f}", f"{100 * aborted:.0f}%"])
    return rows


def of_family(summaries: Sequence[Summary], physics: str = "lumped") -> list[Summary]:
    """Return the summaries of the limbs of one physics."""
    return [s for s in summaries if s.physics == physics]


def mean_and_margin(values: Sequence[float]) -> tuple[float, float]:
    """The mean over limbs and the half-width of its 95% confidence interval (Student's t)."""
    count = len(values)
    if count == 1:
        return float(values[0]), np.nan
    spread = np.std(values, ddof=1) / np.sqrt(count)
    return float(np.mean(values)), float(student.ppf(0.975, count - 1) * spread)


def table_1(summaries: Sequence[Summary]) -> list[list[str]]:
    """Rows of Table I, of each motion and each way, as of `TABLE_1_HEADER`; angles in degrees."""
    rows = []
    for motion in MOTIONS:
        for physics in dict.fromkeys(summary.physics for summary in summaries):
            rows += _family_rows(of_family(summaries, physics), motion)
        if motion in PAPER_TABLE_1:
            of_paper = [*[""] * 3, *(f"{value:.2f}" for value in PAPER_TABLE_1[motion])]
            rest = [""] * (len(TABLE_1_HEADER) - 2 - len(of_paper))
            rows.append([motion, "the paper's robot", *of_paper, *rest])
    # The motion's name is in its first row alone.
    return [
        ["" if number and row[0] == rows[number - 1][0] else row[0], *row[1:]]
        for number, row in enumerate(rows)
    ]


def _family_rows(whole: Sequence[Summary], motion: str) -> list[list[str]]:
    limbs = "emulated limb" if len(whole) == 1 else f"{len(whole)} emulated limbs"
    if whole[0].physics != "lumped":
        limbs = limbs.replace("emulated", f"{whole[0].physics}")
    groups: dict[str, list[Followed]] = {}
    for summary in whole:
        for name, followed in _rows_of(summary, motion).items():
            groups.setdefault(name, []).append(followed)
    left = [nearest for s in whole if (nearest := s.nearest[motion]) is not None]
    cell = _with_margin(*mean_and_margin(left)) if left else ""
    rest = [""] * (len(TABLE_1_HEADER) - 3)
    rows = [[motion, f"{limbs}, best plan within the limits", cell, *rest]]
    return rows + [[motion, f"{limbs}, {name}", *_cells(group)] for name, group in groups.items()]


def _rows_of(summary: Summary, motion: str) -> dict[str, Followed]:
    """What Table I has of a limb and a motion, by what the row is called."""
    rows = {name: way for name, way in summary.ways[motion].items() if name != LEARNING}
    learned = summary.repetitions.get(motion, [])
    shown = sorted({n for n in SHOWN_REPETITIONS if n < len(learned)} | {len(learned)} - {0})
    return rows | {f"{LEARNING}, best of {n}": learned[n - 1] for n in shown}


def _cells(group: Sequence[Followed]) -> list[str]:
    statistics = np.transpose([followed.tracking for followed in group])
    aborted, rollouts = (sum(getattr(f, name) for f in group) for name in ("aborted", "rollouts"))
    return [
        _with_margin(*mean_and_margin([followed.true_reference for followed in group])),
        f"{np.mean([followed.reference for followed in group]):.2f}",
        f"{np.mean([followed.planned for followed in group]):.2f}",
        *(_with_margin(*mean_and_margin(values)) for values in statistics),
        f"{np.mean([followed.true for followed in group]):.2f}",
        *_hottest(group),
        f"{aborted} of {rollouts}",
    ]


def _hottest(group: Sequence[Followed]) -> list[str]:
    """Highest V and highest T of all rollouts, °C."""
    return [
        f"{max(followed.highest_reading for followed in group):.0f}",
        f"{max(followed.highest_temperature for followed in group):.0f}",
    ]


def disturbance_table(summaries: Sequence[Summary]) -> list[list[str]]:
    """Rows of each disturbance, as of `DISTURBANCE_HEADER`, and of all at last."""
    whole = [s for s in of_family(summaries) if s.disturbed]
    if not whole:
        return []
    groups = {name: [s.disturbed[name] for s in whole] for name in whole[0].disturbed}
    rows = []
    for name, limbs in groups.items():
        closed = [limb[FEEDBACK] for limb in limbs]
        row = [name, *_distances(closed), *_hottest(closed), _aborted(closed)]
        if OPEN_LOOP in limbs[0]:
            opened = [limb[OPEN_LOOP] for limb in limbs]
            row += [*_distances(opened), _hottest(opened)[1], _aborted(opened)]
        rows.append(row + [""] * (len(DISTURBANCE_HEADER) - len(row)))
    every = [limb[FEEDBACK] for limbs in groups.values() for limb in limbs]
    row = ["all, the worst", "", "", *_hottest(every), _aborted(every)]
    rows.append(row + [""] * (len(DISTURBANCE_HEADER) - len(row)))
    return rows


def _distances(group: Sequence[Followed]) -> tuple[str, str]:
    """Mean distance of the true bend from the reference; that from the plan, read / true."""
    away, read, true = np.mean([(f.true_reference, f.read, f.true) for f in group], axis=0)
    return f"{away:.2f}", f"{read:.2f} / {true:.2f}"


def _aborted(group: Sequence[Followed]) -> str:
    return f"{sum(f.aborted for f in group)} of {sum(f.rollouts for f in group)}"


def split_table(summaries: Sequence[Summary], which: int) -> list[list[str]]:
    """Rows of `error_split`: the difference a step makes (0), or its part of the error (1)."""
    whole = of_family(summaries)
    rows = [
        [
            f"{step}: {meaning}" if which == 0 else step,
            *(
                _with_margin(*mean_and_margin([s.split[motion][step][which] for s in whole]))
                for motion in MOTIONS
            ),
        ]
        for step, meaning in STEPS.items()
    ]
    errors = [
        _with_margin(*mean_and_margin([s.first[motion] for s in whole])) for motion in MOTIONS
    ]
    return [*rows, ["whole error of the first rollout", *errors]]


def _with_margin(value: float, margin: float) -> str:
    text = f"{round(value, 2) + 0.0:.2f}"  # and no -0.00
    return text if np.isnan(margin) else f"{text} ± {margin:.2f}"
