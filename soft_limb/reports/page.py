"""Make reports: one HTML file without further files, for desktops, phones and paper.

Functions make parts of a page from plain text. The HTML is in ``templates/parts.html``.
"""

import base64
import dataclasses
import functools
import io
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from limb_systems.files.output import write_atomically
from limb_systems.files.provenance import Provenance
from limb_systems.limb_parameters import LimbParameters
from limb_systems.summary import Summary
from limb_systems.views import template as templates
from limb_systems.views.panels import Panel

if TYPE_CHECKING:
    from matplotlib.figure import Figure


TEMPLATES = Path(__file__).parents[1] / "templates"
part = functools.partial(templates.part, folder=TEMPLATES)  # calls a macro of parts.html
template = functools.partial(templates.template, folder=TEMPLATES)


@dataclasses.dataclass(frozen=True, eq=False)
class Section:
    """A section of a page: a heading in plain text, and parts."""

    heading: str
    parts: Sequence[Markup]


Part = Markup | Section


def write_page(
    path: str | Path,
    title: str,
    parts: Sequence[Part],
    provenance: Provenance | None = None,
    data: Mapping[str, str | Path] | None = None,
) -> None:
    """Write the page of `make_page`, with links to files of data by descriptions in plain text."""
    if data:
        folder = Path(path).parent
        links = {}
        for description, file in data.items():
            links[description] = Path(os.path.relpath(file, folder)).as_posix()
        parts = [*parts, section("Data", part("links", links))]
    write_atomically(path, make_page(title, parts, provenance))


def make_page(title: str, parts: Sequence[Part], provenance: Provenance | None = None) -> str:
    """Return a page, HTML. A page of many sections begins with a table of contents.

    Args:
        title: plain text, also used as the heading.
        parts: parts and sections, in their order.
        provenance: origin of the results, for the last section, and for programs as JSON in a
            script with the id "provenance"; None if it is not known.
    """
    if provenance:
        parts = [*parts, section("Origin", facts(provenance.summary()))]
    # Include the scripts of charts only in pages that have charts.
    texts: list[Markup] = []
    for item in parts:
        texts += item.parts if isinstance(item, Section) else [item]
    has_charts = any(text.startswith('<figure class="chart"') for text in texts)
    return template("report.html").render(
        title=title,
        parts=parts,
        provenance=provenance and dataclasses.asdict(provenance),
        bokeh=bokeh_scripts() if has_charts else "",
    )


def bokeh_scripts() -> str:
    """Return the scripts that draw charts, HTML; a page with them needs no other file."""
    from bokeh.resources import Resources

    # Leave out Bokeh's widgets, tables and formulas, which would make the page thrice as large.
    return Resources(mode="inline", components=["bokeh"], log_level="warn").render_js()


def section(heading: str, *parts: Markup) -> Section:
    """Return a section with a heading in plain text."""
    return Section(heading, parts)


paragraph = functools.partial(part, "paragraph")  # of a text
verdict = functools.partial(part, "verdict")  # of a text: the result, at the top of a report
items = functools.partial(part, "items")  # a list of texts
preformatted = functools.partial(part, "preformatted")  # of a text with its lines and spaces
frame = functools.partial(part, "frame")  # of another page's HTML, a description, a height in rem


def limb(parameters: LimbParameters) -> Markup:
    """Return the text of a limb's file, without the numbers of the covariance."""
    text = re.sub(
        r"^  covariance:\n(?:  (?:-|  ).*\n)+",
        "  covariance: ...  # in the limb's file\n",
        parameters.to_yaml(),
        flags=re.MULTILINE,
    )
    return preformatted(text)


def facts(summary: Summary) -> Markup:
    """Return a table of the entries of a summary: names and texts."""
    return table(["", ""], list(summary.texts().items()))


def chart(panels: Sequence[Panel], description: str) -> Markup:
    """Return panels as an interactive chart."""
    # Importing Bokeh takes as long as importing everything else.
    from bokeh.embed import json_item

    from soft_limb.reports import charts

    item = json_item(charts.chart(panels))
    item["target_id"] = None  # the page chooses the element to draw in
    return part("chart", item, description)


def picture(figure: "Figure", description: str) -> Markup:
    """Return a figure of Matplotlib as a picture that is sharp at any size."""
    import matplotlib

    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "limb"}):  # equal figures give equal bytes
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return part("picture", base64.b64encode(buffer.getvalue()).decode(), description)


def table(header: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> Markup:
    """Return a table of plain text; columns of numbers are aligned to the right.

    It has no header if all texts of the header are empty; the caption is below it.
    """
    # A column is numeric if all cells that are not empty begin with a digit after the sign.
    numeric = []
    for column in range(len(header)):
        cells = [row[column] for row in rows if row[column]]
        numeric.append(bool(cells) and all(cell.lstrip("-+±−")[:1].isdigit() for cell in cells))
    return part("table", header, rows, numeric, caption)
