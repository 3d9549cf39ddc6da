"""A million random and mutated frames through the parsers of host and board.

Nothing may raise, no frame may be accepted that was not sent, and a board that
is armed and heats must not change its duty for any of them. Frames that pass
the CRC by chance are counted; one in four thousand million does.

    python benchmarks/fuzz.py [--frames 1000000] [--seed 0]
"""

import argparse
import collections
import random
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "hardware"))
from firmware_checks import Host  # noqa: E402

from hardware.firmware import protocol  # noqa: E402

HOST_KINDS, BOARD_KINDS = (protocol.INFO, protocol.SAMPLE), (protocol.COMMAND, protocol.ARM)


def valid_frame(rng: random.Random) -> bytes:
    """A frame as either side sends it, of another session."""
    word = lambda: rng.getrandbits(16)  # noqa: E731
    kind = rng.choice(("command", "arm", "sample"))
    if kind == "command":
        ticks = (rng.randrange(10001), rng.randrange(10001))
        numbers = rng.getrandbits(32), rng.getrandbits(32)
        return protocol.encode(protocol.COMMAND, word(), *numbers, *ticks)
    if kind == "arm":
        return protocol.encode(protocol.ARM, *[word() for _ in range(12)])
    numbers = [rng.randrange(-2000, 2000) for _ in range(3)]
    return protocol.encode(
        protocol.SAMPLE,
        *(word(), rng.getrandbits(32), word(), 1, 0, word(), *numbers, 5000, 0, 40, 25),
    )


def mutate(frame: bytes, rng: random.Random) -> bytes:
    """The frame after something happened to its bytes; never the frame itself."""
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
    """Counts of what happened; raises AssertionError if a duty changed."""
    rng = random.Random(seed)
    host_parser = protocol.Parser(HOST_KINDS)
    board_parser = protocol.Parser(BOARD_KINDS)
    host = Host()
    host.heat()
    session, duty = host.guard.session, list(host.board.duty)
    # Other sessions' frames are not this one's.
    counts = {"frames": num_frames, "accepted as sent": 0, "accepted by chance": 0}
    # A frame that lost its end is whole again when another one begins, which may be some later.
    recent = collections.deque(maxlen=50)
    for _ in range(num_frames):
        sent = valid_frame(rng)
        data = mutate(sent, rng) if rng.random() < 0.8 else rng.randbytes(rng.randint(1, 100))
        recent.extend(protocol.Parser(HOST_KINDS + BOARD_KINDS).feed(sent))
        for parser in (host_parser, board_parser):
            for frame in parser.feed(data):
                counts["accepted as sent" if frame in recent else "accepted by chance"] += 1
        # A whole frame within the mutated bytes may be a command, but of no session here.
        if session not in {values[0] for _, values in recent}:
            host.board.incoming = data
            host.firmware.step()
            assert host.board.duty == duty, "the duty changed"
    return counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    start = time.perf_counter()
    for name, count in fuzz(options.frames, options.seed).items():
        print(f"{name:<22}{count:>10}")
    print(f"{'seconds':<22}{time.perf_counter() - start:>10.0f}")


if __name__ == "__main__":
    main()
