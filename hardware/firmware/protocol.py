"""Frames between host and board: docs/protocol.md in code, for both sides.

This runs under MicroPython and CPython, hence the plain style.
"""

import math
import struct

VERSION = 5
MAX_PAYLOAD = 24  # bytes; with its CRC and every byte escaped a frame stays below 64
MOST_CHANNELS = 8  # of a board
MOST_ANGLES = 6
GROUP = 4  # largest number of channels in a CHANNELS
FULL_DUTY = 10000  # a duty of 1 in a frame
NO_READING = -0x8000  # in place of a temperature

# From the host to the board.
HELLO, ARM, COMMAND, DISARM, CLEAR, BOUNDS = KINDS = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
# From the board to the host.
INFO, SAMPLE, CHANNELS = BOARD_KINDS = 0x81, 0x82, 0x83

# Formats of the numbers that a payload begins with, and of the numbers for each wire or angle.
LAYOUTS = {
    HELLO: ("", ""),
    # challenge, wire, bounds: a1 (slowest, fastest) in 1/1000 1/s, a2 (least, most) in
    # 1/100 °C/s, a3 (slowest) in 1/1000 1/s; pull, see `shares`
    BOUNDS: ("HBHHHHHB", ""),
    # challenge, channels, largest sum of duties in 1/10000, low half of the CRC-32 of all BOUNDS
    ARM: ("HBHH", ""),
    # session, sequence, time of the newest sample in ms; duty of each wire in 1/10000
    COMMAND: ("HHI", "H"),
    DISARM: ("", ""),
    CLEAR: ("H", ""),  # challenge
    # protocol version, sample period in ms, limit in 1/4 °C, serial number, channels, angles,
    # cause of the last reset
    INFO: ("HHh8sBBB", ""),
    # sequence, time in ms, challenge, state, fault, acknowledged sequence; tip tangents in
    # 1/64 degrees
    SAMPLE: ("HIHBBH", "h"),
    # sequence, first channel, channels in all; of each channel: temperature in 1/4 °C or
    # NO_READING, applied duty in 1/10000, highest possible temperature in °C
    CHANNELS: ("HBB", "hHB"),
}

BOUND_SCALES = 1000, 1000, 100, 100, 1000  # of a wire's bounds in a frame

_FLAG = 0x7E
_ESCAPE = 0x7D
_FLIP = 0x20
_ESCAPED = (_FLAG, _ESCAPE, 0x03)  # 0x03 interrupts a MicroPython that is at its prompt
_MAX_BODY = 2 + MAX_PAYLOAD + 4


def _crc_table():
    """Return low and high halves; MicroPython allocates memory for integers beyond 30 bits."""
    low = []
    high = []
    for value in range(16):
        for _ in range(4):
            value = (value >> 1) ^ (0xEDB88320 if value & 1 else 0)
        low.append(value & 0xFFFF)
        high.append(value >> 16)
    return tuple(low), tuple(high)


_LOW, _HIGH = _crc_table()


def crc32(data):
    """Return the 4 bytes of the CRC-32 (ISO-HDLC), low byte first, by a table for half bytes."""
    low = high = 0xFFFF
    for byte in data:
        low ^= byte
        index = low & 15  # low half byte, then the high one; a loop would allocate memory
        low = (low >> 4 | (high & 15) << 12) ^ _LOW[index]
        high = high >> 4 ^ _HIGH[index]
        index = low & 15
        low = (low >> 4 | (high & 15) << 12) ^ _LOW[index]
        high = high >> 4 ^ _HIGH[index]
    return struct.pack("<HH", low ^ 0xFFFF, high ^ 0xFFFF)


def encode(kind, *values):
    """Return the bytes of one frame."""
    return frame(VERSION, kind, pack(kind, values))


def pack(kind, values):
    """Return the payload of a frame."""
    begin, each = LAYOUTS[kind]
    count = (len(values) - len(begin)) // len(each) if each else 0
    return struct.pack("<" + begin + each * count, *values)


def unpack(kind, payload):
    """Return the values in a payload; None if it has a wrong length."""
    begin, each = LAYOUTS[kind]
    size = len(payload) - struct.calcsize("<" + begin)
    count, rest = divmod(size, struct.calcsize("<" + each)) if each else (0, size)
    return None if rest or count < 0 else struct.unpack("<" + begin + each * count, payload)


def frame(version, kind, payload):
    """Return the bytes of a frame of any version."""
    body = bytes((version, kind)) + payload
    body += crc32(body)
    frame = bytearray((_FLAG,))
    for byte in body:
        if byte in _ESCAPED:
            frame.append(_ESCAPE)
            byte ^= _FLIP
        frame.append(byte)
    frame.append(_FLAG)
    return bytes(frame)


def checksum(parts):
    """Return the checksum in an ARM over the values of all BOUNDS."""
    payloads = b"".join([pack(BOUNDS, part) for part in parts])
    return struct.unpack("<H", crc32(payloads)[:2])[0]


def shares(pulls, angle):
    """Return the share of each wire's torque, from -1 to 1, that changes a bend angle.

    ``pulls`` has a byte for each wire: the index of the first bend angle of its segment in the
    upper three bits, and below them its direction from +E2 towards +E3 in 1/32 turns. A segment
    that bends about two axes has two bend angles. ``angle`` is the index of the bend angle.
    """
    of_wires = []
    for pull in pulls:
        first = pull >> 5
        direction = pull & 31
        turn = math.pi / 16 * direction
        share = 0.0
        if angle == first:
            share = math.cos(turn)
        elif angle == first + 1 and direction % 16:  # sin(turn) is 0, exactly, in half turns
            share = math.sin(turn)
        of_wires.append(share)
    return of_wires


class Parser:
    """A parser that finds frames in a stream that may contain other bytes.

    ``rejected`` counts broken frames. ``other_version`` is the version of the last frame of another
    version, or None.
    """

    def __init__(self, kinds):
        """kinds: kinds of accepted frames."""
        self._kinds = kinds
        self._body = bytearray()
        self._escaping = False
        self._lost = True  # until the first flag
        self.rejected = 0
        self.other_version = None

    def feed(self, data):
        """Return the frames that end in these bytes, as a list of (kind, values)."""
        frames = []
        for byte in data:
            # A flag ends one frame, and begins the next.
            if byte == _FLAG:
                if not self._lost and not self._escaping and self._body:
                    self._finish(frames)
                elif self._body or self._escaping:
                    self.rejected += 1
                self._body = bytearray()
                self._escaping = self._lost = False
            # Skip bytes outside of frames, and decode escapes.
            elif self._lost:
                pass
            elif byte == _ESCAPE:
                if self._escaping:  # never sent twice in a row
                    self._lose()
                self._escaping = True
            else:
                if self._escaping:
                    byte ^= _FLIP
                    self._escaping = False
                if len(self._body) >= _MAX_BODY:
                    self._lose()
                else:
                    self._body.append(byte)
        return frames

    def _lose(self):
        """Skip everything up to the next flag."""
        self.rejected += 1
        self._body = bytearray()
        self._escaping = False
        self._lost = True

    def _finish(self, frames):
        """Add the frame that has ended to the list if it is valid."""
        body = bytes(self._body)
        if len(body) < 6 or body[-4:] != crc32(body[:-4]):
            self.rejected += 1
        elif body[0] != VERSION:
            self.other_version = body[0]
        else:
            values = unpack(body[1], body[2:-4]) if body[1] in self._kinds else None
            if values is None:
                self.rejected += 1
            else:
                frames.append((body[1], values))
