"""Decodes the bytes of the sensors. Runs under MicroPython and CPython alike."""

import struct

# Faults that a MAX31855 reports in its lowest bits (datasheet 19-5793, table 3), and one that is
# ours: a frame that no MAX31855 sends.
OPEN, SHORT_TO_GROUND, SHORT_TO_SUPPLY, INVALID = 1, 2, 4, 8

_RESERVED = 1 << 17 | 1 << 3  # bits that are always 0
_FAULT = 1 << 16  # set if any fault is


def thermocouple(data):
    """Temperature in 1/4 °C, the amplifier's in 1/16 °C, and fault bits, from a MAX31855's 4 bytes.

    A bus that answers nothing reads all zeros or all ones, which no working
    amplifier sends: that counts as an open thermocouple.
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
    """Tip tangent angles in 1/64 degree from what a board's ``read_bend`` gives; None if invalid.

    A sample is the byte 0 and a signed 16-bit number for each angle, low byte first, as the
    one-axis sensor of Bend Labs sends it.
    """
    if len(data) != 1 + 2 * angles or data[0] != 0:
        return None
    return struct.unpack(f"<{angles}h", data[1:])
