"""The limb in 3D: live beside a simulation, and as a replay in one HTML file.

Both look down on the bending plane: E1 points to the right and E2 up, so that
a positive bend angle bends the limb up, as in a plot, towards its right wire.
"""

import contextlib
import gc
import html
import itertools
import logging
import string
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import (
    Meshcat,
    MeshcatParams,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    SceneGraph,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, InputPort, LeafSystem
from pydrake.systems.rendering import MultibodyPositionToGeometryPose
from pydrake.trajectories import PiecewisePolynomial

from limb_systems.errors import LimbError
from limb_systems.files import write_atomically
from limb_systems.kinematics import joint_angles_from_bend_angle
from limb_systems.manipulator import add_manipulator
from limb_systems.ownership import weak_method
from limb_systems.parameters import LimbParameters
from limb_systems.recording import Recording
from limb_systems.trajectory import Trajectory

PUBLISH_PERIOD = 1 / 32  # s, of a live view

# sRGB, evenly spaced from ambient temperature to T_max: blue, plum, red, orange.
_WIRE_COLORS = np.array(
    [[0.30, 0.42, 0.60], [0.50, 0.32, 0.50], [0.86, 0.20, 0.16], [1.00, 0.54, 0.05]]
)
_ELEVATION = np.radians(65.0)  # of the camera above the bending plane
_FIELD_OF_VIEW = np.radians(25.0)  # from top to bottom; narrow, so that lengths compare


def wire_color(parameters: LimbParameters, temperature: ArrayLike) -> np.ndarray:
    """The colour of a wire: greyish blue at ambient temperature, orange at T_max.

    Args:
        parameters: whose ambient and maximum temperature span the colours;
            beyond them the colour stays as it is there.
        temperature: °C, any shape.

    Returns:
        (..., 3): red, green and blue (sRGB) in [0, 1], in a new last axis.
    """
    span = parameters.ambient_temperature, parameters.temperature_limits.maximum
    stops = np.linspace(*span, len(_WIRE_COLORS))
    return np.stack([np.interp(temperature, stops, c) for c in _WIRE_COLORS.T], axis=-1)


class LimbVisualizer(Diagram):
    """Shows a limb in Meshcat while it is simulated, wires in the colour of their heat.

    For a limb of n joints in all and W wires:

    - input 0 ``joint_state``: [θ, θ̇] (2n), rad and rad/s
    - input 1 ``wire_temperature``: T (W), °C; or V, where T is not known

    Connect them to the ports of a `Limb` that have the same names. The view
    is updated every `PUBLISH_PERIOD` of simulated time; let the simulator
    keep to real time with ``set_target_realtime_rate(1.0)``.
    """

    __slots__ = ()  # see limb_systems.ownership

    def __init__(self, parameters: LimbParameters, meshcat: Meshcat):
        """Args:
        parameters: of the limb.
        meshcat: where it is shown; background, lights and camera are set.
        """
        super().__init__()
        builder = DiagramBuilder()
        joint_state = _add_limb_view(builder, parameters, meshcat)
        colors = builder.AddSystem(_WireColors(parameters, meshcat))
        builder.ExportInput(joint_state, "joint_state")
        builder.ExportInput(colors.get_input_port(), "wire_temperature")
        builder.BuildInto(self)
        self.set_name("limb_visualizer")

        bend_angle = np.radians([[-90.0, -45.0, 0.0, 45.0, 90.0]] * len(parameters.segments))
        _set_scene(meshcat, parameters, joint_angles_from_bend_angle(parameters, bend_angle))


class _WireColors(LeafSystem):
    """Colours the wires of a limb that Meshcat shows.

    - input 0 ``wire_temperature``: T (W), °C
    """

    __slots__ = ()  # see limb_systems.ownership

    def __init__(self, parameters: LimbParameters, meshcat: Meshcat):
        super().__init__()
        self._parameters, self._meshcat = parameters, meshcat
        self.DeclareVectorInputPort("wire_temperature", len(parameters.wires))
        self.DeclarePeriodicPublishEvent(PUBLISH_PERIOD, 0.0, weak_method(self._publish))
        self.DeclareForcedPublishEvent(weak_method(self._publish))

    def _publish(self, context: Context) -> None:
        colors = wire_color(self._parameters, self.get_input_port().Eval(context))
        for paths, color in zip(_wire_paths(self._parameters), _linear(colors), strict=True):
            for path in paths:
                self._meshcat.SetProperty(path, "color", [*color, 1.0])


def write_meshcat_replay(
    path: str | Path,
    motion: Recording | Trajectory,
    *,
    title: str = "Soft limb",
    frames_per_second: float = 20.0,
) -> None:
    """Writes a page that replays a motion in 3D, over and over, in any browser.

    The page needs nothing but itself; the browser runs it in real time. Where
    a recording has no joint angles they follow from its bend angle by constant
    curvature, eqn (11). Wires show T, or V where T is not known.

    Args:
        path: of the HTML file, which is written whole or not at all.
        motion: what to replay.
        title: of the page.
        frames_per_second: about how many poses to store, Hz; the browser
            interpolates. 20 Hz and five links take 27 kB per second.

    Raises:
        LimbError: if the motion is a single sample or the rate no rate.
    """
    if len(motion.time) < 2:
        raise LimbError("A replay needs two samples at least.")
    if not (np.isfinite(frames_per_second) and frames_per_second > 0):
        raise LimbError(f"frames_per_second is {frames_per_second!r}; it must be positive.")
    start, end = motion.time[[0, -1]]
    times = np.linspace(start, end, 1 + max(1, round((end - start) * frames_per_second)))
    measured = motion.wire_temperature is None
    temperature = motion.measured_temperature if measured else motion.wire_temperature
    page, aspect = _animate(
        motion.parameters,
        _joint_angle_course(motion).vector_values(times),
        np.array([np.interp(times, motion.time, row) for row in temperature]),
        (len(times) - 1) / (end - start),
    )
    gc.collect()  # a diagram is a cycle of references, and its Meshcat keeps a port open
    limits = motion.parameters.ambient_temperature, motion.parameters.temperature_limits.maximum
    caption = _CAPTION.substitute(
        title=html.escape(title),
        signal="measured temperature" if measured else "wire temperature",
        low=f"{limits[0]:g}",
        high=f"{limits[1]:g}",
        colors=", ".join(f"rgb({r} {g} {b})" for r, g, b in np.rint(255 * _WIRE_COLORS)),
        aspect=aspect,
    )
    write_atomically(path, page.replace("</body>", f"{caption}</body>"))


def _joint_angle_course(motion: Recording | Trajectory) -> PiecewisePolynomial:
    """θ over time: cubic between samples where rates are known, else linear."""
    if motion.joint_state is None:
        angles = joint_angles_from_bend_angle(motion.parameters, motion.bend_angle)
        return PiecewisePolynomial.FirstOrderHold(motion.time, angles)
    angles, rates = np.split(motion.joint_state, 2)
    return PiecewisePolynomial.CubicHermite(motion.time, angles, rates)


def _animate(
    parameters: LimbParameters,
    joint_angles: np.ndarray,
    temperature: np.ndarray,
    frames_per_second: float,
) -> tuple[str, float]:
    """Meshcat's page for the joint angles (n, F), rad, and temperatures (W, F), °C, of F frames.

    Returns:
        HTML, and what `_set_scene` returns.
    """
    with _drake_silenced():
        meshcat = Meshcat(MeshcatParams(host="localhost", port=0, show_stats_plot=False))
    builder = DiagramBuilder()
    builder.ExportInput(_add_limb_view(builder, parameters, meshcat), "joint_state")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    meshcat.StartRecording(frames_per_second)
    animation = meshcat.get_mutable_recording()
    animation.set_repetitions(1_000_000)
    colors = _linear(wire_color(parameters, temperature))
    for frame, angles in enumerate(joint_angles.T):
        context.SetTime((frame + 0.5) / frames_per_second)  # Drake rounds down to a frame
        diagram.get_input_port().FixValue(context, np.append(angles, np.zeros_like(angles)))
        diagram.ForcedPublish(context)
        for paths, color in zip(_wire_paths(parameters), colors[:, frame], strict=True):
            for path in paths:
                # Meshcat sets "color" on a path; an animation binds to its mesh.
                animation.SetProperty(frame, f"{path}/<object>", "material.color", color)
    meshcat.PublishRecording()
    aspect = _set_scene(meshcat, parameters, joint_angles)
    return meshcat.StaticHtml(), aspect


def _add_limb_view(
    builder: DiagramBuilder, parameters: LimbParameters, meshcat: Meshcat
) -> InputPort:
    """Adds what shows a limb's pose, and returns its input port, [θ, θ̇] (2n)."""
    scene_graph = builder.AddSystem(SceneGraph())
    plant = MultibodyPlant(time_step=0.0)
    source = plant.RegisterAsSourceForSceneGraph(scene_graph)
    add_manipulator(plant, parameters)
    plant.Finalize()
    poses = builder.AddSystem(MultibodyPositionToGeometryPose(plant, input_multibody_state=True))
    builder.Connect(poses.get_output_port(), scene_graph.get_source_pose_port(source))
    MeshcatVisualizer.AddToBuilder(
        builder, scene_graph, meshcat, MeshcatVisualizerParams(publish_period=PUBLISH_PERIOD)
    )
    return poses.get_input_port()


def _wire_paths(parameters: LimbParameters) -> list[list[str]]:
    """For each wire the Meshcat paths of its pieces, one on each link."""
    return [
        [f"visualizer/limb/link_{i + 1}/limb/wire_{side}" for i in range(joints.start, joints.stop)]
        for joints in parameters.joint_slices
        for side in ("left", "right")
    ]


def _linear(color: np.ndarray) -> np.ndarray:
    """Linear RGB, in which Meshcat's materials reckon, from sRGB."""
    return np.where(color > 0.04045, ((color + 0.055) / 1.055) ** 2.4, color / 12.92)


def _set_scene(meshcat: Meshcat, parameters: LimbParameters, joint_angles: np.ndarray) -> float:
    """Sets the background, the lights, and a camera that sees all of a motion.

    Args:
        joint_angles: θ, (n, K), rad.

    Returns:
        Width by height of the narrowest window that shows all of it.
    """
    for path in ("/Grid", "/Axes", "/Lights/PointLightNegativeX", "/Lights/PointLightPositiveX"):
        meshcat.SetProperty(path, "visible", False)
    for end in ("top_color", "bottom_color"):
        meshcat.SetProperty("/Background/<object>", end, [0.975, 0.98, 0.985])
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 1.5)
    meshcat.SetProperty("/Lights/FillLight/<object>", "intensity", 1.7)
    meshcat.SetProperty("/Lights/FillLight/<object>", "position", [-6.0, -2.0, 10.0])

    corners = _reach(parameters, joint_angles)
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


def _reach(parameters: LimbParameters, joint_angles: np.ndarray) -> np.ndarray:
    """The corners (3, 8) of a box that the limb stays in, with a margin, m."""
    segments = parameters.segments
    lengths = np.repeat([s.length / s.links for s in segments], [s.links for s in segments])
    directions = np.cumsum(joint_angles, axis=0)
    steps = lengths[:, np.newaxis] * np.array([np.cos(directions), np.sin(directions)])
    ends = np.cumsum(steps, axis=1)
    margin = 0.15 * lengths.sum()
    low = np.minimum(ends.min(axis=(1, 2)), 0.0) - margin
    high = np.maximum(ends.max(axis=(1, 2)), 0.0) + margin
    half_width = max(s.width for s in segments) / 2
    ranges = [(low[0], high[0]), (low[1], high[1]), (-half_width, half_width)]
    return np.array(list(itertools.product(*ranges))).T


@contextlib.contextmanager
def _drake_silenced() -> Iterator[None]:
    """Keeps Drake from announcing a server that is not there to be visited."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(level)


# Below the picture. The script runs the clock, makes the limb fit narrow windows
# and turns off the tone mapping that makes Meshcat's oranges paler than the legend's.
_CAPTION = string.Template("""
  <meta name="viewport" content="width=device-width, initial-scale=1">
  <style>
    #caption {
      position: fixed; bottom: 0; padding: 0.8rem 1.2rem; pointer-events: none;
      display: flex; flex-wrap: wrap; gap: 0.3rem 2rem;
      font: 0.9rem/1.4 system-ui, sans-serif; color: #333;
    }
    #caption span { white-space: nowrap; }
    #caption output { min-width: 3.5rem; font-variant-numeric: tabular-nums; }
    #caption i {
      display: inline-block; width: 5rem; height: 0.7em; margin: 0 0.5em; border-radius: 0.35em;
      background: linear-gradient(to right, $colors);
    }
  </style>
  <div id="caption">
    <b>$title</b>
    <output></output>
    <span>$signal: $low °C<i></i>$high °C</span>
    <span>upper wire: right, lower wire: left</span>
  </div>
  <script>
    viewer.renderer.toneMapping = MeshCat.THREE.NoToneMapping;
    document.title = document.querySelector("#caption b").textContent;
    (function tick() {
      viewer.camera.zoom = Math.min(1, viewer.camera.aspect / $aspect);
      document.querySelector("#caption output").value = viewer.animator.time.toFixed(1) + " s";
      requestAnimationFrame(tick);
    })();
  </script>
""")
