"""Parser and guard under fire; benchmarks/frame_fuzzing.py is the longer version."""

import frame_fuzzing
from firmware_checks import four_wires

from hardware.firmware import from_host, heat, protocol

BOUNDS = [heat.NOMINAL_BOUNDS, (0.005, 0.5, 60.0, 100.0, 4.0)]


def test_random_and_mutated_frames_change_nothing():
    counts = frame_fuzzing.fuzz(15_000, seed=1)
    assert counts["accepted by chance"] == 0
    assert counts["accepted as sent"] > 50  # what is not damaged gets through


def test_whatever_frames_and_sensors_say_no_wire_has_duty_that_it_must_not():
    """On boards with two wires, and with four that bend about two axes."""
    for board in (None, four_wires().board):
        counts = frame_fuzzing.fuzz_guard(6_000, seed=2, paper=board)
        assert counts["steps with duty"] > 250
        assert counts["steps latched"] > 150
        assert counts["resets"] >= 1


def test_frames_are_these_bytes():
    """A number or an order of bytes that changes makes old boards and hosts deaf."""
    arming = from_host.encode_arming(0x7E03, BOUNDS, 1.25, (16, 0))
    for frame, known in (
        (protocol.encode(protocol.HELLO), "7e05012cd6a94b7e"),
        (arming[0], "7e05067d237d5e002a005f00a406fc08f4011050351fda7e"),
        (arming[1], "7e05067d237d5e010500f40170171027a00f00d9c677947e"),
        (arming[2], "7e05027d237d5e02d430515c44c99bd87e"),
        (
            from_host.encode_command(0x1234, 70000, 123456, (0.5, 1.0)),
            "7e057d233412701140e20100881310270e5a2eeb7e",
        ),
        (protocol.encode(protocol.CLEAR, 0x7D7E), "7e05057d5e7d5d3cb4598f7e"),
        (
            protocol.encode(protocol.INFO, 5, 50, 440, b"mine0001", 2, 1, 1),
            "7e058105003200b8016d696e65303030310201012befaec17e",
        ),
        (
            protocol.encode(protocol.SAMPLE, 7, 350, 4711, 1, 0, 9, -640),
            "7e058207005e01000067120100090080fdfb855e657e",
        ),
        (
            protocol.encode(protocol.CHANNELS, 7, 0, 2, 101, 5000, 25, -3, 10000, 127),
            "7e0583070000026500881319fdff10277f7d5e74be597e",
        ),
    ):
        assert frame.hex() == known


def test_the_longest_frames_come_through_and_fit_into_packets():
    a = 0x7E7E
    for kind, values in (
        (protocol.BOUNDS, (a, 7, a, a, a, a, a, 0x7E)),
        (protocol.ARM, (a, 8, a, a)),
        (protocol.COMMAND, (a, a, 0x7D7D7D7D, *8 * [a])),
        (protocol.INFO, (5, 50, 440, b"\x7e" * 8, 8, 1, 6)),
        (protocol.SAMPLE, (a, 0x7E7E7E7E, a, 1, 0, a, *6 * [a])),
        (protocol.CHANNELS, (a, 4, 8, *4 * [a, a, 0x7E])),
    ):
        frame = protocol.encode(kind, *values)
        assert len(frame) <= 64
        assert 3 not in frame
        assert 0x7E not in frame[1:-1]
        parser = protocol.Parser(protocol.KINDS + protocol.BOARD_KINDS)
        assert parser.feed(frame) == [(kind, values)]


def test_frames_of_other_kinds_versions_and_lengths_are_refused():
    parser = protocol.Parser((protocol.SAMPLE, protocol.CHANNELS))
    assert parser.feed(protocol.encode(protocol.CLEAR, 1)) == []
    for kind, size in ((protocol.SAMPLE, 11), (protocol.SAMPLE, 13), (protocol.CHANNELS, 7)):
        assert parser.feed(protocol.frame(protocol.VERSION, kind, bytes(size))) == []
    assert parser.rejected == 4
    assert parser.feed(protocol.frame(protocol.VERSION + 1, protocol.SAMPLE, b"0123")) == []
    assert parser.other_version == protocol.VERSION + 1
