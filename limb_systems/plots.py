"""Pictures of plans and rollouts, as in the paper's Figs. 5 and 6, and how all pictures look."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from limb_systems.recording import Recording
from limb_systems.trajectory import Trajectory

LEFT_RIGHT_COLORS = ("#1f9bb4", "#e07b1f")  # cyan and orange, as in the paper
REFERENCE_COLOR, PLAN_COLOR, ROLLOUT_COLOR = "0.6", "#1f4fd8", "#c2268f"
BAND = 1.96  # standard deviations that hold 95% of the rollouts
WIDTH = 6.4  # inches; text of 9 pt can still be read where a phone shows it


def plot_tracking(
    trajectory: Trajectory, recordings: Sequence[Recording] = (), title: str = ""
) -> Figure:
    """Fig. 5: bend angle, temperatures and duty of a plan and of its rollouts.

    Rollouts are drawn as their mean and the band of 95%, mean ± 1.96 standard
    deviations, on the sample times of the first. For several segments there
    is a panel of bend angles for each.

    Args:
        trajectory: the plan.
        recordings: of rollouts of this plan, all with the same sample rate.
    """
    num_segments = len(trajectory.parameters.segments)
    figure = Figure(figsize=(WIDTH, 3.6 + 2.4 * num_segments), layout="constrained")
    axes = figure.subplots(
        num_segments + 2, 1, sharex=True, height_ratios=[1.6] * num_segments + [1.4, 1.0]
    )
    for segment in range(num_segments):
        _plot_bend_angle(axes[segment], trajectory, recordings, segment)
    _plot_temperatures(axes[-2], trajectory, recordings)
    _plot_duty(axes[-1], trajectory)
    for axis in axes:
        dress(axis)
    axes[-1].set_xlabel("time (s)")
    axes[-1].set_xlim(trajectory.time[0], trajectory.time[-1])
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def dress(axis: Axes) -> None:
    """Gives a panel the look of all others: a light grid, and its legend above it."""
    axis.grid(alpha=0.25)
    axis.spines[["top", "right"]].set_visible(False)
    num_entries = len(axis.get_legend_handles_labels()[1])
    if not num_entries:
        return
    axis.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=num_entries if num_entries <= 3 else (num_entries + 1) // 2,
        frameon=False,
        fontsize=8.5,
        borderaxespad=0.2,
        columnspacing=1.5,
    )


def save_figure(figure: Figure, path: str | Path) -> None:
    """Writes a figure to a file, in the format that its name ends with."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def _plot_bend_angle(axis, trajectory, recordings, segment: int) -> None:
    time = trajectory.time
    axis.plot(
        time,
        np.rad2deg(trajectory.reference[segment]),
        color=REFERENCE_COLOR,
        linewidth=1.2,
        label=r"reference $\varphi_{REF}$",
    )
    if recordings:
        angles = [np.rad2deg(recording.bend_angle[segment]) for recording in recordings]
        _plot_band(axis, recordings[0].time, angles, ROLLOUT_COLOR, r"rollouts $\varphi$")
    axis.plot(
        time,
        np.rad2deg(trajectory.bend_angle[segment]),
        color=PLAN_COLOR,
        linewidth=1.4,
        linestyle="--",
        label=r"plan $\varphi^*$",
    )
    suffix = trajectory.parameters.segment_suffixes[segment].replace("_", " of segment ")
    axis.set_ylabel(f"bend angle{suffix} (°)")


def _plot_temperatures(axis, trajectory, recordings) -> None:
    limits = trajectory.parameters.temperature_limits
    wires = list(enumerate(trajectory.parameters.wire_names))
    if recordings:
        for index, name in wires:
            measured = [recording.measured_temperature[index] for recording in recordings]
            color = LEFT_RIGHT_COLORS[index % 2]
            _plot_band(axis, recordings[0].time, measured, color, f"{name}, V measured")
    for what, course, style, width in (
        ("V* planned", trajectory.measured_temperature, "--", 1.4),
        ("T* planned", trajectory.wire_temperature, ":", 0.8),
    ):
        for index, name in wires:
            axis.plot(
                trajectory.time,
                course[index],
                color=LEFT_RIGHT_COLORS[index % 2],
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


def _plot_duty(axis, trajectory) -> None:
    for index, name in enumerate(trajectory.parameters.wire_names):
        axis.plot(
            trajectory.time,
            trajectory.duty[index],
            color=LEFT_RIGHT_COLORS[index % 2],
            linewidth=1.2,
            label=f"{name}, D*",
        )
    axis.set_ylabel("duty")
    axis.set_ylim(-0.04, 1.04)


def _plot_band(axis, time, samples, color: str, label: str) -> None:
    """Mean and 95% band of rollouts, on the times of the first."""
    length = min(len(sample) for sample in samples)
    stacked = np.array([sample[:length] for sample in samples])
    mean, spread = stacked.mean(axis=0), stacked.std(axis=0, ddof=min(1, len(samples) - 1))
    axis.plot(time[:length], mean, color=color, linewidth=1.1, label=label)
    axis.fill_between(
        time[:length], mean - BAND * spread, mean + BAND * spread, color=color, alpha=0.2, lw=0
    )
