"""Limbs that rest bent: simulations of recordings start where the limb rests."""

import copy

import numpy as np
import pytest

from calibration import fit_damping, validate
from calibration.recordings.at_rest import rest_angle
from calibration.section_v.mechanics import fit_stiffness
from limb_systems import (
    BendSensor,
    Limb,
    LimbParameters,
    Recording,
    SegmentParameters,
    TipTangentSensor,
    simulate,
)
from limb_systems.model.statics import static_equilibrium


@pytest.fixture
def bent() -> LimbParameters:
    return LimbParameters(segments=[SegmentParameters(rest_angle=0.12)])


def test_validation_starts_at_the_rest_angle(bent):
    recording = simulate(Limb(bent), [0.0, 0.1], 3.0, sample_rate=20.0)
    validation = validate(bent, recording)
    assert np.abs(validation.simulation.bend_angle[0, 0] - 0.12) < 1e-9
    assert validation.mean < 0.01


def test_the_model_rings_down_from_where_the_limb_was_released(bent):
    released = np.full(5, (0.12 + np.pi / 4) / 3)
    state = np.concatenate([released, np.zeros(5), np.full(4, 25.0)])
    recording = simulate(
        Limb(bent), [0.0, 0.0], 2.0, sample_rate=100.0, initial_state=state, accuracy=1e-5
    )
    fit = fit_damping(bent, [recording])
    assert fit.damping.value == pytest.approx(bent.segments[0].damping, rel=0.01)
    (measured,), (simulated,) = fit.measured, fit.simulated
    assert simulated.offset == pytest.approx(0.12, abs=0.005)
    assert simulated.amplitude == pytest.approx(measured.amplitude, rel=0.03)


def resting(limb: LimbParameters, shown_extra: float, sensor: BendSensor) -> Recording:
    """Ten seconds of rest, as a sensor shows it that is further off than it is described."""
    described = copy.deepcopy(limb)
    described.segments[0].rest_angle = 0.0
    described.segments[0].bend_sensor = sensor
    angle = sensor.apparent_bend_angle(static_equilibrium(limb)[0]) + shown_extra
    time = np.arange(200) / 20
    noise = np.random.default_rng(0).normal(size=(3, 200))
    return Recording(
        time=time,
        duty=np.zeros((2, 200)),
        measured_temperature=25.0 + 0.2 * noise[:2],
        bend_angle=angle + np.deg2rad(0.3) * noise[2:],
        parameters=described,
        source="made up",
        sample_rate=20.0,
    )


def test_stiffness_of_limbs_that_rest_bent_or_seem_to():
    """The sensor's offset is known or not, degrees."""
    for rests_at, offset, known in ((0.0, 10.0, True), (-25.0, 0.0, True), (5.0, -6.0, False)):
        true = LimbParameters(segments=[SegmentParameters(rest_angle=np.deg2rad(rests_at))])
        mounted = copy.deepcopy(true)
        mounted.gravity = [0.0, -9.81, 0.0]
        extra = 0.0 if known else np.deg2rad(offset)
        sensor = TipTangentSensor(offset=np.deg2rad(offset) if known else 0.0)
        level, sag = (resting(limb, extra, sensor) for limb in (true, mounted))
        rest = rest_angle([level], 25.0)
        assert np.rad2deg(rest.value) == pytest.approx(rests_at + np.rad2deg(extra), abs=0.3)
        start = copy.deepcopy(level.parameters)
        start.segments[0].rest_angle, start.segments[0].stiffness = rest.value, 0.2
        k = fit_stiffness(start, [sag], rest.standard_error).stiffness
        truth = true.segments[0].stiffness
        assert abs(k.value - truth) < 1.96 * k.standard_error < 0.6 * truth
        alone = fit_stiffness(start, [sag]).stiffness
        assert k.standard_error == pytest.approx(np.sqrt(2) * alone.standard_error, rel=0.05)
