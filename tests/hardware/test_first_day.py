"""What arm-check finds; benchmarks/first_day.py goes on from there to replays."""

import first_day
import pytest
from other_limbs import OtherLimb
from simulated_board import SimulatedBoard

from hardware import LimbTwin
from hardware.robot.arm_check import check_wires
from limb_systems import LimbError


def check(limb, order=None):
    """Whether it passed, what was said of what failed, and the hottest wire, °C."""
    board = SimulatedBoard(limb, step=25)
    if order:
        board.emulation.misbehave(order)
    board.run(1.0)
    link = first_day.SimulatedLink(board)
    failures = []
    passed = check_wires(link, lambda good, what: good or failures.append(what))
    assert board.duty == (0.0, 0.0)
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
