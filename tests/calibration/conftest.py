"""Recordings of the model itself, whose truth is known."""

import copy
import dataclasses

import numpy as np
import pytest

from calibration import Calibration, calibrate, collect_equilibria, collect_sag
from limb_systems import Limb, LimbParameters, joint_angles_from_bend_angle, simulate


@pytest.fixture(scope="session")
def true_limb() -> LimbParameters:
    """A limb that is not the nominal one."""
    limb = LimbParameters(ambient_temperature=23.0)
    segment = limb.segments[0]
    segment.stiffness, segment.damping = 0.115, 8e-4
    left, right = segment.wires[0].law, segment.wires[1].law
    left.a1, left.a2, left.a3, left.beta = -0.06, 24.0, -1.3, 4.2e-4
    right.a3 = -0.8
    return limb


@pytest.fixture(scope="session")
def model_recordings(true_limb):
    """By kind, from the model, without noise. Not to be changed."""
    mounted = copy.deepcopy(true_limb)
    mounted.gravity = [0.0, -9.81, 0.0]
    bent = joint_angles_from_bend_angle(true_limb, [np.pi / 4])
    state = np.concatenate([bent, 0 * bent, np.full(4, true_limb.ambient_temperature)])
    ring_down = simulate(Limb(true_limb), [0.0, 0.0], 4.0, sample_rate=100.0, initial_state=state)
    recordings = {"sag": [collect_sag(Limb(mounted))], "ring_down": [ring_down]}
    for seed, kind in enumerate(("right", "left", "both")):
        recordings[kind] = [collect_equilibria(Limb(true_limb), kind, num_angles=6, seed=seed)]
    return recordings


@pytest.fixture(scope="session")
def by_the_paper(model_recordings) -> Calibration:
    """Those recordings, calibrated as in Sec. V. Not to be changed."""
    return calibrate(model_recordings, LimbParameters(), method="paper")


@pytest.fixture(scope="session")
def logged():
    """Recordings as loggers of other rates record them."""
    return _logged


def _logged(recording, rate):
    """As a logger of another rate would have recorded it; duty is the mean in between."""
    every = round(recording.sample_rate / rate)
    duty = [np.add.reduceat(d[1:], np.arange(0, len(d) - 1, every)) / every for d in recording.duty]
    count = (len(recording.time) - 1) // every
    rows = np.array(duty)[:, :count]
    signals = {
        name: getattr(recording, name)[..., : count * every + 1 : every]
        for name in ("time", "measured_temperature", "bend_angle")
    }
    return dataclasses.replace(
        recording,
        duty=np.concatenate([rows[:, :1], rows], axis=1),
        sample_rate=rate,
        reference=None,
        joint_state=None,
        wire_temperature=None,
        **signals,
    )
