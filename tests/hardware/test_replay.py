"""Replay and the tracking errors of Table I."""

import dataclasses
import json
import re

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import ConstantVectorSource
from threadpoolctl import threadpool_info, threadpool_limits

from hardware import LimbTwin, ReplayError, replay
from limb_systems import (
    CalibrationRecord,
    Limb,
    LimbError,
    LimbParameters,
    Recording,
    simulate,
)
from limb_systems.tracking import reference_distances, tracking_errors
from soft_limb.command import main

from .conftest import beginning


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


def test_distances_from_the_reference_are_those_counted_by_hand(fig5_plan):
    """A reference 3° above a plan that starts late, and a best plan 1° above it."""
    plan = dataclasses.replace(
        fig5_plan, time=fig5_plan.time + 7.0, reference=fig5_plan.bend_angle + np.deg2rad(3.0)
    )
    rollouts = [shifted(fig5_plan, [0, -1, 2, -3, 4]), shifted(fig5_plan, [5, 6, -7, 8, -9])]
    rollouts[1].bend_angle[0, 2] = np.nan  # missing
    found = reference_distances(plan, rollouts, fig5_plan.bend_angle + np.deg2rad(1.0))
    # |3 - 0|, |3 + 1|, |3 - 2|, |3 + 3|, |3 - 4|; |3 - 5|, |3 - 6|, |3 - 8|, |3 + 9|
    assert np.rad2deg(found.measured) == pytest.approx((3 + 4 + 1 + 6 + 1 + 2 + 3 + 5 + 12) / 9)
    assert np.rad2deg([found.planned, found.nearest]) == pytest.approx([3.0, 2.0])
    alone = reference_distances(plan)
    assert (alone.measured, alone.nearest) == (None, None)
    assert np.rad2deg(alone.planned) == pytest.approx(3.0, abs=1e-3)  # linear between knots


def test_what_no_limb_does_is_left_out_of_tracking_errors(fig5_plan):
    spoilt = shifted(fig5_plan, [0, -1, 2, -3, 4])
    spoilt.bend_angle[0, 2] = np.deg2rad(32767 / 64)
    said = r"Left out of the tracking errors: 1 of 5 samples out of range, the first at 30 s\."
    with pytest.warns(UserWarning, match=said):
        errors = tracking_errors(fig5_plan, [spoilt])
    assert np.rad2deg(errors.mean) == pytest.approx(2.0)
    spoilt.bend_angle[0, 2] = np.nan  # missing, which needs no warning
    assert tracking_errors(fig5_plan, [spoilt]) == errors
    with pytest.raises(LimbError, match="no recorded samples"):
        tracking_errors(fig5_plan, [])
    late = dataclasses.replace(spoilt, time=spoilt.time + fig5_plan.duration + 1.0)
    with pytest.raises(LimbError, match="no recorded samples"):
        tracking_errors(fig5_plan, [late])


def test_a_plan_that_must_not_be_replayed_on_a_limb_is_refused(fig5_plan, two_segments):
    check = dataclasses.replace(fig5_plan.check, largest_difference_deg=0.5)
    failed = dataclasses.replace(fig5_plan, check=check)
    cooler = LimbParameters()
    cooler.temperature_limits.maximum = 80.0
    for trajectory, limb, sentence in (
        (fig5_plan, LimbTwin(two_segments), "drives 2 wires, but the limb has 4"),
        (fig5_plan, LimbTwin(cooler), r"heats a wire to 92\.4 °C, .*maximum is 80 °C"),
        (failed, LimbTwin(), "failed its check"),
    ):
        with pytest.raises(ReplayError, match=sentence):
            replay(trajectory, limb)


class Steady(LeafSystem):
    """A controller: the same duty for both wires, plus what it reads times a gain."""

    def __init__(self, duty=0.1, gain=0.0, **inputs):
        super().__init__()
        ports = [self.DeclareVectorInputPort(name, size) for name, size in inputs.items()]
        self.seen, self.num_threads = [], set()

        def calc(context, output):
            self.seen = [port.Eval(context) for port in ports]
            blas = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
            self.num_threads = {pool["num_threads"] for pool in blas}
            output.SetFromVector(np.full(2, duty + gain * sum(x.sum() for x in self.seen)))

        self.DeclareVectorOutputPort("duty", 2, calc)


def test_a_controller_drives_the_limb_with_what_it_reads(fig5_plan, tmp_path):
    inputs = {"bend_angle": 1, "measurement": 3, "measured_temperature": 2}
    for limb in (Limb(), LimbTwin(seed=1)):
        controller = Steady(**inputs)
        journal = tmp_path / "journal.csv"
        with threadpool_limits(2, "blas"):
            start = beginning(fig5_plan, 6)
            recording = replay(start, limb, controller=controller, journal=journal)
        assert controller.num_threads == {1}
        np.testing.assert_allclose(recording.duty, 0.1)
        np.testing.assert_allclose(recording.time, np.arange(11) / 20)
        angle, measurement, temperature = controller.seen
        np.testing.assert_array_equal(measurement, [*temperature, *angle])
        np.testing.assert_allclose(temperature, recording.measured_temperature[:, -1])
        kept = Recording.load(journal)
        np.testing.assert_array_equal(kept.duty, recording.duty)
        assert kept.interrupted == recording.interrupted == ""


@pytest.mark.parametrize(
    ("inputs", "sentence"),
    [
        ({"bend_angle": 2}, "takes 2 values at bend_angle, but the limb has 1"),
        ({"torque": 1}, "has an input port torque, but a limb has only the outputs measured"),
    ],
)
def test_a_controller_that_reads_something_else_is_refused(fig5_plan, inputs, sentence):
    with pytest.raises(ReplayError, match=sentence):
        replay(fig5_plan, Limb(), controller=Steady(**inputs))


def test_a_source_without_a_port_for_duty_is_no_controller(fig5_plan):
    with pytest.raises(ReplayError, match="ConstantVectorSource has no output port duty"):
        replay(fig5_plan, Limb(), controller=ConstantVectorSource([0.1, 0.1]))


def test_a_replay_ends_at_the_board_s_limit(fig5_plan, tmp_path, capsys):
    """A plan by which the limb's wires get too hot."""
    eager = dataclasses.replace(beginning(fig5_plan, 201), duty=0 * fig5_plan.duty[:, :201] + 0.7)
    journal = tmp_path / "journal.csv"
    recording = replay(eager, LimbTwin(seed=0), journal=journal)
    assert 1.0 < recording.time[-1] < 19.0
    said = "wire was measured at 110 °C or more, the limit at which a board switches off"
    assert re.fullmatch(f"the (left|right) {said}", recording.interrupted)
    assert recording.measured_temperature[:, -4:].max() >= 110.0
    assert recording.measured_temperature[:, :-4].max() < 110.0
    assert (recording.applied_duty[:, :-1] > 0.6).all()
    kept = Recording.load(journal)
    assert kept.interrupted == recording.interrupted
    np.testing.assert_allclose(kept.time, recording.time, atol=1e-9)
    # Its tracking errors are those until then.
    part = beginning(eager, 1 + int(10 * recording.time[-1]))
    assert tracking_errors(eager, [recording]).mean == pytest.approx(
        tracking_errors(part, [recording]).mean, rel=0.02
    )
    # Simulated plainly, it goes on with its heaters off.
    plain = simulate(LimbTwin(seed=0), eager)
    assert plain.time[-1] == pytest.approx(20.0)
    assert not plain.interrupted
    np.testing.assert_array_equal(plain.bend_angle[:, : len(kept.time)], recording.bend_angle)
    # From the shell it is written, and said.
    eager.save(tmp_path / "plan.csv")
    output = tmp_path / "recording.csv"
    arguments = ["replay", str(tmp_path / "plan.csv"), "-o", str(output), "--emulated", "0"]
    assert main(arguments) == 1
    assert f"interrupted {recording.interrupted}\n" in capsys.readouterr().out
    assert Recording.load(output).interrupted == recording.interrupted


def test_command_replays_and_writes_a_recording(fig5_plan, tmp_path, capsys):
    planned = beginning(fig5_plan, 41)
    planned.save(tmp_path / "plan.csv")
    output, picture = tmp_path / "recording.csv", tmp_path / "tracking.png"
    arguments = ["replay", str(tmp_path / "plan.csv"), "-o", str(output), "--emulated", "3"]
    assert main([*arguments, "--plot", str(picture)]) == 0
    recording = Recording.load(output)
    assert len(recording.time) == 81
    said = capsys.readouterr().out
    assert "emulated" in said
    assert f"written     {output}, {picture}" in said
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main([*arguments, "--json", "--force"]) == 0
    said = json.loads(capsys.readouterr().out)
    errors = tracking_errors(planned, [recording])
    assert said["interrupted"] == ""
    assert said["tracking"] == {
        "mean_deg": pytest.approx(np.rad2deg(errors.mean)),
        "median_deg": pytest.approx(np.rad2deg(errors.median)),
        "percentile_90_deg": pytest.approx(np.rad2deg(errors.percentile_90)),
    }
    assert said["source"] == recording.source
    assert said["timing"] is None  # simulated time
    assert said["written"] == [str(output)]


def test_a_plan_of_a_limb_of_ones_own_is_not_followed_by_another_in_silence(
    fig5_plan, tmp_path, capsys
):
    """An emulated limb stands in with a warning, and the calibrated model on request."""
    planned = beginning(fig5_plan, 41)
    parameters = dataclasses.replace(
        planned.parameters, calibration=CalibrationRecord([], [], [], [])
    )
    planned = dataclasses.replace(planned, parameters=parameters)
    planned.save(tmp_path / "plan.csv")
    arguments = [str(tmp_path / "plan.csv"), "-o", str(tmp_path / "recording.csv")]
    assert main(["replay", *arguments]) == 0
    said = capsys.readouterr()
    assert "unrelated emulated limb, seed 0, follows the plan here" in said.err
    source = "emulated limb, seed 0, not the calibrated one"
    assert f"source      {source}\n" in said.out
    assert Recording.load(tmp_path / "recording.csv").source == source
    assert LimbTwin(parameters).after_rest().source == source
    assert main(["replay", *arguments, "--force", "--model"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert "source      model\n" in said.out
    errors = tracking_errors(planned, [Recording.load(tmp_path / "recording.csv")])
    assert np.rad2deg(errors.percentile_90) < 0.1
