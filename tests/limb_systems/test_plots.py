"""Pictures show what they say: Fig. 5's mean and band of rollouts."""

import dataclasses
import re

import numpy as np
import pytest
from matplotlib.figure import Figure

from hardware import LimbTwin, SensedLimb, replay
from limb_systems import Limb, LimbError, PlanCheck, Trajectory
from limb_systems.views.colors import (
    LEFT_RIGHT_COLORS,
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
    wire_colors,
)
from limb_systems.views.plots import plot_repetitions, plot_tracking, save_figure


def test_rollouts_are_drawn_as_their_mean_and_the_band_of_95_percent(fig5_plan, tmp_path):
    recording = replay(fig5_plan, Limb(fig5_plan.parameters))
    angle = recording.bend_angle
    rollouts = [
        dataclasses.replace(recording, bend_angle=angle + np.deg2rad(d)) for d in (-1.0, 0.0, 1.0)
    ]
    figure = plot_tracking(fig5_plan, rollouts, title="three rollouts")
    bend, heat, duty = figure.axes
    lines = {line.get_label(): line for line in bend.get_lines()}
    mean = lines[r"simulated rollouts $\varphi$"].get_ydata()
    np.testing.assert_allclose(mean, np.rad2deg(angle[0]), atol=1e-9)
    (band,) = bend.collections
    lowest = band.get_paths()[0].vertices[:, 1].min()
    np.testing.assert_allclose(lowest, mean.min() - 1.96, atol=1e-9)  # s = 1°
    assert len(heat.collections) == 2
    drawn = {line.get_label(): line.get_ydata() for line in duty.get_lines()}
    np.testing.assert_allclose(drawn["right, D* planned"], fig5_plan.duty[1])
    np.testing.assert_allclose(drawn["right, D"], recording.duty[1])
    assert figure.get_suptitle() == "three rollouts"
    width = figure.get_size_inches()[0]
    save_figure(figure, tmp_path / "deep" / "fig5.pdf")
    pdf = (tmp_path / "deep" / "fig5.pdf").read_bytes()
    assert re.search(rb"/MediaBox \[ 0 0 252 [0-9.]+ \]", pdf)  # 3.5 inches of 72 pt
    assert b"/FontFile2" in pdf  # TrueType, inside
    assert figure.get_size_inches()[0] == width > 6.0  # the figure is as it was


@pytest.mark.parametrize(
    ("source", "how"),
    [
        (lambda: "limb SN1 on /dev/ttyACM0", "recorded"),
        (lambda: "day_3.csv", "recorded"),
        (lambda: LimbTwin(seed=3).source, "emulated"),
        (lambda: "limb twin0003 on /dev/pts/7", "emulated"),  # an emulated board's serial number
        (lambda: SensedLimb(Limb()).source, "simulated"),
    ],
)
def test_the_legend_says_how_a_recording_came_about(fig5_plan, source, how):
    made = replay(fig5_plan, Limb(fig5_plan.parameters))
    recording = dataclasses.replace(made, source=source(), joint_state=None, wire_temperature=None)
    for one, expected in ((recording, how), (made, "simulated")):
        bend, heat, _ = plot_tracking(fig5_plan, [one]).axes
        assert rf"{expected} $\varphi$" in bend.get_legend_handles_labels()[1]
        assert f"right, V {expected}" in heat.get_legend_handles_labels()[1]


def test_each_segment_has_its_panels_and_its_own_wires(two_segments):
    plan = _plan_of(two_segments)
    axes = plot_tracking(plan).figure.axes
    assert [axis.get_ylabel() for axis in axes[::3]] == [
        "bend angle of segment 1 (°)",
        "bend angle of segment 2 (°)",
    ]
    for segment in range(2):
        lines = {line.get_label(): line for line in axes[3 * segment + 2].get_lines()}
        for index, side in enumerate(("left", "right")):
            duty = plan.duty[2 * segment + index]
            np.testing.assert_array_equal(lines[f"{side}, D* planned"].get_ydata(), duty)


def test_each_wire_has_its_name_and_its_own_colour(three_and_one):
    plan = _plan_of(three_and_one)
    axes = plot_tracking(plan).figure.axes
    for segment, names in enumerate((("low", "middle", "high"), ("only",))):
        for what, axis in (
            ("V* planned", axes[3 * segment + 1]),
            ("D* planned", axes[3 * segment + 2]),
        ):
            lines = {line.get_label(): line for line in axis.get_lines()}
            drawn = [lines[f"{name}, {what}"] for name in names]
            assert len({line.get_color() for line in drawn}) == len(names)
            assert [line.get_color() for line in drawn[:2]] == [*LEFT_RIGHT_COLORS][: len(names)]
    only = {line.get_label(): line for line in axes[5].get_lines()}["only, D* planned"]
    np.testing.assert_array_equal(only.get_ydata(), plan.duty[3])


def test_colours_of_wires_are_told_apart_from_all_that_is_drawn_beside_them():
    assert len({*wire_colors(6), REFERENCE_COLOR, PLAN_COLOR, ROLLOUT_COLOR}) == 9
    assert len(wire_colors(7)) == 7


def _plan_of(parameters) -> Trajectory:
    """Not a plan, but a trajectory that tells its wires from each other."""
    wires, joints = len(parameters.wires), parameters.num_joints
    temperature = 25.0 + np.arange(2.0 * wires).reshape(wires, 2)
    return Trajectory(
        time=np.array([0.0, 1.0]),
        reference=np.zeros((2, 2)),
        duty=np.arange(2.0 * wires).reshape(wires, 2) / 10,
        joint_state=np.zeros((2 * joints, 2)),
        wire_temperature=temperature,
        measured_temperature=temperature,
        parameters=parameters,
        check=PlanCheck(),
    )


def test_a_picture_of_no_known_format_is_refused_before_it_is_drawn(tmp_path):
    with pytest.raises(LimbError, match=r"fig.xyz is of no known format; .*\.pdf"):
        save_figure(Figure(), tmp_path / "new" / "fig.xyz")
    assert not (tmp_path / "new").exists()


def test_repetitions_are_drawn_as_errors_and_the_first_and_the_last(fig5_plan):
    recording = replay(fig5_plan, Limb(fig5_plan.parameters))
    last = dataclasses.replace(recording, bend_angle=recording.bend_angle + np.deg2rad(1.0))
    errors, bend = plot_repetitions(fig5_plan, np.deg2rad([2.0, 1.0]), recording, last).axes
    (line,) = errors.get_lines()
    np.testing.assert_allclose(line.get_xydata(), [[1, 2.0], [2, 1.0]])
    drawn = {line.get_label(): line.get_ydata() for line in bend.get_lines()}
    np.testing.assert_allclose(drawn["last repetition"] - drawn["first repetition"], 1.0)
