"""The limb in 3D, live during a simulation.

The view is down on the bending plane: E1 points to the right and E2 up, so that
a positive bend angle bends the limb up, as in a plot, towards its right wire.
"""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, InputPort, LeafSystem
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from limb_systems.files.trajectory import Trajectory
from limb_systems.model.kinematics import joint_angles_from_bend_angle
from limb_systems.model.manipulator import add_manipulator
from limb_systems.model.ownership import weak_method
from limb_systems.model.parameters import LimbParameters
from limb_systems.views.limb_view import (
    Ghost,
    add_duty_bars,
    add_ghosts,
    ghosts_of_plan,
    pose_ghost,
    set_scene,
    show_duty,
)

PUBLISH_PERIOD = 1 / 32  # s, of a live view

# sRGB, evenly spaced from ambient temperature to T_max: blue, plum, red, orange.
WIRE_COLORS = np.array(
    [[0.30, 0.42, 0.60], [0.50, 0.32, 0.50], [0.86, 0.20, 0.16], [1.00, 0.54, 0.05]]
)


def wire_color(parameters: LimbParameters, temperature: ArrayLike) -> np.ndarray:
    """The colour of a wire: greyish blue at ambient temperature, orange at T_max.

    Args:
        parameters: whose ambient and maximum temperature span the colours;
            beyond them the colour does not change further.
        temperature: °C, any shape.

    Returns:
        (..., 3): red, green and blue (sRGB) in [0, 1], in a new last axis.
    """
    span = parameters.ambient_temperature, parameters.temperature_limits.maximum
    stops, values = np.linspace(*span, len(WIRE_COLORS)), np.asarray(temperature, float)
    return np.stack([np.interp(values, stops, c) for c in WIRE_COLORS.T], axis=-1)


class LimbVisualizer(Diagram):
    """Shows a limb in Meshcat while it is simulated, wires in the colour of their heat.

    For a limb of n joints in all and W wires:

    - input 0 ``joint_state``: [θ, θ̇] (2n), rad and rad/s
    - input 1 ``wire_temperature``: T (W), °C; or V, where T is not known
    - input 2 ``duty``: D (W), in [0, 1], shown as bars beside the base; may be
      left unconnected

    Connect them to the ports of a `Limb` with the same names. The view is
    updated periodically in simulated time; to watch in real time, call the
    simulator's ``set_target_realtime_rate(1.0)``.

    With a plan, translucent ghosts show its reference (grey) and the plan
    itself (blue) as they are at the context's time, time 0 being the plan's
    start; after its end they stay in their last pose.

    Several limbs share a Meshcat, or a diagram, if each of their views has a
    different ``prefix``; ``base_pose`` places them beside each other.
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(
        self,
        parameters: LimbParameters,
        meshcat: Meshcat,
        plan: Trajectory | None = None,
        *,
        prefix: str = "",
        base_pose: RigidTransform | None = None,
        publish_period: float = PUBLISH_PERIOD,
    ):
        """Args:
            parameters: of the limb.
            meshcat: where it is shown; background, lights and camera are set.
            plan: to show as a ghost, with its reference.
            prefix: of the limb's paths in Meshcat, ``visualizer``, ``ghosts`` and
                ``duty``, and of the system's name.
            base_pose: of the limb's frame (E1, E2, E3) in Meshcat's world; there
                if None.
            publish_period: from one update of the view to the next, s.

        Raises:
            LimbError: if the plan is for a limb of another shape.
        """
        super().__init__()
        ghosts = ghosts_of_plan(parameters, plan) if plan else []
        builder = DiagramBuilder()
        root, base_pose = f"{prefix}/" if prefix else "", base_pose or RigidTransform()
        joint_state, duty = add_view(builder, meshcat, root, parameters, ghosts, publish_period)
        colors = builder.AddSystem(_WireColors(meshcat, root, parameters, publish_period))
        builder.ExportInput(joint_state, "joint_state")
        builder.ExportInput(colors.get_input_port(), "wire_temperature")
        builder.ExportInput(duty, "duty")
        builder.BuildInto(self)
        self.set_name(f"{prefix or 'limb'}_visualizer")

        for folder in ("visualizer", "ghosts", "duty"):
            meshcat.SetTransform(f"{root}{folder}", base_pose)
        bend_angle = np.radians([[-90.0, -45.0, 0.0, 45.0, 90.0]] * len(parameters.segments))
        joint_angles = joint_angles_from_bend_angle(parameters, bend_angle)
        set_scene(meshcat, root, parameters, joint_angles, base_pose)


class _WireColors(LeafSystem):
    """Colours the wires of a limb that Meshcat shows.

    - input 0 ``wire_temperature``: T (W), °C
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, meshcat: Meshcat, root: str, parameters: LimbParameters, period: float):
        super().__init__()
        self._meshcat, self._parameters = meshcat, parameters
        self._paths = wire_paths(root, parameters)
        self.DeclareVectorInputPort("wire_temperature", len(parameters.wires))
        self.DeclarePeriodicPublishEvent(period, 0.0, weak_method(self._publish))
        self.DeclareForcedPublishEvent(weak_method(self._publish))

    def _publish(self, context: Context) -> None:
        colors = wire_color(self._parameters, self.get_input_port().Eval(context))
        for paths, color in zip(self._paths, linear(colors), strict=True):
            for path in paths:
                self._meshcat.SetProperty(path, "color", [*color, 1.0])


class _GhostsAndDuty(LeafSystem):
    """Moves the ghosts and the bars that Meshcat shows.

    - input 0 ``duty``: D (W), in [0, 1]; unconnected, there are no bars
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(
        self,
        meshcat: Meshcat,
        root: str,
        parameters: LimbParameters,
        ghosts: list[Ghost],
        period: float,
    ):
        super().__init__()
        self._meshcat, self._root = meshcat, root
        self._parameters, self._ghosts = parameters, ghosts
        add_ghosts(meshcat, root, parameters, ghosts)
        add_duty_bars(meshcat, root, parameters)
        self.DeclareVectorInputPort("duty", len(parameters.wires))
        self.DeclarePeriodicPublishEvent(period, 0.0, weak_method(self._publish))
        self.DeclareForcedPublishEvent(weak_method(self._publish))

    def _publish(self, context: Context) -> None:
        time, duty = context.get_time(), self.get_input_port()
        for ghost in self._ghosts:
            pose_ghost(self._meshcat, self._root, self._parameters, ghost, time)
        self._meshcat.SetProperty(f"{self._root}duty", "visible", duty.HasValue(context))
        if duty.HasValue(context):
            show_duty(self._meshcat, self._root, self._parameters, duty.Eval(context), time)


def add_view(
    builder: DiagramBuilder,
    meshcat: Meshcat,
    root: str,
    parameters: LimbParameters,
    ghosts: list[Ghost],
    period: float,
) -> tuple[InputPort, InputPort]:
    """Adds systems that show a limb's pose, ghosts and duty once per period, s.

    Returns:
        The input ports for [θ, θ̇] (2n) and D (W).
    """
    joint_state = _add_limb_view(builder, meshcat, root, parameters, period)
    others = builder.AddSystem(_GhostsAndDuty(meshcat, root, parameters, ghosts, period))
    return joint_state, others.get_input_port()


def _add_limb_view(
    builder: DiagramBuilder,
    meshcat: Meshcat,
    root: str,
    parameters: LimbParameters,
    period: float,
) -> InputPort:
    """Adds systems that show a limb's pose; returns their input port, [θ, θ̇] (2n)."""
    scene_graph = builder.AddSystem(SceneGraph())
    plant = MultibodyPlant(time_step=0.0)
    source = plant.RegisterAsSourceForSceneGraph(scene_graph)
    add_manipulator(plant, parameters)
    plant.Finalize()
    poses = builder.AddSystem(MultibodyPositionToGeometryPose(plant, input_multibody_state=True))
    builder.Connect(poses.get_output_port(), scene_graph.get_source_pose_port(source))
    folder = f"{root}visualizer"
    meshcat.Delete(folder)  # once: when a simulation starts the pose of its base must stay
    MeshcatVisualizer.AddToBuilder(
        builder,
        scene_graph,
        meshcat,
        MeshcatVisualizerParams(
            publish_period=period, prefix=folder, delete_on_initialization_event=False
        ),
    )
    return poses.get_input_port()


def wire_paths(root: str, parameters: LimbParameters) -> list[list[str]]:
    """For each wire the Meshcat paths of its pieces, one on each link."""
    links = f"{root}visualizer/limb/link"
    return [
        [f"{links}_{i + 1}/limb/wire_{wire.name}" for i in range(joints.start, joints.stop)]
        for joints, segment in zip(parameters.joint_slices, parameters.segments, strict=True)
        for wire in segment.wires
    ]


def linear(color: np.ndarray) -> np.ndarray:
    """Linear RGB, which Meshcat's materials use, from sRGB."""
    return np.where(color > 0.04045, ((color + 0.055) / 1.055) ** 2.4, color / 12.92)
