"""The limb in 3D: live beside a simulation, and as a replay in one HTML file.

Both look down on the bending plane: E1 points to the right and E2 up, so that
a positive bend angle bends the limb up, as in a plot, towards its right wire.
"""

import contextlib
import gc
import html
import logging
import string
from collections.abc import Iterator, Sequence
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

from limb_systems.errors import LimbError
from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory
from limb_systems.model.kinematics import joint_angles_from_bend_angle
from limb_systems.model.manipulator import add_manipulator
from limb_systems.model.ownership import weak_method
from limb_systems.model.parameters import LimbParameters
from limb_systems.output import write_atomically
from limb_systems.views.limb_view import (
    DUTY_COLOR,
    GHOST_OPACITY,
    Ghost,
    add_duty_bars,
    add_ghosts,
    ghost_of_reference,
    ghosts_of_plan,
    joint_angle_course,
    pose_ghost,
    set_scene,
    show_duty,
)

PUBLISH_PERIOD = 1 / 32  # s, of a live view

# sRGB, evenly spaced from ambient temperature to T_max: blue, plum, red, orange.
_WIRE_COLORS = np.array(
    [[0.30, 0.42, 0.60], [0.50, 0.32, 0.50], [0.86, 0.20, 0.16], [1.00, 0.54, 0.05]]
)


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
    stops, values = np.linspace(*span, len(_WIRE_COLORS)), np.asarray(temperature, float)
    return np.stack([np.interp(values, stops, c) for c in _WIRE_COLORS.T], axis=-1)


class LimbVisualizer(Diagram):
    """Shows a limb in Meshcat while it is simulated, wires in the colour of their heat.

    For a limb of n joints in all and W wires:

    - input 0 ``joint_state``: [θ, θ̇] (2n), rad and rad/s
    - input 1 ``wire_temperature``: T (W), °C; or V, where T is not known
    - input 2 ``duty``: D (W), in [0, 1], shown as bars beside the base; may be
      left unconnected

    Connect them to the ports of a `Limb` that have the same names. The view
    is updated at a period of simulated time; let the simulator
    keep to real time with ``set_target_realtime_rate(1.0)``.

    With a plan, translucent ghosts show its reference (grey) and the plan
    itself (blue) as they are at the context's time, time 0 being the plan's
    start; after its end they stay where they are.
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(
        self,
        parameters: LimbParameters,
        meshcat: Meshcat,
        plan: Trajectory | None = None,
        *,
        publish_period: float = PUBLISH_PERIOD,
    ):
        """Args:
            parameters: of the limb.
            meshcat: where it is shown; background, lights and camera are set.
            plan: to show beside it.
            publish_period: from one update of the view to the next, s.

        Raises:
            LimbError: if the plan is for a limb of another shape.
        """
        super().__init__()
        ghosts = ghosts_of_plan(parameters, plan) if plan else []
        builder = DiagramBuilder()
        joint_state, duty = _add_view(builder, parameters, meshcat, ghosts, publish_period)
        colors = builder.AddSystem(_WireColors(parameters, meshcat, publish_period))
        builder.ExportInput(joint_state, "joint_state")
        builder.ExportInput(colors.get_input_port(), "wire_temperature")
        builder.ExportInput(duty, "duty")
        builder.BuildInto(self)
        self.set_name("limb_visualizer")

        bend_angle = np.radians([[-90.0, -45.0, 0.0, 45.0, 90.0]] * len(parameters.segments))
        set_scene(meshcat, parameters, joint_angles_from_bend_angle(parameters, bend_angle))


class _WireColors(LeafSystem):
    """Colours the wires of a limb that Meshcat shows.

    - input 0 ``wire_temperature``: T (W), °C
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters, meshcat: Meshcat, period: float):
        super().__init__()
        self._parameters, self._meshcat = parameters, meshcat
        self.DeclareVectorInputPort("wire_temperature", len(parameters.wires))
        self.DeclarePeriodicPublishEvent(period, 0.0, weak_method(self._publish))
        self.DeclareForcedPublishEvent(weak_method(self._publish))

    def _publish(self, context: Context) -> None:
        colors = wire_color(self._parameters, self.get_input_port().Eval(context))
        for paths, color in zip(_wire_paths(self._parameters), _linear(colors), strict=True):
            for path in paths:
                self._meshcat.SetProperty(path, "color", [*color, 1.0])


class _GhostsAndDuty(LeafSystem):
    """Moves the ghosts and the bars that Meshcat shows.

    - input 0 ``duty``: D (W), in [0, 1]; unconnected, there are no bars
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(
        self, parameters: LimbParameters, meshcat: Meshcat, ghosts: list[Ghost], period: float
    ):
        super().__init__()
        self._parameters, self._meshcat, self._ghosts = parameters, meshcat, ghosts
        add_ghosts(meshcat, parameters, ghosts)
        add_duty_bars(meshcat, parameters)
        self.DeclareVectorInputPort("duty", len(parameters.wires))
        self.DeclarePeriodicPublishEvent(period, 0.0, weak_method(self._publish))
        self.DeclareForcedPublishEvent(weak_method(self._publish))

    def _publish(self, context: Context) -> None:
        time, duty = context.get_time(), self.get_input_port()
        for ghost in self._ghosts:
            pose_ghost(self._meshcat, self._parameters, ghost, time)
        self._meshcat.SetProperty("duty", "visible", duty.HasValue(context))
        if duty.HasValue(context):
            show_duty(self._meshcat, self._parameters, duty.Eval(context), time)


def write_meshcat_replay(
    path: str | Path,
    motion: Recording | Trajectory,
    *,
    plan: Trajectory | None = None,
    title: str = "Soft limb",
    frames_per_second: float = 20.0,
) -> None:
    """Writes a page that replays a motion in 3D, over and over, in any browser.

    The page needs nothing but itself; the browser runs it in real time. Where
    a recording has no joint angles they follow from its bend angle by constant
    curvature, eqn (11). Wires show T, or V where T is not known, and bars
    beside the base the duty. Translucent ghosts show the plan and its
    reference, or if no plan is given the reference that the motion carries.

    Args:
        path: of the HTML file, which is written whole or not at all.
        motion: what to replay.
        plan: to show beside it. A recording's time counts from the plan's
            start, as for `tracking_errors`; after its end the plan stays
            where it is.
        title: of the page.
        frames_per_second: about how many poses to store, Hz; the browser
            interpolates. 20 Hz and five links take 30 kB per second, and nearly as
            much again for two ghosts.

    Raises:
        LimbError: if the motion is a single sample, the rate no rate or the
            plan for a limb of another shape.
    """
    if len(motion.time) < 2:
        raise LimbError("A replay needs two samples at least.")
    if not (np.isfinite(frames_per_second) and frames_per_second > 0):
        raise LimbError(f"frames_per_second is {frames_per_second!r}; it must be positive.")
    start, end = motion.time[[0, -1]]
    ghosts = _ghosts_beside(motion, plan)
    times = np.linspace(start, end, 1 + max(1, round((end - start) * frames_per_second)))
    temperature, measured = motion.wire_temperature, motion.wire_temperature is None
    if temperature is None:
        temperature = motion.measured_temperature
    page, aspect = _animate(
        motion.parameters,
        joint_angle_course(motion).vector_values(times),
        np.array([np.interp(times, motion.time, row) for row in temperature]),
        np.array([np.interp(times, motion.time, row) for row in motion.duty]),
        ghosts,
        (len(times) - 1) / (end - start),
    )
    gc.collect()  # a diagram is a cycle of references, and its Meshcat keeps a port open
    limits = motion.parameters.ambient_temperature, motion.parameters.temperature_limits.maximum
    caption = _CAPTION.substitute(
        title=html.escape(title),
        motion=html.escape(_motion_in_words(motion)),
        ghosts="".join(_GHOST_LEGEND.substitute(name=g.name, rgb=_css(g.color)) for g in ghosts),
        opacity=GHOST_OPACITY,
        signal="measured temperature" if measured else "wire temperature",
        low=f"{limits[0]:g}",
        high=f"{limits[1]:g}",
        colors=", ".join(f"rgb({_css(color)})" for color in _WIRE_COLORS),
        bars=_bars_in_words(motion.parameters),
        duty_rgb=_css(DUTY_COLOR),
        aspect=aspect,
    )
    write_atomically(path, page.replace("</body>", f"{caption}</body>"))


def _ghosts_beside(motion: Recording | Trajectory, plan: Trajectory | None) -> list[Ghost]:
    """What to show beside a motion, over the time since the motion's start."""
    if plan is not None:
        # The time of a recording is that since the start of its plan.
        start = motion.time[0] if isinstance(motion, Recording) else 0.0
        return ghosts_of_plan(motion.parameters, plan, start)
    if motion.reference is None:
        return []
    ghost = ghost_of_reference(motion)
    ghost.course.shiftRight(-motion.time[0])
    return [ghost]


def _motion_in_words(motion: Recording | Trajectory) -> str:
    """What the limb itself shows, and whether it was measured."""
    if isinstance(motion, Trajectory):
        return "planned motion, nothing measured"
    if motion.joint_state is None:
        return f"measured bend angle ({motion.source}), drawn as constant curvature"
    return f"simulated joint angles ({motion.source}), nothing measured"


def _bars_in_words(parameters: LimbParameters) -> str:
    names = ["left", "right"]
    if len(parameters.segments) > 1:
        names = [name.replace("_", " ") for name in parameters.wire_names]
    return ", ".join(names)


def _css(color: Sequence[float]) -> str:
    return " ".join(f"{255 * value:.0f}" for value in color)


def _animate(
    parameters: LimbParameters,
    joint_angles: np.ndarray,
    temperature: np.ndarray,
    duty: np.ndarray,
    ghosts: list[Ghost],
    frames_per_second: float,
) -> tuple[str, float]:
    """Meshcat's page for joint angles (n, F), rad, temperatures, °C, and duty (W, F) of F frames.

    Returns:
        HTML, and what `set_scene` returns.
    """
    with _drake_silenced():
        meshcat = Meshcat(MeshcatParams(host="localhost", port=0, show_stats_plot=False))
    builder = DiagramBuilder()
    for port in _add_view(builder, parameters, meshcat, ghosts, PUBLISH_PERIOD):
        builder.ExportInput(port, port.get_name())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    meshcat.StartRecording(frames_per_second)
    animation = meshcat.get_mutable_recording()
    animation.set_repetitions(1_000_000)
    colors = _linear(wire_color(parameters, temperature))
    times = (np.arange(joint_angles.shape[1]) + 1e-6) / frames_per_second  # Drake rounds down
    for frame, (time, angles) in enumerate(zip(times, joint_angles.T, strict=True)):
        context.SetTime(time)
        state = np.append(angles, np.zeros_like(angles))
        diagram.get_input_port(0).FixValue(context, state)
        diagram.get_input_port(1).FixValue(context, duty[:, frame])
        diagram.ForcedPublish(context)
        for paths, color in zip(_wire_paths(parameters), colors[:, frame], strict=True):
            for path in paths:
                # Meshcat sets "color" on a path; an animation binds to its mesh.
                animation.SetProperty(frame, f"{path}/<object>", "material.color", color)
    meshcat.PublishRecording()
    seen = [ghost.course.vector_values(times) for ghost in ghosts]
    aspect = set_scene(meshcat, parameters, np.hstack([joint_angles, *seen]))
    return meshcat.StaticHtml(), aspect


def _add_view(
    builder: DiagramBuilder,
    parameters: LimbParameters,
    meshcat: Meshcat,
    ghosts: list[Ghost],
    period: float,
) -> tuple[InputPort, InputPort]:
    """Adds what shows a limb's pose, its ghosts and its duty, every period, s.

    Returns:
        The input ports for [θ, θ̇] (2n) and D (W).
    """
    joint_state = _add_limb_view(builder, parameters, meshcat, period)
    others = builder.AddSystem(_GhostsAndDuty(parameters, meshcat, ghosts, period))
    return joint_state, others.get_input_port()


def _add_limb_view(
    builder: DiagramBuilder, parameters: LimbParameters, meshcat: Meshcat, period: float
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
        builder, scene_graph, meshcat, MeshcatVisualizerParams(publish_period=period)
    )
    return poses.get_input_port()


def _wire_paths(parameters: LimbParameters) -> list[list[str]]:
    """For each wire the Meshcat paths of its pieces, one on each link."""
    return [
        [
            f"visualizer/limb/link_{i + 1}/limb/wire_{wire.name}"
            for i in range(joints.start, joints.stop)
        ]
        for joints, segment in zip(parameters.joint_slices, parameters.segments, strict=True)
        for wire in segment.wires
    ]


def _linear(color: np.ndarray) -> np.ndarray:
    """Linear RGB, in which Meshcat's materials reckon, from sRGB."""
    return np.where(color > 0.04045, ((color + 0.055) / 1.055) ** 2.4, color / 12.92)


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


_GHOST_LEGEND = string.Template("""
    <span><i class="ghost" style="--rgb: $rgb"></i>$name</span>""")

# Below the picture. The script runs the clock, makes the limb fit what the caption
# leaves of the window, and turns off the tone mapping that makes Meshcat's oranges
# paler than the legend's.
_CAPTION = string.Template("""
  <meta name="viewport" content="width=device-width, initial-scale=1">
  <style>
    #caption {
      position: fixed; bottom: 0; padding: 0.8rem 1.2rem; pointer-events: none;
      display: flex; flex-wrap: wrap; gap: 0.3rem 2rem;
      font: 0.9rem/1.4 system-ui, sans-serif; color: #333;
    }
    #caption output { min-width: 3.5rem; font-variant-numeric: tabular-nums; }
    #caption i { display: inline-block; width: 2rem; height: 0.7em; margin-right: 0.5em; }
    #caption i.limb { background: #e3e8f0; outline: 1px solid #9aa0a6; }
    #caption i.heat {
      width: 5rem; margin: 0 0.5em; border-radius: 0.35em;
      background: linear-gradient(to right, $colors);
    }
    #caption i.ghost {
      background: linear-gradient(rgb(var(--rgb)), rgb(var(--rgb))) center / 100% 25% no-repeat,
        rgb(var(--rgb) / $opacity);
    }
    #caption i.duty {
      background: linear-gradient(to right, rgb($duty_rgb) 60%, #edeff1 60%);
      outline: 1px solid #73787f;
    }
  </style>
  <div id="caption">
    <b>$title</b>
    <output></output>
    <span><i class="limb"></i>$motion</span>$ghosts
    <span>$signal: $low °C<i class="heat"></i>$high °C</span>
    <span>upper wire: right, lower wire: left</span>
    <span><i class="duty"></i>duty from 0 to 1: $bars</span>
  </div>
  <script>
    viewer.renderer.toneMapping = MeshCat.THREE.NoToneMapping;
    document.title = document.querySelector("#caption b").textContent;
    (function tick() {
      const width = window.innerWidth, height = window.innerHeight;
      const below = document.querySelector("#caption").offsetHeight;
      viewer.camera.zoom = Math.min(1 - below / height, viewer.camera.aspect / $aspect);
      viewer.camera.setViewOffset(width, height, 0, below / 2, width, height);
      document.querySelector("#caption output").value = viewer.animator.time.toFixed(1) + " s";
      requestAnimationFrame(tick);
    })();
  </script>
""")
