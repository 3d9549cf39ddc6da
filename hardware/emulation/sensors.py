"""Sensors as the robot has them: sampled, noisy, drifting, in steps."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem, OutputPort, System

from limb_systems.model.ownership import weak_method

# The paper's thermocouple amplifier, a MAX31855, converts within 100 ms and
# reports steps of 0.25 °C (datasheet 19-5793); the noise of one step is ours.
THERMOCOUPLE_PERIOD = 0.1  # s
THERMOCOUPLE_STEP = 0.25  # °C
THERMOCOUPLE_NOISE = 0.25  # °C
# The paper saw "around 2° measurement error" of its bend sensor in use (Sec.
# VII). How much of it is noise and how much drifts is ours, and so is the step.
BEND_STEP = np.deg2rad(0.1)
BEND_NOISE = np.deg2rad(0.5)
BEND_DRIFT = np.deg2rad(1.0)
BEND_DRIFT_TIME = 120.0  # s


class SampledSensor(LeafSystem):
    """Samples a vector signal and holds it, with noise, drift and quantization.

        y = q round((r(x) + σ w + d) / q) at every multiple of the period,

    with the sensor's response r, w standard normal, and d an Ornstein-Uhlenbeck
    process of standard deviation δ and correlation time τ.

    - input 0 ``signal``: x (size)
    - output 0 ``measurement``: y (size), in the unit of the signal
    - state, discrete: y (size), updated each period and at initialization

    The noise comes from a generator that runs on from one simulation to the
    next, as a sensor's noise does; drift is drawn anew at initialization.
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(
        self,
        size: int,
        period: float,
        step: float,
        *,
        noise: ArrayLike = 0.0,
        drift: ArrayLike = 0.0,
        drift_time: float = 1.0,
        response: Callable[[np.ndarray], np.ndarray] = np.asarray,
        generator: np.random.Generator | None = None,
    ):
        """
        Args:
            size: of the signal.
            period: s between samples.
            step: quantization q, in the unit of the signal.
            noise: standard deviation σ of each sample, for all or for each (size),
                in the unit of the signal.
            drift: standard deviation δ of the drift, likewise.
            drift_time: correlation time τ of the drift, s.
            response: what the sensor reads for a signal, r; exact by default.
            generator: of noise and drift; the seed 0 if None.
        """
        super().__init__()
        self._noise, self._drift, self._step = np.asarray(noise), np.asarray(drift), step
        self._memory = np.exp(-period / drift_time)
        self._response = response
        self._generator = generator or np.random.default_rng(0)
        self._offset = np.zeros(size)
        self.DeclareVectorInputPort("signal", size)
        state = self.DeclareDiscreteState(size)
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._start))
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, weak_method(self._sample))
        self.DeclareStateOutputPort("measurement", state)

    def _start(self, context, discrete_state):
        self._offset = self._drift * self._generator.standard_normal(len(self._offset))
        self._sample(context, discrete_state)

    def _sample(self, context, discrete_state):
        signal = self._response(self.get_input_port().Eval(context))
        noise, wander = self._generator.standard_normal((2, len(signal)))
        self._offset = self._memory * self._offset + (
            self._drift * np.sqrt(1 - self._memory**2) * wander
        )
        noisy = signal + self._noise * noise + self._offset
        discrete_state.set_value(self._step * np.round(noisy / self._step))


def add_sensors(
    builder: DiagramBuilder,
    temperature: OutputPort,
    bend_angle: OutputPort,
    generator: np.random.Generator,
    bend_rate: float,
    *,
    bend_response: Callable[[np.ndarray], np.ndarray] = np.asarray,
    bend_noise: ArrayLike = BEND_NOISE,
    bend_drift: ArrayLike = BEND_DRIFT,
) -> None:
    """Adds the robot's sensors and exports what they read.

    The builder's diagram gets the outputs ``measured_temperature`` (°C) and
    ``bend_angle`` (rad), in this order.

    Args:
        builder: of the diagram that holds the ports below.
        temperature: at the thermocouples (W), °C.
        bend_angle: φ (S), rad.
        generator: of noise and drift.
        bend_rate: at which bend sensors are read, Hz.
        bend_response: what they read for φ, rad.
        bend_noise, bend_drift: their standard deviations, rad.
    """
    thermocouple = builder.AddNamedSystem(
        "thermocouple",
        SampledSensor(
            temperature.size(),
            THERMOCOUPLE_PERIOD,
            THERMOCOUPLE_STEP,
            noise=THERMOCOUPLE_NOISE,
            generator=generator,
        ),
    )
    bend_sensor = builder.AddNamedSystem(
        "bend_sensor",
        SampledSensor(
            bend_angle.size(),
            1 / bend_rate,
            BEND_STEP,
            noise=bend_noise,
            drift=bend_drift,
            drift_time=BEND_DRIFT_TIME,
            response=bend_response,
            generator=generator,
        ),
    )
    for signal, sensor, name in (
        (temperature, thermocouple, "measured_temperature"),
        (bend_angle, bend_sensor, "bend_angle"),
    ):
        builder.Connect(signal, sensor.get_input_port())
        builder.ExportOutput(sensor.get_output_port(), name)


class SensedLimb(Diagram):
    """A limb, such as the model, behind the robot's sensors.

    - input 0 ``duty``: D (W), in [0, 1]
    - output 0 ``measured_temperature``: V (W), °C, as thermocouples read it
    - output 1 ``bend_angle``: φ (S), rad, as bend sensors read it
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, limb: System, *, seed: int = 0, bend_rate: float = 20.0):
        """
        Args:
            limb: with the ports and ``parameters`` of `Limb`.
            seed: of the sensors' noise.
            bend_rate: at which bend sensors are read, Hz.
        """
        super().__init__()
        builder = DiagramBuilder()
        builder.AddSystem(limb)
        self.parameters = limb.parameters
        self.source = f"{limb.source} with sensor noise, seed {seed}"
        builder.ExportInput(limb.GetInputPort("duty"), "duty")
        add_sensors(
            builder,
            limb.GetOutputPort("measured_temperature"),
            limb.GetOutputPort("bend_angle"),
            np.random.default_rng(seed),
            bend_rate,
        )
        builder.BuildInto(self)
        self.set_name("sensed_limb")
