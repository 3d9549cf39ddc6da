"""Commands: the options that they share, each declared once, and how they end."""

import argparse
import contextlib
import dataclasses
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hardware.emulation.specimen import EXTRA_EFFECTS
from limb_systems.summary import Entry, Summary
from soft_limb.live.page import LOOPBACK, LivePage
from soft_limb.runs.rollout import CONTROLLERS


class Option(NamedTuple):
    """An argument of a command.

    - ``names``: such as ("-o", "--output").
    - ``settings``: the further arguments of `argparse.ArgumentParser.add_argument`.
    """

    names: tuple[str, ...]
    settings: dict[str, Any]

    @classmethod
    def of(cls, *names: str, **settings: Any) -> "Option":
        """An option, from the arguments of `argparse.ArgumentParser.add_argument`."""
        return cls(names, settings)

    def but(self, **settings: Any) -> "Option":
        """The same option with other settings."""
        return Option(self.names, self.settings | settings)

    def add_to(self, parser: argparse._ActionsContainer) -> None:
        """Adds the option to a parser, or to a group of it."""
        parser.add_argument(*self.names, **self.settings)


@dataclasses.dataclass(frozen=True)
class Command:
    """A command of ``soft-limb``.

    - ``run``: function that takes the parsed options and returns the exit status.
    - ``description``: what ``--help`` says.
    - ``options``: each an `Option`, or a list of options of which one may be given.
    - ``stopped``: sentence for a command that a signal has ended.
    """

    run: Callable[[argparse.Namespace], int]
    description: str
    options: Sequence[Option | list[Option]]
    stopped: str = "stopped; wires are off"

    def parser(self, prog: str) -> argparse.ArgumentParser:
        """The parser of its arguments."""
        parser = argparse.ArgumentParser(
            prog=prog, description=self.description, epilog=EXIT_STATUS
        )
        for entry in self.options:
            if isinstance(entry, list):
                group = parser.add_mutually_exclusive_group()
                for option in entry:
                    option.add_to(group)
            else:
                entry.add_to(parser)
        return parser


EXIT_STATUS = "exit status: 0 done, 1 it could not be done, 2 wrong usage, 130 stopped by Ctrl-C"
TRAJECTORY = Option.of("trajectory", type=Path, help="trajectory file (.csv)")
REFERENCE = Option.of(
    "reference",
    help="'fig5' for the paper's two steps and decaying sinusoid; or a recording (teach and "
    "repeat); or a CSV of time in s and bend angle in degrees, as spreadsheets write it",
)
LIMB = Option.of(
    "-l", "--limb", type=Path, help="limb parameters (.yaml); the nominal limb if left out"
)
SMOOTH = Option.of(
    "--smooth",
    type=float,
    default=0.5,
    help="window for smoothing a recording's bend angle, s (default %(default)g)",
)

OUTPUT = Option.of(
    "-o", "--output", required=True, type=Path, help="recording file to write (.csv)"
)
FOLDER = OUTPUT.but(help="folder to write to")
PLOT = Option.of("--plot", type=Path, help="picture to write (.png, .pdf, .svg)")
REPORT = Option.of("--report", type=Path, help="page to write, with charts to look into (.html)")
FORCE = Option.of("--force", action="store_true", help="replace files that exist")
JSON = Option.of("--json", action="store_true", help="print JSON")

BOARD = Option.of("port", help="of the board: a serial port or any URL that pyserial accepts")
PORT = Option.of(
    "-p",
    "--port",
    help="of the robot: a serial port or any URL that pyserial accepts; an emulated limb if left "
    "out",
)
EMULATED = Option.of(
    "--emulated",
    type=int,
    default=0,
    metavar="SEED",
    help="seed of the emulated limb (default %(default)s)",
)
EXTRA = Option.of(
    "--extra",
    action="append",
    default=[],
    choices=EXTRA_EFFECTS,
    help="an effect that the emulated limb has beside those of every limb",
)
DRIVEN = [  # the limb that a plan drives
    PORT,
    EMULATED.but(
        default=None,
        help="seed of the emulated limb; if left out, the limb that the plan was calibrated on, "
        "or else 0",
    ),
    Option.of(
        "--model",
        action="store_true",
        help="no other limb than the plan's own model: what it would do if it were exact",
    ),
]
CONTROLLER = Option.of(
    "--controller",
    choices=CONTROLLERS,
    help="what drives it: open, the plan's duty; pi, feedback about the plan; lqr, time-varying "
    "LQR about the plan; mpc, plans of the coming seconds towards the reference (default "
    "%(default)s)",
)
LIVE = (
    Option.of(
        "--live",
        action="store_true",
        help="show the limb on a page of this computer while it runs, in curves and in 3D, with a "
        "button that stops it; an emulated limb runs in real time",
    ),
    Option.of(
        "--live-address",
        metavar="HOST[:PORT]",
        help="serve that page there, for other computers too, with a token in its address "
        f"(default {LOOPBACK}, and a free port)",
    ),
)


@contextlib.contextmanager
def live_page(options: argparse.Namespace) -> Iterator[LivePage | None]:
    """The page that a command was asked for, if any, until it ends; it says where the page is.

    Raises:
        LimbError: if the page cannot be served there.
    """
    if not (options.live or options.live_address):
        yield None
        return
    with LivePage(options.live_address or LOOPBACK) as live:
        stream = sys.stderr if vars(options).get("json") else sys.stdout
        print(f"live        {live.url}", file=stream, flush=True)
        yield live


def print_summary(
    options: argparse.Namespace, summary: Summary, written: Sequence[Path | None] | None = None
) -> None:
    """Tells what a command has found and written, in JSON if the command was asked for it.

    Args:
        written: files that were written; None among them was not asked for.
    """
    if written is not None:
        paths = [str(path) for path in written if path]
        summary += Summary([Entry("written", paths)])
    if vars(options).get("json"):
        print(json.dumps(summary.to_json(), ensure_ascii=False), flush=True)
    elif told := str(summary):
        print(told, flush=True)
