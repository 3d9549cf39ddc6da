"""Import logs: several files of one limb tell more together than each alone."""

import copy
import dataclasses
import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.import_logs.known_loggers import known_logger
from calibration.import_logs.log_signals import read_log
from calibration.import_logs.mapping import LogMapping
from calibration.import_logs.propose import Proposal, propose
from calibration.import_logs.table import LogError, LogTable, read_table
from calibration.import_logs.words import Dictionary
from limb_systems.errors import reraise_as
from limb_systems.files.recording import Recording
from limb_systems.limb_parameters import LimbParameters


@dataclasses.dataclass(eq=False)
class ImportedLog:
    """A log of a limb, its mapping and its recordings.

    - ``path``: path of the log.
    - ``limb``: the limb in it, with the mapping by which it is read, and what is asked.
    - ``recordings``: as far as duty is known without a gap, in parts; empty if something is asked,
      or if the mapping has to be corrected.
    - ``remarks``: what was lost, in sentences.
    - ``error``: why the mapping has to be corrected; empty if it can be read.
    """

    path: Path
    limb: Proposal
    recordings: list[Recording] = dataclasses.field(default_factory=list)
    remarks: list[str] = dataclasses.field(default_factory=list)
    error: str = ""

    @property
    def asks(self) -> bool:
        """True if the log has open questions, or its mapping open fields."""
        return bool(self.limb.questions or self.limb.mapping.open_fields)

    @property
    def stem(self) -> str:
        """The log's name without its ending, of letters that all systems have in files' names."""
        return re.sub(r"[^\w.-]+", "_", self.path.stem)

    @property
    def files(self) -> list[Path]:
        """The path of each recording's file: the limb's name, and the log's with a number."""
        folder = Path(self.limb.name)
        if len(self.recordings) == 1:
            return [folder / f"{self.stem}.csv"]
        numbers = range(1, len(self.recordings) + 1)
        return [folder / f"{self.stem}_{number}.csv" for number in numbers]

    def read(
        self, parameters: LimbParameters | None = None, tables: list[LogTable] | None = None
    ) -> None:
        """Read the recordings by the mapping, if nothing is asked; see `read_log` for its error."""
        if not self.asks:
            log = read_log(self.path, self.limb.mapping, parameters, tables)
            self.recordings, self.remarks = log


def import_logs(
    paths: Sequence[str | Path],
    mapping: LogMapping | None = None,
    parameters: LimbParameters | None = None,
    unread: list[str] | None = None,
    dictionary: Dictionary | None = None,
) -> list[ImportedLog]:
    """Read logs, and return each limb in them with its recordings or questions.

    What is asked of a log that has little heat, another log with the same columns may tell. A log
    whose name begins with "sag" and that has no heat is of a limb that gravity bends.

    Args:
        mapping: mapping of all logs; proposed for each log if None.
        parameters: the limb's description; the nominal limb if None.
        unread: gets why a log is left out that has no rows of numbers; if None, none is left out.
        dictionary: words of the columns' names; the words of `words` if None.

    Raises:
        LogError: if a log has no rows of numbers and is not left out, or if it is not as the given
            mapping says.
    """
    # Read each table, and propose what its columns are.
    files = list(dict.fromkeys(map(Path, paths)))
    logs: list[ImportedLog] = []
    tables: list[LogTable] = []
    for path in files:
        if mapping:
            logs.append(ImportedLog(path, Proposal("", mapping)))
            continue
        try:
            table = read_table(path)
            with reraise_as(LogError, f"{path}: "):
                limbs = known_logger(table)
                limbs = limbs or [propose(table, parameters, dictionary or Dictionary())]
        except LogError as problem:
            if unread is None or (path == files[-1] and not logs):
                raise
            unread.append(str(problem))
            continue
        for limb in limbs:
            logs.append(ImportedLog(path, limb))
        # The only log need not be read again.
        if len(files) == 1:
            tables = [table.only(limbs[0].mapping.columns)]
        del table
    # What one log asks, another one may tell; then read the recordings.
    _share([log.limb for log in logs])
    for log in logs:
        try:
            log.read(parameters, tables)
        except LogError as problem:
            if mapping:
                raise
            log.error = str(problem)
    return logs


def _share(limbs: list[Proposal]) -> None:
    """Answer the questions of logs by the mapping of another log with the same columns."""
    for limb in limbs:
        # Of the logs with the same columns, take the mappings without questions of heated ones.
        zeros_deg = []
        answered: list[LogMapping] = []
        for similar in limbs:
            if (similar.name, similar.columns) == (limb.name, limb.columns):
                if similar.mapping.bend.zero is not None:
                    zeros_deg.append(similar.mapping.bend.zero)
                if similar.is_heated and not similar.questions:
                    answered.append(similar.mapping)
        # The base points to one direction in all of them.
        if limb.mapping.bend.line and zeros_deg:
            limb.mapping.bend.zero = float(np.median(zeros_deg))
        # Replace a mapping with questions, but keep its time.
        has_contradiction = any(question.is_contradiction for question in limb.questions)
        if not answered or has_contradiction or (limb.is_heated and not limb.questions):
            continue
        replaced = limb.mapping
        limb.mapping = copy.deepcopy(max(answered, key=lambda mapping: mapping.full))
        for field in ("time", "rate"):
            setattr(limb.mapping, field, getattr(replaced, field))
        limb.notes.append("what this log does not tell is as in another log of the same columns")
        limb.questions = [q for q in limb.questions if q.field.split(".")[0] in ("time", "rate")]


def recording_from_log(
    path: str | Path,
    mapping: LogMapping | str | Path | None = None,
    parameters: LimbParameters | None = None,
) -> Recording:
    """Return a log's longest recording and warn of the rest; LogError if a question is open."""
    if isinstance(mapping, str | Path):
        mapping = LogMapping.load(mapping)
    # Refuse a log with open questions.
    log, *logs_of_other_limbs = import_logs([path], mapping, parameters)
    if log.asks:
        asked = [f"{question.text}." for question in log.limb.questions]
        asked = asked or log.limb.mapping.open_fields
        raise LogError(f"{path}: give in a mapping what the log does not tell: {' '.join(asked)}")
    if log.error:
        raise LogError(log.error)
    # Warn of the rows and limbs that are not in the longest recording.
    remarks = log.remarks
    if len(log.recordings) > 1:
        remarks = [f"This is the longest of {len(log.recordings)} parts.", *remarks]
    if logs_of_other_limbs:
        names = ", ".join(other_log.limb.name for other_log in logs_of_other_limbs)
        remarks = [f"This is {log.limb.name}; mappings would read {names}.", *remarks]
    if remarks:
        warnings.warn(f"{path}: {' '.join(remarks)}", stacklevel=3)
    return max(log.recordings, key=lambda recording: recording.time[-1])
