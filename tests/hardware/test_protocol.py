"""The parser under fire; benchmarks/fuzz.py is the longer version."""

import random

import fuzz

from hardware.firmware import protocol

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


def test_two_frames_may_share_a_flag():
    first, second = (protocol.encode(protocol.CLEAR, n) for n in (1, 2))
    frames = protocol.Parser((protocol.CLEAR,)).feed(first + second[1:])
    assert frames == [(protocol.CLEAR, (1,)), (protocol.CLEAR, (2,))]


def test_frames_that_never_end_are_given_up():
    parser = protocol.Parser(KINDS)
    assert parser.feed(b"\x7e" + b"x" * 1_000_000) == []
    assert parser.rejected == 1
    assert parser.feed(protocol.encode(protocol.HELLO)) == [(protocol.HELLO, ())]


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
        values = protocol.arm_values(7, bounds, total)
        ((_, received),) = protocol.Parser(KINDS).feed(protocol.encode(protocol.ARM, *values))
        challenge, read, budget = protocol.read_arm_values(received)
        assert (challenge, budget) == (7, sent)
        assert read == bounds
