"""A robot that walks, as a picture of some moments of a cycle and its heat, or as a short loop."""

import io
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.patches import Circle, Polygon
from pydrake.math import RotationMatrix
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial import ConvexHull

from limb_systems.errors import LimbError
from limb_systems.files.output import OutputError, check_folder, write_atomically
from limb_systems.files.recording import Recording
from limb_systems.layout import Layout
from limb_systems.limb_parameters import LimbParameters
from limb_systems.views.colors import NEUTRAL_COLOR, wire_colors
from limb_systems.views.limb_view import box_corners, seen_from, wire_color
from limb_systems.views.plots import WIDTH, Figure, draw_panel, dress
from walking.foot_fall import foot_fall
from walking.gait import Gait
from walking.robot import make_robot, set_positions
from walking.robot_parameters import RobotLimb, RobotParameters
from walking.views.robot_panels import CONTACT_BARS, foot_fall_panel
from walking.views.robot_view import FIFTH, MARK

FRAMES = 6
FRAMES_PER_SECOND, PIXELS_PER_INCH, COLORS = 10, 100, 256  # of a loop
_ROW = 3  # frames beside each other
_SILICONE, _EDGE, _GROUND = "#e3e7ee", "#8a94a3", "#555555"
_FACES = "#4c596b", "#5c6b80", "#8290a4"  # of the body, across its x, y and z
_BODY = _FACES[1]
_MARK = 1e3 * MARK  # mm, of which each `FIFTH` is labelled
_GRIDS = "#e9ecf0", "#c9ced6"  # of marks, and of labelled marks
_ARROWS = {"stick": "▲", "slide_forward": "▶", "slide_backward": "◀", "slide": "", "swing": ""}
# mm from a foot, along the ground to where it is dragged, and across.
_ARROW = np.array([[4, 1], [13, 1], [13, 4], [21, 0], [13, -4], [13, -1], [4, -1]])
_BEHIND = 0.35  # opacity of wires behind the axis of their limb

# Azimuth and elevation of the eye, °. It is at the right side of a robot in the plane; of a robot
# in space it is in front, above and to the right.
_BESIDE, _OBLIQUE = (0.0, 0.0), (40.0, 30.0)


def draw_walk(gait: Gait) -> Figure:
    """Moments of a gait's cycle, what its feet do, and the temperatures of its wires.

    A robot in the plane is seen from its side, a robot in space from in front, above and its right.
    The last moment is the first one again, a stride further. All show the same stretch of ground,
    and where the body was at first. Wires have the colour of their temperature; below each foot is
    a triangle if it sticks, or an arrow to where it slides or is dragged.

    Raises:
        LimbError: if the robot's body does not move.
    """
    robot, limbs = gait.robot, len(gait.robot.limbs)
    walk = _Walk(gait.repeated(2))  # the last moment is of the second cycle
    times = np.linspace(0.0, gait.period, FRAMES)
    scenes = [walk.at(time) for time in times]
    stage = _Stage(walk, scenes)
    rows = FRAMES // _ROW
    width = 1.35 * WIDTH
    most_wires = max(len(limb.parameters.wire_names) for limb in robot.limbs)
    columns = 2 * limbs if most_wires <= 2 else limbs  # of the legend; else one for each limb
    lines = 0.0 if most_wires <= 2 else 0.2 * (most_wires - 1)  # inches
    height = width / _ROW * stage.height / stage.width * (0.87 if gait.in_space else 1.0)
    heights = [height] * rows + [0.35 + 0.22 * limbs, 2.0]
    figure = Figure(figsize=(width, sum(heights) + 0.9 + lines), layout="constrained")
    grid = figure.add_gridspec(rows + 2, _ROW, height_ratios=heights)
    for number, scene in enumerate(scenes):
        axis = figure.add_subplot(grid[divmod(number, _ROW)])
        stage.draw(axis, scene, scenes[0] if number else None)
        axis.set_title(f"{times[number]:.1f} s", loc="left", fontsize=10, pad=0)
    feet, heat = (figure.add_subplot(grid[rows + row, :]) for row in range(2))
    draw_panel(feet, foot_fall_panel(robot, gait.phases, gait.period))
    _draw_heat(heat, gait)
    feet.sharex(heat)
    feet.tick_params(labelbottom=False)
    for axis in (feet, heat):
        dress(axis, most_columns=columns)
        for time in times:
            axis.axvline(time, color=NEUTRAL_COLOR, linewidth=0.8, linestyle=":")
    shades = _shades(gait.parameters)
    figure.colorbar(shades, ax=heat, label="wires' colour (°C)", pad=0.01, aspect=12)
    return figure


def animate_walk(
    motion: Gait | Recording, path: str | Path, *, cycles: int = 2, pace: float = 4.0
) -> None:
    """Write a loop of a robot that walks, as an animated GIF of 10 frames per second.

    It shows what the moments of `draw_walk` do, on all of the ground that the robot walks on.

    Args:
        motion: a gait, or a recording of a robot with its joint angles and its body's pose.
        path: path of the GIF.
        cycles: number of cycles of a gait; a recording is shown whole.
        pace: how many times as fast as the robot the loop is.

    Raises:
        OutputError: if the path does not end with .gif, or the file cannot be written; it is
            written whole or not at all.
        LimbError: if the robot's body does not move, or the recording lacks what is to be shown.
    """
    path = Path(path)
    if path.suffix.lower() != ".gif":
        raise OutputError(f"{path} is to be an animated picture; its name must end with .gif.")
    walk = _Walk(motion.repeated(cycles) if isinstance(motion, Gait) else motion)
    start, end = walk.time[[0, -1]]
    times = np.arange(start, end, pace / FRAMES_PER_SECOND)
    scenes = [walk.at(time) for time in times]
    stage = _Stage(walk, scenes)
    width, below = 0.7 * WIDTH, 0.6  # inches; below is the scale of heat
    height = width * stage.height / stage.width
    figure = Figure(figsize=(width, height + below), dpi=PIXELS_PER_INCH)
    whole = height + below
    axis = figure.add_axes((0.0, below / whole, 1.0, height / whole))
    scale = figure.add_axes((0.35, 0.48 / whole, 0.4, 0.08 / whole))
    shades, label = _shades(motion.parameters), "wire temperature (°C)"
    figure.colorbar(shades, scale, orientation="horizontal").set_label(label, fontsize=8)
    scale.tick_params(labelsize=8)
    clock = figure.text(0.02, 0.4 / whole, "", fontsize=9)
    writer = _LoopWriter(fps=FRAMES_PER_SECOND)
    check_folder(path.parent)
    path.parent.mkdir(parents=True, exist_ok=True)
    with writer.saving(figure, path, PIXELS_PER_INCH):
        for time, scene in zip(times, scenes, strict=True):
            axis.clear()
            stage.draw(axis, scene, large=1.8)
            clock.set_text(f"{time - start:.0f} s" + f"  ({pace:g} x as fast)" * (pace != 1))
            writer.grab_frame()


class _LoopWriter(PillowWriter):
    """A writer of GIFs whose frames share their colours, which takes half of the bytes."""

    _frames: list[Any]

    def finish(self) -> None:
        """Write the file, whole or not at all."""
        colors = self._frames[len(self._frames) // 2].quantize(COLORS, method=2)  # an octree
        first, *others = (frame.quantize(palette=colors, dither=0) for frame in self._frames)
        loop = io.BytesIO()
        first.save(
            loop,
            format="GIF",
            save_all=True,
            append_images=others,
            duration=1000 // self.fps,  # ms
            loop=0,  # for ever
        )
        write_atomically(self.outfile, loop.getvalue())


def _shades(parameters: LimbParameters) -> ScalarMappable:
    """The colours of wires by their temperature, for a scale."""
    span = parameters.ambient_temperature, parameters.temperature_limits.maximum
    colors = ListedColormap(wire_color(parameters, np.linspace(*span, 100)))
    return ScalarMappable(Normalize(*span), colors)


def _draw_heat(axis: Axes, gait: Gait) -> None:
    """T of all wires, one dash for each limb."""
    dashes = ("-", "--", ":", "-.")
    for number, (limb, wires) in enumerate(zip(gait.robot.limbs, gait.robot.wires_of, strict=True)):
        named = limb.parameters.wire_names
        for name, heat, color in zip(
            named, gait.wire_temperature[wires], wire_colors(len(named)), strict=True
        ):
            label = f"{limb.name} {name}".replace("_", " ")
            axis.plot(gait.time, heat, dashes[number % len(dashes)], color=color, label=label)
    highest = gait.parameters.temperature_limits.maximum
    axis.axhline(highest, color=NEUTRAL_COLOR, linewidth=0.8)
    clear = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5}
    axis.annotate("$T_{max}$", (0, highest), (3, -12), textcoords="offset points", bbox=clear)
    axis.set(xlabel="time in the cycle (s)", ylabel="wire temperature (°C)")
    axis.margins(x=0.0)


class _Walk:
    """The motion of a robot, to be seen at any of its times.

    - ``robot``: the robot.
    - ``time``: times of the samples (K,), s.
    - ``view``: rows of what is to the right, up and towards the eye (3, 3), mm by m.
    """

    def __init__(self, motion: Gait | Recording):
        robot, pose, state = motion.robot, motion.body_pose, motion.joint_state
        if not isinstance(robot, RobotParameters) or robot.body.mount == "welded":
            raise LimbError("A walk is drawn of a robot whose body moves.")
        if pose is None or state is None:
            raise LimbError(
                "A walk is drawn from a body's pose and joint angles, which this recording lacks."
            )
        self.robot, self.time, self._motion = robot, motion.time, motion
        heat = motion.wire_temperature
        self._heat = motion.measured_temperature if heat is None else heat
        self._pose, self._angles = np.unwrap(pose), state[: len(state) // 2]
        self._phases = motion.phases if isinstance(motion, Gait) else foot_fall(motion)
        self._builder = DiagramBuilder()  # it keeps the plant
        self._plant = make_robot(self._builder, robot)
        self._context = self._plant.CreateDefaultContext()
        slope = robot.ground.slope if robot.ground else 0.0
        view = seen_from(*(_BESIDE if robot.body.mount == "planar" else _OBLIQUE))
        self.view = 1e3 * view @ RotationMatrix.MakeYRotation(-slope).matrix()

    def at(self, time: float) -> "_Scene":
        """The robot at a time, s."""
        number = max(n for n, phase in enumerate(self._phases) if n == 0 or phase.start <= time)
        phase, ends = self._phases[number], [p.start for p in self._phases[1:]] + [self.time[-1]]
        dragged = np.zeros((len(self.robot.limbs), 3))
        if "slide" in phase.contacts:
            first, last = (self._feet(end) for end in (phase.start, ends[number]))
            dragged = last - first
        self._go_to(time)
        return _Scene(self, phase.contacts, dragged, self._motion.interpolated(self._heat, time))

    def pose(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """The place (3,), m, and the axes (3, 3) of a body where the robot is now."""
        found = self._plant.EvalBodyPoseInWorld(self._context, self._plant.GetBodyByName(name))
        return found.translation(), found.rotation().matrix()

    def _feet(self, time: float) -> np.ndarray:
        """Places of the feet (L, 3), m."""
        self._go_to(time)
        return np.array([self.pose(f"{limb.name}_foot")[0] for limb in self.robot.limbs])

    def _go_to(self, time: float) -> None:
        at = self._motion.interpolated
        pose, angles = at(self._pose, time), at(self._angles, time)
        set_positions(self._plant, self._context, self.robot, pose, angles)


class _LimbScene:
    """A limb at a time.

    - ``middle``: its axis at the ends of its pieces (P, 3), mm to the right, up and to the eye.
    - ``axes``: E1, E2 and E3 there, side by side, in the same axes (P, 3, 3), mm by m.
    - ``hip``: place of its base in the body's frame (3,), m.
    """

    def __init__(self, walk: _Walk, limb: RobotLimb):
        bodies: list[str] = []
        self._pieces: list[slice] = []  # ends of the pieces of each segment
        layout = Layout(limb.parameters)
        for pieces in layout.pieces:
            self._pieces.append(slice(len(bodies), len(bodies) + len(pieces) + 1))
            bodies += [body for body, _ in pieces]
        places, turns = zip(*(walk.pose(f"{limb.name}_{body}") for body in bodies), strict=True)
        self.middle = np.vstack([*places, walk.pose(f"{limb.name}_foot")[0]]) @ walk.view.T
        seen = walk.view @ np.array(turns)
        self.axes = np.concatenate([seen[:1], (seen[1:] + seen[:-1]) / 2, seen[-1:]])
        self._segments, self._wires_of = limb.parameters.segments, layout.wires_of
        self.hip = np.array(limb.position)

    def beside(self, e2: np.ndarray | float, e3: np.ndarray | float) -> np.ndarray:
        """Lines beside the axis, by m along E2 and E3 (S,), at the ends of pieces (S, P, 3), mm."""
        offsets = np.stack(np.broadcast_arrays(e2, e3), axis=-1)
        return self.middle + np.einsum("pij,...j->...pi", self.axes[:, :, 1:], offsets)

    @property
    def outline(self) -> np.ndarray:
        """The corners (any, 2) of the limb as it is seen, mm."""
        segment = self._segments[0]
        corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]).T
        if segment.axes == 2 and segment.thickness == segment.width:
            turn = np.linspace(0, 2 * np.pi, 36, endpoint=False)
            corners = np.array([np.cos(turn), np.sin(turn)])
        rings = self.beside(*(corners.T * [segment.thickness / 2, segment.width / 2]).T)[..., :2]
        along = np.gradient(self.middle[:, :2], axis=0)
        across = np.einsum("spi,pi->sp", rings, along[:, ::-1] * [-1, 1]).round(6)
        ends, count = np.arange(len(along)), len(rings)
        one, other = across.argmax(axis=0), across.argmin(axis=0)
        # The tip's rim from one side to the other, by the way that is seen.
        begin, end = int(one[-1]), int(other[-1])
        ways = [
            (begin + sign * np.arange((sign * (end - begin)) % count + 1)) % count
            for sign in (1, -1)
        ]
        rim = max((rings[way, -1] for way in ways), key=lambda way: (way @ along[-1]).mean())
        return np.vstack([rings[one, ends], rim, rings[other, ends][::-1]])

    def draw(
        self,
        axis: Axes,
        colors: np.ndarray,
        radius: float,
        levels: Iterator[float],
        large: float,
    ) -> None:
        """Draw the limb, the farthest wires first.

        Args:
            axis: axes to draw on.
            colors: colours of its wires (W, 3).
            radius: radius of its foot, mm.
            levels: levels of what is drawn, each over the one before.
            large: factor of the width of wires.
        """
        foot = self.middle[-1, :2]
        style: dict[str, Any] = {"facecolor": _SILICONE, "edgecolor": _EDGE, "linewidth": 0.5}
        axis.add_patch(Circle(foot, radius, color=_BODY, linewidth=0, zorder=next(levels)))
        axis.add_patch(Polygon(self.outline, zorder=next(levels), **style))
        for segment, pieces, wires in zip(
            self._segments, self._pieces, self._wires_of, strict=True
        ):
            courses = [self.beside(wire.e2, wire.e3)[pieces] for wire in segment.wires]
            near = [(course - self.middle[pieces])[:, 2].mean() for course in courses]
            for wire in np.argsort(np.round(near, 6), kind="stable"):
                axis.plot(
                    *courses[wire][:, :2].T,
                    color=colors[wires][wire],
                    alpha=_BEHIND if near[wire] < -1e-6 else 1.0,
                    linewidth=2.6 * large,
                    solid_capstyle="butt",
                    zorder=next(levels),
                )


class _Scene:
    """A robot at a time, in mm to the right, up and towards the eye.

    - ``body``: outline of the body (any, 2).
    - ``limbs``: the limbs.
    - ``reach``: corners of the body and ends of the limbs' pieces in the world (any, 3), mm.
    """

    def __init__(
        self, walk: _Walk, contacts: list[str], dragged: np.ndarray, temperature: np.ndarray
    ):
        """
        Args:
            walk: the walk, which is at the time.
            contacts: what each foot does (L).
            dragged: how far each foot is dragged in its phase (L, 3), m.
            temperature: T (W), °C.
        """
        self._robot, self._view, self._contacts = walk.robot, walk.view, contacts
        self._dragged, self._colors = dragged, wire_color(walk.robot.together, temperature)
        body, (center, turned) = walk.robot.body, walk.pose("body")
        half = np.array([body.length, body.width, body.height]) / 2
        to_eye = walk.view[2] @ turned / 1e3
        sides = np.where(to_eye < 0, -1.0, 1.0)
        self._faces: list[tuple[str, np.ndarray]] = []  # those that are seen
        turn = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        seen = np.flatnonzero(np.abs(to_eye) > 1e-6)
        for face in seen:
            corners = center + (np.insert(turn, face, sides[face], axis=1) * half) @ turned.T
            self._faces.append((_FACES[face], (corners @ walk.view.T)[:, :2]))
        corners = center + box_corners(-half, half).T @ turned.T
        points = (corners @ walk.view.T)[:, :2]
        self.body = points[ConvexHull(points).vertices]
        self.limbs = [_LimbScene(walk, limb) for limb in walk.robot.limbs]
        # Limbs on a seen face of the body hide it; others are within it or behind it.
        self._before = [bool((sides * limb.hip >= half - 1e-9)[seen].any()) for limb in self.limbs]
        ends = np.vstack([limb.middle for limb in self.limbs]) @ walk.view / 1e3
        self.reach = np.vstack([1e3 * corners, ends])

    @property
    def outline(self) -> np.ndarray:
        """Points (any, 2) that the robot reaches to in the picture, mm."""
        return np.vstack([self.body, *(limb.middle[:, :2] for limb in self.limbs)])

    def draw(self, axis: Axes, large: float) -> None:
        """Draw the robot, the farthest limbs first, and what its feet do, with a factor of size."""
        levels = itertools.count(1.0, 1e-3)  # below the line of the ground
        radius, up = 1e3 * self._robot.feet.radius, self._view[:2, 2] / 1e3
        order = np.argsort([limb.middle[0, 2].round(6) for limb in self.limbs], kind="stable")
        for before in (False, True):
            for number in order:
                if self._before[number] == before:
                    colors = self._colors[self._robot.wires_of[number]]
                    self.limbs[number].draw(axis, colors, radius, levels, large)
            for color, corners in () if before else self._faces:
                face = Polygon(corners, facecolor=color, linewidth=0, zorder=next(levels))
                axis.add_patch(face)
        for limb, contact, dragged in zip(self.limbs, self._contacts, self._dragged, strict=True):
            color, foot = CONTACT_BARS[contact][1], limb.middle[-1, :2] - (2.0 + radius) * up
            style = {"color": color, "ha": "center", "va": "top", "fontsize": 9 * large**0.5}
            axis.text(foot[0], foot[1], _ARROWS[contact], **style)
            if (far := np.linalg.norm(dragged[:2])) and contact == "slide":
                along = dragged[:2] / far
                ground = self._view[:2, :2] @ np.column_stack([along, [-along[1], along[0]]]) / 1e3
                style = {"facecolor": color, "edgecolor": "white", "linewidth": 0.5, "zorder": 3.0}
                axis.add_patch(Polygon(limb.middle[-1, :2] + _ARROW @ ground.T, **style))


class _Stage:
    """The ground that robots are drawn on, and the stretch of it on which all scenes are seen.

    - ``width``, ``height``: size of what is seen, mm.
    """

    def __init__(self, walk: _Walk, scenes: list[_Scene]):
        self._view, self._is_planar = walk.view, walk.robot.body.mount == "planar"
        points = np.vstack([scene.outline for scene in scenes])
        before, beyond = [6, 17], [6, 1]  # mm, to the left and below, to the right and above
        if not self._is_planar:
            reach = np.vstack([scene.reach for scene in scenes])[:, :2]
            ground = np.array([reach.min(axis=0) - (5, 10), reach.max(axis=0) + 5]) / _MARK
            # Low and high ends of the ground along x and y (2, 2), mm.
            self._ground = _MARK * np.array([np.floor(ground[0]), np.ceil(ground[1])])
            corners = walk.view[:2, :2] @ box_corners(*self._ground) / 1e3
            points = np.vstack([points, corners.T])
            before, beyond = [9, 10], [2, 5]
        self._low, self._high = points.min(axis=0) - before, points.max(axis=0) + beyond
        self.width, self.height = (self._high - self._low).tolist()

    def draw(
        self, axis: Axes, scene: _Scene, first: _Scene | None = None, large: float = 1.0
    ) -> None:
        """Draw a scene on the ground.

        Args:
            axis: axes to draw on.
            scene: the scene.
            first: the scene from which to draw where the body was at first, if any.
            large: factor of the size of marks and of the width of wires.
        """
        if self._is_planar:
            self._draw_line(axis)
        else:
            self._draw_grid(axis)
        if first:
            there = Polygon(first.body, fill=False, edgecolor=_EDGE, linestyle="--", lw=0.7)
            axis.add_patch(there)
        scene.draw(axis, large)
        axis.set(xlim=(self._low[0], self._high[0]), ylim=(self._low[1], self._high[1]))
        axis.set_aspect("equal")
        axis.set_axis_off()

    def _draw_line(self, axis: Axes) -> None:
        """The ground from its side, with marks below it."""
        along, up = self._view[:2, 0] / 1e3, self._view[:2, 2] / 1e3
        left, right = self._low[0], self._high[0]
        axis.plot(*np.outer(along, [left, right]), color=_GROUND, linewidth=1.0)
        for mark in _marks(left, right):
            at = mark * along
            axis.plot(*np.transpose([at, at - 1.5 * up]), color=_GROUND, linewidth=0.8)
            _label(axis, mark, at - 10 * up)

    def _draw_grid(self, axis: Axes) -> None:
        """The ground from above, with lines along x and y, and labels beside its near edge."""
        plane = self._view[:2, :2] / 1e3
        for direction in range(2):
            for mark in _marks(*self._ground[:, direction]):
                ends = np.insert(self._ground[:, [1 - direction]], direction, mark, axis=1)
                color = _GRIDS[int(mark % (FIFTH * _MARK) == 0)]
                axis.plot(*(plane @ ends.T), color=color, linewidth=0.8, zorder=0.5)
        for mark in _marks(*self._ground[:, 0]):
            _label(axis, mark, plane @ [mark, self._ground[0, 1]] - [0.0, 2.0])


def _marks(low: float, high: float) -> np.ndarray:
    """Places of marks from low to high, mm."""
    return np.arange(np.ceil(low / _MARK), np.floor(high / _MARK) + 1) * _MARK


def _label(axis: Axes, mark: float, place: np.ndarray) -> None:
    """Write how far a mark is from 0, if it is one that is labelled, mm."""
    if mark % (FIFTH * _MARK) == 0:
        text = f"{mark:g} mm" if mark else "0"
        axis.text(place[0], place[1], text, ha="center", va="top", fontsize=7)
