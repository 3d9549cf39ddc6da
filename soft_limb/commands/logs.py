"""The command that converts logs of other programs to recordings."""

import argparse
import shlex
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path

from calibration.import_logs.importing import ImportedLog, import_logs
from calibration.import_logs.mapping import LogMapping
from calibration.import_logs.table import LogError
from calibration.import_logs.words import Dictionary
from calibration.recordings.files import UsableRecordings, left_out_remark, select_usable
from calibration.recordings.kinds import kind_of
from calibration.remarks import Remark
from limb_systems import LimbError, LimbParameters, Recording
from limb_systems.files.output import check_folder, check_outputs, free_path
from limb_systems.summary import Entry, Summary
from soft_limb.commands.options import Command, Option, print_summary, shared

EXIT_QUESTIONS = 2  # exit status if the user has to answer a question


def shell_command(*words: str | Path) -> str:
    """Return a line for the shell that runs ``soft-limb`` with some words."""
    return shlex.join(["soft-limb", *map(str, words)])


def usable_recordings(recordings: Iterable[Recording]) -> UsableRecordings:
    """Sort recordings by the kinds in their headers, and leave out those that no fit can use."""
    by_kind: dict[str, list[Recording]] = {}
    for recording in recordings:
        by_kind.setdefault(recording.kind, []).append(recording)
    return select_usable(by_kind)


def fit_command(folder: Path, name: str = "limb") -> str:
    """Return the command that fits a limb to a folder of recordings and writes a new file."""
    return shell_command("fit", folder, "-o", free_path(Path(f"{name}.yaml")))


def _import(options: argparse.Namespace) -> int:
    # Read the logs.
    check_folder(options.output)
    parameters = LimbParameters.load(options.limb) if options.limb else None
    given = LogMapping.load(options.mapping) if options.mapping else None
    dictionary = Dictionary.load(options.words) if options.words else None
    unread: list[str] = []
    logs = import_logs(options.logs, given, parameters, unread, dictionary)
    # Ask what the logs leave open, if somebody is at a terminal.
    if sys.stdin.isatty() and not options.json:
        _ask_questions(logs, parameters)
    # Check all files before the first is written.
    mappings = [options.output / log.limb.name / f"{log.stem}.mapping.yaml" for log in logs]
    recordings: dict[Path, Recording] = {}
    for log in logs:
        for file, recording in zip(log.files, log.recordings, strict=True):
            recordings[options.output / file] = recording
    files = list(recordings)
    written = files if given else [*mappings, *files]
    inputs = [*options.logs, options.mapping, options.words]
    check_outputs(written, inputs=inputs, force=options.force)
    for log in logs:
        log.remarks.extend(map(str, _set_kinds(log, options.kind)))
    # Write each mapping, and print the summary of each log.
    summaries = []
    heated_folders = set()
    for log, mapping in zip(logs, mappings, strict=True):
        if not given:
            about = [
                f"How soft-limb reads {log.path.name}.",
                *log.limb.notes,
                *_question_lines(log),
            ]
            log.limb.mapping.save(mapping, about)
        used = usable_recordings(recording for recording in log.recordings if recording.kind)
        log.remarks.extend(f"soft-limb fit: {remark}" for remark in used.left_out)
        if used.heated:
            heated_folders.add(mapping.parent)
        summary = _summary(log, options.mapping or mapping)
        summaries.append(summary.to_json())
        if not options.json:
            print(f"{summary}\n")
    # Write the recordings.
    for path, recording in recordings.items():
        recording.save(path)
    # Print the next commands, unless a log has an error or an open question.
    failed = [log for log in logs if log.error or log.asks]
    text = "" if failed else "\n".join(_next_commands(options.output, recordings, heated_folders))
    print_summary(options, Summary.of({"next": text}, {"logs": summaries}), written)
    for error in unread:
        print(f"error: {error} The file is left out.", file=sys.stderr)
    return EXIT_QUESTIONS if any(log.asks for log in failed) else int(bool(failed or unread))


def _ask_questions(logs: Iterable[ImportedLog], parameters: LimbParameters | None) -> None:
    """Ask a person what the logs leave open; the answers hold for logs with like columns."""
    given: dict[tuple, dict[str, str]] = {}
    for log in logs:
        # Ask what no earlier log with these columns has answered.
        answers = given.setdefault((log.limb.name, *log.limb.columns), {})
        questions = {question.field: question.lines for question in log.limb.questions}
        for field in dict.fromkeys([*questions, *log.limb.mapping.open_fields]):
            if field in answers:
                continue
            print(f"{log.path}", *questions.get(field, ["? not known"]), sep="\n")
            print(f"{field} (Enter: leave it open): ", end="", flush=True)
            if answer := sys.stdin.readline().strip():
                answers[field] = answer
        if not answers or not set(questions) <= set(answers):
            continue
        # Read the log again if all is answered.
        try:
            log.limb.mapping = log.limb.mapping.with_answers(answers)
            log.limb.questions = []
            log.read(parameters)
        except LogError as problem:
            log.error = str(problem)


def _question_lines(log: ImportedLog) -> list[str]:
    """Return the questions of a log, each with lines of the mapping to edit."""
    return [line for question in log.limb.questions for line in question.lines]


def _set_kinds(log: ImportedLog, kind: str | None) -> Iterator[Remark]:
    """Set the kinds of a log's recordings, and yield a remark on each without a kind."""
    for path, recording in zip(log.files, log.recordings, strict=True):
        recording.title = path.name
        recording.kind = kind or ""
        try:
            recording.kind = kind_of(recording, log.stem)
        except LimbError as error:
            if kind:
                raise
            yield left_out_remark(recording.title, error)


def _next_commands(
    folder: Path, recordings: Mapping[Path, Recording], heated_folders: Collection[Path]
) -> Iterator[str]:
    """Yield the next command for each limb: fit its recordings, or plan an unheated motion."""
    # Sort the recordings by limb.
    paths_of: dict[Path, list[Path]] = {}
    for path in recordings:
        paths_of.setdefault(path.parent, []).append(path)
    for limb_folder, paths in sorted(paths_of.items()):
        if limb_folder in heated_folders:
            yield fit_command(limb_folder, "limb" if limb_folder == folder else limb_folder.name)
        elif not any(recordings[path].duty.any() for path in paths):
            plan = shell_command("plan", paths[0], "-o", free_path(Path("plan.csv")))
            yield f"{plan}  # no wire is heated: this motion can be a reference"


def _summary(log: ImportedLog, mapping: Path) -> Summary:
    """Return the columns, questions, losses and recordings of a log."""
    recordings = [recording.summary().line() for recording in log.recordings]
    questions = _question_lines(log)
    reason = log.error
    if not reason and log.asks:
        # A mapping that was given has no questions, but may have fields without an answer.
        left_open = "questions" if questions else ", ".join(log.limb.mapping.open_fields)
        reason = f"This log leaves {left_open} open."
    error = f"{reason} Correct {mapping} and give it with --mapping." if reason else ""
    notes = log.limb.notes
    # Put each list into lines.
    return Summary(
        [
            Entry("log", " ".join(filter(None, [str(log.path), log.limb.name]))),
            Entry("columns", notes, "", "\n".join(notes)),
            Entry("open", questions, "", "\n".join(questions)),
            Entry("lost", log.remarks, "", "\n".join(log.remarks)),
            Entry("recordings", recordings, "", "\n".join(recordings)),
            Entry("error", error),
        ]
    )


COMMANDS = {
    "import": Command(
        _import,
        "Convert logs of other programs to recordings, for calibration. The name of a column says "
        "what it is, and its numbers must agree. If the name is not understood, or the numbers "
        "contradict it, the command asks: at the terminal, or else with exit status 2. It writes "
        "the meaning of each column to a mapping, NAME.mapping.yaml, with open questions as "
        "comments; edit it, and run the command again with --mapping. A log of several limbs gives "
        "a folder for each limb.",
        "folder json force",
        [
            Option("logs", nargs="+", metavar="LOG", type=Path, help="log files (tables as text)"),
            shared("limb", help="description of the limb (.yaml); the nominal limb if left out"),
            Option(
                "--kind",
                help="kind of the recordings for calibration: sag; ring_down; the name of the only "
                "heated wire; both; heated; or motion, to compare laws with; if left out, taken "
                "from the data, or from file names that begin with heated or motion",
            ),
            Option("--mapping", type=Path, help="meaning of the columns (.yaml)"),
            Option(
                "--words",
                type=Path,
                help="your own words for signals in the names of columns (.yaml), such as "
                "duty: [brenner]",
            ),
        ],
        stopped="stopped; recordings that were written are complete",
        examples=["soft-limb import lab/*.csv -o out/recordings/"],
    ),
}
