"""`soft-limb board-check` at a port, in real time."""

import io
import json
import sys

import pytest

from hardware.robot import conformance
from hardware.robot.bench import EFFECT_TIME, Bench, SerialEnd
from hardware.robot.conformance import CHECKS
from soft_limb.commands.hardware import main


@pytest.fixture
def some_checks(monkeypatch):
    """Those of a moment each; all of them take minutes."""

    def choose(*names):
        checks = [check for check in CHECKS if check.name in names]
        assert len(checks) == len(names)
        monkeypatch.setattr(conformance, "CHECKS", checks)

    return choose


def test_the_emulated_board_passes(emulator, some_checks, capsys):
    some_checks(
        "samples-come-twice",
        "bad-checksum-is-ignored",
        "escapes-are-understood",
        "arm-needs-the-newest-challenge",
        "off-250-ms-after-last-command",
        "open-thermocouple-latches",
    )
    assert main(["board-check", emulator.port]) == 0
    *lines, summary = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == 5 * ["ok"] + ["not"]
    assert lines[-1] == "not run  open-thermocouple-latches: it needs a hand at the robot"
    assert summary == "passed 5, failed 0, not run 1"
    assert emulator.duty() == [0.0, 0.0]


def test_what_is_done_at_the_robot_is_waited_for(emulator, some_checks, capsys, monkeypatch):
    some_checks("open-thermocouple-latches", "jump-latches", "frozen-bend-sensor-latches")

    class Person(io.StringIO):
        """Does what is asked for, but leaves the bend sensor alone."""

        def readline(self):
            order = capsys.readouterr().err.split('"')[1]
            if order == "freeze bend":
                return "s\n"
            emulator.order(order)
            return "\n"

    monkeypatch.setattr(sys, "stdin", Person())
    # The jump is not asked for by hand, as nobody can make one.
    assert main(["board-check", emulator.port, "--by-order", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["passed"], facts["failed"], facts["not_run"]) == (2, 0, 1)
    assert facts["checks"][2]["what"] == "what it needs at the robot was not done"
    assert facts["checks"][0]["section"] == "docs/protocol.md#what-a-board-must-do"


def test_a_stopped_check_leaves_the_wires_off(emulator, some_checks, monkeypatch, capsys):
    some_checks("duty-goes-to-its-wire")
    drive = Bench.drive

    def interrupt(bench, *arguments):
        drive(bench, *arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(Bench, "drive", interrupt)
    assert main(["board-check", emulator.port]) == 130
    assert capsys.readouterr().err == "stopped; wires are off\n"
    *_, heated = (e["time"] for e in emulator.events("duty") if e["right"] > 0)
    assert emulator.off_after(heated) < 0.25  # before the heartbeat would have ended it


def test_a_fault_that_was_there_before_is_not_cleared(emulator, capsys):
    emulator.order("silence")
    with SerialEnd(emulator.port) as end:
        end.wait(EFFECT_TIME)
    assert main(["board-check", emulator.port]) == 1
    message = "error: The board cannot be checked: it is off for reason 22, the bend sensor does"
    assert capsys.readouterr().err.startswith(message)


def test_a_port_that_is_not_there_is_named(capsys):
    assert main(["board-check", "/dev/no_board"]) == 1
    said = (
        "error: Cannot open /dev/no_board: No such file or directory; soft-limb ports lists those "
    )
    assert capsys.readouterr().err == f"{said}of this computer.\n"
