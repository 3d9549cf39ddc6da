"""A million random and mutated frames through the parsers of host and board.

Nothing may raise, no frame may be accepted that was not sent, and a board that
is armed and heats must not change its duty for any of them. Frames that pass
the CRC by chance are counted; one in four thousand million does.

Then a million whole frames, right and wrong ones of the present session, with
all that sensors may read and with time passing, through the firmware: whatever
comes, there is no duty unless the board is armed, its command fresh and its
wires within their bounds.

    python benchmarks/frame_fuzzing.py [--frames 1000000] [--seed 0]
"""

import argparse
import collections
import random
import struct
import sys
import time
from pathlib import Path
from unittest import mock

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "hardware"))
from firmware_checks import Host, PaperBoard, four_wires  # noqa: E402

from hardware.firmware import firmware, from_host, guard, heat, protocol  # noqa: E402
from hardware.firmware.firmware import Firmware  # noqa: E402


def valid_frame(rng: random.Random) -> bytes:
    """Return a frame as either side sends it, of another session."""
    kind = rng.choice((protocol.COMMAND, protocol.ARM, protocol.BOUNDS, *protocol.BOARD_KINDS[1:]))
    begin, each = protocol.LAYOUTS[kind]
    size = struct.calcsize("<" + begin) + 2 * struct.calcsize("<" + each)
    return protocol.frame(protocol.VERSION, kind, rng.randbytes(size))


def mutate(frame: bytes, rng: random.Random) -> bytes:
    """Return the frame with a random change of its bytes; never the frame itself."""
    data = bytearray(frame)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(data)) if data else 0
        what = rng.randrange(6)
        if what == 0 and data:
            data[at] ^= 1 << rng.randrange(8)
        elif what == 1 and data:
            data[at] = rng.getrandbits(8)
        elif what == 2 and data:
            del data[at]
        elif what == 3:
            data.insert(at, rng.getrandbits(8))
        elif what == 4 and data:
            del data[at:]
        else:
            data[at:at] = rng.randbytes(rng.randint(1, 70))
    return bytes(data)


def fuzz(num_frames: int, seed: int) -> dict[str, int]:
    """Return counts of the results; raise AssertionError if a duty changed."""
    rng = random.Random(seed)
    host_parser = protocol.Parser(protocol.BOARD_KINDS)
    board_parser = protocol.Parser(protocol.KINDS)
    host = Host()
    host.heat()
    session = host.guard.session
    duty = list(host.board.duty)
    # Other sessions' frames are not this one's.
    counts = {"frames": num_frames, "accepted as sent": 0, "accepted by chance": 0}
    # A frame that lost its end is whole again when another one begins, which may be some later.
    recent = collections.deque(maxlen=50)
    # No time passes here, and yet no duty may end.
    with mock.patch.object(firmware, "LONGEST_STANDSTILL", num_frames):
        for _ in range(num_frames):
            sent = valid_frame(rng)
            data = mutate(sent, rng) if rng.random() < 0.8 else rng.randbytes(rng.randint(1, 100))
            recent.extend(protocol.Parser(protocol.KINDS + protocol.BOARD_KINDS).feed(sent))
            for parser in (host_parser, board_parser):
                for frame in parser.feed(data):
                    counts["accepted as sent" if frame in recent else "accepted by chance"] += 1
            # A whole frame within the mutated bytes may be a command, but of no session here.
            if session not in {values[0] for _, values in recent if values}:
                host.board.incoming = data
                host.firmware.step()
                assert host.board.duty == duty, "the duty changed"
    return counts


def check_guard(subject: guard.Guard, now: int) -> None:
    """Raise AssertionError if there is duty that should not be, after a tick at that time."""
    assert all(0.0 <= duty <= 1.0 for duty in subject.duty)
    assert sum(subject.duty) <= subject._total + 1e-9, "more than the power of both"
    if any(subject.duty):
        assert subject.state == guard.ARMED, "not armed"
        assert subject.reason == guard.NO_REASON, "off for a reason"
        assert now - subject._answered_time < guard.LONGEST_HOLD, "nothing fresh"
        assert now - subject._command_time < guard.HEARTBEAT, "no command"
    for duty, observer, room, proven in zip(
        subject.duty, subject.observers, subject._rooms, subject.proven, strict=True
    ):
        if duty:
            assert observer.shortfall <= guard.MAX_SHORTFALL, "out of its band"
            assert proven or duty <= heat.LITTLE_DUTY, "its thermocouple did not follow"
            if (
                proven and observer.most + room > guard.MAX_WIRE_TEMPERATURE + 0.1
            ):  # after a reset nobody knows
                a1_slow, _, _, a2_most, _ = observer.bounds
                loss = a1_slow * (observer.most - observer._silicone)
                assert a2_most * duty <= loss + 1e-9, "too hot, and warming"


def fuzz_guard(num_frames: int, seed: int, paper: PaperBoard | None = None) -> dict[str, int]:
    """Return counts of frames and steps with duty; raise AssertionError if there was too much."""
    rng = random.Random(seed)
    host = Host(paper)
    board = host.board
    program = host.firmware
    wires = len(host.board.wires)
    heated = latched = resets = 0
    for _ in range(num_frames):
        # Mostly what a host sends and a limb reads, so that much of it is while the board heats.
        subject = program.guard
        before = subject.reason
        challenge = subject.challenge
        cleared = False
        what = rng.random()
        if subject.state == guard.DISARMED and what < 0.5:
            # An ARM must not arm what is latched.
            cleared = rng.random() < 0.8
            clear = protocol.encode(protocol.CLEAR, challenge if cleared else challenge ^ 1)
            bounds = tuple(rng.uniform(0.95 * low, 1.05 * high) for low, high in heat.RANGES)
            given = heat.NOMINAL_BOUNDS if rng.random() < 0.8 else bounds
            bounds = [given] + [heat.NOMINAL_BOUNDS] * (wires - 1)
            total = rng.uniform(0, 1.05 * wires)
            arming = subject.challenge, bounds, total, board.pulls
            board.incoming += clear + b"".join(from_host.encode_arming(*arming))
        elif what < 0.97:
            sequence = subject.acknowledged + rng.choice((1, 1, 1, 1, 0, -1, 7))
            sample_time = board.now - int(rng.expovariate(1 / 60))
            session = subject.session if rng.random() < 0.95 else rng.getrandbits(16)
            duty = [rng.choice((0.0, 0.2, 1.0, rng.random())) for _ in range(wires)]
            if rng.random() < 0.002:
                duty[0] = rng.uniform(1.0001, 6.5)
            board.incoming += from_host.encode_command(session or 0, sequence, sample_time, duty)
        elif what < 0.98:
            kind = rng.choice((protocol.DISARM, protocol.HELLO))
            board.incoming += protocol.encode(kind)
        elif what < 0.99:
            wild = rng.uniform(-300.0, 1700.0) if rng.random() < 0.1 else rng.gauss(0, 9)
            board.errors[rng.randrange(wires)] = rng.choice((0.0, 0.0, 0.0, -20.0, wild))
            board.faults[rng.randrange(wires)] = rng.choice((0, 0, 0, 0, 1, 2, 4))
            board.silent = rng.random() < 0.1
        elif what < 0.9905:
            board.reset_cause = rng.randrange(6)
            board.duty = [0.0] * wires
            program = Firmware(board)
            host.firmware = program
            host.guard = program.guard
            resets = resets + 1
            before = guard.NO_REASON
        elif what < 0.991:
            board.wires = [25.0] * wires
            board.temperatures = [25.0] * wires
            board.errors = [0.0] * wires
            board.faults = [0] * wires
            board.silent = False
        for _ in range(int(rng.expovariate(0.05)) + 1):
            board.pass_time()
        if rng.random() < 0.001:
            board.pass_time(rng.randrange(10_000))  # in which its program did nothing
        program.step()
        board.sent.clear()
        check_guard(program.guard, board.now)
        assert cleared or before < guard.LATCHING or program.guard.reason == before, "forgotten"
        heated += any(board.duty)
        latched += program.guard.reason >= guard.LATCHING
    return {"frames to the guard": num_frames, "steps with duty": heated,
            "steps latched": latched, "resets": resets}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    start = time.perf_counter()
    for counts in (
        fuzz(options.frames, options.seed),
        fuzz_guard(options.frames, options.seed),
        fuzz_guard(options.frames, options.seed, four_wires().board),
    ):
        for name, count in counts.items():
            print(f"{name:<22}{count:>10}", flush=True)
    print(f"{'seconds':<22}{time.perf_counter() - start:>10.0f}")


if __name__ == "__main__":
    main()
