"""Sweeps: all combinations in one table."""

import csv

import numpy as np
import pytest

from hardware import LimbTwin, replay
from limb_systems import LimbParameters
from planners import plan, references
from soft_limb.command import main


@pytest.fixture
def sweep(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.csv").write_text("0,0\n21,0\n23,8\n25,8\n")

    def run(*words):
        return main(["sweep", "mine.csv", "-j", "1", "-o", "sweep.csv", *words])

    return run


def rows(path):
    with (path / "sweep.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_row_agrees_with_plan_and_replay(sweep, tmp_path, capsys):
    vary = ("--vary", "segments.0.stiffness=0.11,0.12", "--seeds", "3")
    assert sweep(*vary) == 0
    assert "means over limbs" in capsys.readouterr().out
    only, second = rows(tmp_path)
    assert [row["segments.0.stiffness"] for row in (only, second)] == ["0.11", "0.12"]
    assert second["reference_deg"] != only["reference_deg"]
    assert sweep(*vary) == 1  # which does not replace the table
    limb = LimbParameters()
    limb.segments[0].stiffness = 0.11
    trajectory = plan(limb, references.load("mine.csv"))
    recording = replay(trajectory, LimbTwin(limb, seed=3, truth=True))
    bend = 3 * recording.joint_state[:5].mean(axis=0)  # (11), of the true joints
    wanted = np.interp(recording.time, [21.0, 23.0], np.deg2rad([0.0, 8.0]))
    error = np.rad2deg(np.abs(wanted - bend).mean())
    assert float(only["reference_deg"]) == pytest.approx(error, abs=0.05)
    assert float(only["highest_wire_c"]) == pytest.approx(recording.wire_temperature.max(), abs=0.1)
