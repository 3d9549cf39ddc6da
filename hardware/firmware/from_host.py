"""Frames from a host that arm and command a board. A board does not load them.

This runs under MicroPython and CPython, for the firmware's tests.
"""

import math

from . import protocol


def encode_arming(challenge, bounds, total, pulls):
    """Return the frames that arm, each as bytes: a BOUNDS for each wire, then ARM.

    bounds: bounds of each wire, see `heat`; total: largest sum of all duties; pulls: pull of
    each wire, see `pull`.
    """
    parts = []
    for wire, pull in enumerate(pulls):
        part = [challenge, wire]
        for value, scale in zip(bounds[wire], protocol.BOUND_SCALES):
            part.append(int(value * scale + 0.5))
        part.append(pull)
        parts.append(part)
    total = min(int(protocol.FULL_DUTY * total + 0.5), 0xFFFF)
    arm = challenge, len(parts), total, protocol.checksum(parts)
    frames = [protocol.encode(protocol.BOUNDS, *part) for part in parts]
    frames.append(protocol.encode(protocol.ARM, *arm))
    return frames


def encode_command(session, sequence, sample_time, duty):
    """Return the bytes of a COMMAND. sample_time: ms, of the newest sample; duty: of each wire."""
    ticks = [int(protocol.FULL_DUTY * share + 0.5) for share in duty]
    head = session, sequence & 0xFFFF, sample_time & 0xFFFFFFFF
    return protocol.encode(protocol.COMMAND, *head, *ticks)


def pull(angle, e2, e3):
    """Return the pull of a wire, a number that `protocol.shares` decodes.

    angle: number of its segment's first angle; e2, e3: place of the wire.
    """
    return 32 * angle + int(16 / math.pi * math.atan2(e3, e2) + 32.5) % 32
