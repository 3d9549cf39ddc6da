"""Heat transfer and force, against Drake's simulation of the model that they are fitted to."""

import dataclasses

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from calibration import (
    CalibrationError,
    Estimate,
    fit_force,
    fit_heat_transfer,
)
from calibration.recordings.at_rest import ambient_temperature
from calibration.section_v.wires import simulate_heat
from limb_systems import JouleHeating, ThermocoupleLag

SIDES = [(0, "left"), (1, "right")]


def test_simulated_heat_is_drakes(true_limb):
    wire = true_limb.segments[0].wire("left")
    generator = np.random.default_rng(0)
    duty = np.repeat(generator.uniform(0, 0.5, 20), 40)
    times = np.arange(800) / 20
    builder = DiagramBuilder()
    # The duty at a sample is in force since the sample before.
    held = PiecewisePolynomial.ZeroOrderHold(times, [[*duty[1:], 0.0], [0.0] * 800])
    source = builder.AddSystem(TrajectorySource(held))
    heating = builder.AddSystem(JouleHeating(true_limb))
    lag = builder.AddSystem(ThermocoupleLag(true_limb))
    builder.Connect(source.get_output_port(), heating.get_input_port())
    builder.Connect(heating.get_output_port(), lag.get_input_port())
    sinks = [LogVectorOutput(system.get_output_port(), builder, 0.05) for system in (heating, lag)]
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_maximum_step_size(0.01)
    simulator.AdvanceTo(times[-1])
    expected = [sink.FindLog(simulator.get_context()).data()[0, :800] for sink in sinks]
    simulated = simulate_heat(wire.law, duty, 0.05, 23.0, (23.0, 23.0))
    np.testing.assert_allclose(simulated, expected, atol=1e-3)


@pytest.fixture(scope="module")
def heat_fits(model_recordings):
    """The fits of the wires, left and right. Not to be changed."""
    return [fit_heat_transfer(model_recordings[s][0], i, 23.0) for i, s in SIDES]


@pytest.mark.parametrize(("index", "side"), SIDES)
def test_heat_transfer_is_the_one_that_generated_the_data(true_limb, heat_fits, index, side):
    wire, fit = true_limb.segments[0].wire(side).law, heat_fits[index]
    assert fit.a1.value == pytest.approx(wire.a1, rel=0.03)
    assert fit.a2.value == pytest.approx(wire.a2, rel=0.03)
    assert fit.a3.value == pytest.approx(wire.a3, rel=0.03)
    assert fit.remarks == []
    assert fit.temperature_residual < 0.1


def test_what_a_board_says_of_its_samples_takes_the_place_of_a_delay(model_recordings):
    """Samples that are 0.2 s old, or some ms more, and a duty applied 0.1 s after its command."""
    (recording,) = model_recordings["right"]
    time, age = recording.time, np.random.default_rng(0).uniform(0.2, 0.22, len(recording.time))

    def aged(rows, late):
        return np.array([np.interp(time - late, time, row) for row in rows])

    seen = {
        "measured_temperature": aged(recording.measured_temperature, age + 0.1),
        "bend_angle": aged(recording.bend_angle, age + 0.1),
    }
    since = np.searchsorted(time, time - age - 0.1)  # the duty at a sample is that since the last
    told = {"applied_duty": recording.duty[:, since], "sample_age": age}
    fit = fit_heat_transfer(dataclasses.replace(recording, **seen, **told), 1, 23.0)
    assert fit.delay is None
    assert fit.a3.value == pytest.approx(-0.8, rel=0.03)
    untold = fit_heat_transfer(dataclasses.replace(recording, **seen), 1, 23.0)
    assert untold.delay.value == pytest.approx(0.31, abs=0.03)
    only = fit_heat_transfer(dataclasses.replace(recording, **seen, sample_age=age), 1, 23.0)
    assert only.a3 == untold.a3


@pytest.mark.parametrize(("index", "side"), SIDES)
def test_force_is_the_one_that_generated_the_data(
    true_limb, model_recordings, heat_fits, index, side
):
    (recording,), heat = model_recordings[side], heat_fits[index]
    fit = fit_force(true_limb, recording, index, heat, Estimate(0.115, 0.0, "N·m/rad"))
    assert fit.beta.value == pytest.approx(true_limb.segments[0].wire(side).law.beta, rel=0.02)
    assert len(fit.ratios) >= 3
    softer = fit_force(true_limb, recording, index, heat, Estimate(0.0575, 0.00575, "N·m/rad"))
    assert softer.beta.value == pytest.approx(fit.beta.value / 2)
    assert softer.beta.standard_error >= 0.1 * softer.beta.value  # k's own uncertainty is in it


def test_ambient_is_what_unheated_wires_read(model_recordings):
    recordings = [model_recordings[side][0] for side in ("left", "right")]
    assert ambient_temperature(recordings).value == pytest.approx(23.0, abs=0.01)
    with pytest.raises(CalibrationError, match="No thermocouple ever moves"):
        ambient_temperature([changed_reading(recordings[0], (0, 1), lambda v: 0 * v)])


def changed_reading(recording, wires, change):
    """A recording with other readings of some wires."""
    measured = recording.measured_temperature.copy()
    for wire in wires:
        measured[wire] = change(measured[wire])
    return dataclasses.replace(recording, measured_temperature=measured)


@pytest.mark.parametrize("noise", [0.0, 8.0])
def test_a_thermocouple_that_is_dead_or_disconnected_does_not_tell_ambient(model_recordings, noise):
    """It reads noise around zero, or just that."""
    random = np.random.default_rng(0)
    left, right = (model_recordings[side][0] for side in ("left", "right"))
    sag = changed_reading(
        model_recordings["sag"][0], (0, 1), lambda v: v + random.normal(size=len(v))
    )
    dead = [
        changed_reading(r, (0,), lambda v: noise * random.normal(size=len(v))) for r in (right, sag)
    ]
    ambient = ambient_temperature([*dead, left])
    assert ambient.value == pytest.approx(23.0, abs=0.3)
    assert 0.1 < ambient.standard_error < 1.0


def spiked(recording, every=997):
    """With single readings that are far off."""
    bend, measured = recording.bend_angle.copy(), recording.measured_temperature.copy()
    bend[0, every // 2 :: every] -= np.deg2rad(60.0)
    measured[:, every // 3 :: every] += 150.0
    return dataclasses.replace(recording, bend_angle=bend, measured_temperature=measured)


def test_single_spikes_do_not_matter(true_limb, model_recordings):
    (recording,) = model_recordings["right"]
    wire, spring = true_limb.segments[0].wire("right").law, Estimate(0.115, 0.0, "N·m/rad")
    spoilt = spiked(recording)
    fit = fit_heat_transfer(spoilt, 1, 23.0)
    for name in ("a1", "a2", "a3"):
        assert getattr(fit, name).value == pytest.approx(getattr(wire, name), rel=0.03)
    beta = fit_force(true_limb, spoilt, 1, fit, spring).beta
    assert beta.value == pytest.approx(wire.beta, rel=0.005)
