"""Limbs that rest bent: simulations of recordings start where the limb rests."""

import numpy as np
import pytest

from calibration import fit_damping, validate
from limb_systems import Limb, LimbParameters, SegmentParameters, simulate


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
