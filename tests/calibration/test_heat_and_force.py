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
from calibration.recordings.repair import without_spikes
from calibration.section_v.heat import simulate_heat
from limb_systems import JouleHeating, LinearLaw, ThermocoupleLag

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


def test_delay_shifts_the_response():
    duty, delay = np.repeat([0.0, 0.3, 0.1, 0.4], 100), 0.73
    late = simulate_heat(LinearLaw(-0.07, 20.0, -1.0), duty, 0.05, 25.0, (25.0, 25.0), delay)[1]
    fine = np.repeat(duty, 10)  # at 200 Hz every delay above is a whole number of samples
    exact = simulate_heat(LinearLaw(-0.07, 20.0, -1.0), fine, 0.005, 25.0, (25.0, 25.0))[1]
    times = np.arange(400) * 0.05 + 0.045  # a held value reaches back by a whole sample
    expected = np.interp(times - delay, np.arange(4000) * 0.005, exact, left=25.0)
    np.testing.assert_allclose(late, expected, atol=0.02)


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


def test_bend_per_degree_is_that_of_the_equilibrium(heat_fits):
    """(11), (12): φ = (n + 1)/2 β (T - T0) / k."""
    assert heat_fits[1].angle_per_degree.value == pytest.approx(3 * 4.7e-4 / 0.115, rel=0.01)


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


def test_a_wire_that_bends_the_limb_to_the_other_side_is_refused(
    true_limb, model_recordings, heat_fits
):
    (recording,) = model_recordings["right"]
    heat = heat_fits[1]
    reversed_sensor = dataclasses.replace(recording, bend_angle=-recording.bend_angle)
    with pytest.raises(CalibrationError, match="right wire bends the limb away from its own side"):
        fit_force(true_limb, reversed_sensor, 1, heat, Estimate(0.115, 0.0, "N·m/rad"))


def noisy(recording, seed):
    """White noise of 0.3 °C and 0.5°, and a drift of the bend of 1° over minutes."""
    generator = np.random.default_rng(seed)
    drift, memory = np.empty(len(recording.time)), np.exp(-0.05 / 120.0)
    drift[0] = generator.normal()
    for k in range(1, len(drift)):
        drift[k] = memory * drift[k - 1] + np.sqrt(1 - memory**2) * generator.normal()
    angle = drift + 0.5 * generator.normal(size=len(drift))
    return dataclasses.replace(
        recording,
        bend_angle=recording.bend_angle + np.deg2rad(angle),
        measured_temperature=recording.measured_temperature
        + 0.3 * generator.normal(size=recording.measured_temperature.shape),
    )


def test_standard_errors_cover_the_truth(true_limb, model_recordings):
    """A short version of benchmarks/calibration_accuracy.py."""
    wire = true_limb.segments[0].wire("right").law
    covered = dict.fromkeys(("a1", "a2", "a3"), 0)
    values, told = [], []
    for seed in range(15):
        fit = fit_heat_transfer(noisy(model_recordings["right"][0], seed), 1, 23.0)
        for name in covered:
            estimate, truth = getattr(fit, name), getattr(wire, name)
            assert estimate.value == pytest.approx(truth, rel=0.1)
            covered[name] += abs(estimate.value - truth) < 1.96 * estimate.standard_error
        values.append([fit.a1.value, fit.a2.value, fit.a3.value])
        told.append(fit.covariance)
    # 95% of 15 are 14.25; the readings here are not late, unlike what a3's fit expects.
    assert min(covered["a1"], covered["a2"]) >= 11
    assert covered["a3"] >= 7
    # What is said of errors that go together is how the estimates scatter together.
    said = np.mean(told, axis=0)
    said /= np.sqrt(np.outer(np.diag(said), np.diag(said)))
    assert said[0, 1] == pytest.approx(np.corrcoef(np.transpose(values))[0, 1], abs=0.05)
    assert said[0, 1] < -0.9  # a wire that heats more must cool more


def test_a_wire_that_was_never_warm_is_refused(model_recordings):
    (recording,) = model_recordings["right"]
    cold = dataclasses.replace(
        recording, measured_temperature=np.full_like(recording.measured_temperature, 23.0)
    )
    with pytest.raises(CalibrationError, match="right wire was never warm"):
        fit_heat_transfer(cold, 1, 23.0)
    with pytest.raises(CalibrationError, match="left wire was never heated"):
        fit_heat_transfer(recording, 0, 23.0)


def test_a_limb_that_never_bends_is_refused(model_recordings):
    (recording,) = model_recordings["right"]
    straight = dataclasses.replace(recording, bend_angle=0.01 * recording.bend_angle)
    with pytest.raises(CalibrationError, match="too little to estimate its temperature"):
        fit_heat_transfer(straight, 1, 23.0)


def test_bend_that_is_not_proportional_is_remarked(model_recordings):
    (recording,) = model_recordings["right"]
    bent = np.deg2rad(45.0) * (recording.bend_angle / np.deg2rad(45.0)).clip(0) ** 3
    fit = fit_heat_transfer(dataclasses.replace(recording, bend_angle=bent), 1, 23.0)
    assert any("not proportional" in remark.sentence for remark in fit.remarks)


def test_a_limb_that_never_rests_is_refused(true_limb, model_recordings, heat_fits):
    (recording,) = model_recordings["right"]
    heat = heat_fits[1]
    shaken = recording.bend_angle + np.deg2rad(5.0) * np.sin(0.9 * recording.time)
    restless = dataclasses.replace(recording, bend_angle=shaken)
    with pytest.raises(CalibrationError, match="never rests while the right wire is warm"):
        fit_force(true_limb, restless, 1, heat, Estimate(0.115, 0.0, "N·m/rad"))


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


def test_two_segments_are_calibrated_one_by_one(two_segments, model_recordings, heat_fits):
    heat = heat_fits[1]
    with pytest.raises(Exception, match="calibrate each of them alone"):
        fit_force(
            two_segments, model_recordings["right"][0], 1, heat, Estimate(0.1, 0.0, "N·m/rad")
        )


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


def test_spikes_are_told_from_the_peaks_of_slow_loggers():
    rise = np.concatenate([np.full(40, 25.0), 25.0 + 12.0 * np.arange(1, 5)])
    peak = np.concatenate([rise, 25.0 + 48.0 * 0.8 ** np.arange(1, 40)])
    np.testing.assert_array_equal(without_spikes(peak), peak)
    spiked = peak.copy()
    spiked[20] += 40.0
    assert without_spikes(spiked)[20] == 25.0


def test_slow_loggers_are_enough_for_heat_and_force(true_limb, model_recordings, logged):
    wire, spring = true_limb.segments[0].wire("right").law, Estimate(0.115, 0.0, "N·m/rad")
    slow = logged(model_recordings["right"][0], 1.0)
    fit = fit_heat_transfer(slow, 1, 23.0)
    for name in ("a1", "a2", "a3"):
        assert getattr(fit, name).value == pytest.approx(getattr(wire, name), rel=0.05)
    beta = fit_force(true_limb, slow, 1, fit, spring).beta
    assert beta.value == pytest.approx(wire.beta, rel=0.02)
