"""``soft-limb plan`` as a shell sees it."""

import json
import re
import signal

import numpy as np
import pytest

from hardware.board.signals import SIGNALS
from limb_systems import Limb, LimbError, LimbParameters, Trajectory, simulate
from soft_limb.command import main


@pytest.fixture
def quick(tmp_path):
    """Words for a short plan."""
    parameters = LimbParameters()
    parameters.temperature_limits.warm_up_time = 1000.0
    parameters.save(tmp_path / "limb.yaml")
    (tmp_path / "reference.csv").write_text("0,0\n1,0\n3,12\n6,12\n")
    return ["plan", str(tmp_path / "reference.csv"), "-l", str(tmp_path / "limb.yaml")]


def test_plans_and_writes_a_trajectory_pictures_and_a_report(quick, tmp_path, capsys, look_at):
    output, report = tmp_path / "deep" / "plan.csv", tmp_path / "pages" / "plan.html"
    pictures = [tmp_path / "plan.png", tmp_path / "diagnostics.png"]
    words = ["--plot", str(pictures[0]), "--diagnostics", str(pictures[1])]
    assert main([*quick, "-o", str(output), *words, "--report", str(report)]) == 0
    trajectory = Trajectory.load(output)
    assert trajectory.duration == 6.0
    assert all(picture.read_bytes().startswith(b"\x89PNG") for picture in pictures)
    said = capsys.readouterr().out
    assert "check       passed, simulated again: within 0.0" in said
    assert f"written     {output}, {pictures[0]}, {pictures[1]}, {report}\n" in said
    for active in trajectory.check.active_constraints:
        assert re.search(rf"^ {{12}}{active.bound} +at .*{active.start:.1f}", said, re.MULTILINE)
    text = report.read_text(encoding="utf-8")
    missed = np.rad2deg(np.abs(trajectory.bend_angle - trajectory.reference))
    verdict = text.partition('<p class="verdict">')[2].partition("</p>")[0]
    assert "Checked: simulated again, the limb stays within 0.0" in verdict
    assert f"missed by {missed.mean():.2f}° on average, {missed.max():.2f}° at most" in verdict
    links = [report.parent / link for link in re.findall(r'<a href="([^"#]+)">', text)]
    files = [output, tmp_path / "reference.csv", tmp_path / "limb.yaml"]
    assert [link.resolve() for link in links] == files
    look_at(report)


def test_json_agrees_with_the_file(quick, tmp_path, capsys):
    """Here of a recording as the reference."""
    simulate(Limb(), [0.0, 0.05], 4.0).save(tmp_path / "taught.csv")
    output = tmp_path / "plan.csv"
    words = ["plan", str(tmp_path / "taught.csv"), *quick[2:], "-o", str(output), "--json"]
    assert main([*words, "--task", "closed-loop"]) == 0
    said = json.loads(capsys.readouterr().out)
    trajectory = Trajectory.load(output)
    check = trajectory.check
    for name in ("solver", "status", "iterations", "cost", "guess_cost", "largest_difference_deg"):
        assert said[name] == getattr(check, name)
    assert said["total_time_s"] == check.total_time > said["solve_time_s"] == check.solve_time > 0
    assert (said["duration_s"], said["knots"], said["written"]) == (4.0, 41, [str(output)])
    assert said["active_constraints"] == [
        {"bound": active.bound, "start_s": active.start, "end_s": active.end}
        for active in check.active_constraints
    ]
    missed = np.rad2deg(np.abs(trajectory.bend_angle - trajectory.reference))[0]
    assert said["reference_missed_largest_deg"] == pytest.approx(missed.max())
    mean = np.trapezoid(missed, trajectory.time) / 4.0
    assert said["reference_missed_mean_deg"] == pytest.approx(mean, rel=0.02)


def test_signals_end_the_process_at_once_while_it_plans(quick, tmp_path, monkeypatch):
    handlers = []

    def plan(*_, **__):
        handlers.extend(signal.getsignal(number) for number in SIGNALS)
        raise LimbError("no plan")

    monkeypatch.setattr("soft_limb.commands.planners.plan", plan)
    assert main([*quick, "-o", str(tmp_path / "plan.csv")]) == 1
    assert handlers == [signal.SIG_DFL] * len(SIGNALS)


def test_failure_is_one_sentence_status_1_and_no_file(quick, tmp_path, capsys):
    slow = tmp_path / "slow.csv"
    slow.write_text("0,0\n22000,0\n32000,20\n")  # milliseconds for seconds
    output = tmp_path / "plan.csv"
    for words, message in (
        ([*quick, "--knot-rate", "0", "--json"], "knot_rate is 0.0 Hz"),
        ([*quick, "--tolerance", "nan"], "tolerance_deg is nan degrees"),
        ([*quick, "--max-knots", "60"], "makes 61 knots, more than 60"),
        ([*quick, "-l", "nowhere.yaml"], "nowhere.yaml"),
        (["plan", str(slow)], "320,001 knots, more than 20,000; is its time in s?"),
    ):
        assert main([*words, "-o", str(output)]) == 1
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith("error: ")
        assert said.err.count("\n") == 1
        assert message in said.err
        assert not output.exists()
