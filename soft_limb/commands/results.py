"""Commands that print and compare result files, and that convert them for other tools."""

import argparse
import functools
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from limb_systems import LimbParameters, Recording, Trajectory
from limb_systems.errors import LimbError
from limb_systems.files.duty_export import write_c_header, write_rows
from limb_systems.files.output import OutputError, check_outputs, write_atomically
from limb_systems.summary import Summary
from limb_systems.wire_callback import wire_callback
from soft_limb.commands.options import Command, Option, print_summary, print_table, shared
from soft_limb.results.comparison import compare, comparison_page
from soft_limb.results.overview import overview_page
from soft_limb.results.read_result import LIMB, TRAJECTORY, read_result
from soft_limb.results.summaries import troubles
from urdf import limb_mjcf, limb_sdf, limb_urdf


def _write_duty(write: Callable, plan: Trajectory, options: argparse.Namespace) -> None:
    write(plan, options.output, options.rate, options.duty_max)


def _write_model(
    generate: Callable[..., str], limb: LimbParameters, options: argparse.Namespace
) -> None:
    path = options.output
    write_atomically(path, generate(limb.segments, path.stem, payload=limb.payload))


def _write_mjcf(limb: LimbParameters, options: argparse.Namespace) -> None:
    try:
        model = limb_mjcf(limb, callback=options.callback is not None)
    except ValueError as error:
        raise LimbError(str(error)) from error
    if options.callback:
        write_atomically(options.callback, wire_callback(limb))
    write_atomically(options.output, model)


MJCF = ".xml"
# Kind of the result, and its writer by the value and the options, for each suffix.
_FORMATS: dict[str, tuple[str, Callable[[Any, argparse.Namespace], None]]] = {
    ".csv": (TRAJECTORY, functools.partial(_write_duty, write_rows)),
    ".h": (TRAJECTORY, functools.partial(_write_duty, write_c_header)),
    ".sdf": (LIMB, functools.partial(_write_model, limb_sdf)),
    ".urdf": (LIMB, functools.partial(_write_model, limb_urdf)),
    MJCF: (LIMB, _write_mjcf),
}


def _recover(options: argparse.Namespace) -> int:
    """Finish the recording of a program that was killed."""
    if len(options.files) > 1:
        raise LimbError("--recover finishes one recording; name one file.")
    # Read what the program had written, and save it under a new name.
    path = options.files[0]
    check_outputs([options.recover], inputs=[path], force=options.force)
    recording = Recording.load(path, unfinished=True)
    if not len(recording.time):
        raise LimbError(f"{path} has no samples; there is nothing to recover.")
    recording.save(options.recover)
    text = f"{len(recording.time)} samples, {recording.time[-1]:.2f} s"
    summary = Summary.of({"recovered": text}, {}) + troubles(recording)
    print_summary(options, summary, [options.recover])
    return 0


def _show(options: argparse.Namespace) -> int:
    if options.recover:
        return _recover(options)
    # Read all files; an error in one does not hide the others.
    results = []
    errors = []
    for path in options.files:
        try:
            results.append(read_result(path))
        except (LimbError, OSError) as error:
            errors.append(f"error: {error}")
    # Print the results, then the errors.
    if options.json:
        print(json.dumps({"files": [result.to_json() for result in results]}, ensure_ascii=False))
    elif results:
        print("\n\n".join(str(result.about()) for result in results))
    print("".join(f"{error}\n" for error in errors), end="", file=sys.stderr)
    return int(bool(errors))


def _compare(options: argparse.Namespace) -> int:
    # Compare the results, and write the page.
    page = [options.output]
    check_outputs(page, inputs=options.runs, pages=page, force=options.force)
    comparison = compare([read_result(path) for path in options.runs])
    if options.output:
        write_atomically(options.output, comparison_page(comparison))
    # Print the tables.
    if not options.json:
        for title, rows in comparison.tables().items():
            print_table(title, rows)
        if comparison.changes:
            print_table("what changed", comparison.changes_table())
        else:
            print("nothing changed")
    print_summary(options, Summary.of({}, comparison.to_json()), [options.output])
    return 0


def _export(options: argparse.Namespace) -> int:
    # The end of the output's name tells its format.
    if options.output.suffix not in _FORMATS:
        raise OutputError(
            f"The name of {options.output} does not tell its format; let it end with "
            f"{' or '.join(_FORMATS)}."
        )
    suffix = options.output.suffix
    kind, write = _FORMATS[suffix]
    if options.callback and suffix != MJCF:
        raise OutputError(
            "--callback writes the C code of a limb's wires; give an output that ends with .xml."
        )
    outputs = [options.output, options.callback]
    check_outputs(outputs, inputs=[options.file], force=options.force)
    # Read and convert.
    result = read_result(options.file)
    if result.kind != kind:
        raise LimbError(
            f"{result.path} is a {result.kind}; only a {kind} can be exported as {suffix}."
        )
    write(result.value, options)
    print_summary(options, Summary([]), outputs)
    return 0


def _runs(options: argparse.Namespace) -> int:
    page = [options.output]
    check_outputs(page, pages=page, force=options.force)
    write_atomically(options.output, overview_page(options.folder, options.output))
    print_summary(options, Summary([]), [options.output])
    return 0


STOPPED = "stopped; no file is half-written"
COMMANDS = {
    "show": Command(
        _show,
        "Print the kind of each file, its contents, and what made it. A file may be a recording, "
        "a trajectory or a gait (.csv), a limb or a robot (.yaml), learning.txt, or a report "
        "(.html).",
        "json force",
        [
            Option("files", nargs="+", metavar="FILE", type=Path, help="result files"),
            Option(
                "--recover",
                type=Path,
                metavar="WHOLE",
                help="recording to write (.csv) from FILE, the unfinished recording of a program "
                "that was killed (.unfinished.csv)",
            ),
        ],
        stopped=STOPPED,
        examples=["soft-limb show out/plan.csv out/recording.csv"],
    ),
    "compare": Command(
        _compare,
        "Compare results with the first of them: their origin, their parameters, and the signals "
        "of plans and recordings over the time that they have in common. The results are all limbs "
        "(.yaml), or all plans and recordings (.csv), such as a plan and its recordings.",
        "json force",
        [
            Option("runs", nargs="+", metavar="RUN", type=Path, help="two or more results"),
            shared(
                "output",
                required=False,
                help="page to write, all results in one chart (.html)",
            ),
        ],
        stopped=STOPPED,
        examples=["soft-limb compare out/plan.csv out/recording.csv -o out/comparison.html"],
    ),
    "runs": Command(
        _runs,
        "Write one page about the plans, recordings, limbs and learning in a folder and its "
        "subfolders, newest first, with small pictures, with links between plans, their limbs and "
        "their recordings, and with links to reports.",
        "force",
        [
            Option(
                "folder",
                nargs="?",
                type=Path,
                default=Path(),
                help="folder to search; this folder if left out",
            ),
            shared("output", help="page to write (.html)"),
        ],
        stopped=STOPPED,
        examples=["soft-limb runs out -o out/index.html"],
    ),
    "export": Command(
        _export,
        "Convert a trajectory or a limb for other programs. The duty of a trajectory is written as "
        "CSV or as a C header, for your own program that holds each row for one period: a row is "
        "the mean duty of the plan over the period. A limb is written as SDFormat, with its "
        "springs; as URDF, without springs; or as MJCF for MuJoCo, with springs and heat.",
        "force",
        [
            Option("file", metavar="FILE", type=Path, help="trajectory (.csv) or limb (.yaml)"),
            shared("output", help="file to write: .csv, .h, .sdf, .urdf or .xml"),
            Option(
                "--rate",
                type=float,
                default=20.0,
                help="rows per second (default %(default)g)",
            ),
            Option(
                "--callback",
                metavar="FILE.c",
                type=Path,
                help="for one limb as .xml: C code to write for MuJoCo, for laws of wires that "
                "MJCF cannot express",
            ),
            Option(
                "--duty-max",
                type=int,
                default=1,
                help="number to write for a duty of 1, such as 255 for a timer of 8 bits (default "
                "%(default)s)",
            ),
        ],
        stopped=STOPPED,
        examples=[
            "soft-limb export out/plan.csv -o out/plan.h --duty-max 255",
            "soft-limb export out/limb.yaml -o out/limb.sdf",
            "soft-limb export out/limb.yaml -o out/limb.xml --callback out/limb.c",
        ],
    ),
}
