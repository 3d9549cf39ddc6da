"""Pictures of plans and rollouts, as in the paper's Figs. 5 and 6."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from limb_systems.recording import Recording
from limb_systems.trajectory import Trajectory

LEFT_RIGHT_COLORS = ("#1f9bb4", "#e07b1f")  # cyan and orange, as in the paper
REFERENCE_COLOR, PLAN_COLOR, ROLLOUT_COLOR = "0.6", "#1f4fd8", "#c2268f"
BAND = 1.96  # standard deviations that hold 95% of the rollouts


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
    figure = Figure(figsize=(9, 3.2 + 2.4 * (num_segments + 1)), layout="constrained")
    axes = figure.subplots(
        num_segments + 2, 1, sharex=True, height_ratios=[1.6] * num_segments + [1.3, 1.0]
    )
    for segment in range(num_segments):
        _plot_bend_angle(axes[segment], trajectory, recordings, segment)
    _plot_temperatures(axes[-2], trajectory, recordings)
    _plot_duty(axes[-1], trajectory)
    for axis in axes:
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
    axes[-1].set_xlabel("time (s)")
    axes[-1].set_xlim(trajectory.time[0], trajectory.time[-1])
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


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
    for index, name in enumerate(trajectory.parameters.wire_names):
        color = LEFT_RIGHT_COLORS[index % 2]
        if recordings:
            measured = [recording.measured_temperature[index] for recording in recordings]
            _plot_band(axis, recordings[0].time, measured, color, f"{name}, V measured")
        axis.plot(
            trajectory.time,
            trajectory.measured_temperature[index],
            color=color,
            linewidth=1.4,
            linestyle="--",
            label=f"{name}, V* planned",
        )
        axis.plot(
            trajectory.time,
            trajectory.wire_temperature[index],
            color=color,
            linewidth=0.8,
            linestyle=":",
            label=f"{name}, T* planned",
        )
    end = trajectory.time[-1]
    for name, limit, start in (
        (r"$T_{max}$", limits.maximum, trajectory.time[0]),
        (r"$T_{warm}$", limits.warm, limits.warm_up_time),
    ):
        if start < end:
            axis.plot([start, end], [limit, limit], color="0.4", linewidth=0.8)
            axis.annotate(name, (end, limit), (-30, -11), textcoords="offset points")
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
