"""Panels of pictures: curves, bands, limits, labels, units and colours, declared once.

`limb_systems.views.plots` draws panels as a picture, by Matplotlib, and
`soft_limb.reports.charts` as a chart to look into, by Bokeh. Importing this needs neither.
"""

import dataclasses
import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from limb_systems.connected_limbs import connected
from limb_systems.files.recording import Recording
from limb_systems.files.signal_table import Planned, Samples
from limb_systems.files.trajectory import Trajectory
from limb_systems.limb_model import LimbModel
from limb_systems.limb_parameters import LimbParameters
from limb_systems.views.colors import (
    LEFT_RIGHT_COLORS,
    NEUTRAL_COLOR,
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)

BAND_FACTOR = 1.96  # standard deviations that hold 95% of the rollouts
TIME = "time (s)"


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """A curve of a panel.

    - ``name``: text in the legend and, in a chart, under the pointer; curves with one name share
      an entry, and a curve without a name has none.
    - ``x``, ``y``: samples (K,), in the units of the panel's labels.
    - ``color``: one that is seen on white and on black.
    - ``dash``: "solid", "dashed" or "dotted".
    - ``width``: px.
    - ``band``: half-width of a band about y (K,), or its lower and upper edge; None for none.
    - ``marks``: whether the samples are dots that no line joins; the band is then a bar at each.
    - ``steps``: whether each value holds until the next.
    - ``alpha``: opacity.
    - ``column``: name of the column over "time" that a live page adds samples to; else empty.
    """

    name: str
    x: np.ndarray
    y: np.ndarray
    color: str
    dash: str = "solid"
    width: float = 1.5
    band: np.ndarray | tuple[np.ndarray, np.ndarray] | None = None
    marks: bool = False
    steps: bool = False
    alpha: float = 1.0
    column: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Panel:
    """Curves over one pair of axes. Panels with the same horizontal label share its range.

    - ``label``: text beside the vertical axis, with its unit in brackets.
    - ``curves``: drawn in their order.
    - ``height``: px, with the legend.
    - ``x_label``: text below the horizontal axis, with its unit in brackets.
    - ``y_range``: range of the vertical axis; the curves' if None.
    - ``from_zero``: whether the vertical axis begins at zero.
    - ``x_ticks``, ``y_ticks``: texts beside an axis by where they stand; numbers if None.
    - ``limits``: lines whose names stand beside them in a picture, in the legend of a chart.
    - ``equal``: whether both axes have one scale.
    """

    label: str
    curves: Sequence[Curve]
    height: int = 230
    x_label: str = TIME
    y_range: tuple[float, float] | None = None
    from_zero: bool = False
    x_ticks: Mapping[int, str] | None = None
    y_ticks: Mapping[int, str] | None = None
    limits: Sequence[Curve] = ()
    equal: bool = False


@dataclasses.dataclass(frozen=True)
class Signal:
    """A signal that runs are drawn and compared by.

    - ``symbol``, ``name``, ``unit``: texts in labels.
    - ``height``: height of its panel, px.
    - ``y_range``: range of its panel, if it is always the same.
    """

    symbol: str
    name: str
    unit: str
    height: int
    y_range: tuple[float, float] | None = None

    def panel(self, curves: Sequence[Curve], where: str = "", **options: Any) -> Panel:
        """The signal's panel.

        Args:
            where: suffix of the segment or of the bend, such as "_2", "_2_e3" or "_rear".
            options: further fields of `Panel`.
        """
        label = f"{self.name}{in_words(where)}" + f" ({self.unit})" * bool(self.unit)
        return Panel(label, curves, **{"height": self.height, "y_range": self.y_range, **options})


def in_words(suffix: str) -> str:
    """A suffix of a segment or bend in words, such as " of segment 2 towards E3" or " of rear"."""
    match = re.fullmatch(r"(?:_(.+?))??(?:_e([23]))?", suffix)
    segment, axis = match.groups() if match else (None, None)
    words = "" if segment is None else f" of {'segment ' * segment.isdigit()}{segment}"
    return words.replace("_", " ") + (f" towards E{axis}" if axis else "")


SIGNALS = {
    "bend_angle": Signal("φ", "bend angle", "°", 290),
    "measured_temperature": Signal("V", "temperature", "°C", 270),
    "duty": Signal("D", "duty", "", 210, (-0.04, 1.04)),
}


def tracking_panels(trajectory: Trajectory, recordings: Sequence[Recording] = ()) -> list[Panel]:
    """Fig. 5: bend angle, temperatures and duty of a plan and of its rollouts.

    The first recording of connected limbs has `connected_panels` before them. Time counts from
    the start of the plan. Plans are dashed; the legend says whether
    the rollouts were simulated, emulated or recorded. Several recordings are drawn as their
    mean and the band of 95%, mean ± 1.96 standard deviations, at the sample times of the
    first. Each segment has its own three panels; one that bends in space has one more for its
    second bend, and at the end one of both bends over each other.

    Args:
        trajectory: the plan.
        recordings: rollouts of this plan, all with the same sample rate.
    """
    trajectory = trajectory.since_start()
    how = " and ".join(dict.fromkeys(recording.how for recording in recordings))
    last_duty = trajectory.time[-2]
    names = {
        "bend_angle": f"{how}{' rollouts' * (len(recordings) > 1)} φ",
        "measured_temperature": f"V {how}",
        "duty": "D",
    }

    def rollouts(signal: str, row: int, wire: str, color: str) -> list[Curve]:
        if not recordings:
            return []
        rows = [_in_unit(signal, getattr(recording, signal)[row]) for recording in recordings]
        time, mean, half = mean_and_half_width(recordings, rows)
        shown = time < last_duty if signal == "duty" else slice(None)
        time, mean, half = time[shown], mean[shown], half[shown]
        band = half if len(recordings) > 1 else None
        return [Curve(f"{wire}{names[signal]}", time, mean, color, band=band)]

    limits, time = trajectory.parameters.temperature_limits, trajectory.time
    panels = measured_panels(
        trajectory.parameters,
        rollouts,
        trajectory,
        limits=[
            Curve(name, np.array([start, time[-1]]), np.full(2, value), NEUTRAL_COLOR, width=1.0)
            for name, value, start in (
                ("T_max", limits.maximum, time[0]),
                ("T_warm", limits.warm, limits.warm_up_time),
            )
            if start < time[-1]
        ],
    )
    layout = trajectory.model.layout
    for bend in np.flatnonzero(layout.bend_direction):
        place = bend + 2 * layout.bend_segment[bend]  # two of heat and duty follow each segment
        panels.append(_path_panel(panels[place - 1], panels[place]))
    return [*(panel for run in recordings[:1] for panel in connected_panels(run)), *panels]


def _path_panel(across: Panel, up: Panel) -> Panel:
    """The path of a segment's bends, one over the other, from the panels of both over time."""
    curves = [
        dataclasses.replace(curve, x=below.y, y=curve.y, band=None)
        for below, curve in zip(across.curves, up.curves, strict=True)
    ]
    return Panel(up.label, curves, 420, across.label, equal=True)


def measured_panels(
    parameters: LimbParameters,
    measured: Callable[[str, int, str, str], list[Curve]],
    plan: Trajectory | None,
    *,
    limits: Sequence[Curve] = (),
    bands: Mapping[str, np.ndarray] | None = None,
) -> list[Panel]:
    """Bend angles, temperatures and duty of each segment, with those of a plan.

    Args:
        parameters: the limb.
        measured: curves of a signal's row, from the names of both, the row's as it begins
            curves' names ("left, "), and a colour.
        plan: trajectory that the limb follows, from time 0 on.
        limits: lines in the panels of temperature.
        bands: edges of the plan's bands by signal, low and high (2, rows, K), as far as known.
    """
    panels, bands = [], bands or {}

    def planned(
        name: str, signal: str, row: int, color: str, dash: str, width: float = 1.5
    ) -> list[Curve]:
        if plan is None:
            return []
        # The last duty has no time left to move the limb, so that it is arbitrary: not drawn.
        shown = slice(-1 if signal == "duty" else None)
        values, band = _in_unit(signal, getattr(plan, signal)[row, shown]), None
        if signal in bands:
            low, high = _in_unit(signal, bands[signal][:, row, shown])
            band = low, high
        return [Curve(name, plan.time[shown], values, color, dash, width, band)]

    layout = LimbModel.of(parameters).layout
    for segment, (bends, wired) in enumerate(zip(layout.bends_of, layout.wires_of, strict=True)):
        names = [wire.name for wire in parameters.segments[segment].wires]
        wires = list(
            zip(itertools.count(wired.start), names, wire_colors(len(names)), strict=False)
        )
        for index in range(bends.start, bends.stop):
            bend, called = [], parameters.bend_suffixes[index]
            if plan is not None:
                wanted = np.rad2deg(plan.reference[index])
                bend.append(Curve("reference φ_REF", plan.time, wanted, REFERENCE_COLOR))
            bend += measured("bend_angle", index, "", ROLLOUT_COLOR)
            bend += planned("plan φ*", "bend_angle", index, PLAN_COLOR, "dashed")
            panels.append(SIGNALS["bend_angle"].panel(bend, called))
        heat, duty = [], []
        for index, name, color in wires:
            heat += measured("measured_temperature", index, f"{name}, ", color)
            duty += measured("duty", index, f"{name}, ", color)
        dash = "dashed" if duty else "solid"
        for index, name, color in wires:
            heat += planned(f"{name}, V* planned", "measured_temperature", index, color, "dashed")
            duty += planned(f"{name}, D* planned", "duty", index, color, dash)
        for index, name, color in wires:
            heat += planned(f"{name}, T* planned", "wire_temperature", index, color, "dotted", 1.0)
        where = parameters.segment_suffixes[segment] if parameters.segments[segment].name else ""
        legend = 20 * max(0, len(names) - 3)  # px, of more lines
        for signal, curves, lines in (
            (SIGNALS["measured_temperature"], heat, limits),
            (SIGNALS["duty"], duty, ()),
        ):
            height = signal.height + legend
            panels.append(signal.panel(curves, where, limits=lines, height=height))
    return panels


def _in_unit(signal: str, values: np.ndarray) -> np.ndarray:
    """Values of a signal in the unit of its panel."""
    return np.rad2deg(values) if signal == "bend_angle" else values


def motion_panels(motion: Recording | Planned) -> list[Panel]:
    """Bend angles, temperatures and duty of a limb, or of each connected one, and their panels."""

    def curves(signal: str, row: int, wire: str, color: str) -> list[Curve]:
        values = _in_unit(signal, getattr(motion, signal)[row])
        steps = signal == "duty" and motion.HOLDS_DUTY
        drawn = [Curve(f"{wire}{SIGNALS[signal].symbol}", motion.time, values, color, steps=steps)]
        if signal == "measured_temperature" and motion.wire_temperature is not None:
            heat = motion.wire_temperature[row]
            drawn.append(Curve(f"{wire}T", motion.time, heat, color, "dotted"))
        return drawn

    highest = np.full(2, motion.parameters.temperature_limits.maximum)
    limit = Curve("T_max", motion.time[[0, -1]], highest, NEUTRAL_COLOR, width=1.0)
    return [
        *connected_panels(motion),
        *measured_panels(motion.parameters, curves, None, limits=[limit]),
    ]


def connected_panels(motion: Samples) -> list[Panel]:
    """Return the panels of what no single limb has in a motion; none for a limb."""
    return connected("panels")(motion.robot, motion) if motion.robot else []


def repetition_panels(
    trajectory: Trajectory,
    distances: Sequence[float],
    errors: Sequence[float],
    first: Recording,
    last: Recording,
) -> list[Panel]:
    """How distance and error fell over repetitions, and the bend in the first and the last.

    Args:
        trajectory: the plan.
        distances, errors: means of |φ_ref - φ| and of |φ* - φ| in each repetition, as it was
            read, rad.
        first, last: recordings of repetitions.
    """
    trajectory = trajectory.since_start()
    numbers = np.arange(1, len(errors) + 1)
    fell = [
        Curve(name, numbers, np.rad2deg(values), color, width=width, marks=marks)
        for name, values, color in (
            ("from the reference, |φ_REF − φ|", distances, ROLLOUT_COLOR),
            ("from the plan, |φ* − φ|", errors, PLAN_COLOR),
        )
        for width, marks in ((1.5, False), (2.0, True))
    ]
    panels = [
        Panel(
            "mean distance, as read (°)",
            fell,
            x_label="repetition",
            from_zero=True,
            x_ticks={int(number): str(number) for number in numbers},
        )
    ]
    for bend, suffix in enumerate(trajectory.parameters.bend_suffixes):
        curves = [
            Curve(name, run.time, np.rad2deg(angle[bend]), color, dash)
            for name, run, angle, color, dash in (
                ("reference φ_REF", trajectory, trajectory.reference, REFERENCE_COLOR, "solid"),
                ("first repetition", first, first.bend_angle, LEFT_RIGHT_COLORS[1], "solid"),
                ("last repetition", last, last.bend_angle, ROLLOUT_COLOR, "solid"),
                ("plan φ*", trajectory, trajectory.bend_angle, PLAN_COLOR, "dashed"),
            )
        ]
        panels.append(SIGNALS["bend_angle"].panel(curves, suffix))
    return panels


def mean_and_half_width(
    recordings: Sequence[Recording], samples: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, mean and half-width of the 95% band of rollouts; each as long as the shortest.

    Args:
        recordings: one or more, all with the same sample rate; times are the first's.
        samples: one signal in each recording.
    """
    length = min(len(sample) for sample in samples)
    # What one of them misses is that of the others, and a gap where all do.
    masked = np.ma.masked_invalid([sample[:length] for sample in samples])
    spread = masked.std(axis=0, ddof=min(1, len(samples) - 1))
    return (
        recordings[0].time[:length],
        masked.mean(axis=0).filled(np.nan),
        BAND_FACTOR * spread.filled(0.0),
    )
