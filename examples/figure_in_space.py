"""A figure of a limb that draws with its tip: rendered poses, and the paths of the tips.

    python examples/figure_in_space.py PLAN.csv RECORDING.csv [-o PICTURE.png]

Make the files by `soft-limb follow circle`, with a limb of one segment that bends in space.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from render_motion import IN_SPACE, Scene, heat_scale

from limb_systems import LimbError, Recording, Trajectory, add_limb, tip_position
from limb_systems.tracking import reference_distances
from limb_systems.views.colors import PLAN_COLOR, REFERENCE_COLOR, ROLLOUT_COLOR
from limb_systems.views.limb_view import ghost_of_reference, joint_angle_trajectory
from limb_systems.views.plots import save_figure

POSES = 4
SIZE = 1240, 920  # px


def draw_in_space(plan: Trajectory, recording: Recording) -> Figure:
    """Draw some poses of a limb, and the paths of the tips of limb, plan and reference."""
    parameters = recording.parameters
    plan = plan.since_start()
    # Put a limb for each pose into one scene.
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    limbs = [add_limb(plant, parameters, name=f"pose_{number}") for number in range(POSES)]
    plant.Finalize()
    center = [0.5 * parameters.length, 0.0, 0.0]
    radius = 0.6 * parameters.length
    scene = Scene(builder.Build(), plant, scene_graph, center, radius, IN_SPACE, SIZE)
    # Bend them as the limb was bent at times on the circle.
    bend = np.linalg.norm(plan.reference, axis=0)
    begin = plan.time[np.argmax(bend > 0.9 * bend.max())]
    times = np.linspace(begin, recording.time[-1], POSES + 1)[:-1]
    motion = joint_angle_trajectory(recording)
    heat = recording.wire_temperature
    if heat is None:
        heat = recording.measured_temperature
    for limb, time in zip(limbs, times, strict=True):
        plant.SetPositions(scene.context, limb, motion.value(time)[:, 0])
        scene.color_wires(parameters, recording.interpolated(heat, time), limb)
    figure = Figure(figsize=(6.2, 4.9), layout="constrained")
    axis = figure.subplots()
    axis.imshow(scene.picture(), interpolation="antialiased")
    # Draw the paths of the tips over it.
    along = np.linspace(0.0, recording.time[-1], 999)
    for label, angles, color, style in (
        ("reference", ghost_of_reference(plan).joint_angles, REFERENCE_COLOR, "-"),
        (f"limb ({recording.how})", motion, ROLLOUT_COLOR, "-"),
        ("plan", joint_angle_trajectory(plan), PLAN_COLOR, "--"),
    ):
        path = scene.pixels(tip_position(parameters, angles.vector_values(along)))
        axis.plot(*path, style, color=color, linewidth=1.3, label=f"tip of the {label}")
    poses = np.column_stack([motion.value(time) for time in times])
    tips = scene.pixels(tip_position(parameters, poses))
    outward = tips - tips.mean(axis=1, keepdims=True)
    labels = tips + 110 * outward / np.linalg.norm(outward, axis=0)
    for time, place in zip(times, labels.T, strict=True):
        axis.text(*place, f"{time:.0f} s", ha="center", va="center")
    # Draw the axes.
    ends = np.diag([1.25 * parameters.length, 0.04, 0.04])
    base = scene.pixels(np.zeros((3, 1)))[:, 0]
    for name, end in zip(("E1", "E2", "E3"), scene.pixels(ends).T, strict=True):
        arrow = {"arrowstyle": "-|>", "color": "0.35", "linewidth": 1.0}
        axis.annotate("", end, base, arrowprops=arrow)
        axis.text(*(base + 1.08 * (end - base)), name, color="0.35", ha="center", va="center")
    # Add the title, the legend and the scale of the colours.
    distance_deg = np.rad2deg(reference_distances(plan, [recording]).measured)
    axis.set_title(
        f"mean distance of the measured bend from the circle: {distance_deg:.1f}°", fontsize=10
    )
    axis.legend(loc="upper right", frameon=False)
    bar = {"label": "wire temperature (°C)", "shrink": 0.5, "pad": 0.0}
    figure.colorbar(heat_scale(parameters), ax=axis, orientation="horizontal", aspect=30, **bar)
    axis.set(xlim=(0, SIZE[0]), ylim=(SIZE[1], 0))
    axis.set_axis_off()
    return figure


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw a figure of a limb in space.")
    parser.add_argument("plan", type=Trajectory.load)
    parser.add_argument("recording", type=Recording.load)
    parser.add_argument("-o", "--out", type=Path, default="out/space.png")
    options = parser.parse_args()
    try:
        save_figure(draw_in_space(options.plan, options.recording), options.out)
    except LimbError as error:
        sys.exit(f"error: {error}")
