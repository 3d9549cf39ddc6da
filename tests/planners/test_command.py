"""``python -m planners`` as a shell sees it."""

import json

import numpy as np
import pytest

from limb_systems import Limb, LimbParameters, Trajectory, simulate
from planners.__main__ import main


@pytest.fixture
def quick(tmp_path):
    """Arguments for a short plan."""
    parameters = LimbParameters()
    parameters.temperature_limits.warm_up_time = 1000.0
    parameters.save(tmp_path / "limb.yaml")
    (tmp_path / "reference.csv").write_text("0,0\n1,0\n3,12\n6,12\n")
    return [str(tmp_path / "reference.csv"), "-l", str(tmp_path / "limb.yaml")]


def test_plans_and_writes_a_trajectory_and_a_picture(quick, tmp_path, capsys):
    output, picture = tmp_path / "deep" / "plan.csv", tmp_path / "plan.png"
    diagnostics = tmp_path / "diagnostics.png"
    pictures = ["--plot", str(picture), "--diagnostics", str(diagnostics)]
    assert main([*quick, "-o", str(output), *pictures]) == 0
    trajectory = Trajectory.load(output)
    assert trajectory.duration == 6.0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert diagnostics.read_bytes().startswith(b"\x89PNG")
    said = capsys.readouterr().out
    assert "simulated again" in said
    assert str(output) in said


def test_json_says_what_is_in_the_file(quick, tmp_path, capsys):
    output = tmp_path / "plan.csv"
    assert main([*quick, "-o", str(output), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    trajectory = Trajectory.load(output)
    check = trajectory.check
    for name in ("solver", "status", "iterations", "cost", "guess_cost", "largest_difference_deg"):
        assert said[name] == getattr(check, name)
    assert said["solve_time_s"] == check.solve_time > 0.0
    assert said["total_time_s"] == check.total_time > 0.0
    assert said["duration_s"] == 6.0
    assert said["knots"] == len(trajectory.time) == 61
    assert said["active_constraints"] == [
        {"bound": active.bound, "start_s": active.start, "end_s": active.end}
        for active in check.active_constraints
    ]
    assert {active["bound"] for active in said["active_constraints"]} >= {"duty left = 0"}
    missed = np.rad2deg(np.abs(trajectory.bend_angle - trajectory.reference))
    assert said["reference_missed_mean_deg"] == pytest.approx(missed.mean())
    assert said["written"] == [str(output)]


def test_json_of_no_plan_is_nothing(quick, tmp_path, capsys):
    assert main([*quick, "-o", str(tmp_path / "plan.csv"), "--json", "--knot-rate", "0"]) == 1
    assert capsys.readouterr().out == ""


def test_recordings_are_references(quick, tmp_path):
    simulate(Limb(), [0.0, 0.05], 4.0).save(tmp_path / "taught.csv")
    output = tmp_path / "plan.csv"
    assert main([str(tmp_path / "taught.csv"), *quick[1:], "-o", str(output)]) == 0
    assert Trajectory.load(output).duration == 4.0


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--tolerance", "1e-9"], "failed its check"),
        (["--knot-rate", "0"], "knot_rate is 0.0 Hz"),
        (["-l", "nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_failure_is_one_sentence_status_1_and_no_file(quick, tmp_path, capsys, extra, message):
    output = tmp_path / "plan.csv"
    assert main([*quick, "-o", str(output), *extra]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert message in error
    assert not output.exists()
