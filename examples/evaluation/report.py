"""What came of the evaluation: Table I, Figs. 4 to 7, and where the error comes from."""

import dataclasses
import importlib.metadata
import platform
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import t as student

from calibration import plot_validation
from calibration.report import parameter_table, validation_summary
from evaluation.error_split import STEPS, error_split
from evaluation.experiment import NUM_ANGLES, PAUSE, Experiment
from limb_systems import joint_angles_from_bend_angle, page
from limb_systems.plots import (
    LEFT_RIGHT_COLORS,
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    WIDTH,
    dress,
    plot_tracking,
)
from limb_systems.tracking import tracking_errors
from planners.report import plan_summary

STATISTICS = ("mean", "median", "90th percentile")
PAPER_TABLE_1 = {  # degrees
    "Validation": (3.44, 2.33, 7.43),
    "T&R 1": (3.90, 2.73, 10.61),
    "T&R 2": (5.27, 5.09, 9.20),
}
EMULATED = "These limbs are emulated. The numbers say how the method fares on an emulation with "
EMULATED += "physics that the model leaves out, and nothing of a real limb."
PACKAGES = ("soft-limb", "drake", "ipyopt", "numpy", "scipy", "matplotlib")


@dataclasses.dataclass(frozen=True)
class Summary:
    """The numbers of one experiment, all in degrees.

    - ``seed``, ``absent``: of the limb, and which effects it was without.
    - ``tracking``: of each motion `STATISTICS` over all rollouts.
    - ``first``: of each motion the mean over the first rollout.
    - ``split``: of each motion and step, see `error_split`.
    """

    seed: int
    absent: tuple[str, ...]
    tracking: dict[str, tuple[float, ...]]
    first: dict[str, float]
    split: dict[str, dict[str, tuple[float, float]]]


def summarize(experiment: Experiment) -> Summary:
    tracking, first = {}, {}
    for motion in experiment.motions:
        errors = tracking_errors(motion.trajectory, motion.rollouts)
        degrees = np.rad2deg([errors.mean, errors.median, errors.percentile_90])
        tracking[motion.name] = tuple(degrees.tolist())
        alone = tracking_errors(motion.trajectory, motion.rollouts[:1])
        first[motion.name] = float(np.rad2deg(alone.mean))
    specimen = experiment.specimen
    return Summary(specimen.seed, specimen.absent, tracking, first, error_split(experiment))


def mean_and_margin(values: Sequence[float]) -> tuple[float, float]:
    """The mean over limbs and the half-width of its 95% confidence interval (Student's t)."""
    count = len(values)
    if count == 1:
        return float(values[0]), np.nan
    spread = np.std(values, ddof=1) / np.sqrt(count)
    return float(np.mean(values)), float(student.ppf(0.975, count - 1) * spread)


def table_1(summaries: Sequence[Summary]) -> list[list[str]]:
    """Rows of Table I: trajectory, who, and `STATISTICS` in degrees."""
    whole = [s for s in summaries if not s.absent]
    limbs = "emulated limb" if len(whole) == 1 else f"{len(whole)} emulated limbs"
    rows = []
    for motion, paper in PAPER_TABLE_1.items():
        ours = np.transpose([s.tracking[motion] for s in whole])
        rows.append([motion, limbs, *(_with_margin(*mean_and_margin(v)) for v in ours)])
        rows.append(["", "the paper's robot", *(f"{value:.2f}" for value in paper)])
    return rows


def split_table(summaries: Sequence[Summary], which: int) -> list[list[str]]:
    """Rows of `error_split`: the difference a step makes (0), or the error without it (1)."""
    whole = [s for s in summaries if not s.absent]
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
    whole = {s.seed: s for s in summaries if not s.absent}
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
    whole = [s for s in summaries if not s.absent]
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


def plot_limbs(summaries: Sequence[Summary]) -> Figure:
    """Table I as a picture: every limb, their mean with its interval, and the paper's robot."""
    whole = [s for s in summaries if not s.absent]
    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    for index, (axis, statistic) in enumerate(zip(axes, STATISTICS, strict=True)):
        for place, (motion, paper) in enumerate(PAPER_TABLE_1.items()):
            values = [s.tracking[motion][index] for s in whole]
            label = "each limb" if place == index == 0 else None
            axis.plot(
                [place] * len(values), values, "o", color=ROLLOUT_COLOR, alpha=0.35, label=label
            )
            mean, margin = mean_and_margin(values)
            label = "mean, 95% interval" if place == index == 0 else None
            axis.errorbar(place + 0.15, mean, margin, fmt="o", color="k", capsize=4, label=label)
            label = "the paper's robot" if place == index == 0 else None
            axis.plot(place - 0.2, paper[index], "D", color=PLAN_COLOR, label=label)
        axis.set_xticks(
            range(len(PAPER_TABLE_1)), [name.replace(" ", "\n") for name in PAPER_TABLE_1]
        )
        axis.set_xlim(-0.5, len(PAPER_TABLE_1) - 0.5)
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_xlabel(statistic)
    axes[0].set_ylim(bottom=0)
    axes[0].set_ylabel("|φ* − φ| (°)")
    figure.legend(loc="outside upper left", ncols=3, frameon=False, fontsize=8.5)
    return figure


def plot_split(summaries: Sequence[Summary]) -> Figure:
    """What each step of `error_split` makes of the bend angle, beside the whole error."""
    whole = [s for s in summaries if not s.absent]
    figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
    axis = figure.subplots()
    names = ["the whole error", *STEPS]
    colors = ["0.35", "#2f9e6e", PLAN_COLOR, ROLLOUT_COLOR, LEFT_RIGHT_COLORS[1]]
    for place, (name, color) in enumerate(zip(names, colors, strict=True)):
        bars = [
            mean_and_margin(
                [s.split[motion][name][0] if name in STEPS else s.first[motion] for s in whole]
            )
            for motion in PAPER_TABLE_1
        ]
        mean, margin = np.transpose(bars)
        at = np.arange(len(PAPER_TABLE_1)) + 0.16 * (place - 2)
        axis.bar(at, mean, 0.15, yerr=margin, color=color, label=name, error_kw={"lw": 0.9})
    axis.set_xticks(range(len(PAPER_TABLE_1)), list(PAPER_TABLE_1))
    axis.set_ylabel("mean |difference| (°)")
    dress(axis)
    return figure


def plot_taught(experiment: Experiment) -> Figure:
    """Fig. 7: the limb while it is taught, and while it repeats, every few seconds."""
    motions = [motion for motion in experiment.motions if motion.taught]
    figure = Figure(figsize=(WIDTH, 2.6 * len(motions)), layout="constrained")
    axes = figure.subplots(2 * len(motions), 1)
    (segment,) = experiment.calibration.parameters.segments
    times = np.arange(5.0, 60.0, 5.0)
    for index, motion in enumerate(motions):
        for axis, recording, color, what in (
            (axes[2 * index], motion.taught, "0.35", "taught"),
            (axes[2 * index + 1], motion.rollouts[0], ROLLOUT_COLOR, "repeated"),
        ):
            for place, time in enumerate(times):
                angle = np.interp(time, recording.time, recording.bend_angle[0])
                joints = joint_angles_from_bend_angle(recording.parameters, [angle])
                directions = np.cumsum(joints)
                links = np.array([np.sin(directions), -np.cos(directions)])
                x, y = np.cumsum(np.column_stack([[0, 0], links]), axis=1) / segment.links
                axis.plot(1.1 * place + x, y, "-", color=color, linewidth=5, solid_capstyle="round")
                axis.plot(1.1 * place, 0, "s", color="0.7", markersize=8)
                axis.text(
                    1.1 * place, 0.2, f"{round(np.rad2deg(angle)):+d}°", ha="center", fontsize=8
                )
            axis.set_xlim(-0.7, 1.1 * len(times) - 0.4)
            axis.set_ylim(-1.15, 0.45)
            axis.set_aspect("equal")
            axis.set_yticks([])
            axis.spines[:].set_visible(False)
            axis.set_xticks(
                1.1 * np.arange(len(times)), [f"{time:g}" for time in times], fontsize=8
            )
            axis.tick_params(length=0)
            axis.set_ylabel(f"{motion.name},\n{what}", fontsize=8.5)
    axes[-1].set_xlabel("time (s)")
    return figure


def plot_error(experiment: Experiment) -> Figure:
    """φ - φ* of all rollouts over time, with the motions under each other."""
    figure = Figure(figsize=(WIDTH, 4.5), layout="constrained")
    axes = figure.subplots(len(experiment.motions), 1, sharex=True)
    for axis, motion in zip(axes, experiment.motions, strict=True):
        for number, rollout in enumerate(motion.rollouts):
            error = rollout.bend_angle - motion.trajectory.bend_angle_at(rollout.time)
            label = None if number else "rollouts, φ − φ*"
            axis.plot(
                rollout.time,
                np.rad2deg(error[0]),
                color=ROLLOUT_COLOR,
                lw=0.5,
                alpha=0.6,
                label=label,
            )
        missed = motion.trajectory.bend_angle[0] - motion.trajectory.reference[0]
        axis.plot(
            motion.trajectory.time,
            np.rad2deg(missed),
            color=REFERENCE_COLOR,
            label="plan against reference, φ* − φ_REF",
        )
        axis.set_ylabel(f"{motion.name} (°)")
        dress(axis)
    for axis in axes[1:]:
        axis.get_legend().remove()
    axes[-1].set_xlabel("time (s)")
    return figure


def figures(experiment: Experiment) -> dict[str, tuple[Figure, str]]:
    """The paper's figures of one limb, by the names of their files, with a description."""
    validation, *taught = experiment.motions
    result = {
        "fig4": (
            plot_validation(experiment.calibration.validation),
            "Fig. 4: the calibrated model and the emulated limb for the same duty",
        ),
        "fig5": (
            plot_tracking(validation.trajectory, validation.rollouts),
            "Fig. 5: two steps and a decaying sinusoid, plan and five rollouts",
        ),
    }
    for letter, motion in zip("ab", taught, strict=True):
        result[f"fig6{letter}"] = (
            plot_tracking(motion.trajectory, motion.rollouts),
            f"Fig. 6, {motion.name}: a motion that was taught, plan and five rollouts",
        )
    result["fig7"] = (
        plot_taught(experiment),
        "Fig. 7: the limb's shape by its bend sensor, constant curvature (11), as it was taught "
        "and as it repeated it",
    )
    return result


def write_report(
    path: str | Path,
    summaries: Sequence[Summary],
    experiment: Experiment,
    pictures: dict[str, tuple[Figure, str]],
    command: str,
) -> None:
    """Writes the page with everything in it.

    Args:
        path: of the HTML file.
        summaries: of all limbs.
        experiment: the limb that is shown.
        pictures: `figures` of it.
        command: that this was made with.
    """
    whole = [s for s in summaries if not s.absent]
    limbs = f"{len(whole)} emulated limbs" if len(whole) > 1 else "an emulated limb"
    parameters = experiment.calibration.parameters
    seed = experiment.specimen.seed
    header = ["trajectory", "", *STATISTICS]
    caption = "Tracking error |φ* − φ| of five open-loop rollouts of each plan, in degrees."
    if len(whole) > 1:
        caption += " ± is half of the 95% confidence interval of the mean over limbs."
    parts = [
        page.paragraph(
            "Trajectory optimization for a thermally actuated soft planar limb, after Wertz, "
            f"Sabelhaus and Majidi: {limbs}, recorded, "
            "calibrated, taught, planned for and driven open loop. Planner and calibration know of "
            "a limb what its recordings tell."
        ),
        f"<p><strong>{EMULATED}</strong></p>",
        page.section("Table I, tracking error", page.table(header, table_1(summaries), caption)),
    ]
    if len(whole) > 1:
        parts.append(page.picture(plot_limbs(summaries), "Table I for each limb"))
    motion_header = [*PAPER_TABLE_1]
    parts.append(
        page.section(
            "Where the error comes from",
            page.paragraph(
                "Between the plan and the reading of the sensor one thing is swapped at a time: "
                "the plan for the simulated model, the calibrated parameters for those that "
                "describe this very limb best in hindsight, the model for the limb, and the limb "
                "for what its sensor reads of it. First rollouts; the steps partly cancel each "
                "other, so that they do not add up."
            ),
            page.picture(plot_split(summaries), "What each step makes of the bend angle"),
            page.table(
                ["step", *motion_header],
                split_table(summaries, 0),
                "Mean absolute difference that each step makes, in degrees.",
            ),
            page.table(
                ["without the step", *motion_header],
                split_table(summaries, 1),
                "What would be left of the error if that step made no difference, in degrees.",
            ),
        )
    )
    if len(whole) < len(summaries):
        parts.append(
            page.paragraph(
                "Then the form of the model is taken apart, by swapping the limb for one without "
                "an effect that the model leaves out, and doing everything again with it, from "
                "the recordings on: silicone is the second thermal mass; without stress there is "
                "no latent heat, nor does bending change the torque. A limb without any of them "
                "still has torque that follows temperature along an S-curve, where the model has "
                "a line (4)."
            )
        )
        parts.append(
            page.table(
                ["limb", *motion_header],
                absence_table(summaries),
                "Mean error of the first rollout and, in brackets, its change, in degrees.",
            )
        )
    parts.append(page.items(findings(summaries)))
    for figure, description in pictures.values():
        parts.append(page.section(description, page.picture(figure, description)))
    parts.append(
        page.section(
            "Error over time",
            page.paragraph(
                "Rollouts against their plan, beside the plan against its reference, which moves "
                "faster than wires cool or is, by the weights of (15), not worth its duty."
            ),
            page.picture(plot_error(experiment), "Error of all rollouts over time"),
        )
    )
    parts.append(
        page.section(
            "Parameters",
            page.paragraph(
                f"The limb that is shown, seed {seed}. Validation, open loop: "
                f"{validation_summary(experiment.calibration.validation)}."
            ),
            parameter_table(experiment.calibration),
            page.items(experiment.calibration.remarks),
            page.preformatted(parameters.to_yaml()),
        )
    )
    plans = "\n\n".join(f"{m.name}\n{plan_summary(m.trajectory)}" for m in experiment.motions)
    parts.append(page.section("Plans", page.preformatted(plans)))
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in PACKAGES)
    parts.append(
        page.section(
            "How it was made",
            page.items(
                [
                    f"Command: {command}",
                    f"Limbs: seeds {', '.join(str(s.seed) for s in whole)}; pictures show seed "
                    f"{seed}. A seed draws a limb and its sensors' noise from ranges that "
                    "hardware/specimen.py lists with their sources; none was left out.",
                    "Recordings of each: ten of the sag, three ring-downs, and "
                    f"{NUM_ANGLES} random equilibria each with the right wire, the left one and "
                    "both, held by PI control.",
                    "Motions: the reference of Fig. 5 drawn by hand, and two that a hand moves the "
                    "limb through with its wires off, one faster and narrow, one wide with holds. "
                    "The paper gives no numbers for them; these are ours.",
                    f"Rollouts: five of each plan, open loop, each after {PAUSE:g} s without heat.",
                    "Bands in the figures are mean ± 1.96 standard deviations of the rollouts.",
                    f"Software: {versions}, Python {platform.python_version()}.",
                ]
            ),
        )
    )
    page.write_page(path, "The paper reproduced, on emulated limbs", parts)


def _with_margin(value: float, margin: float, sign: str = "") -> str:
    text = f"{value:{sign}.2f}"
    return text if np.isnan(margin) else f"{text} ± {margin:.2f}"
