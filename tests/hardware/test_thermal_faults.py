"""Faults of thermocouples and of heat on some emulated limbs; benchmarks/board_faults.py has more.

What a wire truly has is asked of the emulation. No wire may pass 130 °C, whatever fails but its
MOSFET.
"""

import board_faults
from board_faults import FROM_BEGINNING, HOTTEST, WHEN_HOT
from simulated_board import SimulatedBoard

from hardware import LimbTwin
from hardware.firmware import guard


def test_heat_that_a_thermocouple_does_not_show():
    """After power-up there is little duty until it has shown some."""
    for fault, duty, limit in (
        ("thermocouple has come off", 0.1, 6.0),
        ("thermocouple has come off", 1.0, 6.0),
        ("thermocouple reversed", 0.5, 4.5),
        ("thermocouple reads 30% of the rise", 0.1, 10.0),
        ("thermocouple frozen", 1.0, 6.0),
        ("half of the heat arrives", 0.5, 12.0),
    ):
        result = board_faults.run_fault((fault, FROM_BEGINNING, duty, 3, 14))
        assert result["reason"] == guard.NOT_WARMING, fault
        assert result["off"] < limit, fault
        assert result["hottest"] < 65.0, fault


def test_power_cycles_do_not_add_up():
    """A thermocouple is off; each time the board is switched on anew, and asked for full duty."""
    board = SimulatedBoard(LimbTwin(seed=14), step=25)
    board.emulation.misbehave("detach left")
    hottest = 0.0
    for _ in range(10):
        board.emulation.misbehave("restart")
        board.run(0.7)
        board.arm()
        for _ in range(4):
            board.run(1.0, (1.0, 0.0))
            hottest = max(hottest, board.emulation.board.wire_temperature().max())
    assert 40.0 < hottest < 100.0


def test_a_supply_that_is_half_too_high_or_a_reading_that_stands_still():
    """With a wire that is warm already, whose thermocouple is good or stops to be."""
    for fault in (None, "freeze right"):
        board = SimulatedBoard(LimbTwin(seed=0), step=25)
        board.emulation.misbehave("weaken 1.5")
        board.run(1.0)
        assert board.arm()
        hottest = 0.0
        for number, duty in enumerate((0.2, 1.0, 0.0, 0.3, 1.0, 1.0, 1.0)):
            if number == 2 and fault:
                board.emulation.misbehave(fault)
            for _ in range(40):
                board.run(0.1, (0.0, duty))
                hottest = max(hottest, board.emulation.board.wire_temperature().max())
        assert 90.0 < hottest < 130.0
        assert board.reason == (guard.NOT_WARMING if fault else guard.NONE)


def test_a_fault_that_the_board_bears_does_not_make_a_wire_too_hot():
    """A limb whose left wire gets hotter than most."""
    for fault, when in (
        ("thermocouple reads 60% of the rise", FROM_BEGINNING),
        ("thermocouple frozen", WHEN_HOT),
        ("thermocouple drifts by -0.5 °C/s", WHEN_HOT),
    ):
        result = board_faults.run_fault((fault, when, 0.5, 3, 0))
        assert 90.0 < result["hottest"] < HOTTEST, fault


def test_a_board_does_not_arm_with_a_fault():
    for fault in ("thermocouple reads 19 °C too little", "clock stands still"):
        assert not board_faults.run_fault((fault, FROM_BEGINNING, 0.3, 1, 5))["armed"], fault


def test_a_reading_that_falls_while_hot_is_no_wire_s():
    job = ("thermocouple reads 19 °C too little", WHEN_HOT, 0.3, 3, 4)
    result = board_faults.run_fault(job)
    assert result["reason"] == guard.TEMPERATURE_JUMP
    assert result["off"] < 0.2


def test_a_mosfet_that_is_shorted_is_noticed_and_the_supply_let_go():
    result = board_faults.run_fault(("MOSFET shorted", FROM_BEGINNING, 0.1, 3, 6))
    assert result["reason"] == guard.TOO_WARM
    assert result["hottest"] < 90.0  # and it cools, though its MOSFET conducts


def test_both_wires_stay_below_the_limit_for_as_long_as_they_are_heated():
    result = board_faults.run_fault(("no fault, all wires hot", FROM_BEGINNING, 1.0, 3, 0))
    assert result["off"] is None
    assert 95.0 < result["hottest"] < HOTTEST
