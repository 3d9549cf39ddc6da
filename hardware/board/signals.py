"""Signals that end a command, so that no wire stays hot and nobody waits."""

import contextlib
import signal
from collections.abc import Iterator

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # that end a command
received_signals: list[int] = []  # of these, since the command that runs has begun


def stop(number: int, _frame: object) -> None:
    """Handler of `SIGNALS` while a command runs."""
    received_signals.append(number)
    raise KeyboardInterrupt


def raise_if_interrupted() -> None:
    """Raises KeyboardInterrupt if a signal has come that ends the command that runs.

    The handler has done so before, but what it raises is lost in a finalizer,
    for example, and in some imports. Whoever heats wires asks here first.
    """
    if received_signals:
        raise KeyboardInterrupt


@contextlib.contextmanager
def default_signal_handlers() -> Iterator[None]:
    """A context in which a signal that ends a command ends its process at once, without a word.

    For work that holds no robot and no file. Python heeds signals only between calls
    into Drake and solvers, which take from seconds to minutes. Scripts, whose
    signals are not a command's, get KeyboardInterrupt there as anywhere.
    """
    ours = [number for number in SIGNALS if signal.getsignal(number) is stop]
    for number in ours:
        signal.signal(number, signal.SIG_DFL)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, stop)
