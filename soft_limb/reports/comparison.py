"""A comparison as a page: what changed, how far runs are apart, and all of them in one chart."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from limb_systems.model.layout import Layout
from limb_systems.provenance import Provenance
from limb_systems.views.colors import PLAN_COLOR, REFERENCE_COLOR, ROLLOUT_COLOR, wire_colors
from limb_systems.views.panels import SIGNALS, Curve, Panel
from soft_limb.reports import page
from soft_limb.results.comparison import Comparison, Curves
from soft_limb.results.reading import TRAJECTORY, ResultFile

_COLORS = (PLAN_COLOR, ROLLOUT_COLOR, *wire_colors(6))
_DASHES = ("solid", "dashed", "dotted")  # of wires


def write_comparison(comparison: Comparison, path: str | Path) -> None:
    """Writes the page to an HTML file."""
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
    page.write_page(path, f"{names[0]} compared with {others}", parts, Provenance.now())


def _runs(comparison: Comparison) -> list[list[str]]:
    rows = []
    for name, result in zip(comparison.names, comparison.results, strict=True):
        made = result.provenance
        by = f"soft-limb {made.version} {made.commit}".strip() if made else "not known"
        rows.append([name, result.kind, by, made.time if made else ""])
    return rows


def _signals(comparison: Comparison) -> list[page.Section]:
    first = comparison.names[0]
    head, *rows = comparison.differences_table(comparison.differences, "|Δ{}|")
    parts = [page.table(head, rows, f"Absolute differences from {first} over their common time.")]
    if comparison.tracking:
        head, *rows = comparison.differences_table(comparison.tracking, "|{0}* − {0}|")
        parts.insert(0, page.table(head, rows, "Tracking errors of the recordings of the plan."))
        head, *rows = comparison.distances_table()
        caption = (
            "Mean distance from the reference of the plan: of what was recorded, of the plan, and "
            "of the best plan that the limits of the limb leave."
        )
        parts.insert(0, page.table(head, rows, caption))
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
    panels = []
    for segment, suffix in enumerate(Layout(parameters).segment_suffixes):
        wires = list(range(len(parameters.wires)))[Layout(parameters).wires_of[segment]]
        for signal, drawn in SIGNALS.items():
            rows = [segment] if signal == "bend_angle" else wires
            called = [""] if signal == "bend_angle" else [parameters.wire_names[w] for w in wires]
            values, differences = [], []
            if signal == "bend_angle":
                values += _references(results, segment)
            for number, curves in enumerate(comparison.curves):
                color = _COLORS[number % len(_COLORS)]
                for row, wire, dash in zip(rows, called, itertools.cycle(_DASHES), strict=False):
                    name = ", ".join(filter(None, [names[number], wire]))
                    run: Curves = curves[signal]
                    values.append(Curve(name, run.time, run.values[row], color, dash))
                    if number:
                        differences.append(
                            Curve(
                                name,
                                run.difference_time,
                                run.differences[row],
                                color,
                                dash,
                            )
                        )
            panels.append(drawn.panel(values, suffix, y_range=None))
            unit = f" ({drawn.unit})" * bool(drawn.unit)
            panels.append(Panel(f"Δ{drawn.symbol}{unit}", differences, height=170))
    return panels


def _references(results: Sequence[ResultFile], segment: int) -> list[Curve]:
    """What the plans are for; one that several share is drawn once."""
    drawn: list[Curve] = []
    for result in results:
        if result.kind == TRAJECTORY:
            plan = result.value.since_start()
            angle = np.rad2deg(plan.reference[segment])
            if not any(np.array_equal(curve.y, angle) for curve in drawn):
                drawn.append(Curve("reference φ_REF", plan.time, angle, REFERENCE_COLOR))
    return drawn
