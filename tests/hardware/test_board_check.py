"""`soft-limb board-check`: the self test of a board. test_board_rules.py has the conformance."""

import json

import pytest

from hardware.firmware import guard, heat
from hardware.firmware.firmware import Firmware
from hardware.robot.board_check import CASES, FAILED, NOT_RUN, PASSED, Host, check_board
from hardware.robot.link import HardwareError
from limb_systems import LimbParameters
from soft_limb.command import main

from .test_board_rules import (
    Cable,
    PaperRobot,
    any_challenge,
    any_power,
    any_sum,
    constants,
    heartbeat_of,
    in_guard,
    limits_the_duty,
    no_disarm,
    no_greeting,
    no_wires,
    only_in_order,
    only_in_range,
    slow_samples,
)


def outcomes(change=lambda program, patch: None, limb=None):
    """The outcomes of the self test on a board whose program was changed, and its robot."""
    limb = limb or LimbParameters()
    with pytest.MonkeyPatch.context() as patch:

        class Program(Firmware):
            def __init__(self, board):
                super().__init__(board)
                change(self, patch)

        robot = PaperRobot(Program, limb)
        said = []
        found = check_board(Cable(robot), limb, said.append)
    assert said == found
    assert [outcome.case for outcome in found] == CASES
    return found, robot


@pytest.mark.parametrize("limb", [LimbParameters(), LimbParameters.in_space(wires=4)])
def test_this_firmware_passes_and_ends_without_duty(limb):
    found, robot = outcomes(limb=limb)
    assert [(o.case.name, o.what) for o in found if o.outcome != PASSED] == []
    assert robot.firmware.guard.state != guard.ARMED
    assert robot.duty == [0.0] * len(limb.wires)


@in_guard("arm")
def any_bounds_of_zero(subject, arm, challenge, bounds, *others):
    nothing = any(wire[0] == 0 for wire in bounds)
    arm(challenge, [heat.NOMINAL] * len(bounds) if nothing else bounds, *others)


def unlike_thermocouples(program, patch):
    program._board.errors[0] = 9.0


def long_heartbeat(program, patch):
    heartbeat_of(400)(program, patch)
    patch.setattr(guard, "LONGEST_HOLD", 1000)


# For each case boards that fail it.
BOARDS = {
    "info": (no_greeting, no_wires),
    "samples": (slow_samples,),
    "sensors": (unlike_thermocouples,),
    "challenge": (any_challenge,),
    "no-bounds": (any_bounds_of_zero,),
    "bounds": (
        constants(heat, acceptable=only_in_order, shown=lambda bounds, total: True),
        constants(heat, acceptable=only_in_range),
    ),
    "no-sum": (any_sum,),
    "duty": (limits_the_duty,),
    "sum": (any_power,),
    "silence": (long_heartbeat,),
    "disarm": (no_disarm,),
}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_board_that_breaks_a_rule_fails_its_case(case):
    for change in BOARDS[case.name]:
        found, _ = outcomes(change)
        (outcome,) = (outcome for outcome in found if outcome.case == case)
        assert outcome.outcome == FAILED, change
        assert outcome.what


def test_a_board_that_stays_on_ends_the_test():
    def never_off(program, patch):
        no_disarm(program, patch)
        heartbeat_of(10**9)(program, patch)
        patch.setattr(guard, "LONGEST_HOLD", 10**9)

    found, _ = outcomes(never_off)
    (stays,) = (o for o in found if "disconnect the supply of its wires" in o.what)
    assert {o.outcome for o in found[found.index(stays) + 1 :]} == {NOT_RUN}


def test_a_silent_board_and_one_of_another_limb_are_refused():
    def say_nothing(program, patch):
        program._board.send = lambda data: None

    with pytest.raises(HardwareError, match="sent no sample for 1 s"):
        outcomes(say_nothing)
    four = Cable(PaperRobot(limb=LimbParameters.in_space(wires=4)))
    with pytest.raises(HardwareError, match="has 4 channels, but the limb has 2 wires"):
        check_board(four, LimbParameters(), print)


def test_the_emulated_board_passes_at_a_port(emulator, capsys):
    assert main(["board-check", emulator.port]) == 0
    *lines, summary = capsys.readouterr().out.splitlines()
    assert lines == [f"ok       {case.name}" for case in CASES]
    assert summary == f"passed {len(CASES)}, failed 0, not run 0"
    assert emulator.duty() == [0.0, 0.0]
    assert main(["board-check", emulator.port, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["passed"], facts["failed"], facts["not_run"]) == (len(CASES), 0, 0)
    assert facts["checks"][-1]["section"] == "docs/protocol.md#from-the-host"


def test_a_stopped_check_leaves_the_wires_off(emulator, monkeypatch, capsys):
    heat_gently = Host.heat

    def interrupt(host, *arguments):
        heat_gently(host, *arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(Host, "heat", interrupt)
    assert main(["board-check", emulator.port]) == 130
    assert capsys.readouterr().err == "stopped; wires are off\n"
    *_, heated = (e["time"] for e in emulator.events("duty") if e["right"] > 0)
    assert emulator.off_after(heated) < 0.4  # it was heated for 0.3 s; silence would take 0.5 s


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
