"""Pictures of plans and rollouts, as in Figs. 5 and 6, and the style of all pictures."""

import itertools
import pickle
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.text import Text

from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory
from limb_systems.output import check_picture
from limb_systems.views.colors import (
    LEFT_RIGHT_COLORS,
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from limb_systems.views.figure import Figure
from limb_systems.views.rollouts import how_recorded, mean_and_band

WIDTH = 6.4  # inches; text of 9 pt can still be read where a phone shows it
FOR_PAPERS = (".pdf", ".eps")
COLUMN_WIDTH, COLUMN_TEXT = 3.5, 8.0  # inches and pt, of the IEEE's journals


def plot_tracking(
    trajectory: Trajectory, recordings: Sequence[Recording] = (), title: str = ""
) -> Figure:
    """Fig. 5: bend angle, temperatures and duty of a plan and of its rollouts.

    Time counts from the start of the plan. Plans are dashed; the legend says
    whether the rollouts were simulated, emulated or recorded. Several recordings
    are drawn as their mean and the band of 95%, mean ± 1.96 standard deviations,
    at the sample times of the first. Each segment has its own three panels.

    Args:
        trajectory: the plan.
        recordings: of rollouts of this plan, all with the same sample rate.
    """
    trajectory = trajectory.since_start()
    num_segments = len(trajectory.parameters.segments)
    figure = Figure(figsize=(WIDTH, 6.0 * num_segments), layout="constrained")
    axes = figure.subplots(
        3 * num_segments, 1, sharex=True, height_ratios=[1.6, 1.4, 1.0] * num_segments
    )
    for segment, suffix in enumerate(trajectory.parameters.segment_suffixes):
        bend_angle, temperature, duty = axes[3 * segment : 3 * segment + 3]
        _plot_bend_angle(bend_angle, trajectory, recordings, segment)
        bend_angle.set_ylabel(f"bend angle{suffix.replace('_', ' of segment ')} (°)")
        names = [wire.name for wire in trajectory.parameters.segments[segment].wires]
        first = trajectory.parameters.wire_slices[segment].start
        wires = list(zip(itertools.count(first), names, wire_colors(len(names)), strict=False))
        _plot_temperatures(temperature, trajectory, recordings, wires)
        _plot_duty(duty, trajectory, recordings, wires)
    for axis in axes:
        dress(axis)
    axes[-1].set_xlabel("time (s)")
    axes[-1].set_xlim(trajectory.time[0], trajectory.time[-1])
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def plot_repetitions(
    trajectory: Trajectory, errors: Sequence[float], first: Recording, last: Recording
) -> Figure:
    """How the error fell over repetitions of a plan, and the first and the last of them.

    Args:
        trajectory: the plan.
        errors: mean of |φ* - φ| in each repetition, as it was read, rad.
    """
    trajectory = trajectory.since_start()
    num_segments = len(trajectory.parameters.segments)
    figure = Figure(figsize=(WIDTH, 2.0 + 2.6 * num_segments), layout="constrained")
    over, *axes = figure.subplots(1 + num_segments, 1)
    numbers = np.arange(1, len(errors) + 1)
    over.plot(numbers, np.rad2deg(errors), "o-", color=ROLLOUT_COLOR, label="mean error, as read")
    over.set_xlabel("repetition")
    over.set_xticks(numbers)
    over.set_ylim(bottom=0.0)
    over.set_ylabel(r"mean $|\varphi^* - \varphi|$ (°)")
    for segment, axis in enumerate(axes):
        suffix = trajectory.parameters.segment_suffixes[segment].replace("_", " of segment ")
        for recording, color, name in (
            (first, LEFT_RIGHT_COLORS[1], "first repetition"),
            (last, ROLLOUT_COLOR, "last repetition"),
        ):
            angle = np.rad2deg(recording.bend_angle[segment])
            axis.plot(recording.time, angle, color=color, linewidth=1.0, label=name)
        planned = np.rad2deg(trajectory.bend_angle[segment])
        axis.plot(trajectory.time, planned, "--", color=PLAN_COLOR, label=r"plan $\varphi^*$")
        axis.set_xlabel("time (s)")
        axis.set_ylabel(f"bend angle{suffix} (°)")
    for axis in (over, *axes):
        dress(axis)
    return figure


def dress(axis: Axes, most_columns: int = 3) -> None:
    """Applies the common style to a panel: a light grid, and the legend above it."""
    axis.grid(alpha=0.25)
    axis.spines[["top", "right"]].set_visible(False)
    num_entries = len(axis.get_legend_handles_labels()[1])
    if not num_entries:
        return
    axis.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=num_entries
        if num_entries <= most_columns
        else min(most_columns, (num_entries + 1) // 2),
        frameon=False,
        fontsize=8.5,
        borderaxespad=0.2,
        columnspacing=1.5,
    )


def save_figure(figure: Figure, path: str | Path) -> None:
    """Writes a figure to a file, in the format that its name ends with.

    One that ends with .pdf or .eps is for a paper: as wide as a column of two, 3.5 inches,
    with text of 8 pt, thin lines, and its fonts inside.

    Raises:
        OutputError: if there is no such format.
    """
    path = Path(path)
    check_picture(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() in FOR_PAPERS:
        figure = _in_a_column(figure)
    with matplotlib.rc_context({"pdf.fonttype": 42, "ps.fonttype": 42}):  # TrueType, as asked for
        figure.savefig(path, dpi=150)


def _in_a_column(figure: Figure) -> Figure:
    """A copy that fits a column of a paper."""
    figure = pickle.loads(pickle.dumps(figure))
    width, height = figure.get_size_inches()
    figure.set_size_inches(COLUMN_WIDTH, 1.4 * height * COLUMN_WIDTH / width)
    for axis in figure.axes:
        if axis.get_legend():
            dress(axis, most_columns=2)
    for line in figure.findobj(Line2D):
        line.set_linewidth(0.75 * line.get_linewidth())
    for text in figure.findobj(Text):
        text.set_fontsize(COLUMN_TEXT)
    return figure


def _plot_bend_angle(axis, trajectory, recordings, segment: int) -> None:
    axis.plot(
        trajectory.time,
        np.rad2deg(trajectory.reference[segment]),
        color=REFERENCE_COLOR,
        linewidth=1.2,
        label=r"reference $\varphi_{REF}$",
    )
    angles = [np.rad2deg(recording.bend_angle[segment]) for recording in recordings]
    what = how_recorded(recordings) + (" rollouts" if len(recordings) > 1 else "")
    _plot_band(axis, recordings, angles, ROLLOUT_COLOR, rf"{what} $\varphi$")
    axis.plot(
        trajectory.time,
        np.rad2deg(trajectory.bend_angle[segment]),
        color=PLAN_COLOR,
        linewidth=1.4,
        linestyle="--",
        label=r"plan $\varphi^*$",
    )


def _plot_temperatures(axis, trajectory, recordings, wires) -> None:
    limits = trajectory.parameters.temperature_limits
    for index, name, color in wires:
        measured = [recording.measured_temperature[index] for recording in recordings]
        _plot_band(axis, recordings, measured, color, f"{name}, V {how_recorded(recordings)}")
    for what, course, style, width in (
        ("V* planned", trajectory.measured_temperature, "--", 1.4),
        ("T* planned", trajectory.wire_temperature, ":", 0.8),
    ):
        for index, name, color in wires:
            axis.plot(
                trajectory.time,
                course[index],
                color=color,
                linewidth=width,
                linestyle=style,
                label=f"{name}, {what}",
            )
    end = trajectory.time[-1]
    for name, limit, start, offset in (
        (r"$T_{max}$", limits.maximum, trajectory.time[0], -12),
        (r"$T_{warm}$", limits.warm, limits.warm_up_time, 4),
    ):
        if start < end:
            axis.plot([start, end], [limit, limit], color="0.4", linewidth=0.8)
            axis.annotate(
                name, (trajectory.time[0], limit), (3, offset), textcoords="offset points"
            )
    axis.set_ylabel("temperature (°C)")


def _plot_duty(axis, trajectory, recordings, wires) -> None:
    for index, name, color in wires:
        duty = [recording.duty[index] for recording in recordings]
        _plot_band(axis, recordings, duty, color, f"{name}, D")
    for index, name, color in wires:
        axis.plot(
            trajectory.time,
            trajectory.duty[index],
            color=color,
            linewidth=1.2,
            linestyle="--" if recordings else "-",
            label=f"{name}, D* planned",
        )
    axis.set_ylabel("duty")
    axis.set_ylim(-0.04, 1.04)


def _plot_band(axis, recordings, samples, color: str, label: str) -> None:
    """Mean and 95% band of samples of recordings, if any, on the times of the first."""
    if not recordings:
        return
    time, mean, half = mean_and_band(recordings, samples)
    axis.plot(time, mean, color=color, linewidth=1.1, label=label)
    axis.fill_between(time, mean - half, mean + half, color=color, alpha=0.2, lw=0)
