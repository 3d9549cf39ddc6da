"""Reports as one HTML file without further files, for desktops, phones and paper."""

import base64
import dataclasses
import html
import io
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from limb_systems.output import write_atomically
from limb_systems.provenance import Provenance

if TYPE_CHECKING:  # Bokeh takes as long to import as all the rest
    from bokeh.models import Model
    from matplotlib.figure import Figure

_STYLE = """
:root { color-scheme: light dark; --text: #222; --soft: #555; --line: #ddd; --ground: #fff; }
@media (prefers-color-scheme: dark) {
  :root { --text: #e4e4e4; --soft: #a8a8a8; --line: #3d3d3d; --ground: #161616; }
}
/* Charts take these, see "css_variables" in Bokeh's documentation. */
:root {
  --bk-axis-label-text-color: var(--soft); --bk-major-label-text-color: var(--soft);
  --bk-axis-line-color: #888; --bk-major-tick-line-color: #888;
  --bk-grid-line-color: rgba(128, 128, 128, 0.25);
}
body { font: 16px/1.5 system-ui, sans-serif; color: var(--text); background: var(--ground);
       max-width: 62rem; margin: 0 auto; padding: 1rem; overflow-wrap: break-word; }
p, li { max-width: 46rem; }
h1 { line-height: 1.2; } h2 { margin-top: 2.5rem; } li { margin: .3rem 0; }
figure { margin: 1rem 0; } figcaption { color: var(--soft); }
img { width: 100%; height: auto; background: #fff; }
.verdict { font-size: 1.15em; border-left: .3rem solid #888; padding-left: .8rem; }
.table { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; width: 100%; }
td, th { text-align: left; vertical-align: top; padding: .25rem .75rem .25rem 0;
         border-bottom: 1px solid var(--line); }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
td.number { white-space: nowrap; }
caption { text-align: left; color: var(--soft); caption-side: bottom; padding-top: .3rem; }
pre { white-space: pre-wrap; overflow-wrap: anywhere; font-size: .8em; line-height: 1.35; }
@media (max-width: 40rem) {
  table { font-size: .8rem; } td, th { padding-right: .4rem; } td.number { white-space: normal; }
}
@media print {
  body { font-size: 10.5pt; padding: 0; }
  h2, caption { break-after: avoid; } figure, table { break-inside: avoid; }
  img { max-height: 21cm; object-fit: contain; }
}
"""
_SHOW_CHARTS = """<script>
for (const chart of document.querySelectorAll("figure.chart"))
  Bokeh.embed.embed_item(JSON.parse(chart.firstElementChild.textContent), chart);
</script>"""


def write_page(
    path: str | Path, title: str, parts: Sequence[str], provenance: Provenance | None = None
) -> None:
    """Writes a page, whole or not at all.

    Args:
        path: of the HTML file.
        title: plain text, also used as the heading.
        parts: of its body, HTML.
        provenance: what made it, for the last section, and for programs in a script of JSON
            with the id "provenance"; None if it is not known.
    """
    title = html.escape(title)
    if provenance:
        parts = [*parts, _how_it_was_made(provenance)]
    body, script = "\n".join([f"<h1>{title}</h1>", *parts]), ""
    if '<figure class="chart"' in body:  # text cannot be this, as it is escaped
        from bokeh.resources import Resources

        # The same for all charts; widgets, tables and formulas would make it thrice as large.
        script = Resources(mode="inline", components=["bokeh"], log_level="warn").render_js()
        body += _SHOW_CHARTS
    write_atomically(
        path,
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style>{script}</head>\n"
        f"<body>{body}</body></html>\n",
    )


def _how_it_was_made(provenance: Provenance) -> str:
    data = json.dumps(dataclasses.asdict(provenance)).replace("<", "\\u003c")
    return "\n".join(
        [
            section("How it was made", table(["", ""], list(provenance.summary().texts().items()))),
            f'<script type="application/json" id="provenance">{data}</script>',
        ]
    )


def section(title: str, *parts: str) -> str:
    """A heading, plain text, and what stands below it, HTML."""
    return "\n".join([f"<h2>{html.escape(title)}</h2>", *parts])


def paragraph(text: str) -> str:
    """Plain text as a paragraph."""
    return f"<p>{html.escape(text)}</p>"


def verdict(text: str) -> str:
    """Plain text that a report begins with: what came of it, in a sentence or two."""
    return f'<p class="verdict">{html.escape(text)}</p>'


def items(texts: Sequence[str]) -> str:
    """Plain texts as a list."""
    return "<ul>" + "".join(f"<li>{html.escape(text)}</li>" for text in texts) + "</ul>"


def preformatted(text: str) -> str:
    """Plain text whose lines and spaces count, such as a file."""
    return f"<pre>{html.escape(text)}</pre>"


def links(report: str | Path, targets: Mapping[str, str | Path]) -> str:
    """Links to files, which hold as long as the files stay where they are from the report.

    Args:
        report: the path of the page.
        targets: by what they hold, plain text.
    """
    entries = []
    for text, target in targets.items():
        relative = Path(os.path.relpath(target, Path(report).parent)).as_posix()
        name = html.escape(relative)
        entries.append(f'<li>{html.escape(text)}: <a href="{quote(relative)}">{name}</a></li>')
    return f"<ul>{''.join(entries)}</ul>"


def chart(model: "Model", description: str) -> str:
    """A chart of Bokeh's as part of a page; the same chart gives the same text.

    Args:
        model: a figure or a layout of figures; it cannot be shown twice.
        description: plain text, for readers who cannot see it.
    """
    from bokeh.embed import json_item

    numbers: dict[str, str] = {}

    def renumber(part: dict[str, Any]) -> dict[str, Any]:
        """Bokeh counts what it has made since it was imported; here what is in this chart."""
        if "id" in part:
            part["id"] = numbers.setdefault(part["id"], f"p{len(numbers)}")
        return part

    item = json.loads(json.dumps(json_item(model)), object_hook=renumber)
    item["root_id"] = numbers[item["root_id"]]
    item["target_id"] = None
    text = json.dumps(item, separators=(",", ":")).replace("<", "\\u003c")
    return (
        f'<figure class="chart" role="img" aria-label="{html.escape(description)}">'
        f'<script type="application/json">{text}</script></figure>'
    )


def picture(figure: "Figure", description: str) -> str:
    """A figure as part of a page, sharp at any size.

    Args:
        description: plain text, for readers who cannot see the picture.
    """
    import matplotlib

    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "limb"}):  # the same picture, the same bytes
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    data = base64.b64encode(buffer.getvalue()).decode()
    return (
        f'<figure><img alt="{html.escape(description)}" src="data:image/svg+xml;base64,{data}">'
        "</figure>"
    )


def facts(lines: Sequence[str]) -> str:
    """What a command prints, lines that begin with a name or go on with the one before, a table."""
    rows: list[list[str]] = []
    for line in lines:
        name, _, text = line.partition(" ")
        if name or not rows:
            rows.append([name, text.strip()])
        else:
            rows[-1][1] += f"; {text.strip()}"
    return table(["", ""], rows)


def table(header: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> str:
    """A table of plain text; columns of numbers are set as such, also if some are missing.

    Args:
        header: a text for each column; no line of them if all are empty.
        rows: each with a text for each column.
        caption: below the table.
    """
    numeric = [
        any(row[i] for row in rows)
        and all(row[i].lstrip("-+±−")[:1].isdigit() for row in rows if row[i])
        for i in range(len(header))
    ]

    def line(cells: Sequence[str], tag: str) -> str:
        marked = (
            f"<{tag}{' class=number' * number}>{html.escape(cell).replace('± ', '±&nbsp;')}</{tag}>"
            for cell, number in zip(cells, numeric, strict=True)
        )
        return f"<tr>{''.join(marked)}</tr>"

    above = [line(header, "th")] if any(header) else []
    body = "\n".join([*above, *(line(row, "td") for row in rows)])
    below = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f'<div class="table"><table>{below}{body}</table></div>'
