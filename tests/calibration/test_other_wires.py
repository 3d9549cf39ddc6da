"""A limb whose wires have other names and another order is planned and replayed."""

import re

import numpy as np

from hardware import replay
from limb_systems import Limb, LimbParameters, LinearLaw, WireParameters
from planners import plan, references


def test_dorsal_and_ventral_are_planned_and_replayed(monkeypatch):
    """In real time, as a robot is, which shows its wires while it runs.

    The wire that bends towards +E2 is the first, and oblique: 0.8 of its torque bends.
    """
    limb = LimbParameters(ambient_temperature=23.0)
    limb.segments[0].wires = [
        WireParameters("dorsal", 0.004, 0.003, LinearLaw(-0.06, 24.0, -1.3, 6.0e-4)),
        WireParameters("ventral", -0.003, 0.0, LinearLaw(-0.07, 20.0, -0.8, 4.7e-4)),
    ]
    limb.segments[0].stiffness = 0.115
    trajectory = plan(limb, references.from_samples([0.0, 1.0], [0.0, 0.05]))

    class Robot(Limb):
        __slots__ = ()

        real_time = True

        def close(self):
            pass

    said = []
    monkeypatch.setattr(
        "limb_systems.progress.Progress.update", lambda _, done, remark="": said.append(remark)
    )
    recording = replay(trajectory, Robot(limb))
    shown = r"φ  \+\d\.\d°, dorsal \d\d\.\d °C at 0\.\d\d, ventral 23\.0 °C at 0\.00"
    assert re.fullmatch(shown, said[-1]), said[-1]
    np.testing.assert_allclose(recording.bend_angle[0, -1], trajectory.bend_angle[0, -1], atol=2e-3)
    assert recording.measured_temperature[0, -1] > recording.measured_temperature[1, -1]
