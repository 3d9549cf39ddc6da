"""The limb in 3D, described once: its links, wires, ghosts and bars of duty, and the camera.

The view is down on the bending plane: E1 points to the right and E2 up, so that
a positive bend angle bends the limb up, as in a plot, towards its right wire.
"""

import dataclasses
import itertools
import weakref

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Box, Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from pydrake.trajectories import PiecewisePolynomial

from limb_systems.errors import LimbError
from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory
from limb_systems.model.kinematics import joint_angles_from_bend_angle
from limb_systems.model.layout import Layout
from limb_systems.model.manipulator import add_manipulator
from limb_systems.model.parameters import LimbParameters
from limb_systems.views.colors import PLAN_COLOR, REFERENCE_COLOR

GHOST_OPACITY = 0.5
DUTY_COLOR = (0.16, 0.18, 0.22)  # sRGB
# sRGB, evenly spaced from ambient temperature to T_max: blue, plum, red, orange.
WIRE_COLORS = np.array(
    [[0.30, 0.42, 0.60], [0.50, 0.32, 0.50], [0.86, 0.20, 0.16], [1.00, 0.54, 0.05]]
)
_TRACK_COLOR, _OUTLINE_COLOR = (0.93, 0.94, 0.95), (0.45, 0.47, 0.5)
_ELEVATION = np.radians(65.0)  # of the camera above the bending plane
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
        code = {"reference": REFERENCE_COLOR, "plan": PLAN_COLOR}[self.name]
        return tuple(value / 255 for value in bytes.fromhex(code[1:]))


def joint_angle_trajectory(motion: Recording | Trajectory) -> PiecewisePolynomial:
    """θ over time: cubic between samples where rates are known, else linear."""
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
    """θ over time for bend angles (S, K), rad, by eqn (11), linear between samples."""
    angles = joint_angles_from_bend_angle(parameters, bend_angle)
    return PiecewisePolynomial.FirstOrderHold(time, angles)


def _shape_in_words(parameters: LimbParameters) -> str:
    return " and ".join(
        f"{s.links} links, {1e3 * s.length:g} mm x {1e3 * s.thickness:g} mm x {1e3 * s.width:g} mm"
        for s in parameters.segments
    )


class LimbView:
    """A limb in 3D, its wires in the colour of their heat, with ghosts and bars of duty.

    `add_to` puts it into a Meshcat, and `show` moves it there, or wherever there are
    ``SetTransform`` and ``SetProperty`` as Meshcat has them.
    """

    def __init__(self, parameters: LimbParameters, ghosts: list[Ghost], root: str = ""):
        """
        Args:
            ghosts: poses to compare the limb's with.
            root: beginning of the limb's paths in Meshcat; empty, or ends with a slash.
        """
        self._parameters, self._ghosts, self._root = parameters, ghosts, root
        self._segments = [s for s in parameters.segments for _ in range(s.links)]
        self._lengths = np.array([s.length / s.links for s in self._segments])
        self._unit = 0.1 * sum(segment.length for segment in parameters.segments)  # of the bars
        links = f"{root}visualizer/limb/link"
        self._link_paths = [f"{links}_{i + 1}" for i in range(len(self._segments))]
        self.wire_paths = [
            [f"{links}_{i + 1}/limb/wire_{wire.name}" for i in range(joints.start, joints.stop)]
            for joints, segment in zip(
                Layout(parameters).joints_of, parameters.segments, strict=True
            )
            for wire in segment.wires
        ]  # of each wire's pieces, one on each link

    def add_to(self, meshcat: Meshcat, base_pose: RigidTransform | None = None) -> None:
        """Puts the limb into a scene, in place of one with the same root.

        Args:
            base_pose: pose of the limb's frame (E1, E2, E3) in the world; its origin if None.
        """
        for folder in ("visualizer", "ghosts", "duty"):
            meshcat.Delete(f"{self._root}{folder}")
            meshcat.SetTransform(f"{self._root}{folder}", base_pose or RigidTransform())
        self._add_limb(meshcat)
        for level, ghost in enumerate(self._ghosts):
            self._add_ghost(meshcat, ghost, level)
        self._add_bars(meshcat)

    def show(
        self, meshcat: Meshcat, joint_angles: np.ndarray, duty: np.ndarray | None, time: float
    ) -> None:
        """Moves limb, ghosts and bars; a recording by Meshcat shows them at this time, too.

        Args:
            joint_angles: θ (n), rad.
            duty: D (W); the bars stay as they are if None.
            time: time for the ghosts, s.
        """
        directions = np.cumsum(joint_angles)
        steps = self._lengths * np.array([np.cos(directions), np.sin(directions)])
        origins = np.cumsum(steps, axis=1) - steps
        for path, direction, origin in zip(self._link_paths, directions, origins.T, strict=True):
            pose = RigidTransform(RotationMatrix.MakeZRotation(direction), [*origin, 0.0])
            meshcat.SetTransform(path, pose, time)
        for ghost in self._ghosts:
            origin = 0.0
            angles = ghost.joint_angles.value(time)[:, 0]
            for path, angle, length in zip(
                self._ghost_paths(ghost), angles, self._lengths, strict=True
            ):
                pose = RigidTransform(RotationMatrix.MakeZRotation(angle), [origin, 0.0, 0.0])
                meshcat.SetTransform(path, pose, time)
                origin = length
        if duty is not None:
            for name, value in zip(self._parameters.wire_names, duty, strict=True):
                path = f"{self._root}duty/{name}/fill"
                meshcat.SetProperty(path, "scale", [1.0, float(value), 1.0], time)

    def colors(self, temperature: np.ndarray) -> np.ndarray:
        """Linear RGB of the wires, which Meshcat's materials use.

        Args:
            temperature: °C (W, ...).

        Returns:
            (W, ..., 3)
        """
        color = wire_color(self._parameters, temperature)
        return np.where(color > 0.04045, ((color + 0.055) / 1.055) ** 2.4, color / 12.92)

    def show_heat(self, meshcat: Meshcat, temperature: np.ndarray) -> None:
        """Colours the wires by their temperatures (W), °C."""
        for paths, color in zip(self.wire_paths, self.colors(temperature), strict=True):
            for path in paths:
                meshcat.SetProperty(path, "color", [*color.tolist(), 1.0])

    def set_scene(
        self,
        meshcat: Meshcat,
        joint_angles: np.ndarray | None = None,
        base_pose: RigidTransform | None = None,
    ) -> float:
        """Sets the background, the lights, and a camera that shows a whole motion and the bars.

        The camera still shows what it was set to show of limbs with other roots.

        Args:
            joint_angles: θ, (n, K), rad; bends of up to 90° if None.
            base_pose: pose that `add_to` took.

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
        meshcat.SetProperty("/Lights/FillLight/<object>", "position", [-6.0, -2.0, 10.0])

        if joint_angles is None:
            bends = np.radians([[-90.0, -45.0, 0.0, 45.0, 90.0]] * len(self._parameters.segments))
            joint_angles = joint_angles_from_bend_angle(self._parameters, bends)
        limbs = _in_view.setdefault(meshcat, {})
        limbs[self._root] = (base_pose or RigidTransform()) @ self._reach(joint_angles)
        corners = np.hstack(list(limbs.values()))
        target = (corners.min(axis=1) + corners.max(axis=1)) / 2
        sine, cosine = np.sin(_ELEVATION), np.cos(_ELEVATION)
        to_camera = np.array([[1, 0, 0], [0, sine, cosine], [0, -cosine, sine]])
        right, up, near = to_camera @ (corners - target[:, np.newaxis])
        slope = np.tan(_FIELD_OF_VIEW / 2)
        distance = (np.abs(up) / slope + near).max()
        camera = "/Cameras/default/rotated/<object>"
        meshcat.SetProperty(camera, "fov", np.degrees(_FIELD_OF_VIEW))
        meshcat.SetProperty(camera, "near", 0.1 * distance)
        meshcat.SetProperty(camera, "far", 10.0 * distance)
        meshcat.SetCameraPose(target + distance * to_camera[2], target)
        return (np.abs(right) / (distance - near)).max() / slope

    def _add_limb(self, meshcat: Meshcat) -> None:
        """Puts the bodies of the limb's URDF into a scene; once, as only their poses change."""
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        add_manipulator(plant, self._parameters)
        plant.Finalize()
        params = MeshcatVisualizerParams(
            prefix=f"{self._root}visualizer", delete_on_initialization_event=False
        )
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
        diagram = builder.Build()
        diagram.ForcedPublish(diagram.CreateDefaultContext())

    def _ghost_paths(self, ghost: Ghost) -> list[str]:
        """Meshcat paths of a ghost's links, each below that of the link which it hangs on."""
        names = [f"link_{number}" for number in range(1, len(self._segments) + 1)]
        base = f"{self._root}ghosts/{ghost.name}"
        return list(itertools.accumulate(names, "{}/{}".format, initial=base))[1:]

    def _add_ghost(self, meshcat: Meshcat, ghost: Ghost, level: int) -> None:
        """Puts a ghost into the scene.

        It is a flat strip just below the limb's top and narrower than the limb.
        Where both coincide the limb hides it, so that nothing flickers; where they
        differ it is visible beside the limb. Its centre line is always visible: it
        runs above the limb and between the wires. The line of the next ghost is above
        that of the previous one, and narrower.
        """
        for segment, path in zip(self._segments, self._ghost_paths(ghost), strict=True):
            length = segment.length / segment.links
            thickness, width = segment.thickness, segment.width
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
        """Puts a bar for each wire beside the base, in a track that is as long as duty 1."""
        unit, thin = self._unit, 0.02 * self._unit
        for name, x in zip(self._parameters.wire_names, self._bar_positions(), strict=True):
            path = f"{self._root}duty/{name}"
            meshcat.SetTransform(path, RigidTransform([x, -1.5 * unit, 0.0]))
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
        """Positions of the bars along E1, m: left of the base, with gaps between segments."""
        steps = np.full(len(self._parameters.wires), 0.95)
        steps[[wires.start for wires in Layout(self._parameters).wires_of]] = 1.25
        places = np.cumsum(steps)
        return self._unit * (places - places[-1] - 0.7) - 0.6 * self._segments[0].thickness

    def _reach(self, joint_angles: np.ndarray) -> np.ndarray:
        """The corners (3, 8) of a box that limb and bars stay in, with a margin, m."""
        directions = np.cumsum(joint_angles, axis=0)
        steps = self._lengths[:, np.newaxis] * np.array([np.cos(directions), np.sin(directions)])
        ends = np.cumsum(steps, axis=1)
        margin, unit = 0.15 * self._lengths.sum(), self._unit
        low = np.minimum(ends.min(axis=(1, 2)) - margin, -1.8 * unit)
        high = np.maximum(ends.max(axis=(1, 2)) + margin, 1.8 * unit)
        half_width = max(segment.width for segment in self._segments) / 2
        left = min(low[0], self._bar_positions()[0] - 0.6 * unit)
        ranges = [(left, high[0]), (low[1], high[1]), (-half_width, half_width)]
        return np.array(list(itertools.product(*ranges))).T
