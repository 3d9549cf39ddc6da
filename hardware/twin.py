"""The emulated limb: what scripts use where there is no robot."""

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder

from hardware.sensors import SampledSensor
from limb_systems import Limb, LimbParameters

# The paper's thermocouple amplifier, a MAX31855, converts within 100 ms and
# reports steps of 0.25 °C (datasheet 19-5793); the noise of one step is ours.
THERMOCOUPLE_PERIOD = 0.1  # s
THERMOCOUPLE_STEP = 0.25  # °C
THERMOCOUPLE_NOISE = 0.25  # °C
# The paper saw "around 2° measurement error" of its bend sensor in use (Sec.
# VII); here 95% of the readings are that close. The step is ours.
BEND_PERIOD = 0.05  # s
BEND_STEP = np.deg2rad(0.1)
BEND_NOISE = np.deg2rad(1.0)


class LimbTwin(Diagram):
    """An emulated limb with the sensors of the robot and the ports of `Limb`.

    It emulates; it is no measurement of a robot. Its mechanics and heat are
    those of the model, with the given parameters; its sensors are sampled,
    noisy and quantized.

    For a limb of S segments and W = 2 S wires:

    - input 0 ``duty``: D (W), in [0, 1]
    - output 0 ``measured_temperature``: V (W), °C, as thermocouples read it
    - output 1 ``bend_angle``: φ (S), rad, as bend sensors read it
    """

    __slots__ = ()  # see limb_systems.ownership

    def __init__(self, parameters: LimbParameters | None = None, *, seed: int = 0):
        """Args:
            parameters: the nominal limb if None.
            seed: of the sensors' noise.

        Raises:
            ParameterError: if a parameter is out of its range.
        """
        super().__init__()
        builder = DiagramBuilder()
        limb = builder.AddSystem(Limb(parameters))
        self.parameters = limb.parameters
        self.source = f"emulated limb (model with sensor noise, seed {seed})"
        num_segments = len(self.parameters.segments)
        seeds = np.random.SeedSequence(seed).spawn(2)
        thermocouple = builder.AddNamedSystem(
            "thermocouple",
            SampledSensor(
                2 * num_segments,
                THERMOCOUPLE_PERIOD,
                THERMOCOUPLE_NOISE,
                THERMOCOUPLE_STEP,
                seeds[0],
            ),
        )
        bend_sensor = builder.AddNamedSystem(
            "bend_sensor",
            SampledSensor(num_segments, BEND_PERIOD, BEND_NOISE, BEND_STEP, seeds[1]),
        )
        builder.Connect(limb.GetOutputPort("measured_temperature"), thermocouple.get_input_port())
        builder.Connect(limb.GetOutputPort("bend_angle"), bend_sensor.get_input_port())
        builder.ExportInput(limb.GetInputPort("duty"), "duty")
        builder.ExportOutput(thermocouple.get_output_port(), "measured_temperature")
        builder.ExportOutput(bend_sensor.get_output_port(), "bend_angle")
        builder.BuildInto(self)
        self.set_name("limb_twin")
