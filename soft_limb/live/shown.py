"""What the live page shows of a run: curves, state and numbers."""

import itertools
import time
from collections.abc import Iterable
from typing import Any

import numpy as np
from bokeh.embed import json_item
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, DataRange1d, Range1d

from hardware.board.serial_limb import DEADLINE
from hardware.live_feed import Reading, RunHeader
from limb_systems.layout import Layout
from limb_systems.views.colors import REFERENCE_COLOR
from limb_systems.views.panels import Curve, Panel, in_words, measured_panels
from soft_limb.live.run import MOST_POINTS, Run
from soft_limb.reports import charts
from soft_limb.reports.page import part

SILENCE = 1.0  # s, after which a limb that runs is missed
WINDOW = 600.0  # s, that are shown of a run without an end
NEAR = 10.0  # °C below T_max, from where on a wire is said to be near it
LIMIT_COLOR, WARM_COLOR = "#c62828", "#b08900"


class Browser:
    """What one browser has been told of the curves of a run."""

    def __init__(self, run: Run):
        self._run, self._shown, self._sent = run, (0, 0), 0

    def curves(self) -> dict[str, Any]:
        """Return what the browser does not have yet, for JSON.

        - ``charts``: charts of a new phase, as Bokeh embeds them, of at most ``most`` points.
        - ``data``: all columns, if the phase is new or its readings were thinned.
        - ``rows``: else what is to be appended to the columns.
        """
        run, phase = self._run, self._run.phase
        news: dict[str, Any] = {}
        if phase is None:
            return {}
        number, thinned = self._shown
        if (run.number, run.thinned) != (number, thinned):
            news["data"] = columns(phase, run.readings)
            if run.number != number:
                news |= {"charts": figures(phase), "most": MOST_POINTS}
        elif new := min(run.count - self._sent, len(run.readings)):
            fresh = itertools.islice(run.readings, len(run.readings) - new, None)
            news["rows"] = columns(phase, fresh)
        self._shown, self._sent = (run.number, run.thinned), run.count
        return news


def columns(phase: RunHeader, readings: Iterable[Reading]) -> dict[str, list[float | None]]:
    """The columns of the curves: angles in degrees, numbered by bend or wire; None for a gap."""
    readings, layout = list(readings), Layout(phase.parameters)
    found: dict[str, list[float | None]] = {"time": [reading.time for reading in readings]}
    for name, size, scale in (
        ("bend_angle", layout.num_bends, 180.0 / np.pi),
        ("reference", layout.num_bends, 180.0 / np.pi),
        ("measured_temperature", layout.num_wires, 1.0),
        ("duty", layout.num_wires, 1.0),
        ("applied_duty", layout.num_wires, 1.0),
    ):
        for i in range(size):
            values = [getattr(reading, name) for reading in readings]
            found[f"{name}_{i}"] = [
                None if row is None or not np.isfinite(row[i]) else scale * row[i] for row in values
            ]
    return found


def figures(phase: RunHeader) -> dict[str, Any]:
    """The charts of a phase, whose curves take their columns from the source "readings"."""
    source = ColumnDataSource(columns(phase, []), name="readings")
    x_range = (
        Range1d(start=0.0, end=phase.duration, name="duration")
        if phase.duration
        else DataRange1d(follow="end", follow_interval=WINDOW, range_padding=0)
    )
    drawn = [charts.draw(panel, source, x_range) for panel in panels(phase)]
    for figure in drawn[:-1]:
        figure.xaxis.axis_label = None
    if isinstance(x_range, DataRange1d):  # limits are drawn beyond what has been recorded
        renderers = itertools.chain.from_iterable(figure.renderers for figure in drawn)
        x_range.renderers = [one for one in renderers if one.data_source is source]
    return json_item(column(*drawn, sizing_mode="stretch_width"))


def panels(phase: RunHeader) -> list[Panel]:
    """Fig. 5 of a phase, whose rollout grows."""
    plan, band, limits = phase.plan, phase.band, phase.parameters.temperature_limits

    def grows(name: str, column: str, color: str, **style) -> Curve:
        return Curve(name, np.zeros(0), np.zeros(0), color, column=column, **style)

    def measured(signal: str, row: int, wire: str, color: str) -> list[Curve]:
        column = f"{signal}_{row}"
        if signal == "measured_temperature":
            return [grows(f"{wire}V measured", column, color, width=2.0)]
        if signal == "bend_angle":
            read = grows("measured φ", column, color, width=2.0)
            wanted = grows("asked for", f"reference_{row}", REFERENCE_COLOR)
            return [wanted, read] if plan is None else [read]
        wide = {"width": 5.0, "alpha": 0.3, "steps": True}
        return [
            grows(f"{wire}D applied", f"applied_duty_{row}", color, **wide),
            grows(f"{wire}D asked for", column, color, steps=True),
        ]

    bands = {}
    if plan is not None and band is not None:
        width = np.interp(plan.time, band.time, band.bend_reading)
        planned = plan.measured_temperature
        above = [np.interp(plan.time, band.time, row) for row in band.measured_temperature]
        bands = {
            "bend_angle": np.array([plan.bend_angle - width, plan.bend_angle + width]),
            "measured_temperature": np.array([planned, planned + above]),
        }
    ends = np.array([0.0, phase.duration or 1e6])
    lines = (
        (f"T_max {limits.maximum:g} °C", limits.maximum, WARM_COLOR, "dotted"),
        (f"off at {phase.limit:g} °C", phase.limit, LIMIT_COLOR, "solid"),
    )
    return measured_panels(
        phase.parameters,
        measured,
        plan,
        limits=[
            Curve(name, ends, np.full(2, value), color, dash, 2.0)
            for name, value, color, dash in lines
        ],
        bands=bands,
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
    elif run.reading is not None and run.reading.cooling:
        kind, what = "off", "The run has ended: wires are off and cooling"
    elif board is None:
        kind, what = "armed", "Running"
    elif board.armed:
        kind, what = "armed", "Armed: wires may be heated"
    else:
        kind, what = "off", f"Wires off: {board.reason}"
    return part("state", kind, what, run.said, alarms(run))


def alarms(run: Run) -> list[tuple[str, str]]:
    """Return kind ("near" or "bad") and sentence for each wire read near T_max or above."""
    if run.phase is None or run.reading is None or not run.is_running:
        return []
    parameters, said = run.phase.parameters, []
    limits = parameters.temperature_limits
    for name, value in zip(parameters.wire_names, run.reading.measured_temperature, strict=True):
        if value >= min(limits.measured_maximum, run.phase.limit):
            kind, word = "bad", "too hot"
        elif value >= limits.maximum - NEAR:
            kind, word = "near", "above T_max" if value > limits.maximum else "near T_max"
        else:
            continue
        called = name.replace("_", " ")
        said.append((kind, f"{called}: {value:.1f} °C, {word} (T_max {limits.maximum:g} °C)"))
    return said


def facts(run: Run) -> str:
    """The numbers, HTML: readings and duty of each wire, bends, time and board."""
    phase, reading = run.phase, run.reading
    if phase is None:
        return ""
    rows: list[tuple[str, list[str]]] = []
    lines: list[str] = []

    def add(name: str, values: Iterable[float] | None, digits: int) -> None:
        if values is not None:
            rows.append((name, [f"{value:.{digits}f}" for value in values]))

    if reading is not None:
        board = reading.board
        add("reading V, °C", reading.measured_temperature, 1)
        add("highest so far, °C", run.highest, 1)
        add("highest, predicted, °C", phase.band.highest_readings if phase.band else None, 0)
        add("at most, by its duty, °C", board.warmest if board else None, 0)
        if run.is_running:  # the last duty is not in force any more
            add("duty", reading.duty, 2)
            add("duty applied", reading.applied_duty, 2)
        lines += [*_bends(phase, reading), _clock(run, phase, reading)]
        if board is not None:
            lines.append(f"{board.lost_samples} samples lost")
            if board.late is not None:
                lines.append(
                    f"last command late by {1000 * board.late:.1f} ms; {board.missed} of "
                    f"{board.commands} by more than {1000 * DEADLINE:g} ms"
                )
    if phase.band is not None:
        lines.append("Shaded: 95% band of the bend reading, 99.5% upper bound of wire temperature.")
    names = [name.replace("_", " ") for name in phase.parameters.wire_names]
    return part("facts", names, rows, [*lines, phase.source])


def _bends(phase: RunHeader, reading: Reading) -> list[str]:
    """A line for each bend: as it is read, as it is planned, and what is asked for."""
    shown = [("", reading.bend_angle)]
    if phase.plan is not None and not reading.cooling:
        for name, rows in (("plan ", phase.plan.bend_angle), ("reference ", phase.plan.reference)):
            shown.append((name, [np.interp(reading.time, phase.plan.time, row) for row in rows]))
    if reading.reference is not None:
        shown.append(("asked for ", reading.reference))
    return [
        f"φ{in_words(suffix)} "
        + ", ".join(f"{name}{np.rad2deg(angles[i]):+.1f}°" for name, angles in shown)
        for i, suffix in enumerate(Layout(phase.parameters).bend_suffixes)
    ]


def _clock(run: Run, phase: RunHeader, reading: Reading) -> str:
    if phase.duration is None or reading.cooling:
        return f"{reading.time:.1f} s"
    left = f", {max(0.0, phase.duration - reading.time):.1f} s left" * run.is_running
    return f"{reading.time:.1f} s of {phase.duration:g} s{left}"
