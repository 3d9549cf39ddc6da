"""Pictures show what they say: Fig. 5's mean and band of rollouts."""

import dataclasses

import numpy as np

from hardware import replay
from limb_systems import Limb
from limb_systems.plots import plot_tracking, save_figure


def test_rollouts_are_drawn_as_their_mean_and_the_band_of_95_percent(fig5_plan, tmp_path):
    recording = replay(fig5_plan, Limb(fig5_plan.parameters))
    angle = recording.bend_angle
    rollouts = [
        dataclasses.replace(recording, bend_angle=angle + np.deg2rad(d)) for d in (-1.0, 0.0, 1.0)
    ]
    figure = plot_tracking(fig5_plan, rollouts, title="three rollouts")
    bend, heat, duty = figure.axes
    lines = {line.get_label(): line for line in bend.get_lines()}
    mean = lines[r"rollouts $\varphi$"].get_ydata()
    np.testing.assert_allclose(mean, np.rad2deg(angle[0]), atol=1e-9)
    (band,) = bend.collections
    lowest = band.get_paths()[0].vertices[:, 1].min()
    np.testing.assert_allclose(lowest, mean.min() - 1.96, atol=1e-9)  # s = 1°
    assert len(heat.collections) == 2
    assert len(duty.collections) == 0
    assert figure.get_suptitle() == "three rollouts"
    save_figure(figure, tmp_path / "deep" / "fig5.pdf")
    assert (tmp_path / "deep" / "fig5.pdf").read_bytes().startswith(b"%PDF")
