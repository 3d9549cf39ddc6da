"""The fault table without the cable: an emulated board in simulated time.

The firmware's own files run on the board. Faults come while a wire is hot at full duty, and
times, from the fault to duty zero at the pins, are the longest over when between two of its
samples it comes.
"""

import itertools
import random

import pytest

from hardware.firmware import guard, protocol

from .conftest import SimulatedBoard

HEARTBEAT = 0.252  # s
MOMENTS = (1, 51, 99)  # ms after the thermocouples were read, every 100 ms
HOT = (0.0, 1.0)


@pytest.fixture
def longest(record_property):
    """Injects faults at many moments into boards that heat; reports the longest time to off."""

    def measure(fault, limit, duty=HOT, moments=MOMENTS):
        boards, times = [], []
        for moment in moments:
            random.seed(moment)
            board = SimulatedBoard()
            board.heat()
            board.run_to_reading(HOT)
            board.run(moment / 1000, HOT)
            fault(board)
            times.append(board.time_to_off(limit, duty))
            boards.append(board)
        record_property("off after", f"{1000 * max(times):.0f} ms")
        print(f"\noff after {1000 * max(times):.0f} ms")
        return boards

    return measure


def order(text):
    return lambda board: board.emulation.misbehave(text)


def assert_stays_off(board, duty=HOT, seconds=0.5):
    """Whatever the host commands."""
    count = len(board.duties)
    board.run(seconds, duty)
    assert all(event[1:] == (0.0, 0.0) for event in board.duties[count:])
    assert board.duty == (0.0, 0.0)


def test_bytes_that_are_damaged_now_and_then(board_in_simulated_time):
    """1%: nothing but what was commanded gets to the wires, and the next command does."""
    commanded = [(0.0, 0.3), (0.11, 0.2), (0.25, 0.05)]
    board = board_in_simulated_time
    assert board.arm()
    board.prove((0.3, 0.3))
    parsers = board.emulation.firmware._parser, board._parser
    for damage in ("corrupt", "drop", "duplicate", "reorder"):
        start, sent = len(board.duties), len(board.sent)
        rejected = [parser.rejected for parser in parsers]
        board.emulation.misbehave(f"{damage} 0.01")
        for duty in itertools.islice(itertools.cycle(commanded), 150):
            board.run(0.05, duty)
        duties = {event[1:] for event in board.duties[start:]}
        assert duties <= {(0.0, 0.0), *_halves(commanded)}
        assert min(now.rejected - then for now, then in zip(parsers, rejected, strict=True)) > 5
        assert len(board.sent) - sent > 100
        assert board.sent[-1][3] == guard.ARMED
        assert board.duty in commanded
        board.emulation.misbehave("mend")


def _halves(duties):
    """Those, and the moments between, when the left wire has its duty and the right not yet."""
    for before, after in itertools.product([(0.0, 0.0), *duties], duties):
        yield after
        yield after[0], before[1]


def test_commands_that_are_late(longest):
    """They come one after the other, but the first of them after the heartbeat's end."""
    for board in longest(order("delay 0.4"), HEARTBEAT):
        assert board.emulation.firmware.guard.reason == guard.NO_COMMAND
        assert_stays_off(board)  # late ones do not heat again
        assert board.reason == guard.NO_COMMAND


def test_commands_that_are_later_and_later(record_property):
    """Behind a buffer that grows up to 3 s, until the host is no more, or nobody notices."""
    longest = 0.0
    cases = itertools.product(("killed", "stopped", "unplugged"), (0.02, 0.15, 3.0), (0.3,))
    for event, moment, rate in (*cases, ("nothing", 3.0, 0.1), ("nothing", 3.0, 0.3)):
        random.seed(0)
        board = SimulatedBoard()
        board.heat()
        board.emulation.misbehave(f"creep {rate}")
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
                board.emulation.misbehave("unplug")
                board.run(0.3)
            if late is None and guarded._late:
                late = board.now  # the first command that is 250 ms old has come
            assert board.now < 100.0, "still on"
        off = next(t for t, left, right in board.duties[::-1] if left == right == 0.0)
        longest = max(longest, off - min(happened, late or happened))
        assert guarded.reason in (guard.NO_COMMAND, guard.LATE_COMMANDS, guard.HOST)
        assert_stays_off(board, None)
    record_property("off after", f"{1000 * longest:.0f} ms")
    print(f"\noff after {1000 * longest:.0f} ms")
    assert longest <= 0.3


def test_bytes_that_are_mostly_corrupted(longest):
    # As long as a command in some comes through it is not to blame.
    for board in longest(order("corrupt 0.2"), 1.0):
        assert {event[1:] for event in board.duties[-2:]} == {(0.0, 0.0), HOT}


def test_stream_of_random_bytes(longest):
    """The host babbles instead of commanding; its last command came up to 50 ms before."""

    def babble(board):
        for _ in range(8):
            board.emulation.misbehave("noise 4000")

    for board in longest(babble, HEARTBEAT, None):
        assert board.emulation.firmware._parser.rejected > 10
        assert_stays_off(board)


def test_stale_frames_do_not_heat_again(board_in_simulated_time):
    board = board_in_simulated_time
    board.heat()
    board.time_to_off(HEARTBEAT, None)
    assert len(board.emulation._recorded) > 400  # everything that the host sent, arming included
    board.emulation.misbehave("replay")
    assert_stays_off(board, None)
    assert board.sent[-1][3] == guard.DISARMED
    count = len(board.duties)
    assert board.arm()
    board.run(0.1, (0.0, 0.1))
    board.emulation.misbehave("replay")  # commands of a session before, of higher numbers
    board.run(0.1)
    assert board.duty == (0.0, 0.1)
    assert {event[1:] for event in board.duties[count:]} == {(0.0, 0.1)}


def test_sensor_faults_latch_until_cleared(longest):
    for fault, reason, limit in (
        ("open right", guard.THERMOCOUPLE_OPEN, 0.102),
        ("supply left", guard.THERMOCOUPLE_TO_SUPPLY, 0.102),
        ("hot right", guard.TEMPERATURE_JUMP, 0.102),
        ("silence", guard.BEND_SILENT, 0.052),
        ("freeze bend", guard.BEND_STUCK, 0.552),  # ten samples alike
        # After 1 s of full duty beyond the holding duty of 0.3.
        ("freeze right", guard.NOT_WARMING, 1.6),
    ):
        boards = longest(order(fault), limit)
        for board in boards:
            assert board.emulation.firmware.guard.reason == reason
        assert not board.arm()
        assert_stays_off(board, seconds=0.3)
        board.emulation.misbehave("mend")
        assert_stays_off(board, seconds=6.0)  # until averages of readings are right again
        assert not board.arm()  # mended is not cleared
        assert board.reason == reason
        board.clear()
        assert board.reason == guard.HOST
        assert_stays_off(board, seconds=0.3)
        assert board.arm()
        board.run(0.1, (0.0, 0.2))
        assert board.duty == (0.0, 0.2)  # and now it heats again


def test_board_that_resets(longest):
    for cause, reason in (("reset", guard.RESET), ("restart", guard.POWER_UP)):
        for board in longest(order(cause), 0.001):
            assert_stays_off(board)
            assert board.reason == reason


def test_board_that_hangs_is_reset_by_its_watchdog(longest):
    for board in longest(order("stall 5.0"), 0.202, moments=[1, 30]):
        assert_stays_off(board, seconds=1.0)
        assert board.reason == guard.RESTARTED
        assert not board.arm()


def test_command_out_of_range_switches_off(longest):
    """Sent past the host's own check, as a faulty host would."""
    for board in longest(lambda board: board.command((1.0001, 0.0)), 0.002):
        assert board.emulation.firmware.guard.reason == guard.OUT_OF_RANGE
        assert_stays_off(board)


def test_mending_and_cooling_make_board_line_and_limb_as_new(board_in_simulated_time):
    board = board_in_simulated_time
    began = board.temperature
    board.heat()
    for fault in ("delay 0.4", "drop 1.0", "hot left", "open right", "freeze bend", "silence"):
        board.emulation.misbehave(fault)
    board.run(1.0)
    for mending in ("mend", "cool", "restart"):
        board.emulation.misbehave(mending)
    board.run(1.0)
    assert board.temperature == pytest.approx(began, abs=1.0)
    assert board.reason == guard.POWER_UP
    board.heat()
