"""The fault table without the cable: an emulated board in simulated time.

Faults come while a wire is hot at full duty, right after the thermocouples were read. They are read
again after 100 ms, so that no other moment gives the board more time. More faults of thermocouples
and heat, on more limbs, are in benchmarks/board_faults.py.
"""

import itertools
import random

import board_faults
import numpy as np
import pytest
from board_faults import FROM_BEGINNING, HOTTEST, WHEN_HOT
from simulated_board import SimulatedBoard as Simulated

from hardware.firmware import guard, protocol

from .conftest import SimulatedBoard, report, small_twin

HEARTBEAT = 0.252  # s
HOT = (0.0, 1.0)
NOISE = 8 * "noise 4000;"  # random bytes
# Orders of the emulator; the reason for which the board is off; s until it is, at most.
FAULTS = [
    ("open right", guard.THERMOCOUPLE_OPEN, 0.102),
    ("ground right", guard.THERMOCOUPLE_TO_GROUND, 0.102),
    ("supply left", guard.THERMOCOUPLE_TO_SUPPLY, 0.202),  # the left wire, which is cold
    ("garbled left", guard.AMPLIFIER, 0.202),
    ("hot right", guard.TEMPERATURE_JUMP, 0.102),
    ("silence", guard.BEND_SILENT, 0.052),
    ("freeze bend", guard.BEND_STUCK, 0.552),  # ten samples alike
    ("freeze right", guard.NOT_WARMING, 1.6),  # after 1 s of full duty
    ("reset", guard.WAS_RESET, 0.001),
    ("restart", guard.POWER_UP, 0.001),
    ("stall 5.0", guard.RESTARTED, 0.202),  # its watchdog resets it
    ("delay 0.4", guard.NO_COMMAND, HEARTBEAT),  # late commands do not heat again
    ("corrupt 0.2", None, 1.0),  # as long as a command in some comes through it is not to blame
    (NOISE, guard.NO_COMMAND, HEARTBEAT),  # in place of commands
]


def assert_stays_off(board, duty=HOT, seconds=0.5):
    """Whatever the host commands."""
    count = len(board.duties)
    board.run(seconds, duty)
    assert all(event[1:] == (0.0, 0.0) for event in board.duties[count:])
    assert board.duty == (0.0, 0.0)


@pytest.mark.parametrize(("fault", "reason", "limit"), FAULTS, ids=lambda fault: str(fault)[:12])
def test_faults_end_heat_in_time(fault, reason, limit):
    random.seed(1)
    board = SimulatedBoard()
    board.heat()
    board.run_to_reading(HOT)
    board.run(0.001, HOT)
    for order in filter(None, fault.split(";")):
        board.emulation.inject_fault(order)
    time_to_off = board.time_to_off(limit, None if fault == NOISE else HOT)
    report(fault, time_to_off)
    if reason is None:
        return
    assert_stays_off(board)
    assert board.reason == reason
    if reason >= guard.LATCHING:
        assert not board.arm()


def test_bytes_that_are_damaged_now_and_then(board_in_simulated_time):
    """1%: nothing but what was commanded gets to the wires, and the next command does."""
    commanded = [(0.0, 0.3), (0.11, 0.2), (0.25, 0.05)]
    board = board_in_simulated_time
    assert board.arm()
    board.prove((0.3, 0.3))
    parsers = board.emulation.firmware._parser, board._parser
    # The wires change one after the other.
    states = itertools.product([(0.0, 0.0), *commanded], commanded)
    known = {(0.0, 0.0), *commanded, *((now[0], before[1]) for before, now in states)}
    for damage in ("corrupt", "drop", "duplicate", "reorder"):
        start, sent = len(board.duties), len(board.samples)
        rejected = [parser.rejected for parser in parsers]
        board.emulation.inject_fault(f"{damage} 0.01")
        for duty in itertools.islice(itertools.cycle(commanded), 80):
            board.run(0.05, duty)
        assert {event[1:] for event in board.duties[start:]} <= known
        assert min(now.rejected - then for now, then in zip(parsers, rejected, strict=True)) > 5
        assert len(board.samples) - sent > 50
        assert board.newest.armed
        assert board.duty in commanded
        board.emulation.inject_fault("mend")


def test_commands_that_are_later_and_later():
    """Behind a buffer that grows up to 3 s, until the host is no more, or nobody notices."""
    longest = 0.0
    for event, moment, rate in (
        ("killed", 0.02, 0.3),
        ("killed", 3.0, 0.3),
        ("stopped", 3.0, 0.3),
        ("unplugged", 0.02, 0.3),
        ("nothing", 3.0, 0.1),
        ("nothing", 3.0, 0.3),
    ):
        random.seed(0)
        board = SimulatedBoard()
        board.heat()
        board.emulation.inject_fault(f"creep {rate}")
        guarded, late = board.emulation.firmware.guard, None
        happened = board.now + (moment if event != "nothing" else 1e9)
        while board.duty != (0.0, 0.0):
            if board.now < happened:
                board.run(0.001, HOT)
            elif event == "killed":
                board.run(0.001)
            elif event == "stopped":
                board.send(protocol.DISARM)
                board.run(0.001)
            else:
                board.emulation.inject_fault("unplug")
                board.run(0.3)
            if late is None and guarded._late:
                late = board.now  # the first command that is 250 ms old has come
            assert board.now < 100.0, "still on"
        off = next(t for t, left, right in board.duties[::-1] if left == right == 0.0)
        longest = max(longest, off - min(happened, late or happened))
        assert guarded.reason in (guard.NO_COMMAND, guard.LATE_COMMANDS, guard.BY_HOST)
        assert_stays_off(board, None)
    report("later and later commands", longest)
    assert longest <= 0.3


def test_stale_frames_do_not_heat_again():
    board = SimulatedBoard()
    board.heat()
    board.time_to_off(HEARTBEAT, None)
    assert len(board.emulation._recorded) > 400  # everything that the host sent, arming included
    board.emulation.inject_fault("replay")
    assert_stays_off(board, None)
    assert not board.newest.armed
    count = len(board.duties)
    assert board.arm()
    board.run(0.1, (0.0, 0.25))
    board.emulation.inject_fault("replay")  # commands of a session before, of higher numbers
    board.run(0.1)
    assert board.duty == (0.0, 0.25)
    assert {event[1:] for event in board.duties[count:]} == {(0.0, 0.25)}


OFF, REVERSED, LESS = "has come off", "reversed", "reads 30% of the rise"
COLDER = "reads 19 °C too little"
# A fault of a thermocouple or of heat, when, duty, and seed of the limb; the reason, s until
# the board is off, and how hot a wire truly gets, °C. No wire may pass 130 °C but by its MOSFET.
THERMAL = [
    (f"thermocouple {OFF}", FROM_BEGINNING, 1.0, 14, guard.NOT_WARMING, 6.0, (0.0, 65.0)),
    (f"thermocouple {REVERSED}", FROM_BEGINNING, 0.5, 14, guard.NOT_WARMING, 4.5, (0.0, 65.0)),
    (f"thermocouple {LESS}", FROM_BEGINNING, 0.1, 14, guard.NOT_WARMING, 10.0, (0.0, 65.0)),
    (f"thermocouple {COLDER}", WHEN_HOT, 0.3, 4, guard.TEMPERATURE_JUMP, 0.2, (0.0, HOTTEST)),
    ("MOSFET shorted", FROM_BEGINNING, 0.1, 6, guard.TOO_WARM, 5.0, (0.0, 90.0)),  # and then cools
    # What the board bears, on a limb whose left wire gets hotter than most.
    ("thermocouple reads 60% of the rise", FROM_BEGINNING, 0.5, 0, None, None, (90.0, HOTTEST)),
    ("thermocouple frozen", WHEN_HOT, 0.5, 0, None, None, (90.0, HOTTEST)),
    ("no fault, all wires hot", FROM_BEGINNING, 1.0, 0, guard.NO_REASON, None, (95.0, HOTTEST)),
]


@pytest.mark.parametrize(
    ("fault", "when", "duty", "seed", "reason", "limit", "hottest"),
    THERMAL,
    ids=range(len(THERMAL)),
)
def test_faults_of_thermocouples_and_heat(
    fault, when, duty, seed, reason, limit, hottest, monkeypatch
):
    monkeypatch.setattr(board_faults, "LONGEST", 12.0)  # s; wires are at their hottest before
    result = board_faults.run_fault((fault, when, duty, 3, seed))
    low, high = hottest
    assert low < result["hottest"] < high
    if reason is not None:
        assert result["reason"] == reason
        assert (result["off"] or np.inf) < limit if limit else result["off"] is None


def test_a_board_does_not_arm_with_a_fault():
    for fault in (f"thermocouple {COLDER}", "clock stands still"):
        assert not board_faults.run_fault((fault, FROM_BEGINNING, 0.3, 1, 5))["armed"], fault


def test_power_cycles_do_not_add_up():
    """A thermocouple is off; each time the board is switched on anew, and asked for full duty."""
    board = Simulated(small_twin(seed=14), step=25)
    board.emulation.inject_fault("detach left")
    hottest = 0.0
    for _ in range(5):
        board.emulation.inject_fault("restart")
        board.run(0.7)
        board.arm()
        for _ in range(4):
            board.run(1.0, (1.0, 0.0))
            hottest = max(hottest, board.emulation.board.wire_temperature().max())
    assert 40.0 < hottest < 100.0


@pytest.mark.parametrize("fault", [None, "freeze right"])
def test_a_supply_that_is_half_too_high_or_a_reading_that_stands_still(fault):
    """With a wire that is warm already, whose thermocouple is good or stops to be."""
    board = Simulated(small_twin(), step=25)
    board.emulation.inject_fault("weaken 1.5")
    board.run(1.0)
    assert board.arm()
    hottest = 0.0
    for number, duty in enumerate((0.2, 1.0, 0.0, 1.0, 1.0, 1.0)):
        if number == 2 and fault:
            board.emulation.inject_fault(fault)
        for _ in range(40):
            board.run(0.1, (0.0, duty))
            hottest = max(hottest, board.emulation.board.wire_temperature().max())
    assert 90.0 < hottest < 130.0
    assert board.reason == (guard.NOT_WARMING if fault else guard.NO_REASON)
