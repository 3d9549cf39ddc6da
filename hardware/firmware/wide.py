"""Frames of boards with other than two wires and one bend angle, as `protocol` has those of these.

Runs under MicroPython and CPython alike; a board with two wires does not load it.
"""

import math
import struct

from . import protocol

VERSION = 4
MOST_CHANNELS, MOST_ANGLES = 8, 6
GROUP = 4  # channels in a CHANNELS
NO_ANGLE = -0x8000  # in a SAMPLE, of an angle that the board does not have

BOUNDS = 0x06  # from the host to the board
CHANNELS = 0x83  # from the board to the host

FORMATS = {
    protocol.HELLO: "<",
    # challenge, wire, its five bounds as in protocol.ARM, its pull, see `shares`
    BOUNDS: "<HBHHHHHB",
    # challenge, channels, largest sum of duties in 1/10000, low half of the CRC-32 of all BOUNDS
    protocol.ARM: "<HBHH",
    # session, low half of the sequence, time of the newest sample in ms, duties in 1/10000
    protocol.COMMAND: "<HHI8H",
    protocol.DISARM: "<",
    protocol.CLEAR: "<H",
    # as of protocol, then angles, and CHANNELS in a sample
    protocol.INFO: "<HHh8sBBBB",
    # as of protocol up to the acknowledged sequence, then tip tangents in 1/64 degrees
    protocol.SAMPLE: "<HIHBBH6h",
    # sequence, first channel, channels in all; of each of four: temperature in 1/4 °C, applied
    # duty in 1/10000, the most that it can have in °C
    CHANNELS: "<HBBhHBhHBhHBhHB",
}


KINDS = protocol.KINDS + (BOUNDS,)  # noqa: RUF005 - as MicroPython has it


def encode(kind, *values):
    """The bytes of one frame."""
    return protocol.frame(VERSION, kind, struct.pack(FORMATS[kind], *values))


def checksum(parts):
    """What an ARM has of the values of all BOUNDS."""
    payloads = b"".join([struct.pack(FORMATS[BOUNDS], *part) for part in parts])
    return struct.unpack("<H", protocol.crc32(payloads)[:2])[0]


class Dialect:
    """What `firmware` does otherwise on such a board."""

    def __init__(self, channels, angles):
        self._channels, self._angles = channels, angles
        self.info = [angles, (channels - 1) // GROUP + 1]  # at the end of an INFO
        self._parts = [None] * channels  # values of each wire's last BOUNDS

    def handle(self, kind, values, guard, now):
        """Does what a frame asks the guard for; whether it is not as on other boards."""
        if kind == BOUNDS:
            if values[1] < self._channels:
                self._parts[values[1]] = values
        elif kind == protocol.ARM:
            self._arm(values, guard, now)
        elif kind == protocol.COMMAND:
            newest = guard.acknowledged  # the frame has the low half, which may have begun anew
            sequence = newest + ((values[1] - newest + 0x8000) & 0xFFFF) - 0x8000
            duty = [ticks / protocol.FULL_DUTY for ticks in values[3:]]
            guard.command(values[0], sequence, values[2], duty, now)
        else:
            return False
        return True

    def _arm(self, values, guard, now):
        """Arms, or has no bounds to arm with unless all BOUNDS came that the ARM is for."""
        challenge, channels, total, expected = values
        parts = self._parts
        whole = channels == len(parts) and all(part and part[0] == challenge for part in parts)
        if not whole or checksum(parts) != expected:
            parts = ()
        bounds = [protocol.read_bounds(part[2:7]) for part in parts]
        pulls = [part[7] for part in parts]
        turned = [shares(pulls, angle) for angle in range(self._angles)]
        guard.arm(challenge, bounds, total / protocol.FULL_DUTY, now, turned)

    def encode_sample(self, header, quarters, bends, ticks, most):
        """The frames of a sample, each as bytes; arguments as the values of `protocol.SAMPLE`."""
        bends = bends + [NO_ANGLE] * (MOST_ANGLES - self._angles)
        frames = [encode(protocol.SAMPLE, *(header + bends))]
        for first in range(0, self._channels, GROUP):
            values = [header[0], first, self._channels]
            for wire in range(first, first + GROUP):
                there = wire < self._channels
                values += [quarters[wire], ticks[wire], most[wire]] if there else [0, 0, 0]
            frames.append(encode(CHANNELS, *values))
        return frames


def shares(pulls, angle):
    """Share of each wire's torque that turns an angle.

    A pull has the first angle of the wire's segment in its upper three bits, and below them the
    wire's direction from +E2 towards +E3 in 1/32 turns. A segment that bends about two axes has
    two angles.
    """
    found = []
    for pull in pulls:
        first, direction = pull >> 5, pull & 31
        turn = math.pi / 16 * direction
        across = math.sin(turn) if angle == first + 1 and direction % 16 else 0.0
        found.append(math.cos(turn) if angle == first else across)
    return found
