"""Charts that one can look into: zoom, values under the pointer, curves that can be hidden.

Importing this takes as long as Bokeh does; what makes no page does without.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

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
    Span,
)
from bokeh.plotting import figure

from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory
from limb_systems.views.colors import (
    LEFT_RIGHT_COLORS,
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from limb_systems.views.rollouts import how_recorded, mean_and_band

NEUTRAL_COLOR = "#808080"  # on white and on black
MAX_POINTS = 2000  # of a curve; more than a screen has columns
DUTY_RANGE = (-0.04, 1.04)
LEFT_OF_AXIS = 62  # px, for the same numbers of digits in panels that stand on each other
# Where a phone has no room for an entry, it goes to the next line; colours are those of the page.
_LEGEND_STYLE = """
:host { width: 100%; }
.bk-grid { display: flex; flex-wrap: wrap; width: auto; column-gap: 14px; }
.bk-item { max-width: 100%; }
.bk-item .bk-label { color: var(--text); white-space: normal; }
.bk-item.bk-inactive { opacity: 0.4; }
"""


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """A curve of a panel.

    - ``name``: in the legend, where a click hides it, and under the pointer, where of
      curves with one name the first is shown; without a name it is in neither.
    - ``x``, ``y``: (K,), in the units of the panel's labels.
    - ``color``: that can be told on white and on black.
    - ``dash``: "solid", "dashed" or "dotted".
    - ``width``: px.
    - ``band``: half-width of a band about y (K,), or its lower and upper edge; None for none.
    - ``marks``: whether the samples are dots that no line joins; the band is then a bar at each.
    - ``alpha``: opacity.
    """

    name: str
    x: np.ndarray
    y: np.ndarray
    color: str
    dash: str = "solid"
    width: float = 1.5
    band: np.ndarray | tuple[np.ndarray, np.ndarray] | None = None
    marks: bool = False
    alpha: float = 1.0


def panel(
    label: str,
    curves: Sequence[Curve],
    *,
    height: int = 230,
    x_label: str = "time (s)",
    y_range: tuple[float, float] | None = None,
    from_zero: bool = False,
    x_ticks: Mapping[int, str] | None = None,
) -> figure:
    """A panel with curves, which are drawn in their order.

    Args:
        label: of the vertical axis, with its unit in brackets.
        curves: any number.
        height: px, with the legend.
        x_label: of the horizontal axis, with its unit in brackets.
        y_range: of the vertical axis; that of the curves if None.
        from_zero: whether the vertical axis begins at zero.
        x_ticks: what stands below the horizontal axis, and where; numbers if None.
    """
    plot = figure(
        height=height,
        sizing_mode="stretch_width",
        x_range=DataRange1d(range_padding=0.0),
        y_range=y_range or DataRange1d(),
        x_axis_label=x_label,
        y_axis_label=label,
        # Nothing is active at first: a finger scrolls the page, and not the plot.
        tools="xpan,box_zoom,xwheel_zoom,reset,save",
        active_drag=None,
        active_scroll=None,
        min_border_left=LEFT_OF_AXIS,
        min_border_right=12,
        background_fill_color=None,
        border_fill_color=None,
        outline_line_color=None,
        output_backend="canvas",
    )
    named: dict[str, Curve] = {}
    drawn: dict[str, list[GlyphRenderer]] = {}
    for curve in curves:
        named.setdefault(curve.name, curve)
        drawn.setdefault(curve.name, []).extend(_draw(plot, curve))
    named.pop("", None)
    plot.add_tools(
        HoverTool(
            renderers=[drawn[name][-1] for name in named],
            tooltips=[("", "$name"), (label.partition(" (")[0], f"@y{{0.00}}{_unit(label)}")],
        )
        if not named or any(curve.marks or not _increasing(curve.x) for curve in curves)
        else _hover_at_x(plot, list(named.values()), label, x_label)
    )
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
    for axis in plot.axis:
        axis.axis_label_text_font_style = "normal"
        axis.minor_tick_line_color = None
    if from_zero:
        plot.y_range.start = 0.0
    if x_ticks is not None:
        plot.xaxis.ticker = list(x_ticks)
        plot.xaxis.major_label_overrides = dict(x_ticks)
        plot.x_range.range_padding = 0.1
    return plot


def stacked(panels: Sequence[figure]) -> Model:
    """Panels one below the other: they share x range and toolbar, and the last has the x label."""
    first, *others = panels
    cross = CrosshairTool(
        overlay=Span(dimension="height", line_color=NEUTRAL_COLOR, line_alpha=0.6)
    )
    first.add_tools(cross)
    for other in others:
        other.x_range = first.x_range
        other.add_tools(cross)
    for upper in panels[:-1]:
        upper.xaxis.axis_label = None
    layout = gridplot(
        [[plot] for plot in panels],
        sizing_mode="stretch_width",
        toolbar_location="above",
        toolbar_options={"logo": None},
        merge_tools=True,
    )
    layout.spacing = 12
    return layout


def tracking_chart(trajectory: Trajectory, recordings: Sequence[Recording] = ()) -> Model:
    """Fig. 5, `plots.plot_tracking`: bend angle, temperatures and duty of a plan and its rollouts.

    Time counts from the start of the plan. Plans are dashed; the legend says whether
    the rollouts were simulated, emulated or recorded. Several recordings are drawn as
    their mean and the band of 95%. Each segment has its own three panels.

    Args:
        trajectory: the plan.
        recordings: of rollouts of this plan, all with the same sample rate.
    """
    trajectory = trajectory.since_start()
    panels = []
    for segment, suffix in enumerate(trajectory.parameters.segment_suffixes):
        names = [wire.name for wire in trajectory.parameters.segments[segment].wires]
        first = trajectory.parameters.wire_slices[segment].start
        wires = list(zip(itertools.count(first), names, wire_colors(len(names)), strict=False))
        panels += [
            panel(_bend_label(suffix), _bend_angles(trajectory, recordings, segment), height=280),
            panel("temperature (°C)", _temperatures(trajectory, recordings, wires), height=280),
            panel("duty", _duties(trajectory, recordings, wires), height=210, y_range=DUTY_RANGE),
        ]
    return stacked(panels)


def repetitions_chart(
    trajectory: Trajectory, errors: Sequence[float], first: Recording, last: Recording
) -> tuple[Model, Model]:
    """How the error fell over repetitions of a plan, and the bend in the first and the last.

    Args:
        trajectory: the plan.
        errors: mean of |φ* - φ| in each repetition, as it was read, rad.
        first, last: recordings of repetitions.
    """
    trajectory = trajectory.since_start()
    numbers = np.arange(1, len(errors) + 1)
    degrees = np.rad2deg(errors)
    fell = panel(
        "mean |φ* − φ| (°)",
        [
            Curve("", numbers, degrees, ROLLOUT_COLOR),
            Curve("mean error, as read", numbers, degrees, ROLLOUT_COLOR, width=2.0, marks=True),
        ],
        x_label="repetition",
        from_zero=True,
        x_ticks={int(number): str(number) for number in numbers},
    )
    panels = []
    for segment, suffix in enumerate(trajectory.parameters.segment_suffixes):
        planned = np.rad2deg(trajectory.bend_angle[segment])
        curves = [
            Curve(name, recording.time, np.rad2deg(recording.bend_angle[segment]), color)
            for recording, color, name in (
                (first, LEFT_RIGHT_COLORS[1], "first repetition"),
                (last, ROLLOUT_COLOR, "last repetition"),
            )
        ]
        curves.append(Curve("plan φ*", trajectory.time, planned, PLAN_COLOR, "dashed"))
        panels.append(panel(_bend_label(suffix), curves, height=280))
    return stacked([fell]), stacked(panels)


def _bend_label(suffix: str) -> str:
    return f"bend angle{suffix.replace('_', ' of segment ')} (°)"


def _bend_angles(trajectory, recordings, segment: int) -> list[Curve]:
    time, what = trajectory.time, how_recorded(recordings)
    what += " rollouts" if len(recordings) > 1 else ""
    angles = [np.rad2deg(recording.bend_angle[segment]) for recording in recordings]
    reference = np.rad2deg(trajectory.reference[segment])
    plan = np.rad2deg(trajectory.bend_angle[segment])
    return [
        Curve("reference φ_REF", time, reference, REFERENCE_COLOR),
        *_rollouts(f"{what} φ", recordings, angles, ROLLOUT_COLOR),
        Curve("plan φ*", time, plan, PLAN_COLOR, "dashed"),
    ]


def _temperatures(trajectory, recordings, wires) -> list[Curve]:
    time, what, curves = trajectory.time, how_recorded(recordings), []
    for index, name, color in wires:
        measured = [recording.measured_temperature[index] for recording in recordings]
        curves += _rollouts(f"{name}, V {what}", recordings, measured, color)
    for index, name, color in wires:
        planned = trajectory.measured_temperature[index]
        curves.append(Curve(f"{name}, V* planned", time, planned, color, "dashed"))
    for index, name, color in wires:
        planned = trajectory.wire_temperature[index]
        curves.append(Curve(f"{name}, T* planned", time, planned, color, "dotted", 1.3))
    limits = trajectory.parameters.temperature_limits
    for name, limit, start in (
        ("T_max", limits.maximum, time[0]),
        ("T_warm", limits.warm, limits.warm_up_time),
    ):
        if start < time[-1]:
            span = np.array([start, time[-1]])
            curves.append(Curve(name, span, np.full(2, limit), NEUTRAL_COLOR, width=1.0))
    return curves


def _duties(trajectory, recordings, wires) -> list[Curve]:
    curves, dash = [], "dashed" if recordings else "solid"
    for index, name, color in wires:
        duty = [recording.duty[index] for recording in recordings]
        curves += _rollouts(f"{name}, D", recordings, duty, color)
    for index, name, color in wires:
        planned = trajectory.duty[index]
        curves.append(Curve(f"{name}, D* planned", trajectory.time, planned, color, dash))
    return curves


def _rollouts(name: str, recordings, samples, color: str) -> list[Curve]:
    if not recordings:
        return []
    time, mean, half = mean_and_band(recordings, samples)
    return [Curve(name, time, mean, color, band=half if len(recordings) > 1 else None)]


def _draw(plot: figure, curve: Curve) -> list[GlyphRenderer]:
    """The band of a curve, if it has one, and the curve."""
    columns = {"x": curve.x, "y": curve.y}
    if isinstance(curve.band, tuple):
        columns["low"], columns["high"] = curve.band
    elif curve.band is not None:
        columns["low"], columns["high"] = curve.y - curve.band, curve.y + curve.band
    kept = _kept(np.asarray(curve.y))
    # Seven digits are more than any sensor has, in half the bytes.
    source = ColumnDataSource(
        {name: np.asarray(column, np.float32)[kept] for name, column in columns.items()}
    )
    style = {"source": source, "color": curve.color, "alpha": curve.alpha, "name": curve.name}
    drawn = []
    if curve.band is not None and curve.marks:
        drawn.append(plot.segment("x", "low", "x", "high", line_width=1.5, **style))
    elif curve.band is not None:
        drawn.append(plot.varea("x", "low", "high", **(style | {"alpha": 0.2 * curve.alpha})))
    if curve.marks:
        drawn.append(plot.scatter("x", "y", size=4 * curve.width, **style))
    else:
        drawn.append(plot.line("x", "y", line_width=curve.width, line_dash=curve.dash, **style))
    return drawn


def _increasing(x: np.ndarray) -> bool:
    return len(x) > 0 and bool((np.diff(x) > 0).all())


def _hover_at_x(plot: figure, curves: Sequence[Curve], label: str, x_label: str) -> HoverTool:
    """Shows the values of all curves at the pointer's x."""
    longest = max((curve.x for curve in curves), key=len)
    x = np.asarray(longest)[_kept(np.asarray(longest))]
    columns = {"x": x, "y": np.interp(x, curves[0].x, curves[0].y)}
    for number, curve in enumerate(curves):
        columns[f"y{number}"] = np.interp(x, curve.x, curve.y, left=np.nan, right=np.nan)
    source = ColumnDataSource({name: np.float32(column) for name, column in columns.items()})
    return HoverTool(
        renderers=[plot.line("x", "y", source=source, line_alpha=0.0)],
        mode="vline",
        line_policy="nearest",
        attachment="horizontal",
        tooltips=[
            (x_label.partition(" (")[0], f"@x{{0.00}}{_unit(x_label)}"),
            *(
                (curve.name, f"@y{number}{{0.00}}{_unit(label)}")
                for number, curve in enumerate(curves)
            ),
        ],
    )


def _kept(y: np.ndarray) -> np.ndarray:
    """Indices of the samples that are drawn: all, or of many the extremes of short stretches."""
    if len(y) <= MAX_POINTS:
        return np.arange(len(y))
    stretches = np.array_split(np.arange(len(y)), MAX_POINTS // 2)
    return np.unique(
        [[stretch[np.argmin(y[stretch])], stretch[np.argmax(y[stretch])]] for stretch in stretches]
    )


def _unit(label: str) -> str:
    """The unit in the brackets of an axis' label, with a space before it if it takes one."""
    unit = label.rpartition("(")[2].removesuffix(")") if label.endswith(")") else ""
    return unit if unit in ("", "°") else f" {unit}"
