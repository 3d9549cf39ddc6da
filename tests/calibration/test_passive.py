"""Stiffness and damping, against what generated the data, closed forms and a real beam."""

import copy
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from calibration import (
    CalibrationError,
    fit_damped_sinusoid,
    fit_damping,
    fit_stiffness,
)
from calibration.section_v.mechanics import shape_factors
from limb_systems import ChordSensor, LimbParameters, Recording, TipTangentSensor
from limb_systems.model.statics import static_equilibrium

RING_DOWNS = Path(__file__).parents[1] / "data" / "silicone_ring_down"


def sagging(parameters, angle, trials=1, spread=0.0, sensor=None):
    """Recordings of a limb at rest at a bend angle, rad, with gravity along -E2."""
    mounted = copy.deepcopy(parameters)
    mounted.segments[0].bend_sensor = sensor or mounted.segments[0].bend_sensor
    mounted.gravity = [0.0, -9.81, 0.0]
    time = np.arange(120) / 20
    return [
        Recording(
            time=time,
            duty=np.zeros((2, 120)),
            measured_temperature=np.full((2, 120), 25.0),
            bend_angle=np.full((1, 120), angle + spread * deviation),
            parameters=mounted,
            source="made up",
            sample_rate=20.0,
        )
        for deviation in np.linspace(-1, 1, trials)
    ]


def limb_with_ten_degrees_of_sag(links, sensor):
    """Its stiffness by bisection on the plant's statics."""
    limb = LimbParameters(gravity=[0.0, -9.81, 0.0])
    limb.segments[0].links = links
    low, high = 0.02, 0.5
    for _ in range(15):
        limb.segments[0].stiffness = (low + high) / 2
        sag = -sensor.apparent_bend_angle(static_equilibrium(limb)[0])
        low, high = (
            (limb.segments[0].stiffness, high)
            if sag > np.deg2rad(10)
            else (
                low,
                limb.segments[0].stiffness,
            )
        )
    return limb


def test_correction_factor_is_the_papers_and_stiffness_the_one_that_sags():
    for sensor, links, factor in (
        (ChordSensor(), 4, 1.20),  # the paper's
        (ChordSensor(), 5, 1.22),
        (ChordSensor(), 6, 1.23),
        (TipTangentSensor(), 5, 1.22 * 1.5),  # the chord's angle is 1.5 times α/2 (beam theory)
        (ChordSensor(gain=1.2, offset=0.05), 5, 1.22),
    ):
        limb = limb_with_ten_degrees_of_sag(links, sensor)
        start = LimbParameters()
        start.segments[0].links = links
        fit = fit_stiffness(start, sagging(start, -np.deg2rad(10.0), sensor=sensor))
        assert fit.correction_factor == pytest.approx(factor, abs=0.01)
        by_chord = 1.22 if isinstance(sensor, TipTangentSensor) else factor
        assert fit.chord_factor == pytest.approx(by_chord, abs=0.02)
        assert (f"the same sag has {by_chord:.1f}" in fit.factor_in_words) == (factor != by_chord)
        assert fit.stiffness.value == pytest.approx(limb.segments[0].stiffness, rel=0.01)
        assert fit.simulated_sag == pytest.approx(-np.deg2rad(10.0), rel=0.01)
    np.testing.assert_allclose(shape_factors(5), np.array([25, 16, 9, 4, 1]) / 55)


def test_taking_half_the_tip_tangent_for_the_chord_would_make_the_limb_half_as_stiff_again():
    """What Sec. V-A does: the same numbers, compared with another angle of the model."""
    angle, limb = -np.deg2rad(6.6), LimbParameters()
    stiffness = [
        fit_stiffness(limb, sagging(limb, angle, sensor=sensor)).stiffness.value
        for sensor in (ChordSensor(), TipTangentSensor())
    ]
    assert stiffness[0] / stiffness[1] == pytest.approx(1.5, abs=0.04)


def test_stiffness_is_as_uncertain_as_its_trials_scatter():
    """k is about inversely proportional to the sag, so relative errors are the same."""
    limb = LimbParameters()
    fit = fit_stiffness(limb, sagging(limb, -np.deg2rad(10.0), trials=5, spread=np.deg2rad(2.0)))
    # Student's t with 4 degrees of freedom holds 95% within 2.776, a normal variable within 1.96.
    scatter = np.std(np.linspace(-2, 2, 5), ddof=1) / np.sqrt(5) / 10 * 2.776 / 1.96
    assert fit.stiffness.standard_error / fit.stiffness.value == pytest.approx(scatter, rel=0.1)
    assert fit.remarks == []


def test_scatter_of_the_trials_does_not_make_the_limb_softer():
    limb, angle = LimbParameters(), -np.deg2rad(10.0)
    alike, scattered = (
        fit_stiffness(limb, sagging(limb, angle, trials=5, spread=np.deg2rad(spread)))
        for spread in (0.0, 4.0)
    )
    assert scattered.stiffness.value == pytest.approx(alike.stiffness.value, rel=1e-6)


def test_a_sag_upwards_or_a_limb_in_motion_is_refused():
    limb = LimbParameters()
    with pytest.raises(CalibrationError, match="bends upwards"):
        fit_stiffness(limb, sagging(limb, 0.17))
    (moving,) = sagging(limb, -0.17)
    moving.bend_angle[0] = np.linspace(-0.1, -0.3, 120)
    with pytest.raises(CalibrationError, match="does not rest"):
        fit_stiffness(limb, [moving])


def ring_down(time, frequency=4.6, damping_ratio=0.1, offset=0.0, phase=0.4, release=0.0):
    """A held signal, released into a damped sinusoid, by its closed form."""
    natural = 2 * np.pi * frequency / np.sqrt(1 - damping_ratio**2)
    since = np.maximum(time - release, 0.0)
    wave = np.sin(2 * np.pi * frequency * since + phase) / np.sin(phase)
    return offset + 45.0 * np.exp(-damping_ratio * natural * since) * wave


def test_damped_sinusoid_is_found():
    """With and without velocity at the release, a hold before it, and an offset."""
    time = np.arange(500) / 100
    for frequency, damping_ratio, phase, release, offset in (
        (4.6, 0.12, np.pi / 2, 0.0, 0.0),
        (4.6, 0.12, 0.6, 1.3, -12.0),
        (7.7, 0.05, 0.6, 0.0, -12.0),
        (7.7, 0.05, np.pi / 2, 1.3, 0.0),
        (2.0, 0.3, np.pi / 2, 1.3, -12.0),
        (2.0, 0.3, 0.6, 0.0, 0.0),
    ):
        signal = ring_down(time, frequency, damping_ratio, offset, phase, release)
        fit = fit_damped_sinusoid(time, signal)
        assert fit.frequency == pytest.approx(frequency, rel=5e-3)
        assert fit.damping_ratio == pytest.approx(damping_ratio, rel=2e-2)
        assert fit.offset == pytest.approx(offset, abs=0.3)
        assert release - 0.02 <= fit.start < release + 0.5
        np.testing.assert_allclose(fit(time[-300:]), signal[-300:], atol=0.5)


def test_standard_error_of_the_decay_covers_the_truth():
    time, generator, inside = np.arange(400) / 100, np.random.default_rng(0), 0
    decay = 0.1 * 2 * np.pi * 4.6 / np.sqrt(1 - 0.1**2)
    clean = ring_down(time, phase=np.pi / 2)
    for _ in range(50):
        fit = fit_damped_sinusoid(time, clean + generator.normal(0.0, 1.0, 400))
        inside += abs(fit.decay_rate.value - decay) < 1.96 * fit.decay_rate.standard_error
    assert 43 <= inside <= 50


def test_real_silicone_beam():
    """Raw motion capture, hold included, against careful fits that are known to two digits.

    The beam hangs along x; the tip marker's path is projected on its main direction.
    """
    beams = ("gravity", 7.7, 0.05), ("load52", 4.3, 0.055), ("load101", 3.3, 0.07)
    for name, frequency, damping_ratio in beams:
        table = np.loadtxt(RING_DOWNS / f"{name}.csv", delimiter=",", skiprows=1)
        tip = table[:, 1:4] - table[:, 1:4].mean(axis=0)
        main = np.linalg.svd(tip, full_matrices=False)[2][0]
        fit = fit_damped_sinusoid(table[:, 0], tip @ main)
        # "About 3.3" and "4.3" Hz are rounded by up to 1.5%.
        assert fit.frequency == pytest.approx(frequency, rel=0.02 + 0.05 / frequency)
        assert fit.damping_ratio == pytest.approx(damping_ratio, rel=0.15)


def test_damping_is_the_one_that_generated_the_ring_down(true_limb, model_recordings):
    start = copy.deepcopy(true_limb)
    start.segments[0].damping = 2e-3
    fit = fit_damping(start, model_recordings["ring_down"])
    assert fit.damping.value == pytest.approx(8e-4, rel=0.01)
    assert fit.remarks == []


def held(recording, seconds=1.0):
    """A ring-down with the hold before it, which is 45°."""
    count = round(seconds * recording.sample_rate)
    bend = np.concatenate([np.full(count, np.pi / 4), recording.bend_angle[0]])
    return dataclasses.replace(
        recording,
        time=np.arange(len(bend)) / recording.sample_rate,
        bend_angle=bend[np.newaxis],
        duty=np.zeros((2, len(bend))),
        measured_temperature=np.full((2, len(bend)), 23.0),
        joint_state=None,
        wire_temperature=None,
    )


def test_what_is_too_little_is_refused():
    limb, time = LimbParameters(), np.arange(100) / 100
    with pytest.raises(CalibrationError, match="no recording of the limb's sag"):
        fit_stiffness(limb, [])
    with pytest.raises(CalibrationError, match="no recording of a ring-down"):
        fit_damping(limb, [])
    with pytest.raises(CalibrationError, match="needs at least 20 samples"):
        fit_damped_sinusoid(time[:10], time[:10])
    with pytest.raises(CalibrationError, match=r"moves fastest at 0\.9\d s, at its end"):
        fit_damped_sinusoid(time, np.where(time > 0.955, 1.0, 0.0))
