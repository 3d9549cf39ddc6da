"""Sensors like the robot's: sampled, noisy, drifting, with steps."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem, System

from limb_systems import LimbModel, LimbParameters, LimbSystem
from limb_systems.drake_python import weak_method
from limb_systems.layout import slices
from limb_systems.limb_system import check_limb
from limb_systems.wire_blocks import VectorFunction

# The paper's thermocouple amplifier, a MAX31855, converts within 100 ms and
# reports steps of 0.25 °C (datasheet 19-5793); the noise of one step is ours.
THERMOCOUPLE_PERIOD = 0.1  # s
THERMOCOUPLE_STEP = 0.25  # °C
THERMOCOUPLE_NOISE = 0.25  # °C
# Noise and drift of a bend sensor are in the limb's parameters; these two are ours.
BEND_STEP = np.deg2rad(0.1)
BEND_DRIFT_TIME = 120.0  # s
# A camera beside the robot. All are ours: about a pixel of one that sees 0.4 m of the ground, and
# that pixel across a body of 9 cm.
CAMERA_PERIOD = 0.1  # s
CAMERA_NOISE = 3e-4  # m
CAMERA_ANGLE_NOISE = np.deg2rad(0.2)
CAMERA_STEP = 1e-5  # m and rad


class Noise:
    """Standard normal numbers in the order in which a generator draws them.

    A system keeps in its state how many numbers it has used. It therefore
    continues with the same numbers from every copy of its Context, because numbers
    that were drawn once are kept. With a plain generator it would not.
    """

    def __init__(self, generator: np.random.Generator):
        self._generator = generator
        self._numbers = np.empty(0)

    def read(self, start: int, count: int) -> np.ndarray:
        """The numbers from ``start`` on, (count,)."""
        missing = start + count - len(self._numbers)
        if missing > 0:
            more = self._generator.standard_normal(max(missing, len(self._numbers), 1000))
            self._numbers = np.concatenate([self._numbers, more])
        return self._numbers[start : start + count]


@dataclasses.dataclass(frozen=True)
class Sensor:
    """How a vector signal is read: sampled, with noise, drift and steps.

    - ``name``: name of the signal and of its reading.
    - ``size``: size of the signal.
    - ``period``: time between samples, s.
    - ``step``: quantization q, in the unit of the signal.
    - ``noise``: standard deviation σ of each sample, for all or for each (size),
      in the unit of the signal.
    - ``drift``: standard deviation δ of the drift, likewise.
    - ``drift_time``: correlation time τ of the drift, s.
    - ``response``: reading for a signal, r; exact by default.
    """

    name: str
    size: int
    period: float
    step: float
    noise: ArrayLike = 0.0
    drift: ArrayLike = 0.0
    drift_time: float = 1.0
    response: Callable[[np.ndarray], np.ndarray] = np.asarray


class SampledSensors(LeafSystem):
    """Samples vector signals and holds them, with noise, drift and quantization.

        y = q round((r(x) + σ w + d) / q) at every multiple of the sensor's period,

    with the sensor's response r, w standard normal, and d an Ornstein-Uhlenbeck
    process of standard deviation δ and correlation time τ. For sensors 1 to N:

    - inputs 0 to N - 1, by the sensors' names: x (size)
    - outputs 0 to N - 1, likewise: y (size), in the unit of the signal
    - output N ``measurement``: all y, one after the other
    - output N + 1 ``draws``: how many numbers of the noise were used
    - state, discrete: y of each; d of all; draws. Updated each period and at
      initialization, where a new drift is drawn

    The sensors draw from one sequence of noise in turn; the position in the
    sequence is in the Context.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, sensors: Sequence[Sensor], noise: Noise, start: int = 0):
        """
        Args:
            sensors: one or more; those that are due at the same time draw in this order.
            noise: numbers for noise and drift.
            start: how many numbers of the noise were used before.
        """
        super().__init__()
        self._sensors = [
            dataclasses.replace(s, noise=np.asarray(s.noise), drift=np.asarray(s.drift))
            for s in sensors
        ]
        self._memories = [np.exp(-s.period / s.drift_time) for s in sensors]
        self._wanders = [
            sensor.drift * np.sqrt(1 - memory**2)
            for sensor, memory in zip(self._sensors, self._memories, strict=True)
        ]
        self._noise = noise
        self._parts = slices([sensor.size for sensor in sensors])
        size = self._parts[-1].stop
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._start))
        for index, sensor in enumerate(sensors):
            self.DeclareVectorInputPort(sensor.name, sensor.size)
            self.DeclarePeriodicDiscreteUpdateEvent(
                sensor.period, sensor.period, self._sampling(index)
            )
            reading = self.DeclareDiscreteState(sensor.size)
            self.DeclareStateOutputPort(sensor.name, reading)
        self.DeclareDiscreteState(size)
        draws = self.DeclareDiscreteState([float(start)])
        self.DeclareVectorOutputPort(
            "measurement", size, weak_method(self._calc), {self.xd_ticket()}
        )
        self.DeclareStateOutputPort("draws", draws)

    def _start(self, context, state):
        for index, (sensor, part) in enumerate(zip(self._sensors, self._parts, strict=True)):
            drift = state.get_mutable_value(len(self._sensors))
            drift[part] = sensor.drift * self._draw(state, sensor.size)
            self._sample(index, context, state)

    def _sampling(self, index: int):
        sample = weak_method(self._sample)
        return lambda context, state: sample(index, context, state)

    def _sample(self, index: int, context, state):
        sensor, part = self._sensors[index], self._parts[index]
        signal = sensor.response(self.get_input_port(index).Eval(context))
        noise, wander = self._draw(state, 2 * sensor.size).reshape(2, -1)
        offset = state.get_mutable_value(len(self._sensors))[part]
        offset[:] = self._memories[index] * offset + self._wanders[index] * wander
        noisy = signal + sensor.noise * noise + offset
        state.set_value(index, sensor.step * np.rint(noisy / sensor.step))

    def _draw(self, state, count: int) -> np.ndarray:
        """The next numbers of the noise, as far as the sensors before have used it."""
        draws = state.get_mutable_value(len(self._sensors) + 1)
        start = int(draws[0])
        draws[0] = start + count
        return self._noise.read(start, count)

    def _calc(self, context, output):
        groups = range(len(self._sensors))
        readings = [context.get_discrete_state(group).value() for group in groups]
        output.SetFromVector(np.concatenate(readings))


def exact_bend(parameters: LimbParameters) -> System:
    """Return a system from [θ, θ̇] (2n), rad and rad/s, to what exact bend sensors show (F), rad."""
    mechanics = LimbModel.of(parameters).mechanics
    n = parameters.num_joints
    return VectorFunction(
        lambda state: mechanics.recorded_bend_angle(state[:n]), [2 * n], mechanics.layout.num_bends
    )


def limb_sensors(
    parameters: LimbParameters,
    bend_rate: float,
    thermocouple_period: float = THERMOCOUPLE_PERIOD,
    *,
    bend_response: Callable[[np.ndarray], np.ndarray],
    bend_noise: ArrayLike,
    bend_drift: ArrayLike,
) -> list[Sensor]:
    """The robot's sensors, for `SampledSensors`: ``measured_temperature`` and ``bend_angle``.

    Args:
        parameters: description of the limb.
        bend_rate: rate at which bend sensors are read, Hz.
        thermocouple_period: time between readings of a thermocouple, s.
        bend_response: what they read where exact ones would show angles (F,), rad.
        bend_noise, bend_drift: their standard deviations, for all or for each (F,), rad.
    """
    thermocouples = Sensor(
        "measured_temperature",
        len(parameters.wires),
        thermocouple_period,
        THERMOCOUPLE_STEP,
        noise=THERMOCOUPLE_NOISE,
    )
    bend_sensors = Sensor(
        "bend_angle",
        LimbModel.of(parameters).layout.num_bends,
        1 / bend_rate,
        BEND_STEP,
        noise=bend_noise,
        drift=bend_drift,
        drift_time=BEND_DRIFT_TIME,
        response=bend_response,
    )
    return [thermocouples, bend_sensors]


def camera(size: int) -> Sensor:
    """A camera or tags that see the ``body_pose`` (size,) of a robot, for `SampledSensors`."""
    angles = 1 if size == 3 else 3
    noise = np.repeat([CAMERA_NOISE, CAMERA_ANGLE_NOISE], [size - angles, angles])
    return Sensor("body_pose", size, CAMERA_PERIOD, CAMERA_STEP, noise=noise)


class SensedLimb(Diagram):
    """A limb, such as the model, behind the robot's sensors.

    Its ``bend_angle`` is what its bend sensors show of the joint angles, if it has
    the output port ``joint_state``; else they show its own ``bend_angle``.

    - input 0 ``duty``: D (W), in [0, 1]
    - output 0 ``measured_temperature``: V (W), °C, as thermocouples read it
    - output 1 ``bend_angle``: φ (F), rad, as bend sensors read it
    - output 2 ``measurement``: [V (W), φ (F)], both of them
    """

    __slots__ = ()  # see limb_systems.drake_python

    real_time = False

    def __init__(self, limb: LimbSystem, *, seed: int = 0, bend_rate: float = 20.0):
        """
        Args:
            limb: the one behind them.
            seed: seed of the sensors' noise.
            bend_rate: rate at which bend sensors are read, Hz.
        """
        super().__init__()
        builder = DiagramBuilder()
        check_limb(limb)
        builder.AddSystem(limb)
        self.parameters, self.accuracy = limb.parameters, limb.accuracy
        self.source = f"{limb.source} with sensor noise, seed {seed}"
        builder.ExportInput(limb.GetInputPort("duty"), "duty")
        layout = LimbModel.of(limb.parameters).layout
        segments = limb.parameters.segments
        described = [segments[number].bend_sensor for number in layout.bend_segment]
        gain = np.array([sensor.gain for sensor in described])
        offset = np.choose(
            layout.bend_direction, np.array([(s.offset, s.offset_e3) for s in described]).T
        )
        readings = limb_sensors(
            limb.parameters,
            bend_rate,
            bend_response=lambda angle: gain * angle + offset,
            bend_noise=[sensor.noise for sensor in described],
            bend_drift=[sensor.drift for sensor in described],
        )
        noise = Noise(np.random.default_rng(seed))
        sensors = builder.AddNamedSystem("sensors", SampledSensors(readings, noise))
        shown = limb.GetOutputPort("bend_angle")
        if limb.HasOutputPort("joint_state"):
            exact = builder.AddNamedSystem("exact_bend", exact_bend(limb.parameters))
            builder.Connect(limb.GetOutputPort("joint_state"), exact.get_input_port())
            shown = exact.get_output_port()
        builder.Connect(shown, sensors.GetInputPort("bend_angle"))
        temperature = "measured_temperature"
        builder.Connect(limb.GetOutputPort(temperature), sensors.GetInputPort(temperature))
        for name in ("measured_temperature", "bend_angle", "measurement"):
            builder.ExportOutput(sensors.GetOutputPort(name), name)
        builder.BuildInto(self)
