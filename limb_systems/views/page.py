"""Reports as one HTML file without further files, for desktops, phones and paper."""

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from limb_systems.output import write_atomically

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; max-width: 46rem;
       margin: 0 auto; padding: 1rem; }
h1 { line-height: 1.2; } h2 { margin-top: 2.5rem; } li { margin: .3rem 0; }
figure { margin: 1rem 0; } img { width: 100%; height: auto; } figcaption { color: #555; }
.table { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; width: 100%; }
td, th { text-align: left; vertical-align: top; padding: .25rem .75rem .25rem 0;
         border-bottom: 1px solid #ddd; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
td.number, th.number { white-space: nowrap; }
caption { text-align: left; color: #555; caption-side: bottom; padding-top: .3rem; }
pre { white-space: pre-wrap; overflow-wrap: anywhere; font-size: .8em; line-height: 1.35; }
@media (max-width: 40rem) {
  table { font-size: .8rem; } td, th { padding-right: .4rem; } td.number { white-space: normal; }
}
@media print {
  body { font-size: 10.5pt; max-width: none; padding: 0; }
  h2, caption { break-after: avoid; } figure, table { break-inside: avoid; }
  img { max-height: 21cm; object-fit: contain; }
}
"""


def write_page(path: str | Path, title: str, parts: Sequence[str]) -> None:
    """Writes a page, whole or not at all.

    Args:
        path: of the HTML file.
        title: plain text, also used as the heading.
        parts: of its body, HTML.
    """
    title = html.escape(title)
    body = "\n".join([f"<h1>{title}</h1>", *parts])
    write_atomically(
        path,
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style></head>\n<body>{body}</body></html>\n",
    )


def section(title: str, *parts: str) -> str:
    """A heading, plain text, and what stands below it, HTML."""
    return "\n".join([f"<h2>{html.escape(title)}</h2>", *parts])


def paragraph(text: str) -> str:
    """Plain text as a paragraph."""
    return f"<p>{html.escape(text)}</p>"


def items(texts: Sequence[str]) -> str:
    """Plain texts as a list."""
    return "<ul>" + "".join(f"<li>{html.escape(text)}</li>" for text in texts) + "</ul>"


def preformatted(text: str) -> str:
    """Plain text whose lines and spaces count, such as a file."""
    return f"<pre>{html.escape(text)}</pre>"


def picture(figure: Figure, description: str) -> str:
    """A figure as part of a page, sharp at any size.

    Args:
        description: plain text, for readers who cannot see the picture.
    """
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "limb"}):  # the same picture, the same bytes
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    data = base64.b64encode(buffer.getvalue()).decode()
    return (
        f'<figure><img alt="{html.escape(description)}" src="data:image/svg+xml;base64,{data}">'
        "</figure>"
    )


def table(header: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> str:
    """A table of plain text; what begins with a digit or a sign is set as a number.

    Args:
        header: a text for each column.
        rows: each with a text for each column.
        caption: below the table.
    """
    numeric = [
        bool(rows) and all(row[i].lstrip("-+±−")[:1].isdigit() for row in rows)
        for i in range(len(header))
    ]

    def line(cells: Sequence[str], tag: str) -> str:
        marked = (
            f"<{tag}{' class=number' * number}>{html.escape(cell).replace('± ', '±&nbsp;')}</{tag}>"
            for cell, number in zip(cells, numeric, strict=True)
        )
        return f"<tr>{''.join(marked)}</tr>"

    body = "\n".join([line(header, "th"), *(line(row, "td") for row in rows)])
    below = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f'<div class="table"><table>{below}{body}</table></div>'
