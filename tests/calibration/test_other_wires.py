"""Limbs whose wires are not left and right: other names, another order, another number."""

import copy
import re

import numpy as np
import pytest

from calibration import (
    calibrate,
    collect_equilibria,
    collect_sag,
    kinds_of,
    save_recordings,
)
from hardware import replay
from limb_systems import (
    Limb,
    LimbParameters,
    LinearLaw,
    WireParameters,
    joint_angles_from_bend_angle,
    simulate,
)
from planners import plan, references


def limb_with(*wires) -> LimbParameters:
    limb = LimbParameters(ambient_temperature=23.0)
    limb.segments[0].wires = list(wires)
    return limb


@pytest.fixture(scope="module")
def dorsal_and_ventral() -> LimbParameters:
    """The wire that bends towards +E2 is the first, and oblique: 0.8 of its torque bends."""
    limb = limb_with(
        WireParameters("dorsal", 0.004, 0.003, LinearLaw(-0.06, 24.0, -1.3, 6.0e-4)),
        WireParameters("ventral", -0.003, 0.0, LinearLaw(-0.07, 20.0, -0.8, 4.7e-4)),
    )
    limb.segments[0].stiffness = 0.115
    return limb


@pytest.fixture(scope="module")
def folder(dorsal_and_ventral, tmp_path_factory):
    """Recordings of the model, as files."""
    folder = tmp_path_factory.mktemp("dorsal")
    mounted = copy.deepcopy(dorsal_and_ventral)
    mounted.gravity = [0.0, -9.81, 0.0]
    bent = joint_angles_from_bend_angle(dorsal_and_ventral, [np.pi / 4])
    state = np.concatenate([bent, 0 * bent, np.full(4, 23.0)])
    swing = simulate(
        Limb(dorsal_and_ventral), [0.0, 0.0], 4.0, sample_rate=100.0, initial_state=state
    )
    recordings = {"sag": [collect_sag(Limb(mounted))], "ring_down": [swing]}
    for seed, kind in enumerate(("dorsal", "ventral", "both")):
        limb = Limb(dorsal_and_ventral)
        recordings[kind] = [collect_equilibria(limb, kind, num_angles=3, seed=seed, longest=30.0)]
    save_recordings(recordings, folder)
    return folder


def test_dorsal_and_ventral_are_planned_and_replayed(dorsal_and_ventral, monkeypatch):
    """In real time, as a robot is, which shows its wires while it runs."""
    reference = references.from_samples([0.0, 1.0], [0.0, 0.05])
    trajectory = plan(dorsal_and_ventral, reference)

    class Robot(Limb):
        __slots__ = ()

        real_time = True

        def close(self):
            pass

    said = []
    monkeypatch.setattr(
        "limb_systems.progress.Progress.update", lambda _, done, remark="": said.append(remark)
    )
    recording = replay(trajectory, Robot(dorsal_and_ventral))
    shown = r"φ  \+\d\.\d°, dorsal \d\d\.\d °C at 0\.\d\d, ventral 23\.0 °C at 0\.00"
    assert re.fullmatch(shown, said[-1]), said[-1]
    np.testing.assert_allclose(recording.bend_angle[0, -1], trajectory.bend_angle[0, -1], atol=2e-3)
    assert recording.measured_temperature[0, -1] > recording.measured_temperature[1, -1]


def test_a_limb_with_one_wire_is_calibrated():
    law = LinearLaw(-0.06, 24.0, -1.3, 6.0e-4)
    limb = limb_with(WireParameters("only", 0.0034, 0.0, law))
    assert list(kinds_of(limb)) == ["sag", "ring_down", "only"]
    recording = collect_equilibria(Limb(limb), "only", num_angles=4, longest=30.0)
    for method in ("paper", "prediction"):
        calibration = calibrate({"only": [recording]}, limb, method=method, laws=[LinearLaw])
        (found,) = calibration.parameters.wires
        for name in ("a1", "a2", "beta"):
            assert getattr(found.law, name) == pytest.approx(getattr(law, name), rel=0.05)
