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

from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory
from limb_systems.layout import Layout
from limb_systems.limb_parameters import LimbParameters
from limb_systems.views.colors import (
    LEFT_RIGHT_COLORS,
    NEUTRAL_COLOR,
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from walking.foot_fall import foot_fall
from walking.gait import Gait, GaitPhase
from walking.robot_parameters import RobotParameters

# What a foot may do: in words, in colour, and how wide its bar is, px.
CONTACTS = {
    "stick": ("sticks", "#5b6b8c", 18.0),
    "slide_forward": ("slides forward", "#2f9e6e", 18.0),
    "slide_backward": ("slides backward", "#d83a4e", 18.0),
    "slide": ("is dragged", "#8a63d2", 18.0),
    "swing": ("swings", "#b0b6c0", 3.0),
}
_DASHES = {"x": "dashed", "y": "dotted", "z": "solid"}
BAND = 1.96  # standard deviations that hold 95% of the rollouts
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
    """A suffix of `Layout`'s in words, such as " of segment 2 towards E3" or " of rear"."""
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

    A robot's first recording has `robot_panels` before them. Time counts from the start of the
    plan. Plans are dashed; the legend says whether
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
        time, mean, half = mean_and_band(recordings, rows)
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
    layout = Layout(trajectory.parameters)
    for bend in np.flatnonzero(layout.bend_direction):
        place = bend + 2 * layout.bend_segment[bend]  # two of heat and duty follow each segment
        panels.append(_path_panel(panels[place - 1], panels[place]))
    return [*(panel for run in recordings[:1] for panel in robot_panels(run)), *panels]


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

    layout = Layout(parameters)
    for segment, (bends, wired) in enumerate(zip(layout.bends_of, layout.wires_of, strict=True)):
        names = [wire.name for wire in parameters.segments[segment].wires]
        wires = list(
            zip(itertools.count(wired.start), names, wire_colors(len(names)), strict=False)
        )
        for index in range(bends.start, bends.stop):
            bend, called = [], layout.bend_suffixes[index]
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
        where = layout.segment_suffixes[segment] if parameters.segments[segment].name else ""
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


def motion_panels(motion: Recording | Gait) -> list[Panel]:
    """Bend angles, temperatures and duty of a limb, or of each of a robot's, and `robot_panels`."""

    def curves(signal: str, row: int, wire: str, color: str) -> list[Curve]:
        values = _in_unit(signal, getattr(motion, signal)[row])
        steps = signal == "duty" and isinstance(motion, Gait)
        drawn = [Curve(f"{wire}{SIGNALS[signal].symbol}", motion.time, values, color, steps=steps)]
        if signal == "measured_temperature" and motion.wire_temperature is not None:
            heat = motion.wire_temperature[row]
            drawn.append(Curve(f"{wire}T", motion.time, heat, color, "dotted"))
        return drawn

    highest = np.full(2, motion.parameters.temperature_limits.maximum)
    limit = Curve("T_max", motion.time[[0, -1]], highest, NEUTRAL_COLOR, width=1.0)
    return [
        *robot_panels(motion),
        *measured_panels(motion.parameters, curves, None, limits=[limit]),
    ]


def robot_panels(motion: Recording | Gait) -> list[Panel]:
    """What the feet of a robot do, where its body is, and the contact forces, as far as known.

    Nothing for a limb.
    """
    robot, time, panels = motion.robot, motion.time, []
    if robot is None:
        return []
    forces, pose = motion.contact_force, motion.body_pose
    if isinstance(motion, Gait):
        panels.append(foot_fall_panel(robot, motion.phases, motion.period))
    elif forces is not None and motion.joint_state is not None and len(time) > 1:
        panels.append(foot_fall_panel(robot, foot_fall(motion), time[-1]))
    if pose is not None:
        in_space = robot.pose_size == 6
        # On a ground z tells little, and x and y less beside it.
        floats = in_space and robot.ground is None
        for group in ("mm", "°"):
            drawn = [
                (name, scale * row)
                for (name, unit, scale), row in zip(body_axes(robot), pose, strict=True)
                if unit == group and (floats or name != "z")
            ]
            colors = wire_colors(3) if in_space else [ROLLOUT_COLOR]
            curves = [
                Curve(name, time, row, color)
                for (name, row), color in zip(drawn, colors, strict=False)
            ]
            names = ", ".join(name for name, _ in drawn)
            panels.append(Panel(f"body {names} ({group})", curves, 190))
    if forces is not None:
        of_feet = forces.reshape(len(robot.limbs), -1, len(time))
        axes = "xz" if robot.force_size == 2 else "xyz"
        curves = [
            Curve(f"{limb.name.replace('_', ' ')}, {axis}", time, force, color, _DASHES[axis])
            for limb, color, of_foot in zip(
                robot.limbs, wire_colors(len(robot.limbs)), of_feet, strict=True
            )
            for axis, force in zip(axes, of_foot, strict=True)
        ]
        panels.append(Panel("contact force (N)", curves, 230 + 20 * (len(curves) // 6)))
    return panels


def body_axes(robot: RobotParameters) -> list[tuple[str, str, float]]:
    """Name, unit and scale from SI of each row of a body's pose."""
    in_space = robot.pose_size == 6
    moves, turns = ("xyz", ("roll", "pitch", "yaw")) if in_space else ("xz", ("pitch",))
    return [(axis, "mm", 1e3) for axis in moves] + [(turn, "°", np.rad2deg(1.0)) for turn in turns]


def foot_fall_panel(robot: RobotParameters, phases: Sequence[GaitPhase], end: float) -> Panel:
    """A bar for each foot over time, whose colour says what it does; the first is the lowest.

    Args:
        robot: the robot whose feet they are.
        phases: what they do, one phase after the other.
        end: end of the last phase, s.
    """
    ends = [*(phase.start for phase in phases[1:]), end]
    curves = []
    for contact, (name, color, width) in CONTACTS.items():
        x: list[float] = []
        y: list[float] = []
        for number in range(len(robot.limbs)):
            for phase, until in zip(phases, ends, strict=True):
                if phase.contacts[number] == contact:
                    x += [phase.start, until, until]
                    y += [number, number, np.nan]  # no line to the next
        if x:
            curves.append(Curve(name, np.array(x), np.array(y), color, width=width))
    feet = len(robot.limbs)
    ticks = {number: limb.name.replace("_", " ") for number, limb in enumerate(robot.limbs)}
    return Panel("foot", curves, 90 + 32 * feet, y_range=(-0.6, feet - 0.4), y_ticks=ticks)


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
    for bend, suffix in enumerate(Layout(trajectory.parameters).bend_suffixes):
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


def mean_and_band(
    recordings: Sequence[Recording], samples: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, mean and half-width of the 95% band of rollouts; each as long as the shortest.

    Args:
        recordings: one or more, all with the same sample rate; times are the first's.
        samples: one signal in each recording.
    """
    length = min(len(sample) for sample in samples)
    # What one of them misses is that of the others, and a gap where all do.
    stacked = np.ma.masked_invalid([sample[:length] for sample in samples])
    spread = stacked.std(axis=0, ddof=min(1, len(samples) - 1))
    return (
        recordings[0].time[:length],
        stacked.mean(axis=0).filled(np.nan),
        BAND * spread.filled(0.0),
    )
