"""Panels of pictures: curves, bands, limits, labels, units and colours, declared once.

`limb_systems.views.plots` draws panels as a picture, by Matplotlib, and
`soft_limb.reports.charts` as an interactive chart, by Bokeh. This module imports neither.
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

BAND_FACTOR = 1.96  # half-width of the 95% band over the standard deviation of rollouts
TIME = "time (s)"


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """A curve of a panel.

    - ``name``: text in the legend and, in a chart, under the pointer; curves with one name share
      an entry, and a curve without a name has none.
    - ``x``, ``y``: samples (K,), in the units of the panel's labels.
    - ``color``: a colour that is visible on white and on black.
    - ``dash``: "solid", "dashed" or "dotted".
    - ``width``: px.
    - ``band``: lower and upper edge (K,) of a band about a line; None for none.
    - ``marks``: whether the samples are dots that no line joins.
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
    band: tuple[np.ndarray, np.ndarray] | None = None
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
    """A signal of runs, with its texts and sizes in panels.

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
        """Return the signal's panel.

        Args:
            where: suffix of the segment or of the bend, such as "_2", "_2_e3" or "_rear".
            options: further fields of `Panel`.
        """
        label = f"{self.name}{in_words(where)}" + f" ({self.unit})" * bool(self.unit)
        return Panel(label, curves, **{"height": self.height, "y_range": self.y_range, **options})


def in_words(suffix: str) -> str:
    """Return a segment's or bend's suffix in words: " of segment 2 towards E3" or " of rear"."""
    match = re.fullmatch(r"(?:_(.+?))??(?:_e([23]))?", suffix)
    segment, axis = match.groups() if match else (None, None)
    words = ""
    if segment is not None:
        words = f" of {'segment ' * segment.isdigit()}{segment}".replace("_", " ")
    if axis:
        words += f" towards E{axis}"
    return words


SIGNALS = {
    "bend_angle": Signal("φ", "bend angle", "°", 290),
    "measured_temperature": Signal("V", "temperature", "°C", 270),
    "duty": Signal("D", "duty", "", 210, (-0.04, 1.04)),
}


def tracking_panels(trajectory: Trajectory, recordings: Sequence[Recording] = ()) -> list[Panel]:
    """Return the panels of Fig. 5: bend angle, temperatures and duty of a plan and its rollouts.

    Each segment has its own three panels. A segment that bends in space has one more for its second
    bend, and a panel at the end that draws one bend over the other. If limbs are connected, the
    `connected_panels` of the first recording come first.

    Time counts from the start of the plan. Plans are dashed; the legend says whether the rollouts
    were simulated, emulated or recorded. Several recordings are drawn as their mean and a band of
    95%, mean ± 1.96 standard deviations, at the sample times of the first.

    Args:
        trajectory: the plan.
        recordings: rollouts of this plan, all with the same sample rate.
    """
    trajectory = trajectory.since_start()
    origins = " and ".join(dict.fromkeys(recording.how for recording in recordings))
    names = {
        "bend_angle": f"{origins}{' rollouts' * (len(recordings) > 1)} φ",
        "measured_temperature": f"V {origins}",
        "duty": "D",
    }
    last_duty_time = trajectory.time[-2]

    def rollouts(signal: str, row: int, wire: str, color: str) -> list[Curve]:
        """Return the curve of the rollouts' mean with its band, in a list; [] without rollouts."""
        if not recordings:
            return []
        samples = [_in_unit(signal, getattr(recording, signal)[row]) for recording in recordings]
        time, mean, half_width = _mean_and_half_width(recordings, samples)
        if signal == "duty":
            is_drawn = time < last_duty_time
            time = time[is_drawn]
            mean = mean[is_drawn]
            half_width = half_width[is_drawn]
        band = (mean - half_width, mean + half_width) if len(recordings) > 1 else None
        return [Curve(f"{wire}{names[signal]}", time, mean, color, band=band)]

    # Draw the limits from the times on at which they hold.
    limits = trajectory.parameters.temperature_limits
    start, end = trajectory.time[[0, -1]]
    limit_curves = [_limit_curve("T_max", limits.maximum, start, end)]
    if limits.warm_up_time < end:
        limit_curves.append(_limit_curve("T_warm", limits.warm, limits.warm_up_time, end))
    panels = measured_panels(trajectory.parameters, rollouts, trajectory, limits=limit_curves)
    # Draw the paths of bends in space.
    layout = trajectory.model.layout
    for bend in np.flatnonzero(layout.bend_direction):
        # In the list, each segment has two panels, of heat and of duty, after its bends.
        index = bend + 2 * layout.bend_segment[bend]
        panels.append(_path_panel(panels[index - 1], panels[index]))
    connected_part = connected_panels(recordings[0]) if recordings else []
    return [*connected_part, *panels]


def _limit_curve(name: str, value: float, start: float, end: float) -> Curve:
    """Return a line at a temperature, °C, from start to end, s."""
    return Curve(name, np.array([start, end]), np.full(2, value), NEUTRAL_COLOR, width=1.0)


def _path_panel(across: Panel, up: Panel) -> Panel:
    """Return the path of a segment's bends, one over the other, from their panels over time."""
    curves = []
    for across_curve, up_curve in zip(across.curves, up.curves, strict=True):
        curves.append(dataclasses.replace(up_curve, x=across_curve.y, band=None))
    return Panel(up.label, curves, 420, across.label, equal=True)


def measured_panels(
    parameters: LimbParameters,
    measured: Callable[[str, int, str, str], list[Curve]],
    plan: Trajectory | None,
    *,
    limits: Sequence[Curve] = (),
    bands: Mapping[str, np.ndarray] | None = None,
) -> list[Panel]:
    """Return the bend angles, temperatures and duty of each segment, with the curves of a plan.

    Args:
        parameters: the limb.
        measured: function that returns the curves of a signal's row, of the signal's name, the
            row, the beginning of the curves' names ("left, "), and a colour.
        plan: trajectory that the limb follows, from time 0 on.
        limits: lines in the panels of temperature.
        bands: edges of the plan's bands by signal, low and high (2, rows, K), as far as known.
    """
    bands = bands or {}

    def planned(
        name: str, signal: str, row: int, color: str, dash: str, width: float = 1.5
    ) -> list[Curve]:
        """Return the curve of a plan's signal; none without a plan."""
        if plan is None:
            return []
        # The last duty is arbitrary, as it has no time left to move the limb: not drawn.
        drawn = slice(-1 if signal == "duty" else None)
        values = _in_unit(signal, getattr(plan, signal)[row, drawn])
        band = None
        if signal in bands:
            low, high = _in_unit(signal, bands[signal][:, row, drawn])
            band = (low, high)
        return [Curve(name, plan.time[drawn], values, color, dash, width, band)]

    panels = []
    layout = LimbModel.of(parameters).layout
    for segment, (bends, wire_rows) in enumerate(
        zip(layout.bends_of, layout.wires_of, strict=True)
    ):
        # Add a panel for each bend.
        for index in range(bends.start, bends.stop):
            bend = []
            if plan is not None:
                reference_deg = np.rad2deg(plan.reference[index])
                bend.append(Curve("reference φ_REF", plan.time, reference_deg, REFERENCE_COLOR))
            bend += measured("bend_angle", index, "", ROLLOUT_COLOR)
            bend += planned("plan φ*", "bend_angle", index, PLAN_COLOR, "dashed")
            panels.append(SIGNALS["bend_angle"].panel(bend, parameters.bend_suffixes[index]))
        # Collect the curves of heat and duty.
        names = [wire.name for wire in parameters.segments[segment].wires]
        colors = wire_colors(len(names))
        wires = list(zip(itertools.count(wire_rows.start), names, colors, strict=False))
        heat = []
        duty = []
        for index, name, color in wires:
            heat += measured("measured_temperature", index, f"{name}, ", color)
            duty += measured("duty", index, f"{name}, ", color)
        dash = "dashed" if duty else "solid"
        for index, name, color in wires:
            heat += planned(f"{name}, V* planned", "measured_temperature", index, color, "dashed")
            duty += planned(f"{name}, D* planned", "duty", index, color, dash)
        for index, name, color in wires:
            heat += planned(f"{name}, T* planned", "wire_temperature", index, color, "dotted", 1.0)
        # Add their panels, with room for more lines of the legend.
        where = parameters.segment_suffixes[segment] if parameters.segments[segment].name else ""
        legend_height = 20 * max(0, len(names) - 3)  # px
        for signal, curves, lines in (
            (SIGNALS["measured_temperature"], heat, limits),
            (SIGNALS["duty"], duty, ()),
        ):
            height = signal.height + legend_height
            panels.append(signal.panel(curves, where, limits=lines, height=height))
    return panels


def _in_unit(signal: str, values: np.ndarray) -> np.ndarray:
    """Return values of a signal in the unit of its panel."""
    return np.rad2deg(values) if signal == "bend_angle" else values


def motion_panels(motion: Recording | Planned) -> list[Panel]:
    """Return the panels of a limb's, or each connected limb's, bend angles, heat and duty."""

    def motion_curves(signal: str, row: int, wire: str, color: str) -> list[Curve]:
        """Return the curve of a signal's row; readings have the wire temperature with them."""
        values = _in_unit(signal, getattr(motion, signal)[row])
        steps = signal == "duty" and motion.HOLDS_DUTY
        name = f"{wire}{SIGNALS[signal].symbol}"
        curves = [Curve(name, motion.time, values, color, steps=steps)]
        if signal == "measured_temperature" and motion.wire_temperature is not None:
            temperature = motion.wire_temperature[row]
            curves.append(Curve(f"{wire}T", motion.time, temperature, color, "dotted"))
        return curves

    start, end = motion.time[[0, -1]]
    limit = _limit_curve("T_max", motion.parameters.temperature_limits.maximum, start, end)
    return [
        *connected_panels(motion),
        *measured_panels(motion.parameters, motion_curves, None, limits=[limit]),
    ]


def connected_panels(motion: Samples) -> list[Panel]:
    """Return the panels of signals that no single limb has; none for a limb."""
    return connected("panels")(motion.robot, motion) if motion.robot else []


def repetition_panels(
    trajectory: Trajectory,
    distances: Sequence[float],
    errors: Sequence[float],
    first: Recording,
    last: Recording,
) -> list[Panel]:
    """Return panels of distance and error over repetitions, and of the bend in two repetitions.

    Args:
        trajectory: the plan.
        distances, errors: means of |φ_ref - φ| and of |φ* - φ| of the sensor's readings in each
            repetition, rad.
        first, last: recordings of repetitions.
    """
    trajectory = trajectory.since_start()
    # Draw distance and error as lines with dots.
    numbers = np.arange(1, len(errors) + 1)
    distance_curves = []
    for name, values, color in (
        ("from the reference, |φ_REF − φ|", distances, ROLLOUT_COLOR),
        ("from the plan, |φ* − φ|", errors, PLAN_COLOR),
    ):
        values_deg = np.rad2deg(values)
        distance_curves.append(Curve(name, numbers, values_deg, color, width=1.5))
        distance_curves.append(Curve(name, numbers, values_deg, color, width=2.0, marks=True))
    panels = [
        Panel(
            "mean distance, as read (°)",
            distance_curves,
            x_label="repetition",
            from_zero=True,
            x_ticks={int(number): str(number) for number in numbers},
        )
    ]
    # Draw each bend of the plan and of two repetitions.
    for bend, suffix in enumerate(trajectory.parameters.bend_suffixes):
        curves = []
        for name, run, angle, color, dash in (
            ("reference φ_REF", trajectory, trajectory.reference, REFERENCE_COLOR, "solid"),
            ("first repetition", first, first.bend_angle, LEFT_RIGHT_COLORS[1], "solid"),
            ("last repetition", last, last.bend_angle, ROLLOUT_COLOR, "solid"),
            ("plan φ*", trajectory, trajectory.bend_angle, PLAN_COLOR, "dashed"),
        ):
            curves.append(Curve(name, run.time, np.rad2deg(angle[bend]), color, dash))
        panels.append(SIGNALS["bend_angle"].panel(curves, suffix))
    return panels


def _mean_and_half_width(
    recordings: Sequence[Recording], samples: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, mean and half-width of the 95% band of a signal, as long as the shortest."""
    length = min(len(sample) for sample in samples)
    # Leave out missing samples; where all rollouts miss a sample there is a gap.
    masked = np.ma.masked_invalid([sample[:length] for sample in samples])
    spread = masked.std(axis=0, ddof=min(1, len(samples) - 1))
    return (
        recordings[0].time[:length],
        masked.mean(axis=0).filled(np.nan),
        BAND_FACTOR * spread.filled(0.0),
    )
