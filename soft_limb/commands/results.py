"""What results are, how they differ, and exports of them."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from limb_systems.errors import LimbError
from limb_systems.files.export import FORMATS, write_mcap, write_parquet
from limb_systems.output import OutputError, check_outputs
from soft_limb.command import add_force_option, run_command
from soft_limb.results.comparison import Comparison, compare
from soft_limb.results.reading import LIMB, RECORDING, TASK, TRAJECTORY, Result, read_result
from soft_limb.results.tables import changes_table, differences_table, motions_table

_WRITERS = dict(zip(FORMATS, (write_parquet, write_mcap), strict=True))


def main(arguments: list[str] | None = None, prog: str = "soft-limb") -> int:
    options = _parser(prog).parse_args(arguments)
    command = {"show": _show, "compare": _compare, "export": _export}[options.command]
    return run_command(lambda: command(options), "stopped; no file is half-written")


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=prog,
        description="Says what results are, what made them and how they differ, and writes "
        "recordings and plans for other tools.",
        epilog="exit status: 0 done, 1 it could not be done, 2 wrong usage, 130 stopped by Ctrl-C",
    )
    commands = parser.add_subparsers(dest="command", required=True)

    show = commands.add_parser(
        "show",
        help="say what files are, and what made them",
        description="Says what each file is, what is in it, and what made it: a recording, a "
        "trajectory, a limb or a task (.yaml), learning.txt, a report (.html), or the results of "
        "an evaluation (results.json or its folder).",
    )
    show.add_argument("files", nargs="+", metavar="FILE", type=Path, help="any of these")
    show.add_argument("--json", action="store_true", help="print JSON")

    difference = commands.add_parser(
        "compare",
        help="say how plans, recordings, limbs or evaluations differ",
        description="Compares results of one kind with the first of them: what made them, their "
        "parameters, and the signals of plans and recordings over their common time. A plan can "
        "be compared with its recordings. Evaluations are folders with results.json.",
        epilog="example: soft-limb compare out/plan.csv out/recording.csv -o out/compare.html",
    )
    difference.add_argument("runs", nargs="+", metavar="RUN", type=Path, help="two or more results")
    difference.add_argument(
        "-o", "--output", type=Path, help="page to write, with all runs in one chart (.html)"
    )
    difference.add_argument("--json", action="store_true", help="print JSON")
    add_force_option(difference)

    export = commands.add_parser(
        "export",
        help="write recordings and plans for other tools",
        description="Writes recordings and trajectories as Parquet, for tables, or as MCAP, for "
        "viewers of robots' logs, with units and provenance in their metadata. Needs pip install "
        "'soft-limb[data]'.",
        epilog="example: soft-limb export out/recording.csv -o out/recording.parquet",
    )
    export.add_argument(
        "files", nargs="+", metavar="FILE", type=Path, help="recordings and trajectories (.csv)"
    )
    export.add_argument(
        "-o",
        "--output",
        required=True,
        type=Path,
        help="file to write (.parquet or .mcap); of several files the folder",
    )
    export.add_argument(
        "--format",
        choices=[suffix[1:] for suffix in FORMATS],
        default="parquet",
        help="of several files in a folder (default %(default)s)",
    )
    add_force_option(export)
    return parser


def _show(options) -> int:
    results = [read_result(path) for path in options.files]
    if options.json:
        print(json.dumps({"files": [result.to_json() for result in results]}, ensure_ascii=False))
        return 0
    print("\n\n".join("\n".join(_lines(result)) for result in results))
    return 0


def _lines(result: Result) -> list[str]:
    facts = {result.kind: str(result.path), **result.facts}
    if result.provenance:
        facts |= result.provenance.summary().texts()
    elif result.kind not in (LIMB, TASK):  # a person wrote these
        facts["made by"] = "not known"
    width = max(12, *(len(name) + 2 for name in facts))
    return [f"{name:<{width}}{text}" for name, text in facts.items()]


def _compare(options) -> int:
    check_outputs([options.output], inputs=options.runs, force=options.force)
    comparison = compare([read_result(path) for path in options.runs])
    if options.output:
        # Bokeh takes as long to import as all the rest.
        from soft_limb.reports.comparison import write_comparison

        write_comparison(comparison, options.output)
    written = [str(options.output)] if options.output else []
    if options.json:
        print(json.dumps({**comparison.to_json(), "written": written}, ensure_ascii=False))
        return 0
    _tell(comparison)
    for path in written:
        print(f"written     {path}")
    return 0


def _tell(comparison: Comparison) -> None:
    if comparison.changes:
        _print_table("what changed", changes_table(comparison, comparison.changes))
    else:
        print("nothing changed")
    if comparison.differences:
        rows = differences_table(comparison, comparison.differences, "|Δ{}|")
        _print_table("absolute differences from the first", rows)
    if comparison.tracking:
        rows = differences_table(comparison, comparison.tracking, "|{0}* - {0}|")
        _print_table("tracking errors of the plan's recordings", rows)
    if comparison.motions:
        _print_table("Table I, means over limbs", motions_table(comparison))


def _print_table(title: str, rows: Sequence[Sequence[str]]) -> None:
    """Columns that are as wide as they must be."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    print(f"{title}:")
    for row in rows:
        cells = (f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True))
        print(f"  {'  '.join(cells)}".rstrip())
    print()


def _export(options) -> int:
    one = len(options.files) == 1
    if one and options.output.suffix not in FORMATS:
        raise OutputError(
            f"{options.output} is of no known format; its name must end with "
            f"{' or '.join(FORMATS)}."
        )
    outputs = [
        options.output if one else options.output / f"{path.stem}.{options.format}"
        for path in options.files
    ]
    check_outputs(outputs, inputs=options.files, force=options.force)
    results = [read_result(path) for path in options.files]
    for result in results:
        if result.kind not in (RECORDING, TRAJECTORY):
            raise LimbError(
                f"{result.path} is a {result.kind}; recordings and trajectories are exported."
            )
    for result, path in zip(results, outputs, strict=True):
        _WRITERS[path.suffix](result.value, path)
        print(f"written     {path}")
    return 0
