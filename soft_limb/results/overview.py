"""All results in a folder, and what belongs together, as a page."""

import dataclasses
import datetime
import itertools
import shlex
import time
import urllib.parse
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from markupsafe import Markup

from limb_systems.errors import LimbError
from limb_systems.files.provenance import Provenance
from limb_systems.files.recording import Recording
from limb_systems.files.table_writer import is_unfinished
from limb_systems.files.trajectory import Trajectory
from limb_systems.layout import Layout
from limb_systems.views.colors import (
    NEUTRAL_COLOR,
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from soft_limb.command import COMMANDS
from soft_limb.reports import page
from soft_limb.results.folder import FoundFile, find, glance
from soft_limb.results.read_result import (
    GAIT,
    LEARNING,
    LIMB,
    RECORDING,
    REPORT,
    ROBOT,
    TASK,
    TRAJECTORY,
    read_result,
)
from walking.gait import Gait

RECENT = 5.0  # s since the last change of a recording
BEING_RECORDED = "it is being recorded, or its program was killed just now"
POINTS = 150  # of a curve in a small picture
WIDTH, HEIGHT = 240.0, 56.0  # of a panel of a small picture
_DASHED, _DOTTED = "4 3", "1 3"  # bends towards E3 are dotted
# Of kinds of files, those from which they are made.
_MADE_FROM = {
    RECORDING: (TRAJECTORY, LIMB, ROBOT, GAIT),
    TRAJECTORY: (RECORDING, LIMB, TRAJECTORY, ROBOT, GAIT),
    GAIT: (ROBOT,),
    LEARNING: (TRAJECTORY,),
    LIMB: (RECORDING, LIMB),
}
_OUTPUTS = ("-o", "--output", "--plot", "--report", "--diagnostics")  # options of commands
# What a summary has for who looks at one file.
_DETAILS = {"rate", "samples", "limb", "solver", "limits", "title", "recordings", "made by"}


@dataclasses.dataclass(frozen=True, eq=False)
class ListedFile:
    """What is kept of a file.

    - ``key``, ``path``: as of `FoundFile`.
    - ``time``: when it was made, as far as it says so, else changed, s since 1970.
    - ``kind``: as of `ResultFile`; empty if the file cannot be read.
    - ``facts``: key figures by their names.
    - ``picture``: small picture of the signals, SVG.
    - ``made``: what made it; None if it does not say.
    - ``digest``: digest of the limb's parameters; empty if there are none.
    - ``trouble``: why it cannot be read, in a sentence; else empty.
    """

    key: str
    path: Path
    time: float
    kind: str = ""
    facts: dict[str, str] = dataclasses.field(default_factory=dict)
    picture: str | Markup = ""
    made: Provenance | None = None
    digest: str = ""
    trouble: str = ""

    @property
    def folder(self) -> PurePosixPath:
        """The folder that the file is in."""
        return PurePosixPath(self.key).parent


class Overview:
    """Results in a folder and below; a file is read again only if it has changed.

    - ``files``: files that have been read, newest first.
    - ``unread``: number of files that are still to be read.
    """

    def __init__(self, folder: str | Path):
        """
        Args:
            folder: path of the folder.
        """
        self.folder = Path(folder)
        self.files: list[ListedFile] = []
        self.unread = 0
        self._known: dict[FoundFile, ListedFile] = {}

    def look(self, patience: float = float("inf")) -> None:
        """List the files that are there now, and read some for so long, s; at least one file.

        Raises:
            LimbError: if the folder cannot be read.
        """
        try:
            found = find(self.folder)
        except OSError as error:
            raise LimbError(f"Cannot list {self.folder}: {error.strerror}.") from error
        known = {
            file: self._known[file]
            for file in found
            # What was being recorded is asked again whether it still is.
            if file in self._known and self._known[file].facts.get("end") != BEING_RECORDED
        }
        end = time.monotonic() + patience
        for file in found:
            if file not in known:
                known[file] = list_file(file)
                if time.monotonic() > end:
                    break
        self._known, self.unread = known, len(found) - len(known)
        listed = [file for file in known.values() if file.kind or file.trouble]
        self.files = sorted(listed, key=lambda file: (-file.time, file.key))

    def of_kind(self, *kinds: str) -> list[ListedFile]:
        """The files of some kinds."""
        return [file for file in self.files if file.kind in kinds]

    def origins(self) -> dict[str, list[ListedFile]]:
        """Files from which each file was made, by its key.

        They are older, and named in the command that made it, or the plan of a recording that the
        same command made in the same folder; or they are a limb of its limb's digest.
        """
        named, limbs = defaultdict(list), {f.digest: f for f in self.of_kind(LIMB, ROBOT)}
        for file in self.of_kind(RECORDING, TRAJECTORY, GAIT, LIMB, ROBOT):
            for name in (PurePosixPath(file.key).name, f"{file.folder.name}/"):
                named[name].append(file)
        found = {}
        for file in self.of_kind(*_MADE_FROM):
            origins: list[ListedFile] = []
            for word in map(PurePosixPath, _inputs(file.made)):
                for name in (word.name, f"{word.name}/"):  # a file, or all in a folder
                    older = [
                        other
                        for other in named[name]
                        if other is not file
                        and other.kind in _MADE_FROM[file.kind]
                        and other.time <= file.time
                    ]
                    origins += _nearest(file, word, older)
            if file.kind == RECORDING and file.made:
                origins += [
                    other
                    for other in named[f"{file.folder.name}/"]
                    if other.kind == TRAJECTORY
                    and other.made
                    and (other.folder, other.made.command) == (file.folder, file.made.command)
                ]
            if file.kind in (RECORDING, TRAJECTORY, GAIT) and file.digest in limbs:
                origins.append(limbs[file.digest])
            found[file.key] = list(dict.fromkeys(origins))
        return found

    def pages(self) -> dict[str, list[ListedFile]]:
        """Reports and replays of each file, by its key: they have its provenance."""
        by_stamp = defaultdict(list)
        for report in self.of_kind(REPORT):
            by_stamp[report.made].append(report)
        return {
            file.key: by_stamp[file.made]
            for file in self.of_kind(*_MADE_FROM)
            if file.made and file.made in by_stamp
        }


def list_file(file: FoundFile) -> ListedFile:
    """Read a file, whatever it is; a text file of another program has no kind and no trouble."""
    listed = ListedFile(file.key, file.path, file.changed)
    if not glance(file.path) and file.path.suffix in (".txt", ".html"):
        unstamped = f"{file.path} is a page that does not say what made it."
        return dataclasses.replace(listed, trouble=unstamped * (file.path.suffix == ".html"))
    try:
        result = read_result(file.path, quick=True)
    except LimbError as error:
        return dataclasses.replace(listed, trouble=str(error))
    facts = {
        name: text.splitlines()[0]
        for name, text in result.summary.texts().items()
        if name not in _DETAILS
    }
    if is_unfinished(file.path) and time.time() - file.changed < RECENT:
        facts["end"] = BEING_RECORDED
    if result.kind == REPORT:
        facts = {"title": result.summary.texts()["title"]}
    value = result.value
    described = getattr(value, "robot", None) or getattr(value, "parameters", None)
    parameters = value if result.kind in (LIMB, ROBOT) else described
    return dataclasses.replace(
        listed,
        time=_seconds(result.provenance) or file.changed,
        kind=result.kind,
        facts=facts,
        picture=small_picture(value),
        made=result.provenance,
        digest=parameters.digest if parameters else "",
    )


def _seconds(made: Provenance | None) -> float | None:
    try:
        return datetime.datetime.fromisoformat(made.time).timestamp() if made else None
    except ValueError:
        return None


def _inputs(made: Provenance | None) -> list[str]:
    """The words of a command that may be files which it read."""
    try:
        words = shlex.split(made.command) if made else []
    except ValueError:  # it was too long, and cut
        return []
    return [
        word
        for before, word in itertools.pairwise(["", *words])
        if before not in _OUTPUTS and word not in COMMANDS and not word.startswith("-")
    ]


def _nearest(
    file: ListedFile, word: PurePosixPath, candidates: Sequence[ListedFile]
) -> list[ListedFile]:
    """Of files with the name, or in the folder, of a path in a command, those that are meant.

    Nobody knows in which folder the command ran: those nearest to the file that it made.
    """
    parts = tuple(part for part in word.parts if part not in ("/", ".", ".."))
    shared: dict[PurePosixPath, int] = {}
    for other in candidates:
        theirs = PurePosixPath(other.key)
        if theirs.name != word.name:
            theirs = theirs.parent
        length = min(len(parts), len(theirs.parts))
        if parts[len(parts) - length :] == theirs.parts[-length:]:
            pairs = zip(other.folder.parts, file.folder.parts, strict=False)
            shared[other.folder] = sum(a == b for a, b in pairs)
    meant = max(shared, key=lambda folder: (shared[folder], -len(folder.parts)), default=None)
    return [other for other in candidates if other.folder == meant]


def small_picture(run: object) -> Markup:
    """The bend angles and temperatures of a recording, plan or gait in small, as SVG."""
    if not isinstance(run, Recording | Trajectory | Gait):
        return Markup()
    good = np.flatnonzero(run.usable if isinstance(run, Recording) else np.ones(len(run.time)))
    if len(good) < 2:
        return Markup()
    kept = good[np.unique(np.linspace(0, len(good) - 1, POINTS).astype(int))]
    times = run.time[kept] - run.time[0]
    color = ROLLOUT_COLOR if isinstance(run, Recording) else PLAN_COLOR
    asked = None if isinstance(run, Gait) else run.reference
    angles, wires = np.rad2deg(run.bend_angle), run.measured_temperature
    bend = [(row, REFERENCE_COLOR, _DASHED) for row in ([] if asked is None else np.rad2deg(asked))]
    towards = Layout(run.parameters).bend_direction
    bend += [(row, color, ("", _DOTTED)[axis]) for row, axis in zip(angles, towards, strict=True)]
    heat = [(row, shade, "") for row, shade in zip(wires, wire_colors(len(wires)), strict=True)]
    limit = np.full(len(run.time), run.parameters.temperature_limits.maximum)
    heat.append((limit, NEUTRAL_COLOR, _DOTTED))
    drawn = []
    for name, unit, lines, read in (
        ("bend angle", "°", bend, angles[:, good]),
        ("temperature", " °C", heat, wires[:, good]),
    ):
        rows = np.array([row[kept] for row, *_ in lines])
        heights = HEIGHT * (rows.max() - rows) / max(np.ptp(rows), 1e-9)
        points = [
            " ".join(
                f"{WIDTH * x / times[-1]:.1f},{y:.1f}" for x, y in zip(times, row, strict=True)
            )
            for row in heights
        ]
        styled = [(text, *style) for text, (_, *style) in zip(points, lines, strict=True)]
        ends = f"{read.min():.0f} to {read.max():.0f}{unit}"
        drawn.append((name, ends, f"{times[-1]:.0f} s", styled))
    return page.part("picture_in_small", drawn, WIDTH, HEIGHT)


def overview_page(
    overview: Overview,
    link: Callable[[ListedFile], str],
    *,
    provenance: Provenance | None = None,
    served: bool = False,
    news: Sequence[tuple[str, str]] = (),
) -> str:
    """The page, HTML.

    Args:
        link: function that gives the address of a file, before it is quoted.
        provenance: what makes it, of one that is kept.
        served: whether there is a server that compares and starts.
        news: sentences on what was started, each with a link or "".
    """
    origins = overview.origins()
    by_key = {file.key: file for file in overview.files}
    results: dict[str, list[ListedFile]] = {}
    for key, files in origins.items():
        for file in files:
            results.setdefault(file.key, []).append(by_key[key])
    pages = overview.pages()
    shown = {report.key for of_file in pages.values() for report in of_file}
    return page.template("overview.html").render(
        folder=overview.folder.resolve().name or str(overview.folder.resolve()),
        unread=overview.unread,
        provenance=provenance and dataclasses.asdict(provenance),
        served=served,
        news=news,
        files=overview.of_kind(RECORDING, TRAJECTORY, GAIT, LEARNING, LIMB, ROBOT, TASK),
        others=[report for report in overview.of_kind(REPORT) if report.key not in shown],
        foreign=[file.trouble for file in overview.files if file.trouble],
        origins=origins,
        results=results,
        pages=pages,
        compared=(RECORDING, TRAJECTORY, LIMB),
        startable=TRAJECTORY,
        href=lambda file: urllib.parse.quote(link(file)),
        day=lambda file: f"{datetime.datetime.fromtimestamp(file.time):%Y-%m-%d %H:%M}",
    )
