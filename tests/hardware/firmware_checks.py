"""The firmware's own tests, on a board of paper: plain enough for MicroPython.

pytest runs them under CPython, test_firmware.py under MicroPython as well.
"""

from hardware.firmware import guard, protocol, readings
from hardware.firmware.firmware import Firmware

ROOM = 22 << 4  # °C of the amplifiers themselves, in 1/16


class PaperBoard:
    """A board whose clock and sensors are what a test writes on it."""

    def __init__(self):
        self.now = 0
        self.incoming = b""
        self.sent = []
        self.duty = [None, None]
        self.temperatures = [25.0, 25.0]
        self.faults = [0, 0]
        self.bend = 0
        self.silent = False
        self.fed = 0
        self.serial_number = b"paper\0\0\0"
        self.random = 4711

    def ticks(self):
        return self.now

    def receive(self):
        data, self.incoming = self.incoming, b""
        return data

    def send(self, data):
        self.sent.append(data)

    def read_thermocouple(self, wire):
        word = (int(4 * self.temperatures[wire]) & 0x3FFF) << 18 | ROOM << 4 | self.faults[wire]
        if self.faults[wire]:
            word |= 0x10000
        return bytes((word >> 24 & 255, word >> 16 & 255, word >> 8 & 255, word & 255))

    def read_bend(self):
        self.bend = (self.bend + 1) % 100
        return b"" if self.silent else bytes((0, self.bend, 0))

    def set_duty(self, wire, duty):
        self.duty[wire] = duty

    def feed(self):
        self.fed += 1


class Host:
    """Runs a firmware on paper, a millisecond at a time, and talks to it."""

    def __init__(self):
        self.board = PaperBoard()
        self.firmware = Firmware(self.board)
        self.guard = self.firmware.guard
        self.sequence = 0
        self.run(100)

    def run(self, milliseconds, duty=None, warming=0.0):
        """Runs on; commands a duty each 50 ms if there is one; wires warm by °C each second."""
        for _ in range(milliseconds):
            self.board.now += 1
            for wire in (0, 1):
                self.board.temperatures[wire] += warming / 1000
            if duty is not None and self.board.now % 50 == 0:
                self.command(duty)
            self.firmware.step()

    def send(self, *frame):
        self.board.incoming += protocol.encode(*frame)

    def arm(self):
        self.send(protocol.ARM, self.guard.challenge)
        self.sequence = 0
        self.run(1)

    def command(self, duty, session=None):
        self.sequence += 1
        ticks = [int(protocol.FULL_DUTY * d) for d in duty]
        session = self.guard.session or 0 if session is None else session
        self.send(protocol.COMMAND, session, self.sequence, *ticks)

    def heat(self):
        self.arm()
        self.run(500, (0.0, 1.0), 20.0)
        assert self.board.duty == [0.0, 1.0]

    def time_to_off(self, limit, duty=(0.0, 1.0), warming=20.0):
        start = self.board.now
        while self.board.duty != [0.0, 0.0]:
            self.run(1, duty, warming)
            assert self.board.now - start <= limit, "still on"
        return self.board.now - start

    def last_sample(self):
        parser = protocol.Parser((protocol.SAMPLE,))
        return parser.feed(self.board.sent[-1])[0][1]


def test_nothing_heats_before_arming():
    host = Host()
    host.run(500, (1.0, 1.0))
    assert host.board.duty == [0.0, 0.0]
    assert host.last_sample()[4] == guard.POWER_UP


def test_arming_needs_the_present_challenge():
    host = Host()
    host.send(protocol.ARM, host.guard.challenge ^ 1)
    host.run(200, (1.0, 0.0))
    assert host.board.duty == [0.0, 0.0]
    host.arm()
    host.run(200, (1.0, 0.0), 20.0)
    assert host.board.duty == [1.0, 0.0]


def test_arming_again_changes_nothing():
    host = Host()
    host.heat()
    session, acknowledged = host.guard.session, host.guard.acknowledged
    host.send(protocol.ARM, host.guard.challenge)
    host.run(1)
    assert (host.guard.session, host.guard.acknowledged) == (session, acknowledged)
    assert host.board.duty == [0.0, 1.0]


def test_heartbeat_ends_after_a_quarter_second_and_stays_off():
    host = Host()
    host.heat()
    start = host.board.now
    host.time_to_off(260, None)
    assert 200 <= host.board.now - start <= 251
    assert host.last_sample()[4] == guard.NO_COMMAND or host.guard.reason == guard.NO_COMMAND
    host.run(500, (0.0, 1.0))  # commands of before it switched off
    assert host.board.duty == [0.0, 0.0]
    host.arm()
    host.run(100, (0.0, 0.5), 20.0)
    assert host.board.duty == [0.0, 0.5]


def test_commands_that_are_old_doubled_or_of_another_session_do_nothing():
    host = Host()
    host.heat()
    host.run(60, (0.0, 0.4), 20.0)
    old = host.sequence
    for sequence in (old, old - 1, 1):
        host.send(protocol.COMMAND, host.guard.session, sequence, 10000, 10000)
    host.command((1.0, 1.0), session=host.guard.session ^ 1)
    host.run(5)
    assert host.board.duty == [0.0, 0.4]


def test_command_out_of_range_switches_off():
    host = Host()
    host.heat()
    host.send(protocol.COMMAND, host.guard.session, host.sequence + 1, 10001, 0)
    host.run(1)
    assert host.board.duty == [0.0, 0.0]
    assert host.guard.reason == guard.OUT_OF_RANGE


def check_latches(change, mend, reason, limit):
    """A fault switches off within the limit, ms, and stays until it is mended and cleared."""
    host = Host()
    host.heat()
    change(host.board)
    host.time_to_off(limit)
    assert host.guard.reason == reason, guard.TEXTS[host.guard.reason]
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
    host.run(100, (0.0, 0.3), 20.0)
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


def test_too_hot_latches():
    host = Host()
    host.arm()
    while host.board.temperatures[1] <= guard.TEMPERATURE_LIMIT:
        assert host.guard.reason == guard.NONE
        host.run(1, (0.0, 1.0), 20.0)
    host.time_to_off(101)
    assert host.guard.reason == guard.OVER_TEMPERATURE
    host.arm()
    assert host.guard.state == guard.DISARMED
    while host.board.temperatures[1] > 40.0:  # no faster than a wire cools
        host.run(10, (0.0, 1.0), -40.0)
    assert host.board.duty == [0.0, 0.0]
    host.arm()
    assert (host.guard.state, host.guard.reason) == (guard.DISARMED, guard.OVER_TEMPERATURE)
    host.send(protocol.CLEAR, host.guard.challenge)
    host.run(1)
    host.heat()


def test_temperature_that_jumps_latches():
    def jump(board):
        board.temperatures[1] += guard.LARGEST_JUMP + 5.0

    def fall(board):
        board.temperatures[1] -= guard.LARGEST_JUMP + 5.0

    check_latches(jump, fall, guard.TEMPERATURE_JUMP, 101)
    check_latches(fall, jump, guard.TEMPERATURE_JUMP, 101)


def test_silent_bend_sensor_latches():
    def silence(board):
        board.silent = True

    def speak(board):
        board.silent = False

    check_latches(silence, speak, guard.BEND_SILENT, 51)


def test_the_first_fault_that_latches_is_the_one_reported():
    host = Host()
    host.heat()
    host.board.faults[1] = 1
    host.time_to_off(101)
    host.board.silent = True
    host.run(200)
    assert host.guard.reason == guard.THERMOCOUPLE_OPEN


def test_stuck_bend_sensor_is_noticed():
    host = Host()
    host.heat()
    host.board.read_bend = lambda: bytes((0, 7, 0))
    assert host.time_to_off(600) > 400
    assert host.guard.reason == guard.BEND_STUCK


def test_wire_that_is_heated_and_does_not_warm():
    host = Host()
    host.heat()
    assert host.time_to_off(1700, (0.0, 1.0), 0.0) > 1000
    assert host.guard.reason == guard.NOT_WARMING


def test_wire_that_is_held_warm_need_not_warm():
    host = Host()
    host.heat()
    host.run(20000, (0.0, 0.3), 0.0)
    assert host.board.duty == [0.0, 0.3]


def test_disarming_needs_nothing():
    host = Host()
    host.heat()
    host.send(protocol.DISARM)
    host.run(1)
    assert host.board.duty == [0.0, 0.0]
    assert host.guard.reason == guard.HOST


def test_samples_come_at_their_rate_and_the_watchdog_is_fed():
    host = Host()
    sent, fed = len(host.board.sent), host.board.fed
    host.run(1000)
    assert len(host.board.sent) - sent in (19, 20, 21)
    assert host.board.fed - fed == 1000


def test_greeting_is_answered():
    host = Host()
    host.send(protocol.HELLO)
    host.run(1)
    frames = protocol.Parser((protocol.INFO,)).feed(host.board.sent[-1])
    assert frames[0][1][0] == 2
    assert frames[0][1][3:] == (b"paper\0\0\0", 2)


def test_frames_fit_into_packets_and_hide_bytes():
    a, b = 0x7E7E, 0x7D7D
    worst = protocol.encode(protocol.SAMPLE, a, 0x7E7E7E7E, b, 3, 0x7E, a, a, b, a, 771, 771)
    assert len(worst) <= 64
    assert 3 not in worst
    assert 0x7E not in worst[1:-1]
    values = protocol.Parser((protocol.SAMPLE,)).feed(worst)[0][1]
    assert values[1] == 0x7E7E7E7E


def test_checksum_is_the_usual_one():
    assert protocol.crc32(b"123456789") == 0xCBF43926


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
        word = bits << 18 | ROOM << 4
        data = bytes((word >> 24 & 255, word >> 16 & 255, word >> 8 & 255, word & 255))
        assert readings.thermocouple(data) == (quarters, 0)
    assert readings.thermocouple(b"\0\0\0\0")[1] == readings.OPEN
    assert readings.thermocouple(b"\xff\xff\xff\xff")[1] & readings.OPEN
    assert readings.thermocouple(b"\x01\x91\x16\x00")[1] == readings.OPEN  # without a cause


def test_bend_bytes():
    assert readings.bend(b"\x00\x40\x00") == 64
    assert readings.bend(b"\x00\xc0\xff") == -64
    assert readings.bend(b"\x01\x40\x00") is None
    assert readings.bend(b"") is None


def run_all():
    """Runs every test above; for interpreters without pytest. Returns how many."""
    tests = [(name, test) for name, test in globals().items() if name.startswith("test_")]
    for name, test in tests:
        print(name)
        test()
    return len(tests)
