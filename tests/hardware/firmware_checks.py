"""What the rules of conformance.py do not see over a cable, on a board of paper.

Plain enough for MicroPython: pytest runs it under CPython, test_firmware.py under MicroPython too.
"""

import math
import struct
import sys

from hardware.firmware import firmware, from_host, guard, heat, protocol, readings
from hardware.firmware.firmware import Firmware
from hardware.firmware.protocol import crc32

ROOM = 25.0  # °C


class PaperBoard:
    """A board on paper: nominal wires, (6) and (7), and whatever a test writes over them."""

    def __init__(self, cause=firmware.POWER_ON, remembered=0, pulls=(16, 0), angles=1):
        """pulls: of each wire, see `from_host.pull`."""
        self.channels, self.angles, self.pulls = len(pulls), angles, pulls
        self.now = 0
        self.incoming = b""
        self.sent = []  # the newest, as hours of them do not fit into a small computer
        self.duty = [None] * self.channels
        self.wires = [ROOM] * self.channels  # °C
        self.temperatures = [ROOM] * self.channels  # as read
        self.junctions = [ROOM] * self.channels
        self.errors = [0.0] * self.channels  # °C, of the readings
        self.faults = [0] * self.channels
        self.bad_frames = [0] * self.channels  # that come next, as of an open thermocouple
        self.reserved = 0  # bits that no amplifier sends
        self.bend = 0
        self.silent = False
        self.fed = self.held = 0
        self.serial_number = b"paper\0\0\0"
        self.random = 4711
        self.reset_cause = cause
        self.remembered = remembered

    def pass_time(self, milliseconds=1):
        self.now += milliseconds
        for wire in range(self.channels):
            interval, rise = milliseconds / 1000, self.wires[wire] - ROOM
            lag = self.wires[wire] - self.temperatures[wire]
            self.wires[wire] += interval * (20.0 * (self.duty[wire] or 0.0) - 0.07 * rise)
            self.temperatures[wire] += interval * lag

    def ticks(self):
        return self.now

    def receive(self):
        data, self.incoming = self.incoming, b""
        return data

    def send(self, data):
        self.sent.append(data)
        del self.sent[:-200]

    def read_thermocouple(self, wire):
        quarters = int(4 * (self.temperatures[wire] + self.errors[wire]) + 0.5) & 0x3FFF
        word = quarters << 18 | int(16 * self.junctions[wire]) << 4 | self.faults[wire]
        if self.bad_frames[wire]:
            self.bad_frames[wire] -= 1
            word = readings.OPEN  # and no temperature, which nobody may use
        if self.faults[wire] or word == readings.OPEN:
            word |= 0x10000
        return struct.pack(">I", word | self.reserved)

    def read_bend(self):
        """The nominal limb's, with some noise in the last bits."""
        self.bend = (self.bend + 1) % 5
        data = b"\0"
        for angle in range(self.angles):
            pull = 0.0
            for wire, share in enumerate(protocol.shares(self.pulls, angle)):
                pull += share * self.wires[wire]
            data += struct.pack("<h", int(32 * pull) + self.bend)
        return b"" if self.silent else data

    def set_duty(self, wire, duty):
        self.duty[wire] = duty

    def keep_supply(self):
        self.held = self.now

    def feed(self):
        self.fed = self.now

    def remember(self, reason):
        self.remembered = reason


class Host:
    """Runs a firmware on paper, a millisecond at a time, and talks to it."""

    def __init__(self, board=None, milliseconds=700, proven=True):
        """proven: whether thermocouples have followed some heat already."""
        self.board = board or PaperBoard()
        self.firmware = Firmware(self.board)
        self.guard = self.firmware.guard
        self.sequence = 0
        self.run(milliseconds)
        if proven:
            self.guard.proven = [True] * self.board.channels

    def run(self, milliseconds, duty=None, delay=0):
        """Runs on; commands a duty each 50 ms if there is one, as if late by a delay, ms."""
        for _ in range(milliseconds):
            self.board.pass_time()
            if duty is not None and self.board.now % 50 == 0:
                self.command(duty, delay=delay)
            self.firmware.step()

    def send(self, *frame):
        self.board.incoming += protocol.encode(*frame)

    def arm(self, bounds=heat.NOMINAL_BOUNDS, total=1.0):
        pulls = self.board.pulls
        frames = from_host.encode_arming(self.guard.challenge, [bounds] * len(pulls), total, pulls)
        self.board.incoming += b"".join(frames)
        self.sequence = 0
        self.run(1)

    def command(self, duty, delay=0):
        self.sequence += 1
        heard = self.last_sample()[1] - delay
        session = self.guard.session or 0
        self.board.incoming += from_host.encode_command(session, self.sequence, heard, duty)

    def heat(self):
        self.arm()
        self.run(500, (0.0, 1.0))
        assert self.board.duty[:2] == [0.0, 1.0]

    def time_to_off(self, limit, duty=(0.0, 1.0)):
        start = self.board.now
        while any(self.board.duty):
            self.run(1, duty)
            assert self.board.now - start <= limit, "still on"
        return self.board.now - start

    def last_sample(self):
        """Values of the newest SAMPLE."""
        parser = protocol.Parser((protocol.SAMPLE,))
        return parser.feed(b"".join(self.board.sent[-4:]))[-1][1]


def test_a_session_from_greeting_to_disarming():
    host = Host(milliseconds=200)
    host.arm()  # before ten samples
    host.run(500, (1.0, 1.0))
    assert host.board.duty == [0.0, 0.0]
    assert host.last_sample()[4] == guard.POWER_UP
    host.send(protocol.HELLO)
    host.run(1)
    ((_, info),) = protocol.Parser((protocol.INFO,)).feed(host.board.sent[-1])
    assert info == (5, 50, 440, b"paper\0\0\0", 2, 1, firmware.POWER_ON)
    host.arm(total=0.8)
    assert host.board.held > host.board.now - 5  # the supply's relay
    host.run(300, (1.0, 0.6))
    assert close(host.board.duty[0], 0.5, 1e-6)
    assert close(host.board.duty[1], 0.3, 1e-6)
    host.send(protocol.DISARM)
    host.run(20)
    assert (host.board.duty, host.guard.reason) == ([0.0, 0.0], guard.BY_HOST)
    assert host.board.held < host.board.now - 5
    host.arm()
    host.run(60, (0.0, 0.4))
    host.command((1.0001, 0.0))
    host.run(1)
    assert (host.board.duty, host.guard.reason) == ([0.0, 0.0], guard.OUT_OF_RANGE)
    host.board.sent.clear()
    fed = host.board.fed
    host.run(1000)
    assert len(host.board.sent) in (76, 80, 84)  # SAMPLE and CHANNELS, each twice
    assert 950 <= host.board.fed - fed <= 1050


def arm(subject, now, bounds=heat.NOMINAL_BOUNDS, total=1.0):
    """Asks a guard of two wires to arm."""
    shares = ((-1.0, 1.0),)
    subject.arm(subject.challenge, (bounds, heat.NOMINAL_BOUNDS), total, shares, now)


def test_two_readings_above_the_limit_are_too_hot_and_one_is_not():
    for readings_above, reason in ((1, guard.NO_REASON), (2, guard.OVER_TEMPERATURE)):
        subject = guard.Guard(0, 4711)
        subject.observers = [heat.WireObserver(80.0), heat.WireObserver(80.0)]
        now = 0
        for reading in [105.0] * 10 + [112.0] * readings_above + [105.0] * 3:
            for _ in (0, 1):  # samples for each reading
                now += 50
                if subject.state == guard.DISARMED and subject.reason < guard.LATCHING:
                    arm(subject, now)
                subject.sample(now, [105.0, reading], [30.0, 30.0], [0, 0], [now])
        assert subject.reason == reason, subject.reason


def test_a_board_may_begin_with_a_bad_reading():
    """There is no reading before it; and it is not armed with one."""
    for bad, reason in ((1, guard.NO_REASON), (2, guard.THERMOCOUPLE_OPEN)):
        board = PaperBoard()
        board.bad_frames[0] = bad
        host = Host(board)
        host.arm()
        assert host.guard.reason == reason
    host = Host()
    host.board.bad_frames[0] = 1
    host.run(110)
    host.arm()
    assert host.guard.state == guard.DISARMED
    host.run(100)
    host.arm()
    assert host.guard.state == guard.ARMED


def rising(rate, until):
    """A guard with a reading that rises, °C/s, of a wire that may be hot: readings and duties."""
    subject = guard.Guard(0, 4711)
    subject.observers = [heat.WireObserver(85.0), heat.WireObserver(85.0)]
    subject.proven = [True, True]
    reading, now, seen = 60.0, 0, []
    while reading < until and subject.reason < guard.LATCHING:
        now += 50
        if now > 1000:
            reading += rate / 20
        subject.sample(now, [60.0, reading], [30.0, 30.0], [0, 0], [now])
        arm(subject, now)
        subject.command(subject.session, now, now, (0.0, 0.01), now)
        seen.append((reading, subject.duty[1]))
    return subject.reason, seen


def test_duty_ends_as_a_reading_goes_from_100_to_105():
    reason, seen = rising(2.0, 109.0)
    assert reason == guard.NO_REASON
    assert min([duty for reading, duty in seen if 62 < reading < 92]) == 0.01
    assert max([duty for reading, duty in seen if reading >= 105]) == 0.0


def test_a_steep_rise_is_too_hot_before_the_limit():
    reason, seen = rising(25.0, 200.0)
    assert reason == guard.OVER_TEMPERATURE
    assert 80.0 < seen[-1][0] < 108.0


def test_sensors_of_no_cold_limb_do_not_arm():
    """Readings of a thermocouple that is reversed or disagrees, and amplifiers of no room."""
    for errors, junction, reason in (
        ([-19.0, 0.0], ROOM, guard.BELOW_ROOM),
        ([5.0, -5.0], ROOM, guard.DISAGREEING),
        ([-20.0, -20.0], ROOM - 20.0, guard.DISAGREEING),
        ([2.0, -2.0], ROOM, guard.NO_REASON),
    ):
        board = PaperBoard()
        board.errors, board.junctions = errors, [junction] * 2
        host = Host(board)
        host.arm()
        assert host.guard.reason == reason
        assert (host.guard.state == guard.ARMED) == (reason == guard.NO_REASON)


def close(value, expected, tolerance):
    return abs(value - expected) <= tolerance


def test_bounds_follow_the_solutions_of_the_paper_s_equations():
    """(6): a2 D / a1 (1 - exp(-a1 t)) for the least; the most settles at a2 D / a1 (1 - share)."""
    a1_slow, a1_fast, a2_least, a2_most, _ = heat.NOMINAL_BOUNDS
    wire = heat.WireObserver(0.0)
    for _ in range(200):
        wire.advance(0.1, 0.05, 0.0)
    assert close(wire.least, 1.7 / a1_fast * (1 - math.exp(-10.0 * a1_fast)), 0.05)
    assert wire.most > 2.3 / a1_slow * (1 - math.exp(-10.0 * a1_slow))  # silicone holds heat
    for _ in range(20000):
        wire.advance(0.1, 0.05, 0.0)
    assert close(wire.least, 0.1 * a2_least / a1_fast, 0.01)
    assert close(wire.most, 0.1 * a2_most / (a1_slow * (1 - heat.SILICONE_SHARE)), 0.1)
    assert close(wire.shortfall, wire.least, 0.1)  # the reading is 0
    assert wire.allowed_duty(wire.most) < 0.1 + 1e-3
    long = heat.WireObserver(0.0)
    long.advance(0.1, 1000.0, 0.0)  # in one go
    assert close(long.most, wire.most, 0.1)


def cold_thermocouple(board, off=1):
    """It has come off the wire, and reads the room with noise."""
    read, noise = board.read_thermocouple, iter(range(1000000))

    def read_cold(wire):
        there = board.temperatures[off]
        board.temperatures[off] = ROOM + (next(noise) * 5 % 7 - 3) / 4
        data = read(wire)
        board.temperatures[off] = there
        return data

    return read_cold


def test_what_a_board_says_of_its_start():
    latched = guard.THERMOCOUPLE_OPEN
    for cause, remembered, reason in (
        (firmware.POWER_ON, 0, guard.POWER_UP),
        (firmware.POWER_ON, latched, guard.POWER_UP),
        (firmware.PIN_RESET, 0, guard.WAS_RESET),
        (firmware.SOFT_RESET, latched, latched),
        (firmware.WATCHDOG_RESET, latched, latched),
        (firmware.WATCHDOG_RESET, 0, guard.RESTARTED),
        (firmware.LOCKUP_RESET, 0, guard.RESTARTED),
        (firmware.UNKNOWN_RESET, 0, guard.RESTARTED),
    ):
        host = Host(PaperBoard(cause, remembered))
        assert host.guard.reason == reason
        host.send(protocol.CLEAR, host.guard.challenge)
        host.run(1)
        assert host.board.remembered == 0


def test_steady_reading_is_no_frozen_one():
    """A wire that is held warm, whose readings have no noise and stand in the same quarter."""
    host = Host()
    host.arm()
    host.run(100000, (0.0, 0.11))
    assert host.guard.state == guard.ARMED
    assert abs(host.board.wires[1] - ROOM - 0.11 * 20.0 / 0.07) < 0.6


def four_wires():
    """A host of a board whose limb bends about two axes: wires at +E2, +E3, -E2 and -E3."""
    return Host(PaperBoard(pulls=(0, 8, 16, 24), angles=2))


def only(wire, share):
    """A duty of one wire of four."""
    return [share * (number == wire) for number in range(4)]


def test_each_of_four_wires_is_guarded():
    """While another one is heated, or this one for heat that its thermocouple does not show."""

    def open_it(board, wire):
        board.faults[wire] = 1

    def jump(board, wire):
        board.errors[wire] += guard.LARGEST_JUMP + 1.0

    def detach(board, wire):
        board.read_thermocouple = cold_thermocouple(board, wire)

    def conduct(board, wire):
        pass_time = board.pass_time

        def pass_and_warm():
            pass_time()
            board.wires[wire] += 0.02

        board.pass_time = pass_and_warm

    for wire in range(4):
        for change, reason, heated, limit in (
            (open_it, guard.THERMOCOUPLE_OPEN, wire + 1, 201),  # the second reading
            (jump, guard.TEMPERATURE_JUMP, wire + 1, 101),
            (conduct, guard.TOO_WARM, wire + 1, 3000),
            (detach, guard.NOT_WARMING, wire, 1600),
        ):
            host, duty = four_wires(), only(heated % 4, 1.0)
            host.arm()
            host.run(60, duty)
            assert host.board.duty == duty
            change(host.board, wire)
            host.time_to_off(limit, duty)
            assert host.guard.reason == reason, host.guard.reason
            host.run(300, duty)
            assert host.board.duty == [0.0] * 4


def test_each_of_two_angles_must_follow_its_wires():
    """One follows, the other has noise alone, or nothing, when wires across and along it heat."""
    noise = iter(range(1000000))
    for angle, silent in ((0, False), (1, False), (0, True), (1, True)):
        host = four_wires()
        host.arm()
        host.run(60, only(1 - angle, 0.5))
        read = host.board.read_bend

        def stick(read=read, angle=angle, silent=silent):
            data, stuck = read(), 0 if silent else next(noise) * 7 % 100
            data = data[: 1 + 2 * angle], struct.pack("<h", stuck), data[3 + 2 * angle :]
            return b"".join(data)

        host.board.read_bend = stick
        if silent:
            assert host.time_to_off(600, only(1 - angle, 0.5)) > 400
        else:
            host.run(10000, only(1 - angle, 0.5))
            host.run(8000, only(angle, 0.5))
            assert host.guard.state == guard.ARMED
            host.time_to_off(12000, only(angle + 2, 0.5))
        assert host.guard.reason == guard.BEND_STUCK


def test_clock_that_stands_still_switches_off():
    """Its watchdog may count the same clock, and is not fed; the supply's relay is let go."""
    host = Host()
    host.heat()
    host.firmware.step()  # in the same ms
    board, counts = host.board, {"held": 0, "fed": 0}
    board.keep_supply = lambda: counts.__setitem__("held", counts["held"] + 1)
    board.feed = lambda: counts.__setitem__("fed", counts["fed"] + 1)
    for _ in range(60):
        host.firmware.step()
    assert host.guard.reason == board.remembered == guard.CLOCK_STANDS
    assert board.duty == [0.0, 0.0]
    assert counts == {"held": 0, "fed": 0}


def test_checksum_is_the_usual_one():
    assert crc32(b"123456789") == b"\x26\x39\xf4\xcb"  # CBF43926, low byte first
    assert crc32(bytes(range(256))) == b"\x73\x8c\x05\x29"  # by zlib


def test_thermocouple_bytes_of_the_datasheet():
    # Table 4: 1600, 1000, 100.75, 25, 0, -0.25, -1, -250 °C as 14 bits.
    for bits, quarters in (
        (0b01100100000000, 6400),
        (0b00111110100000, 4000),
        (0b00000110010011, 403),
        (0b00000001100100, 100),
        (0b11111111111111, -1),
        (0b11111111111100, -4),
        (0b11110000011000, -1000),
    ):
        data = struct.pack(">I", bits << 18 | 22 << 8)
        assert readings.thermocouple(data) == (quarters, 22 * 16, 0)
    # Table 5: 127, 100.5625, 25, 0, -0.0625, -1, -20, -55 °C as 12 bits, of the amplifier.
    for bits, sixteenths in (
        (0b011111110000, 2032),
        (0b011001001001, 1609),
        (0b000110010000, 400),
        (0b000000000000, 0),
        (0b111111111111, -1),
        (0b111111110000, -16),
        (0b111011000000, -320),
        (0b110010010000, -880),
    ):
        data = struct.pack(">I", 100 << 18 | bits << 4)
        assert readings.thermocouple(data) == (100, sixteenths, 0)
    assert readings.thermocouple(b"\0\0\0\0")[2] == readings.OPEN
    assert readings.thermocouple(b"\xff\xff\xff\xff")[2] & readings.OPEN
    for bit in (3, 17, 16, 0):  # reserved bits, and a fault without a cause or the reverse
        data = struct.pack(">I", 100 << 18 | 22 << 8 | 1 << bit)
        assert readings.thermocouple(data)[2] & readings.INVALID


def test_bend_bytes():
    assert readings.bends(b"\x00\x40\x00") == (64,)
    assert readings.bends(b"\x00\xc0\xff") == (-64,)
    assert readings.bends(b"\x01\x40\x00") is None
    assert readings.bends(b"") is None
    assert readings.bends(b"\x00\x40\x00\xc0\xff", 2) == (64, -64)
    assert readings.bends(b"\x00\x40\x00", 2) is None


if __name__ == "__main__":
    print(sys.implementation.name, ".".join(map(str, sys.implementation.version)))
    tests = [(name, test) for name, test in globals().items() if name.startswith("test_")]
    for name, test in tests:
        print(name)
        test()
    print(len(tests), "passed")
