"""What arm-check finds; benchmarks/first_day.py goes on from there to replays."""

import re

import first_day
import numpy as np
import pytest
from other_limbs import OtherLimb
from simulated_board import SimulatedBoard

from hardware import LimbTwin
from hardware.board import arm_check
from hardware.board.arm_check import check_supply, check_wires
from hardware.board.heat_rates import HeatRates
from limb_systems import LimbError, LimbParameters
from soft_limb.command import main


def check(limb, order=None, described=None):
    """Whether it passed, what was said of what failed, and the hottest wire, °C."""
    board = SimulatedBoard(limb, step=25)
    if order:
        board.emulation.misbehave(order)
    board.run(1.0)
    link = first_day.SimulatedLink(board)
    failures = []
    passed = check_wires(link, lambda good, what: good or failures.append(what), described)
    assert not any(board.duty)
    return passed, failures, link.hottest


def test_arm_check_passes_a_limb_of_another_physics():
    passed, failures, hottest = check(OtherLimb(1))
    assert passed, failures
    assert hottest < 75.0


def test_arm_check_finds_a_thermocouple_that_shows_a_share():
    passed, failures, hottest = check(LimbTwin(seed=1), "share right 0.6")
    assert not passed
    assert "Either its thermocouple shows a share of its rise" in failures[0]
    assert hottest < 90.0


def test_the_board_ends_arm_check_where_no_heat_shows():
    with pytest.raises(LimbError, match="does not show it: it is off the wire or badly bonded"):
        check(LimbTwin(seed=1), "detach left")


def test_thermocouples_are_compared_by_heat_and_by_bend():
    duty, bend = np.full((200, 2), 0.2), np.deg2rad(np.linspace(0.0, 10.0, 200))
    heatings = 2 * [(duty, np.zeros((200, 2)), bend)]
    for shown, good in ((14.0, False), (18.0, True)):
        rates = [HeatRates(heating, 0.07, 1.0) for heating in (20.0, shown)]
        said = []
        arm_check._judge_likeness(
            ["left", "right"], rates, heatings, lambda ok, what: said.append((ok, what))
        )
        ((passed, what),) = said
        assert passed == good
        assert f"right thermocouple shows {shown / 20:.0%} of what the left one does" in what
        assert ("Bond the thermocouple anew" in what) != good


@pytest.mark.parametrize(
    ("calibrated_at", "voltage", "cut_off", "good", "said"),
    [
        (0.0, None, None, True, []),
        (
            0.0,
            7.0,
            True,
            True,
            ["ok the supply has 7 V; write supply_voltage: 7 into", "ok a ther"],
        ),
        (
            7.0,
            9.9,
            None,
            False,
            ["no the supply has 9.9 V, .*: 200% of its heat; set it to 7 V, or"],
        ),
        (
            7.0,
            7.0,
            False,
            False,
            ["ok the supply", "no no cut-off: only a thermal cut-off in series"],
        ),
    ],
)
def test_what_a_person_says_of_the_supply(calibrated_at, voltage, cut_off, good, said):
    limb, heard = LimbParameters(supply_voltage=calibrated_at), []
    say = lambda ok, what: heard.append(f"{'ok' if ok else 'no'} {what}")  # noqa: E731
    assert check_supply(limb, voltage, cut_off, say) == good
    assert len(heard) == len(said)
    assert all(map(re.match, said, heard)), heard


def test_a_command_that_is_told_of_no_cut_off_does_not_open_the_port(capsys):
    assert main(["arm-check", "/dev/null", "--supply", "7", "--no-cut-off"]) == 1
    assert "FAILED   no cut-off" in capsys.readouterr().out
    assert main(["arm-check", "/dev/null", "--supply", "-7"]) == 1
    assert main(["arm-check", "/dev/null"]) == 1
    said = capsys.readouterr().err
    assert "supply's voltage is -7 V; it must be from 0.1" in said
    assert "warning: Nobody has said what voltage the wires' supply has" in said
    assert "Cannot open /dev/null" in said
