"""What a host says to boards of either version. A board does not load it.

Runs under MicroPython and CPython alike, for the firmware's tests.
"""

import math

from . import protocol, wide

FORMATS = {protocol.VERSION: protocol.FORMATS, wide.VERSION: wide.FORMATS}
KINDS = protocol.INFO, protocol.SAMPLE, wide.CHANNELS  # that boards send


def encode(version, kind, *values):
    """The bytes of one frame."""
    return (protocol if version == protocol.VERSION else wide).encode(kind, *values)


def encode_command(version, session, sequence, heard, ticks):
    """The bytes of a COMMAND. ticks: duty of each wire in 1/10000."""
    if version == protocol.VERSION:
        return protocol.encode(protocol.COMMAND, session, sequence, heard, *ticks)
    ticks = list(ticks) + [0] * (wide.MOST_CHANNELS - len(ticks))
    return wide.encode(protocol.COMMAND, session, sequence & 0xFFFF, heard, *ticks)


def arm_values(challenge, bounds, total):
    """Values of an ARM for two wires.

    bounds: bounds of left and right, see `heat`; total: largest sum of both duties.
    """
    values = [challenge]
    for wire in bounds:
        values += _bounds_values(wire)
    values.append(int(min(total, 2.0) * protocol.FULL_DUTY + 0.5))  # two wires cannot have more
    return values


def _bounds_values(bounds):
    return [int(value * scale + 0.5) for value, scale in zip(bounds, protocol.BOUND_SCALES)]


def encode_arming(version, challenge, bounds, total, pulls):
    """The frames that arm, each as bytes. pulls: of each wire, see `pull`."""
    if version == protocol.VERSION:
        return [protocol.encode(protocol.ARM, *arm_values(challenge, bounds, total))]
    parts = []
    for wire, pull in enumerate(pulls):
        parts.append([challenge, wire])
        parts[wire] += _bounds_values(bounds[wire])
        parts[wire].append(pull)
    frames = [wide.encode(wide.BOUNDS, *part) for part in parts]
    total = min(int(protocol.FULL_DUTY * total + 0.5), 0xFFFF)
    frames.append(wide.encode(protocol.ARM, challenge, len(parts), total, wide.checksum(parts)))
    return frames


def pull(angle, e2, e3):
    """How a wire pulls, as `wide.shares` reads it.

    angle: number of the first one of its segment; e2, e3: place of the wire.
    """
    return 32 * angle + int(16 / math.pi * math.atan2(e3, e2) + 32.5) % 32
