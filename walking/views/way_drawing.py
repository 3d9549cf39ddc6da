"""The way of a robot over the ground, from above."""

from collections.abc import Sequence

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.patches import Circle, Polygon

from limb_systems.errors import LimbError
from limb_systems.files.recording import Recording
from limb_systems.views.colors import NEUTRAL_COLOR, PLAN_COLOR
from limb_systems.views.plots import WIDTH, Figure
from walking.gait import along_heading
from walking.robot_parameters import RobotParameters

BODIES = 12  # that are drawn along the way
SHADES = "viridis"


def draw_way(recording: Recording, goals: Sequence[Sequence[float]], near: float) -> Figure:
    """A robot's way from above: its body at some times, and the places to which it was to go.

    Args:
        recording: recording of a robot in space whose body is seen.
        goals: places x, y, m, or x, y and yaw, m and rad.
        near: how far from a place it is reached, m.

    Raises:
        LimbError: if the body is not seen, or moves in the vertical plane.
    """
    robot, pose = recording.robot, recording.body_pose
    if not isinstance(robot, RobotParameters) or pose is None or len(pose) != 6:
        raise LimbError("A way is drawn of a robot in space whose body is seen.")
    time, (x, y), yaw = recording.time, 1e3 * pose[:2], np.unwrap(pose[5])
    places = 1e3 * np.array([goal[:2] for goal in goals])
    wide, high = np.ptp(np.vstack([np.transpose([x, y]), places]), axis=0) + 2e3 * robot.body.length
    height = float(np.clip(WIDTH * high / wide, 0.25 * WIDTH, WIDTH))
    figure = Figure(figsize=(WIDTH, height + 1.0), layout="constrained")
    axis = figure.subplots()
    shades = ScalarMappable(Normalize(time[0], time[-1]), SHADES)
    half = 500 * np.array([robot.body.length, robot.body.width])
    # A body is pointed at its front.
    outline = half * np.array([[-1, -1], [0.6, -1], [1, 0], [0.6, 1], [-1, 1]])
    for k in np.linspace(0, len(time) - 1, BODIES).astype(int):
        corners = np.add(along_heading(outline.T, -yaw[k]).T, [x[k], y[k]])
        color = shades.to_rgba(time[k])
        axis.add_patch(Polygon(corners, facecolor=(*color[:3], 0.12), edgecolor=color, lw=0.8))
    axis.plot(x, y, color=NEUTRAL_COLOR, linewidth=0.7)
    for number, (place, (_, _, *heading)) in enumerate(zip(places, goals, strict=True), 1):
        axis.add_patch(Circle(place, 1e3 * near, color=PLAN_COLOR, fill=False, lw=1.5))
        axis.text(place[0], place[1], str(number), ha="center", va="center", color=PLAN_COLOR)
        if heading:
            far = 1.2 * half[0]
            ahead = place[0] + far * np.cos(heading[0]), place[1] + far * np.sin(heading[0])
            arrow = {"arrowstyle": "->", "color": PLAN_COLOR}
            axis.annotate("", ahead, tuple(place), arrowprops=arrow)
    axis.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    axis.margins(0.05)
    axis.autoscale_view()
    axis.grid(color="#e9ecf0")
    axis.set_axisbelow(True)
    figure.colorbar(shades, ax=axis, label="time (s)", location="bottom", aspect=40)
    return figure
