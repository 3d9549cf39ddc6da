"""Sensors like the robot's: sampled, noisy, drifting, with steps."""

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import LeafSystem, System
from pydrake.systems.primitives import MatrixGain

from limb_systems import LimbModel, LimbParameters, TipTangentSensor
from limb_systems.drake_python import weak_method
from limb_systems.layout import slices
from limb_systems.wire_blocks import VectorFunction

# The paper's thermocouple amplifier, a MAX31855, converts within 100 ms and
# reports steps of 0.25 °C (datasheet 19-5793); the noise of one step is ours.
THERMOCOUPLE_PERIOD = 0.1  # s
THERMOCOUPLE_STEP = 0.25  # °C
THERMOCOUPLE_NOISE = 0.25  # °C
# Noise and drift of a bend sensor are in the limb's parameters; these two numbers are ours.
BEND_STEP = np.deg2rad(0.1)
BEND_DRIFT_TIME = 120.0  # s
# A camera above the robot. All numbers are ours: about a pixel if it sees 0.4 m of the ground, and
# the angle of such a pixel across a body of 9 cm.
CAMERA_PERIOD = 0.1  # s
CAMERA_NOISE = 3e-4  # m
CAMERA_ANGLE_NOISE = np.deg2rad(0.2)
CAMERA_STEP = 1e-5  # m and rad


class Noise:
    """Standard normal numbers in the order in which a generator draws them.

    The state of a system has the number of numbers that it has used. Because all drawn numbers
    are kept, the system continues with the same numbers from every copy of its Context; with a
    plain generator it would not.
    """

    def __init__(self, generator: np.random.Generator):
        self._generator = generator
        self._numbers = np.empty(0)

    def read(self, start: int, count: int) -> np.ndarray:
        """Return the numbers from ``start`` on, (count,)."""
        missing = start + count - len(self._numbers)
        if missing > 0:
            more = self._generator.standard_normal(max(missing, len(self._numbers), 1000))
            self._numbers = np.concatenate([self._numbers, more])
        return self._numbers[start : start + count]


@dataclasses.dataclass(frozen=True)
class Sensor:
    """A sensor of a vector signal: sampled, with noise, drift and quantization.

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
    - output N + 1 ``draws``: count of the numbers of the noise that were used
    - state, discrete: y of each; d of all; draws. Updated each period and at
      initialization, where a new drift is drawn

    The sensors draw from one sequence of noise in turn; the position in the
    sequence is in the Context.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, sensors: Sequence[Sensor], random_numbers: Noise, num_used: int = 0):
        """
        Args:
            sensors: one or more; those that are due at the same time draw in this order.
            random_numbers: standard normal numbers, for noise and drift.
            num_used: count of these numbers that were used before.
        """
        super().__init__()
        # In a period a drift decays by a factor, and moves by a random step.
        self._sensors = sensors
        self._drift_decays = []
        self._noise_and_drift_step = []
        for sensor in sensors:
            decay = math.exp(-sensor.period / sensor.drift_time)
            drift_step = np.asarray(sensor.drift) * np.sqrt(1 - decay**2)
            steps = np.broadcast_arrays(np.empty(sensor.size), sensor.noise, drift_step)[1:]
            self._drift_decays.append(decay)
            self._noise_and_drift_step.append(np.transpose(steps).tolist())
        self._random_numbers = random_numbers
        # The elements of each sensor in the measurement, and in the drift.
        self._sensor_slices = slices([sensor.size for sensor in sensors])
        size = self._sensor_slices[-1].stop
        # Declare the states: readings of each sensor, drifts of all, and the count of draws.
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._start))
        for index, sensor in enumerate(sensors):
            self.DeclareVectorInputPort(sensor.name, sensor.size)
            self.DeclarePeriodicDiscreteUpdateEvent(
                sensor.period, sensor.period, self._sampling(index)
            )
            reading = self.DeclareDiscreteState(sensor.size)
            self.DeclareStateOutputPort(sensor.name, reading)
        self.DeclareDiscreteState(size)
        draws = self.DeclareDiscreteState([float(num_used)])
        self.DeclareVectorOutputPort(
            "measurement", size, weak_method(self._calc_measurement), {self.xd_ticket()}
        )
        self.DeclareStateOutputPort("draws", draws)

    def _start(self, context, state):
        for index, (sensor, part) in enumerate(
            zip(self._sensors, self._sensor_slices, strict=True)
        ):
            drift = state.get_mutable_value(len(self._sensors))
            drift[part] = np.asarray(sensor.drift) * self._draw(state, sensor.size)
            self._sample(index, context, state)

    def _sampling(self, index: int):
        sample = weak_method(self._sample)
        return lambda context, state: sample(index, context, state)

    def _sample(self, index: int, context, state):
        sensor = self._sensors[index]
        signal = sensor.response(self.EvalVectorInput(context, index).value()).tolist()
        random_numbers = self._draw(state, 2 * sensor.size).tolist()
        drift = state.get_mutable_value(len(self._sensors))[self._sensor_slices[index]]
        drifts = drift.tolist()
        # Calculate with numbers, because arrays of one or two take several times as long.
        for element, (noise, drift_step) in enumerate(self._noise_and_drift_step[index]):
            random_step = drift_step * random_numbers[sensor.size + element]
            drifts[element] = self._drift_decays[index] * drifts[element] + random_step
            noisy = signal[element] + noise * random_numbers[element] + drifts[element]
            signal[element] = quantized(noisy, sensor.step)
        drift[:] = drifts
        state.set_value(index, signal)

    def _draw(self, state, count: int) -> np.ndarray:
        """Return the next numbers of the noise, and count them in the state."""
        draws = state.get_mutable_value(len(self._sensors) + 1)
        start = int(draws[0])
        draws[0] = start + count
        return self._random_numbers.read(start, count)

    def _calc_measurement(self, context, output):
        groups = range(len(self._sensors))
        readings = [context.get_discrete_state(group).value() for group in groups]
        output.SetFromVector(np.concatenate(readings))


def quantized(value: float, step: float) -> float:
    """Return the multiple of a step that is closest to a value; nan of a limb that diverged."""
    return step * round(value / step) if math.isfinite(value) else math.nan


def exact_bend(parameters: LimbParameters) -> System:
    """Return a system from [θ, θ̇] (2n), rad and rad/s, to exact bend sensors' readings (F), rad."""
    mechanics = LimbModel.of(parameters).mechanics
    num_joints = parameters.num_joints
    # A tip's tangent in a plane is linear in the angles, which Drake's C++ multiplies faster.
    sensors = mechanics.bend_sensors
    if mechanics.layout.is_planar and all(type(each) is TipTangentSensor for each in sensors):
        bend_by_angle = mechanics.recorded_bend_angle(np.eye(num_joints))
        return MatrixGain(np.hstack([bend_by_angle, 0.0 * bend_by_angle]))

    def readings(state: np.ndarray) -> np.ndarray:
        return mechanics.recorded_bend_angle(state[:num_joints])

    return VectorFunction(readings, [2 * num_joints], mechanics.layout.num_bends)


def limb_sensors(
    parameters: LimbParameters,
    bend_rate: float,
    thermocouple_period: float = THERMOCOUPLE_PERIOD,
    *,
    bend_response: Callable[[np.ndarray], np.ndarray],
    bend_noise: ArrayLike,
    bend_drift: ArrayLike,
) -> list[Sensor]:
    """Return the robot's sensors ``measured_temperature`` and ``bend_angle`` for `SampledSensors`.

    Args:
        parameters: description of the limb.
        bend_rate: rate at which bend sensors are read, Hz.
        thermocouple_period: time between readings of a thermocouple, s.
        bend_response: function from exact bend angles (F,), rad, to readings of the sensors.
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
    """Return a camera that sees the ``body_pose`` (size,) of a robot, for `SampledSensors`."""
    num_angles = 1 if size == 3 else 3
    noise = np.repeat([CAMERA_NOISE, CAMERA_ANGLE_NOISE], [size - num_angles, num_angles])
    return Sensor("body_pose", size, CAMERA_PERIOD, CAMERA_STEP, noise=noise)
