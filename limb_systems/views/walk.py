"""A robot that walks, as a picture: some moments of a cycle from its side, and its heat."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.patches import Circle, Polygon
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from limb_systems.errors import LimbError
from limb_systems.files.gait import Gait
from limb_systems.model.robot import make_robot, set_positions
from limb_systems.views.colors import NEUTRAL_COLOR, wire_colors
from limb_systems.views.limb_view import wire_color
from limb_systems.views.panels import CONTACTS, foot_fall_panel
from limb_systems.views.plots import WIDTH, Figure, draw_panel, dress

FRAMES = 6
_ROW = 3  # frames beside each other
_SILICONE, _BODY, _EDGE = "#e3e7ee", "#5c6b80", "#8a94a3"
_MARK = 10.0  # mm, from mark to mark on the ground
_ARROWS = {"stick": "▲", "slide_forward": "▶", "slide_backward": "◀", "swing": ""}


def draw_walk(gait: Gait, title: str = "") -> Figure:
    """Moments of a gait's cycle from the side, what its feet do, and the temperatures of its wires.

    The last moment is the first one again, a stride further. All show the same stretch of ground,
    and where the body was at first. Wires have the colour of their temperature; below each foot is
    a triangle if it sticks, or an arrow to where it slides.

    Raises:
        LimbError: if the robot's body does not move in the plane, or a limb bends in space.
    """
    robot, limbs = gait.robot, len(gait.robot.limbs)
    if robot.body.mount != "planar":
        raise LimbError("A robot is drawn from the side if its body moves in the plane.")
    times = np.linspace(0.0, gait.period, FRAMES)
    builder = DiagramBuilder()  # it keeps the plant
    plant = make_robot(builder, robot)
    scenes = [_Scene(gait, plant, time) for time in times]
    points = np.vstack([scene.outline for scene in scenes])
    left, low = np.subtract(points.min(axis=0), (6, 17))
    right, high = np.add(points.max(axis=0), (6, 1))
    rows = FRAMES // _ROW
    width = 1.35 * WIDTH
    heights = [width / _ROW * (high - low) / (right - left)] * rows + [0.35 + 0.22 * limbs, 2.0]
    figure = Figure(figsize=(width, sum(heights) + 0.9), layout="constrained")
    grid = figure.add_gridspec(rows + 2, _ROW, height_ratios=heights)
    for number, scene in enumerate(scenes):
        axis = figure.add_subplot(grid[divmod(number, _ROW)])
        if number:
            first = Polygon(scenes[0].body, fill=False, edgecolor=_EDGE, linestyle="--", lw=0.7)
            axis.add_patch(first)
        scene.draw(axis, left, right)
        axis.set(xlim=(left, right), ylim=(low, high), aspect="equal")
        axis.set_title(f"{times[number]:.1f} s", loc="left", fontsize=10, pad=0)
        axis.set_axis_off()
    feet, heat = (figure.add_subplot(grid[rows + row, :]) for row in range(2))
    draw_panel(feet, foot_fall_panel(robot, gait.phases, gait.period))
    _draw_heat(heat, gait)
    feet.sharex(heat)
    feet.tick_params(labelbottom=False)
    for axis in (feet, heat):
        dress(axis, most_columns=2 * limbs)
        for time in times:
            axis.axvline(time, color=NEUTRAL_COLOR, linewidth=0.8, linestyle=":")
    limits = gait.parameters.temperature_limits.maximum
    values = np.linspace(gait.parameters.ambient_temperature, limits, 100)
    shades = ScalarMappable(
        Normalize(values[0], values[-1]), ListedColormap(wire_color(gait.parameters, values))
    )
    figure.colorbar(shades, ax=heat, label="wires' colour (°C)", pad=0.01, aspect=12)
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def _draw_heat(axis: Axes, gait: Gait) -> None:
    """T of all wires, one dash for each limb."""
    dashes = ("-", "--", ":", "-.")
    for number, (limb, wires) in enumerate(zip(gait.robot.limbs, gait.robot.wires_of, strict=True)):
        named = limb.parameters.wire_names
        for name, heat, color in zip(
            named, gait.wire_temperature[wires], wire_colors(len(named)), strict=True
        ):
            label = f"{limb.name} {name.replace('_', ' ')}"
            axis.plot(gait.time, heat, dashes[number % len(dashes)], color=color, label=label)
    highest = gait.parameters.temperature_limits.maximum
    axis.axhline(highest, color=NEUTRAL_COLOR, linewidth=0.8)
    axis.annotate("$T_{max}$", (0, highest), (3, -12), textcoords="offset points")
    axis.set(xlabel="time in the cycle (s)", ylabel="wire temperature (°C)")
    axis.margins(x=0.0)


class _Scene:
    """A robot at a time, in mm along the level and upwards.

    - ``body``: corners of the body (4, 2).
    """

    def __init__(self, gait: Gait, plant: MultibodyPlant, time: float):
        self._robot, context = gait.robot, plant.CreateDefaultContext()
        slope = gait.robot.ground.slope if gait.robot.ground else 0.0
        self._tilt = np.array([[np.cos(slope), -np.sin(slope)], [np.sin(slope), np.cos(slope)]])

        def at(signal: np.ndarray) -> np.ndarray:
            return np.array([np.interp(time, gait.time, row) for row in signal])

        set_positions(plant, context, gait.robot, at(gait.body_pose), at(gait.joint_angles))
        self._colors = wire_color(gait.parameters, at(gait.wire_temperature))
        self._contacts = [p for p in gait.phases if p.start <= time % gait.period][-1].contacts

        def pose(name: str) -> tuple[np.ndarray, np.ndarray]:
            found = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(name))
            turned = self._tilt @ found.rotation().matrix()[[0, 2]]
            return 1e3 * self._tilt @ found.translation()[[0, 2]], turned

        center, turn = pose("body")
        body = gait.robot.body
        corner = 500 * np.array([body.length, 0.0, body.height])
        signs = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
        self.body = center + (signs * corner) @ turn.T
        self._limbs: list[tuple[np.ndarray, np.ndarray]] = []  # axis and E2 at links' ends
        for limb in gait.robot.limbs:
            links = range(1, sum(s.links for s in limb.parameters.segments) + 1)
            poses = [pose(f"{limb.name}_link_{number}") for number in links]
            foot = pose(f"{limb.name}_foot")[0]
            lateral = np.array([turned[:, 1] for _, turned in poses])
            ends = np.vstack([lateral[:1], (lateral[1:] + lateral[:-1]) / 2, lateral[-1:]])
            self._limbs.append((np.vstack([[place for place, _ in poses], foot]), ends))

    @property
    def outline(self) -> np.ndarray:
        """Points (any, 2) that the robot reaches to."""
        return np.vstack([self.body, *(axis for axis, _ in self._limbs)])

    def draw(self, axis: Axes, left: float, right: float) -> None:
        """Draw the robot on its ground from left to right."""
        marks = np.arange(np.ceil(left / _MARK), np.floor(right / _MARK) + 1) * _MARK
        below = self._tilt[:, 1]
        axis.plot(*(self._tilt[:, :1] * [left, right]), color="#555555", linewidth=1.0)
        for mark in marks:
            at = mark * self._tilt[:, 0]
            axis.plot(*np.transpose([at, at - 1.5 * below]), color="#555555", linewidth=0.8)
            if mark % (5 * _MARK) == 0:
                text = f"{mark:g} mm" if mark else "0"
                x, z = at - 10 * below
                axis.text(x, z, text, ha="center", va="top", fontsize=7)
        for (middle, lateral), limb, wires, contact in zip(
            self._limbs, self._robot.limbs, self._robot.wires_of, self._contacts, strict=True
        ):
            radius = 1e3 * self._robot.feet.radius
            axis.add_patch(Circle(middle[-1], radius, color=_BODY, linewidth=0))
            half = [500 * segment.thickness for segment in limb.parameters.segments]
            sides = [middle + sign * half[0] * lateral for sign in (1, -1)]
            outline = np.vstack([sides[0], sides[1][::-1]])
            axis.add_patch(Polygon(outline, facecolor=_SILICONE, edgecolor=_EDGE, linewidth=0.5))
            number = 0
            for segment in limb.parameters.segments:
                along = slice(number, number + segment.links + 1)
                number += segment.links
                colors = self._colors[wires][: len(segment.wires)]
                for wire, color in zip(segment.wires, colors, strict=True):
                    x, z = (middle + 1e3 * wire.e2 * lateral)[along].T
                    axis.plot(x, z, color=color, linewidth=2.6, solid_capstyle="butt")
            color = CONTACTS[contact][1]
            x, z = middle[-1] - (2.0 + radius) * below
            axis.text(x, z, _ARROWS[contact], color=color, ha="center", va="top", fontsize=9)
        axis.add_patch(Polygon(self.body, facecolor=_BODY, linewidth=0, zorder=3))
