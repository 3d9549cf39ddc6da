"""The paper's Figs. 4 to 7 for one limb, and a comparison of the methods to drive it."""

from collections.abc import Mapping

import numpy as np

from limb_systems import Recording, joint_angles_from_bend_angle
from limb_systems.tracking import true_bend
from limb_systems.views.colors import (
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from limb_systems.views.panels import Panel, tracking_panels
from limb_systems.views.plots import WIDTH, Figure
from reproduce_paper.driving import FOLLOW, LEARNING, OPEN_LOOP, PlanWithRollouts
from reproduce_paper.experiment import AS_DESCRIBED, HANDS, RAMPS, VALIDATION, Experiment
from reproduce_paper.tables import RolloutStatistics, nearest_distance
from soft_limb.reports.calibration_report import validation_panels


def plot_taught(experiment: Experiment) -> Figure:
    """Draw Fig. 7: poses of the limb every few seconds, taught and repeated."""
    motions = experiment.taught
    figure = Figure(figsize=(WIDTH, 2.6 * len(motions)), layout="constrained")
    axes = figure.subplots(2 * len(motions), 1)
    # Draw the limb below the hand, for each motion.
    for pair, (motion, by_hand) in zip(axes.reshape(-1, 2), motions.items(), strict=True):
        repeated = experiment.ways[motion][OPEN_LOOP].rollouts[0]
        for axis, recording, title, color in (
            (pair[0], by_hand, "taught", "0.35"),
            (pair[1], repeated, "repeated", ROLLOUT_COLOR),
        ):
            _plot_poses(axis, recording, color)
            axis.set_ylabel(f"{motion},\n{title}", fontsize=8.5)
    axes[-1].set_xlabel("time (s)")
    return figure


def _plot_poses(axis, recording: Recording, color: str) -> None:
    """Draw the shape of a limb of one segment by (11) every five seconds, E1 down, E2 right."""
    times = np.arange(5.0, recording.time[-1], 5.0)
    places = 1.1 * np.arange(len(times))  # in lengths of the limb
    for place, time in zip(places, times, strict=True):
        # Draw links of equal length in the directions of the joint angles.
        angle = np.interp(time, recording.time, recording.bend_angle[0])
        directions = np.cumsum(joint_angles_from_bend_angle(recording.parameters, [angle]))
        links = np.array([np.sin(directions), -np.cos(directions)]) / len(directions)
        x, y = np.cumsum(np.column_stack([[0, 0], links]), axis=1)
        axis.plot(place + x, y, "-", color=color, linewidth=5, solid_capstyle="round")
        axis.plot(place, 0, "s", color="0.7", markersize=8)
        axis.text(place, 0.2, f"{round(np.rad2deg(angle)):+d}°", ha="center", fontsize=8)
    # Leave the times alone on the axes.
    axis.set_xlim(-0.7, 1.1 * len(times) - 0.4)
    axis.set_ylim(-1.15, 0.45)
    axis.set_aspect("equal")
    axis.set_yticks([])
    axis.spines[:].set_visible(False)
    axis.set_xticks(places, [f"{time:g}" for time in times], fontsize=8)
    axis.tick_params(length=0)


def plans_to_plot(experiment: Experiment) -> dict[str, PlanWithRollouts]:
    """Return the rollouts of `RAMPS` to plot, by method.

    The methods are open loop before and after calibration, `follow`, and the repetition of
    learning whose reading was nearest to the reference.
    """
    ways = experiment.ways[RAMPS]
    plotted = {f"{OPEN_LOOP}, not calibrated": experiment.compared[AS_DESCRIBED][RAMPS]}
    plotted |= {name: ways[name] for name in (OPEN_LOOP, FOLLOW)}
    trajectory = ways[LEARNING].trajectory
    learned = ways[LEARNING].rollouts
    return plotted | {
        f"{LEARNING}, best of {len(learned)} as read": PlanWithRollouts(trajectory, learned[-1:])
    }


def plot_methods(plotted: Mapping[str, PlanWithRollouts]) -> Figure:
    """Draw the methods of `plans_to_plot` side by side: bend, as read and true, and V.

    The title of a method has the mean distance of the true bend from the reference over all
    rollouts; the first rollout is drawn. The title of the figure has the best possible distance.
    """
    figure = Figure(figsize=(2.0 * WIDTH, 4.6), layout="constrained")
    axes = figure.subplots(2, len(plotted), sharex=True, sharey="row", height_ratios=[1.4, 1.0])
    for (bend, heat), (name, way) in zip(axes.T, plotted.items(), strict=True):
        # Draw the bend: reference, reading, true bend and plan.
        rollout = way.rollouts[0]
        plan = way.trajectory.since_start()
        read = np.rad2deg(rollout.bend_angle[0])
        true = np.rad2deg(true_bend(rollout).bend_angle[0])
        bend.set_title(f"{name}: {RolloutStatistics.of(way).true_reference:.2f}°")
        reference = np.rad2deg(plan.reference[0])
        bend.plot(plan.time, reference, color=REFERENCE_COLOR, lw=1.0, label="reference")
        bend.plot(rollout.time, read, color=ROLLOUT_COLOR, lw=0.6, label="read")
        bend.plot(rollout.time, true, color="k", lw=1.0, label="true")
        bend.plot(plan.time, np.rad2deg(plan.bend_angle[0]), "--", color=PLAN_COLOR, label="plan")
        # Draw the readings of each wire, and their plan.
        names = rollout.parameters.wire_names
        for wire, color in enumerate(wire_colors(len(names))):
            reading = rollout.measured_temperature[wire]
            planned = plan.measured_temperature[wire]
            heat.plot(rollout.time, reading, color=color, lw=1.0, label=f"{names[wire]}, V")
            heat.plot(plan.time, planned, "--", color=color, lw=1.0, label=f"{names[wire]}, plan")
        heat.set_xlabel("time (s)")
        for axis in (bend, heat):
            axis.grid(alpha=0.25)
            axis.spines[["top", "right"]].set_visible(False)
    # Add titles, labels and legends.
    nearest = nearest_distance(plotted[OPEN_LOOP].trajectory)
    best = "" if nearest is None else f"; the best plan within the limits: {nearest:.2f}°"
    figure.suptitle(
        f"Mean distance of the true bend from the reference, on an emulated limb{best}",
        fontsize=10,
    )
    axes[0, 0].set_ylabel("bend angle (°)")
    axes[1, 0].set_ylabel("temperature (°C)")
    for axis in axes[:, 0]:
        axis.legend(frameon=False, fontsize=8)
    return figure


def figures(experiment: Experiment) -> dict[str, tuple[Figure | list[Panel], str]]:
    """Return the paper's figures of one limb by the names of their files, with descriptions.

    A figure is a list of panels, which a page draws as an interactive chart, or a picture.
    """
    # Draw Figs. 4 to 6 as panels.
    driven = {motion: ways[OPEN_LOOP] for motion, ways in experiment.ways.items()}
    tracking = {}
    for motion, way in driven.items():
        tracking[motion] = tracking_panels(way.trajectory, way.rollouts)
    validation = experiment.calibration.validation
    assert validation is not None  # recordings of an emulated limb are enough for one
    result: dict[str, tuple[Figure | list[Panel], str]] = {
        "fig4": (
            validation_panels(validation),
            "Fig. 4: the calibrated model and the emulated limb for the same duty",
        ),
        "fig5": (
            tracking[VALIDATION],
            "Fig. 5: two steps and a decaying sinusoid, plan and rollouts. The limb cannot move "
            "as asked: heat builds up and leaves over seconds, and bounds hold",
        ),
    }
    for letter, name in zip("ab", HANDS, strict=True):
        text = f"Fig. 6, {name}: a motion that was taught, plan and rollouts"
        result[f"fig6{letter}"] = tracking[name], text
    # Draw Fig. 7 and the comparison of methods as pictures.
    result["fig7"] = (
        plot_taught(experiment),
        "Fig. 7: the limb's shape by its bend sensor, constant curvature (11), as it was taught "
        "and as it repeated it",
    )
    result["ways"] = (
        plot_methods(plans_to_plot(experiment)),
        "Ramps that the limb can follow: open loop before and after calibration, follow, and the "
        "repetition of learning that was read nearest to the reference. Each curve is the first "
        "rollout, and each distance is the mean over all rollouts",
    )
    return result
