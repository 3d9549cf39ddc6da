"""``soft-limb``, the door to all commands."""

import argparse
import datetime
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from limb_systems.errors import LimbError
from limb_systems.signals import SIGNALS, came, stop
from soft_limb.results.folder import find, glance

NEWEST = 12  # results that are listed without a command
EXIT_STATUS = (
    "exit status: 0 done, 1 it could not be done, 2 wrong usage, or import asks, "
    "130 stopped by Ctrl-C"
)

# For each command: its module in `soft_limb.commands`, which is imported when the command runs,
# and what it does.
COMMANDS = {
    "demo": ("emulated", "plan, calibrate and drive an emulated limb, as in the paper"),
    "plan": ("planners", "plan the feasible trajectory nearest to a reference"),
    "collect": ("calibration", "record all that calibration needs"),
    "import": ("logs", "read logs of other programs as recordings"),
    "fit": ("calibration", "fit a limb to a folder of recordings"),
    "validate": ("calibration", "compare a calibrated limb with a recording, open loop"),
    "replay": ("hardware", "replay a trajectory on a robot or an emulated limb"),
    "follow": ("hardware", "plan what was taught, and follow it by feedback"),
    "learn": ("hardware", "repeat a trajectory, and learn from each repetition to follow it"),
    "teach": ("hardware", "record the bend while the limb is moved by hand"),
    "status": ("hardware", "print the state of a board"),
    "arm-check": ("hardware", "test sensors and wires one by one"),
    "board-check": ("hardware", "test that a board refuses what it must and ends duty in time"),
    "ports": ("hardware", "list the serial ports of this computer"),
    "recover": ("hardware", "finish the recording of a program that was killed"),
    "emulate": ("hardware", "emulate a board and a limb on a pseudo-terminal"),
    "gait": ("gaits", "plan how a robot of several limbs walks"),
    "gaits": ("gaits", "plan the gaits by which a robot in space gets anywhere"),
    "walk": ("gaits", "walk by a gait: a robot, or an emulated one, from cold wires"),
    "sweep": ("emulated", "plan and drive many emulated limbs, motions, tasks and controllers"),
    "show": ("results", "say what files are, and what made them"),
    "compare": ("results", "say how plans, recordings or limbs differ"),
    "export": ("results", "write plans and limbs for programs of your own"),
    "runs": ("results", "show the results in a folder on a page, compare them, replay plans"),
}


def main(arguments: Sequence[str] | None = None, package: str = "") -> int:
    """Runs a command.

    Args:
        arguments: words after the program's name; those of this process if None.
        package: whose commands ``python -m PACKAGE`` runs; all of ``soft-limb`` if empty. A
            package's only command is run without its name.

    Returns:
        Exit status, as of `run_command`.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    prog = f"python -m {package}" if package else "soft-limb"
    names = [name for name, (home, _) in COMMANDS.items() if package in ("", home)]
    modules: list[str] = []
    if len(names) > 1:
        door = _door(prog, names)
        if not words:
            if not package and _print_results(prog):
                return 0
            door.print_help(sys.stderr)
            return 2
        chosen = door.parse_args(words)
        names, words, modules = [chosen.command], chosen.arguments, chosen.modules
        prog += f" {chosen.command}"
    (name,) = names
    command = importlib.import_module(f"soft_limb.commands.{COMMANDS[name][0]}").COMMANDS[name]
    return run_words(command, prog, words, modules)


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


def _print_results(prog: str) -> bool:
    """Lists the newest results in this folder; whether there are any."""
    found = [(kind, file) for file in find(Path()) if (kind := glance(file.path))]
    if found:
        print(f"{len(found)} results here, newest first:")
    for kind, file in found[:NEWEST]:
        changed = datetime.datetime.fromtimestamp(file.changed)
        print(f"  {changed:%Y-%m-%d %H:%M}  {kind:<10}  {file.key}")
    if found:
        print(f"\n{prog} runs shows them on a page, {prog} show FILE says what one is, and")
        print(f"{prog} --help lists all commands.")
    return bool(found)


def _door(prog: str, names: Sequence[str]) -> argparse.ArgumentParser:
    """The parser up to the name of a command, whose module need not be imported for it."""
    width = max(map(len, names))
    parser = argparse.ArgumentParser(
        prog=prog,
        description="Calibrates, plans for and drives soft limbs that are bent by heat.",
        epilog="commands:\n"
        + "".join(f"  {name:<{width}}  {COMMANDS[name][1]}\n" for name in names)
        + f"\n{prog} COMMAND --help explains each of them.\n{EXIT_STATUS}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="show program's version number and exit"
    )
    _add_import_option(parser)
    parser.add_argument("command", type=_among(names), metavar="COMMAND", help="one of those below")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, metavar="...", help="of the command")
    return parser


class _Version(argparse.Action):
    """Prints the version, which takes long to find."""

    def __call__(self, parser, *_: Any) -> None:
        from importlib.metadata import version

        parser.exit(message=f"soft-limb {version('soft-limb')}\n")


def _among(names: Sequence[str]) -> Callable[[str], str]:
    """Return the check of a command's name, whose error says which name is near."""

    def check(name: str) -> str:
        if name in names:
            return name
        from limb_systems.schema import nearest  # takes long to import

        raise argparse.ArgumentTypeError(
            f"there is no command {name!r}{nearest(name, names)}; --help lists all."
        )

    return check


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
    came.clear()
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
        came.append(signal.SIGINT)
    except Exception as error:
        # What a signal has stopped may fail in consequence.
        if not came and not isinstance(error, LimbError | OSError | MemoryError):
            raise
        if not came:
            print("\n".join([f"error: {error}", *getattr(error, "__notes__", [])]), file=sys.stderr)
        status = 1
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if came:
        print(stopped, file=sys.stderr)
        status = 128 + came[0]
        came.clear()
    return status


def _say_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"warning: {message}", file=sys.stderr)
