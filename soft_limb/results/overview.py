"""One page about all results in a folder, with links between related results; no server."""

import contextlib
import dataclasses
import datetime
import itertools
import os
import shlex
import urllib.parse
from collections.abc import Sequence
from pathlib import Path, PurePath

import numpy as np
from markupsafe import Markup

from limb_systems.errors import LimbError
from limb_systems.files.provenance import Provenance
from limb_systems.files.recording import Recording
from limb_systems.files.signal_table import Samples
from limb_systems.progress import Progress
from limb_systems.views.colors import PLAN_COLOR, REFERENCE_COLOR, ROLLOUT_COLOR, wire_colors
from soft_limb.reports import page
from soft_limb.results.read_result import (
    LIMB,
    RECORDING,
    REPORT,
    ROBOT,
    TRAJECTORY,
    ResultFile,
    guess_file_kind,
    read_result,
)

RESULT_SUFFIXES = (".csv", ".html", ".txt", ".yaml", ".yml")
PICTURE_POINTS = 150  # of a curve in a small picture
WIDTH = 240.0  # of a panel of a small picture
HEIGHT = 56.0
_OUTPUT_OPTIONS = ("-o", "--output", "--plot", "--report", "--diagnostics")
# Facts that the page leaves out; soft-limb show prints them.
_DETAILS = {"rate", "samples", "limb", "solver", "limits", "title", "recordings", "made by"}


def overview_page(folder: Path, output: Path) -> str:
    """Return the page of a folder and the folders below, HTML.

    Links are relative to the file ``output``, which is not listed. Raise LimbError if the folder
    cannot be listed.
    """
    entries, troubles = _read_files(folder, output.resolve())
    files = [entry for entry in entries if entry.kind != REPORT]
    reports = [entry for entry in entries if entry.kind == REPORT]
    origins = find_origins(files)
    # A report has the same provenance as its result.
    provenances = [file.provenance for file in files]

    def href(file: ResultFile) -> str:
        relative = os.path.relpath(file.path.resolve(), output.resolve().parent)
        return urllib.parse.quote(Path(relative).as_posix())

    return page.template("overview.html").render(
        folder=folder.resolve().name or str(folder.resolve()),
        provenance=dataclasses.asdict(Provenance.now()),
        files=files,
        others=[report for report in reports if report.provenance not in provenances],
        troubles=troubles,
        origins=origins,
        results=lambda file: [made for made in files if file in origins[made]],
        pages=lambda file: [made for made in reports if made.provenance == file.provenance],
        href=href,
        key=lambda file: file.path.relative_to(folder).as_posix(),
        day=lambda file: f"{datetime.datetime.fromtimestamp(_time_of(file)):%Y-%m-%d %H:%M}",
        details=_DETAILS,
        picture=small_picture,
    )


def _read_files(folder: Path, output: Path) -> tuple[list[ResultFile], list[str]]:
    """Return the results in a folder, newest first, and a sentence for each unreadable file."""
    if not folder.is_dir():
        trouble = "it is a file" if folder.exists() else "there is no such folder"
        raise LimbError(f"Cannot list {folder}: {trouble}.")
    # Read all files; an unreadable file gives a sentence on the page.
    files = []
    troubles = []
    paths = _find_results(folder)
    with Progress("reading", len(paths), "files") as progress:
        for number, path in enumerate(paths):
            progress.update(number)
            # Skip the page itself, and texts that soft-limb did not write.
            if path.resolve() == output or (path.suffix == ".txt" and not guess_file_kind(path)):
                continue
            try:
                file = read_result(path, quick=True)
            except LimbError as error:
                troubles.append(str(error))
                continue
            if file.kind == REPORT and not file.provenance:
                troubles.append(f"{path} is a page that does not say what made it.")
            else:
                files.append(file)
    return sorted(files, key=lambda file: (-_time_of(file), str(file.path))), troubles


def _find_results(folder: Path) -> list[Path]:
    """Return the files in a folder and below that may be results.

    Hidden folders, installed packages, and links that lead out of the folder are left out.
    """
    files = []
    for parent, folders, names in os.walk(folder):
        folders[:] = filter(_is_visible, folders)
        # Keep files with the suffix of a result that are inside.
        for name in filter(_is_visible, names):
            path = Path(parent, name)
            is_inside = path.resolve().is_relative_to(folder.resolve())
            if name.endswith(RESULT_SUFFIXES) and is_inside and path.is_file():
                files.append(path)
    return files


def _is_visible(name: str) -> bool:
    """Return False for hidden files and folders, and for folders of installed packages."""
    return name[0] not in "._" and name.isprintable() and name not in ("node_modules", "venv")


def _time_of(file: ResultFile) -> float:
    """Return the time in a file's provenance, or else of its last change, s since 1970."""
    if file.provenance:
        with contextlib.suppress(ValueError):
            return datetime.datetime.fromisoformat(file.provenance.time).timestamp()
    return file.path.stat().st_mtime


def find_origins(files: Sequence[ResultFile]) -> dict[ResultFile, list[ResultFile]]:
    """Return the files from which each file was made.

    These are older files that its command names, the plan of a recording that the same command
    made in the same folder, and the limb whose digest its parameters have.
    """
    limbs = {file.value.digest: file for file in files if file.kind in (LIMB, ROBOT)}
    origins = {}
    for file in files:
        # Take older files that the command names, and the plan that the same command made.
        names = _input_names(file.provenance)
        inputs = []
        for origin in files:
            is_named = origin.path.name in names or origin.path.parent.name in names
            is_input = origin is not file and (is_named or _is_plan_of(origin, file))
            if is_input and _time_of(origin) <= _time_of(file):
                inputs.append(origin)
        # Take the limb or robot that the file is about.
        described = getattr(file.value, "robot", None) or getattr(file.value, "parameters", None)
        if described and described.digest in limbs:
            inputs.append(limbs[described.digest])
        origins[file] = list(dict.fromkeys(inputs))
    return origins


def _input_names(made: Provenance | None) -> set[str]:
    """Return the names of files and folders that a command may have read."""
    try:
        words = shlex.split(made.command) if made else []
    except ValueError:  # the command was too long, and is cut off
        return set()
    inputs = [word for option, word in itertools.pairwise(words) if option not in _OUTPUT_OPTIONS]
    return {PurePath(word).name for word in inputs} - {""}


def _is_plan_of(plan: ResultFile, file: ResultFile) -> bool:
    """Return True if one command wrote a plan and, to the same folder, its recording."""
    if (plan.kind, file.kind) != (TRAJECTORY, RECORDING) or plan.path.parent != file.path.parent:
        return False
    commands = [made.provenance and made.provenance.command for made in (plan, file)]
    return commands[0] is not None and commands[0] == commands[1]


def small_picture(run: object) -> Markup:
    """Return a small picture of the bends and temperatures of a recording, plan or gait, SVG."""
    if not isinstance(run, Samples):
        return Markup()
    # Choose evenly spaced samples.
    usable = np.flatnonzero(run.usable if isinstance(run, Recording) else np.ones(len(run.time)))
    if len(usable) < 2:
        return Markup()
    evenly = np.linspace(0, len(usable) - 1, PICTURE_POINTS).astype(int)
    drawn = usable[np.unique(evenly)]
    times = run.time[drawn] - run.time[drawn[0]]
    # Choose the lines: the bends, their reference and the wires.
    bends = np.rad2deg(run.bend_angle)
    reference = getattr(run, "reference", None)
    references = bends[:0] if reference is None else np.rad2deg(reference)
    wires = run.measured_temperature
    color = ROLLOUT_COLOR if isinstance(run, Recording) else PLAN_COLOR
    bend_colors = [color] * len(bends) + [REFERENCE_COLOR] * len(references)
    # Scale them to the panels.
    panels = []
    for name, unit, signal, rows, colors in (
        ("bend angle", "°", bends, np.vstack([bends, references]), bend_colors),
        ("temperature", " °C", wires, wires, wire_colors(len(wires))),
    ):
        values = rows[:, drawn]
        x = WIDTH * times / times[-1]
        y = HEIGHT * (values.max() - values) / max(np.ptp(values), 1e-9)
        lines = []
        for line, line_color in zip(y, colors, strict=True):
            points = np.char.mod("%.1f", np.column_stack([x, line]))
            lines.append((" ".join(map(",".join, points)), line_color))
        ends = f"{signal[:, usable].min():.0f} to {signal[:, usable].max():.0f}{unit}"
        panels.append((name, ends, f"{times[-1]:.0f} s", lines))
    return page.part("small_picture", panels, WIDTH, HEIGHT)
