"""Reads any file of soft-limb, and says what it is."""

import dataclasses
import html
import importlib
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.files.recording import Recording
from limb_systems.files.table_writer import is_unfinished
from limb_systems.files.trajectory import Trajectory
from limb_systems.input import LARGEST_TABLE, read_bytes
from limb_systems.model.parameters import EmulatedLimb, LimbParameters
from limb_systems.provenance import Provenance
from limb_systems.schema import shown

RESULTS = "results.json"  # of an evaluation, in its folder
RECORDING, TRAJECTORY, LEARNING = "recording", "trajectory", "learning"
LIMB, TASK, EVALUATION, REPORT = "limb", "task", "evaluation", "report"
STATISTICS = ("mean", "median", "90th percentile")  # of "tracking" in an evaluation's results


class ResultError(LimbError):
    """A file is none of soft-limb's, or damaged."""


@dataclasses.dataclass(frozen=True, eq=False)
class Result:
    """A file of soft-limb.

    - ``path``: of the file, or of the folder of an evaluation.
    - ``kind``: "recording", "trajectory", "learning", "limb", "task", "evaluation" or "report".
    - ``facts``: short texts, each under a name.
    - ``provenance``: what made it; None if it does not say.
    - ``value``: what was read: a `Recording`, a `Trajectory`, `LimbParameters`; of an
      evaluation the list in its JSON; else None.
    """

    path: Path
    kind: str
    facts: dict[str, str]
    provenance: Provenance | None
    value: Any = None

    def to_json(self) -> dict[str, Any]:
        """For JSON: all but the samples, with all of a plan's check."""
        checked = isinstance(self.value, Trajectory) and not self.value.check.is_missing
        return {
            "file": str(self.path),
            "kind": self.kind,
            "facts": self.facts,
            "check": dataclasses.asdict(self.value.check) if checked else None,
            "provenance": self.provenance and dataclasses.asdict(self.provenance),
        }


def read_result(path: str | Path) -> Result:
    """Reads a file, or the folder of an evaluation, whatever it is.

    Raises:
        LimbError: with one sentence, if it is not a file of soft-limb or is damaged.
    """
    path = Path(path)
    if path.is_dir():
        if not (path / RESULTS).exists():
            raise ResultError(f"{path} is a folder without {RESULTS}; give one of its files.")
        return _evaluation(path, path / RESULTS)
    data = read_bytes(path, "result", LARGEST_TABLE, ResultError)
    head = data[:4096].decode("utf-8", errors="replace").removeprefix("\ufeff")
    if match := re.match(r"# limb (\w+), format ", head):
        readers = {RECORDING: _recording, TRAJECTORY: _trajectory, LEARNING: _learning}
        if match[1] in readers:
            return readers[match[1]](path)
    elif head.lstrip().lower().startswith("<!doctype html>"):
        return _report(path, data)
    elif path.suffix == ".json":
        return _evaluation(path, path)
    elif path.suffix in (".yaml", ".yml"):
        return _yaml(path, data)
    raise ResultError(
        f"{path} is no recording, trajectory, limb, task, state of learning, evaluation or report "
        "of soft-limb."
    )


def _recording(path: Path) -> Result:
    recording = Recording.load(path, unfinished=is_unfinished(path))
    facts = recording.summary().texts() | {"rate": f"{recording.sample_rate:g} Hz"}
    facts["limb"] = _identity(recording.parameters)
    return Result(path, RECORDING, facts, recording.provenance, recording)


def _trajectory(path: Path) -> Result:
    trajectory = Trajectory.load(path)
    facts = trajectory.summary().texts() | {"check": check_sentence(trajectory)}
    facts["limb"] = _identity(trajectory.parameters)
    return Result(path, TRAJECTORY, facts, trajectory.provenance, trajectory)


def check_sentence(trajectory: Trajectory) -> str:
    """What the check of a plan says."""
    check = trajectory.check
    if check.is_missing:
        return f"none; made by {check.solver or 'an unknown solver'}, {check.status}"
    bounds = f"; runs along {len(check.active_constraints)} bounds"
    return (
        f"{'failed' if check.failure() else 'passed'}: up to {check.largest_difference_deg:.3f}° "
        f"from its simulation ({check.tolerance_deg:g}° allowed), defect "
        f"{check.largest_defect:.1e}; {check.solver}, {check.iterations} iterations, "
        f"{check.total_time:.1f} s{bounds if check.active_constraints else ''}"
    )


def _learning(path: Path) -> Result:
    # Not imported at the top: this package must not depend on those that import it.
    learner = importlib.import_module("controllers.learner").Learner.load(path)
    errors = [f"{np.rad2deg(r.mean_error):.2f}°" for r in learner.repetitions]
    failed = sum(repetition.failed for repetition in learner.repetitions)
    facts = {
        "repetitions": f"{len(errors)}, of which {failed} were undone" if failed else len(errors),
        "errors": ", ".join(errors),
        "finished": learner.finished,
        "plan": learner.trajectory.summary().line(),
        "limb": _identity(learner.trajectory.parameters),
    }
    facts = {name: str(text) for name, text in facts.items() if text != ""}
    return Result(path, LEARNING, facts, learner.provenance)


def _identity(parameters: LimbParameters) -> str:
    """Which limb a file is about."""
    board = parameters.board
    named = f"emulated, seed {board.seed}" if isinstance(board, EmulatedLimb) else board.identity
    calibrated = "calibrated" if parameters.calibration else "not calibrated"
    return ", ".join(filter(None, [named, calibrated, f"digest {parameters.digest}"]))


def _yaml(path: Path, data: bytes) -> Result:
    given = set(re.findall(r"^\{?(\w+):", data.decode("utf-8", errors="replace"), re.MULTILINE))
    if given & {"left", "right", *(field.name for field in dataclasses.fields(LimbParameters))}:
        return _limb(path)  # those of format 1 had a left and a right wire
    # See `_learning`.
    kind = importlib.import_module("planners.task").Task
    if not given & {field.name for field in dataclasses.fields(kind)}:
        raise ResultError(f"{path} has no field of a limb or a task at its top level.")
    task = kind.load(path)
    changed = {
        field.name: str(getattr(task, field.name))
        for field in dataclasses.fields(task)
        if getattr(task, field.name) != getattr(kind(), field.name)
    }
    facts = {name.replace("_", " "): text for name, text in changed.items()}
    return Result(path, TASK, facts or {"fields": "all have their defaults"}, None)


def _limb(path: Path) -> Result:
    limb = LimbParameters.load(path)
    record, count = limb.calibration, len(limb.segments)
    laws = ", ".join(
        f"{name} {type(wire.law).__name__}"
        for name, wire in zip(limb.wire_names, limb.wires, strict=True)
    )
    facts = {
        "segments": f"{count}, {limb.num_joints} links",
        "wires": laws,
        "identity": _identity(limb),
    }
    if record:
        kinds = [line.partition(":")[0] for line in record.recordings]
        facts["recordings"] = ", ".join(kinds) or "none"
        facts["validation"] = record.validation or "none"
        made = record.provenance
        if made and made.parameters != limb.digest:
            facts["changed"] = f"since it was calibrated: its digest was {made.parameters} then"
    return Result(path, LIMB, facts, record.provenance if record else None, limb)


def _report(path: Path, data: bytes) -> Result:
    text = data.decode("utf-8", errors="replace")
    title = re.search(r"<title>(.*?)</title>", text, re.DOTALL)
    facts = {"title": html.unescape(title[1]).strip() if title else "none"}
    stamp = re.search(
        r'<script type="application/json" id="provenance">(.*?)</script>', text, re.DOTALL
    )
    try:
        made = Provenance.from_json(json.loads(stamp[1])) if stamp else None
    except ValueError as error:
        raise ResultError(f"{path}: its provenance is damaged: {error}.") from error
    return Result(path, REPORT, facts, made)


def _evaluation(path: Path, file: Path) -> Result:
    text = read_bytes(file, "evaluation", LARGEST_TABLE, ResultError)
    try:
        summaries = json.loads(text)
    except ValueError as error:
        raise ResultError(f"{file} is not valid JSON: {error}.") from error
    _check_summaries(file, summaries)
    try:
        made = [Provenance.from_json(summary.get("provenance")) for summary in summaries]
    except LimbError as error:
        raise ResultError(f"{file}: {error}") from error
    whole = [summary for summary in summaries if not summary["absent"]]
    ways = dict.fromkeys(way for s in whole for ways in s["ways"].values() for way in ways)
    facts = {
        "limbs": f"{len(whole)}, seeds {', '.join(str(s['seed']) for s in whole)}",
        "motions": ", ".join(dict.fromkeys(motion for s in whole for motion in s["ways"])),
        "ways": ", ".join(ways),
    }
    for way in ways:
        errors = [
            driven[way]["tracking"][0]
            for s in whole
            for driven in s["ways"].values()
            if way in driven
        ]
        facts[way] = f"mean |φ* - φ| {np.mean(errors):.2f}°"
    if len(whole) < len(summaries):
        facts["others"] = f"{len(summaries) - len(whole)} limbs without some of their effects"
    return Result(path, EVALUATION, facts, made[0], summaries)


def _check_summaries(file: Path, summaries: Any) -> None:
    """Raises ResultError unless these are numbers of an evaluation."""
    if not isinstance(summaries, list) or not summaries:
        raise ResultError(f"{file} is no evaluation: it is not a list of limbs.")
    for number, summary in enumerate(summaries, 1):
        where = f"{file}: limb {number}"
        kinds: dict[str, type] = {"seed": int, "absent": list, "ways": dict}
        for name, kind in kinds.items():
            if not isinstance(summary, dict) or not isinstance(summary.get(name), kind):
                raise ResultError(f"{where} has no {name}; it is no evaluation, or damaged.")
        for motion, way, numbers in rollouts_of(summary):
            tracking = numbers.get("tracking") if isinstance(numbers, dict) else None
            if not _are_numbers(tracking, len(STATISTICS)):
                raise ResultError(
                    f"{where} has as tracking of {motion}, {way}: {shown(tracking)}; it must be "
                    f"{len(STATISTICS)} numbers, {', '.join(STATISTICS)}."
                )
    if not any(not summary["absent"] for summary in summaries):
        raise ResultError(f"{file} has no limb with all its effects.")


def rollouts_of(summary: dict) -> Iterator[tuple[str, str, Any]]:
    """Motion, way and numbers of all that a limb of an evaluation was driven by.

    Learning has all its repetitions as a way; the last one alone comes after it.
    """
    for motion, driven in summary["ways"].items():
        for way, numbers in driven.items() if isinstance(driven, dict) else [("", None)]:
            yield motion, way, numbers
    repeated = summary.get("repetitions")
    for motion, repetitions in repeated.items() if isinstance(repeated, dict) else ():
        if isinstance(repetitions, list) and repetitions:
            yield motion, f"learning, repetition {len(repetitions)}", repetitions[-1]


def _are_numbers(values: Any, count: int) -> bool:
    return (
        isinstance(values, list)
        and len(values) == count
        and all(isinstance(value, int | float) and math.isfinite(value) for value in values)
    )
