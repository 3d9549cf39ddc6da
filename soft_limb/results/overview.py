"""All results in a folder, and what belongs together, as one page without a server."""

import contextlib
import dataclasses
import datetime
import itertools
import os
import shlex
import urllib.parse
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path, PurePath

import numpy as np
from markupsafe import Markup

from limb_systems.errors import LimbError
from limb_systems.files.provenance import Provenance
from limb_systems.files.recording import Recording
from limb_systems.files.signal_table import Samples
from limb_systems.limb_model import LimbModel
from limb_systems.views.colors import (
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from soft_limb.reports import page
from soft_limb.results.folder import find, glance
from soft_limb.results.read_result import (
    GAIT,
    LEARNING,
    LIMB,
    RECORDING,
    REFERENCE,
    REPORT,
    ROBOT,
    TRAJECTORY,
    ResultFile,
    read_result,
)

PICTURE_POINTS = 150  # of a curve in a small picture
WIDTH, HEIGHT = 240.0, 56.0  # of a panel of a small picture
DASHED = "4 3"
# Of kinds of files, those from which they are made.
_MADE_FROM = {
    RECORDING: (TRAJECTORY, LIMB, ROBOT, GAIT),
    TRAJECTORY: (RECORDING, LIMB, TRAJECTORY, ROBOT, GAIT),
    GAIT: (ROBOT,),
    LEARNING: (TRAJECTORY,),
    LIMB: (RECORDING, LIMB),
}
_OUTPUT_OPTIONS = ("-o", "--output", "--plot", "--report", "--diagnostics")
# Facts that only somebody who looks at one file needs.
_DETAILS = {"rate", "samples", "limb", "solver", "limits", "title", "recordings", "made by"}


def overview_page(folder: Path, output: Path) -> str:
    """Return the page of a folder and the folders below, HTML.

    Args:
        folder: folder of the results.
        output: file that the page is for; links are relative to it, and it is not listed.

    Raises:
        LimbError: if the folder cannot be listed.
    """
    files, troubles = _read_files(folder, output.resolve())
    origins = find_origins(files)
    results = defaultdict(list)
    for file in files:
        for origin in origins[file]:
            results[origin].append(file)
    # A report has the provenance of its result.
    reports = [file for file in files if file.kind == REPORT]
    pages = {
        file: [report for report in reports if report.provenance == file.provenance]
        for file in files
        if file.kind in _MADE_FROM
    }
    linked = {report for of_file in pages.values() for report in of_file}

    def href(file: ResultFile) -> str:
        relative = os.path.relpath(file.path.resolve(), output.resolve().parent)
        return urllib.parse.quote(Path(relative).as_posix())

    return page.template("overview.html").render(
        folder=folder.resolve().name or str(folder.resolve()),
        provenance=dataclasses.asdict(Provenance.now()),
        files=[file for file in files if file.kind not in (REPORT, REFERENCE)],
        others=[report for report in reports if report not in linked],
        troubles=troubles,
        origins=origins,
        results=results,
        pages=pages,
        href=href,
        key=lambda file: file.path.relative_to(folder).as_posix(),
        day=lambda file: f"{datetime.datetime.fromtimestamp(_time_of(file)):%Y-%m-%d %H:%M}",
        title=lambda file: file.summary.texts()["title"],
        facts=_facts,
        picture=lambda file: small_picture(file.value),
    )


def _read_files(folder: Path, output: Path) -> tuple[list[ResultFile], list[str]]:
    """Return the files of a folder that can be read, newest first, and why others cannot be."""
    try:
        found = find(folder)
    except OSError as error:
        raise LimbError(f"Cannot list {folder}: {error.strerror}.") from error
    files, troubles = [], []
    for path in [file.path for file in found if file.path.resolve() != output]:
        if path.suffix == ".txt" and not glance(path):
            continue  # a text of somebody else
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


def _time_of(file: ResultFile) -> float:
    """Return when a file was made, or last changed if it does not say, s since 1970."""
    if file.provenance:
        with contextlib.suppress(ValueError):
            return datetime.datetime.fromisoformat(file.provenance.time).timestamp()
    return file.path.stat().st_mtime


def _facts(file: ResultFile) -> dict[str, str]:
    """Return the first line of each key figure, by its name."""
    texts = file.summary.texts().items()
    return {name: text.splitlines()[0] for name, text in texts if name not in _DETAILS}


def find_origins(files: Sequence[ResultFile]) -> dict[ResultFile, list[ResultFile]]:
    """Return the files from which each file was made.

    These are older files that its command names, the plan of a recording that the same command
    made in the same folder, and the limb whose digest its parameters have.
    """
    times = {file: _time_of(file) for file in files}
    limbs = {file.value.digest: file for file in files if file.kind in (LIMB, ROBOT)}
    origins = {}
    for file in files:
        kinds = _MADE_FROM.get(file.kind, ())
        older = [o for o in files if o.kind in kinds and times[o] <= times[file] and o is not file]
        found: list[ResultFile] = []
        # What the command names: a file, or all files of a folder.
        for word in _input_names(file.provenance):
            named = [other for other in older if word in (other.path.name, other.path.parent.name)]
            found += _nearest(file, named)
        # The plan that the same command made beside it.
        if file.kind == RECORDING and file.provenance:
            found += [
                other
                for other in older
                if other.kind == TRAJECTORY
                and other.path.parent == file.path.parent
                and other.provenance
                and other.provenance.command == file.provenance.command
            ]
        # The limb.
        if file.kind in (RECORDING, TRAJECTORY, GAIT):
            described = getattr(file.value, "robot", None) or file.value.parameters
            found += [limbs[described.digest]] if described.digest in limbs else []
        origins[file] = list(dict.fromkeys(found))
    return origins


def _input_names(made: Provenance | None) -> list[str]:
    """Return the names of files and folders that a command may have read."""
    try:
        words = shlex.split(made.command) if made else []
    except ValueError:  # it was too long, and cut
        return []
    inputs = [w for option, w in itertools.pairwise(words) if option not in _OUTPUT_OPTIONS]
    return [name for word in inputs if (name := PurePath(word).name)]


def _nearest(file: ResultFile, named: Sequence[ResultFile]) -> list[ResultFile]:
    """Return the files in the folder nearest to a file, as nobody knows where its command ran."""

    def nearness(folder: Path) -> tuple[int, int]:
        shared = Path(os.path.commonpath([folder, file.path.parent]))
        return len(shared.parts), -len(folder.parts)

    nearest = max((other.path.parent for other in named), key=nearness, default=None)
    return [other for other in named if other.path.parent == nearest]


def small_picture(run: object) -> Markup:
    """Return the bends and temperatures of a recording, plan or gait in small, SVG."""
    if not isinstance(run, Samples):
        return Markup()
    # Choose the samples.
    usable = np.flatnonzero(run.usable if isinstance(run, Recording) else np.ones(len(run.time)))
    if len(usable) < 2:
        return Markup()
    evenly = np.linspace(0, len(usable) - 1, PICTURE_POINTS).astype(int)
    kept = usable[np.unique(evenly)]
    # Choose the lines: the reference, the bends (those towards E3 dashed) and the wires.
    bends = np.rad2deg(run.bend_angle)
    wires = run.measured_temperature
    color = ROLLOUT_COLOR if isinstance(run, Recording) else PLAN_COLOR
    dashes = [DASHED if axis else "" for axis in LimbModel.of(run.parameters).layout.bend_direction]
    bend_lines = [(row, color, dash) for row, dash in zip(bends, dashes, strict=True)]
    reference = getattr(run, "reference", None)
    if reference is not None:
        bend_lines += [(row, REFERENCE_COLOR, "") for row in np.rad2deg(reference)]
    shades = wire_colors(len(wires))
    wire_lines = [(row, shade, "") for row, shade in zip(wires, shades, strict=True)]
    # Scale them to the panels.
    times = run.time[kept] - run.time[kept[0]]
    panels = []
    for name, unit, lines, values in (
        ("bend angle", "°", bend_lines, bends[:, usable]),
        ("temperature", " °C", wire_lines, wires[:, usable]),
    ):
        rows = np.array([row[kept] for row, *_ in lines])
        points = np.empty((len(rows), len(kept), 2))
        points[..., 0] = WIDTH * times / times[-1]
        points[..., 1] = HEIGHT * (rows.max() - rows) / max(np.ptp(rows), 1e-9)
        texts = [" ".join(f"{x:.1f},{y:.1f}" for x, y in line) for line in points]
        styled = [(text, *style) for text, (_, *style) in zip(texts, lines, strict=True)]
        ends = f"{values.min():.0f} to {values.max():.0f}{unit}"
        panels.append((name, ends, f"{times[-1]:.0f} s", styled))
    return page.part("picture_in_small", panels, WIDTH, HEIGHT)
