"""Commands: the options that they share, each declared once, and how they end."""

import argparse
import contextlib
import dataclasses
import json
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hardware.emulation.specimen import EXTRA_EFFECTS, Specimen
from limb_systems.errors import LimbError
from limb_systems.files.output import check_outputs
from limb_systems.summary import Entry, Summary
from limb_systems.views.panels import Panel
from soft_limb.command import EXIT_STATUS
from soft_limb.runs import CONTROLLERS, OPEN_LOOP

if TYPE_CHECKING:
    from soft_limb.live_page import LivePage


class Option:
    """An argument of a command, by the arguments of `argparse.ArgumentParser.add_argument`."""

    def __init__(self, *names: str, **settings: Any):
        self.names, self.settings = names, settings


class _Help(argparse.HelpFormatter):
    """Fills paragraphs, and leaves lines that are indented as they are."""

    def _fill_text(self, text, width, indent):
        fill = super()._fill_text
        lines = text.split("\n")
        return "\n".join(x if x[:1] in ("", " ") else fill(x, width, indent) for x in lines)


@dataclasses.dataclass(frozen=True)
class Command:
    """A command of ``soft-limb``.

    - ``run``: function that takes the parsed options and returns the exit status.
    - ``description``: what ``--help`` says.
    - ``shared``: keys of its options in `SHARED`, with spaces between them.
    - ``own``: further ones, each an `Option`, or a list of which one may be given.
    - ``stopped``: sentence for a command that a signal has ended.
    - ``examples``: lines that a shell runs, by the names that README gives to files.
    """

    run: Callable[[argparse.Namespace], int]
    description: str
    shared: str
    own: Sequence[Option | list[Option]] = ()
    stopped: str = "stopped; wires are off"
    examples: Sequence[str] = ()

    def parser(self, prog: str) -> argparse.ArgumentParser:
        """The parser of its arguments."""
        lines = ["for example:", *(f"  {line}" for line in self.examples), "", EXIT_STATUS]
        parser = argparse.ArgumentParser(
            prog=prog,
            description=self.description,
            epilog="\n".join(lines),
            formatter_class=_Help,
        )
        for entry in (*(SHARED[key] for key in self.shared.split()), *self.own):
            group = parser.add_mutually_exclusive_group() if isinstance(entry, list) else parser
            for option in entry if isinstance(entry, list) else [entry]:
                group.add_argument(*option.names, **option.settings)
        parser.add_argument("--board", type=_refuse_text_board, help=argparse.SUPPRESS)
        return parser


def _refuse_text_board(path: str) -> NoReturn:
    """Raise ArgumentTypeError: ``--board FILE`` described boards that are no longer driven."""
    raise argparse.ArgumentTypeError(
        f"{path} describes a board that speaks lines of text, and such boards are no longer "
        "driven: put the firmware on yours as docs/firmware_in_c.md says, and leave --board out"
    )


def shared(key: str, **settings: Any) -> Option:
    """A shared option with some settings of its own."""
    option = SHARED[key]
    assert isinstance(option, Option)
    return Option(*option.names, **option.settings | settings)


MAX_COOLING_TIME = 3600.0  # s
PORT_HELP = "a serial port or any URL that pyserial accepts"
TASK_HELP = (
    "weights and limits: a file (.yaml), 'paper' for the paper's, or 'closed-loop' for plans that "
    "feedback follows"
)


class _AddPort(argparse.Action):
    """A port, or with NAME= before it that of one limb, which joins those of the others."""

    def __call__(self, parser, namespace, value, option_string=None):
        """Sets the option, to text or to the ports by their names."""
        if named := re.fullmatch(r"(\w+)=(.+)", value):
            before = getattr(namespace, self.dest)
            value = (before if isinstance(before, dict) else {}) | {named[1]: named[2]}
        setattr(namespace, self.dest, value)


SHARED: dict[str, Option | list[Option]] = {
    "trajectory": Option("trajectory", type=Path, help="trajectory file (.csv)"),
    "reference": Option(
        "reference",
        help="'fig5' for the paper's two steps and decaying sinusoid; 'circle' or 'eight' for a "
        "limb that bends in space; or a recording (teach and repeat); or a CSV of time in s and "
        "bend angles in degrees, as spreadsheets write it",
    ),
    "limb": Option(
        "-l", "--limb", type=Path, help="limb parameters (.yaml); the nominal limb if left out"
    ),
    "task": Option("--task", help=f"{TASK_HELP}; the defaults of planners.Task if left out"),
    "knot-rate": Option(
        "--knot-rate", type=float, default=10.0, help="knots per second (default %(default)g)"
    ),
    "smooth": Option(
        "--smooth",
        type=float,
        default=0.5,
        help="window for smoothing a recording's bend angle, s (default %(default)g)",
    ),
    "output": Option("-o", "--output", required=True, type=Path, help="recording to write (.csv)"),
    "plot": Option("--plot", type=Path, help="picture to write (.png, .pdf, .svg)"),
    "report": Option("--report", type=Path, help="page to write, with charts to look into (.html)"),
    "force": Option("--force", action="store_true", help="replace files that exist"),
    "json": Option("--json", action="store_true", help="print JSON"),
    "board": Option("port", help=f"of the board, {PORT_HELP}"),
    "port": Option(
        "-p",
        "--port",
        action=_AddPort,
        help=f"of the robot, {PORT_HELP}, or NAME=PORT for each limb that has a board of its own; "
        "an emulated limb if left out",
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
        help="an effect that the emulated limb has beside those of every limb",
    ),
    "physics": Option(
        "--physics",
        default=Specimen.physics,
        help="physics of the emulated limb (default %(default)s); --import names the module of "
        "any other",
    ),
    "controller": Option(
        "--controller",
        choices=CONTROLLERS,
        default=OPEN_LOOP,
        help="what drives it: open-loop, the plan's duty; plan-feedback, feedback about the plan; "
        "plan-regulator, a time-varying linear-quadratic regulator about the plan; "
        "receding-horizon, plans of the coming seconds towards the reference "
        "(default %(default)s)",
    ),
    "live": Option(
        "--live",
        action="store_true",
        help="show the limb on a page of this computer while it runs, in curves, with a button "
        "that stops it; an emulated limb runs in real time",
    ),
    "cool": Option(
        "--cool-down",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="when the run's files are written, show how its wires cool, until they are as cool as "
        "before, or for so long; Ctrl-C ends that alone (default %(default)g)",
    ),
}
SHARED["folder"] = shared("output", help="folder to write to")
SHARED["driven"] = [  # the limb that a plan drives
    shared("port"),
    shared(
        "emulated",
        default=None,
        help="seed of the emulated limb; if left out, the limb that the plan was calibrated on, or "
        "else 0",
    ),
    Option(
        "--model",
        action="store_true",
        help="no other limb than the plan's own model: what it would do if it were exact",
    ),
]


def count(text: str) -> int:
    """Return a count from 1 to 9999; the type of an option."""
    if not re.fullmatch(r"[1-9]\d{0,3}", text):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 1 to 9999")
    return int(text)


@contextlib.contextmanager
def live_page(options: argparse.Namespace) -> Iterator["LivePage | None"]:
    """The page that a command was asked for, if any, until it ends; it says where the page is.

    Raises:
        LimbError: if the page does not start, or there is none to show a cool-down on, or the
            cool-down is out of range.
    """
    cool_down = vars(options).get("cool_down", 0.0)
    if not 0 <= cool_down <= MAX_COOLING_TIME:
        raise LimbError(f"--cool-down is {cool_down:g} s; it must be 0 to {MAX_COOLING_TIME:g} s.")
    if not options.live:
        if cool_down:
            raise LimbError("--cool-down is for the live page; add --live.")
        yield None
        return
    # Bokeh takes long to import, and few commands show a page.
    from soft_limb.live_page import LivePage

    with LivePage() as live:
        stream = sys.stderr if vars(options).get("json") else sys.stdout
        print(f"live        {live.url}", file=stream, flush=True)
        yield live


def checked_outputs(
    options: argparse.Namespace, *inputs: Path | str | None, goes_on: bool = False
) -> list[Path | None]:
    """Return the files that a command is to write: its table, pictures and report.

    Args:
        inputs: files that the command reads, also as texts that may be something else.
        goes_on: whether the command goes on with a table that exists.

    Raises:
        OutputError: if a file must not or cannot be written.
    """
    given = vars(options)
    pictures = [given.get("plot"), given.get("diagnostics")]
    outputs = [options.output, *pictures, given.get("report")]
    check_outputs(
        outputs,
        inputs=[Path(name) for name in inputs if name],
        pictures=pictures,
        tables=[options.output],
        force=options.force or goes_on,
    )
    return outputs


def save_panels(panels: Sequence[Panel], path: Path | None) -> None:
    """Draw panels and save the picture, if a command was asked for one."""
    if path:
        # Matplotlib takes as long to import as all the rest.
        from limb_systems.views.plots import draw, save_figure

        save_figure(draw(panels), path)


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


def print_duration(about: str) -> None:
    """Tells at a command's start about how long it takes, beside what it prints as its result."""
    print(f"takes {about}", file=sys.stderr, flush=True)


def print_table(title: str, rows: Sequence[Sequence[str]]) -> None:
    """Prints columns that are as wide as they must be."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    print(f"{title}:")
    for row in rows:
        cells = (f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True))
        print(f"  {'  '.join(cells)}".rstrip())
    print()
