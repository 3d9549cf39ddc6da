"""Signals that end a command, so that no wire stays hot and nobody waits."""

import contextlib
import signal
from collections.abc import Iterator

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # end a command
received_signals: list[int] = []  # those of `SIGNALS` since the present command began


def stop(number: int, _frame: object) -> None:
    """Handle one of `SIGNALS` while a command runs."""
    received_signals.append(number)
    raise KeyboardInterrupt


def raise_if_interrupted() -> None:
    """Raise KeyboardInterrupt if a signal has ended the present command.

    The handler has raised it before, but finalizers and some imports swallow its exception.
    Code that heats wires calls this first.
    """
    if received_signals:
        raise KeyboardInterrupt


@contextlib.contextmanager
def default_signal_handlers() -> Iterator[None]:
    """Let signals that end a command end the process at once, within a context.

    This is for work without a robot or an open file. Python handles signals only between calls
    into Drake and solvers, which take from seconds to minutes. Scripts, which do not install the
    command's handler, get KeyboardInterrupt as anywhere.
    """
    handled = [number for number in SIGNALS if signal.getsignal(number) is stop]
    for number in handled:
        signal.signal(number, signal.SIG_DFL)
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, stop)
