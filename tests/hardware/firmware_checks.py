"""The firmware's own tests, on a board of paper: plain enough for MicroPython.

pytest runs them under CPython, test_firmware.py under MicroPython as well.
"""

import math
import struct
import sys

from hardware.firmware import firmware, from_host, guard, heat, protocol, readings, wide
from hardware.firmware.firmware import Firmware

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
        if self.faults[wire]:
            word |= 0x10000
        return struct.pack(">I", word | self.reserved)

    def read_bend(self):
        """The nominal limb's, with some noise in the last bits."""
        self.bend = (self.bend + 1) % 5
        data = b"\0"
        for angle in range(self.angles):
            pull = 0.0
            for wire, share in enumerate(wide.shares(self.pulls, angle)):
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
        self.version = self.firmware._version
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
        self.board.incoming += from_host.encode(self.version, *frame)

    def arm(self, bounds=heat.NOMINAL, total=1.0):
        pulls = self.board.pulls
        challenge, bounds = self.guard.challenge, [bounds] * len(pulls)
        frames = from_host.encode_arming(self.version, challenge, bounds, total, pulls)
        self.board.incoming += b"".join(frames)
        self.sequence = 0
        self.run(1)

    def command(self, duty, session=None, sequence=None, delay=0):
        self.sequence += 1
        ticks = [int(protocol.FULL_DUTY * d + 0.5) for d in duty]
        session = self.guard.session or 0 if session is None else session
        sequence = self.sequence if sequence is None else sequence
        heard = (self.last_sample()[1] - delay) & 0xFFFFFFFF
        values = session, sequence, heard, ticks
        self.board.incoming += from_host.encode_command(self.version, *values)

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
        parser = protocol.Parser((protocol.SAMPLE,), from_host.FORMATS)
        sent = self.board.sent[-3:]
        return parser.feed(b"".join(sent))[-1][1]


def test_a_session_from_greeting_to_disarming():
    """What the rules of conformance.py say of it; here also under MicroPython."""
    host = Host(milliseconds=200)
    host.arm()  # before ten samples
    host.run(500, (1.0, 1.0))
    assert host.board.duty == [0.0, 0.0]
    assert host.last_sample()[4] == guard.POWER_UP
    host.send(protocol.HELLO)
    host.run(1)
    frames = protocol.Parser((protocol.INFO,)).feed(host.board.sent[-1])
    assert frames[0][1][0] == 3
    assert frames[0][1][3:] == (b"paper\0\0\0", 2, firmware.POWER_ON)
    host.run(60)
    wrong = host.guard.challenge ^ 1
    host.send(protocol.ARM, *from_host.arm_values(wrong, (heat.NOMINAL, heat.NOMINAL), 1.0))
    host.run(200, (1.0, 0.0))
    assert host.board.duty == [0.0, 0.0]
    host.guard.proven = [True, True]
    host.arm(total=0.8)
    host.run(300, (1.0, 0.6))
    assert close(host.board.duty[0], 0.5, 1e-6)
    assert close(host.board.duty[1], 0.3, 1e-6)
    host.run(60, (0.0, 0.4))
    session, old = host.guard.session, host.sequence
    other = from_host.arm_values(host.guard.challenge, (heat.NOMINAL, heat.NOMINAL), 0.1)
    host.send(protocol.ARM, *other)
    for sequence in (old, old - 1, 1):
        host.command((1.0, 0.0), sequence=sequence)
    host.command((1.0, 0.0), session=session ^ 1)
    host.run(5)
    assert host.board.duty == [0.0, 0.4]
    host.send(protocol.DISARM)
    host.run(1)
    assert (host.board.duty, host.guard.reason) == ([0.0, 0.0], guard.HOST)
    host.arm()
    host.run(60, (0.0, 0.4))
    host.command((1.0001, 0.0))
    host.run(1)
    assert (host.board.duty, host.guard.reason) == ([0.0, 0.0], guard.OUT_OF_RANGE)


def test_heartbeat_ends_after_a_quarter_second_and_stays_off():
    host = Host()
    host.heat()
    start = host.board.now
    host.time_to_off(260, None)
    assert 100 <= host.board.now - start <= 251  # since the sample that the last one answered
    assert host.last_sample()[4] == guard.NO_COMMAND or host.guard.reason == guard.NO_COMMAND
    host.run(500, (0.0, 1.0))  # commands of before it switched off
    assert host.board.duty == [0.0, 0.0]
    host.arm()
    host.run(100, (0.0, 0.5))
    assert host.board.duty == [0.0, 0.5]


def check_latches(change, mend, reason, limit):
    """A fault switches off within the limit, ms, and stays until it is mended and cleared."""
    host = Host()
    host.heat()
    change(host.board)
    host.time_to_off(limit)
    assert host.guard.reason == reason, host.guard.reason
    assert host.last_sample()[4] == reason
    host.arm()
    host.run(300, (0.0, 1.0))
    assert host.board.duty == [0.0, 0.0]
    mend(host.board)
    host.run(300)
    assert host.guard.reason == reason
    host.arm()
    assert host.guard.state == guard.DISARMED
    host.send(protocol.CLEAR, host.guard.challenge)
    host.run(1)
    assert host.guard.state == guard.DISARMED
    host.arm()
    host.run(100, (0.0, 0.3))
    assert host.board.duty == [0.0, 0.3]


def set_fault(bits):
    def change(board):
        board.faults[1] = bits

    return change


def no_fault(board):
    board.faults[1] = 0


def test_thermocouple_faults_latch():
    check_latches(set_fault(1), no_fault, guard.THERMOCOUPLE_OPEN, 101)
    check_latches(set_fault(2), no_fault, guard.THERMOCOUPLE_TO_GROUND, 101)
    check_latches(set_fault(4), no_fault, guard.THERMOCOUPLE_TO_SUPPLY, 101)


def read_more(degrees):
    def change(board):
        board.errors[1] += degrees

    return change


def test_bits_that_no_amplifier_sends_latch():
    def change(board):
        board.reserved = 8

    def mend(board):
        board.reserved = 0

    check_latches(change, mend, guard.AMPLIFIER, 101)


def test_two_readings_above_the_limit_are_too_hot_and_one_is_not():
    for readings_above, reason in ((1, guard.NONE), (2, guard.OVER_TEMPERATURE)):
        subject = guard.Guard(0, 4711)
        subject.observers = [heat.WireObserver(80.0), heat.WireObserver(80.0)]
        now = 0
        for reading in [105.0] * 10 + [112.0] * readings_above + [105.0] * 3:
            for _ in (0, 1):  # samples for each reading
                now += 50
                if subject.state == guard.DISARMED and subject.reason < guard.LATCHING:
                    subject.arm(subject.challenge, (heat.NOMINAL, heat.NOMINAL), 1.0, now)
                subject.sample(now, [105.0, reading], [30.0, 30.0], [0, 0], [now])
        assert subject.reason == reason, subject.reason


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
        subject.arm(subject.challenge, (heat.NOMINAL, heat.NOMINAL), 1.0, now)
        subject.command(subject.session, now, now, (0.0, 0.01), now)
        seen.append((reading, subject.duty[1]))
    return subject.reason, seen


def test_duty_ends_as_a_reading_goes_from_100_to_105():
    reason, seen = rising(2.0, 109.0)
    assert reason == guard.NONE
    assert min([duty for reading, duty in seen if 62 < reading < 92]) == 0.01
    assert max([duty for reading, duty in seen if reading >= 105]) == 0.0


def test_a_steep_rise_is_too_hot_before_the_limit():
    reason, seen = rising(25.0, 200.0)
    assert reason == guard.OVER_TEMPERATURE
    assert 80.0 < seen[-1][0] < 108.0


def test_temperature_that_jumps_latches():
    jump = guard.LARGEST_JUMP + 1.0
    check_latches(read_more(jump), read_more(-jump), guard.TEMPERATURE_JUMP, 101)
    check_latches(read_more(-jump), read_more(jump), guard.TEMPERATURE_JUMP, 101)


def test_thermocouple_below_the_room_latches_before_arming():
    """It is reversed and the limb is warm, or it reads 19 °C too little."""
    board = PaperBoard()
    board.errors[0] = -19.0
    host = Host(board)
    assert host.guard.reason == guard.BELOW_ROOM
    host.arm()
    assert host.guard.state == guard.DISARMED


def test_thermocouples_that_disagree_when_cold_do_not_arm():
    board = PaperBoard()
    board.errors = [5.0, -5.0]
    host = Host(board)
    host.arm()
    assert (host.guard.state, host.guard.reason) == (guard.DISARMED, guard.DISAGREEING)
    board.errors = [2.0, -2.0]
    host.run(5000)
    host.arm()
    assert host.guard.state == guard.ARMED


def test_bounds_out_of_range_do_not_arm():
    for number, (low, high) in enumerate(heat.RANGES):
        for value in (0.5 * low, 2.0 * high):
            host = Host()
            bounds = list(heat.NOMINAL)
            bounds[number] = value
            host.arm(bounds)
            assert (host.guard.state, host.guard.reason) == (guard.DISARMED, guard.BAD_BOUNDS)
    a1_slow, a1_fast, a2_least, a2_most, a3_slow = heat.NOMINAL
    host.arm((a1_slow, a1_fast, a2_most, a2_least, a3_slow))
    assert host.guard.reason == guard.BAD_BOUNDS
    values = from_host.arm_values(host.guard.challenge, (heat.NOMINAL, heat.NOMINAL), 1.0)
    for total in (0, 20001):
        values[-1] = total
        host.send(protocol.ARM, *values)
        host.run(1)
        assert host.guard.reason == guard.BAD_BOUNDS
    host.arm()
    assert host.guard.state == guard.ARMED


def test_bounds_by_which_heat_need_not_show_arm_only_with_little_duty():
    hiding = (0.2, 0.5, 4.0, 8.0, 0.1)
    wide = (0.005, 0.5, 4.0, 100.0, 0.1)  # whose most allows little duty itself
    for bounds, total, armed in ((hiding, 1.0, False), (hiding, 0.12, True), (wide, 1.5, True)):
        host = Host()
        host.arm(bounds, total)
        assert (host.guard.state == guard.ARMED) == armed
        assert armed or host.guard.reason == guard.BAD_BOUNDS


def test_amplifiers_of_no_room_do_not_arm():
    """Both junctions are 20 °C too low, and so is what thermocouples read."""
    board = PaperBoard()
    board.junctions, board.errors = [ROOM - 20.0] * 2, [-20.0, -20.0]
    host = Host(board)
    host.arm()
    assert (host.guard.state, host.guard.reason) == (guard.DISARMED, guard.DISAGREEING)


def close(value, expected, tolerance):
    return abs(value - expected) <= tolerance


def test_bounds_follow_the_solutions_of_the_paper_s_equations():
    """(6): a2 D / a1 (1 - exp(-a1 t)) for the least; the most settles at a2 D / a1 (1 - share)."""
    a1_slow, a1_fast, a2_least, a2_most, _ = heat.NOMINAL
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


def test_duty_is_reduced_before_a_wire_may_be_too_hot():
    host = Host()
    host.arm()
    hottest = 0.0
    for _ in range(300):
        host.run(100, (0.0, 1.0))
        hottest = max(hottest, host.guard.observers[1].most + ROOM)
    assert host.guard.state == guard.ARMED
    assert close(hottest, guard.HIGHEST, 1.0)
    assert 0.05 < host.board.duty[1] < 0.3
    sample = host.last_sample()
    assert close(sample[10] / protocol.FULL_DUTY, host.board.duty[1], 1e-4)  # and the host is told
    assert sample[12] == 127


def test_commands_that_answer_old_samples_are_refused():
    host = Host()
    host.heat()
    off = host.time_to_off
    start = host.board.now
    while host.board.duty != [0.0, 0.0]:
        host.run(1, (0.0, 1.0), delay=260)
    assert host.board.now - start <= 251
    assert off(1) == 0
    assert host.guard.reason == guard.LATE_COMMANDS
    host = Host()
    host.heat()
    host.run(1000, (0.0, 1.0), delay=120)  # slow, but in time
    assert host.board.duty == [0.0, 1.0]
    host.command((0.0, 0.5), delay=-1000)  # answers a sample that is not yet
    host.run(5)
    assert host.board.duty == [0.0, 1.0]


def test_silent_bend_sensor_latches():
    def silence(board):
        board.silent = True

    def speak(board):
        board.silent = False

    check_latches(silence, speak, guard.BEND_SILENT, 51)


def test_stuck_bend_sensor_is_noticed():
    host = Host()
    host.heat()
    host.board.read_bend = lambda: bytes((0, 7, 0))
    assert host.time_to_off(600) > 400
    assert host.guard.reason == guard.BEND_STUCK


def test_stuck_bend_sensor_with_noise_is_noticed():
    host = Host()
    host.arm()
    noise = iter(range(1000000))
    host.board.read_bend = lambda: bytes((0, next(noise) * 7 % 100, 0))
    host.run(10000, (0.0, 0.5))
    assert host.guard.state == guard.ARMED
    host.time_to_off(10000, (0.5, 0.0))
    assert host.guard.reason == guard.BEND_STUCK


def test_heat_that_a_thermocouple_does_not_show():
    for duty, limit in ((0.1, 6000), (0.3, 3000), (1.0, 1600)):
        host = Host()
        host.arm()
        host.run(100, (0.0, duty))
        host.board.read_thermocouple = cold_thermocouple(host.board)
        host.time_to_off(limit, (0.0, duty))
        assert host.guard.reason == guard.NOT_WARMING


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


def test_wire_that_is_held_warm_need_not_warm():
    host = Host()
    host.arm()
    host.run(30000, (0.0, 0.2))
    assert host.board.duty == [0.0, 0.2]


def test_wire_that_warms_without_duty_latches():
    """Its MOSFET is shorted."""
    host = Host()
    host.arm()
    start = host.board.now
    while host.guard.state == guard.ARMED:
        host.board.wires[0] += 1.0
        host.run(50, (0.0, 0.1))
        assert host.board.now - start < 3000, "still armed"
    assert host.guard.reason == guard.TOO_WARM
    held = host.board.held
    host.run(500)
    assert host.board.held == held  # the supply's relay drops out


def test_supply_is_held_only_while_armed():
    host = Host()
    assert host.board.held == 0
    host.heat()
    assert host.board.held == host.board.now
    host.send(protocol.DISARM)
    host.run(10)
    assert host.board.held < host.board.now - 5


def test_latch_outlives_a_reset():
    host = Host()
    host.heat()
    set_fault(1)(host.board)
    host.run(150)
    assert host.board.remembered == guard.THERMOCOUPLE_OPEN
    for cause, reason in (
        (firmware.SOFT_RESET, guard.THERMOCOUPLE_OPEN),
        (firmware.WATCHDOG_RESET, guard.THERMOCOUPLE_OPEN),
        (firmware.POWER_ON, guard.POWER_UP),
    ):
        again = Host(PaperBoard(cause, host.board.remembered))
        assert again.guard.reason == reason
    again = Host(PaperBoard(firmware.SOFT_RESET, host.board.remembered))
    again.send(protocol.CLEAR, again.guard.challenge)
    again.run(1)
    assert again.board.remembered == 0


def test_reset_of_its_own_latches():
    for cause in (firmware.WATCHDOG_RESET, firmware.LOCKUP_RESET, firmware.UNKNOWN_RESET):
        host = Host(PaperBoard(cause))
        assert host.guard.reason == guard.RESTARTED
        host.arm()
        assert host.guard.state == guard.DISARMED


def test_after_a_reset_wires_may_be_hot():
    host = Host(PaperBoard(firmware.PIN_RESET))
    assert host.guard.reason == guard.RESET
    host.arm()
    host.run(200, (1.0, 0.0))
    assert host.board.duty[0] < 0.3
    host.run(60000, (0.0, 0.0))
    host.run(200, (1.0, 0.0))
    assert host.board.duty[0] == 1.0


def test_after_a_start_there_is_little_duty_until_a_thermocouple_has_followed():
    for cause in (firmware.POWER_ON, firmware.PIN_RESET):
        host = Host(PaperBoard(cause), proven=False)
        host.arm()
        host.run(300, (0.0, 1.0))
        assert close(host.board.duty[1], heat.LITTLE_DUTY, 1e-6)
        assert host.last_sample()[12] > 120
        host.run(3700, (0.0, 1.0))
        assert host.board.duty[1] == 1.0
        assert host.last_sample()[12] < 100


def test_first_contact_with_bounds_for_any_wire_is_not_reduced():
    host = Host(proven=False)
    host.arm((0.02, 0.15, 8.0, 80.0, 0.1), 0.3)
    host.run(5000, (0.0, 0.1))
    assert host.board.duty == [0.0, 0.1]
    assert host.guard.proven == [False, True]


def test_power_cycles_do_not_add_up():
    board = PaperBoard()
    board.read_thermocouple = cold_thermocouple(board)
    hottest = 0.0
    for _ in range(12):
        board.now, board.duty = 0, [0.0, 0.0]
        host = Host(board, proven=False)
        host.arm()
        host.run(3900, (0.0, 1.0))
        hottest = max(hottest, board.wires[1])
    assert 45.0 < hottest < 100.0


def test_reading_that_stands_still_gets_no_duty_and_then_latches():
    host = Host()
    host.arm()
    host.run(8000, (0.0, 0.15))
    read, frozen = host.board.read_thermocouple, host.board.read_thermocouple(1)
    host.board.read_thermocouple = lambda wire: frozen if wire else read(wire)
    host.run(9800, (0.0, 0.1))
    assert host.guard.state == guard.ARMED
    assert 0.0 < host.board.duty[1] < 0.08
    host.time_to_off(12000, (0.01, 0.1))
    host.run(7000, (0.01, 0.1))
    assert host.guard.reason == guard.NOT_WARMING


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


def check_ends(host, duty, reason, limit):
    """All wires are off within a limit, ms, for a reason, and stay off."""
    host.time_to_off(limit, duty)
    assert host.guard.reason == reason, host.guard.reason
    assert host.last_sample()[4] in (reason, guard.NONE)  # the sample may be from before
    host.run(300, duty)
    assert host.board.duty == [0.0] * 4


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
            (open_it, guard.THERMOCOUPLE_OPEN, wire + 1, 101),
            (jump, guard.TEMPERATURE_JUMP, wire + 1, 101),
            (conduct, guard.TOO_WARM, wire + 1, 3000),
            (detach, guard.NOT_WARMING, wire, 1600),
        ):
            host, duty = four_wires(), only(heated % 4, 1.0)
            host.arm()
            host.run(60, duty)
            assert host.board.duty == duty
            change(host.board, wire)
            check_ends(host, duty, reason, limit)


def test_four_wires_share_their_total():
    host = four_wires()
    host.arm(total=1.2)
    host.run(300, (0.8, 0.8, 0.4, 0.4))
    for wire, share in enumerate((0.4, 0.4, 0.2, 0.2)):
        assert close(host.board.duty[wire], share, 1e-6)


def test_four_wires_arm_only_by_all_of_their_bounds():
    """One lost, one of another set, of another challenge, for fewer wires, or too much in all."""
    pulls, bounds = (0, 8, 16, 24), [heat.NOMINAL] * 4
    other = [(0.05, 0.095, 17.0, 23.0, 0.5)] * 4

    def frames(challenge, bounds=bounds, total=1.0, count=4):
        return from_host.encode_arming(wide.VERSION, challenge, bounds, total, pulls[:count])

    for wrong in (
        lambda right: frames(right)[1:],
        lambda right: frames(right)[:2] + frames(right)[3:],
        lambda right: frames(right, other)[:1] + frames(right)[1:],
        lambda right: frames(right ^ 1)[:4] + frames(right)[4:],
        lambda right: frames(right, count=3),
        lambda right: frames(right, total=4.1),
    ):
        host = four_wires()
        host.board.incoming = b"".join(wrong(host.guard.challenge))
        host.run(10)
        assert (host.guard.state, host.guard.reason) == (guard.DISARMED, guard.BAD_BOUNDS)
        host.guard.session = host.guard.challenge  # as a host that heats all the same
        host.run(200, (0.5,) * 4)
        assert host.board.duty == [0.0] * 4
        host.arm()
        host.run(60, (0.2,) * 4)
        assert host.board.duty == [0.2] * 4
    host = four_wires()
    host.board.incoming = b"".join(frames(host.guard.challenge ^ 1))
    host.run(10)
    assert (host.guard.state, host.guard.reason) == (guard.DISARMED, guard.POWER_UP)


def test_frames_of_the_other_version_have_no_effect():
    for host, spoken in ((Host(), wide.VERSION), (four_wires(), protocol.VERSION)):
        host.arm()
        host.run(300, [0.1] * host.board.channels)
        host.board.sent.clear()
        values = host.guard.session, host.sequence + 1, host.board.now, [9000, 9000]
        host.board.incoming += from_host.encode_command(spoken, *values)
        for kind in (protocol.DISARM, protocol.HELLO):
            host.board.incoming += from_host.encode(spoken, kind)
        host.run(2)
        assert host.board.duty == [0.1] * host.board.channels
        assert host.board.sent == []  # no INFO
        assert host.firmware._parser.other_version == spoken


def test_duty_of_a_wire_that_is_not_there_switches_off():
    host = four_wires()
    host.arm()
    host.run(300, only(0, 0.5))
    host.command((0.5, 0.0, 0.0, 0.0, 0.1))
    host.run(1)
    assert (host.board.duty, host.guard.reason) == ([0.0] * 4, guard.OUT_OF_RANGE)


def test_a_session_goes_on_when_the_half_of_its_sequence_begins_anew():
    host = four_wires()
    host.arm()
    host.guard.acknowledged = host.sequence = 0xFFFD
    host.run(500, only(1, 0.5))
    assert host.guard.acknowledged == host.sequence == 0xFFFD + 10
    assert host.last_sample()[5] < 10
    for old in (0xFFFD, host.sequence, host.sequence + 0x8000):
        host.command(only(1, 1.0), sequence=old)
    host.run(5)
    assert host.board.duty == only(1, 0.5)


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


def test_samples_come_at_their_rate_and_the_watchdog_is_fed():
    host = Host()
    host.board.sent.clear()
    fed = host.board.fed
    host.run(1000)
    assert len(host.board.sent) in (38, 40, 42)  # each twice
    assert 950 <= host.board.fed - fed <= 1050


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
    assert host.guard.reason == board.remembered == guard.CLOCK
    assert board.duty == [0.0, 0.0]
    assert counts == {"held": 0, "fed": 0}


def test_frames_fit_into_packets_and_hide_bytes():
    a, b = 0x7E7E, 0x7D7D
    worst = protocol.encode(protocol.ARM, *[a] * 12)
    assert len(worst) <= 64
    sample = a, 0x7E7E7E7E, b, 3, 0x7E, a, a, b, a, 771, 771, 0x7E, 0x7D
    worst = protocol.encode(protocol.SAMPLE, *sample)
    assert len(worst) <= 64
    assert 3 not in worst
    assert 0x7E not in worst[1:-1]
    values = protocol.Parser((protocol.SAMPLE,)).feed(worst)[0][1]
    assert values[1] == 0x7E7E7E7E


def test_checksum_is_the_usual_one():
    assert protocol.crc32(b"123456789") == b"\x26\x39\xf4\xcb"  # CBF43926, low byte first


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
    print(sys.implementation.name)
    tests = [(name, test) for name, test in globals().items() if name.startswith("test_")]
    for name, test in tests:
        print(name)
        test()
    print(len(tests), "passed")
