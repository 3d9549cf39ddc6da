"""`soft-limb board-check` at a port; test_board_rules.py has all rules."""

import io
import json
import sys

import pytest

from hardware.robot import board_check
from hardware.robot.bench import Bench
from hardware.robot.board_check import RULES
from soft_limb.command import main


@pytest.fixture
def some_rules(monkeypatch):
    """Rules of a moment each; all of them take minutes."""

    def choose(*names):
        rules = [rule for rule in RULES if rule.name in names]
        assert len(rules) == len(names)
        monkeypatch.setattr(board_check, "RULES", rules)

    return choose


def test_the_emulated_board_passes_and_what_is_done_by_hand_is_waited_for(
    emulator, some_rules, capsys, monkeypatch
):
    some_rules(
        "info-describes-the-board", "open-thermocouple-latches", "silent-bend-sensor-latches"
    )
    assert main(["board-check", emulator.port]) == 0
    *lines, summary = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["ok", "not", "not"]
    assert lines[-1] == "not run  silent-bend-sensor-latches: it needs a hand at the robot"
    assert summary == "passed 1, failed 0, not run 2"

    class Person(io.StringIO):
        """Does what is asked for, but leaves the bend sensor alone."""

        def readline(self):
            order = capsys.readouterr().err.split('"')[1]
            if order == "silence":
                return "s\n"
            emulator.order(order)
            return "\n"

    monkeypatch.setattr(sys, "stdin", Person())
    assert main(["board-check", emulator.port, "--by-order", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["passed"], facts["failed"], facts["not_run"]) == (2, 0, 1)
    assert facts["checks"][2]["what"] == "what it needs at the robot was not done"
    assert facts["checks"][1]["section"] == "docs/protocol.md#what-a-board-must-do"


def test_a_stopped_check_leaves_the_wires_off(emulator, some_rules, monkeypatch, capsys):
    some_rules("duty-goes-to-its-wire")
    hold = Bench.hold

    def interrupt(bench, *arguments):
        hold(bench, *arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(Bench, "hold", interrupt)
    assert main(["board-check", emulator.port]) == 130
    assert capsys.readouterr().err == "stopped; wires are off\n"
    *_, heated = (e["time"] for e in emulator.events("duty") if e["right"] > 0)
    assert emulator.off_after(heated) < 0.25  # before the heartbeat would have ended it


def test_a_board_with_a_fault_and_a_port_that_is_not_there_are_named(
    virtual_time, emulator, capsys
):
    emulator.order("silence")
    virtual_time.sleep(1.0)
    assert main(["board-check", emulator.port]) == 1
    message = "error: The board cannot be checked: it is off for reason 22, the bend sensor does"
    assert capsys.readouterr().err.startswith(message)
    assert main(["board-check", "/dev/no_board"]) == 1
    said = "error: Cannot open /dev/no_board: No such file or directory; soft-limb ports lists "
    assert capsys.readouterr().err == f"{said}those of this computer.\n"
