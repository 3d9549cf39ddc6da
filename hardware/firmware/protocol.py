"""Frames between host and board: docs/protocol.md in code, for both sides.

Those here are for boards with two wires and one bend angle; `wide` has all others'.

Runs under MicroPython and CPython alike, hence the plain style.
"""

import struct

VERSION = 3
MAX_PAYLOAD = 24  # bytes; with its CRC and every byte escaped a frame stays below 64
FULL_DUTY = 10000  # a duty of 1 in a frame
HEATING_SCALE, RATE_SCALE = 100, 1000  # of a2, and of a1 and a3, in a frame

# From the host to the board.
HELLO, ARM, COMMAND, DISARM, CLEAR = KINDS = 0x01, 0x02, 0x03, 0x04, 0x05
# From the board to the host.
INFO, SAMPLE = 0x81, 0x82

FORMATS = {
    HELLO: "<",  # nothing
    # challenge, then of left and of right: a1 (slowest, fastest) in 1/1000 1/s, a2 (least, most) in
    # 1/100 °C/s, a3 (slowest) in 1/1000 1/s; largest sum of duties in 1/10000
    ARM: "<HHHHHHHHHHHH",
    # session, sequence, time of the newest sample in ms, duty of left and right in 1/10000
    COMMAND: "<HIIHH",
    DISARM: "<",  # nothing
    CLEAR: "<H",  # challenge
    # firmware version, sample period in ms, limit in 1/4 °C, serial number, channels, cause of the
    # last reset
    INFO: "<HHh8sBB",
    # sequence, time in ms, challenge, state, fault, acknowledged sequence, temperatures of left
    # and right in 1/4 °C, tip tangent in 1/64 degrees, applied duty of left and right in 1/10000,
    # the most that left and right can have in °C
    SAMPLE: "<HIHBBHhhhHHBB",
}

BOUND_SCALES = RATE_SCALE, RATE_SCALE, HEATING_SCALE, HEATING_SCALE, RATE_SCALE  # of a wire

_FLAG, _ESCAPE, _FLIP = 0x7E, 0x7D, 0x20
_ESCAPED = (_FLAG, _ESCAPE, 0x03)  # 0x03 interrupts a MicroPython that is at its prompt
_MAX_BODY = 2 + MAX_PAYLOAD + 4


def _crc_table():
    """Low and high halves, as MicroPython allocates memory for integers of more than 30 bits."""
    low, high = [], []
    for value in range(16):
        for _ in range(4):
            value = (value >> 1) ^ (0xEDB88320 if value & 1 else 0)
        low.append(value & 0xFFFF)
        high.append(value >> 16)
    return tuple(low), tuple(high)


_LOW, _HIGH = _crc_table()


def crc32(data):
    """The 4 bytes of the CRC-32 (ISO-HDLC), low byte first; by half bytes, small enough for us."""
    low = high = 0xFFFF
    for byte in data:
        low ^= byte
        index = low & 15  # twice the same, as a loop would allocate memory
        low = (low >> 4 | (high & 15) << 12) ^ _LOW[index]
        high = high >> 4 ^ _HIGH[index]
        index = low & 15
        low = (low >> 4 | (high & 15) << 12) ^ _LOW[index]
        high = high >> 4 ^ _HIGH[index]
    return struct.pack("<HH", low ^ 0xFFFF, high ^ 0xFFFF)


def encode(kind, *values):
    """The bytes of one frame."""
    return frame(VERSION, kind, struct.pack(FORMATS[kind], *values))


def frame(version, kind, payload):
    """The bytes of a frame of any version."""
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


def read_arm_values(values):
    """Challenge, bounds and total of an ARM's values."""
    bounds = [read_bounds(values[start : start + 5]) for start in (1, 6)]
    return values[0], bounds, values[11] / FULL_DUTY


def read_bounds(values):
    """A wire's bounds from those in a frame."""
    return tuple([value / scale for value, scale in zip(values, BOUND_SCALES)])


class Parser:
    """Finds frames in a stream that may contain other bytes.

    ``rejected`` counts what looked like frames and were none. ``version`` is that
    of the last frame. ``other_version`` is the version of the last frame of
    another version, None if none came.
    """

    def __init__(self, kinds, formats=None):
        """kinds: of the frames that are accepted; formats: of their versions, if not of 3."""
        self._kinds, self._formats = kinds, formats or {VERSION: FORMATS}
        self.version = min(self._formats)
        self._body = bytearray()
        self._escaping = False
        self._lost = True  # until the first flag
        self.rejected = 0
        self.other_version = None

    def feed(self, data):
        """Frames that end in these bytes, as a list of (kind, values)."""
        frames = []
        for byte in data:
            if byte == _FLAG:
                if not self._lost and not self._escaping and self._body:
                    self._finish(frames)
                elif self._body or self._escaping:
                    self.rejected += 1
                self._body = bytearray()
                self._escaping = self._lost = False
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
        """Skips everything up to the next flag."""
        self.rejected += 1
        self._body = bytearray()
        self._escaping = False
        self._lost = True

    def _finish(self, frames):
        body = bytes(self._body)
        if len(body) < 6 or body[-4:] != crc32(body[:-4]):
            self.rejected += 1
        elif body[0] not in self._formats:
            self.other_version = body[0]
        else:
            form = self._formats[body[0]].get(body[1]) if body[1] in self._kinds else None
            if form is None or struct.calcsize(form) != len(body) - 6:
                self.rejected += 1
                return
            self.version = body[0]
            frames.append((body[1], struct.unpack(form, body[2:-4])))
