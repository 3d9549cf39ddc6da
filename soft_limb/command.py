"""``soft-limb``, the door to all commands."""

import argparse
import datetime
import functools
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from hardware.board.signals import SIGNALS, received_signals, stop
from limb_systems.errors import LimbError
from soft_limb.results.folder import find, glance

NEWEST = 12  # results that are listed without a command
EXIT_STATUS = (
    "exit status: 0 done, 1 it could not be done, 2 wrong usage, or import or fit asks, "
    "130 stopped by Ctrl-C"
)

# For each command: its module in `soft_limb.commands`, which is imported when the command runs,
# and what it does.
COMMANDS = {
    "plan": ("planners", "plan the feasible trajectory nearest to a reference"),
    "collect": ("calibration", "record all that calibration needs"),
    "import": ("logs", "read logs of other programs as recordings"),
    "fit": ("calibration", "fit a limb to a folder of recordings"),
    "validate": ("calibration", "compare a calibrated limb with a recording, open loop"),
    "replay": ("hardware", "replay a trajectory on a robot or an emulated limb"),
    "follow": ("hardware", "plan what was taught, and follow it by feedback"),
    "learn": ("hardware", "repeat a trajectory, and learn from each repetition to follow it"),
    "teach": ("hardware", "record the bend while the limb is moved by hand"),
    "status": ("hardware", "print the state of a board, or list the serial ports"),
    "arm-check": ("hardware", "test sensors and wires one by one"),
    "board-check": ("hardware", "test that a board refuses what it must and ends duty in time"),
    "emulate": ("hardware", "emulate a board and a limb on a pseudo-terminal"),
    "sweep": ("sweep", "plan and drive many emulated limbs, motions, tasks and controllers"),
    "show": ("results", "say what files are, and what made them"),
    "compare": ("results", "say how plans, recordings or limbs differ"),
    "export": ("results", "write plans and limbs for programs of your own"),
    "runs": ("results", "write one page about all results in a folder"),
}


@functools.cache
def all_commands() -> dict[str, tuple[str, str]]:
    """Return `COMMANDS` with the full names of their modules, and what other packages register.

    These name a dict like it as an entry point of the group ``soft_limb.commands``.
    """
    found = {name: (f"soft_limb.commands.{home}", what) for name, (home, what) in COMMANDS.items()}
    for entry in entry_points(group="soft_limb.commands"):
        found |= entry.load()
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: words after the program's name; those of this process if None.

    Returns:
        Exit status, as of `run_command`.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = _top_level_parser()
    if not words:
        if _print_results():
            return 0
        parser.print_help(sys.stderr)
        return 2
    chosen = parser.parse_args(words)
    module, _ = all_commands()[chosen.command]
    command = importlib.import_module(module).COMMANDS[chosen.command]
    return run_words(command, f"soft-limb {chosen.command}", chosen.arguments, chosen.modules)


def run_words(command: Any, prog: str, words: Sequence[str], modules: Sequence[str] = ()) -> int:
    """Runs a command as a user typed it, and returns its exit status, as of `run_command`.

    Args:
        command: a `soft_limb.commands.options.Command`.
        prog: name of the program, for its help.
        words: the words after the program's name.
        modules: modules to import first, beside those that the words name.
    """
    parser = command.parser(prog)
    _add_import_option(parser)
    options = parser.parse_args(words)
    options.modules = [*modules, *options.modules]
    for module in options.modules:
        from soft_limb.runs.jobs import load_module  # takes long to import

        try:
            load_module(module, os.getcwd())
        except Exception as error:  # whatever the module does
            parser.error(f"{module} could not be imported: {type(error).__name__}: {error}")
    return run_command(lambda: command.run(options), command.stopped)


def _print_results() -> bool:
    """Lists the newest results in this folder; whether there are any."""
    found = [(kind, file) for file in find(Path()) if (kind := glance(file.path))]
    if found:
        print(f"{len(found)} results here, newest first:")
    for kind, file in found[:NEWEST]:
        changed = datetime.datetime.fromtimestamp(file.changed)
        print(f"  {changed:%Y-%m-%d %H:%M}  {kind:<10}  {file.key}")
    if found:
        print("\nsoft-limb runs -o index.html writes a page about them, soft-limb show FILE says")
        print("what one is, and soft-limb --help lists all commands.")
    return bool(found)


def _top_level_parser() -> argparse.ArgumentParser:
    """Return the parser up to the name of a command, whose module need not be imported for it."""
    commands = all_commands()
    width = max(map(len, commands))
    parser = argparse.ArgumentParser(
        prog="soft-limb",
        description="Calibrates, plans for and drives soft limbs that are bent by heat.",
        epilog="commands:\n"
        + "".join(f"  {name:<{width}}  {what}\n" for name, (_, what) in commands.items())
        + f"\nsoft-limb COMMAND --help explains each of them.\n{EXIT_STATUS}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="show program's version number and exit"
    )
    _add_import_option(parser)
    parser.add_argument("command", type=_command_name, metavar="COMMAND", help="one of those below")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, metavar="...", help="of the command")
    return parser


class _Version(argparse.Action):
    """Prints the version, which takes long to find."""

    def __call__(self, parser, *_: Any) -> None:
        from importlib.metadata import version

        print(f"soft-limb {version('soft-limb')}")
        parser.exit()


def _command_name(name: str) -> str:
    """Return the name of a command, or say which name is near."""
    if name in all_commands():
        return name
    from limb_systems.files.schema import nearest  # takes long to import

    raise argparse.ArgumentTypeError(
        f"there is no command {name!r}{nearest(name, list(all_commands()))}; --help lists all."
    )


def _add_import_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--import",
        dest="modules",
        action="append",
        default=[],
        metavar="MODULE",
        help="import a Python module first, of this folder or an installed one, that defines a "
        "wire law, a bend sensor or an emulated limb of your own; once for each module",
    )


def run_command(command: Callable[[], int], stopped: str) -> int:
    """Runs a command to its exit status, with one sentence for an error or a warning.

    SIGTERM and SIGHUP end it as Ctrl-C does, so that resources are released
    and hot wires switched off. SIGINT does so also where a shell ignores it, as
    in the background; a SIGHUP that `nohup` ignores stays ignored.

    Args:
        command: function that returns its own exit status.
        stopped: what to say when it was stopped.

    Returns:
        Exit status: the command's own, 1 if it could not be done, 128 and the
        signal's number if it was stopped: 130 by Ctrl-C, 143 by SIGTERM.
    """
    received_signals.clear()
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in SIGNALS:
        if number != signal.SIGHUP or before[number] != signal.SIG_IGN:
            signal.signal(number, stop)
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
        received_signals.append(signal.SIGINT)
    except Exception as error:
        # What a signal has stopped may fail in consequence.
        if not received_signals and not isinstance(error, LimbError | OSError | MemoryError):
            raise
        if not received_signals:
            print("\n".join([f"error: {error}", *getattr(error, "__notes__", [])]), file=sys.stderr)
        status = 1
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if received_signals:
        print(stopped, file=sys.stderr)
        status = 128 + received_signals[0]
        received_signals.clear()
    return status


def _say_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"warning: {message}", file=sys.stderr)
