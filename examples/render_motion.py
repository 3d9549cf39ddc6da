"""Render a recording of a limb or robot as a row of moments or as a GIF, without a screen.

    python examples/render_motion.py [RECORDING.csv] [-o PICTURE.png or .gif] [--pace FACTOR]

The colour of a wire is its temperature. Without a recording, a simulation of the crawler is
rendered, whose rear right wire is heated for 8 s.
"""

import argparse
import io
import sys
from pathlib import Path

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from PIL import Image
from pydrake.geometry import (
    Box,
    ClippingRange,
    ColorRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    Rgba,
    Role,
    RoleAssign,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from limb_systems import (
    LimbError,
    LimbModel,
    LimbParameters,
    Recording,
    add_limb,
    simulate,
    wire_color,
)
from limb_systems.files.output import write_atomically
from limb_systems.views.plots import save_figure
from walking import Robot
from walking.robot import add_robot, set_positions

FIELD_OF_VIEW = 0.35  # rad, from top to bottom
FRAMES_PER_SECOND = 10  # of a GIF
COLUMNS = 3  # of pictures of moments
GRID = 0.01  # m, between lines on the ground
DARK_GRID = 0.05  # m, between darker lines
LIGHTS = (  # frames, directions and intensities
    ("camera", [0.2, 0.2, 1.0], 0.9),
    ("world", [-0.3, 0.3, -1.0], 0.4),
)
IN_PLANE, IN_SPACE, BESIDE, OBLIQUE = (  # directions from limbs, and from robots, to the camera
    [0.0, -0.45, 0.9],
    [0.64, -0.64, 0.42],
    [0.0, -1.0, 0.25],
    [0.557, -0.663, 0.5],
)


class Scene:
    """A plant in a diagram, and a camera that renders it on a white background.

    - ``context``: context of the plant, in which to set positions.
    - ``pose``: pose of the camera in the world; z points ahead and y down.
    - ``camera``: size and field of view.
    """

    def __init__(
        self,
        diagram: Diagram,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        center: np.ndarray,
        radius: float,
        to_eye: np.ndarray,
        size: tuple[int, int],
    ):
        """
        Args:
            center, radius: a ball that the picture shows entirely, m.
            to_eye: direction from the center to the camera.
            size: width and height of pictures, px.
        """
        self._plant = plant
        self._scene_graph = scene_graph
        # Add the renderer.
        lights = [
            LightParameter(type="directional", frame=frame, direction=way, intensity=intensity)
            for frame, way, intensity in LIGHTS
        ]
        params = RenderEngineVtkParams(default_clear_color=[1.0, 1.0, 1.0], lights=lights)
        scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(params))
        # Put the camera where it sees the ball.
        self.camera = CameraInfo(*size, FIELD_OF_VIEW)
        ahead = -np.asarray(to_eye) / np.linalg.norm(to_eye)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        axes = np.column_stack([right, np.cross(ahead, right), ahead])
        distance = radius / np.sin(FIELD_OF_VIEW / 2)
        self.pose = RigidTransform(RotationMatrix(axes), center - distance * ahead)
        # Contexts have a copy of the renderer.
        self._root = diagram.CreateDefaultContext()
        self.context = plant.GetMyMutableContextFromRoot(self._root)

    def color_wires(
        self,
        parameters: LimbParameters,
        temperature: np.ndarray,
        instance: ModelInstanceIndex,
        prefix: str = "",
    ) -> None:
        """Give the wires of a limb the colours of their temperatures (W), °C.

        Args:
            instance: model instance of the limb.
            prefix: beginning of the names of its bodies.
        """
        plant = self._plant
        inspector = self._scene_graph.model_inspector()
        context = self._scene_graph.GetMyMutableContextFromRoot(self._root)
        colors = iter(wire_color(parameters, temperature))
        pieces_of = LimbModel.of(parameters).mechanics.pieces
        for segment, pieces in zip(parameters.segments, pieces_of, strict=True):
            bodies = [plant.GetBodyByName(f"{prefix}{body}", instance) for body, _ in pieces]
            frames = [plant.GetBodyFrameIdOrThrow(body.index()) for body in bodies]
            # Replace the colour of each piece of each wire.
            for wire, color in zip(segment.wires, colors, strict=False):
                properties = PerceptionProperties()
                properties.AddProperty("phong", "diffuse", Rgba(*color))
                for frame in frames:
                    for shape in inspector.GetGeometries(frame, Role.kPerception):
                        if inspector.GetName(shape).endswith(f"wire_{wire.name}"):
                            source = plant.get_source_id()
                            self._scene_graph.RemoveRole(context, source, shape, Role.kPerception)
                            self._scene_graph.AssignRole(
                                context, source, shape, properties, RoleAssign.kNew
                            )

    def picture(self) -> np.ndarray:
        """Return the picture of the camera (height, width, 3), 0 to 255."""
        context = self._scene_graph.GetMyContextFromRoot(self._root)
        query = self._scene_graph.get_query_output_port().Eval(context)
        clipping = ClippingRange(0.01, 10.0)  # m
        core = RenderCameraCore("vtk", self.camera, clipping, RigidTransform())
        world = self._scene_graph.world_frame_id()
        image = query.RenderColorImage(ColorRenderCamera(core), world, self.pose)
        return image.data[..., :3].copy()

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Project points (3, K), m, to the picture (2, K), px to the right and down."""
        projected = self.camera.intrinsic_matrix() @ (self.pose.inverse() @ points)
        return projected[:2] / projected[2]


class MotionScene(Scene):
    """The scene of a recording or a gait: a limb, or a robot on the ground."""

    def __init__(self, motion, size: tuple[int, int]):
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        self._motion = motion
        self._robot = motion.robot
        if self._robot is None:
            add_limb(plant, motion.parameters)
            center = np.zeros(3)
            radius = 1.1 * motion.parameters.length
            to_eye = IN_PLANE if motion.model.layout.is_planar else IN_SPACE
        else:
            add_robot(plant, self._robot)
            # Show the robot's whole path and the ground around it.
            path = self._body_positions()
            low = path.min(axis=1)
            high = path.max(axis=1)
            height = max(limb.parameters.length for limb in self._robot.limbs)
            margin = 0.6 * max(self._robot.body.length, self._robot.body.width) + 0.2 * height
            center = [*(low + high)[:2] / 2, 0.45 * height]
            radius = np.linalg.norm(high - low) / 2 + margin
            to_eye = OBLIQUE if self._robot.pose_size == 6 else BESIDE
            add_grid(plant, low - margin, high + margin)
        plant.Finalize()
        super().__init__(builder.Build(), plant, scene_graph, center, radius, to_eye, size)

    def _body_positions(self) -> np.ndarray:
        """Return the positions of the body (3, K), m."""
        pose = self._motion.body_pose
        if len(pose) == 6:
            return pose[:3]
        return np.array([pose[0], 0 * pose[0], pose[1]])

    def at(self, time: float) -> np.ndarray:
        """Return the picture (height, width, 3) at a time, s."""
        # Set the limb's pose and colours.
        motion = self._motion
        plant = self._plant
        num_joints = len(motion.joint_state) // 2
        angles = motion.interpolated(motion.joint_state[:num_joints], time)
        heat = motion.interpolated(motion.wire_temperature, time)
        instance = ModelInstanceIndex(2)
        if self._robot is None:
            plant.SetPositions(self.context, angles)
            self.color_wires(motion.parameters, heat, instance)
            return self.picture()
        # Set the robot's pose and the colours of each limb.
        pose = motion.interpolated(motion.body_pose, time)
        set_positions(plant, self.context, self._robot, pose, angles)
        for limb, wires in zip(self._robot.limbs, self._robot.wires_of, strict=True):
            self.color_wires(limb.parameters, heat[wires], instance, f"{limb.name}_")
        return self.picture()


def add_grid(plant: MultibodyPlant, low: np.ndarray, high: np.ndarray) -> None:
    """Draw lines on the ground between two corners (x, y), m; every fifth line is darker."""
    # Begin and end with dark lines.
    low = np.floor(low / DARK_GRID) * DARK_GRID
    high = np.ceil(high / DARK_GRID) * DARK_GRID
    middle = (low + high) / 2
    span = high - low
    # Draw each line as a thin box.
    for axis in range(2):
        for coordinate in np.arange(low[axis], high[axis] + GRID / 2, GRID):
            is_dark = abs(coordinate / DARK_GRID - round(coordinate / DARK_GRID)) < 1e-6
            shape = np.array([*span[:2], 1e-4])
            shape[axis] = 0.0008 if is_dark else 0.0005
            position = np.array([*middle[:2], -1e-4])
            position[axis] = coordinate
            color = (0.62, 0.65, 0.7, 1.0) if is_dark else (0.84, 0.86, 0.89, 1.0)
            name = f"grid_{axis}_{coordinate:.3f}"
            plant.RegisterVisualGeometry(
                plant.world_body(), RigidTransform(position), Box(*shape), name, color
            )


def heat_scale(parameters: LimbParameters) -> ScalarMappable:
    """Return the colour scale of wire temperature, for a colour bar."""
    values = np.linspace(parameters.ambient_temperature, parameters.temperature_limits.maximum, 100)
    return ScalarMappable(
        Normalize(values[0], values[-1]), ListedColormap(wire_color(parameters, values))
    )


def draw_moments(motion, times: np.ndarray) -> Figure:
    """Draw a motion at some times, s, in rows of pictures."""
    scene = MotionScene(motion, (640, 440))
    rows = -(-len(times) // COLUMNS)
    figure = Figure(figsize=(8.6, 0.2 + 2.0 * rows), layout="constrained")
    axes = figure.subplots(rows, COLUMNS, squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
    # Render each moment.
    for axis, time in zip(axes.flat, times, strict=False):
        axis.imshow(scene.at(time), interpolation="antialiased")
        axis.set_title(f"{time:.1f} s", loc="left", fontsize=10)
    # Add the scale of the colours.
    scale = heat_scale(motion.parameters)
    figure.colorbar(scale, ax=axes, label="wire temperature (°C)", aspect=30, pad=0.01)
    return figure


def animate(motion, path: Path, pace: float = 4.0) -> None:
    """Write a motion as a looping GIF that is faster by the factor ``pace``."""
    # Lay out the picture, the colour bar and the clock.
    scene = MotionScene(motion, (900, 540))
    figure = Figure(figsize=(4.5, 3.2), dpi=100)
    axis = figure.add_axes((0.0, 0.16, 1.0, 0.84))
    axis.set_axis_off()
    bar = figure.add_axes((0.4, 0.13, 0.4, 0.025))
    figure.colorbar(heat_scale(motion.parameters), bar, orientation="horizontal")
    bar.set_xlabel("wire temperature (°C)", fontsize=8)
    bar.tick_params(labelsize=8)
    clock = figure.text(0.02, 0.1, "", fontsize=9)
    image = axis.imshow(scene.at(motion.time[0]), interpolation="antialiased")
    # Render the frames.
    frames = []
    for time in np.arange(motion.time[0], motion.time[-1], pace / FRAMES_PER_SECOND):
        image.set_data(scene.at(time))
        clock.set_text(f"{time - motion.time[0]:.0f} s  ({pace:g} x as fast)")
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=100)
        frames.append(Image.open(picture).convert("RGB"))
    # Use one palette for all frames, so that colours do not flicker.
    palette = frames[0].quantize(128, method=Image.Quantize.MAXCOVERAGE)
    frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    loop = io.BytesIO()
    frames[0].save(
        loop,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=1000 // FRAMES_PER_SECOND,
        loop=0,
    )
    write_atomically(path, loop.getvalue())


def main(options) -> None:
    motion = options.recording or simulate(Robot(), [0.0, 0.3, 0.0, 0.0], 8.0)
    if motion.joint_state is None or motion.wire_temperature is None:
        raise LimbError(
            "This recording has no joint angles or no wire temperatures to render; give a "
            "recording of an emulated limb or of a simulation."
        )
    if options.out.suffix == ".gif":
        animate(motion, options.out, options.pace)
    else:
        save_figure(draw_moments(motion, np.linspace(*motion.time[[0, -1]], 6)), options.out)
    print(f"written     {options.out}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Render a recording.")
    parser.add_argument("recording", nargs="?", type=Recording.load)
    parser.add_argument("-o", "--out", type=Path, default="out/motion.png")
    parser.add_argument("--pace", type=float, default=4.0, help="speed of a GIF over real time")
    try:
        main(parser.parse_args())
    except LimbError as error:
        sys.exit(f"error: {error}")
