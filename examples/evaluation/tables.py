"""What came of the evaluation in numbers: Table I, and where the error comes from."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from evaluation.error_split import STEPS, error_split
from evaluation.experiment import Experiment, Motion
from limb_systems.tracking import tracking_errors

STATISTICS = ("mean", "median", "90th percentile")
ABORTED = "aborted rollouts"
PAPER_TABLE_1 = {  # degrees
    "Validation": (3.44, 2.33, 7.43),
    "T&R 1": (3.90, 2.73, 10.61),
    "T&R 2": (5.27, 5.09, 9.20),
}
PREDICTION = "the law that predicts best"
APPROACH_HEADER = [
    "calibrated model",
    *(f"{motion}: read / true" for motion in PAPER_TABLE_1),
    "V, °C",
    "aborted",
]


@dataclasses.dataclass(frozen=True)
class Summary:
    """The numbers of one experiment, angles in degrees.

    - ``seed``, ``absent``: of the limb, and which effects it was without.
    - ``rollouts``: of each motion, how many there were.
    - ``aborted``: of each motion, how many of them ended at the limit of the board.
    - ``tracking``: of each motion `STATISTICS` over all rollouts, as far as they came.
    - ``first``: of each motion the mean over the first rollout.
    - ``split``: of each motion and step, see `error_split`.
    - ``approaches``: of each approach to calibration and each motion, errors as of `_approach`.
    - ``law``: that the limb was calibrated with.
    """

    seed: int
    absent: tuple[str, ...]
    rollouts: int
    aborted: dict[str, int]
    tracking: dict[str, tuple[float, ...]]
    first: dict[str, float]
    split: dict[str, dict[str, tuple[float, float]]]
    approaches: dict[str, dict[str, tuple[float, ...]]]
    law: str


def summarize(experiment: Experiment) -> Summary:
    tracking, first, aborted = {}, {}, {}
    for motion in experiment.motions:
        aborted[motion.name] = sum(bool(rollout.interrupted) for rollout in motion.rollouts)
        errors = tracking_errors(motion.trajectory, motion.rollouts)
        degrees = np.rad2deg([errors.mean, errors.median, errors.percentile_90])
        tracking[motion.name] = tuple(degrees.tolist())
        alone = tracking_errors(motion.trajectory, motion.rollouts[:1])
        first[motion.name] = float(np.rad2deg(alone.mean))
    specimen = experiment.specimen
    rollouts = len(experiment.motions[0].rollouts)
    prediction = experiment.calibration.prediction
    approaches = {
        name: {motion.name: _approach(motion) for motion in motions}
        for name, motions in [*experiment.compared.items(), (PREDICTION, experiment.motions)]
    }
    return Summary(
        specimen.seed,
        specimen.absent,
        rollouts,
        aborted,
        tracking,
        first,
        error_split(experiment),
        approaches,
        prediction.best.name if prediction else "",
    )


def _approach(motion: Motion) -> tuple[float, ...]:
    """Mean errors of a motion: the bend as read and the true bend, degrees, and V, °C; aborted."""
    trajectory = motion.trajectory.since_start()
    read = tracking_errors(trajectory, motion.rollouts).mean
    true = tracking_errors(trajectory, [motion.exact]).mean
    heat = []
    for rollout in motion.rollouts:
        for planned, measured in zip(
            trajectory.measured_temperature, rollout.measured_temperature, strict=True
        ):
            heat.append(np.abs(np.interp(rollout.time, trajectory.time, planned) - measured).mean())
    aborted = sum(bool(rollout.interrupted) for rollout in motion.rollouts) / len(motion.rollouts)
    return float(np.rad2deg(read)), float(np.rad2deg(true)), float(np.mean(heat)), aborted


def approach_table(summaries: Sequence[Summary]) -> list[list[str]]:
    """Rows of each approach: for each motion mean errors as read and true, then V, then aborted."""
    whole = complete(summaries)
    rows = []
    for name in dict.fromkeys(name for s in whole for name in s.approaches):
        limbs = [s.approaches[name] for s in whole if name in s.approaches]
        cells = []
        for motion in PAPER_TABLE_1:
            read, true, _, _ = np.mean([limb[motion] for limb in limbs], axis=0)
            cells.append(f"{read:.2f} / {true:.2f}")
        means = np.mean([list(limb.values()) for limb in limbs], axis=(0, 1))
        suffix = f" ({len(limbs)} limbs)" if len(limbs) < len(whole) else ""
        rows.append([name + suffix, *cells, f"{means[2]:.2f}", f"{100 * means[3]:.0f}%"])
    return rows


def complete(summaries: Sequence[Summary]) -> list[Summary]:
    """Those of limbs that are without nothing."""
    return [s for s in summaries if not s.absent]


def mean_and_margin(values: Sequence[float]) -> tuple[float, float]:
    """The mean over limbs and the half-width of its 95% confidence interval (Student's t)."""
    count = len(values)
    if count == 1:
        return float(values[0]), np.nan
    spread = np.std(values, ddof=1) / np.sqrt(count)
    return float(np.mean(values)), float(student.ppf(0.975, count - 1) * spread)


def table_1(summaries: Sequence[Summary]) -> list[list[str]]:
    """Rows of Table I: trajectory, who, `STATISTICS` in degrees, and how many were aborted."""
    whole = complete(summaries)
    limbs = "emulated limb" if len(whole) == 1 else f"{len(whole)} emulated limbs"
    rows = []
    for motion, paper in PAPER_TABLE_1.items():
        ours = np.transpose([s.tracking[motion] for s in whole])
        aborted = sum(s.aborted[motion] for s in whole)
        aborted_of = f"{aborted} of {sum(s.rollouts for s in whole)}"
        rows.append([motion, limbs, *(_with_margin(*mean_and_margin(v)) for v in ours), aborted_of])
        rows.append(["", "the paper's robot", *(f"{value:.2f}" for value in paper), ""])
    return rows


def split_table(summaries: Sequence[Summary], which: int) -> list[list[str]]:
    """Rows of `error_split`: the difference a step makes (0), or the error without it (1)."""
    whole = complete(summaries)
    rows = [
        [
            f"{step}: {meaning}" if which == 0 else step,
            *(
                _with_margin(*mean_and_margin([s.split[motion][step][which] for s in whole]))
                for motion in PAPER_TABLE_1
            ),
        ]
        for step, meaning in STEPS.items()
    ]
    errors = [
        _with_margin(*mean_and_margin([s.first[motion] for s in whole])) for motion in PAPER_TABLE_1
    ]
    return [*rows, ["the whole error", *errors]]


def absence_table(summaries: Sequence[Summary]) -> list[list[str]]:
    """Rows for what limbs are without: the error of each motion, and its change by that."""
    whole = {s.seed: s for s in complete(summaries)}
    rows = []
    for absent in dict.fromkeys(s.absent for s in summaries):
        group = [s for s in summaries if s.absent == absent]
        cells = []
        for motion in PAPER_TABLE_1:
            error, _ = mean_and_margin([s.first[motion] for s in group])
            change = [s.first[motion] - whole[s.seed].first[motion] for s in group]
            suffix = f" ({_with_margin(*mean_and_margin(change), '+')})" if absent else ""
            cells.append(f"{error:.2f}{suffix}")
        name = f"without {', '.join(absent)}" if absent else "with all effects"
        rows.append([name, *cells])
    return rows


def findings(summaries: Sequence[Summary]) -> list[str]:
    """What the tables say, in sentences."""
    whole = complete(summaries)
    sizes = {
        step: np.mean([[s.split[m][step][0] for m in PAPER_TABLE_1] for s in whole])
        for step in STEPS
    }
    order = sorted(sizes, key=sizes.get, reverse=True)
    sentences = [
        "By what they make of the bend angle, over all motions, the steps rank: "
        + ", ".join(f"{step} {sizes[step]:.2f}°" for step in order)
        + "."
    ]
    by_absence = {}
    base = {s.seed: np.mean(list(s.first.values())) for s in whole}
    for s in summaries:
        if s.absent:
            change = np.mean(list(s.first.values())) - base[s.seed]
            by_absence.setdefault(s.absent, []).append(change)
    for absent, changes in by_absence.items():
        change, margin = mean_and_margin(changes)
        if np.isnan(margin):
            verdict = "on this one limb"
        elif abs(change) < margin:
            verdict = "which may be chance"
        else:
            verdict = "which is more than chance"
        sentences.append(
            f"Without {', '.join(absent)} the mean error of all motions changes by "
            f"{_with_margin(change, margin, '+')}°, {verdict}."
        )
    return sentences


def _with_margin(value: float, margin: float, sign: str = "") -> str:
    text = f"{value:{sign}.2f}"
    return text if np.isnan(margin) else f"{text} ± {margin:.2f}"
