"""What a browser shows of a run: Bokeh's document, one for each that looks."""

import html
import itertools
import time
from collections.abc import Callable, Sequence

import numpy as np
from bokeh.document import Document
from bokeh.events import ButtonClick, ClientReconnected
from bokeh.layouts import column
from bokeh.models import (
    Button,
    ColumnDataSource,
    CustomJS,
    DataRange1d,
    Div,
    InlineStyleSheet,
    Range1d,
)
from bokeh.plotting import figure
from jinja2 import Template

from hardware.live.messages import BoardReading, Reading, RunHeader
from hardware.robot.serial_limb import DEADLINE
from limb_systems.views.colors import (
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from soft_limb.live.run import MOST_POINTS, Run

PERIOD = 200  # ms, of what browsers are told
SILENCE = 1.0  # s, after which a limb that runs is missed
WINDOW = 60.0  # s, that are shown of what has no end
LIMIT_COLOR, WARM_COLOR = "#c62828", "#b08900"
DASHES = ("solid", "dashed", "dotted", "dotdash")  # of segments

STYLE = """
:host, .bk-clearfix { width: 100%; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
td { text-align: right; padding: .15rem .5rem; border-bottom: 1px solid var(--line); }
td:first-child { text-align: left; padding-left: 0; }
tr:first-child { font-weight: bold; }
p { margin: .6rem 0; }
b.big { font-size: 1.35rem; line-height: 1.25; display: block; }
b.armed { color: var(--hot); } b.bad { color: var(--bad); } b.off { color: var(--good); }
span.key { white-space: nowrap; margin-right: .8rem; }
i {
  display: inline-block; width: 1.1em; height: .5em; border-radius: 2px; margin-right: .3em;
  filter: var(--figures);
}
"""

TEMPLATE = Template("""
{% from macros import embed %}
{% extends base %}
{% block postamble %}
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
  :root {
    color-scheme: light dark; --back: #fff; --text: #222; --line: #d8dbe0;
    --hot: #b34700; --bad: #c62828; --good: #1b6e3c;
  }
  body { background: var(--back); color: var(--text); font: 15px/1.4 system-ui, sans-serif; }
  header {
    position: sticky; top: 0; z-index: 10; display: flex; gap: 1rem; align-items: center;
    padding: .6rem 1rem; background: var(--back); border-bottom: 1px solid var(--line);
  }
  header > div:first-child { flex: 1; min-width: 0; }
  #silent { display: none; color: #fff; background: #c62828; padding: .5rem 1rem; }
  #silent.shown { display: block; }
  main {
    display: grid; grid-template-columns: minmax(0, 3fr) minmax(0, 2fr); gap: 0 1.5rem;
    padding: .5rem 1rem 1rem;
  }
  iframe {
    width: 100%; aspect-ratio: 4 / 3; border: 1px solid var(--line); box-sizing: border-box;
  }
  @media (max-width: 760px) {
    main { grid-template-columns: minmax(0, 1fr); padding: .3rem .6rem 1rem; }
    main > div { display: contents; }
    #facts { order: -1; }
    header { padding: .5rem .6rem; }
  }
  @media (prefers-color-scheme: dark) {
    :root {
      --back: #16181d; --text: #e4e6ea; --line: #3a3e46;
      --hot: #ff9d4d; --bad: #ff7b72; --good: #6cc28a;
    }
    #curves { --figures: invert(.91) hue-rotate(180deg); }
  }
</style>
{% endblock %}
{% block contents %}
<header>
  <div>{{ embed(roots.state) }}</div><div>{{ embed(roots.stop) }}</div>{{ embed(roots.pulse) }}
</header>
<div id="silent">
  Nothing comes from the page's own program. The limb goes on without it: to stop it, press Ctrl-C
  where it was started.
</div>
<main>
  <div id="curves">{{ embed(roots.curves) }}</div>
  <div>
    <iframe src="view/" title="the limb in 3D"></iframe>
    <div id="facts">{{ embed(roots.facts) }}</div>
  </div>
</main>
<script>
  // Says so when the pulse stops, whether the connection or the page's program is the cause.
  let last = null, since = Date.now();
  setInterval(() => {
    const pulse = Bokeh.documents[0]?.get_model_by_name("pulse");
    const [count, ended] = pulse ? pulse.tags : [null, false];
    if (count !== last) [last, since] = [count, Date.now()];
    const silent = !ended && Date.now() - since > 3000;
    document.querySelector("#silent").classList.toggle("shown", silent);
  }, 500);
</script>
{% endblock %}
""")


class LiveDocument:
    """Keeps a browser's document up to date with a `Run`."""

    def __init__(self, document: Document, run: Run, stop: Callable[[], None]):
        """
        Args:
            document: of a browser that has just come.
            run: what is known.
            stop: is called when the button is pressed.
        """
        self._run, self._stop = run, stop
        self._number = self._sent = 0
        style = InlineStyleSheet(css=STYLE)
        self._state, self._facts = (
            Div(name=name, sizing_mode="stretch_width", margin=0, stylesheets=[style])
            for name in ("state", "facts")
        )
        big = InlineStyleSheet(css=".bk-btn { font-size: 1.3rem; padding: .6rem 1.3rem; }")
        self._button = Button(name="stop", label="STOP", button_type="danger", stylesheets=[big])
        self._button.on_event(ButtonClick, lambda _: self._press())
        self._curves = column(name="curves", sizing_mode="stretch_width")
        self._source = ColumnDataSource(name="readings")
        self._pulse = Div(name="pulse", visible=False, tags=[0, False])
        self._look()
        for root in (self._state, self._button, self._curves, self._facts, self._pulse):
            document.add_root(root)
        # Another run may be served at the same address, whose document is another.
        document.js_on_event(ClientReconnected, CustomJS(code="window.location.reload()"))
        document.title = "Soft limb, live"
        document.template = TEMPLATE
        document.add_periodic_callback(self._look, PERIOD)

    def _press(self) -> None:
        self._stop()
        self._button.label = "STOP again"

    def _look(self) -> None:
        """Tells the browser what is new."""
        run = self._run
        phase = run.phase
        if phase is not None and run.number != self._number:
            self._number, self._sent = run.number, 0
            self._source = ColumnDataSource(_columns(phase, []), name="readings")
            self._curves.children = figures(phase, self._source)
        if phase is not None and run.count > self._sent:
            new = min(run.count - self._sent, len(run.readings))
            fresh = itertools.islice(run.readings, len(run.readings) - new, None)
            self._source.stream(_columns(phase, list(fresh)), MOST_POINTS)
            self._sent = run.count
        self._state.text = state(run)
        if phase is not None:
            self._facts.text = facts(run, phase, run.reading)
        self._button.disabled = bool(run.ended)
        self._pulse.tags = [self._pulse.tags[0] + 1, bool(run.ended)]


def _columns(phase: RunHeader, readings: Sequence[Reading]) -> dict[str, list[float]]:
    """The columns of the curves: angles in degrees, numbered by segment or wire."""
    num_segments, num_wires = len(phase.parameters.segments), len(phase.parameters.wires)
    nan = float("nan")
    columns = {"time": [reading.time for reading in readings]}
    for name, size, scale in (
        ("bend_angle", num_segments, 180.0 / np.pi),
        ("reference", num_segments, 180.0 / np.pi),
        ("measured_temperature", num_wires, 1.0),
        ("duty", num_wires, 1.0),
        ("applied_duty", num_wires, 1.0),
    ):
        for i in range(size):
            columns[f"{name}_{i}"] = [
                nan if (values := getattr(reading, name)) is None else scale * values[i]
                for reading in readings
            ]
    return columns


def figures(phase: RunHeader, source: ColumnDataSource) -> list:
    """The curves of a phase, each below what its colours mean."""
    parameters, plan, band = phase.parameters, phase.plan, phase.band
    time_range = (
        Range1d(start=0.0, end=phase.duration)
        if phase.duration
        else DataRange1d(follow="end", follow_interval=WINDOW, range_padding=0)
    )
    names = [name.replace("_", " ") for name in parameters.wire_names]
    colors = wire_colors(len(names))
    ends = [0.0, phase.duration or 1e6]

    def make(unit: str, **options) -> figure:
        picture = figure(
            height=210,
            sizing_mode="stretch_width",
            x_range=time_range,
            tools="",
            toolbar_location=None,
            stylesheets=[InlineStyleSheet(css=":host { filter: var(--figures); }")],
            **options,
        )
        picture.axis.axis_label_text_font_style = "normal"
        picture.yaxis.axis_label, picture.xgrid.visible = unit, False
        picture.outline_line_color = None
        picture.background_fill_color = picture.border_fill_color = None
        return picture

    bend = make("bend angle φ (°)")
    keys = [("measured", ROLLOUT_COLOR)]
    if plan is not None:
        if band is not None:
            middle = np.rad2deg(np.interp(band.time, plan.time, plan.bend_angle[0]))
            width = np.rad2deg(band.bend_reading)
            bend.varea(band.time, middle - width, middle + width, color=PLAN_COLOR, alpha=0.12)
            keys.append(("what 95% of limbs like this read", f"{PLAN_COLOR}30"))
        for row, planned, dash in zip(plan.reference, plan.bend_angle, DASHES, strict=False):
            bend.line(
                plan.time, np.rad2deg(row), color=REFERENCE_COLOR, line_width=2, line_dash=dash
            )
            bend.line(
                plan.time, np.rad2deg(planned), color=PLAN_COLOR, line_width=2, line_dash=dash
            )
        keys += [("plan", PLAN_COLOR), ("reference", REFERENCE_COLOR)]
    for i, dash in zip(range(len(parameters.segments)), DASHES, strict=False):
        bend.line("time", f"reference_{i}", source=source, color=REFERENCE_COLOR, line_dash=dash)
        bend.line(
            "time",
            f"bend_angle_{i}",
            source=source,
            color=ROLLOUT_COLOR,
            line_width=2,
            line_dash=dash,
        )

    heat = make("readings V (°C)")
    heat_keys = list(zip(names, colors, strict=True))
    for i, color in enumerate(colors):
        if plan is not None:
            planned = plan.measured_temperature[i]
            heat.line(plan.time, planned, color=color, line_width=1.5, line_dash="dashed")
            if band is not None:
                low = np.interp(band.time, plan.time, planned)
                high = low + band.measured_temperature[i]
                heat.varea(band.time, low, high, color=color, alpha=0.12)
        heat.line("time", f"measured_temperature_{i}", source=source, color=color, line_width=2)
    maximum = parameters.temperature_limits.maximum
    heat.line(ends, [maximum] * 2, color=WARM_COLOR, line_dash="dotted", line_width=2)
    heat.line(ends, [phase.limit] * 2, color=LIMIT_COLOR, line_width=2)
    heat_keys += [
        (f"T_max {maximum:g} °C", WARM_COLOR),
        (f"off at {phase.limit:g} °C", LIMIT_COLOR),
    ]

    duty = make("duty", y_range=Range1d(start=-0.02, end=1.02))
    for i, color in enumerate(colors):
        for name, width, alpha in (("applied_duty", 5.0, 0.3), ("duty", 1.5, 1.0)):
            duty.step(
                "time",
                f"{name}_{i}",
                source=source,
                color=color,
                line_width=width,
                alpha=alpha,
                mode="after",
            )
    duty.xaxis.axis_label = "time (s)"
    dashed = "; dashed: the plan" if plan is not None else ""
    dashed += ", shaded: above it in 995 of 1000 limbs" if band is not None else ""
    return [
        _key(keys),
        bend,
        _key(heat_keys, dashed),
        heat,
        _key(zip(names, colors, strict=True), "; thin: asked for, wide: applied"),
        duty,
    ]


def _key(entries, more: str = "") -> Div:
    marks = "".join(
        f'<span class="key"><i style="background: {color}"></i>{html.escape(name)}</span>'
        for name, color in entries
    )
    return Div(
        text=marks + html.escape(more.lstrip("; ,")),
        sizing_mode="stretch_width",
        stylesheets=[InlineStyleSheet(css=STYLE)],
    )


def state(run: Run) -> str:
    """The line on top, HTML: whether wires may be heated, or how it ended, and what runs."""
    silence = time.monotonic() - run.heard
    board = run.reading.board if run.reading is not None else None
    if run.ended:
        kind, what = "off" if run.ended == "done" else "bad", f"Ended: {run.ended}"
    elif not run.is_running:
        kind, what = "off", "No limb runs"
    elif silence > SILENCE:
        kind, what = "bad", f"Nothing was heard of the limb for {silence:.0f} s"
    elif board is None:
        kind, what = "armed", "Running"
    elif board.armed:
        kind, what = "armed", "Armed: wires may be heated"
    else:
        kind, what = "off", f"Wires off: {board.reason}"
    line = f'<b class="big {kind}">{html.escape(what)}</b>{html.escape(run.said)}'
    return line + "".join(f' <b class="bad">{html.escape(hot)}</b>' for hot in too_hot(run))


def too_hot(run: Run) -> list[str]:
    """A sentence for each wire that is read above T_max."""
    if run.phase is None or run.reading is None or not run.is_running:
        return []
    parameters = run.phase.parameters
    limit = parameters.temperature_limits.maximum
    names = (name.replace("_", " ") for name in parameters.wire_names)
    return [
        f"The {name} wire is read at {value:.1f} °C, above T_max, {limit:g} °C."
        for name, value in zip(names, run.reading.measured_temperature, strict=True)
        if value > limit
    ]


def facts(run: Run, phase: RunHeader, reading: Reading | None) -> str:
    """The numbers, HTML."""
    names = [html.escape(name.replace("_", " ")) for name in phase.parameters.wire_names]
    rows = [("", names)]
    if reading is not None:
        rows += _wires(run, phase, reading)
    cells = "".join(
        f"<tr>{''.join(f'<td>{cell}</td>' for cell in (name, *values))}</tr>"
        for name, values in rows
    )
    lines = [*_bend(phase, reading), *_clock(run, phase, reading)] if reading is not None else []
    if reading is not None and reading.board is not None:
        lines += _cable(reading.board)
    lines.append(phase.source)
    return f"<table>{cells}</table>" + "".join(f"<p>{html.escape(line)}</p>" for line in lines)


def _wires(run: Run, phase: RunHeader, reading: Reading) -> list[tuple[str, list[str]]]:
    limit = phase.parameters.temperature_limits.maximum

    def cells(values) -> list[str]:
        texts = (f"{value:.1f}" for value in values)
        return [
            f'<b class="bad">{text}</b>' if value > limit else text
            for text, value in zip(texts, values, strict=True)
        ]

    rows = [
        ("reading V, °C", cells(reading.measured_temperature)),
        ("highest so far, °C", cells(run.highest)),
    ]
    if phase.band is not None:
        highest = phase.band.highest_readings
        rows.append(("highest, predicted, °C", [f"{value:.0f}" for value in highest]))
    if reading.board is not None:
        warmest = reading.board.warmest
        rows.append(("at most, by its duty, °C", [f"{value:.0f}" for value in warmest]))
    if not run.is_running:  # the last duty is not in force any more
        return rows
    rows.append(("duty", [f"{value:.2f}" for value in reading.duty]))
    if reading.applied_duty is not None:
        rows.append(("duty applied", [f"{value:.2f}" for value in reading.applied_duty]))
    return rows


def _bend(phase: RunHeader, reading: Reading) -> list[str]:
    lines = []
    for i, angle in enumerate(np.rad2deg(reading.bend_angle)):
        said = [f"φ {angle:+.1f}°"]
        if phase.plan is not None:
            plan = phase.plan
            rows = (("plan", plan.bend_angle), ("reference", plan.reference))
            for name, row in rows:
                said.append(
                    f"{name} {np.rad2deg(np.interp(reading.time, plan.time, row[i])):+.1f}°"
                )
        if reading.reference is not None:
            said.append(f"asked for {np.rad2deg(reading.reference[i]):+.1f}°")
        lines.append(", ".join(said))
    return lines


def _clock(run: Run, phase: RunHeader, reading: Reading) -> list[str]:
    if phase.duration is None:
        return [f"{reading.time:.1f} s"]
    if not run.is_running:
        return [f"{reading.time:.1f} s of {phase.duration:g} s"]
    left = max(0.0, phase.duration - reading.time)
    return [f"{reading.time:.1f} s of {phase.duration:g} s, {left:.1f} s left"]


def _cable(board: BoardReading) -> list[str]:
    lines = [f"{board.lost_samples} samples lost"]
    if board.late is not None:
        lines.append(
            f"last command late by {1000 * board.late:.1f} ms; {board.missed} of {board.commands} "
            f"by more than {1000 * DEADLINE:g} ms"
        )
    return lines
