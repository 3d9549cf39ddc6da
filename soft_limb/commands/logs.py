"""The command that reads logs of other programs."""

import argparse
import re
from pathlib import Path
from typing import Any

from limb_systems import LimbParameters, Recording
from limb_systems.logs.formats import LimbInLog
from limb_systems.logs.guess import limbs_in_log
from limb_systems.logs.mapping import LogMapping
from limb_systems.logs.reading import read_log
from limb_systems.logs.table import LogError
from limb_systems.output import check_folder, check_outputs
from limb_systems.summary import Entry, Summary
from soft_limb.commands.options import Command, Option, print_summary, shared


def _import(options: argparse.Namespace) -> int:
    check_folder(options.output)
    parameters = LimbParameters.load(options.limb) if options.limb else None
    given = LogMapping.load(options.mapping) if options.mapping else None
    told: list[dict[str, Any]] = []
    written: list[Path] = []
    for log in options.logs:
        limbs = [LimbInLog("", given, [])] if given else limbs_in_log(log)
        for limb in limbs:
            summary = _read(log, limb, parameters, options, written)
            told.append(summary.to_json())
            if not options.json:
                print(f"{summary}\n")
    failed = [one for one in told if one["error"]]
    text = "" if failed else f"soft-limb fit {options.output} -o limb.yaml"
    print_summary(options, Summary.of({"next": text}, {"logs": told}), written)
    return 1 if failed else 0


def _read(
    log: Path,
    limb: LimbInLog,
    parameters: LimbParameters | None,
    options: argparse.Namespace,
    written: list[Path],
) -> Summary:
    """Reads a limb of a log into files, and says what was found in it and what was lost."""
    folder = options.output / limb.name
    stem = re.sub(r"[^\w.-]+", "_", log.stem)
    mapping = options.mapping or folder / f"{stem}.mapping.yaml"
    if not options.mapping:
        check_outputs([mapping], inputs=[log], force=options.force)
        limb.mapping.save(mapping, [f"How soft-limb reads {log.name}.", *limb.notes])
        written.append(mapping)
    recordings: list[Recording] = []
    remarks: list[str] = []
    error = ""
    try:
        recordings, remarks = read_log(log, limb.mapping, parameters)
    except LogError as problem:
        error = f"{problem} Correct {mapping} and add --mapping {mapping}."
    several = len(recordings) > 1
    paths = [
        folder / (f"{stem}_{number}.csv" if several else f"{stem}.csv")
        for number in range(1, len(recordings) + 1)
    ]
    check_outputs(paths, inputs=[log], force=options.force)
    for recording, path in zip(recordings, paths, strict=True):
        recording.save(path)
    written += paths
    found = [recording.summary().line() for recording in recordings]
    return Summary(
        [
            Entry("log", " ".join(filter(None, [str(log), limb.name]))),
            Entry("columns", limb.notes, "", "\n".join(limb.notes)),
            Entry("lost", remarks, "", "\n".join(remarks)),
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
