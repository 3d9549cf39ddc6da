"""The command that reads logs of other programs."""

import argparse
import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path

from limb_systems import LimbParameters, Recording
from limb_systems.logs.importing import ImportedLog, import_logs
from limb_systems.logs.mapping import LogMapping
from limb_systems.output import check_folder, check_outputs
from limb_systems.summary import Entry, Summary
from soft_limb.commands.options import Command, Option, print_summary, shared


def _import(options: argparse.Namespace) -> int:
    check_folder(options.output)
    parameters = LimbParameters.load(options.limb) if options.limb else None
    given = LogMapping.load(options.mapping) if options.mapping else None
    logs = import_logs(options.logs, given, parameters)
    mappings = [options.output / log.limb.name / f"{log.stem}.mapping.yaml" for log in logs]
    files = [options.output / file for log in logs for file in log.files]
    recordings = dict(zip(files, itertools.chain(*(log.recordings for log in logs)), strict=True))
    written = files if given else [*mappings, *files]
    check_outputs(written, inputs=[*options.logs, options.mapping], force=options.force)
    told = []
    for log, mapping in zip(logs, mappings, strict=True):
        if not given:
            about = [f"How soft-limb reads {log.path.name}.", *log.limb.notes]
            log.limb.mapping.save(mapping, about)
        summary = _summary(log, mapping)
        told.append(summary.to_json())
        if not options.json:
            print(f"{summary}\n")
    for path, recording in recordings.items():
        recording.save(path)
    failed = any(log.error for log in logs)
    text = "" if failed else "\n".join(_next(options.output, recordings))
    print_summary(options, Summary.of({"next": text}, {"logs": told}), written)
    return int(failed)


def _next(folder: Path, recordings: Mapping[Path, Recording]) -> Iterator[str]:
    """A command for each limb that was read."""
    for limb in sorted({path.parent for path in recordings}):
        own = {path: r for path, r in recordings.items() if path.parent == limb}
        if any(recording.duty.any() for recording in own.values()):
            name = "limb" if limb == folder else limb.name
            yield f"soft-limb fit {limb} -o {name}.yaml"
        else:
            yield f"soft-limb plan {next(iter(own))} -o plan.csv, as a reference: nothing is heated"


def _summary(log: ImportedLog, mapping: Path) -> Summary:
    """What is in a log, and what was lost."""
    found = [recording.summary().line() for recording in log.recordings]
    error = f"{log.error} Correct {mapping} and give it with --mapping." if log.error else ""
    return Summary(
        [
            Entry("log", " ".join(filter(None, [str(log.path), log.limb.name]))),
            Entry("columns", log.limb.notes, "", "\n".join(log.limb.notes)),
            Entry("lost", log.remarks, "", "\n".join(log.remarks)),
            Entry("recordings", found, "", "\n".join(found)),
            Entry("error", error),
        ]
    )


COMMANDS = {
    "import": Command(
        _import,
        "Reads logs of other programs as recordings, which calibration takes. Some loggers of this "
        "field are known; of any other table it says what it takes each column for, by name, range "
        "and what follows the heat. It writes that as a mapping (NAME.mapping.yaml), which you may "
        "correct and give back. Limbs that share a log get a folder each.",
        "folder json force",
        [
            Option("logs", nargs="+", metavar="LOG", type=Path, help="logs, tables of text"),
            shared("limb", help="the limb's description (.yaml); the nominal limb if left out"),
            Option("--mapping", type=Path, help="how to read the logs (.yaml)"),
        ],
        stopped="stopped; recordings that are there are whole",
    ),
}
