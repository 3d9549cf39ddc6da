"""A limb on a serial port: the firmware on an emulated board, over a pseudo-terminal."""

import copy
import dataclasses
import functools
import json
import signal
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.trajectories import PiecewisePolynomial

from hardware import HardwareError, LimbTwin, ReplayError, SerialLimb, replay
from hardware.replaying import check_replayable
from limb_systems import (
    EmulatedLimb,
    LimbError,
    LimbParameters,
    Recording,
    SerialBoard,
    simulate,
)
from limb_systems.simulation import PERIOD
from planners import plan, references
from soft_limb.command import main
from soft_limb.runs.rollout import make_controller
from walking import BodyParameters, RobotLimb, RobotParameters

from .conftest import SimulatedBoard, VirtualBoard, start_heating, wait_for


@pytest.fixture(scope="module")
def short_plan():
    """Four seconds of warming up, as much as a board allows that was just switched on."""
    parameters = LimbParameters()
    parameters.temperature_limits.warm_up_time = 100.0
    return plan(parameters, references.from_samples([0.0, 4.0], [0.0, 0.085]), knot_rate=10.0)


def test_a_robot_of_six_wires_has_its_ports_and_heats_on_one_board(virtual_time):
    in_space = RobotLimb("front", parameters=LimbParameters.in_space(wires=4))
    limbs = [RobotLimb("rear"), in_space]
    limb = RobotParameters(body=BodyParameters("free"), limbs=limbs).as_single_limb
    board = VirtualBoard(virtual_time, twin=LimbTwin(limb))
    with pytest.raises(LimbError, match=r"has 2 wires and 1 bend angles, but .* has 6"):
        SerialLimb(board.port)
    with SerialLimb(board.port, limb) as robot:
        sizes = {"measured_temperature": 6, "bend_angle": 3, "applied_duty": 6}
        for name, size in {**sizes, "measurement": 9}.items():
            assert robot.GetOutputPort(name).size() == size
        duty = [0.05, 0.0, 0.1, 0.02, 0.03, 0.0]
        recording = simulate(robot, duty, 1.0)
        heated = board.events("duty")[-1]
    np.testing.assert_allclose(recording.applied_duty[:, -1], duty, atol=1e-4)
    assert [heated[name] for name in limb.wire_names] == pytest.approx(duty)
    assert recording.bend_angle.shape[0] == 3
    virtual_time.sleep(0.01)
    assert not any(board.events("duty")[-1][name] for name in limb.wire_names)


def test_a_robot_that_cannot_be_built_leaves_its_port(virtual_time, monkeypatch):
    board = VirtualBoard(virtual_time)
    with monkeypatch.context() as patch:
        patch.setattr("hardware.board.serial_limb.declare_state_output", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError) as error:
            SerialLimb(board.port)
    SerialLimb(board.port).close()  # while the traceback still has the first one
    assert error


def test_a_command_that_fails_switches_off_at_once(virtual_time):
    """Before the simulation ends by its error, a period later."""
    board = VirtualBoard(virtual_time)
    with SerialLimb(board.port) as robot:
        simulator = Simulator(robot)
        duty = robot.GetInputPort("duty")
        duty.FixValue(simulator.get_mutable_context(), [0.0, 0.1])
        simulator.Initialize()
        for tick in range(5):
            simulator.AdvanceTo((tick + 0.5) * PERIOD)
            virtual_time.sleep(PERIOD)
        assert any(board.duty())
        duty.FixValue(simulator.get_mutable_context(), [0.0, 1.1])
        simulator.AdvanceTo(5.5 * PERIOD)
        virtual_time.sleep(0.02)
        assert not any(board.duty())


def test_replay_sends_the_plan_and_records_all_of_it(virtual_time, emulator, short_plan, tmp_path):
    limb = SerialLimb(emulator.port, short_plan.parameters)
    recording = replay(short_plan, limb, journal=tmp_path / "journal.csv")
    assert len(recording.time) == 81
    assert limb.link.lost_samples == 0
    planned = short_plan.duty_trajectory().vector_values(recording.time)
    np.testing.assert_allclose(recording.duty, planned, atol=1e-9)
    # The board applied each of them, in steps of 1/10000.
    applied = np.array([(e["left"], e["right"]) for e in emulator.events("duty")]).T
    missing = np.abs(applied[1][:, np.newaxis] - planned[1, :-1]).min(axis=0)
    assert missing.max() < 1e-4
    virtual_time.sleep(0.01)
    assert emulator.duty() == [0.0, 0.0]  # off at the end
    assert recording.measured_temperature[1, -1] > recording.measured_temperature[1, 0] + 3.0
    # What the board had applied at a sample is what was asked for some samples before.
    before = np.lib.stride_tricks.sliding_window_view(planned[1], 6)
    assert np.abs(before - recording.applied_duty[1, 5:, np.newaxis]).min(axis=1).max() < 1e-4
    assert 0.0 <= recording.sample_age.min() <= recording.sample_age[1:].max() < 0.25
    assert recording.board_time[-1] - recording.board_time[1] == pytest.approx(3.95, abs=0.1)
    journal = Recording.load(tmp_path / "journal.csv")
    for name in ("bend_angle", "applied_duty", "board_time", "sample_age"):
        np.testing.assert_array_equal(getattr(journal, name), getattr(recording, name))
    np.testing.assert_allclose(journal.time, recording.time, atol=1e-9)


@pytest.mark.parametrize("controller", ["open-loop", "plan-feedback"])
def test_a_bad_reading_is_recorded_as_none_and_ends_no_run(
    controller, virtual_time, emulator, short_plan, tmp_path
):
    emulator.order("glitch left 1")
    virtual_time.when(
        lambda: emulator.duty()[1] > 0.05, lambda: emulator.order("glitch right 1"), after=1.0
    )
    limb = SerialLimb(emulator.port, short_plan.parameters)
    recording = replay(
        short_plan,
        limb,
        controller=make_controller(controller, short_plan),
        journal=tmp_path / "journal.csv",
    )
    assert recording.interrupted == ""
    assert len(recording.time) == 81
    has_no_reading = np.isnan(recording.measured_temperature)
    assert has_no_reading.sum(axis=1).tolist() == [0, 2]  # of the left wire it was before
    assert not recording.applied_duty[1, has_no_reading[1]].any()
    assert recording.applied_duty[1, np.roll(has_no_reading[1], 4)].all()
    assert np.isfinite(recording.duty).all()
    journal = Recording.load(tmp_path / "journal.csv")
    np.testing.assert_array_equal(np.isnan(journal.measured_temperature), has_no_reading)


def test_emulated_limb_is_the_same_behind_a_board_and_in_a_simulation():
    """Behind the board the twin does what it does in a simulation, a fraction of a second later.

    While it heats, readings only rise, so that they are between the simulation's of now and of
    a while ago, but for the sensors' noise, drift and steps: 2 °C and 3°.
    """
    board = SimulatedBoard(LimbTwin(), step=5)
    assert board.arm()
    began, times = board.now, 6.5
    for number in range(round(times / 0.05)):  # at first so little that it is not reduced
        board.run(0.05, (0.0, 0.1 if number < 80 else 1.0))
    samples = [s for s in board.samples if began < s.board_time <= began + times]
    time = np.array([s.board_time for s in samples]) - began
    duty = PiecewisePolynomial.ZeroOrderHold([0.0, 4.0, 6.5], [[0.0, 0.0, 0.0], [0.1, 1.0, 1.0]])
    model = simulate(LimbTwin(), duty, times)
    late = 0.3  # s: 0.1 s between readings, and the cable
    for read, simulated, noise in (
        (np.array([s.temperature for s in samples]).T, model.measured_temperature, 2.0),
        (np.array([s.tip_tangent for s in samples]).T / 2, model.bend_angle, np.deg2rad(3.0)),
    ):
        highest = np.maximum.accumulate(simulated, axis=1)
        for values, now, before in zip(read, simulated, highest, strict=True):
            assert (values < np.interp(time, model.time, now) + noise).all()
            assert (values > np.interp(time - late, model.time, before) - noise).all()
    assert np.ptp(model.measured_temperature[1]) > 25.0  # so that a wrong gain is seen
    assert np.rad2deg(np.ptp(model.bend_angle)) > 10.0


def test_plans_that_do_not_fit_a_limb_are_refused(virtual_time, emulator, short_plan):
    def planned(board=None, **signals):
        parameters = copy.deepcopy(short_plan.parameters)
        parameters.board = board or EmulatedLimb(0)
        return dataclasses.replace(short_plan, parameters=parameters, **signals)

    readings = short_plan.measured_temperature
    weak = planned().parameters
    weak.total_duty = 0.1
    hot = planned(measured_temperature=readings + 30.0)
    hotter = planned()
    hotter.parameters.temperature_limits.maximum = 120.0
    for trajectory, limb, said in (
        (planned(SerialBoard("twin0007")), None, "limb twin0007, but the limb on .* is twin0000"),
        (planned(EmulatedLimb(5)), None, "limb twin0005, but the limb on .* is twin0000"),
        (planned(), weak, r"duties add up to \d\.\d\d at .* total_duty is 0.1; raise"),
        (hot, None, r"left wire is at .* but the trajectory starts at 55\.0"),
        (hotter, hotter.parameters, "board switches off at 110 °C"),
    ):
        with pytest.raises(ReplayError, match=said):
            replay(trajectory, SerialLimb(emulator.port, limb))
    with SerialLimb(emulator.port, planned().parameters) as robot:
        check_replayable(planned(), robot)
        with pytest.warns(UserWarning, match=r"starts at 30\.0 °C; .* soft-limb plan --start 2"):
            check_replayable(planned(measured_temperature=readings + 5.0), robot)
        emulator.order("open right")
        virtual_time.sleep(0.3)
        with pytest.raises(HardwareError, match="no reading of each wire: a thermocouple is open"):
            check_replayable(planned(), robot)
    assert emulator.duty() == [0.0, 0.0]


def test_taught_motion_becomes_a_reference(emulator, tmp_path, capsys):
    output = tmp_path / "taught.csv"
    assert main(["teach", emulator.port, "-o", str(output), "-t", "1.5"]) == 0
    said = capsys.readouterr().out
    assert "taught      1.5 s" in said
    recording = Recording.load(output)
    assert len(recording.time) == 31
    assert np.ptp(recording.bend_angle) > 0.0
    assert all(event["right"] == event["left"] == 0.0 for event in emulator.events("duty"))
    reference = references.from_recording(recording, smoothing_time=0.5)
    assert reference.end_time() == pytest.approx(1.5)


def test_a_gap_is_no_end_where_nothing_is_heated(emulator, virtual_time, tmp_path, capsys):
    begin = virtual_time.monotonic() + 2.0
    for seconds, order in ((0.0, "drop 1"), (0.6, "drop 0")):
        virtual_time.when(
            lambda due=begin + seconds: virtual_time.monotonic() >= due,
            functools.partial(emulator.order, order),
        )
    output = tmp_path / "taught.csv"
    assert main(["teach", emulator.port, "-o", str(output), "-t", "4"]) == 0
    assert "missing" in capsys.readouterr().out
    missing = Recording.load(output).missing
    assert 0 < missing.sum() < len(missing) / 2
    assert not missing[0]


def test_an_emulated_hand_teaches(tmp_path, capsys):
    output = str(tmp_path / "taught.csv")
    teach = ["teach", "-o", output, "-t", "12", "--force"]
    assert main([*teach, "--emulated", "3"]) == 0
    recording = Recording.load(output)
    assert recording.source.startswith("emulated limb")
    assert recording.duty.max() == 0.0
    at = np.interp([6.3, 11.0], recording.time, np.rad2deg(recording.bend_angle[0]))
    np.testing.assert_allclose(at, [15.0, 5.7], atol=3.0)  # 15° sin(t / 4), and the sensor
    assert main(teach) == 1
    assert main([*teach, "port", "--emulated", "3"]) == 1
    said = capsys.readouterr()
    assert "An emulated hand moves the limb" in said.out
    assert said.err.count("Give the PORT of a board, or --emulated SEED") == 2


def test_status_without_a_port_lists_the_serial_ports(monkeypatch, capsys):
    found = [SimpleNamespace(device="/dev/ttyACM0", description="J-Link")]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: found)
    assert main(["status"]) == 0
    assert main(["status", "--json"]) == 0
    assert main(["status", "--clear"]) == 1
    said = capsys.readouterr()
    text, as_json = said.out.splitlines()
    assert text.split() == ["/dev/ttyACM0", "J-Link"]
    assert json.loads(as_json)["ports"] == [{"port": "/dev/ttyACM0", "description": "J-Link"}]
    assert "needs the PORT of a board" in said.err


def test_status_says_how_the_board_is(virtual_time, emulator, capsys):
    assert main(["status", emulator.port]) == 0
    said = capsys.readouterr().out
    assert "board       twin0000, firmware 5" in said
    assert "off: it was just switched on" in said
    assert main(["status", emulator.port, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["armed"] is False
    emulator.order("open left")
    virtual_time.sleep(0.2)
    assert main(["status", emulator.port]) == 0
    assert "a thermocouple is open" in capsys.readouterr().out
    emulator.order("mend")
    virtual_time.sleep(0.2)
    assert main(["status", emulator.port, "--clear"]) == 0
    assert "thermocouple" not in capsys.readouterr().out.split("wires")[0]


def test_arm_check_heats_nothing_that_is_hot(virtual_time, emulator, capsys):
    emulator.order("hot left")
    virtual_time.sleep(0.2)
    arm_check = ["arm-check", emulator.port, "--supply", "7", "--cut-off"]
    assert main(arm_check) == 1
    said = capsys.readouterr().out
    assert "FAILED   left thermocouple reads 115.0 °C; cold wires have 5 to 45 °C" in said
    assert emulator.duty() == [0.0, 0.0]
    assert main([*arm_check, "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert said["passed"] is False
    assert [check["passed"] for check in said["checks"]] == [True] * 3 + [False, True, True]
    assert "left thermocouple reads 115.0 °C" in said["checks"][3]["what"]


# The board of these is a process of its own, which is busy as long as it is there.


def test_a_host_that_freezes_leaves_the_wires_off_and_its_recording(
    real_emulator, start_host, fig5_plan, tmp_path
):
    """It is killed while it is frozen, and so cannot write anything any more."""
    fig5_plan.save(tmp_path / "plan.csv")
    output, journal = tmp_path / "recording.csv", tmp_path / "recording.unfinished.csv"
    output.write_text("old")
    command = [sys.executable, "-m", "soft_limb", "replay", tmp_path / "plan.csv", "-o", output]
    command += ["-p", real_emulator.port, "--force"]
    process = start_heating(real_emulator, lambda: start_host(command))
    # A recording in which a duty was applied is on the disk, or the host is late and has ended.
    assert wait_for(lambda: len(journal.read_bytes()) > 10_000 or process.poll() is not None)
    process.send_signal(signal.SIGSTOP)
    assert wait_for(lambda: real_emulator.duty() == [0.0, 0.0])  # by the heartbeat
    process.kill()
    process.wait()
    assert output.read_text() == "old"
    recording = Recording.load(journal, unfinished=True)
    assert recording.duty[1, -1] > 0.0
    assert main(["show", str(journal), "--recover", str(tmp_path / "whole.csv")]) == 0
    assert len(Recording.load(tmp_path / "whole.csv").time) == len(recording.time)


def test_orders_that_come_together_are_obeyed_but_for_those_that_make_no_sense(real_emulator):
    assert real_emulator.next.split() == ["next", "soft-limb", "status", real_emulator.port]
    real_emulator.process.stdin.write("explode\nopen left\n")
    real_emulator.process.stdin.flush()
    assert wait_for(lambda: len(real_emulator.events("order")) == 2)  # the first is its restart
    assert real_emulator.events("order")[1]["order"] == "open left"
    assert "'explode" in real_emulator.errors.read_text()
