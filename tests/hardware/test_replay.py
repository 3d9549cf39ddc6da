"""Replay and the tracking errors of Table I."""

import dataclasses
import json

import numpy as np
import pytest

from hardware import LimbTwin, ReplayError, replay
from hardware.__main__ import main
from hardware.sensors import SensedLimb
from limb_systems import Limb, LimbError, LimbParameters, Recording
from limb_systems.tracking import tracking_errors


def test_replay_on_the_model_itself_follows_the_plan(fig5_plan):
    recording = replay(fig5_plan, Limb(fig5_plan.parameters))
    errors = tracking_errors(fig5_plan, [recording])
    assert np.rad2deg(errors.percentile_90) < 0.1
    np.testing.assert_allclose(recording.time, np.arange(1201) / 20, atol=1e-9)
    planned = [np.interp(recording.time, fig5_plan.time, duty) for duty in fig5_plan.duty]
    np.testing.assert_allclose(recording.duty, planned, atol=1e-9)


def test_rollouts_behind_sensors_have_errors_of_the_size_of_their_noise(fig5_plan):
    rollouts = [
        replay(fig5_plan, SensedLimb(Limb(fig5_plan.parameters), seed=s)) for s in range(20)
    ]
    errors = tracking_errors(fig5_plan, rollouts)
    # Noise of 0.5° and drift of 1° are normal of σ = 1.12°: |w| has the mean √(2/π) σ and the
    # median 0.674 σ. Few drifts are seen in 20 min, which is what the tolerance is for.
    assert np.rad2deg(errors.mean) == pytest.approx(np.sqrt(2 / np.pi) * 1.12, rel=0.3)
    assert np.rad2deg(errors.median) == pytest.approx(0.674 * 1.12, rel=0.3)


def test_rollouts_on_the_twin_say_that_they_are_emulated(fig5_plan):
    assert "emulated" in replay(fig5_plan, LimbTwin(seed=1)).source


def shifted(trajectory, degrees):
    """A recording that is off the plan by the given angles, sample by sample."""
    time = np.linspace(0.0, trajectory.duration, len(degrees))
    return Recording(
        time=time,
        duty=np.zeros((2, len(time))),
        measured_temperature=np.full((2, len(time)), 25.0),
        bend_angle=trajectory.bend_angle_at(time) + np.deg2rad(degrees),
        parameters=trajectory.parameters,
        source="made up",
        sample_rate=1.0,
    )


def test_tracking_errors_are_those_counted_by_hand(fig5_plan):
    recordings = [shifted(fig5_plan, [0, -1, 2, -3, 4]), shifted(fig5_plan, [5, 6, -7, 8, -9])]
    errors = tracking_errors(fig5_plan, recordings)
    assert np.rad2deg(errors.mean) == pytest.approx(4.5)
    assert np.rad2deg(errors.median) == pytest.approx(4.5)
    assert np.rad2deg(errors.percentile_90) == pytest.approx(8.1)


def test_nothing_to_compare_is_said(fig5_plan):
    with pytest.raises(LimbError, match="no recorded samples"):
        tracking_errors(fig5_plan, [])


def test_a_plan_for_another_kind_of_limb_is_refused(fig5_plan, two_segments):
    with pytest.raises(ReplayError, match="drives 2 wires, but the limb has 4"):
        replay(fig5_plan, LimbTwin(two_segments))


def test_a_plan_hotter_than_the_limb_allows_is_refused(fig5_plan):
    cooler = LimbParameters()
    cooler.temperature_limits.maximum = 80.0
    with pytest.raises(ReplayError, match=r"heats a wire to 92\.4 °C, .*maximum is 80 °C"):
        replay(fig5_plan, LimbTwin(cooler))


def test_a_plan_that_failed_its_check_is_refused(fig5_plan):
    check = dataclasses.replace(fig5_plan.check, largest_difference_deg=0.5)
    with pytest.raises(ReplayError, match="failed its check"):
        replay(dataclasses.replace(fig5_plan, check=check), LimbTwin())


def test_command_replays_and_writes_a_recording(fig5_plan, tmp_path, capsys):
    fig5_plan.save(tmp_path / "plan.csv")
    output = tmp_path / "recording.csv"
    assert main(["replay", str(tmp_path / "plan.csv"), "-o", str(output)]) == 0
    assert len(Recording.load(output).time) == 1201
    assert "emulated" in capsys.readouterr().out


def test_json_says_what_is_in_the_recording(fig5_plan, tmp_path, capsys):
    fig5_plan.save(tmp_path / "plan.csv")
    output = tmp_path / "recording.csv"
    arguments = ["replay", str(tmp_path / "plan.csv"), "-o", str(output)]
    assert main([*arguments, "--seed", "3", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    recording = Recording.load(output)
    errors = tracking_errors(fig5_plan, [recording])
    assert said["tracking"] == {
        "mean_deg": pytest.approx(np.rad2deg(errors.mean)),
        "median_deg": pytest.approx(np.rad2deg(errors.median)),
        "percentile_90_deg": pytest.approx(np.rad2deg(errors.percentile_90)),
    }
    assert said["source"] == recording.source
    assert said["timing"] is None  # simulated time
    assert said["written"] == [str(output)]


def test_command_says_what_is_wrong_with_a_file(tmp_path, capsys):
    (tmp_path / "plan.csv").write_text("time,duty\n0,1\n")
    output = tmp_path / "recording.csv"
    assert main(["replay", str(tmp_path / "plan.csv"), "-o", str(output)]) == 1
    error = capsys.readouterr().err
    assert "plan.csv: this is not a limb trajectory" in error
    assert not output.exists()
