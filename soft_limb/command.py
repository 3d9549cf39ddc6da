"""The program ``soft-limb``: it finds a command by its name and runs it."""

import argparse
import contextlib
import functools
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Any

from hardware.board.signals import SIGNALS, received_signals, stop
from limb_systems.errors import LimbError
from soft_limb import exit_before_start

EXIT_STATUS = (
    "exit status: 0 done; 1 failed; 2 wrong usage, or import or fit has a question; "
    "130 stopped by Ctrl-C"
)

# For each command: its module in `soft_limb.commands`, which is imported when the command runs,
# and its one-line help.
COMMANDS = {
    "plan": ("planners", "plan the feasible trajectory nearest to a reference"),
    "collect": ("calibration", "record all the data that calibration needs"),
    "import": ("logs", "convert logs of other programs to recordings"),
    "fit": ("calibration", "fit the model of a limb to a folder of recordings"),
    "validate": ("calibration", "compare a calibrated limb with a recording, open loop"),
    "replay": ("hardware", "replay a trajectory on a robot or an emulated limb"),
    "follow": ("hardware", "plan a taught motion, and track the plan with feedback"),
    "learn": ("hardware", "repeat a trajectory, and correct the duty after each repetition"),
    "teach": ("hardware", "record the bend while you move the limb by hand"),
    "status": ("hardware", "print the state of a board, or list the serial ports"),
    "arm-check": ("hardware", "test sensors and wires one by one"),
    "board-check": ("hardware", "test the safety rules of a board"),
    "emulate": ("hardware", "emulate a board and a limb on a pseudo-terminal"),
    "sweep": ("sweep", "plan and drive many emulated limbs, motions and controllers"),
    "show": ("results", "print the contents and the origin of result files"),
    "compare": ("results", "print the differences between plans, recordings or limbs"),
    "export": ("results", "convert plans and limbs for your own programs"),
    "runs": ("results", "write one page about all results in a folder"),
}


@functools.cache
def all_commands() -> dict[str, tuple[str, str]]:
    """Return the module and the one-line help of each command, by the command's name.

    Other packages add commands by a dict like this one, as an entry point of the group
    ``soft_limb.commands``.
    """
    commands = {
        name: (f"soft_limb.commands.{module}", summary)
        for name, (module, summary) in COMMANDS.items()
    }
    for entry in entry_points(group="soft_limb.commands"):
        commands |= entry.load()
    return commands


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command in the words, or in ``sys.argv[1:]``; return its exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = _top_level_parser()
    if not words:
        parser.print_help(sys.stderr)
        return 2
    # Import the module of the command alone: others take long.
    chosen = parser.parse_args(words)
    module, _ = all_commands()[chosen.command]
    command = importlib.import_module(module).COMMANDS[chosen.command]
    return run_words(command, f"soft-limb {chosen.command}", chosen.arguments, chosen.modules)


def run_words(command: Any, prog: str, words: Sequence[str], modules: Sequence[str] = ()) -> int:
    """Run a command with the words that a user typed; return its exit status.

    Args:
        command: a `soft_limb.commands.options.Command`.
        prog: name of the program, for its help.
        words: the words after the program's name.
        modules: modules to import first, in addition to the words' own.
    """
    # Parse the options of this command.
    parser = command.parser(prog)
    _add_import_option(parser)
    options = parser.parse_args(words)
    options.modules = [*modules, *options.modules]
    # Import the user's modules, which define laws, sensors or emulated limbs.
    for module in options.modules:
        from soft_limb.runs.jobs import load_module  # takes long to import

        try:
            load_module(module, os.getcwd())
        except Exception as error:  # whatever the module does
            parser.error(f"{module} could not be imported: {type(error).__name__}: {error}")
    return run_command(lambda: command.run(options), command.stopped)


def _top_level_parser() -> argparse.ArgumentParser:
    """Return the parser of the words up to the command's name; it imports no command."""
    # List the commands below the options.
    commands = all_commands()
    width = max(map(len, commands))
    parser = argparse.ArgumentParser(
        prog="soft-limb",
        description="Calibrate, plan for and drive soft limbs that bend when their wires heat up.",
        epilog="commands:\n"
        + "".join(f"  {name:<{width}}  {line}\n" for name, (_, line) in commands.items())
        + f"\nsoft-limb COMMAND --help explains a command.\n{EXIT_STATUS}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="show program's version number and exit"
    )
    _add_import_option(parser)
    parser.add_argument("command", type=_command_name, metavar="COMMAND", help="see below")
    parser.add_argument(
        "arguments", nargs=argparse.REMAINDER, metavar="...", help="options of the command"
    )
    return parser


class _Version(argparse.Action):
    """The option ``--version``; a search for the version would slow the start of each command."""

    def __call__(self, parser, *_: Any) -> None:
        from limb_systems.files.provenance import version_and_commit

        print(f"soft-limb {version_and_commit()[0]}")
        parser.exit()


def _command_name(name: str) -> str:
    """Return the name of a command, or raise ArgumentTypeError with the nearest name."""
    if name in all_commands():
        return name
    from limb_systems.files.schema import did_you_mean  # takes long to import

    raise argparse.ArgumentTypeError(
        f"there is no command {name!r}{did_you_mean(name, list(all_commands()))}; --help lists all."
    )


def _add_import_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--import",
        dest="modules",
        action="append",
        default=[],
        metavar="MODULE",
        help="Python module to import first, from this folder or installed, that defines your own "
        "wire law, bend sensor or emulated limb; repeat the option for more modules",
    )


def run_command(command: Callable[[], int], stopped: str) -> int:
    """Run a command, print an error or a warning as one sentence, and return the exit status.

    SIGTERM and SIGHUP end the command as Ctrl-C does, so that hot wires are switched off. SIGINT
    ends it even where the shell ignores SIGINT, as in the background. A SIGHUP that `nohup` ignores
    stays ignored.

    Args:
        command: function that returns its own exit status.
        stopped: sentence to print when a signal has stopped the command.

    Returns:
        The command's own status; 1 if it failed; 128 plus the number of a signal that stopped it.
    """
    # Let all signals end the command as Ctrl-C does.
    received_signals.clear()
    previous_handlers = {number: signal.getsignal(number) for number in SIGNALS}
    for number in SIGNALS:
        if number != signal.SIGHUP or previous_handlers[number] != signal.SIG_IGN:
            signal.signal(number, stop)
    # Run it. Once it has ended, further signals are ignored until all is printed.
    try:
        try:
            with warnings.catch_warnings():
                warnings.showwarning = _print_warning
                status = command()
            sys.stdout.flush()
        finally:
            _ignore_signals()
    except BrokenPipeError:
        # The reader has closed the pipe, as `| head` does; do not flush the rest at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 1
    except KeyboardInterrupt:
        received_signals.append(signal.SIGINT)
    except Exception as error:
        # A command that a signal has stopped may fail in consequence: that is no fault.
        if not received_signals and not isinstance(error, LimbError | OSError | MemoryError):
            raise
        if not received_signals:
            text = str(error)
            if isinstance(error, OSError) and error.filename:
                text = f"Cannot use {error.filename}: {error.strerror}."
            print("\n".join([f"error: {text}", *getattr(error, "__notes__", [])]), file=sys.stderr)
        status = 1
    finally:
        for number, handler in previous_handlers.items():
            # The command has run: the handler of its start would say that nothing was written.
            has_started = handler is exit_before_start
            signal.signal(number, signal.SIG_DFL if has_started else handler)
    # Tell that a signal stopped it, even if the KeyboardInterrupt was lost on the way.
    if received_signals:
        print(stopped, file=sys.stderr)
        status = 128 + received_signals[0]
        received_signals.clear()
    return status


def _ignore_signals() -> None:
    """Ignore signals from now on; one that arrives meanwhile is ignored, too."""
    for number in SIGNALS:
        while signal.getsignal(number) != signal.SIG_IGN:
            with contextlib.suppress(KeyboardInterrupt):
                signal.signal(number, signal.SIG_IGN)


def _print_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"warning: {message}", file=sys.stderr)
