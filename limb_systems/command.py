"""How the package's commands end."""

import os
import signal
import sys
from collections.abc import Callable

from limb_systems.errors import LimbError


def run_command(command: Callable[[], int], stopped: str) -> int:
    """Runs a command to its exit status, with one sentence instead of a traceback.

    SIGTERM and SIGHUP end it as Ctrl-C does, so that what holds a resource,
    such as hot wires, lets go of it on the way out. So does SIGINT where a
    shell ignores it, as in the background; a SIGHUP that `nohup` ignores stays
    ignored.

    Args:
        command: returns its own exit status.
        stopped: what to say when it was stopped.

    Returns:
        Exit status: the command's own, 1 if it could not be done, 130 if it
        was stopped.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _stop)
    try:
        status = command()
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # Nobody reads any more, as after `| head`; what is left must not be flushed at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (LimbError, OSError, MemoryError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(stopped, file=sys.stderr)
        return 130


def _stop(*_: object) -> None:
    raise KeyboardInterrupt
