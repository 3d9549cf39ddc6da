"""A comparison as a page: what changed, how far runs are apart, and all of them in one chart."""

import itertools
from collections.abc import Sequence

import numpy as np

from limb_systems.model.layout import Layout
from limb_systems.provenance import Provenance
from limb_systems.views.colors import PLAN_COLOR, REFERENCE_COLOR, ROLLOUT_COLOR, wire_colors
from limb_systems.views.panels import SIGNALS, Curve, Panel
from soft_limb.reports import page
from soft_limb.results.comparison import Comparison
from soft_limb.results.reading import TRAJECTORY, ResultFile

_COLORS = (PLAN_COLOR, ROLLOUT_COLOR, *wire_colors(6))
_STYLES = tuple(  # of wires
    (dash, width) for width in (1.5, 3.0) for dash in ("solid", "dashed", "dotted", "dashdot")
)


def comparison_page(comparison: Comparison) -> str:
    """Return the page, HTML."""
    names = comparison.names
    parts: list[page.Part] = [
        page.section("Runs", page.table(["", "kind", "made by", "at"], _runs(comparison)))
    ]
    if comparison.curves:
        parts += _signals(comparison)
    head, *rows = comparison.changes_table()
    caption = f"In brackets the difference from {names[0]}, over its size."
    changed = page.table(head, rows, caption) if rows else page.paragraph("Nothing changed.")
    parts.append(page.section("What changed", changed))
    others = names[1] if len(names) == 2 else f"{len(names) - 1} others"
    return page.make_page(f"{names[0]} compared with {others}", parts, Provenance.now())


def _runs(comparison: Comparison) -> list[list[str]]:
    rows = []
    for name, result in zip(comparison.names, comparison.results, strict=True):
        made = result.provenance
        by = f"soft-limb {made.version} {made.commit}".strip() if made else "not known"
        rows.append([name, result.kind, by, made.time if made else ""])
    return rows


def _signals(comparison: Comparison) -> list[page.Section]:
    first = comparison.names[0]
    parts = [
        page.table(head, rows, f"{title[0].upper()}{title[1:]}.")
        for title, (head, *rows) in comparison.tables().items()
    ]
    chart = page.chart(_panels(comparison), f"All runs, and what differs from {first}")
    return [
        page.section("How far apart they are", *parts),
        page.section(
            "All runs",
            page.paragraph(f"Below each signal is its difference (Δ) from that of {first}."),
            chart,
        ),
    ]


def _panels(comparison: Comparison) -> list[Panel]:
    results, names = comparison.results, comparison.names
    parameters = results[0].value.parameters
    panels, layout = [], Layout(parameters)
    drawn: list[tuple[str, list[int], str]] = []  # in each panel: a signal's rows, and where
    for bends, wires, suffix in zip(
        layout.bends_of, layout.wires_of, layout.segment_suffixes, strict=True
    ):
        for bend in range(bends.start, bends.stop):
            drawn.append(("bend_angle", [bend], layout.bend_suffixes[bend]))
        wired = list(range(wires.start, wires.stop))
        drawn += [("measured_temperature", wired, suffix), ("duty", wired, suffix)]
    for signal, rows, suffix in drawn:
        bends_alone = signal == "bend_angle"
        values, differences = _references(results, rows[0]) if bends_alone else [], []
        for number, curves in enumerate(comparison.curves):
            color, run = _COLORS[number % len(_COLORS)], curves[signal]
            for row, style in zip(rows, itertools.cycle(_STYLES), strict=False):
                wire = "" if bends_alone else parameters.wire_names[row]
                name = ", ".join(filter(None, [names[number], wire]))
                values.append(Curve(name, run.time, run.values[row], color, *style))
                if number:
                    apart = run.difference_time, run.differences[row]
                    differences.append(Curve(name, *apart, color, *style))
        kind = SIGNALS[signal]
        panels.append(kind.panel(values, suffix, y_range=None))
        unit = f" ({kind.unit})" * bool(kind.unit)
        panels.append(Panel(f"Δ{kind.symbol}{unit}", differences, height=170))
    return panels


def _references(results: Sequence[ResultFile], bend: int) -> list[Curve]:
    """What the plans are for; one that several share is drawn once."""
    drawn: list[Curve] = []
    for result in results:
        if result.kind == TRAJECTORY:
            plan = result.value.since_start()
            angle = np.rad2deg(plan.reference[bend])
            if not any(np.array_equal(curve.y, angle) for curve in drawn):
                drawn.append(Curve("reference φ_REF", plan.time, angle, REFERENCE_COLOR))
    return drawn
