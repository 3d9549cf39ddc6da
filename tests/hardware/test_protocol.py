"""The parser under fire; benchmarks/fuzz.py is the longer version."""

import hashlib
import random

import fuzz
from firmware_checks import Host

from hardware.firmware import from_host, heat, protocol, wide

KINDS = (protocol.COMMAND, protocol.ARM, protocol.SAMPLE, protocol.HELLO)


def test_random_and_mutated_frames_change_nothing():
    counts = fuzz.fuzz(15_000, seed=1)
    assert counts["accepted by chance"] == 0
    assert counts["accepted as sent"] > 50  # what is not damaged gets through


def test_frames_come_through_whatever_is_between_them():
    rng = random.Random(0)
    stream, sent = b"", []
    for number in range(500):
        duty = rng.randrange(10001), rng.randrange(10001)
        frame = (protocol.COMMAND, (7, number, rng.getrandbits(32), *duty))
        sent.append(frame)
        garbage = bytes(b for b in rng.randbytes(rng.randrange(20)) if b != 0x7D)
        stream += garbage + b"\x7e" + protocol.encode(frame[0], *frame[1])
    for size in (1, 3, 64, 1000):  # however the bytes are split
        parser, received = protocol.Parser(KINDS), []
        for start in range(0, len(stream), size):
            received += parser.feed(stream[start : start + size])
        assert received == sent


def test_frames_for_two_wires_are_those_of_hosts_and_boards_before_there_were_others():
    """As they were sent then, and so is all that a board said in two seconds."""
    wide_bounds = (0.03, 0.5, 4.0, 40.0, 0.1)
    arming = (0x7E03, [heat.NOMINAL, wide_bounds], 1.25, (16, 0))
    header = 7, 350, 4711, 1, 0, 70000 & 0xFFFF
    readings = 101, -3, -640, 5000, 10000, 25, 127
    for frame, before in (
        (from_host.encode(3, protocol.HELLO), "7e7d2301aa71f31d7e"),
        (
            from_host.encode_arming(3, *arming)[0],
            "7e7d23027d237d5e2a005f00a406fc08f4011e00f4019001a00f6400d430a962e05f7e",
        ),
        (
            from_host.encode_command(3, 0x1234, 70000, 123456, (5000, 10000)),
            "7e7d237d2334127011010040e2010088131027903e64b97e",
        ),
        (from_host.encode(3, protocol.DISARM), "7e7d23042585996d7e"),
        (from_host.encode(3, protocol.CLEAR, 0x7D7E), "7e7d23057d5e7d5de0eb32aa7e"),
        (
            protocol.encode(protocol.INFO, 3, 50, 440, b"mine0001", 2, 1),
            "7e7d23817d23003200b8016d696e653030303102017825759d7e",
        ),
        (
            protocol.encode(protocol.SAMPLE, *header, *readings),
            "7e7d238207005e0100006712010070116500fdff80fd88131027197fdf04bc277e",
        ),
    ):
        assert frame.hex() == before
    host = Host()
    host.send(protocol.HELLO)
    host.run(100)
    host.heat()
    host.run(700, (0.3, 0.9))
    host.send(protocol.DISARM)
    host.run(300)
    sent = hashlib.sha256(b"".join(host.board.sent)).hexdigest()
    assert sent == "2d5f1ac15c237e4d89d01e4276d592e0b32e7818cd321efa9509624b54eedcbe"


def test_frames_of_boards_with_more_wires_come_through_and_fit_into_packets():
    a = 0x7E7E
    for kind, values in (
        (wide.BOUNDS, (a, 7, a, a, a, a, a, 0x7E)),
        (protocol.ARM, (a, 8, a, a)),
        (protocol.COMMAND, (a, a, 0x7D7D7D7D, *8 * [a])),
        (protocol.INFO, (4, 50, 440, b"mine0001", 8, 1, 6, 2)),
        (protocol.SAMPLE, (a, 0x7E7E7E7E, a, 1, 0, a, *6 * [a])),
        (wide.CHANNELS, (a, 4, 8, *4 * [a, a, 0x7E])),
    ):
        frame = wide.encode(kind, *values)
        assert len(frame) <= 64
        parser = protocol.Parser((*wide.KINDS, *from_host.KINDS), from_host.FORMATS)
        assert parser.feed(frame) == [(kind, values)]
        assert parser.version == 4
        before = protocol.Parser((*wide.KINDS, *from_host.KINDS))  # of two wires alone
        assert before.feed(frame) == []
        assert before.other_version == 4


def test_frames_of_other_kinds_and_versions_are_refused():
    parser = protocol.Parser((protocol.SAMPLE,))
    assert parser.feed(protocol.encode(protocol.CLEAR, 1)) == []
    assert parser.rejected == 1
    body = bytes((protocol.VERSION + 1, protocol.SAMPLE)) + b"0123"
    body += protocol.crc32(body)
    assert parser.feed(b"\x7e" + body + b"\x7e") == []
    assert parser.other_version == protocol.VERSION + 1


def test_every_single_bit_error_is_found():
    frame = protocol.encode(protocol.COMMAND, 0x1234, 99, 123456, 5000, 10000)
    for bit in range(8, 8 * (len(frame) - 1)):
        broken = bytearray(frame)
        broken[bit // 8] ^= 1 << bit % 8
        assert protocol.Parser(KINDS).feed(bytes(broken)) == []


def test_what_arms_comes_back_and_no_two_wires_have_more_than_two():
    bounds = [(0.042, 0.095, 17.0, 23.0, 0.5), (0.005, 0.5, 60.0, 100.0, 4.0)]
    for total, sent in ((0.75, 0.75), (2.0, 2.0), (100.0, 2.0)):
        values = from_host.arm_values(7, bounds, total)
        ((_, received),) = protocol.Parser(KINDS).feed(protocol.encode(protocol.ARM, *values))
        challenge, read, budget = protocol.read_arm_values(received)
        assert (challenge, budget) == (7, sent)
        assert read == bounds
