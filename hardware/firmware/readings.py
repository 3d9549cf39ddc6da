"""Decodes the bytes of the sensors. Runs under MicroPython and CPython alike."""

import struct

# Faults that a MAX31855 reports in its lowest bits (datasheet 19-5793, table 3).
OPEN, SHORT_TO_GROUND, SHORT_TO_SUPPLY = 1, 2, 4


def thermocouple(data):
    """Temperature in quarters of a °C, and fault bits, from the 4 bytes of a MAX31855.

    A bus that answers nothing reads all zeros or all ones, which no working
    amplifier sends: that counts as an open thermocouple.
    """
    (word,) = struct.unpack(">I", data)
    faults = word & 7
    if word in (0, 0xFFFFFFFF):
        faults |= OPEN
    elif word & 0x10000 and not faults:
        faults = OPEN
    quarters = word >> 18
    if quarters & 0x2000:
        quarters -= 0x4000
    return quarters, faults


def bend(data):
    """Tip tangent angle in 1/64 degrees from the 3 bytes of a Bend Labs sensor; None if invalid.

    A sample is the byte 0 and a signed 16-bit number, low byte first.
    """
    if len(data) != 3 or data[0] != 0:
        return None
    return struct.unpack("<h", data[1:])[0]
