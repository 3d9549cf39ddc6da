"""Panels of what no single limb has: what the feet of a robot do, its body and contact forces."""

from collections.abc import Sequence

import numpy as np

from limb_systems.files.recording import Recording
from limb_systems.views.colors import PLAN_COLOR, ROLLOUT_COLOR, wire_colors
from limb_systems.views.panels import Curve, Panel
from walking.foot_fall import foot_fall
from walking.gait import Gait, GaitPhase
from walking.robot_parameters import RobotParameters

# What a foot may do: in words, in colour, and how wide its bar is, px.
CONTACT_BARS = {
    "stick": ("sticks", "#5b6b8c", 18.0),
    "slide_forward": ("slides forward", "#2f9e6e", 18.0),
    "slide_backward": ("slides backward", "#d83a4e", 18.0),
    "slide": ("is dragged", "#8a63d2", 18.0),
    "swing": ("swings", "#b0b6c0", 3.0),
}
_DASHES = {"x": "dashed", "y": "dotted", "z": "solid"}


def robot_panels(robot: RobotParameters, motion: Recording | Gait) -> list[Panel]:
    """Return panels of the contacts of feet, the body's pose and the contact forces, if present."""
    time = motion.time
    panels = []
    forces = motion.contact_force
    pose = motion.body_pose
    if isinstance(motion, Gait):
        panels.append(foot_fall_panel(robot, motion.phases, motion.period))
    elif forces is not None and motion.joint_state is not None and len(time) > 1:
        panels.append(foot_fall_panel(robot, foot_fall(motion), time[-1]))
    if pose is not None:
        in_space = robot.pose_size == 6
        # On a ground z changes little, and its curve would squeeze x and y.
        floats = in_space and robot.ground is None
        for group in ("mm", "°"):
            colors = wire_colors(3) if in_space else [ROLLOUT_COLOR]
            curves: list[Curve] = []
            for (name, unit, scale), row in zip(robot.pose_rows(), pose, strict=True):
                if unit == group and (floats or name != "z"):
                    curves.append(Curve(name, time, scale * row, colors[len(curves)]))
            names = ", ".join(curve.name for curve in curves)
            panels.append(Panel(f"body {names} ({group})", curves, 190))
    if forces is not None:
        of_feet = forces.reshape(len(robot.limbs), -1, len(time))
        axes = "xz" if robot.force_size == 2 else "xyz"
        curves = []
        for limb, color, of_foot in zip(
            robot.limbs, wire_colors(len(robot.limbs)), of_feet, strict=True
        ):
            foot = limb.name.replace("_", " ")
            for axis, force in zip(axes, of_foot, strict=True):
                curves.append(Curve(f"{foot}, {axis}", time, force, color, _DASHES[axis]))
        panels.append(Panel("contact force (N)", curves, 230 + 20 * (len(curves) // 6)))
    return panels


def body_path_panel(recording: Recording, goals: Sequence[Sequence[float]]) -> Panel:
    """Return the way of a body over the ground, from above, and the places it was to go to.

    Args:
        recording: recording of a robot in space whose body is seen.
        goals: places, whose first numbers are x and y, m.
    """
    assert recording.body_pose is not None
    x, y = 1e3 * recording.body_pose[:2]
    places = 1e3 * np.array([goal[:2] for goal in goals]).T
    curves = [
        Curve("way of the body", x, y, ROLLOUT_COLOR),
        Curve("places to go to", places[0], places[1], PLAN_COLOR, width=4.0, marks=True),
    ]
    return Panel("y (mm)", curves, 400, "x (mm)", equal=True)


def foot_fall_panel(robot: RobotParameters, phases: Sequence[GaitPhase], end: float) -> Panel:
    """A bar for each foot over time, whose colour says what it does; the first is the lowest.

    Args:
        robot: the robot whose feet they are.
        phases: what they do, one phase after the other.
        end: end of the last phase, s.
    """
    ends = [*(phase.start for phase in phases[1:]), end]
    curves: list[Curve] = []
    for contact, (name, color, width) in CONTACT_BARS.items():
        x: list[float] = []
        y: list[float] = []
        for number in range(len(robot.limbs)):
            for phase, until in zip(phases, ends, strict=True):
                if phase.contacts[number] == contact:
                    x += [phase.start, until, until]
                    y += [number, number, np.nan]  # no line to the next
        if x:
            curves.append(Curve(name, np.array(x), np.array(y), color, width=width))
    feet = len(robot.limbs)
    ticks = {number: limb.name.replace("_", " ") for number, limb in enumerate(robot.limbs)}
    return Panel("foot", curves, 90 + 32 * feet, y_range=(-0.6, feet - 0.4), y_ticks=ticks)
