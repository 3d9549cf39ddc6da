"""Live 3D views during a simulation: of a limb, of a robot, or of the wires in any scene."""

from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from limb_systems.connected_limbs import ConnectedLimbs
from limb_systems.drake_python import weak_method
from limb_systems.files.trajectory import Trajectory
from limb_systems.limb_parameters import LimbParameters
from limb_systems.views.limb_view import color_wires, ghosts_of_plan, view_of, wire_paths

PUBLISH_PERIOD = 1 / 32  # s, of a live view


class LimbVisualizer(LeafSystem):
    """A view of a limb or a robot in Meshcat while it is simulated; wires have their heat's colour.

    For n joints and W wires in all:

    - input 0 ``joint_state``: [θ, θ̇] (2n), rad and rad/s
    - input 1 ``wire_temperature``: T (W), °C; or V, where T is not known
    - input 2 ``body_pose``: of a robot whose body moves, as the port of `Robot`; may be left
      unconnected

    Connect them to the ports of a `Limb` or `Robot` with the same names. The view is
    updated periodically in simulated time; to watch in real time, call the
    simulator's ``set_target_realtime_rate(1.0)``.

    With a plan, ghosts, lines along the axis, show its reference (grey) and the plan
    itself (blue) as they are at the context's time, time 0 being the plan's
    start; after its end they stay in their last pose.

    Several limbs share a Meshcat, or a diagram, if each of their views has a
    different ``prefix``; ``base_pose`` places them beside each other. The camera shows
    the last one.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(
        self,
        parameters: LimbParameters | ConnectedLimbs,
        meshcat: Meshcat,
        plan: Trajectory | None = None,
        *,
        prefix: str = "",
        base_pose: RigidTransform | None = None,
        publish_period: float = PUBLISH_PERIOD,
    ):
        """
        Args:
            parameters: the limb, or the robot.
            meshcat: scene to show it in; background, lights and camera are set.
            plan: trajectory to show as a ghost, with its reference.
            prefix: beginning of the limb's paths in Meshcat, ``visualizer`` and ``ghosts``,
                and of the system's name.
            base_pose: pose of the limb's frame (E1, E2, E3), or of the world of a robot, in
                Meshcat's world; its origin if None.
            publish_period: time from one update of the view to the next, s.

        Raises:
            LimbError: if the plan is for a limb of another shape, or there is one for a robot.
        """
        super().__init__()
        self._meshcat = meshcat
        self._root = f"{prefix}/" if prefix else ""
        if isinstance(parameters, ConnectedLimbs):
            limb = parameters.as_single_limb
            pose_size = len(parameters.pose_rows())
        else:
            limb = parameters
            pose_size = 0
        # Add the view and its ghosts to the scene.
        ghosts = ghosts_of_plan(limb, plan) if plan else []
        self._view = view_of(parameters, ghosts, self._root)
        self._view.add_to(meshcat, base_pose)
        self._view.set_scene(meshcat)
        # Declare the ports, and publish periodically.
        self.DeclareVectorInputPort("joint_state", 2 * limb.num_joints)
        self.DeclareVectorInputPort("wire_temperature", len(limb.wires))
        if pose_size:
            self.DeclareVectorInputPort("body_pose", pose_size)
        self.DeclarePeriodicPublishEvent(publish_period, 0.0, weak_method(self._publish))
        self.DeclareForcedPublishEvent(weak_method(self._publish))

    def _publish(self, context: Context) -> None:
        state, temperature, *pose_ports = map(self.get_input_port, range(self.num_input_ports()))
        angles = state.Eval(context)[: state.size() // 2]
        pose = (
            pose_ports[0].Eval(context) if pose_ports and pose_ports[0].HasValue(context) else None
        )
        self._view.show(self._meshcat, angles, context.get_time(), pose)
        self._view.show_heat(self._meshcat, temperature.Eval(context))


class WireColors(LeafSystem):
    """A block that colours the wires of a limb in the scene of Drake's MeshcatVisualizer.

    - input 0 ``wire_temperature``: T (W), °C
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(
        self,
        parameters: LimbParameters,
        meshcat: Meshcat,
        limb: str = "limb",
        *,
        prefix: str = "illustration",
    ):
        """
        Args:
            parameters: description of the limb.
            meshcat: scene in which the limb is shown.
            limb: name of the limb's model instance.
            prefix: path of the visualizer in the scene, by default the path of
                `AddDefaultVisualization`.
        """
        super().__init__()
        self._parameters, self._meshcat = parameters, meshcat
        path = limb.replace("::", "/")
        self._paths = wire_paths(parameters, f"{prefix}/{path}/", path)
        self.DeclareVectorInputPort("wire_temperature", len(parameters.wires))
        self.DeclarePeriodicPublishEvent(PUBLISH_PERIOD, 0.0, weak_method(self._publish))
        self.DeclareForcedPublishEvent(weak_method(self._publish))

    def _publish(self, context) -> None:
        temperature = self.get_input_port().Eval(context)
        color_wires(self._meshcat, self._paths, self._parameters, temperature)
