"""What came of the evaluation in panels: Figs. 4 to 6, Table I and the split of the error."""

from collections.abc import Sequence
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
from soft_limb.evaluation.experiment import Experiment, Motion
from soft_limb.evaluation.tables import (
    PAPER_TABLE_1,
    STATISTICS,
    Followed,
    Summary,
    complete,
    mean_and_margin,
)
from soft_limb.evaluation.ways import FEEDBACK, LEARNING, OPEN_LOOP, Way
from soft_limb.reports.calibration_panels import validation_panels

MOTION_TICKS = dict(enumerate(PAPER_TABLE_1))


def limbs_panels(summaries: Sequence[Summary]) -> list[Panel]:
    """Table I as a chart: every limb, their mean with its interval, and the paper's robot."""
    whole = complete(summaries)
    at = np.arange(len(PAPER_TABLE_1), dtype=float)
    away = np.array([[s.ways[m][OPEN_LOOP].true_reference for m in PAPER_TABLE_1] for s in whole])
    left = np.array([[s.nearest[m] for m in PAPER_TABLE_1] for s in whole], float)
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
        values = np.array(
            [[s.ways[m][OPEN_LOOP].tracking[index] for m in PAPER_TABLE_1] for s in whole]
        )
        paper = np.array([row[index] for row in PAPER_TABLE_1.values()])
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
    names = ["the whole error", *STEPS]
    colors = [NEUTRAL_COLOR, "#2f9e6e", PLAN_COLOR, ROLLOUT_COLOR, LEFT_RIGHT_COLORS[1]]
    for place, (name, color) in enumerate(zip(names, colors, strict=True)):
        mean, margin = np.transpose(
            [
                mean_and_margin(
                    [s.split[motion][name][0] if name in STEPS else s.first[motion] for s in whole]
                )
                for motion in PAPER_TABLE_1
            ]
        )
        at = np.arange(len(PAPER_TABLE_1)) + 0.1 * (place - 2)
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


def ways_panels(motion: Motion) -> list[Panel]:
    """Open loop, feedback and the best repetition: bend as read and true, and V."""
    repetitions = motion.ways[LEARNING].rollouts
    bends, heats = [], []
    for way, name, rollout in (
        (OPEN_LOOP, OPEN_LOOP, motion.open_loop.rollouts[0]),
        (FEEDBACK, FEEDBACK, motion.ways[FEEDBACK].rollouts[0]),
        (LEARNING, f"best of {len(repetitions)}", repetitions[-1]),
    ):
        plan = motion.ways[way].trajectory.since_start()
        followed = Followed.of(Way(plan, [rollout]))
        curves = [
            Curve(name, run.time, np.rad2deg(angle[0]), color, dash)
            for name, run, angle, color, dash in (
                ("reference", plan, plan.reference, REFERENCE_COLOR, "solid"),
                (
                    f"read, {followed.reference:.2f}° from the reference, "
                    f"{followed.read:.2f}° from the plan",
                    rollout,
                    rollout.bend_angle,
                    ROLLOUT_COLOR,
                    "solid",
                ),
                (
                    f"true, {followed.true_reference:.2f}° and {followed.true:.2f}°",
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
    validation, *taught = experiment.motions
    driven = {"fig5": validation, "fig6a": taught[0], "fig6b": taught[1]}
    result = {"fig4": validation_panels(experiment.validation)}
    for name, motion in driven.items():
        way = motion.open_loop
        result[name] = tracking_panels(way.trajectory, way.rollouts)
    if {FEEDBACK, LEARNING} <= validation.ways.keys():
        result["ways"] = ways_panels(validation)
    return result
