"""Prediction from what loggers make of recordings: slow, late, spiked, in a room that warms."""

import dataclasses

import numpy as np
import pytest

from calibration.prediction.heated_run import HeatedRun
from calibration.prediction.law_fit import fit_law
from limb_systems import LinearLaw, SegmentParameters


@pytest.fixture(scope="module")
def heated(true_limb, model_recordings):
    """One recording of each wire with the noise of thermocouples and bend sensor, shortened."""
    random = np.random.default_rng(0)

    def noisy(recording):
        count = int(120.0 * recording.sample_rate) + 1
        measured, bend = recording.measured_temperature[:, :count], recording.bend_angle[:, :count]
        return dataclasses.replace(
            recording,
            time=recording.time[:count],
            duty=recording.duty[:, :count],
            measured_temperature=measured + 0.25 * random.normal(size=measured.shape),
            bend_angle=bend + np.deg2rad(0.5) * random.normal(size=bend.shape),
            reference=None,
            joint_state=None,
            wire_temperature=None,
        )

    return [noisy(model_recordings[kind][0]) for kind in ("right", "left")]


def slow(heated, logged, rate):
    return [logged(recording, rate) for recording in heated]


def warming(heated, logged):
    """The room warms by 5 °C in each, and by as much between them: wires are as much above it."""
    result = []
    for number, recording in enumerate(heated):
        rise = 5.0 * (number + recording.time / recording.time[-1])
        result.append(
            dataclasses.replace(
                recording, measured_temperature=recording.measured_temperature + rise
            )
        )
    return result


def spiked(heated, logged):
    result = [dataclasses.replace(r, bend_angle=r.bend_angle.copy()) for r in heated]
    for recording in result:
        recording.bend_angle[0, 100::400] += np.deg2rad(60.0)
    return result


CHANGES = {
    "none": lambda heated, logged: heated,
    "1 Hz": lambda heated, logged: slow(heated, logged, 1.0),
    "a clock that drifts": lambda heated, logged: [
        dataclasses.replace(r, time=1.001 * r.time) for r in heated
    ],
    "warming": warming,
    "spiked": spiked,
}


@pytest.mark.parametrize("name", CHANGES)
def test_laws_are_within_their_errors(true_limb, heated, logged, name):
    runs = [HeatedRun.of(recording) for recording in CHANGES[name](heated, logged)]
    segment = SegmentParameters(stiffness=true_limb.segments[0].stiffness)
    estimates = fit_law(LinearLaw, runs, segment, 23.0).estimates
    for wire in true_limb.segments[0].wires:
        for field in ("a1", "a2", "a3", "beta"):
            found, truth = estimates[f"{wire.name}.{field}"], getattr(wire.law, field)
            assert abs(found.value - truth) < 3 * found.standard_error < 0.9 * abs(truth)
