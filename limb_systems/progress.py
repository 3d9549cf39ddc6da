"""A line on the terminal that shows the progress of long work."""

import contextlib
import contextvars
import sys
import time
from collections.abc import Callable, Iterator

FIRST_ESTIMATE_SHARE = 0.1  # share of the work after which the remaining time is estimated
MIN_ANNOUNCED_TIME = 5.0  # s; a shorter remaining time is not announced

_part = contextvars.ContextVar("part", default="")


@contextlib.contextmanager
def progress_prefix(name: str) -> Iterator[None]:
    """A context in which lines of progress begin with the name of the part that is being done."""
    token = _part.set(f"{_part.get()}{name}: ")
    try:
        yield
    finally:
        _part.reset(token)


class TimeLeft:
    """Announces the remaining time of some work once, estimated from its first tenth."""

    def __init__(self, total: float, announce: Callable[[str], object]):
        """
        Args:
            total: amount of work, in any unit.
            announce: is called with the remaining time in words, if it is long.
        """
        self._total = total
        self._announce = announce
        self._start = time.monotonic()
        self._done = 0.0
        self._is_announced = False

    def add(self, amount: float) -> None:
        """Count work as done."""
        self._done += amount
        if self._is_announced or self._done < FIRST_ESTIMATE_SHARE * self._total:
            return
        self._is_announced = True
        # The rest takes as long as the work so far, in proportion.
        left = (time.monotonic() - self._start) * (self._total / self._done - 1.0)
        if left > MIN_ANNOUNCED_TIME:
            self._announce(f"about {float(f'{left:.1g}'):.0f} s are left")


class Progress:
    """Shows the progress of a long task on stderr, and clears it at the end.

    Nothing is shown for work that ends within a second, and nothing where stderr
    is no terminal: in logs, notebooks and tests nobody watches a line.

    Use as a context manager::

        with Progress("simulating", 60.0, "s") as progress:
            progress.update(12.5, "more to say")
    """

    def __init__(self, label: str, total: float | None, unit: str):
        self._label = label
        self._total = total
        self._unit = unit
        self._is_visible = sys.stderr.isatty()
        self._next_update = time.monotonic() + 1.0
        self._width = 0

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_):
        if self._width:
            self._write("\r" + " " * self._width + "\r")

    def update(self, done: float, remark: str = "") -> None:
        """Show how much of the total is done, in the unit of the total."""
        now = time.monotonic()
        if not self._is_visible or now < self._next_update:
            return
        self._next_update = now + 0.1
        # Write over the line before.
        of_total = f" of {self._total:g}" if self._total is not None else ""
        line = f"{_part.get()}{self._label}: {done:.4g}{of_total} {self._unit} {remark}".rstrip()
        self._write("\r" + line.ljust(self._width))
        self._width = len(line)

    @staticmethod
    def _write(text: str) -> None:
        sys.stderr.write(text)
        sys.stderr.flush()
