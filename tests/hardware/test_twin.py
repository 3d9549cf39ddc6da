"""The emulated limb: the ports of `Limb`, and sensors with known statistics."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from hardware import LimbTwin
from hardware.sensors import SampledSensor
from limb_systems import Limb, simulate


def port_sizes(system):
    inputs = [system.get_input_port(i) for i in range(system.num_input_ports())]
    outputs = [system.get_output_port(i) for i in range(system.num_output_ports())]
    return (
        {port.get_name(): port.size() for port in inputs},
        {port.get_name(): port.size() for port in outputs},
    )


def test_has_the_ports_of_the_limb(two_segments):
    for parameters in (None, two_segments):
        twin_inputs, twin_outputs = port_sizes(LimbTwin(parameters))
        limb_inputs, limb_outputs = port_sizes(Limb(parameters))
        assert twin_inputs == limb_inputs
        assert twin_outputs == {
            name: limb_outputs[name] for name in ("measured_temperature", "bend_angle")
        }


def test_readings_are_the_model_with_the_stated_noise():
    course = ([0.0, 0.3], 60.0)
    twin, model = simulate(LimbTwin(seed=3), *course), simulate(Limb(), *course)
    bend_error = np.rad2deg(twin.bend_angle - model.bend_angle)[0]
    assert abs(bend_error.mean()) < 4 * 1.0 / np.sqrt(bend_error.size)
    assert bend_error.std() == pytest.approx(1.0, rel=0.1)
    heat_error = twin.measured_temperature[0] - 25.0  # the left wire is off
    # Noise of 0.25 °C and steps of 0.25 °C, whose variance is a twelfth of their square.
    assert heat_error.std() == pytest.approx(0.25 * np.sqrt(1 + 1 / 12), rel=0.1)


def test_readings_come_in_steps_and_are_held_between_samples():
    recording = simulate(LimbTwin(), [0.1, 0.4], 5.0, sample_rate=20.0)
    steps = recording.measured_temperature / 0.25
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    # Thermocouples are read at 10 Hz: at most every second sample at 20 Hz is a new one.
    assert (np.diff(recording.measured_temperature) != 0).sum(axis=1).max() <= 50
    assert len(np.unique(recording.bend_angle)) > 50


def test_the_same_seed_is_the_same_limb_and_another_is_not():
    first, again, other = (
        simulate(LimbTwin(seed=seed), [0.0, 0.2], 3.0).bend_angle for seed in (7, 7, 8)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > np.deg2rad(0.5)


def test_sensor_without_noise_rounds_to_its_step_at_its_period():
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource([0.3, -1.13]))
    sensor = builder.AddSystem(SampledSensor(2, period=0.5, noise=0.0, step=0.25, seed=0))
    builder.Connect(source.get_output_port(), sensor.get_input_port())
    sink = LogVectorOutput(sensor.get_output_port(), builder, 0.1)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.0)
    np.testing.assert_allclose(
        sink.FindLog(simulator.get_context()).data().T, np.tile([0.25, -1.25], (11, 1))
    )
