"""The results in a folder as a page, with a small picture of each."""

import dataclasses
import datetime
import functools
import os
import urllib.parse
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from limb_systems.output import write_atomically
from limb_systems.provenance import Provenance
from soft_limb.reports import page
from soft_limb.results.overview import ListedFile, Overview
from soft_limb.results.reading import (
    GAIT,
    LEARNING,
    LIMB,
    RECORDING,
    REPORT,
    ROBOT,
    TASK,
    TRAJECTORY,
)

WIDTH, HEIGHT = 240.0, 56.0  # of a panel of a small picture
_DASHES = {"solid": "", "dashed": "4 3", "dotted": "1 3"}


def write_overview(overview: Overview, path: str | Path) -> None:
    """Writes the page to an HTML file; its links hold as long as the files stay where they are."""
    folder = Path(path).resolve().parent

    def link(file: ListedFile) -> str:
        return Path(os.path.relpath(file.path.resolve(), folder)).as_posix()

    write_atomically(path, overview_page(overview, link, provenance=Provenance.now()))


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
        picture=picture,
        href=lambda file: urllib.parse.quote(link(file)),
        day=lambda file: f"{datetime.datetime.fromtimestamp(file.time):%Y-%m-%d %H:%M}",
    )


@functools.lru_cache(10_000)
def picture(file: ListedFile) -> Markup:
    """The signals of a file in small, as SVG, with their ranges."""
    drawn = []
    for panel in file.panels:
        values = np.concatenate([curve.y for curve in panel.curves])
        times = np.concatenate([curve.x for curve in panel.curves])
        if not len(times):
            continue
        low, high = min(values.min(), 0.0) if panel.from_zero else values.min(), values.max()
        span, wide = max(high - low, 1e-9), max(times.max() - times.min(), 1e-9)
        lines = [
            (
                " ".join(
                    f"{WIDTH * (x - times.min()) / wide:.1f},{HEIGHT * (high - y) / span:.1f}"
                    for x, y in zip(curve.x, curve.y, strict=True)
                ),
                curve.color,
                _DASHES[curve.dash],
            )
            for curve in panel.curves
        ]
        first, last = panel.y_range or (low, high)
        unit = panel.label.rpartition("(")[2].rstrip(")")
        unit = unit if unit == "°" else f" {unit}"
        ends = f"{first:.0f} to {last:.0f}{unit}"
        x_unit = panel.x_label.rpartition("(")[2].rstrip(")")
        length = f"{times.max():.0f} {x_unit}"
        drawn.append((panel.label.rpartition(" (")[0], ends, length, lines))
    return page.part("picture_in_small", drawn, WIDTH, HEIGHT)
