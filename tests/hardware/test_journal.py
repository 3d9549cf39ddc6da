"""Journals: what is on the disk of a run that ended, and what stays of the runs before it."""

import os
import threading

import numpy as np
import pytest

from hardware import HardwareError, LimbTwin, replay, watch
from limb_systems import Limb, LimbParameters, Recording, Trajectory
from limb_systems.files import table_writer
from limb_systems.files.csv_format import KILLED_REASON
from limb_systems.files.output import OutputError
from limb_systems.progress import Progress
from planners import plan, references
from soft_limb.command import main


@pytest.fixture(scope="module")
def plan_of_3_s() -> Trajectory:
    return plan(LimbParameters(), references.from_samples([0.0, 3.0], [0.0, 0.02]))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "recording.csv"


@pytest.fixture
def unfinished(path):
    return path.with_name("recording.unfinished.csv")


@pytest.fixture
def end_at(monkeypatch):
    """Ends what runs at a time with an error; before its first sample if that is None."""

    def end(time, error):
        def update(progress, done, remark=""):
            if progress._unit == "s" and done >= time:  # of the simulation, and not of files
                raise error

        def start(*_):
            raise error

        if time is None:
            monkeypatch.setattr("limb_systems.simulation.make_simulator", start)
        else:
            monkeypatch.setattr(Progress, "update", update)

    return end


class Robot(Limb):
    """The model in place of a robot, which must be closed before the disk is waited for."""

    __slots__ = ()

    real_time = True
    closed = False

    def close(self):
        self.closed = True


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (KeyboardInterrupt(), "stopped by Ctrl-C or a signal"),
        (HardwareError("The board is off: a thermocouple is open."), "The board is off: a thermo"),
        (MemoryError(), "MemoryError"),
    ],
    ids=repr,
)
def test_a_replay_that_was_interrupted_says_so_in_its_file(
    plan_of_3_s, path, unfinished, end_at, error, reason
):
    path.write_text("old")
    end_at(2.0, error)
    with (
        pytest.raises(type(error)),
        pytest.warns(UserWarning, match=r"until then is in .*recording\.unfinished\.csv\.$"),
    ):
        replay(plan_of_3_s, LimbTwin(), journal=path)
    assert path.read_text() == "old"
    recording = Recording.load(unfinished)
    assert recording.time[-1] == pytest.approx(2.0)
    assert recording.interrupted.startswith(reason)
    assert f"interrupted: {recording.interrupted}" in recording.summary().texts().values()
    recording.save(path)
    assert Recording.load(path).interrupted == recording.interrupted


def test_a_run_that_does_not_start_leaves_all_as_it_was(plan_of_3_s, path, end_at, capsys):
    path.write_text("old")
    end_at(None, HardwareError("The board refuses to be armed."))
    with pytest.raises(HardwareError):
        replay(plan_of_3_s, LimbTwin(), journal=path)
    assert list(path.parent.iterdir()) == [path]
    plan_of_3_s.save(path.with_name("plan.csv"))
    command = ["replay", str(path.with_name("plan.csv")), "-o", str(path), "--force"]
    assert main([*command, "-p", "/dev/no_board"]) == 1
    assert "no_board" in capsys.readouterr().err
    assert path.read_text() == "old"
    assert sorted(p.name for p in path.parent.iterdir()) == ["plan.csv", "recording.csv"]


@pytest.mark.parametrize("drive", [replay, lambda plan, robot: watch(robot, plan.duration)])
def test_a_robot_that_fails_without_a_journal_is_closed(drive, plan_of_3_s, end_at):
    robot = Robot(plan_of_3_s.parameters)
    end_at(None, HardwareError("The board is silent."))
    with pytest.raises(HardwareError, match="silent"):
        drive(plan_of_3_s, robot)
    assert robot.closed


def test_ctrl_c_ends_what_is_taught_and_the_file_says_so(path, end_at):
    end_at(2.0, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        watch(LimbTwin(), 10.0)
    with pytest.raises(KeyboardInterrupt), pytest.warns(UserWarning, match=r"is in .*recording\.c"):
        watch(LimbTwin(), 10.0, journal=path)
    recording = Recording.load(path)
    assert recording.time[-1] == pytest.approx(2.0)
    assert recording.interrupted == "stopped by Ctrl-C or a signal"


def test_what_is_recovered_says_that_it_was_interrupted(path, capsys):
    recording = watch(LimbTwin(), 2.0)
    recording.measured_temperature = recording.measured_temperature.copy()
    recording.measured_temperature[1, 7] = 700.0
    recording.save(path)
    path.write_bytes(path.read_bytes()[: path.read_bytes().index(b"# end") - 10])
    whole = path.with_name("whole.csv")
    assert main(["show", str(path), "--recover", str(whole)]) == 0
    said = capsys.readouterr().out
    assert "recovered   40 samples, 1.95 s" in said
    assert f"interrupted {KILLED_REASON}\n" in said
    assert "doubt       1 of 40 samples out of range, the first at 0.35 s\n" in said
    assert Recording.load(whole).interrupted == KILLED_REASON
    np.testing.assert_array_equal(Recording.load(whole).measured_temperature[1, 7], 700.0)


def test_a_stalled_disk_ends_the_run_with_the_wires_off(path, monkeypatch):
    """And the limb is closed before anything waits for the disk."""
    go, closed = threading.Event(), []
    write, end = os.write, table_writer.TableWriter._end

    def stall(*arguments):
        go.wait()
        return write(*arguments)

    def note(writer, *arguments, **options):
        closed.append(robot.closed)
        return end(writer, *arguments, **options)

    monkeypatch.setattr(table_writer.os, "write", stall)
    monkeypatch.setattr(table_writer, "PATIENCE", 0.05)
    monkeypatch.setattr(table_writer, "MOST_WAITING", 5)
    monkeypatch.setattr(table_writer.TableWriter, "_end", note)
    robot = Robot()
    try:
        with (
            pytest.raises(OutputError, match="The disk is stalled: 5 rows wait"),
            pytest.warns(UserWarning, match=r"The disk is stalled: the last \d rows of"),
        ):
            watch(robot, 1.0, journal=path)
    finally:
        go.set()
    assert closed == [True]
