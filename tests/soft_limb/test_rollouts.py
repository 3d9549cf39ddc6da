"""Controllers from the shell: replay with one, and teach and go."""

import dataclasses
import json

import numpy as np
import pytest

from hardware import LimbTwin
from limb_systems import Recording, Trajectory, simulate
from limb_systems.files.output import OutputError
from soft_limb.command import main
from soft_limb.runs.rollout import COMMAND_DEADLINE, Rollout, roll_out


def test_replay_by_a_controller_says_so(short_plan, tmp_path, capsys):
    short_plan.save(tmp_path / "plan.csv")
    output, name = tmp_path / "recording.csv", "receding-horizon"
    arguments = ["replay", str(tmp_path / "plan.csv"), "-o", str(output), "--controller", name]
    assert main([*arguments, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    recording = Recording.load(output)
    assert said["controller"] == name
    assert said["source"] == recording.source == "emulated limb, seed 0, driven by RecedingHorizon"
    assert recording.how == "emulated"
    assert said["timing"] is None  # simulated time
    planned = simulate(LimbTwin(), short_plan).duty
    assert np.abs(recording.duty - planned).max() > 0.02
    # Every 0.25 s, from the start to the last moment.
    assert said["replans"] == {"begun": 8, "late": 0, "failed": 0}


def test_an_emulated_replay_on_a_full_disk_keeps_what_was_measured(
    short_plan, tmp_path, full_disk, monkeypatch, capsys
):
    """It gets full on the way, or when all is written again with what only emulations show."""
    short_plan.save(tmp_path / "plan.csv")
    output, unfinished = tmp_path / "recording.csv", tmp_path / "recording.unfinished.csv"
    words = ["replay", str(tmp_path / "plan.csv"), "-o", str(output), "--emulated", "3"]
    assert main(words) == 0
    whole = Recording.load(output)
    header = output.read_text().index("time_s")
    output.unlink()

    with full_disk(header + 1500):
        assert main(words) == 1
    said = capsys.readouterr().err
    assert f"error: Cannot write {output}: " in said
    assert not output.exists()
    kept = Recording.load(unfinished, unfinished=True)
    assert len(kept.time) > 5
    np.testing.assert_array_equal(kept.duty, whole.duty[:, : len(kept.time)])

    def save(recording, path):
        raise OutputError(f"Cannot write {path}: No space left on device.")

    monkeypatch.setattr(Recording, "save", save)
    assert main(words) == 1
    said = capsys.readouterr().err
    assert f"error: Cannot write {output}: No space left on device.\n{output} has what" in said
    np.testing.assert_array_equal(Recording.load(output).bend_angle, whole.bend_angle)


def test_deadlines_that_were_missed_are_counted(short_plan, tmp_path):
    rollout = roll_out(short_plan, lambda: LimbTwin(seed=3), tmp_path / "recording.csv")
    assert rollout.recording.source == "emulated limb, seed 3"
    assert rollout.replans is None
    late = np.array([0.0, 1e-3, COMMAND_DEADLINE + 1e-4, 9e-3])
    counts = np.array([8.0, 2.0, 1.0])
    summary = Rollout("receding-horizon", short_plan, rollout.recording, late, 3, counts).summary()
    timing = summary.to_json()["timing"]
    assert timing["late_median_ms"] == pytest.approx(3.05)
    assert timing["missed_deadline"] == 2
    assert timing["missed_deadline_share"] == 0.5
    assert "2 (50.0%) by more than 5 ms; 3 samples were lost\nsource" in str(summary)
    assert "replans     8 begun, 2 late, 1 failed" in str(summary)


def test_a_bend_that_heat_does_not_explain_gives_a_warning(short_plan):
    """The sensor of a limb that rests drifts by 15° within 12 s."""
    recording = simulate(LimbTwin(), [0.0, 0.0], 12.0)
    drifted = recording.bend_angle + np.deg2rad(1.25) * recording.time
    for bend, told in ((recording.bend_angle, False), (drifted, True)):
        read = dataclasses.replace(recording, bend_angle=bend)
        summary = Rollout("open-loop", short_plan, read, None, None, None).summary()
        assert ("s the bend was read up to" in str(summary)) == told
        assert (summary.to_json()["unexplained"]["longest_s"] > 5.0) == told
    assert "and else calibrate it\n" in f"{summary}\n"  # the plan is of the nominal limb


def test_follow_plans_and_tracks_a_taught_motion(tmp_path, capsys):
    """A motion that the limb cannot do in full: the report tells plan and reference apart."""
    (tmp_path / "taught.csv").write_text("0,0\n0.5,25\n4,25\n")
    folder = tmp_path / "followed"
    arguments = ["follow", str(tmp_path / "taught.csv"), "-o", str(folder)]
    assert main([*arguments, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    names = ("plan.csv", "recording.csv", "report.html")
    assert said["written"] == [str(folder / name) for name in names]
    report = (folder / "report.html").read_text(encoding="utf-8")
    assert all(f'<a href="{name}">' in report for name in names[:-1])
    planned = Trajectory.load(folder / "plan.csv")
    recording = Recording.load(folder / "recording.csv")
    assert said["controller"] == "receding-horizon"
    assert planned.duty.max() == pytest.approx(0.6)  # at the margin of a plan for feedback
    read = recording.measured_temperature[:, 0]  # where the plan begins
    assert planned.measured_temperature[:, 0] == pytest.approx(read, abs=1e-6)
    wanted = np.interp(recording.time, [0.0, 0.5, 4.0], [0.0, 25.0, 25.0])
    missed = np.abs(wanted - np.rad2deg(recording.bend_angle[0])).mean()
    assert said["reference_distance_deg"] == pytest.approx(missed, rel=1e-6)
    asked = np.abs(wanted - np.rad2deg(planned.bend_angle_at(recording.time)[0])).mean()
    assert said["planned_distance_deg"] == pytest.approx(asked, rel=1e-6)
    # Without the margins for feedback it could be nearer.
    nearest = said["nearest_distance_deg"]
    assert nearest < asked - 1.0
    assert (
        f"measured {missed:.2f}°, planned {asked:.2f}°, best possible within the limits "
        f"{nearest:.2f}°" in report
    )
    assert said["highest_readings_c"] == recording.measured_temperature.max(axis=1).tolist()

    assert main(arguments) == 1
    assert "plan.csv exists; give another name, or --force" in capsys.readouterr().err
    # The plan's own model does as planned.
    model = ["--force", "--model", "--controller", "open-loop", "--knot-rate", "2", "--json"]
    assert main([*arguments, *model]) == 0
    assert json.loads(capsys.readouterr().out)["tracking"]["mean_deg"] < 0.1


def test_without_a_reference_or_a_board_nothing_is_planned(tmp_path, capsys):
    folder = tmp_path / "followed"
    for words, said in (
        (["fig5", "-p", str(tmp_path / "no_port")], "Cannot open"),
        ([str(tmp_path / "none.csv")], "none.csv"),
        (["fig5", "--task", "nosuch"], "no task 'nosuch', nor a file of this name; give 'paper',"),
    ):
        assert main(["follow", *words, "-o", str(folder)]) == 1
        assert said in capsys.readouterr().err
        assert not folder.exists()
