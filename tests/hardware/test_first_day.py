"""What a robot's self test finds; benchmarks/first_day.py goes on from there to replays."""

import sys
from pathlib import Path

import pytest

from hardware import LimbTwin
from hardware.emulation.simulated_board import SimulatedBoard
from hardware.robot import self_test

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import first_day
from other_limbs import OtherLimb


def check(limb, monkeypatch, order=None):
    """Whether it passed, what was said of what failed, and the hottest wire, °C."""
    board = SimulatedBoard(limb, step=25)
    if order:
        board.emulation.misbehave(order)
    board.run(1.0)
    link = first_day.SimulatedLink(board)
    monkeypatch.setattr(self_test, "time", link)
    failures = []
    passed = self_test.self_test(link, lambda good, what: good or failures.append(what))
    assert board.duty == (0.0, 0.0)
    return passed, failures, link.hottest


def test_arm_check_passes_a_limb_of_another_physics(monkeypatch):
    passed, failures, hottest = check(OtherLimb(1), monkeypatch)
    assert passed, failures
    assert hottest < 75.0


@pytest.mark.parametrize(
    ("order", "sentence"),
    [
        ("share right 0.6", "Either its thermocouple shows a share of its rise"),
        ("detach left", "left wire warms its own thermocouple by"),
    ],
)
def test_arm_check_finds_a_thermocouple_that_is_wrong(order, sentence, monkeypatch):
    passed, failures, hottest = check(LimbTwin(seed=1), monkeypatch, order)
    assert not passed
    assert sentence in failures[0]
    assert hottest < 90.0
