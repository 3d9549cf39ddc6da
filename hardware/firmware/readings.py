"""The decoding of the sensors' bytes. It runs under MicroPython and CPython."""

import struct

# Faults that a MAX31855 reports in its lowest bits (datasheet 19-5793, table 3), and our fault for
# a frame that no MAX31855 sends.
OPEN, SHORT_TO_GROUND, SHORT_TO_SUPPLY, INVALID = 1, 2, 4, 8

_RESERVED = 1 << 17 | 1 << 3  # bits that are always 0
_FAULT = 1 << 16  # set if any fault is


def thermocouple(data):
    """Decode the 4 bytes of a MAX31855.

    Returns temperature in 1/4 °C, temperature of the amplifier in 1/16 °C, and fault bits. A bus
    without an answer reads all zeros or all ones, which no working amplifier sends: that counts as
    an open thermocouple.
    """
    (word,) = struct.unpack(">I", data)
    faults = word & 7
    if word in (0, 0xFFFFFFFF):
        faults |= OPEN
    elif word & _RESERVED or bool(word & _FAULT) != bool(faults):
        faults |= INVALID
    return _signed(word >> 18, 14), _signed(word >> 4 & 0xFFF, 12), faults


def _signed(bits, width):
    return bits - (1 << width) if bits >> (width - 1) else bits


def bends(data, angles=1):
    """Return tip tangent angles in 1/64 degree from bytes of ``read_bend``; None if invalid.

    A sample is the byte 0 and a signed 16-bit number for each angle, low byte first, like the
    sample of Bend Labs' one-axis sensor.
    """
    if len(data) != 1 + 2 * angles or data[0] != 0:
        return None
    return struct.unpack(f"<{angles}h", data[1:])
