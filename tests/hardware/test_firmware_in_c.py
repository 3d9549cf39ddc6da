"""The sketch's core in C calls its board as the firmware in Python does."""

import random
import struct

import frame_fuzzing
import pytest

from hardware.firmware import firmware, from_host, guard, heat, protocol

from .c_firmware import COMPILER
from .firmware_checks import PaperBoard


@pytest.mark.skipif(not COMPILER, reason="there is no C compiler here")
def test_the_core_does_what_the_firmware_in_python_does_where_things_go_wrong(both_firmwares):
    """Byte for byte and call for call; test_board_rules.py has the rules of a board."""
    rng, heated, reasons = random.Random(0), 0, set()
    for _ in range(18):
        episode = Episode(rng, both_firmwares)
        for _ in range(400):
            episode.pass_once()
            heated += episode.duty != [0.0, 0.0]
            reasons.add(episode.program.guard.reason)
    assert heated > 1800  # of 7200 passes
    assert len(reasons) > 14


class Episode(PaperBoard):
    """A board on paper and a host that heats, where one thing after the other goes wrong."""

    def __init__(self, rng, program):
        causes = firmware.POWER_ON, firmware.PIN_RESET, firmware.WATCHDOG_RESET
        super().__init__(rng.choices(causes, (4, 2, 1))[0], rng.choice([0, 0, 0, guard.TOO_WARM]))
        self.now = rng.choice([0, 2**32 - 10_000])  # ms; the core's wrap
        if rng.random() < 0.2:
            self.junctions = [rng.uniform(9.0, 26.0), rng.choice([10.5, 18.0, 25.0])]
        self.drift = [rng.choice([0.0, 0.0, rng.uniform(-0.5, 1.0)]) for _ in (0, 1)]  # °C/s
        tight, wide = (0.07, 0.07, 20.0, 20.0, 1.0), (0.042, 0.085, 6.0, 23.0, 0.5)
        self.bounds = rng.choices([heat.NOMINAL_BOUNDS, tight, wide], k=2)
        self.total = rng.choice([2.0, 2.0, 1.0, 0.4])
        self.rng, self.program = rng, program(self)
        self.asked, self.sequence = (0.0, 0.0), 0
        self.mend()

    def mend(self):
        self.frozen, self.stuck, self.silent, self.standing = [None, None], None, False, 0
        self.faults, self.reserved, self.errors = [0, 0], 0, [0.0, 0.0]
        self.bad_frames = [0, 0]

    def go_wrong(self):
        rng, wire = self.rng, self.rng.randrange(2)
        self.mend()
        match rng.randrange(10):
            case 0:
                self.frozen[wire] = super().read_thermocouple(wire)
            case 1:
                self.stuck = rng.randrange(-99, 99), rng.choice([0, 5])  # and its noise
            case 2:
                self.silent = True
            case 3:
                self.faults[wire] = rng.choice([1, 2, 4])
            case 4:
                self.reserved = 8
            case 5:
                self.errors[wire] = rng.uniform(-12.0, 12.0)
            case 6:
                self.wires[wire] += rng.uniform(0.0, 40.0)
            case 7:
                self.standing = rng.choice([50, 60])  # passes
            case 8:
                self.drift[wire] = rng.choice([0.0, 6.0, 30.0])
            case 9:
                self.bad_frames[wire] = rng.choice([1, 1, 2])

    def read_thermocouple(self, wire):
        return self.frozen[wire] or super().read_thermocouple(wire)

    def read_bend(self):
        data = super().read_bend()
        if self.stuck is None or not data:
            return data
        return struct.pack("<bh", 0, self.stuck[0] + self.rng.randint(0, self.stuck[1]))

    def pass_once(self):
        rng = self.rng
        interval = rng.choice([50, 50, 50, 25, 110]) if self.standing <= 0 else 0
        self.standing -= 1
        self.pass_time(interval)
        for wire in (0, 1):
            self.errors[wire] += interval / 1000 * self.drift[wire]
        if rng.random() < 0.004:
            self.go_wrong()
        if rng.random() < 0.01:
            self.asked = rng.choice([(0.3, 0.3), (0.5, 0.0), (0.0, 0.9), (0.0, 0.0), (1.0, 0.2)])
        frame = self.frame()
        self.incoming = frame if rng.random() < 0.9 else frame_fuzzing.mutate(frame, rng) + frame
        self.program.step()
        self.sent.clear()

    def frame(self):
        """A COMMAND, or what it takes to arm the board."""
        subject, rng = self.program.guard, self.rng
        if subject.state == guard.ARMED:
            self.sequence += 1
            heard = self.now - rng.choice([50, 50, 50, 249, 250])
            return from_host.encode_command(subject.session, self.sequence, heard, self.asked)
        self.sequence = 0
        clear = protocol.encode(protocol.CLEAR, subject.challenge) if rng.random() < 0.05 else b""
        pulls = rng.choice([self.pulls] * 9 + [self.pulls[::-1]])
        arming = subject.challenge, self.bounds, self.total, pulls
        return clear + b"".join(from_host.encode_arming(*arming))
