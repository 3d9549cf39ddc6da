"""``soft-limb``, which runs all commands, and how commands end."""

import argparse
import contextlib
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from importlib.metadata import version
from typing import Any

from limb_systems.errors import LimbError

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # that end a command
_came: list[int] = []  # of these, since the command that runs has begun

# For each command: its package and what it does. The package's `__main__` is imported when the
# command runs, so that this module does not depend on packages that import it.
COMMANDS = {
    "plan": ("planners", "plan the feasible trajectory nearest to a reference"),
    "collect": ("calibration", "record all that calibration needs"),
    "fit": ("calibration", "fit a limb to a folder of recordings"),
    "validate": ("calibration", "compare a calibrated limb with a recording, open loop"),
    "replay": ("hardware", "replay a trajectory on a robot or an emulated limb"),
    "follow": ("hardware", "plan what was taught, and follow it by feedback"),
    "learn": ("hardware", "repeat a trajectory, and learn from each repetition to follow it"),
    "teach": ("hardware", "record the bend while the limb is moved by hand"),
    "status": ("hardware", "print the state of a board"),
    "arm-check": ("hardware", "test sensors and wires one by one"),
    "board-check": ("hardware", "test a board's firmware against the protocol, rule by rule"),
    "ports": ("hardware", "list the serial ports of this computer"),
    "recover": ("hardware", "finish the recording of a program that was killed"),
    "emulate": ("hardware", "emulate a board and a limb on a pseudo-terminal"),
    "show": ("limb_systems", "say what files are, and what made them"),
    "compare": ("limb_systems", "say how plans, recordings, limbs or evaluations differ"),
    "export": ("limb_systems", "write recordings and plans for other tools"),
}


def main(arguments: list[str] | None = None) -> int:
    """``soft-limb``: runs the command that is named, by its own package."""
    width = max(map(len, COMMANDS))
    parser = argparse.ArgumentParser(
        prog="soft-limb",
        description="Calibrates, plans for and drives soft limbs that are bent by heat.",
        epilog="commands:\n"
        + "".join(f"  {name:<{width}}  {what}\n" for name, (_, what) in COMMANDS.items())
        + "\nsoft-limb COMMAND --help explains each of them.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"soft-limb {version('soft-limb')}")
    parser.add_argument(
        "--import",
        dest="modules",
        action="append",
        default=[],
        metavar="MODULE",
        help="import a Python module first, of this folder or an installed one, that defines a "
        "wire law or a bend sensor of your own; before COMMAND, and once for each module",
    )
    parser.add_argument("command", choices=COMMANDS, metavar="COMMAND", help="one of those below")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, metavar="...", help="of the command")
    if not (sys.argv[1:] if arguments is None else arguments):
        parser.print_help(sys.stderr)
        return 2
    options = parser.parse_args(arguments)
    for module in options.modules:
        try:
            _import(module)
        except Exception as error:  # whatever the module does
            parser.error(f"{module} could not be imported: {type(error).__name__}: {error}")
    package, _ = COMMANDS[options.command]
    run = importlib.import_module(f"{package}.__main__").main
    if package == "planners":  # it has only one command, without a name
        return run(options.arguments, prog="soft-limb plan")
    return run([options.command, *options.arguments], prog="soft-limb")


def _import(module: str) -> None:
    """Imports a module; those of this folder come last, so that they take no other's place."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    importlib.import_module(module)


def add_force_option(command: argparse.ArgumentParser) -> None:
    """Adds ``--force``, for `limb_systems.output.check_outputs`."""
    command.add_argument("--force", action="store_true", help="replace files that exist")


def run_command(command: Callable[[], int], stopped: str) -> int:
    """Runs a command to its exit status, with one sentence for an error or a warning.

    SIGTERM and SIGHUP end it as Ctrl-C does, so that resources are released
    and hot wires switched off. SIGINT does so also where a shell ignores it, as
    in the background; a SIGHUP that `nohup` ignores stays ignored.

    Args:
        command: returns its own exit status.
        stopped: what to say when it was stopped.

    Returns:
        Exit status: the command's own, 1 if it could not be done, 128 and the
        signal's number if it was stopped: 130 by Ctrl-C, 143 by SIGTERM.
    """
    _came.clear()
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in SIGNALS:
        if number != signal.SIGHUP or before[number] != signal.SIG_IGN:
            signal.signal(number, _stop)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _say_warning
            status = command()
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader has gone, as after `| head`; the rest must not be flushed at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 1
    except KeyboardInterrupt:
        _came.append(signal.SIGINT)
    except Exception as error:
        # What a signal has stopped may fail in consequence.
        if not _came and not isinstance(error, LimbError | OSError | MemoryError):
            raise
        if not _came:
            print(f"error: {error}", file=sys.stderr)
        status = 1
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if _came:
        print(stopped, file=sys.stderr)
        status = 128 + _came[0]
        _came.clear()
    return status


def heed_signals() -> None:
    """Raises KeyboardInterrupt if a signal has come that ends the command that runs.

    The handler has done so before, but what it raises is lost in a finalizer,
    for example, and in some imports. Whoever heats wires asks here first.
    """
    if _came:
        raise KeyboardInterrupt


@contextlib.contextmanager
def ended_at_once() -> Iterator[None]:
    """A context in which a signal that ends a command ends its process at once, without a word.

    For work that holds no robot and no file. Python heeds signals only between calls
    into Drake and solvers, which take from seconds to minutes. Scripts, whose
    signals are not `run_command`'s, get KeyboardInterrupt there as anywhere.
    """
    ours = [number for number in SIGNALS if signal.getsignal(number) is _stop]
    for number in ours:
        signal.signal(number, signal.SIG_DFL)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, _stop)


def _say_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"warning: {message}", file=sys.stderr)


def _stop(number: int, _frame: object) -> None:
    _came.append(number)
    raise KeyboardInterrupt
