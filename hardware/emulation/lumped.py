"""The lumped physics of emulated limbs and robots, without the mechanics of their joints."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from pydrake import trajectories
from pydrake.systems.framework import BasicVector, DiagramBuilder, InputPort, LeafSystem, OutputPort
from pydrake.systems.primitives import Adder, Demultiplexer, LinearSystem, MatrixGain, Multiplexer

from hardware.emulation.emulated_rubber import EmulatedRubber, Hand, RestShift
from hardware.emulation.emulated_wires import ShapeMemoryWires
from hardware.emulation.sensors import (
    THERMOCOUPLE_PERIOD,
    SampledSensors,
    camera,
    exact_bend,
    limb_sensors,
    quantized,
)
from hardware.emulation.specimen import SegmentPhysics, Specimen
from hardware.firmware import guard
from limb_systems import LimbModel, ThermocoupleLag
from limb_systems.bend_sensor import roll_bends
from limb_systems.drake_python import weak_method
from limb_systems.layout import Layout, slices

SMOOTHING_TIME = 0.05  # s, over which the steps of the wires' torque are smoothed
PWM_STEP = 1 / 255  # of duty, of a timer of eight bits


def add_physics(
    builder: DiagramBuilder,
    specimen: Specimen,
    joint_state: OutputPort,
    force: InputPort,
    *,
    bend_rate: float,
    wire_period: float,
    truth: bool,
    hand: trajectories.Trajectory | None = None,
    body_pose: OutputPort | None = None,
    memory: Mapping[str, OutputPort] = MappingProxyType({}),
) -> tuple[dict[str, OutputPort], InputPort]:
    """Add wires, rubber, sensors and cut-out to mechanics, and export the ports of a limb.

    Args:
        builder: builder of the diagram that has the mechanics.
        specimen: the limb, or all limbs of a robot together. Its ``state`` is kept up to date.
        joint_state: [θ, θ̇] (2n) of the mechanics, rad and rad/s.
        force: torques on its joints (n), N·m.
        bend_rate, wire_period, truth, hand: as for `LimbTwin`.
        body_pose: pose of a robot's body, which a camera sees.
        memory: ports that the specimen's state keeps in addition, by name.

    Returns:
        Output ports by name, and the input port of the duty, which is neither connected nor
        exported.
    """
    parameters = specimen.description
    state = specimen.state
    layout = LimbModel.of(parameters).layout
    num_wires = layout.num_wires
    num_joints = layout.num_joints
    segments = specimen.segments
    # Wires, the rubber around them, and the exact signals of the sensors.
    wires = builder.AddNamedSystem("shape_memory_wires", ShapeMemoryWires(specimen, wire_period))
    rubber = builder.AddNamedSystem("rubber", EmulatedRubber(specimen))
    lag = builder.AddNamedSystem("thermocouple_lag", ThermocoupleLag(specimen.mechanics()))
    lag.configure_default_state(state.get("measured", np.full(num_wires, specimen.ambient)))
    bend_angle = builder.AddNamedSystem("exact_bend", exact_bend(parameters))
    split = builder.AddSystem(Demultiplexer([num_joints, num_joints]))
    # A low-pass smooths the steps of the wires' torque.
    identity = np.eye(num_joints)
    rate = identity / max(SMOOTHING_TIME, wire_period / 2)
    smooth = builder.AddSystem(LinearSystem(-rate, rate, identity, 0 * identity))
    smooth.configure_default_state(state.get("smooth", np.zeros(num_joints)))
    builder.Connect(wires.GetOutputPort("generalized_force"), smooth.get_input_port())
    # Add all torques up: wires, rubber, and where they are asked for, a hand and the rest's memory.
    forces = [smooth.get_output_port(), split.get_output_port(0)]
    if hand is not None:
        holding = builder.AddNamedSystem("hand", Hand(parameters, hand))
        builder.Connect(joint_state, holding.get_input_port())
        forces.append(holding.get_output_port())
    has_rest_shift = any(segment.memory_share for segment in segments)
    if has_rest_shift:
        rest = builder.AddNamedSystem("rest_shift", RestShift(specimen, wire_period))
        builder.Connect(wires.GetOutputPort("state"), rest.get_input_port())
        forces.append(rest.GetOutputPort("generalized_force"))
    total = builder.AddSystem(Adder(len(forces), num_joints))
    cut_out = builder.AddNamedSystem("heater_cut_out", CutOut(num_wires, wire_period))
    # Sensors, with the properties of this specimen.
    of_bends = [segments[number] for number in layout.bend_segment]
    readings = limb_sensors(
        parameters,
        bend_rate,
        max(THERMOCOUPLE_PERIOD, wire_period),
        bend_response=_bend_response(segments, layout),
        bend_noise=[segment.sensor_noise for segment in of_bends],
        bend_drift=[segment.sensor_drift for segment in of_bends],
    )
    if body_pose:
        readings.append(camera(body_pose.size()))
    (draws,) = state.get("draws", [0.0])
    sampled = SampledSensors(readings, specimen.noise, num_used=int(draws))
    sensors = builder.AddNamedSystem("sensors", sampled)
    measurement = sensors.GetOutputPort("measurement")

    # Connect them: duty to wires to joints to sensors.
    builder.Connect(cut_out.GetOutputPort("duty"), wires.GetInputPort("duty"))
    builder.Connect(joint_state, wires.GetInputPort("joint_state"))
    builder.Connect(joint_state, rubber.get_input_port())
    builder.Connect(joint_state, bend_angle.get_input_port())
    builder.Connect(rubber.get_output_port(), split.get_input_port())
    builder.Connect(wires.GetOutputPort("wire_temperature"), lag.get_input_port())
    for index, port in enumerate(forces):
        builder.Connect(port, total.get_input_port(index))
    builder.Connect(total.get_output_port(), force)
    builder.Connect(lag.get_output_port(), sensors.GetInputPort("measured_temperature"))
    builder.Connect(bend_angle.get_output_port(), sensors.GetInputPort("bend_angle"))
    if body_pose:
        builder.Connect(body_pose, sensors.GetInputPort("body_pose"))
        # The limb's measurement is without the pose, which is the last sensor.
        size = measurement.size()
        first_readings = builder.AddSystem(MatrixGain(np.eye(size - body_pose.size(), size)))
        builder.Connect(measurement, first_readings.get_input_port())
        measurement = first_readings.get_output_port()
    measured = sensors.GetOutputPort("measured_temperature")
    builder.Connect(measured, cut_out.GetInputPort("measured_temperature"))

    # Export the ports.
    ports = {
        "measured_temperature": measured,
        "bend_angle": sensors.GetOutputPort("bend_angle"),
        "applied_duty": cut_out.GetOutputPort("duty"),
        "measurement": measurement,
        "cut_out": cut_out.GetOutputPort("cut_out"),
    }
    if truth:
        ports["wire_temperature"] = wires.GetOutputPort("wire_temperature")
        ports["joint_state"] = joint_state
    if body_pose:
        ports["body_pose"] = sensors.GetOutputPort("body_pose")
    for name, port in ports.items():
        builder.ExportOutput(port, name)

    # Keep the state of all parts in the specimen.
    states = {
        "joints": joint_state,
        "wires": wires.GetOutputPort("state"),
        "rubber": split.get_output_port(1),
        "measured": lag.get_output_port(),
        "smooth": smooth.get_output_port(),
        "draws": sensors.GetOutputPort("draws"),
        **memory,
    }
    if has_rest_shift:
        states["rest"] = rest.GetOutputPort("state")
    sizes = {name: port.size() for name, port in states.items()}
    joined = builder.AddNamedSystem("memory_inputs", Multiplexer(list(sizes.values())))
    for index, port in enumerate(states.values()):
        builder.Connect(port, joined.get_input_port(index))
    keeper = builder.AddNamedSystem("memory", _StateKeeper(specimen, sizes))
    builder.Connect(joined.get_output_port(), keeper.get_input_port())
    return ports, cut_out.GetInputPort("duty")


class CutOut(LeafSystem):
    """A cut-out that switches all heaters off once a wire is measured at the board's limit.

    They stay off until the end of the simulation. Unlike a board it does not reduce the duty
    below the limit. Like a board it puts the duty into the steps of its PWM.

    - input 0 ``duty``: D (W), as commanded
    - input 1 ``measured_temperature``: V (W), °C
    - output 0 ``duty``: D (W) in the steps of the PWM, zero once it has cut out
    - output 1 ``cut_out``: 1 if it has cut out, else 0
    - state, discrete: the value of ``cut_out``
    - parameter: the limit, °C, by default the limit of the board's firmware
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, num_wires: int, period: float):
        """
        Args:
            num_wires: number of wires, W.
            period: s, between two checks of the temperatures.
        """
        super().__init__()
        state = self.DeclareDiscreteState(1)
        self.DeclareNumericParameter(BasicVector([guard.TEMPERATURE_LIMIT]))
        duty = self.DeclareVectorInputPort("duty", num_wires)
        self.DeclareVectorInputPort("measured_temperature", num_wires)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weak_method(self._update_cut_out))
        tickets = {self.discrete_state_ticket(state)}
        self.DeclareVectorOutputPort(
            "duty",
            num_wires,
            weak_method(self._calc_duty),
            tickets | {self.input_port_ticket(duty.get_index())},
        )
        self.DeclareStateOutputPort("cut_out", state)

    def _update_cut_out(self, context, discrete_state):
        limit = context.get_numeric_parameter(0)[0]
        if max(self.EvalVectorInput(context, 1).value().tolist()) >= limit:
            discrete_state.set_value([1.0])

    def _calc_duty(self, context, output):
        share = 1 - context.get_discrete_state_vector()[0]
        duty = self.EvalVectorInput(context, 0).value().tolist()
        output.SetFromVector([share * quantized(value, PWM_STEP) for value in duty])


class _StateKeeper(LeafSystem):
    """Keeps the state of the parts in their specimen, for limbs that are made from it later.

    Its input is the state of all parts in one port, because each port takes time in every step.
    Nothing in this diagram reads the kept state, so simulations of two copies of its Context do
    not affect each other. A later limb starts from the state of the last run.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, specimen: Specimen, sizes: dict[str, int]):
        super().__init__()
        self._specimen = specimen
        self._parts = dict(zip(sizes, slices([*sizes.values()]), strict=True))
        self.DeclareVectorInputPort("state", sum(sizes.values()))
        self.DeclarePerStepPublishEvent(weak_method(self._remember))

    def _remember(self, context):
        state = self.get_input_port(0).Eval(context)
        self._specimen.state = {name: state[part] for name, part in self._parts.items()}


def _bend_response(
    segments: Sequence[SegmentPhysics], layout: Layout
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function from exact bends (F,), rad, to readings of the segments' bend sensors."""
    # A sensor that is rolled about E1 mixes both bends of its segment.
    roll = np.eye(layout.num_bends)
    for segment, bends in zip(segments, layout.bends_of, strict=True):
        roll[bends, bends] = roll_bends(roll[bends, bends], segment.sensor_roll)
    # Gain, curvature and offset of each segment towards E2 and E3 (S, 3, 2), then of each bend.
    of_segments = np.empty((len(segments), 3, 2))
    for number, segment in enumerate(segments):
        of_segments[number, 0] = segment.sensor_gain, segment.sensor_gain_e3
        of_segments[number, 1] = segment.sensor_curvature, segment.sensor_curvature_e3
        of_segments[number, 2] = segment.sensor_offset, segment.sensor_offset_e3
    gain, curvature, offset = of_segments[layout.bend_segment, :, layout.bend_direction].T
    curvature = curvature / (np.pi / 4)

    def readings(exact: np.ndarray) -> np.ndarray:
        angle = roll @ exact
        return gain * angle * (1 + curvature * angle) + offset

    return readings
