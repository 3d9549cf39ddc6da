"""Reads logs of one limb or of several, which may tell more together than each alone."""

import copy
import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from limb_systems.files.recording import Recording
from limb_systems.limb_parameters import LimbParameters
from limb_systems.logs.formats import LimbInLog
from limb_systems.logs.guess import ASKS, limbs_in_log
from limb_systems.logs.mapping import LogMapping
from limb_systems.logs.reading import read_log
from limb_systems.logs.table import LogError, read_table


@dataclasses.dataclass(frozen=True, eq=False)
class ImportedLog:
    """What a log tells of a limb.

    - ``path``: path of the log.
    - ``limb``: the limb in it, with the mapping by which it was read.
    - ``recordings``: as far as duty is known without a gap, in parts; empty if the mapping has
      to be corrected.
    - ``remarks``: what was lost, in sentences.
    - ``error``: why the mapping has to be corrected; empty if it can be read.
    """

    path: Path
    limb: LimbInLog
    recordings: list[Recording]
    remarks: list[str]
    error: str

    @property
    def asks(self) -> bool:
        """Whether the mapping lacks something that the log does not tell."""
        return bool(self.limb.mapping.question)

    @property
    def stem(self) -> str:
        """The log's name without its ending, of letters that all systems have in files' names."""
        return re.sub(r"[^\w.-]+", "_", self.path.stem)

    @property
    def files(self) -> list[Path]:
        """Names for the recordings, by the limb's and the log's."""
        names = [self.stem]
        if len(self.recordings) != 1:
            names = [f"{self.stem}_{number}" for number in range(1, len(self.recordings) + 1)]
        return [Path(self.limb.name) / f"{name}.csv" for name in names]


def import_logs(
    paths: Sequence[str | Path],
    mapping: LogMapping | None = None,
    parameters: LimbParameters | None = None,
    unread: list[str] | None = None,
) -> list[ImportedLog]:
    """Reads logs.

    A log without heat does not show which way the bend is counted, so that it is read as one
    with heat that has the same columns. A log whose name begins with "sag" and that has no heat
    is one of a limb that is mounted so that gravity bends it, to the side where it bends.

    Args:
        mapping: mapping of all of them; what they show themselves if None.
        parameters: the limb's description; the nominal limb if None.
        unread: gets why a log is left out that is no table of text with rows of numbers; if None,
            none is left out.

    Raises:
        LogError: if a log is no table of text with rows of numbers, unless it is left out beside
            another one; if it is not as the given mapping says.
    """
    files = list(dict.fromkeys(map(Path, paths)))
    table = read_table(files[0]) if len(files) == 1 and not mapping else None  # not many at once
    found: list[tuple[Path, LimbInLog]] = []
    for path in files:
        try:
            read = [LimbInLog("", mapping, [], [])] if mapping else limbs_in_log(path, table)
            found += [(path, limb) for limb in read]
        except LogError as problem:
            if unread is None or (path == files[-1] and not found):
                raise
            unread.append(str(problem))
    limbs = [limb for _, limb in found]
    if table:
        table = table.only(set().union(*(limb.mapping.columns for limb in limbs)))
    shown: dict[tuple, LimbInLog] = {}
    for limb in limbs:
        if limb.heated:
            shown[_columns(limb)] = _joined(limb, shown.get(_columns(limb)))
    for key, known in shown.items():  # the base points to one direction in all of them
        same = [known, *(limb for limb in limbs if _columns(limb) == key)]
        zero = float(np.median([one.mapping.bend.zero for one in same]))
        for one in same:
            one.mapping.bend.zero = zero
    imported = []
    for path, limb in found:
        limb = _joined(limb, shown.get(_columns(limb)))
        try:
            parts, remarks = read_log(path, limb.mapping, parameters, table)
            recordings, error = [Recording(**part) for part in parts], ""
        except LogError as problem:
            if mapping:
                raise
            recordings, remarks, error = [], [], str(problem)
        imported.append(ImportedLog(path, limb, recordings, remarks, error))
    return imported


def _columns(limb: LimbInLog) -> tuple:
    """What logs that can be read alike have in common."""
    mapping = limb.mapping
    duties = tuple(sorted(wire.duty for wire in mapping.wires))
    return limb.name, mapping.time.column, duties, mapping.bend.column, tuple(mapping.bend.line)


def _joined(limb: LimbInLog, other: LimbInLog | None) -> LimbInLog:
    """A limb in a log, with what only another log of the same columns shows."""
    if other is None:
        return limb
    own = limb.mapping
    mapping = copy.deepcopy(own if limb.heated else other.mapping)
    mapping.delimiter, mapping.decimal = own.delimiter, own.decimal
    mapping.names_line, mapping.time = own.names_line, own.time
    agreement = list(limb.agreement)
    mapping.full = max(mapping.full, other.mapping.full)  # 0 if a log does not tell
    for index, wire in enumerate(other.mapping.wires):
        if not agreement[index] and other.agreement[index]:
            mapping.wires[index], agreement[index] = copy.deepcopy(wire), other.agreement[index]
    if len({wire.temperature for wire in mapping.wires}) < len(mapping.wires):
        return limb  # they contradict each other
    notes = limb.notes
    if mapping != limb.mapping:
        notes = [*notes, "what no heat shows here is as in another log of the same columns"]
        if not mapping.question:
            notes = [note for note in notes if not note.startswith(ASKS)]
    return LimbInLog(limb.name, mapping, notes, agreement)
