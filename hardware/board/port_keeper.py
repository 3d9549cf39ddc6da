"""The process that keeps the port of a text board: it sends zero when its host is gone.

Standard library alone, so that it starts in a twentieth of a second. The host's duties come by
standard input, a line for each; what the board says goes to standard output. Zero is sent until
the first duty, when standard input ends, when no duty comes for 250 ms, and when a signal comes.
"""

import contextlib
import errno
import json
import os
import select
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

DEADLINE = 0.25  # s, for which a duty holds
LAST_LINES = 5  # with zero at the end, as one may get lost
LONGEST_PAUSE = 0.1  # s, between these
ENDS = {"LF": "\n", "CR": "\r", "CRLF": "\r\n", "none": ""}


def encode(line: Mapping[str, Any], duty: Sequence[float]) -> bytes:
    """The bytes of a line.

    Args:
        line: fields of a `hardware.board.text_board.DutyLine`.
        duty: duty of each channel, in [0, 1].
    """
    if line["zero"] is not None and not any(duty):
        return (line["zero"] + ENDS[line["end"]]).encode()
    numbers = (f"{line['full'] * share:.{line['decimals']}f}" for share in duty)
    text = line["prefix"] + line["separator"].join(numbers) + line["suffix"]
    return (text + ENDS[line["end"]]).encode()


class OnOff:
    """On and off for each line, whose mean is the duty: what is owed is carried on."""

    def __init__(self, channels: int):
        self._owed, self._duty, self._on = ([0.0] * channels for _ in range(3))

    def next(self, duty: Sequence[float], lasted: float = 1.0) -> list[float]:
        """0 or 1 of each channel, after the last line held for so many durations of a line."""
        held = zip(self._owed, self._duty, self._on, strict=True)
        # A line that held for too long is made up for, but never by heat for long.
        self._owed = [min(1.0, owed + (share - on) * lasted) for owed, share, on in held]
        self._duty = list(duty)
        self._on = [float(d > 0 and o + d >= 0.5) for o, d in zip(self._owed, duty, strict=True)]
        return self._on


def keep(port: int, line: Mapping[str, Any], channels: int, rate: float) -> None:
    """Keeps a port until the host is gone, and ends with zero on every way out.

    Args:
        port: its file descriptor.
        line: fields of a `DutyLine`.
        channels: number of channels.
        rate: lines in a second.

    Raises:
        SystemExit: with why, and whether zero was sent, unless the host has closed.
    """
    parent, zero, reason, sent = os.getppid(), [0.0] * channels, "", False
    os.set_blocking(sys.stdout.fileno(), False)
    duty, heard, unread, on_off = zero, None, b"", OnOff(channels)
    due = last = time.monotonic()
    try:
        while os.getppid() == parent:  # a program that the host has started may hold the pipe
            timeout = min(DEADLINE / 5, max(0.0, due - time.monotonic()))
            ready = select.select([sys.stdin, port], [], [], timeout)[0]
            if port in ready:
                # A host that hangs loses answers, and must not hold up this.
                with contextlib.suppress(BlockingIOError):
                    if not (said := os.read(port, 4096)):
                        raise OSError(errno.EIO, "unplugged")
                    os.write(sys.stdout.fileno(), said)
            now = time.monotonic()
            if sys.stdin in ready:
                if not (new := os.read(sys.stdin.fileno(), 4096)):
                    break
                *commands, unread = (unread + new).split(b"\n")
                was_hot = any(duty)
                for command in commands:
                    duty = [float(number) for number in command.split()] or zero
                    heard = now if command else None  # an empty line switches off
                due = now if was_hot and not any(duty) else due
            if heard is not None and now - heard > DEADLINE:
                raise TimeoutError("this program sent no duty for 250 ms")
            if now >= due:
                applied = on_off.next(duty, rate * (now - last)) if line["on_off"] else duty
                last = now
                os.write(port, encode(line, applied))
                due = max(due + 1 / rate, now)
    except BlockingIOError:
        reason = "it takes no more data"
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
    finally:
        for _ in range(LAST_LINES):
            with contextlib.suppress(OSError):
                sent = os.write(port, encode(line, zero)) > 0 or sent
                time.sleep(min(1 / rate, LONGEST_PAUSE))
    if reason:
        sys.exit(f"{reason}; zero {'was' if sent else 'could not be'} sent")


def _stop(*_: object) -> None:
    raise InterruptedError("its keeper was told to end")


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _stop)
    keep(**json.loads(sys.argv[1]))
