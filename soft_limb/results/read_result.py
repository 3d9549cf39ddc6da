"""Read any file that soft-limb writes, and tell its kind."""

import dataclasses
import functools
import html
import importlib.metadata
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from limb_systems.connected_limbs import CONNECTED_FIELDS, ConnectedLimbs, top_level_fields
from limb_systems.errors import LimbError
from limb_systems.files.input import LARGEST_TABLE, first_line, read_bytes
from limb_systems.files.provenance import Provenance
from limb_systems.files.recording import Recording
from limb_systems.files.table_writer import is_unfinished
from limb_systems.files.trajectory import Trajectory
from limb_systems.limb_parameters import EmulatedLimb, LimbParameters
from limb_systems.summary import Entry, Summary
from soft_limb.results.summaries import plan_summary, repetitions_summary

RECORDING, TRAJECTORY, LEARNING = "recording", "trajectory", "learning"
GAIT, LIMB, ROBOT, REPORT = "gait", "limb", "robot", "report"
ENTRY_POINTS = "soft_limb.results"  # group of entry points: dicts of readers like `_READERS`
TABLE_KINDS = ("recording", "trajectory", "gait", "learning")  # kinds by the first line
_HEAD = 4096  # bytes
_TAIL = 16384  # bytes of a page, whose provenance is at its end
LIMB_FIELDS = {field.name for field in dataclasses.fields(LimbParameters)}


class ResultError(LimbError):
    """A file is damaged, or not a file of soft-limb."""


@dataclasses.dataclass(frozen=True, eq=False)
class ResultFile:
    """A file of soft-limb: its path, and its kind, such as "recording" or "limb".

    - ``summary``: key figures of the contents, without the provenance.
    - ``provenance``: program and time that made the file; None if it is not in the file.
    - ``value``: a `Recording`, a `Trajectory`, `LimbParameters`, or an object of another
      package's reader; None for other kinds.
    """

    path: Path
    kind: str
    summary: Summary
    provenance: Provenance | None
    value: Any = None

    def about(self) -> Summary:
        """Return kind, path, key figures and provenance."""
        about = Summary([Entry(self.kind, str(self.path))]) + self.summary
        if self.provenance:
            return about + self.provenance.summary()
        # Limbs and robots are written by people.
        if self.kind in (LIMB, ROBOT):
            return about
        return about + Summary([Entry("made by", "not known")])

    def to_json(self) -> dict[str, Any]:
        """Return path, kind, key figures and provenance, for JSON."""
        return {
            "file": str(self.path),
            "kind": self.kind,
            "facts": self.summary.to_json(),
            "provenance": self.provenance and dataclasses.asdict(self.provenance),
        }


def read_result(path: str | Path, *, quick: bool = False) -> ResultFile:
    """Read a file of any kind.

    Args:
        quick: whether to leave out of the summary what takes a second, see `plan_summary`.

    Raises:
        LimbError: with one sentence, if it is not a file of soft-limb or is damaged.
    """
    path = Path(path)
    text = read_bytes(path, "result", LARGEST_TABLE, ResultError).decode("utf-8", "replace")
    text = text.removeprefix("\ufeff")
    # Guess the kind by the first line, and read the file with the reader of this kind.
    kind = REPORT if is_html(text[:1000]) else kind_of_head(path, text)
    if not kind:
        raise ResultError(
            f"{path} is no recording, trajectory, gait, limb, robot, state of learning or report "
            "of soft-limb."
        )
    reader = _READERS.get(kind) or _readers_of_packages()[kind]
    value, made, summary = reader(path, text, quick)
    return ResultFile(path, kind, summary, made, value)


def guess_file_kind(path: Path) -> str:
    """Return the kind of a file by its first and last bytes; see `ResultFile` for the kinds.

    The result is empty for other files.
    """
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD).decode("utf-8", "replace").removeprefix("\ufeff")
            file.seek(max(0, path.stat().st_size - _TAIL))
            tail = file.read(_TAIL)
    except OSError:
        return ""
    # Tables and descriptions are known by their beginnings, reports by their ends.
    if kind := kind_of_head(path, head):
        return kind
    return "report" if is_html(head) and b'id="provenance"' in tail else ""


def kind_of_head(path: Path, head: str) -> str:
    """Return the kind of a table, or "limb" or "robot" for a YAML file, or an empty text."""
    title = first_line(head)
    if title and title.kind in TABLE_KINDS:
        return title.kind
    fields = top_level_fields(head) if path.suffix in (".yaml", ".yml") else set()
    if fields & CONNECTED_FIELDS:
        return "robot"
    return "limb" if fields & LIMB_FIELDS else ""


def is_html(head: str) -> bool:
    """Return True if a file that begins with this text is an HTML page."""
    return head.lstrip().lower().startswith("<!doctype html>")


Read = tuple[Any, Provenance | None, Summary]


@functools.cache
def _readers_of_packages() -> dict[str, Callable[[Path, str, bool], Read]]:
    """Return the reader of each kind that another package adds."""
    readers: dict[str, Callable[[Path, str, bool], Read]] = {}
    for entry in importlib.metadata.entry_points(group=ENTRY_POINTS):
        readers |= entry.load()
    return readers


def _recording(path: Path, _text: str, _quick: bool) -> Read:
    recording = Recording.load(path, unfinished=is_unfinished(path))
    rate = Entry("rate", float(recording.sample_rate), "Hz")
    more = Summary([rate, identity_entry(recording.robot or recording.parameters)])
    return recording, recording.provenance, recording.summary() + more


def _trajectory(path: Path, _text: str, quick: bool) -> Read:
    plan = Trajectory.load(path)
    summary = plan_summary(plan, quick=quick) + Summary([identity_entry(plan.parameters)])
    return plan, plan.provenance, summary


def _learning(path: Path, _text: str, quick: bool) -> Read:
    from controllers import Learner  # takes long to import

    learner = Learner.load(path)
    plan = learner.trajectory
    more = Summary([Entry("plan", plan.summary().line()), identity_entry(plan.parameters)])
    return None, learner.provenance, repetitions_summary(learner, quick=quick) + more


def identity_entry(parameters: LimbParameters | ConnectedLimbs) -> Entry:
    """Return the entry that identifies the limb or robot of a file."""
    if isinstance(parameters, ConnectedLimbs):
        limbs = ", ".join(limb.name for limb in parameters.limbs)
        return Entry("identity", f"robot with limbs {limbs}, digest {parameters.digest}")
    board = parameters.board
    name = f"emulated, seed {board.seed}" if isinstance(board, EmulatedLimb) else board.identity
    calibrated = "calibrated" if parameters.calibration else "not calibrated"
    parts = [name, calibrated, f"digest {parameters.digest}"]
    return Entry("identity", ", ".join(filter(None, parts)))


def _limb(path: Path, _text: str, _quick: bool) -> Read:
    # List segments and wires.
    limb = LimbParameters.load(path)
    wires = zip(limb.wire_names, limb.wires, strict=True)
    num_links = sum(segment.links for segment in limb.segments)
    entries = [
        Entry("segments", f"{len(limb.segments)}, {num_links} links"),
        Entry("wires", ", ".join(f"{name} {type(wire.law).__name__}" for name, wire in wires)),
        identity_entry(limb),
    ]
    # Add the calibration, if there is one.
    record = limb.calibration
    made = None
    if record:
        made = record.provenance
        kinds = [line.partition(":")[0] for line in record.recordings]
        entries.append(Entry("recordings", ", ".join(kinds) or "none"))
        entries.append(Entry("validation", record.validation or "none"))
        if made and made.parameters != limb.digest:
            text = f"since it was calibrated: its digest was {made.parameters} then"
            entries.append(Entry("changed", text))
    return limb, made, Summary(entries)


def _report(path: Path, text: str, _quick: bool) -> Read:
    title = re.search(r"<title>(.*?)</title>", text, re.DOTALL)
    stamp = re.search(
        r'<script type="application/json" id="provenance">(.*?)</script>', text, re.DOTALL
    )
    try:
        made = Provenance.from_json(json.loads(stamp[1])) if stamp else None
    except ValueError as error:
        raise ResultError(f"{path}: its provenance is damaged: {error}.") from error
    summary = Summary([Entry("title", html.unescape(title[1]).strip() if title else "none")])
    return None, made, summary


_READERS: dict[str, Callable[[Path, str, bool], Read]] = {
    RECORDING: _recording,
    TRAJECTORY: _trajectory,
    LEARNING: _learning,
    LIMB: _limb,
    REPORT: _report,
}
