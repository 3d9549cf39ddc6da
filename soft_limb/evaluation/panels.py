"""What came of the evaluation in panels: Figs. 4 to 6, Table I and the split of the error."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from limb_systems.tracking import true_bend
from limb_systems.views.colors import (
    LEFT_RIGHT_COLORS,
    NEUTRAL_COLOR,
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from limb_systems.views.panels import Curve, Panel, tracking_panels
from soft_limb.evaluation.error_split import STEPS
from soft_limb.evaluation.experiment import (
    AS_DESCRIBED,
    HANDS,
    MOTIONS,
    RAMPS,
    VALIDATION,
    Experiment,
)
from soft_limb.evaluation.tables import (
    PAPER_TABLE_1,
    STATISTICS,
    Followed,
    Summary,
    complete,
    mean_and_margin,
)
from soft_limb.evaluation.ways import FOLLOW, LEARNING, OPEN_LOOP, Way
from soft_limb.reports.calibration_panels import validation_panels

MOTION_TICKS = dict(enumerate(MOTIONS))


def limbs_panels(summaries: Sequence[Summary]) -> list[Panel]:
    """Table I as a chart: every limb, their mean with its interval, and the paper's robot."""
    whole = complete(summaries)
    at = np.arange(len(MOTIONS), dtype=float)
    away = np.array([[s.ways[m][OPEN_LOOP].true_reference for m in MOTIONS] for s in whole])
    left = np.array([[s.nearest[m] for m in MOTIONS] for s in whole], float)
    panels = [
        _by_motion(
            "mean |φ_REF − φ| of the true bend (°)",
            [
                *_limbs_and_mean(at, away),
                Curve(
                    "best plan within the limits, mean",
                    at - 0.1,
                    left.mean(axis=0),
                    PLAN_COLOR,
                    marks=True,
                ),
            ],
        )
    ]
    for index, statistic in enumerate(STATISTICS):
        values = np.array([[s.ways[m][OPEN_LOOP].tracking[index] for m in MOTIONS] for s in whole])
        paper = np.array([PAPER_TABLE_1.get(m, [np.nan] * 3)[index] for m in MOTIONS])
        curves = [
            *_limbs_and_mean(at, values),
            Curve("the paper's robot", at - 0.1, paper, PLAN_COLOR, marks=True),
        ]
        panels.append(_by_motion(f"{statistic} of |φ* − φ| (°)", curves))
    return panels


def _limbs_and_mean(at: np.ndarray, values: np.ndarray) -> list[Curve]:
    """Values of each limb (limbs, motions), and their mean with its interval."""
    mean, margin = np.transpose([mean_and_margin(column) for column in values.T])
    every: dict[str, Any] = {"marks": True, "alpha": 0.4}
    return [
        Curve("each limb", np.tile(at, len(values)), values.ravel(), ROLLOUT_COLOR, **every),
        Curve("mean, 95% interval", at + 0.1, mean, NEUTRAL_COLOR, band=margin, marks=True),
    ]


def split_panels(summaries: Sequence[Summary]) -> list[Panel]:
    """What each step of `error_split` makes of the bend angle, beside the whole error."""
    whole, curves = complete(summaries), []
    names = ["whole error of the first rollout", *STEPS]
    colors = [NEUTRAL_COLOR, "#2f9e6e", PLAN_COLOR, ROLLOUT_COLOR, LEFT_RIGHT_COLORS[1]]
    for place, (name, color) in enumerate(zip(names, colors, strict=True)):
        mean, margin = np.transpose(
            [
                mean_and_margin(
                    [s.split[motion][name][0] if name in STEPS else s.first[motion] for s in whole]
                )
                for motion in MOTIONS
            ]
        )
        at = np.arange(len(MOTIONS)) + 0.1 * (place - 2)
        curves.append(Curve(name, at, mean, color, width=2.0, band=margin, marks=True))
    return [_by_motion("mean |difference| (°)", curves)]


def _by_motion(label: str, curves: list[Curve]) -> Panel:
    return Panel(label, curves, x_label="motion", from_zero=True, x_ticks=MOTION_TICKS)


def error_panels(experiment: Experiment) -> list[Panel]:
    """φ - φ* of all rollouts over time, with the motions under each other."""
    panels = []
    for motion in experiment.motions:
        plan = motion.open_loop.trajectory.since_start()
        curves = [
            Curve(
                f"rollout {number}, φ − φ*",
                rollout.time,
                np.rad2deg(rollout.bend_angle - plan.bend_angle_at(rollout.time))[0],
                ROLLOUT_COLOR,
                width=1.0,
                alpha=0.6,
            )
            for number, rollout in enumerate(motion.open_loop.rollouts, 1)
        ]
        missed = np.rad2deg(plan.bend_angle[0] - plan.reference[0])
        curves.append(
            Curve("plan against reference, φ* − φ_REF", plan.time, missed, REFERENCE_COLOR)
        )
        panels.append(Panel(f"{motion.name} (°)", curves))
    return panels


def ways_shown(experiment: Experiment) -> dict[str, Way]:
    """Ways in which the limb was driven along `RAMPS`, each with one rollout.

    Open loop before and after calibration, by `follow`, and the best repetition of learning;
    nothing if it was not driven in one of these.
    """
    (motion,) = (motion for motion in experiment.motions if motion.name == RAMPS)
    if not {FOLLOW, LEARNING} <= motion.ways.keys():
        return {}
    (described,) = (each for each in experiment.compared[AS_DESCRIBED] if each.name == RAMPS)
    learned = motion.ways[LEARNING]
    last = Way(learned.trajectory, learned.rollouts[-1:])
    firsts = {name: motion.ways[name] for name in (OPEN_LOOP, FOLLOW)}
    firsts = {name: Way(way.trajectory, way.rollouts[:1]) for name, way in firsts.items()}
    learning = f"{LEARNING}, best of {len(learned.rollouts)}"
    return {f"{OPEN_LOOP}, not calibrated": described.open_loop, **firsts, learning: last}


def ways_panels(shown: Mapping[str, Way]) -> list[Panel]:
    """Bend as read and true, and V, of each way of `ways_shown`."""
    bends, heats = [], []
    for name, way in shown.items():
        (rollout,), plan = way.rollouts, way.trajectory.since_start()
        followed = Followed.of(way)
        curves = [
            Curve(name, run.time, np.rad2deg(angle[0]), color, dash)
            for name, run, angle, color, dash in (
                ("reference", plan, plan.reference, REFERENCE_COLOR, "solid"),
                (
                    f"read, {followed.reference:.2f}° from the reference",
                    rollout,
                    rollout.bend_angle,
                    ROLLOUT_COLOR,
                    "solid",
                ),
                (
                    f"true, {followed.true_reference:.2f}° from the reference",
                    rollout,
                    true_bend(rollout).bend_angle,
                    NEUTRAL_COLOR,
                    "solid",
                ),
                (
                    f"plan, {followed.planned:.2f}° from the reference",
                    plan,
                    plan.bend_angle,
                    PLAN_COLOR,
                    "dashed",
                ),
            )
        ]
        bends.append(Panel(f"{name}: bend (°)", curves))
        names = rollout.parameters.wire_names
        readings = [
            Curve(f"{names[wire]}, {what}", source.time, source.measured_temperature[wire], *style)
            for wire, color in enumerate(wire_colors(len(names)))
            for what, source, style in (
                ("V", rollout, (color,)),
                ("V*", plan, (color, "dashed")),
            )
        ]
        heats.append(Panel(f"{name}: V (°C)", readings))
    return [*bends, *heats]


def learning_panels(summaries: Sequence[Summary]) -> list[Panel]:
    """Mean distances of the best repetition so far, as read and true: limbs thin, mean thick."""
    whole, panels = [s for s in complete(summaries) if s.repetitions], []
    for motion in whole[0].repetitions:
        curves = []
        for what, color, name in (
            ("true_reference", PLAN_COLOR, "true, from the reference"),
            ("read", ROLLOUT_COLOR, "read, from the plan"),
            ("true", NEUTRAL_COLOR, "true, from the plan"),
        ):
            errors = np.array([[getattr(f, what) for f in s.repetitions[motion]] for s in whole])
            numbers = np.arange(1, errors.shape[1] + 1)
            curves += [Curve("", numbers, row, color, width=0.7, alpha=0.4) for row in errors]
            curves.append(Curve(name, numbers, errors.mean(axis=0), color, width=2.0))
        ticks = {int(number): str(number) for number in numbers}
        panels.append(
            Panel(f"{motion} (°)", curves, x_label="repetition", from_zero=True, x_ticks=ticks)
        )
    return panels


def panels_of(experiment: Experiment) -> dict[str, list[Panel]]:
    """The paper's figures of one limb, as far as there is something to look into; by `figures`."""
    result = {"fig4": validation_panels(experiment.validation)}
    ways = {motion.name: motion.open_loop for motion in experiment.motions}
    for name, motion in zip(("fig5", "fig6a", "fig6b"), (VALIDATION, *HANDS), strict=True):
        result[name] = tracking_panels(ways[motion].trajectory, ways[motion].rollouts)
    if shown := ways_shown(experiment):
        result["ways"] = ways_panels(shown)
    return result
