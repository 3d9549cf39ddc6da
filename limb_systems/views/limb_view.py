"""The limb or robot in 3D, described once: links, wires, ghosts and bars of duty, and the camera.

The view is down on the bending plane: E1 points to the right and E2 up, so that
a positive bend angle bends the limb up, as in a plot, towards its right wire. On limbs that
bend in space it is from before their tip, with E3 up, so that the paths of tips are seen.
Robots are seen from their right side, so that they walk to the right, on a ground with marks
that is tilted as it slopes.
"""

import dataclasses
import itertools
import weakref
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import (
    Box,
    Cylinder,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.perception import PointCloud
from pydrake.systems.framework import DiagramBuilder
from pydrake.trajectories import PiecewisePolynomial

from limb_systems.errors import LimbError
from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory
from limb_systems.kinematics import (
    joint_angles_from_bend_angle,
    link_positions,
    tip_position,
)
from limb_systems.layout import Layout
from limb_systems.limb import add_limb
from limb_systems.limb_parameters import LimbParameters, SegmentParameters
from limb_systems.views.colors import PLAN_COLOR, REFERENCE_COLOR, ROLLOUT_COLOR
from walking.gait import Gait
from walking.robot import PLANE, add_robot, set_positions
from walking.robot_parameters import RobotParameters

GHOST_OPACITY = 0.5
DUTY_COLOR = (0.16, 0.18, 0.22)  # sRGB
# sRGB, evenly spaced from ambient temperature to T_max: blue, plum, red, orange.
WIRE_COLORS = np.array(
    [[0.30, 0.42, 0.60], [0.50, 0.32, 0.50], [0.86, 0.20, 0.16], [1.00, 0.54, 0.05]]
)
_TRACK_COLOR, _OUTLINE_COLOR = (0.93, 0.94, 0.95), (0.45, 0.47, 0.5)
# The camera's azimuth and elevation, of limbs in a plane and in space, and of robots, °.
_IN_PLANE, _IN_SPACE, _BESIDE = (0.0, 65.0), (45.0, 25.0), (0.0, 15.0)
_GROUND_COLOR, _MARK_COLOR = (0.97, 0.98, 0.96), (0.62, 0.64, 0.66)
MARK, FIFTH = 0.01, 5  # m, from mark to mark on the ground; each so many, one is wider
_IN_SIGHT = 4.0  # lengths of a robot to go, to which the camera shows all of the way
_ALONG = RotationMatrix.MakeYRotation(np.pi / 2)  # a cylinder's axis along E1
_FIELD_OF_VIEW = np.radians(25.0)  # from top to bottom; narrow, so that lengths compare

# What the camera of a Meshcat must see: corners (3, 8) for each root.
_in_view: weakref.WeakKeyDictionary[Meshcat, dict[str, np.ndarray]] = weakref.WeakKeyDictionary()


def wire_color(parameters: LimbParameters, temperature: ArrayLike) -> np.ndarray:
    """The colour of a wire: greyish blue at ambient temperature, orange at T_max.

    Args:
        parameters: limb whose ambient and maximum temperature span the colours;
            beyond them the colour does not change further.
        temperature: °C, any shape.

    Returns:
        (..., 3): red, green and blue (sRGB) in [0, 1], in a new last axis.
    """
    span = parameters.ambient_temperature, parameters.temperature_limits.maximum
    stops, values = np.linspace(*span, len(WIRE_COLORS)), np.asarray(temperature, float)
    return np.stack([np.interp(values, stops, c) for c in WIRE_COLORS.T], axis=-1)


def seen_from(azimuth: float, elevation: float) -> np.ndarray:
    """The axes to the right, up, and towards an eye: a row for each, in the world (3, 3).

    Args:
        azimuth: angle of the eye about +z from where it looks along +y, °.
        elevation: angle of the eye above the horizon, °.
    """
    sine, cosine = np.sin(np.radians(elevation)), np.cos(np.radians(elevation))
    raised = np.array([[1, 0, 0], [0, sine, cosine], [0, -cosine, sine]])
    return raised @ RotationMatrix.MakeZRotation(-np.radians(azimuth)).matrix()


def box_corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The corners (n, 2ⁿ) of a box from low to high (n,)."""
    return np.array(list(itertools.product(*zip(low, high, strict=True)))).T


def linear_wire_color(parameters: LimbParameters, temperature: np.ndarray) -> np.ndarray:
    """`wire_color` as linear RGB (..., 3), which Meshcat's materials use."""
    color = wire_color(parameters, temperature)
    return np.where(color > 0.04045, ((color + 0.055) / 1.055) ** 2.4, color / 12.92)


def wire_paths(limb: LimbParameters, bodies: str, model: str) -> list[list[str]]:
    """The Meshcat paths of each wire (W), one on each body of its segment.

    Args:
        limb: description of the limb.
        bodies: beginning of the paths of the limb's bodies.
        model: name of the model that the bodies are of.
    """
    return [
        [f"{bodies}{body}/{model}/wire_{wire.name}" for body, _ in pieces]
        for segment, pieces in zip(limb.segments, Layout(limb).pieces, strict=True)
        for wire in segment.wires
    ]


def color_wires(
    meshcat: Meshcat,
    paths: Sequence[Sequence[str]],
    parameters: LimbParameters,
    temperature: np.ndarray,
) -> None:
    """Colours what is at the paths of each wire (W) by its temperature (W), °C."""
    colors = linear_wire_color(parameters, temperature)
    for of_wire, color in zip(paths, colors, strict=True):
        for path in of_wire:
            meshcat.SetProperty(path, "color", [*color.tolist(), 1.0])


@dataclasses.dataclass(frozen=True)
class Ghost:
    """A translucent limb without wires, which shows how the limb should bend.

    - ``name``: ``reference`` or ``plan``.
    - ``joint_angles``: θ (n) over the time of the view, rad; held before and after.
    """

    name: str
    joint_angles: PiecewisePolynomial

    @property
    def color(self) -> tuple[float, ...]:
        """The colour of its curve in plots, sRGB."""
        return _rgb({"reference": REFERENCE_COLOR, "plan": PLAN_COLOR}[self.name])


def _rgb(code: str) -> tuple[float, ...]:
    return tuple(value / 255 for value in bytes.fromhex(code[1:]))


def joint_angle_trajectory(motion: Recording | Trajectory | Gait) -> PiecewisePolynomial:
    """θ over time: cubic between samples where rates are known, else linear.

    Between a gait's knots it is linear, as the body's pose, so that feet stay where they are.
    """
    if isinstance(motion, Gait):
        return PiecewisePolynomial.FirstOrderHold(motion.time, motion.joint_angles)
    if motion.joint_state is None:
        shown = ~np.isnan(motion.bend_angle).any(axis=0)
        return _bend_angle_trajectory(
            motion.parameters, motion.time[shown], motion.bend_angle[:, shown]
        )
    angles, rates = np.split(motion.joint_state, 2)
    return PiecewisePolynomial.CubicHermite(motion.time, angles, rates)


def ghosts_of_plan(parameters: LimbParameters, plan: Trajectory, start: float = 0.0) -> list[Ghost]:
    """The reference and the plan, over the time since ``start``, s, after the plan's own start.

    Raises:
        LimbError: if the plan is for a limb of another shape than the parameters'.
    """
    planned, present = map(_shape_in_words, (plan.parameters, parameters))
    if planned != present:
        raise LimbError(
            f"The plan is for a limb of {planned}, but the motion is of one of {present}; they "
            "cannot be shown together."
        )
    plan = plan.since_start()
    ghosts = [ghost_of_reference(plan), Ghost("plan", joint_angle_trajectory(plan))]
    for ghost in ghosts:
        ghost.joint_angles.shiftRight(-start)
    return ghosts


def ghost_of_reference(motion: Recording | Trajectory) -> Ghost:
    """The reference in a motion, by eqn (11), over the motion's time."""
    return Ghost(
        "reference", _bend_angle_trajectory(motion.parameters, motion.time, motion.reference)
    )


def _bend_angle_trajectory(parameters, time, bend_angle) -> PiecewisePolynomial:
    """θ over time for bend angles (F, K), rad, by eqn (11), linear between samples."""
    angles = joint_angles_from_bend_angle(parameters, bend_angle)
    return PiecewisePolynomial.FirstOrderHold(time, angles)


def _shape_in_words(parameters: LimbParameters) -> str:
    return " and ".join(
        f"{s.links} links, {1e3 * s.length:g} mm x {1e3 * s.thickness:g} mm x {1e3 * s.width:g} mm"
        + ", two axes" * (s.axes == 2)
        + ", twists" * s.twists
        + ", centred" * s.centred_joints
        for s in parameters.segments
    )


class LimbView:
    """A limb or a robot in 3D, its wires in the colour of their heat, with bars of duty.

    A limb may have ghosts. A robot is on its ground; the camera shows all of its way if that is
    known and short, and else goes with it. `add_to` puts the view into a Meshcat, `set_scene`
    sets the camera, and `show` moves it there, or wherever there are ``SetTransform`` and
    ``SetProperty`` as Meshcat has them.
    """

    def __init__(
        self, limb: LimbParameters | RobotParameters, ghosts: Sequence[Ghost] = (), root: str = ""
    ):
        """
        Args:
            limb: the limb, or the robot.
            ghosts: poses to compare the limb's with.
            root: beginning of the paths in Meshcat; empty, or ends with a slash.

        Raises:
            LimbError: if a robot is to have ghosts.
        """
        robot: RobotParameters | None = None
        if isinstance(limb, RobotParameters):
            robot, limb = None if limb.is_limb else limb, limb.together
        if robot and ghosts:
            raise LimbError("A robot is shown without a plan beside it; leave the plan out.")
        self._parameters, self._robot, self._ghosts, self._root = limb, robot, ghosts, root
        self._layout, self._follows = Layout(limb), True
        self._builder = DiagramBuilder()  # it keeps the plant
        self._plant, _ = self._add_plant(self._builder)
        self._context = self._plant.CreateDefaultContext()
        model = "robot" if robot else "limb"
        self._limb = f"{root}visualizer/{model}"
        self._pieces: list[tuple[str, SegmentParameters, float]] = []  # bodies and their lengths
        self.wire_paths: list[list[str]] = []
        others: list[str] = []
        limbs = {"": limb}
        if robot:
            others, limbs = ["body"], {f"{one.name}_": one.parameters for one in robot.limbs}
        for prefix, one in limbs.items():
            for segment, pieces in zip(one.segments, Layout(one).pieces, strict=True):
                self._pieces += [(f"{prefix}{body}", segment, length) for body, length in pieces]
            self.wire_paths += wire_paths(one, f"{self._limb}/{prefix}", model)
            others += [f"{prefix}payload"] * bool(one.payload)
            others += [f"{prefix}base", f"{prefix}foot"] if robot else []
        names = [name for name, _, _ in self._pieces] + others
        self._body = len(self._pieces)  # place of a robot's body among the bodies
        self._bodies = [self._plant.GetBodyByName(name) for name in names]
        # The length of the bars is 3 units.
        self._unit = 0.1 * max(one.length for one in limbs.values())
        planar = self._layout.is_planar
        self._to_camera = seen_from(*(_BESIDE if robot else _IN_PLANE if planar else _IN_SPACE))
        # The bars are in the plane of the bends, or of a robot's walk, or face the camera.
        facing = PLANE.matrix() if robot else np.eye(3) if planar else self._to_camera.T
        self._facing = RigidTransform(RotationMatrix(facing), np.zeros(3))
        self._bar_foot = robot.body.height / 2 + 1.5 * self._unit if robot else -1.5 * self._unit

    def add_to(self, meshcat: Meshcat, base_pose: RigidTransform | None = None) -> None:
        """Put the limb into a scene, in place of one with the same root.

        Args:
            base_pose: pose of the limb's frame (E1, E2, E3) in the world, or of the world of a
                robot on level ground; the world's origin if None.
        """
        self._base_pose = base_pose or RigidTransform()
        if self._robot and self._robot.ground:
            slope = RotationMatrix.MakeYRotation(-self._robot.ground.slope)
            self._base_pose = self._base_pose @ RigidTransform(slope, np.zeros(3))
        for folder in ("visualizer", "ghosts", "duty", "ground"):
            meshcat.Delete(f"{self._root}{folder}")
            meshcat.SetTransform(f"{self._root}{folder}", self._base_pose)
        meshcat.SetTransform(f"{self._root}duty", self._base_pose @ self._facing)
        self._add_limb(meshcat)
        for level, ghost in enumerate(self._ghosts):
            self._add_ghost(meshcat, ghost, level)
        self._add_bars(meshcat)

    def add_tip_path(
        self, meshcat: Meshcat, joint_angles: np.ndarray, ghost: Ghost | None = None
    ) -> None:
        """Put a dot where the tip of a limb in space is, or its ghost's, for each θ (n, K)."""
        dots = PointCloud(joint_angles.shape[1])
        dots.mutable_xyzs()[:] = tip_position(self._parameters, joint_angles)
        path = f"{self._root}ghosts/{f'{ghost.name}/' if ghost else ''}tip"
        color = ghost.color if ghost else _rgb(ROLLOUT_COLOR)
        meshcat.SetObject(path, dots, 0.13 * self._unit, Rgba(*color))

    def show(
        self,
        meshcat: Meshcat,
        joint_angles: np.ndarray,
        duty: np.ndarray | None,
        time: float,
        body_pose: np.ndarray | None = None,
    ) -> None:
        """Move limb, ghosts and bars; a recording by Meshcat shows them at this time, too.

        Args:
            joint_angles: θ (n), rad.
            duty: D (W); the bars stay as they are if None.
            time: time for the ghosts, s.
            body_pose: pose of a robot's body, as in `Recording`; that of a robot that stands on
                straight limbs if None.
        """
        poses = self._poses(joint_angles, body_pose)
        for body, pose in zip(self._bodies, poses, strict=True):
            meshcat.SetTransform(f"{self._limb}/{body.name()}", pose, time)
        if self._robot:
            center = poses[self._body].translation()
            back = -center * [1.0, 1.0, 0.0] if self._follows else np.zeros(3)
            step = FIFTH * MARK  # the marks repeat
            for folder, moved in (("visualizer", back), ("ground", np.fmod(back, step))):
                pose = self._base_pose @ RigidTransform(moved)
                meshcat.SetTransform(f"{self._root}{folder}", pose, time)
            pose = self._base_pose @ RigidTransform(center + back) @ self._facing
            meshcat.SetTransform(f"{self._root}duty", pose, time)
        for ghost in self._ghosts:
            before = RigidTransform()
            ghostly = self._poses(ghost.joint_angles.value(time)[:, 0])
            for path, pose in zip(self._ghost_paths(ghost), ghostly, strict=False):  # no payload
                meshcat.SetTransform(path, before.InvertAndCompose(pose), time)
                before = pose
        if duty is not None:
            for name, value in zip(self._parameters.wire_names, duty, strict=True):
                path = f"{self._root}duty/{name}/fill"
                meshcat.SetProperty(path, "scale", [1.0, float(value), 1.0], time)

    def show_heat(self, meshcat: Meshcat, temperature: np.ndarray) -> None:
        """Colour the wires by their temperatures (W), °C."""
        color_wires(meshcat, self.wire_paths, self._parameters, temperature)

    def set_scene(
        self,
        meshcat: Meshcat,
        joint_angles: np.ndarray | None = None,
        body_pose: np.ndarray | None = None,
    ) -> float:
        """Set the background, the lights, and a camera that shows a whole motion and the bars.

        The camera still shows what it was set to show of limbs with other roots. Call it after
        `add_to`, and before `show`.

        Args:
            joint_angles: θ, (n, K), rad; bends of up to 90°, 60° in space or 30° of robots if None.
            body_pose: pose of a robot's body (3 or 6, K), as far as it is known.

        Returns:
            Width by height of the narrowest window that shows all of it.
        """
        for path in (
            "/Grid",
            "/Axes",
            "/Lights/PointLightNegativeX",
            "/Lights/PointLightPositiveX",
        ):
            meshcat.SetProperty(path, "visible", False)
        for end in ("top_color", "bottom_color"):
            meshcat.SetProperty("/Background/<object>", end, [0.975, 0.98, 0.985])
        meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 1.5)
        meshcat.SetProperty("/Lights/FillLight/<object>", "intensity", 1.7)
        light = [-4.0, -10.0, 5.0] if self._robot else [-6.0, -2.0, 10.0]
        meshcat.SetProperty("/Lights/FillLight/<object>", "position", light)

        if joint_angles is None:
            towards = self._layout.bend_direction
            largest = np.radians(30.0 if self._robot else 90.0 if self._layout.is_planar else 60.0)
            angles = largest * np.linspace(-1.0, 1.0, 5)
            bends = [np.outer(towards == one, angles) for one in range(towards.max() + 1)]
            joint_angles = joint_angles_from_bend_angle(self._parameters, np.hstack(bends))
        limbs = _in_view.setdefault(meshcat, {})
        if self._robot:
            low, high = self._robot_reach(joint_angles, body_pose)
            if self._robot.ground:
                self._add_ground(meshcat, low, high)
            corners = box_corners(low, high)
        else:
            corners = self._reach(joint_angles)
        limbs[self._root] = self._base_pose @ corners
        corners = np.hstack(list(limbs.values()))
        target = (corners.min(axis=1) + corners.max(axis=1)) / 2
        right, up, near = self._to_camera @ (corners - target[:, np.newaxis])
        slope = np.tan(_FIELD_OF_VIEW / 2)
        distance = (np.abs(up) / slope + near).max()
        camera = "/Cameras/default/rotated/<object>"
        meshcat.SetProperty(camera, "fov", np.degrees(_FIELD_OF_VIEW))
        meshcat.SetProperty(camera, "near", 0.1 * distance)
        meshcat.SetProperty(camera, "far", 10.0 * distance)
        meshcat.SetCameraPose(target + distance * self._to_camera[2], target)
        return (np.abs(right) / (distance - near)).max() / slope

    def _add_limb(self, meshcat: Meshcat) -> None:
        """Put the bodies of the limb's URDF into a scene; once, as only their poses change."""
        builder = DiagramBuilder()
        _, scene_graph = self._add_plant(builder)
        params = MeshcatVisualizerParams(
            prefix=f"{self._root}visualizer", delete_on_initialization_event=False
        )
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
        diagram = builder.Build()
        diagram.ForcedPublish(diagram.CreateDefaultContext())
        # From the tip on, each link of clear silicone hides what of the next is within it.
        order, model = 0.0, "robot" if self._robot else "limb"
        for name in () if self._layout.is_planar else ("silicone", "joint"):
            for body, _, _ in reversed(self._pieces):
                path, order = f"{self._limb}/{body}/{model}/{name}/<object>", order + 1.0
                meshcat.SetProperty(path, "renderOrder", order)
                meshcat.SetProperty(path, "material.side", 0.0)  # front only

    def _add_plant(self, builder: DiagramBuilder) -> tuple[MultibodyPlant, SceneGraph]:
        """Add the limb or the robot to a diagram."""
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        if self._robot:
            add_robot(plant, self._robot)
        else:
            add_limb(plant, self._parameters)
        plant.Finalize()
        return plant, scene_graph

    def _add_ground(self, meshcat: Meshcat, low: np.ndarray, high: np.ndarray) -> None:
        """Put the ground below a box from low to high (3,), m, with a mark each 10 mm along x."""
        step, path = FIFTH * MARK, f"{self._root}ground"
        first, last = np.floor(low[0] / step) - 1, np.ceil(high[0] / step) + 1
        middle, depth = (low[1] + high[1]) / 2, 1.5 * (high[1] - low[1])
        size = (last - first) * step, depth, MARK / 5
        center = [(first + last) / 2 * step, middle, -size[2] / 2]
        meshcat.SetObject(f"{path}/plane", Box(*size), Rgba(*_GROUND_COLOR))
        meshcat.SetTransform(f"{path}/plane", RigidTransform(center))
        for number in range(round((last - first) * FIFTH) + 1):
            mark = Box(MARK * (0.05 if number % FIFTH else 0.15), depth, 1e-5)
            meshcat.SetObject(f"{path}/mark_{number}", mark, Rgba(*_MARK_COLOR))
            at = [first * step + number * MARK, middle, 1e-5]
            meshcat.SetTransform(f"{path}/mark_{number}", RigidTransform(at))

    def _ghost_paths(self, ghost: Ghost) -> list[str]:
        """Meshcat paths of a ghost's links, each below that of the link which it hangs on."""
        names = [name for name, _, _ in self._pieces]
        base = f"{self._root}ghosts/{ghost.name}"
        return list(itertools.accumulate(names, "{}/{}".format, initial=base))[1:]

    def _poses(
        self, joint_angles: np.ndarray, body_pose: np.ndarray | None = None
    ) -> list[RigidTransform]:
        """Poses of the bodies in the limb's frame, or in the robot's world."""
        if self._robot:
            set_positions(self._plant, self._context, self._robot, body_pose, joint_angles)
        else:
            self._plant.SetPositions(self._context, joint_angles)
        return [self._plant.EvalBodyPoseInWorld(self._context, body) for body in self._bodies]

    def _add_ghost(self, meshcat: Meshcat, ghost: Ghost, level: int) -> None:
        """Put a ghost into the scene.

        In space it is a tube along the axis, seen through the silicone, and the path of its tip.
        Else it is a flat strip just below the limb's top and narrower than the limb.
        Where both coincide the limb hides it, so that nothing flickers; where they
        differ it is visible beside the limb. Its centre line is always visible: it
        runs above the limb and between the wires. The line of the next ghost is above
        that of the previous one, and narrower.
        """
        if not self._layout.is_planar:
            times = np.linspace(ghost.joint_angles.start_time(), ghost.joint_angles.end_time(), 999)
            angles = ghost.joint_angles.vector_values(times)
            self.add_tip_path(meshcat, angles, ghost)
        for (_, segment, length), path in zip(self._pieces, self._ghost_paths(ghost), strict=True):
            thickness, width = segment.thickness, segment.width
            if not self._layout.is_planar:
                tube = Cylinder((0.05 + 0.03 * level) * thickness, length)
                meshcat.SetObject(f"{path}/tube", tube, Rgba(*ghost.color))
                meshcat.SetTransform(f"{path}/tube", RigidTransform(_ALONG, [length / 2, 0.0, 0.0]))
                continue
            gap = 0.15 * thickness  # links that overlap would be seen twice
            flat = 0.02 * thickness
            strip = Box(max(length - gap, 0.5 * length), 0.96 * thickness, flat)
            line = Box(length, (0.26 - 0.16 * level) * thickness, flat)
            below = 0.5 * width - (0.08 - 0.04 * level) * thickness
            above = 0.5 * width + (0.14 + 0.04 * level) * thickness
            for part, shape, height, opacity in (
                ("strip", strip, below, GHOST_OPACITY),
                ("line", line, above, 1.0),
            ):
                meshcat.SetObject(f"{path}/{part}", shape, Rgba(*ghost.color, opacity))
                meshcat.SetTransform(f"{path}/{part}", RigidTransform([length / 2, 0.0, height]))
            # The strips are blended in this order, whichever is nearer, and hide none.
            meshcat.SetProperty(f"{path}/strip/<object>", "renderOrder", level + 1.0)
            meshcat.SetProperty(f"{path}/strip/<object>", "material.depthWrite", False)
            meshcat.SetProperty(f"{path}/strip/<object>", "material.side", 0.0)  # front only

    def _add_bars(self, meshcat: Meshcat) -> None:
        """Put a bar for each wire beside the base, or above the body; its track is duty 1."""
        unit, thin = self._unit, 0.02 * self._unit
        for name, x in zip(self._parameters.wire_names, self._bar_positions(), strict=True):
            path = f"{self._root}duty/{name}"
            meshcat.SetTransform(path, RigidTransform([x, self._bar_foot, 0.0]))
            for part, margin, layer, color in (
                ("outline", 0.12 * unit, 0, _OUTLINE_COLOR),
                ("track", 0.06 * unit, 1, _TRACK_COLOR),
                ("fill/bar", 0.0, 2, DUTY_COLOR),
            ):
                shape = Box(0.5 * unit + 2 * margin, 3 * unit + 2 * margin, thin)
                meshcat.SetObject(f"{path}/{part}", shape, Rgba(*color))
                center = RigidTransform([0.0, 1.5 * unit, layer * thin])
                meshcat.SetTransform(f"{path}/{part}", center)

    def _bar_positions(self) -> np.ndarray:
        """Positions of the bars, m, with gaps between segments.

        They are along E1, left of the base, or along x about the middle of a robot's body.
        """
        steps = np.full(len(self._parameters.wires), 0.95)
        steps[[wires.start for wires in self._layout.wires_of]] = 1.25
        places = np.cumsum(steps)
        if self._robot:
            return self._unit * (places - (places[0] + places[-1]) / 2)
        bracket = (0.6 if self._layout.is_planar else 1.2) * self._pieces[0][1].thickness
        return self._unit * (places - places[-1] - 0.7) - bracket

    def _robot_reach(
        self, joint_angles: np.ndarray, body_pose: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The ends (3,) of a box that the robot and its bars stay in, with a margin, m.

        From here on the camera goes with the robot if it goes far, or nobody knows how far.
        """
        kept = np.unique(np.linspace(0, joint_angles.shape[1] - 1, 60).astype(int))
        bodies = [
            [
                pose.translation()
                for pose in self._poses(
                    joint_angles[:, k], None if body_pose is None else body_pose[:, k]
                )
            ]
            for k in kept
        ]
        places = np.array(bodies)  # (K, bodies, 3)
        centers = places[:, [self._body]]
        size = np.ptp(places - centers, axis=(0, 1)).max()
        far = np.ptp(centers, axis=(0, 1))[:2].max() > _IN_SIGHT * size
        self._follows = body_pose is None or bool(far)
        if self._follows:
            places = places - centers * [1.0, 1.0, 0.0]
        margin = np.array([4.0, 3.0, 1.0]) * self._unit
        low, high = places.min(axis=(0, 1)) - margin, places.max(axis=(0, 1)) + margin
        high[2] = max(high[2], places[:, self._body, 2].max() + self._bar_foot + 4.0 * self._unit)
        return low, high

    def _reach(self, joint_angles: np.ndarray) -> np.ndarray:
        """The corners (3, 8) of a box that limb and bars stay in, with a margin, m."""
        ends = link_positions(self._parameters, joint_angles)[1:]
        facing = self._facing.rotation().matrix()
        ends = np.einsum("ji,pjk->ipk", facing, ends)
        half_width = max(segment.width for segment in self._parameters.segments) / 2
        margin, unit = np.array([1.5 * self._unit, 1.5 * self._unit, half_width]), self._unit
        bars = np.array([1.8 * unit, 1.8 * unit, 0.0])
        low = np.minimum(ends.min(axis=(1, 2)) - margin, -bars)
        high = np.maximum(ends.max(axis=(1, 2)) + margin, bars)
        low[0] = min(low[0], self._bar_positions()[0] - 0.6 * unit)
        return facing @ box_corners(low, high)
