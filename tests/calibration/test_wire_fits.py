"""Heat transfer and force, against Drake's simulation of the model that they are fitted to."""

import dataclasses

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from calibration import CalibrationError, Estimate, fit_force, fit_heat_transfer
from calibration.estimate import clustered_covariance, standard_error
from calibration.paper_method.wire_fits import simulate_heat
from calibration.recordings.at_rest import ambient_temperature
from limb_systems import JouleHeating, ThermocoupleLag

SPRING = Estimate(0.0575, 0.0, "N·m/rad")


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


def with_spikes(recording, every=997):
    """With single readings that are far off."""
    bend, measured = recording.bend_angle.copy(), recording.measured_temperature.copy()
    bend[0, every // 2 :: every] -= np.deg2rad(60.0)
    measured[:, every // 3 :: every] += 150.0
    return dataclasses.replace(recording, bend_angle=bend, measured_temperature=measured)


@pytest.mark.parametrize(("index", "side", "spoil"), [(0, "left", None), (1, "right", with_spikes)])
def test_heat_and_force_are_those_that_generated_the_data(
    true_limb, model_recordings, index, side, spoil
):
    """Also where single readings are far off."""
    (recording,) = model_recordings[side]
    recording = spoil(recording) if spoil else recording
    wire, heat = true_limb.segments[0].wire(side).law, fit_heat_transfer(recording, index, 23.0)
    for name in ("a1", "a2", "a3"):
        assert getattr(heat, name).value == pytest.approx(getattr(wire, name), rel=0.03)
    assert heat.remarks == []
    assert heat.temperature_residual < 0.1
    force = fit_force(true_limb, recording, index, heat, SPRING)
    assert force.beta.value == pytest.approx(wire.beta, rel=0.02)
    assert force.remarks == []  # not even of few equilibria
    softer = Estimate(0.02875, 0.002875, "N·m/rad")
    half = fit_force(true_limb, recording, index, heat, softer).beta
    assert half.value == pytest.approx(force.beta.value / 2)
    assert half.standard_error >= 0.1 * half.value  # k's own uncertainty is in it


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
    unidentified = fit_heat_transfer(dataclasses.replace(recording, **seen), 1, 23.0)
    assert unidentified.delay.value == pytest.approx(0.31, abs=0.03)


def reading(recording, wires, change):
    """A recording with other readings of some wires."""
    measured = recording.measured_temperature.copy()
    for wire in wires:
        measured[wire] = change(measured[wire])
    return dataclasses.replace(recording, measured_temperature=measured)


def test_ambient_is_what_unheated_wires_read(model_recordings):
    """Not what a thermocouple reads that is dead or disconnected: noise around zero, or zero."""
    left, right = (model_recordings[side][0] for side in ("left", "right"))
    assert ambient_temperature([left, right]).value == pytest.approx(23.0, abs=0.01)
    random = np.random.default_rng(0)
    sag = reading(model_recordings["sag"][0], (0, 1), lambda v: v + random.normal(size=len(v)))
    for noise in (0.0, 8.0):
        dead = [
            reading(r, (0,), lambda v, n=noise: n * random.normal(size=len(v)))
            for r in (right, sag)
        ]
        ambient = ambient_temperature([*dead, left])
        assert ambient.value == pytest.approx(23.0, abs=0.3)
        assert 0.1 < ambient.standard_error < 1.0
    with pytest.raises(CalibrationError, match="No thermocouple ever moves"):
        ambient_temperature([reading(left, (0, 1), lambda v: 0 * v)])


def test_the_error_of_the_room_is_the_scatter_of_thermocouples_and_recordings(model_recordings):
    """The left wire's are apart by 1 °C; where it is heated they do not count."""
    (sag,) = model_recordings["sag"]
    (left,) = model_recordings["left"]
    recordings = []
    for recording, level in ((sag, 22.0), (sag, 23.0), (sag, 24.0), (left, 24.5)):
        readings = np.full((2, len(recording.time)), [[level], [24.0]])
        readings[:, recording.time - recording.time[0] < 2.0] += 0.1
        recordings.append(dataclasses.replace(recording, measured_temperature=readings))
    ambient = ambient_temperature(recordings)
    assert ambient.value == pytest.approx((23.0 + 24.0) / 2)
    error_of_left = np.sqrt(2 / 3) / np.sqrt(3)
    assert ambient.standard_error == pytest.approx(np.hypot(0.5, error_of_left) / np.sqrt(2))


def test_the_room_is_not_as_warm_as_recordings_that_are_never_cold(model_recordings):
    (right,) = model_recordings["right"]
    cooling = 35.0 + 40.0 * np.exp(-right.time / 15.0)
    signals = {"duty": right.duty[[1, 1]], "measured_temperature": np.array([cooling] * 2)}

    def with_room(described):
        limb = dataclasses.replace(right.parameters, ambient_temperature=described)
        return dataclasses.replace(right, parameters=limb, **signals)

    for described, expected in ((25.0, 25.0), (34.0, 35.0)):
        ambient = ambient_temperature([with_room(described)])
        assert ambient.value == pytest.approx(expected, abs=0.1)
        if described == 25.0:  # where the coldest reading is 10 °C above
            assert ambient.standard_error == pytest.approx(5.0, abs=0.1)
    with pytest.raises(CalibrationError, match=r"are 35 °C, where ambient is 5 °C: .* Fahrenheit"):
        ambient_temperature([with_room(5.0)])


def test_an_error_of_the_room_adds_what_rates_differ_by_in_another_room(model_recordings):
    """In a room that is as much colder; 0.5 °C of some 60 °C."""
    (recording,) = model_recordings["right"]
    exact = fit_heat_transfer(recording, 1, 23.0)
    uncertain = fit_heat_transfer(recording, 1, 23.0, 0.5)
    colder = fit_heat_transfer(recording, 1, 22.5)
    for name in ("a1", "a2", "a3"):
        rate, other, moved = (getattr(fit, name) for fit in (exact, uncertain, colder))
        added = np.sqrt(other.standard_error**2 - rate.standard_error**2)
        expected = abs(moved.value - rate.value)
        assert added == pytest.approx(expected, rel=0.3, abs=3 * rate.standard_error), name
    assert uncertain.a2.standard_error > 3 * exact.a2.standard_error


def test_the_error_of_a_mean_of_clusters_is_the_standard_error_of_their_means():
    """Of five clusters of three equal samples, which count as five values."""
    values = np.random.default_rng(0).normal(size=5)
    residuals = np.repeat(values - values.mean(), 3)
    covariance = clustered_covariance(np.ones((15, 1)), residuals, np.repeat(np.arange(5), 3))
    assert np.sqrt(covariance[0, 0]) == pytest.approx(standard_error(values))
