"""The limb in Meshcat, by Drake's visualizer, with wires in the colour of their heat, and ghosts.

The view is down on the bending plane: E1 points to the right and E2 up, so that
a positive bend angle bends the limb up, as in a plot, towards its right wire. Limbs that bend
in space are seen from in front of the tip, with E3 up, so that paths of tips are visible.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import (
    Cylinder,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody
from pydrake.perception import PointCloud
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.trajectories import PiecewisePolynomial

from limb_systems.drake_python import weak_method
from limb_systems.files.recording import Recording
from limb_systems.files.signal_table import Planned
from limb_systems.files.trajectory import Trajectory
from limb_systems.kinematics import joint_angles_from_bend_angle, tip_position
from limb_systems.limb import add_limb
from limb_systems.limb_model import LimbModel
from limb_systems.limb_parameters import LimbParameters, SegmentParameters
from limb_systems.views.colors import PLAN_COLOR, REFERENCE_COLOR, ROLLOUT_COLOR

# sRGB, evenly spaced from ambient temperature to T_max: blue, plum, red, orange.
WIRE_COLORS = np.array(
    [[0.30, 0.42, 0.60], [0.50, 0.32, 0.50], [0.86, 0.20, 0.16], [1.00, 0.54, 0.05]]
)
# Directions from limbs in a plane, and in space, to the camera.
PLANAR_VIEW_DIRECTION = (0.0, -0.42, 0.91)
SPATIAL_VIEW_DIRECTION = (0.64, -0.64, 0.42)
PUBLISH_PERIOD = 1 / 32  # s, of `WireColors`
_CYLINDER_ALONG_E1 = RotationMatrix.MakeYRotation(np.pi / 2)  # a cylinder's axis along E1
_FIELD_OF_VIEW = np.radians(25.0)  # from top to bottom; narrow, so that lengths compare
_NUM_CAMERA_POSES = 60  # poses of a motion that the camera must see


def wire_color(parameters: LimbParameters, temperature: ArrayLike) -> np.ndarray:
    """Return the colour of a wire: greyish blue at ambient temperature, orange at T_max.

    Args:
        parameters: limb whose ambient and maximum temperature span the colours;
            beyond them the colour does not change further.
        temperature: °C, any shape.

    Returns:
        (..., 3): red, green and blue (sRGB) in [0, 1], in a new last axis.
    """
    ambient = parameters.ambient_temperature
    maximum = parameters.temperature_limits.maximum
    stops = np.linspace(ambient, maximum, len(WIRE_COLORS))
    values = np.asarray(temperature, float)
    return np.apply_along_axis(lambda channel: np.interp(values, stops, channel), 0, WIRE_COLORS)


def linear_wire_color(parameters: LimbParameters, temperature: np.ndarray) -> np.ndarray:
    """Return `wire_color` as linear RGB (..., 3), which Meshcat's materials use."""
    color = wire_color(parameters, temperature)
    return np.where(color > 0.04045, ((color + 0.055) / 1.055) ** 2.4, color / 12.92)


def wire_paths(limb: LimbParameters, bodies: str, model: str) -> list[list[str]]:
    """Return the Meshcat paths of each wire (W), one on each body of its segment.

    Args:
        limb: description of the limb.
        bodies: beginning of the paths of the limb's bodies.
        model: name of the model that the bodies are of.
    """
    paths = []
    pieces_of = LimbModel.of(limb).mechanics.pieces
    for segment, pieces in zip(limb.segments, pieces_of, strict=True):
        for wire in segment.wires:
            paths.append([f"{bodies}{body}/{model}/wire_{wire.name}" for body, _ in pieces])
    return paths


@dataclasses.dataclass(frozen=True)
class Ghost:
    """The axis of a limb as a line, which shows how the limb should bend.

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
    """Return the sRGB values in [0, 1] of a code such as "#999999"."""
    return tuple(np.frombuffer(bytes.fromhex(code[1:]), np.uint8) / 255)


def joint_angle_trajectory(motion: Recording | Planned) -> PiecewisePolynomial:
    """Return θ over time: cubic between samples where rates are known, else linear.

    Plans that hold their duty between knots, such as gaits, are linear like the body's pose, so
    that feet do not move.
    """
    if isinstance(motion, Planned) and motion.HOLDS_DUTY:
        return PiecewisePolynomial.FirstOrderHold(motion.time, motion.joint_angles)
    if motion.joint_state is None:
        is_present = ~np.isnan(motion.bend_angle).any(axis=0)
        return _bend_angle_trajectory(
            motion.parameters, motion.time[is_present], motion.bend_angle[:, is_present]
        )
    angles, rates = np.split(motion.joint_state, 2)
    return PiecewisePolynomial.CubicHermite(motion.time, angles, rates)


def ghost_of_reference(motion: Recording | Trajectory) -> Ghost:
    """Return the reference of a motion by eqn (11), over the motion's time."""
    return Ghost(
        "reference", _bend_angle_trajectory(motion.parameters, motion.time, motion.reference)
    )


def _bend_angle_trajectory(parameters, time, bend_angle) -> PiecewisePolynomial:
    """Return θ over time for bend angles (F, K), rad, by eqn (11), linear between samples."""
    angles = joint_angles_from_bend_angle(parameters, bend_angle)
    return PiecewisePolynomial.FirstOrderHold(time, angles)


class LimbView:
    """A limb in a Meshcat in 3D, its wires in the colour of their heat, perhaps with ghosts.

    `set_scene` sets the camera, and `show` moves the limb. Views of other systems with links and
    wires override the methods that begin with an underscore.

    - ``wire_paths``: paths of each wire in Meshcat, see `wire_paths`.
    """

    MODEL = "limb"  # name of the model in Meshcat
    LIGHT = (-6.0, -2.0, 10.0)

    def __init__(self, meshcat: Meshcat, parameters: LimbParameters, ghosts: Sequence[Ghost] = ()):
        """
        Args:
            meshcat: scene that the limb is put into.
            parameters: the limb.
            ghosts: poses to compare the limb's with.
        """
        self._meshcat = meshcat
        self._parameters = parameters
        self._ghosts = ghosts
        self._is_planar = LimbModel.of(parameters).layout.is_planar
        self._model = f"visualizer/{self.MODEL}"
        for folder in ("visualizer", "ghosts", "ground"):
            meshcat.SetTransform(folder, self._base_pose())
        # Put the model into the scene. Drake publishes the shapes once; later only poses change.
        builder = DiagramBuilder()
        self._plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        self._add_model(self._plant)
        self._plant.Finalize()
        params = MeshcatVisualizerParams(prefix="visualizer", delete_on_initialization_event=False)
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
        self._diagram = builder.Build()  # it keeps the plant
        self._diagram.ForcedPublish(self._diagram.CreateDefaultContext())
        self._context = self._plant.CreateDefaultContext()
        # Collect the moving parts: the visible bodies, and the links.
        bodies = map(self._plant.get_body, self._plant.GetBodyIndices(ModelInstanceIndex(2)))
        self._bodies = [body for body in bodies if self._plant.GetVisualGeometriesForBody(body)]
        self._links: list[tuple[RigidBody, SegmentParameters, float]] = []  # with their lengths
        self.wire_paths: list[list[str]] = []
        for prefix, limb in self._limbs().items():
            pieces_of = LimbModel.of(limb).mechanics.pieces
            for segment, pieces in zip(limb.segments, pieces_of, strict=True):
                for body, length in pieces:
                    link = self._plant.GetBodyByName(f"{prefix}{body}")
                    self._links.append((link, segment, length))
            self.wire_paths += wire_paths(limb, f"{self._model}/{prefix}", self.MODEL)
        # Add what is drawn through silicone, and the ghosts.
        if not self._is_planar:
            self._order_silicone()
        for level, ghost in enumerate(ghosts):
            self._add_ghost(ghost, level)

    def _base_pose(self) -> RigidTransform:
        """Return the pose of the limb's frame (E1, E2, E3), or of a robot's world, in the scene."""
        return RigidTransform()

    def _limbs(self) -> dict[str, LimbParameters]:
        """Return the limbs, by the prefixes of their bodies' names."""
        return {"": self._parameters}

    def _to_eye(self) -> Sequence[float]:
        """Return the direction to the camera in the world."""
        return PLANAR_VIEW_DIRECTION if self._is_planar else SPATIAL_VIEW_DIRECTION

    def _add_model(self, plant: MultibodyPlant) -> None:
        """Add the bodies and joints to a plant."""
        add_limb(plant, self._parameters)

    def _set_positions(self, joint_angles: np.ndarray, body_pose: np.ndarray | None) -> None:
        """Set the plant's positions to joint angles (n,) and the pose of the body, if any."""
        self._plant.SetPositions(self._context, joint_angles)

    def _add_surroundings(self, low: np.ndarray, high: np.ndarray) -> None:
        """Add the surroundings of bodies that stay between two corners (3,), m."""

    def _order_silicone(self) -> None:
        """Draw links from the tip on: clear silicone then hides parts of the next link in it."""
        order = 0.0
        for name in ("silicone", "joint"):
            for body, _, _ in reversed(self._links):
                order += 1.0
                path = f"{self._model}/{body.name()}/{self.MODEL}/{name}"
                self._meshcat.SetProperty(f"{path}/<object>", "renderOrder", order)
                self._meshcat.SetProperty(f"{path}/<object>", "material.side", 0.0)  # front only

    def _add_ghost(self, ghost: Ghost, level: int) -> None:
        """Put a ghost into the scene: a line along the axis, narrower than the ghosts before it.

        In space it is visible through the silicone, with the path of its tip. In a plane it is
        above the limb, between the wires.
        """
        # In space, draw the path of the tip, too.
        if not self._is_planar:
            trajectory = ghost.joint_angles
            times = np.linspace(trajectory.start_time(), trajectory.end_time(), 999)
            self.add_tip_path(trajectory.vector_values(times), ghost)
        for body, segment, length in self._links:
            path = f"ghosts/{ghost.name}/{body.name()}/line"
            radius = (0.12 - 0.05 * level) * segment.thickness
            height = 0.0
            if self._is_planar:
                height = 0.5 * segment.width + 0.1 * level * segment.thickness
            pose = RigidTransform(_CYLINDER_ALONG_E1, [length / 2, 0.0, height])
            self._meshcat.SetObject(path, Cylinder(radius, length), Rgba(*ghost.color))
            self._meshcat.SetTransform(path, pose)

    def add_tip_path(self, joint_angles: np.ndarray, ghost: Ghost | None = None) -> None:
        """Add a dot at the tip of a limb in space, or of its ghost, for each θ (n, K)."""
        # Make a cloud of points, one for each θ.
        dots = PointCloud(joint_angles.shape[1])
        dots.mutable_xyzs()[:] = tip_position(self._parameters, joint_angles)
        path = f"ghosts/{f'{ghost.name}/' if ghost else ''}tip"
        color = ghost.color if ghost else _rgb(ROLLOUT_COLOR)
        self._meshcat.SetObject(path, dots, 0.013 * self._parameters.length, Rgba(*color))

    def show(
        self, joint_angles: np.ndarray, time: float, body_pose: np.ndarray | None = None
    ) -> None:
        """Move limb and ghosts; a recording by Meshcat shows them at this time, too.

        Args:
            joint_angles: θ (n), rad.
            time: time for the ghosts, s.
            body_pose: pose of the body that limbs are on, as in `Recording`; the default pose if
                None.
        """
        self._set_positions(joint_angles, body_pose)
        for body in self._bodies:
            pose = self._plant.EvalBodyPoseInWorld(self._context, body)
            self._meshcat.SetTransform(f"{self._model}/{body.name()}", pose, time)
        for ghost in self._ghosts:
            self._set_positions(ghost.joint_angles.value(time)[:, 0], body_pose)
            for body, _, _ in self._links:
                pose = self._plant.EvalBodyPoseInWorld(self._context, body)
                self._meshcat.SetTransform(f"ghosts/{ghost.name}/{body.name()}", pose, time)

    def set_scene(self, joint_angles: np.ndarray, body_pose: np.ndarray | None = None) -> None:
        """Set the background, the lights, and a camera that shows a whole motion.

        Args:
            joint_angles: θ, (n, K), rad.
            body_pose: pose of the body that limbs are on (3 or 6, K), as far as it is known.
        """
        # Set the background and the lights.
        for path in (
            "/Grid",
            "/Axes",
            "/Lights/PointLightNegativeX",
            "/Lights/PointLightPositiveX",
        ):
            self._meshcat.SetProperty(path, "visible", False)
        for end in ("top_color", "bottom_color"):
            self._meshcat.SetProperty("/Background/<object>", end, [0.975, 0.98, 0.985])
        self._meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 1.5)
        self._meshcat.SetProperty("/Lights/FillLight/<object>", "intensity", 1.7)
        self._meshcat.SetProperty("/Lights/FillLight/<object>", "position", [*self.LIGHT])

        # Enclose all bodies and ends of links, however they bend, in a box.
        places = []
        frames = np.linspace(0, joint_angles.shape[1] - 1, _NUM_CAMERA_POSES).astype(int)
        for k in np.unique(frames):
            self._set_positions(joint_angles[:, k], None if body_pose is None else body_pose[:, k])
            for body in self._bodies:
                pose = self._plant.EvalBodyPoseInWorld(self._context, body)
                places.append(pose.translation())
            for body, _, length in self._links:
                pose = self._plant.EvalBodyPoseInWorld(self._context, body)
                places.append(pose @ [length, 0.0, 0.0])
        margin = 0.1 * max(limb.length for limb in self._limbs().values())
        low = np.min(places, axis=0) - margin
        high = np.max(places, axis=0) + margin
        self._add_surroundings(low, high)

        # Put the camera where it sees the longest side of the box from any direction.
        center = self._base_pose() @ ((low + high) / 2)
        distance = (high - low).max() / 2 / np.tan(_FIELD_OF_VIEW / 2)
        to_eye = np.array(self._to_eye()) / np.linalg.norm(self._to_eye())
        self._meshcat.SetProperty(
            "/Cameras/default/rotated/<object>", "fov", np.degrees(_FIELD_OF_VIEW)
        )
        self._meshcat.SetCameraPose(center + distance * to_eye, center)


class WireColors(LeafSystem):
    """A block that colours the wires of a limb in the scene of Drake's MeshcatVisualizer.

    - input 0 ``wire_temperature``: T (W), °C
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, parameters: LimbParameters, meshcat: Meshcat, limb: str = "limb"):
        """
        Args:
            parameters: description of the limb.
            meshcat: scene in which `AddDefaultVisualization` shows the limb.
            limb: name of the limb's model instance.
        """
        super().__init__()
        self._parameters = parameters
        self._meshcat = meshcat
        path = limb.replace("::", "/")
        self._paths = wire_paths(parameters, f"illustration/{path}/", path)
        self.DeclareVectorInputPort("wire_temperature", len(parameters.wires))
        self.DeclarePeriodicPublishEvent(PUBLISH_PERIOD, 0.0, weak_method(self._publish))
        self.DeclareForcedPublishEvent(weak_method(self._publish))

    def _publish(self, context) -> None:
        temperature = self.get_input_port().Eval(context)
        colors = linear_wire_color(self._parameters, temperature)
        for paths, color in zip(self._paths, colors, strict=True):
            for path in paths:
                self._meshcat.SetProperty(path, "color", [*color.tolist(), 1.0])
