"""Draw panels as interactive charts by Bokeh, with zoom, values under the pointer, and legends.

Importing this module takes as long as importing Bokeh.
"""

import functools
from collections.abc import Sequence

import numpy as np
from bokeh.layouts import gridplot
from bokeh.models import (
    ColumnDataSource,
    CrosshairTool,
    DataRange1d,
    GlyphRenderer,
    HoverTool,
    Legend,
    LegendItem,
    Model,
    Range,
    Span,
)
from bokeh.plotting import figure

from limb_systems.views.colors import NEUTRAL_COLOR
from limb_systems.views.panels import Curve, Panel

MAX_POINTS = 2000  # of a curve; more than a screen has columns
LEFT_OF_AXIS = 62  # px, the same in all panels, so that their axes are aligned
# Entries that have no room on a phone go to the next line; the page defines the colours.
_LEGEND_STYLE = """
:host { width: 100%; }
.bk-grid { display: flex; flex-wrap: wrap; width: auto; column-gap: 14px; }
.bk-item { max-width: 100%; }
.bk-item .bk-label { color: var(--text); white-space: normal; }
.bk-item.bk-inactive { opacity: 0.4; }
"""


def chart(panels: Sequence[Panel]) -> Model:
    """Return panels one below the other, with one toolbar."""
    # Share the axis and the crosshair between panels over the same quantity.
    plots: list[figure] = []
    first: dict[str, figure] = {}
    crosses: dict[str, CrosshairTool] = {}
    for panel, below in zip(panels, [*panels[1:], None], strict=True):
        plot = draw(panel)
        plot.x_range = first.setdefault(panel.x_label, plot).x_range
        span = Span(dimension="height", line_color=NEUTRAL_COLOR, line_alpha=0.6)
        plot.add_tools(crosses.setdefault(panel.x_label, CrosshairTool(overlay=span)))
        if below is not None and below.x_label == panel.x_label:
            plot.xaxis.axis_label = None
        plots.append(plot)
    # Put them into one column.
    layout = gridplot(
        [[plot] for plot in plots],
        sizing_mode="stretch_width",
        toolbar_location="above",
        toolbar_options={"logo": None},
        merge_tools=True,
    )
    layout.spacing = 12
    return layout


def draw(
    panel: Panel, stream: ColumnDataSource | None = None, x_range: Range | None = None
) -> figure:
    """Return the plot of a panel.

    Args:
        stream: source of the curves that have a column and grow; the plot has no tools then.
        x_range: range of the horizontal axis; the range of the curves if None.
    """
    # Make the axes.
    plot = figure(
        height=panel.height,
        sizing_mode="stretch_width",
        x_range=x_range or DataRange1d(range_padding=0.0),
        y_range=panel.y_range or DataRange1d(),
        x_axis_label=panel.x_label,
        y_axis_label=panel.label,
        match_aspect=panel.equal,
        # No tool is active at first: a finger scrolls the page, not the plot.
        tools="xpan,box_zoom,xwheel_zoom,reset,save" if stream is None else "",
        toolbar_location="above" if stream is None else None,
        active_drag=None,
        active_scroll=None,
        min_border_left=LEFT_OF_AXIS,
        min_border_right=12,
        background_fill_color=None,
        border_fill_color=None,
        outline_line_color=None,
        output_backend="canvas",
    )
    # Draw the curves; curves with equal names share an entry of the legend.
    curves = [*panel.curves, *panel.limits]
    named: dict[str, Curve] = {}
    drawn: dict[str, list[GlyphRenderer]] = {}
    for curve in curves:
        named.setdefault(curve.name, curve)
        drawn.setdefault(curve.name, []).extend(_draw_curve(plot, curve, stream))
    named.pop("", None)
    # Show values under the pointer: of all curves at one x, or of one point.
    if stream is None:
        is_over_time = all(not curve.marks and (np.diff(curve.x) > 0).all() for curve in curves)
        plot.add_tools(
            HoverTool(
                renderers=[drawn[name][-1] for name in named],
                mode="vline" if is_over_time else "mouse",
                line_policy="nearest",
                tooltips=[
                    ("", "$name"),
                    (_label_name(panel.x_label), f"@x{{0.00}}{_label_unit(panel.x_label)}"),
                    (_label_name(panel.label), f"@y{{0.00}}{_label_unit(panel.label)}"),
                ],
            )
        )
    # Add the legend.
    plot.add_layout(
        Legend(
            items=[LegendItem(label={"value": name}, renderers=drawn[name]) for name in named],
            orientation="horizontal",
            click_policy="hide",
            background_fill_color=None,
            border_line_color=None,
            margin=0,
            padding=0,
            inactive_fill_color=None,
            glyph_height=14,
            label_text_font_size="12px",
            stylesheets=[_LEGEND_STYLE],
        ),
        "above",
    )
    # Set the axes' labels, ranges and ticks.
    for axis in plot.axis:
        axis.axis_label_text_font_style = "normal"
        axis.minor_tick_line_color = None
    if panel.from_zero:
        plot.y_range.start = 0.0
    for axis, ticks in ((plot.xaxis, panel.x_ticks), (plot.yaxis, panel.y_ticks)):
        if ticks is not None:
            axis.ticker = list(ticks)
            axis.major_label_overrides = dict(ticks)
    if panel.x_ticks is not None:
        plot.x_range.range_padding = 0.1
    return plot


def _draw_curve(plot: figure, curve: Curve, stream: ColumnDataSource | None) -> list[GlyphRenderer]:
    """Draw a curve, and its band if it has one; return the renderers."""
    style = {"color": curve.color, "alpha": curve.alpha, "name": curve.name}
    line = {"line_width": curve.width, "line_dash": curve.dash}
    draw_line = functools.partial(plot.step, mode="after") if curve.steps else plot.line
    if curve.column:
        return [draw_line("time", curve.column, source=stream, **line, **style)]
    # Choose the points of curve and band.
    columns = {"x": curve.x, "y": curve.y}
    if curve.band:
        columns["low"], columns["high"] = curve.band
    kept = _drawn_indices(np.asarray(curve.y))
    # Single precision is enough for any sensor, and halves the size of the page.
    style["source"] = ColumnDataSource(
        {name: np.asarray(column, np.float32)[kept] for name, column in columns.items()}
    )
    # Draw the band below the curve.
    drawn = []
    if curve.band:
        drawn.append(plot.varea("x", "low", "high", **(style | {"alpha": 0.2 * curve.alpha})))
    if curve.marks:
        drawn.append(plot.scatter("x", "y", size=4 * curve.width, **style))
    else:
        drawn.append(draw_line("x", "y", **line, **style))
    return drawn


def _drawn_indices(y: np.ndarray) -> np.ndarray:
    """Return the indices of the samples to draw: all, or the extremes of short stretches."""
    if len(y) <= MAX_POINTS:
        return np.arange(len(y))
    indices = []
    for stretch in np.array_split(np.arange(len(y)), MAX_POINTS // 2):
        indices += [stretch[np.argmin(y[stretch])], stretch[np.argmax(y[stretch])]]
    return np.unique(indices)


def _label_name(label: str) -> str:
    """Return an axis label without its unit."""
    return label.partition(" (")[0]


def _label_unit(label: str) -> str:
    """Return the unit in the brackets of an axis label, after a space if it takes a space."""
    unit = label.rpartition("(")[2].removesuffix(")") if label.endswith(")") else ""
    return unit if unit in ("", "°") else f" {unit}"
