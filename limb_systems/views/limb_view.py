"""The limb in 3D, described once: links, wires, ghosts and bars of duty, and the camera.

The view is down on the bending plane: E1 points to the right and E2 up, so that
a positive bend angle bends the limb up, as in a plot, towards its right wire. On limbs that
bend in space it is from before their tip, with E3 up, so that the paths of tips are seen.
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

from limb_systems.connected_limbs import ConnectedLimbs, connected
from limb_systems.errors import LimbError
from limb_systems.files.recording import Recording
from limb_systems.files.signal_table import Planned
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

GHOST_OPACITY = 0.5
DUTY_COLOR = (0.16, 0.18, 0.22)  # sRGB
# sRGB, evenly spaced from ambient temperature to T_max: blue, plum, red, orange.
WIRE_COLORS = np.array(
    [[0.30, 0.42, 0.60], [0.50, 0.32, 0.50], [0.86, 0.20, 0.16], [1.00, 0.54, 0.05]]
)
_TRACK_COLOR, _OUTLINE_COLOR = (0.93, 0.94, 0.95), (0.45, 0.47, 0.5)
# The camera's azimuth and elevation, of limbs in a plane and in space, °.
_IN_PLANE, _IN_SPACE = (0.0, 65.0), (45.0, 25.0)
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


def joint_angle_trajectory(motion: Recording | Planned) -> PiecewisePolynomial:
    """θ over time: cubic between samples where rates are known, else linear.

    Where duty is held between knots, as in gaits, it is linear, as the body's pose, so that feet
    stay where they are.
    """
    if isinstance(motion, Planned) and motion.HOLDS_DUTY:
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


def view_of(
    described: LimbParameters | ConnectedLimbs, ghosts: Sequence[Ghost] = (), root: str = ""
) -> "LimbView":
    """Return the view of a limb, or of connected limbs.

    Args:
        described: description of the limb or the limbs.
        ghosts: poses to compare the limb's with.
        root: beginning of the paths in Meshcat; empty, or ends with a slash.

    Raises:
        LimbError: if connected limbs are to have ghosts.
    """
    if isinstance(described, LimbParameters):
        return LimbView(described, ghosts, root)
    if described.is_limb:
        return LimbView(described.together, ghosts, root)
    if ghosts:
        raise LimbError("A robot is shown without a plan beside it; leave the plan out.")
    return connected("view")(described, root)


class LimbView:
    """A limb in 3D, its wires in the colour of their heat, with bars of duty.

    It may have ghosts. `add_to` puts the view into a Meshcat, `set_scene` sets the camera, and
    `show` moves it there, or wherever there are ``SetTransform`` and ``SetProperty`` as Meshcat has
    them. What else has links and wires overrides the methods that begin with an underscore.
    """

    MODEL = "limb"  # name of the model in Meshcat
    LIGHT = (-6.0, -2.0, 10.0)
    _bodies_beside: Sequence[str] = ()  # names of bodies that are no links

    def __init__(self, parameters: LimbParameters, ghosts: Sequence[Ghost] = (), root: str = ""):
        """
        Args:
            parameters: the limb.
            ghosts: poses to compare the limb's with.
            root: beginning of the paths in Meshcat; empty, or ends with a slash.
        """
        self._parameters, self._ghosts, self._root = parameters, ghosts, root
        self._layout = Layout(parameters)
        self._builder = DiagramBuilder()  # it keeps the plant
        self._plant, _ = self._add_plant(self._builder)
        self._context = self._plant.CreateDefaultContext()
        self._limb = f"{root}visualizer/{self.MODEL}"
        self._pieces: list[tuple[str, SegmentParameters, float]] = []  # bodies and their lengths
        self.wire_paths: list[list[str]] = []
        others: list[str] = []
        limbs = self._limbs()
        for prefix, limb in limbs.items():
            for segment, pieces in zip(limb.segments, Layout(limb).pieces, strict=True):
                self._pieces += [(f"{prefix}{body}", segment, length) for body, length in pieces]
            self.wire_paths += wire_paths(limb, f"{self._limb}/{prefix}", self.MODEL)
            others += [f"{prefix}payload"] * bool(limb.payload)
        names = [name for name, _, _ in self._pieces] + others + [*self._bodies_beside]
        self._bodies = [self._plant.GetBodyByName(name) for name in names]
        # The length of the bars is 3 units.
        self._unit = 0.1 * max(limb.length for limb in limbs.values())
        self._to_camera = seen_from(*self._eye())
        self._facing = RigidTransform(RotationMatrix(self._bar_axes()), np.zeros(3))

    def _limbs(self) -> dict[str, LimbParameters]:
        """Return the limbs, by what the names of their bodies begin with."""
        return {"": self._parameters}

    def _eye(self) -> tuple[float, float]:
        """Return azimuth and elevation of the camera, °."""
        return _IN_PLANE if self._layout.is_planar else _IN_SPACE

    def _bar_axes(self) -> np.ndarray:
        """Return the axes (3, 3) of the bars: in the plane of the bends, or facing the camera."""
        return np.eye(3) if self._layout.is_planar else self._to_camera.T

    def _bar_foot(self) -> float:
        """Return the position of the lower end of the bars, m."""
        return -1.5 * self._unit

    def add_to(self, meshcat: Meshcat, base_pose: RigidTransform | None = None) -> None:
        """Put the limb into a scene, in place of one with the same root.

        Args:
            base_pose: pose of the limb's frame (E1, E2, E3) in the world; the world's origin if
                None.
        """
        self._base_pose = base_pose or RigidTransform()
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
            body_pose: pose of the body that limbs are on, as in `Recording`; where it is by default
                if None.
        """
        poses = self._poses(joint_angles, body_pose)
        for body, pose in zip(self._bodies, poses, strict=True):
            meshcat.SetTransform(f"{self._limb}/{body.name()}", pose, time)
        self._move_scene(meshcat, poses, time)
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

    def _move_scene(self, meshcat: Meshcat, poses: list[RigidTransform], time: float) -> None:
        """Move what is around the bodies, for their poses."""

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
            joint_angles: θ, (n, K), rad; bends of up to 90°, or 60° in space, if None.
            body_pose: pose of the body that limbs are on (3 or 6, K), as far as it is known.

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
        meshcat.SetProperty("/Lights/FillLight/<object>", "position", [*self.LIGHT])

        if joint_angles is None:
            towards = self._layout.bend_direction
            angles = self._largest_bend() * np.linspace(-1.0, 1.0, 5)
            bends = [np.outer(towards == one, angles) for one in range(towards.max() + 1)]
            joint_angles = joint_angles_from_bend_angle(self._parameters, np.hstack(bends))
        limbs = _in_view.setdefault(meshcat, {})
        corners = self._reach(meshcat, joint_angles, body_pose)
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
        order = 0.0
        for name in () if self._layout.is_planar else ("silicone", "joint"):
            for body, _, _ in reversed(self._pieces):
                path, order = f"{self._limb}/{body}/{self.MODEL}/{name}/<object>", order + 1.0
                meshcat.SetProperty(path, "renderOrder", order)
                meshcat.SetProperty(path, "material.side", 0.0)  # front only

    def _largest_bend(self) -> float:
        """Return the largest bend, rad, that the camera shows of a motion that is not known."""
        return np.radians(90.0 if self._layout.is_planar else 60.0)

    def _add_plant(self, builder: DiagramBuilder) -> tuple[MultibodyPlant, SceneGraph]:
        """Add the plant to a diagram."""
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        self._add_model(plant)
        plant.Finalize()
        return plant, scene_graph

    def _add_model(self, plant: MultibodyPlant) -> None:
        """Add the bodies to a plant."""
        add_limb(plant, self._parameters)

    def _ghost_paths(self, ghost: Ghost) -> list[str]:
        """Meshcat paths of a ghost's links, each below that of the link which it hangs on."""
        names = [name for name, _, _ in self._pieces]
        base = f"{self._root}ghosts/{ghost.name}"
        return list(itertools.accumulate(names, "{}/{}".format, initial=base))[1:]

    def _poses(
        self, joint_angles: np.ndarray, body_pose: np.ndarray | None = None
    ) -> list[RigidTransform]:
        """Poses of the bodies in the limb's frame."""
        self._set_positions(joint_angles, body_pose)
        return [self._plant.EvalBodyPoseInWorld(self._context, body) for body in self._bodies]

    def _set_positions(self, joint_angles: np.ndarray, body_pose: np.ndarray | None) -> None:
        """Put the plant into a pose."""
        self._plant.SetPositions(self._context, joint_angles)

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
        """Put a bar for each wire beside the base; its track is duty 1."""
        unit, thin = self._unit, 0.02 * self._unit
        for name, x in zip(self._parameters.wire_names, self._bar_positions(), strict=True):
            path = f"{self._root}duty/{name}"
            meshcat.SetTransform(path, RigidTransform([x, self._bar_foot(), 0.0]))
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
        """Positions of the bars along E1, left of the base, m, with gaps between segments."""
        places = self._bar_steps()
        bracket = (0.6 if self._layout.is_planar else 1.2) * self._pieces[0][1].thickness
        return self._unit * (places - places[-1] - 0.7) - bracket

    def _bar_steps(self) -> np.ndarray:
        """Positions of the bars after each other, in units, with gaps between segments."""
        steps = np.full(len(self._parameters.wires), 0.95)
        steps[[wires.start for wires in self._layout.wires_of]] = 1.25
        return np.cumsum(steps)

    def _reach(
        self, meshcat: Meshcat, joint_angles: np.ndarray, body_pose: np.ndarray | None
    ) -> np.ndarray:
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
