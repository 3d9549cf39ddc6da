"""Pictures of panels, by Matplotlib, and the style of all pictures."""

import io
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes

from limb_systems.files.output import check_picture, write_atomically
from limb_systems.files.recording import Recording
from limb_systems.files.signal_table import Planned
from limb_systems.files.trajectory import Trajectory
from limb_systems.views.panels import (
    Curve,
    Panel,
    motion_panels,
    tracking_panels,
)

WIDTH = 6.4  # inches; text of 9 pt can still be read where a phone shows it
PIXELS_PER_INCH = 125  # of a panel's height
POINTS_PER_PIXEL = 0.8  # of a line's width
MOST_LEGEND_COLUMNS = 3


class Figure(matplotlib.figure.Figure):
    """A figure that notebooks display although it was not made with pyplot."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()


def plot_tracking(
    trajectory: Trajectory, recordings: Sequence[Recording] = (), title: str = ""
) -> Figure:
    """Return Fig. 5 as a picture; see `limb_systems.views.panels.tracking_panels`."""
    return draw(tracking_panels(trajectory, recordings), title)


def plot_motion(motion: Recording | Planned) -> Figure:
    """Return a recording or a gait as a picture; see `limb_systems.views.panels.motion_panels`."""
    return draw(motion_panels(motion))


def draw(panels: Sequence[Panel], title: str = "") -> Figure:
    """Draw a picture of panels, one below the other."""
    heights = [panel.height for panel in panels]
    figure = Figure(figsize=(WIDTH, sum(heights) / PIXELS_PER_INCH), layout="constrained")
    axes = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
    shared_axes: dict[str, Axes] = {}
    for axis, panel, panel_below in zip(axes, panels, [*panels[1:], None], strict=True):
        draw_panel(axis, panel)
        # Panels with the same horizontal label share the range; the lowest has the label.
        shared_axis = shared_axes.setdefault(panel.x_label, axis)
        if shared_axis is not axis:
            axis.sharex(shared_axis)
        if panel_below is not None and panel_below.x_label == panel.x_label:
            axis.tick_params(labelbottom=False)
        else:
            axis.set_xlabel(panel.x_label)
        apply_axis_style(axis)
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def apply_axis_style(axis: Axes) -> None:
    """Apply the common style to a panel: a light grid, and the legend above it."""
    axis.grid(alpha=0.25)
    axis.spines[["top", "right"]].set_visible(False)
    num_entries = len(axis.get_legend_handles_labels()[1])
    if not num_entries:
        return
    num_columns = num_entries
    if num_entries > MOST_LEGEND_COLUMNS:
        num_columns = min(MOST_LEGEND_COLUMNS, (num_entries + 1) // 2)
    axis.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=num_columns,
        frameon=False,
        fontsize=8.5,
        borderaxespad=0.2,
        columnspacing=1.5,
    )


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure to a file, in the format that its name ends with.

    The file is written whole or not at all. Fonts are embedded in .pdf and .eps.

    Raises:
        OutputError: if there is no such format, or the file cannot be written.
    """
    path = Path(path)
    check_picture(path)
    # Embed fonts as TrueType, which journals ask for.
    picture = io.BytesIO()
    with matplotlib.rc_context({"pdf.fonttype": 42, "ps.fonttype": 42}):
        figure.savefig(picture, format=path.suffix[1:].lower(), dpi=150)
    write_atomically(path, picture.getvalue())


def draw_panel(axis: Axes, panel: Panel) -> None:
    """Draw a panel's curves and limits; `apply_axis_style` adds the legend."""
    labelled_names: set[str] = set()
    for curve in [*panel.curves, *panel.limits]:
        is_limit = any(curve is limit for limit in panel.limits)
        has_label = not is_limit and curve.name not in labelled_names
        if has_label:
            labelled_names.add(curve.name)
        _draw_curve(axis, curve, has_label)
    # Write the names of the limits beside their lines, between the lines as the curves are.
    highest = max((limit.y[0] for limit in panel.limits), default=0.0)
    for limit in panel.limits:
        offset = (3, -12 if limit.y[0] == highest else 4)  # pt
        place = (panel.limits[0].x[0], limit.y[0])
        axis.annotate(_typeset(limit.name), place, offset, textcoords="offset points")
    # Set the label, the ranges and the ticks.
    axis.set_ylabel(_typeset(textwrap.fill(panel.label, panel.height // 12)))
    if panel.y_range:
        axis.set_ylim(panel.y_range)
    if panel.from_zero:
        axis.set_ylim(bottom=0.0)
    if panel.equal:
        axis.set_aspect("equal", adjustable="datalim")
    elif panel.x_ticks is None:
        axis.margins(x=0.0)
    else:
        axis.set_xticks(list(panel.x_ticks), list(panel.x_ticks.values()))
    if panel.y_ticks is not None:
        axis.set_yticks(list(panel.y_ticks), list(panel.y_ticks.values()))


def _draw_curve(axis: Axes, curve: Curve, has_label: bool) -> None:
    """Draw a curve and its band."""
    x = np.asarray(curve.x)
    y = np.asarray(curve.y)
    style: dict[str, Any] = {
        "color": curve.color,
        "alpha": curve.alpha,
        "linewidth": POINTS_PER_PIXEL * curve.width,
    }
    if has_label:
        style["label"] = _typeset(curve.name)
    # Draw dots or a line.
    if curve.marks:
        axis.plot(x, y, "o", markersize=2.5 * curve.width, **style)
    else:
        drawstyle = "steps-post" if curve.steps else "default"
        style["solid_capstyle"] = "butt"  # wide lines are bars
        axis.plot(x, y, linestyle=curve.dash, drawstyle=drawstyle, **style)
    if curve.band:
        axis.fill_between(x, *curve.band, color=curve.color, alpha=0.2 * curve.alpha, lw=0)


def _typeset(text: str) -> str:
    """Return a label with its symbols as formulas."""

    def formula(match: re.Match) -> str:
        star, index = match.groups()
        return rf"$\varphi{'^*' * bool(star)}{f'_{{{index}}}' * bool(index)}$"

    text = re.sub(r"φ(\*?)(?:_(\w+))?", formula, text)
    return re.sub(r"\bT_(\w+)", r"$T_{\1}$", text)
