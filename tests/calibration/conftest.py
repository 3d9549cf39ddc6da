"""Recordings and calibrations that several test files share. Nobody changes them."""

import copy
from pathlib import Path

import numpy as np
import pytest

from calibration import Calibration, calibrate, collect_equilibria, collect_sag
from limb_systems import (
    HystereticLaw,
    Limb,
    LimbParameters,
    LinearLaw,
    SaturatingLaw,
    SegmentParameters,
    joint_angles_from_bend_angle,
    simulate,
)


def two_links() -> LimbParameters:
    """Return a limb that sags about as the nominal one, and that Drake simulates fast."""
    return LimbParameters(segments=[SegmentParameters(links=2, stiffness=0.0623)])


@pytest.fixture
def described() -> LimbParameters:
    """`two_links`, which a test may change."""
    return two_links()


@pytest.fixture(scope="session")
def true_limb() -> LimbParameters:
    """A limb of two links that is not as described."""
    limb = two_links()
    limb.ambient_temperature = 23.0
    segment = limb.segments[0]
    segment.stiffness = 0.0575
    segment.damping = 8e-4
    segment.wires[0].law = LinearLaw(a1=-0.06, a2=24.0, a3=-1.3, beta=4.2e-4)
    segment.wires[1].law.a3 = -0.8
    return limb


@pytest.fixture(scope="session")
def model_recordings(true_limb):
    """By kind, from the model of that limb, without noise: the truth is known."""
    mounted = copy.deepcopy(true_limb)
    mounted.gravity = [0.0, -9.81, 0.0]
    bent = joint_angles_from_bend_angle(true_limb, [np.pi / 4])
    state = np.concatenate([bent, 0 * bent, np.full(4, true_limb.ambient_temperature)])
    ring_down = simulate(Limb(true_limb), [0.0, 0.0], 2.5, sample_rate=100.0, initial_state=state)
    recordings = {"sag": [collect_sag(Limb(mounted))], "ring_down": [ring_down]}
    for kind, num_angles, seed in (("right", 4, 7), ("left", 3, 0), ("both", 3, 2)):
        options = {"num_angles": num_angles, "longest": 40.0, "seed": seed}
        recordings[kind] = [collect_equilibria(Limb(true_limb), kind, **options)]
    return recordings


@pytest.fixture(scope="session")
def by_the_paper(model_recordings) -> Calibration:
    """Those recordings, calibrated as in Sec. V."""
    return calibrate(model_recordings, two_links(), method="paper")


@pytest.fixture(scope="session")
def emulated_folder() -> Path:
    """Recordings of an emulated limb, and the limb that was calibrated from them."""
    return Path(__file__).parents[1] / "data" / "emulated_limb"


@pytest.fixture(scope="session")
def by_prediction(emulated_folder) -> Calibration:
    """The emulated limb, calibrated anew; most of the time would go to laws that are no match."""
    return calibrate(emulated_folder, laws=(SaturatingLaw, HystereticLaw))
