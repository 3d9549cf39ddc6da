"""Reports as one HTML file without further files, for desktops, phones and paper.

Functions make parts of a page from plain text; their HTML is in ``templates/parts.html``.
"""

import base64
import dataclasses
import functools
import io
import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
part = functools.partial(templates.part, folder=TEMPLATES)  # by a macro of parts.html
template = functools.partial(templates.template, folder=TEMPLATES)


@dataclasses.dataclass(frozen=True, eq=False)
class Section:
    """A heading, plain text, and the parts below it."""

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
    """Write a page, whole or not at all, with links to its data.

    Args:
        path: the HTML file.
        title, parts, provenance: as of `make_page`.
        data: files that the page links to, by what they hold, plain text.
    """
    if data:
        folder = Path(path).parent
        links = {what: Path(os.path.relpath(at, folder)).as_posix() for what, at in data.items()}
        parts = [*parts, section("Data", part("links", links))]
    write_atomically(path, make_page(title, parts, provenance))


def make_page(title: str, parts: Sequence[Part], provenance: Provenance | None = None) -> str:
    """Return a page, HTML. A page of many sections begins with a list of them.

    Args:
        title: plain text, also used as the heading.
        parts: parts and sections, in their order.
        provenance: origin of the results, for the last section and, for programs, in a script
            of JSON with the id "provenance"; None if it is not known.
    """
    if provenance:
        parts = [*parts, section("How it was made", facts(provenance.summary()))]
    body = [text for one in parts for text in getattr(one, "parts", [one])]
    has_charts = any(text.startswith('<figure class="chart"') for text in body)
    return template("report.html").render(
        title=title,
        parts=parts,
        provenance=provenance and dataclasses.asdict(provenance),
        bokeh=bokeh_scripts() if has_charts else "",
    )


def bokeh_scripts() -> str:
    """Return the scripts that draw charts, HTML; a page with them needs no other file."""
    from bokeh.resources import Resources

    # The same for all charts; widgets, tables and formulas would make it thrice as large.
    return Resources(mode="inline", components=["bokeh"], log_level="warn").render_js()


def section(heading: str, *parts: Markup) -> Section:
    """A heading, plain text, and what stands below it."""
    return Section(heading, parts)


paragraph = functools.partial(part, "paragraph")  # a text
verdict = functools.partial(part, "verdict")  # a text: what came of it, with which a report begins
items = functools.partial(part, "items")  # texts, as a list
preformatted = functools.partial(part, "preformatted")  # a text whose lines and spaces count
frame = functools.partial(part, "frame")  # a page's HTML, a description, and a height in rem


def limb(parameters: LimbParameters) -> Markup:
    """A limb as in its file, without the numbers of its covariance, which nobody reads."""
    text = re.sub(
        r"^  covariance:\n(?:  (?:-|  ).*\n)+",
        "  covariance: ...  # in the limb's file\n",
        parameters.to_yaml(),
        flags=re.MULTILINE,
    )
    return preformatted(text)


def facts(summary: Summary) -> Markup:
    """A table of the statements about a result."""
    return table(["", ""], list(summary.texts().items()))


def chart(panels: Sequence[Panel], description: str) -> Markup:
    """Panels as a chart to look into; the same panels give the same text.

    Args:
        description: text for readers who cannot see it.
    """
    # Bokeh takes as long to import as all the rest.
    from bokeh.embed import json_item

    from soft_limb.reports import charts

    numbers: dict[str, str] = {}

    def renumber(part: dict[str, Any]) -> dict[str, Any]:
        """Bokeh counts what it has made since it was imported; here what is in this chart."""
        if "id" in part:
            part["id"] = numbers.setdefault(part["id"], f"p{len(numbers)}")
        return part

    item = json.loads(json.dumps(json_item(charts.chart(panels))), object_hook=renumber)
    item["root_id"], item["target_id"] = numbers[item["root_id"]], None
    return part("chart", item, description)


def picture(figure: "Figure", description: str) -> Markup:
    """A figure of Matplotlib's, sharp at any size.

    Args:
        description: text for readers who cannot see it.
    """
    import matplotlib

    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "limb"}):  # the same picture, the same bytes
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return part("picture", base64.b64encode(buffer.getvalue()).decode(), description)


def table(header: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> Markup:
    """A table of plain text; columns of numbers are set as such, also if some are missing.

    Args:
        header: a text for each column; no line of them if all are empty.
        rows: each with a text for each column.
        caption: text below the table.
    """
    columns = [[row[i] for row in rows if row[i]] for i in range(len(header))]
    numeric = [
        bool(cells) and all(cell.lstrip("-+±−")[:1].isdigit() for cell in cells)
        for cells in columns
    ]
    return part("table", header, rows, numeric, caption)
