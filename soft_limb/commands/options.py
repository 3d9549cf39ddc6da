"""The class of commands, the options that commands share, and helpers to print results."""

import argparse
import contextlib
import dataclasses
import json
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hardware.emulation.specimen import EXTRA_EFFECTS, Specimen
from limb_systems.files.output import check_outputs
from limb_systems.summary import Entry, Summary
from limb_systems.views.panels import Panel
from soft_limb.command import EXIT_STATUS
from soft_limb.runs import CONTROLLERS, OPEN_LOOP

if TYPE_CHECKING:
    from soft_limb.live_page import LivePage


class Option:
    """An argument of a command: the arguments of `argparse.ArgumentParser.add_argument`."""

    def __init__(self, *names: str, **settings: Any):
        self.names = names
        self.settings = settings


class _Help(argparse.HelpFormatter):
    """A formatter that wraps paragraphs and keeps indented lines as they are."""

    def _fill_text(self, text, width, indent):
        lines = []
        for line in text.split("\n"):
            is_fixed = line[:1] in ("", " ")
            lines.append(line if is_fixed else super()._fill_text(line, width, indent))
        return "\n".join(lines)


@dataclasses.dataclass(frozen=True)
class Command:
    """A command of ``soft-limb``.

    - ``run``: function that takes the parsed options and returns the exit status.
    - ``description``: text that ``--help`` prints.
    - ``shared``: keys of its options in `SHARED`, with spaces between them.
    - ``own``: further options; a list of options is a choice of at most one.
    - ``stopped``: sentence to print when a signal has ended the command.
    - ``examples``: lines for a shell, with the file names of the README.
    """

    run: Callable[[argparse.Namespace], int]
    description: str
    shared: str
    own: Sequence[Option | list[Option]] = ()
    stopped: str = "stopped; wires are off"
    examples: Sequence[str] = ()

    def parser(self, prog: str) -> argparse.ArgumentParser:
        """Return the parser of its arguments."""
        lines = ["for example:", *(f"  {line}" for line in self.examples), "", EXIT_STATUS]
        parser = argparse.ArgumentParser(
            prog=prog,
            description=self.description,
            epilog="\n".join(lines),
            formatter_class=_Help,
        )
        # Add the shared options, then the command's own.
        for entry in (*(SHARED[key] for key in self.shared.split()), *self.own):
            if isinstance(entry, list):
                group = parser.add_mutually_exclusive_group()
                for option in entry:
                    group.add_argument(*option.names, **option.settings)
            else:
                parser.add_argument(*entry.names, **entry.settings)
        return parser


def shared(key: str, **settings: Any) -> Option:
    """Return a shared option with some settings replaced."""
    option = SHARED[key]
    assert isinstance(option, Option)
    return Option(*option.names, **option.settings | settings)


SMOOTHING_TIME = 0.5  # s, over which a recording's bend angle is smoothed
PORT_HELP = "a serial port or any URL that pyserial accepts"
TASK_HELP = (
    "weights and limits of the plan: a file (.yaml), 'paper' for the values in the paper, or "
    "'closed-loop' to leave margins for feedback"
)


class _AddPort(argparse.Action):
    """The option ``--port``: one PORT, or NAME=PORT once for each limb of a robot."""

    def __call__(self, parser, namespace, value, option_string=None):
        """Set the option to a port, or to a dict of ports by the limbs' names."""
        if named := re.fullmatch(r"(\w+)=(.+)", value):
            previous = getattr(namespace, self.dest)
            ports = previous if isinstance(previous, dict) else {}
            value = ports | {named[1]: named[2]}
        setattr(namespace, self.dest, value)


SHARED: dict[str, Option | list[Option]] = {
    "trajectory": Option("trajectory", type=Path, help="trajectory file (.csv)"),
    "reference": Option(
        "reference",
        help="motion to follow: a CSV of time in s and bend angles in degrees, as spreadsheets "
        "write it; or a recording (teach and repeat); or 'ramps', or 'fig5' for the two steps and "
        "the decaying sinusoid of the paper; or 'circle' or 'eight' for a limb that bends in space",
    ),
    "limb": Option(
        "-l", "--limb", type=Path, help="limb parameters (.yaml); the nominal limb if left out"
    ),
    "task": Option("--task", help=f"{TASK_HELP}; defaults of planners.Task if left out"),
    "knot-rate": Option(
        "--knot-rate", type=float, default=10.0, help="knots per second (default %(default)g)"
    ),
    "smooth": Option(
        "--smooth",
        type=float,
        default=SMOOTHING_TIME,
        help="window over which the bend angle of a recording is smoothed, s (default %(default)g)",
    ),
    "output": Option("-o", "--output", required=True, type=Path, help="recording to write (.csv)"),
    "plot": Option("--plot", type=Path, help="picture to write (.png, .pdf, .svg)"),
    "report": Option("--report", type=Path, help="page to write, with interactive charts (.html)"),
    "force": Option("--force", action="store_true", help="replace files that exist"),
    "json": Option("--json", action="store_true", help="print the result as JSON"),
    "board": Option("port", metavar="PORT", help=f"port of the board: {PORT_HELP}"),
    "port": Option(
        "-p",
        "--port",
        action=_AddPort,
        help=f"port of the robot: {PORT_HELP}; or NAME=PORT once for each limb that has its own "
        "board; an emulated limb if left out",
    ),
    "emulated": Option(
        "--emulated",
        type=int,
        default=0,
        metavar="SEED",
        help="seed of the emulated limb (default %(default)s)",
    ),
    "extra": Option(
        "--extra",
        action="append",
        default=[],
        choices=EXTRA_EFFECTS,
        help="effect to add to the physics of the emulated limb; may be repeated",
    ),
    "physics": Option(
        "--physics",
        default=Specimen.physics,
        help="physics of the emulated limb (default %(default)s); import the module of any other "
        "by --import",
    ),
    "controller": Option(
        "--controller",
        choices=CONTROLLERS,
        default=OPEN_LOOP,
        help="controller of the limb: open-loop applies the duty of the plan; plan-feedback "
        "corrects deviations from the plan; plan-regulator is a time-varying linear-quadratic "
        "regulator about the plan; receding-horizon plans the next seconds again and again, "
        "towards the reference (default %(default)s)",
    ),
    "live": Option(
        "--live",
        action="store_true",
        help="plot the run live on a web page of this computer, with a button that stops it; an "
        "emulated limb then runs in real time",
    ),
}
SHARED["folder"] = shared("output", help="folder to write to")
SHARED["driven"] = [  # a limb to drive along a plan; at most one of the options
    shared("port"),
    shared(
        "emulated",
        default=None,
        help="seed of the emulated limb; if left out, the emulated limb that the plan's model was "
        "calibrated on, or else 0",
    ),
    Option(
        "--model",
        action="store_true",
        help="drive the model of the plan in place of a limb, as if the model were exact",
    ),
]


def count(text: str) -> int:
    """Return a count from 1 to 9999, for the type of an option."""
    if not re.fullmatch(r"[1-9]\d{0,3}", text):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 1 to 9999")
    return int(text)


@contextlib.contextmanager
def live_page(options: argparse.Namespace) -> Iterator["LivePage | None"]:
    """Open the live page if ``--live`` is given, print its address, and yield it or None."""
    if not options.live:
        yield None
        return
    # Bokeh takes long to import, and few commands show a page.
    from soft_limb.live_page import LivePage

    with LivePage() as live:
        stream = sys.stderr if vars(options).get("json") else sys.stdout
        print(f"live        {live.url}", file=stream, flush=True)
        yield live


def checked_outputs(options: argparse.Namespace, *inputs: Path | str | None) -> list[Path | None]:
    """Return the files that a command will write: its table, pictures and report.

    Args:
        inputs: files that the command reads; a text that names no file is allowed.

    Raises:
        OutputError: if a file must not or cannot be written.
    """
    given = vars(options)
    pictures = [given.get("plot"), given.get("diagnostics")]
    outputs = [given.get("output"), *pictures, given.get("report")]
    check_outputs(
        outputs,
        inputs=[Path(name) for name in inputs if name],
        pictures=pictures,
        tables=[given.get("output")],
        pages=[given.get("report")],
        force=options.force,
    )
    return outputs


def save_panels(panels: Sequence[Panel], path: Path | None) -> None:
    """Draw panels and save the picture, if a command was asked for one."""
    if path:
        # Importing Matplotlib takes as long as importing everything else.
        from limb_systems.views.plots import draw, save_figure

        save_figure(draw(panels), path)


def print_summary(
    options: argparse.Namespace, summary: Summary, written: Sequence[Path | None] | None = None
) -> None:
    """Print the results of a command and the files that it wrote, as JSON with ``--json``."""
    if written is not None:
        paths = [str(path) for path in written if path]
        summary += Summary([Entry("written", paths)])
    if vars(options).get("json"):
        print(json.dumps(summary.to_json(), ensure_ascii=False), flush=True)
    elif text := str(summary):
        print(text, flush=True)


def print_duration(about: str) -> None:
    """Print about how long a command will take, to stderr, away from its results."""
    print(f"takes {about}", file=sys.stderr, flush=True)


def print_table(title: str, rows: Sequence[Sequence[str]]) -> None:
    """Print a title and a table with columns as wide as their cells."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    print(f"{title}:")
    for row in rows:
        cells = (f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True))
        print(f"  {'  '.join(cells)}".rstrip())
    print()
