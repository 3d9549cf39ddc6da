"""The command that reads logs of other programs."""

import argparse
import shlex
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path

from calibration.import_logs.importing import ImportedLog, import_logs
from calibration.import_logs.mapping import LogMapping
from calibration.import_logs.table import LogError
from calibration.import_logs.words import Dictionary
from calibration.recordings.files import UsableRecordings, left_out_remark, usable_recordings
from calibration.recordings.kinds import kind_of
from calibration.remarks import Remark
from limb_systems import LimbError, LimbParameters, Recording
from limb_systems.files.output import check_folder, check_outputs, free_path
from limb_systems.summary import Entry, Summary
from soft_limb.commands.options import Command, Option, print_summary, shared

ASKED = 2  # exit status: a log leaves something open, which the mapping has to say


def shell_line(*words: str | Path) -> str:
    """A command of ``soft-limb`` as a shell takes it."""
    return shlex.join(["soft-limb", *map(str, words)])


def usable_of(recordings: Iterable[Recording]) -> UsableRecordings:
    """What a limb can be fitted to of recordings with their kinds in their headers."""
    by_kind: dict[str, list[Recording]] = {}
    for recording in recordings:
        by_kind.setdefault(recording.kind, []).append(recording)
    return usable_recordings(by_kind)


def fit_line(folder: Path, name: str = "limb") -> str:
    """The command that fits a limb to a folder of recordings, and writes a new file."""
    return shell_line("fit", folder, "-o", free_path(Path(f"{name}.yaml")))


def _import(options: argparse.Namespace) -> int:
    check_folder(options.output)
    parameters = LimbParameters.load(options.limb) if options.limb else None
    given = LogMapping.load(options.mapping) if options.mapping else None
    dictionary = Dictionary.load(options.words) if options.words else None
    unread: list[str] = []
    logs = import_logs(options.logs, given, parameters, unread, dictionary)
    if sys.stdin.isatty() and not options.json:
        _answer(logs, parameters)
    mappings = [options.output / log.limb.name / f"{log.stem}.mapping.yaml" for log in logs]
    files = [options.output / file for log in logs for file in log.files]
    every = [recording for log in logs for recording in log.recordings]
    recordings = dict(zip(files, every, strict=True))
    written = files if given else [*mappings, *files]
    inputs = [*options.logs, options.mapping, options.words]
    check_outputs(written, inputs=inputs, force=options.force)
    for log in logs:
        log.remarks.extend(map(str, _of_kind(log, options.kind)))
    told, heated = [], set()
    for log, mapping in zip(logs, mappings, strict=True):
        if not given:
            about = [f"How soft-limb reads {log.path.name}.", *log.limb.notes, *_asked(log)]
            log.limb.mapping.save(mapping, about)
        own = usable_of(recording for recording in log.recordings if recording.kind)
        log.remarks.extend(f"soft-limb fit: {remark}" for remark in own.left_out)
        heated |= {mapping.parent} if own.heated else set()
        summary = _summary(log, mapping)
        told.append(summary.to_json())
        if not options.json:
            print(f"{summary}\n")
    for path, recording in recordings.items():
        recording.save(path)
    failed = [log for log in logs if log.error or log.asks]
    text = "" if failed else "\n".join(_next(options.output, recordings, heated))
    print_summary(options, Summary.of({"next": text}, {"logs": told}), written)
    for error in unread:
        print(f"error: {error} It is left out.", file=sys.stderr)
    return ASKED if any(log.asks for log in failed) else int(bool(failed or unread))


def _answer(logs: Iterable[ImportedLog], parameters: LimbParameters | None) -> None:
    """Ask a person at the terminal what logs do not tell; Enter leaves a question open.

    Answers to the questions of one log hold for all logs that have the same columns.
    """
    given: dict[tuple, dict[str, str]] = {}
    for log in logs:
        answers = given.setdefault((log.limb.name, *log.limb.columns), {})
        questions = {question.field: question.lines for question in log.limb.questions}
        fields = [*questions, *(f for f in log.limb.mapping.open_fields if f not in questions)]
        for field in [field for field in fields if field not in answers]:
            print(f"{log.path}", *questions.get(field, ["? not known"]), sep="\n")
            print(f"{field} (Enter: leave it open): ", end="", flush=True)
            if said := sys.stdin.readline().strip():
                answers[field] = said
        if not answers or not set(questions) <= set(answers):
            continue
        try:
            log.limb.mapping = log.limb.mapping.with_answers(answers)
            log.limb.questions = []
            log.read(parameters)
        except LogError as problem:
            log.error = str(problem)


def _asked(log: ImportedLog) -> list[str]:
    """The questions of a log, with lines of the mapping ready to be edited."""
    return [line for question in log.limb.questions for line in question.lines]


def _of_kind(log: ImportedLog, kind: str | None) -> Iterator[Remark]:
    """Gives recordings of a log their kinds, and yields remarks on those that have none.

    Raises:
        LimbError: if the kind that is given is none.
    """
    for path, recording in zip(log.files, log.recordings, strict=True):
        recording.title, recording.kind = path.name, kind or ""
        try:
            recording.kind = kind_of(recording, log.stem)
        except LimbError as error:
            if kind:
                raise
            yield left_out_remark(recording.title, error)


def _next(
    folder: Path, recordings: Mapping[Path, Recording], heated: Collection[Path]
) -> Iterator[str]:
    """A command for each limb that was read, if there is one that takes its recordings."""
    for limb in sorted({path.parent for path in recordings}):
        own = {path: r for path, r in recordings.items() if path.parent == limb}
        if limb in heated:
            yield fit_line(limb, "limb" if limb == folder else limb.name)
        elif not any(recording.duty.any() for recording in own.values()):
            plan = shell_line("plan", next(iter(own)), "-o", free_path(Path("plan.csv")))
            yield f"{plan}  # nothing is heated, so that it can be a reference"


def _summary(log: ImportedLog, mapping: Path) -> Summary:
    """What is in a log, and what was lost."""
    found = [recording.summary().line() for recording in log.recordings]
    doubt = log.error or ("It leaves something open." if log.asks else "")
    error = f"{doubt} Correct {mapping} and give it with --mapping." if doubt else ""
    asked = _asked(log)
    notes = log.limb.notes
    return Summary(
        [
            Entry("log", " ".join(filter(None, [str(log.path), log.limb.name]))),
            Entry("columns", notes, "", "\n".join(notes)),
            Entry("open", asked, "", "\n".join(asked)),
            Entry("lost", log.remarks, "", "\n".join(log.remarks)),
            Entry("recordings", found, "", "\n".join(found)),
            Entry("error", error),
        ]
    )


COMMANDS = {
    "import": Command(
        _import,
        "Reads logs of other programs as recordings, which calibration takes. Names say what a "
        "column is; numbers confirm it. What names do not tell, or what numbers contradict, it "
        "asks, at a terminal or with exit status 2. It writes what it took each column for as a "
        "mapping (NAME.mapping.yaml), with the questions as comments; correct it and give it back. "
        "Limbs that share a log get a folder each.",
        "folder json force",
        [
            Option("logs", nargs="+", metavar="LOG", type=Path, help="logs, tables of text"),
            shared("limb", help="the limb's description (.yaml); the nominal limb if left out"),
            Option(
                "--kind",
                help="what the logs are for calibration: sag, ring_down, the name of the one wire "
                "that is heated, both, heated, or motion, which judges laws; if left out, what "
                "they show, and heated or motion if their names begin so",
            ),
            Option("--mapping", type=Path, help="how to read the logs (.yaml)"),
            Option(
                "--words", type=Path, help="your words in columns' names (.yaml: duty: [brenner])"
            ),
        ],
        stopped="stopped; recordings that are there are whole",
        examples=["soft-limb import lab/*.csv -o out/recordings/"],
    ),
}
