"""Panels show what is in the files, and pictures and charts show what is in the panels."""

import dataclasses
import itertools
import json
import re

import numpy as np
import pytest
from bokeh.document import Document
from matplotlib.colors import to_hex

from limb_systems import (
    Limb,
    Recording,
    Trajectory,
    simulate,
)
from limb_systems.views import plots
from limb_systems.views.panels import Curve, Panel, tracking_panels
from limb_systems.views.plots import save_figure
from soft_limb.reports import page


def chart_of(panels) -> list:
    """The figures of a chart, as Bokeh reads them from a page."""
    html = page.chart(panels, "a chart")
    (text,) = re.findall(r'<script type="application/json">(.*?)</script>', html, re.DOTALL)
    (layout,) = Document.from_json(json.loads(text)["doc"]).roots
    return [figure for figure, *_ in layout.children]


@pytest.fixture(scope="module")
def model_recording():
    return simulate(Limb(), [0.05, 0.3], 4.0)


@pytest.fixture
def planned_like_it(model_recording, plan_like) -> Trajectory:
    recording = model_recording
    return plan_like(recording, time=recording.time + 3.0, reference=recording.bend_angle + 0.1)


def by_name(panel: Panel) -> dict[str, Curve]:
    return {curve.name: curve for curve in [*panel.curves, *panel.limits]}


def test_panels_have_the_data_of_the_files(model_recording, planned_like_it, tmp_path):
    planned_like_it.save(tmp_path / "plan.csv")
    model_recording.save(tmp_path / "recording.csv")
    planned, recorded = (
        np.genfromtxt(
            itertools.dropwhile(
                lambda line: line.startswith("#"), (tmp_path / name).read_text("utf-8").splitlines()
            ),
            delimiter=",",
            names=True,
        )
        for name in ("plan.csv", "recording.csv")
    )
    bend, temperature, duty = tracking_panels(
        Trajectory.load(tmp_path / "plan.csv"), [Recording.load(tmp_path / "recording.csv")]
    )
    assert [panel.label for panel in (bend, temperature, duty)] == [
        "bend angle (°)",
        "temperature (°C)",
        "duty",
    ]
    for panel, name, data, column in (
        (bend, "simulated φ", recorded, "bend_angle_deg"),
        (bend, "plan φ*", planned, "bend_angle_deg"),
        (bend, "reference φ_REF", planned, "reference_angle_deg"),
        (temperature, "right, V simulated", recorded, "measured_temperature_right_c"),
        (temperature, "left, T* planned", planned, "wire_temperature_left_c"),
        (temperature, "left, V* planned", planned, "measured_temperature_left_c"),
        (duty, "right, D", recorded, "duty_right"),
        (duty, "left, D* planned", planned, "duty_left"),
    ):
        curve = by_name(panel)[name]
        time = data["time_s"] - data["time_s"][0]  # since the start of the plan
        # A plan's duty is drawn up to its last but one knot, and that of rollouts as long.
        drawn = time < planned["time_s"][-2] - planned["time_s"][0] if panel is duty else time >= 0
        if name.endswith("planned") and panel is duty:
            drawn = slice(-1)
        np.testing.assert_allclose(curve.x, time[drawn], atol=1e-9)
        np.testing.assert_allclose(curve.y, data[column][drawn], rtol=1e-9, atol=1e-9)
    (limit,) = temperature.limits  # T_warm holds from 20 s on
    assert (limit.name, *limit.x, *limit.y) == ("T_max", 0.0, 4.0, 100.0, 100.0)


@pytest.fixture
def rollouts(model_recording) -> list[Recording]:
    """Three, 1° beside each other."""
    angle = model_recording.bend_angle
    return [
        dataclasses.replace(model_recording, bend_angle=angle + np.deg2rad(degrees))
        for degrees in (-1.0, 0.0, 1.0)
    ]


def test_pictures_and_charts_show_their_panels(planned_like_it, rollouts, tmp_path):
    panels = tracking_panels(planned_like_it, rollouts)
    figure = plots.draw(panels, "three rollouts")
    shown = chart_of(panels)
    for panel, axis, chart in zip(panels, figure.axes, shown, strict=True):
        assert axis.get_ylabel() == panel.label
        lines = axis.get_lines()
        for curve, line in zip([*panel.curves, *panel.limits], lines, strict=True):
            np.testing.assert_array_equal(line.get_xydata().T, [curve.x, curve.y])
            assert to_hex(line.get_color()) == curve.color
            wanted = {"x": curve.x, "y": curve.y}
            if curve.band is not None:
                wanted |= dict(zip(("low", "high"), curve.band, strict=True))
            drawn = next(r.data_source.data for r in chart.renderers if r.name == curve.name)
            for column, values in wanted.items():  # of which seven digits are kept
                np.testing.assert_allclose(drawn[column], values, rtol=2e-6, atol=1e-5)
        bands = [curve.band for curve in panel.curves if curve.band is not None]
        assert len(axis.collections) == len(bands)
    drawn = figure.axes[0].collections[0].get_paths()[0].vertices[:, 1]
    mean = by_name(panels[0])["simulated rollouts φ"].y
    assert (drawn.min(), drawn.max()) == pytest.approx((mean.min() - 1.96, mean.max() + 1.96))
    bend, heat = (axis.get_legend_handles_labels()[1] for axis in figure.axes[:2])
    assert bend == [
        r"reference $\varphi_{REF}$",
        r"simulated rollouts $\varphi$",
        r"plan $\varphi^*$",
    ]
    assert len(heat) == 6  # the limit has its name beside it
    assert [text.get_text() for text in figure.axes[1].texts] == ["$T_{max}$"]
    assert figure.get_suptitle() == "three rollouts"
    assert len({plot.x_range for plot in shown}) == 1

    save_figure(figure, tmp_path / "deep" / "fig5.pdf")
    pdf = (tmp_path / "deep" / "fig5.pdf").read_bytes()
    assert b"/FontFile2" in pdf  # TrueType, inside


HOSTILE = "</script><script>document.title = 'broken'</script>$$x$$ @y $name"


def test_names_are_text(tmp_path, browser):
    x = np.arange(3.0)
    panels = [Panel("a (°)", [Curve(HOSTILE, x, x, "#808080")])]
    data = {HOSTILE: tmp_path / "a b&<i>.csv"}
    page.write_page(tmp_path / "p.html", "Whole", [page.chart(panels, HOSTILE)], data=data)
    shown = browser.new_page()
    shown.goto((tmp_path / "p.html").as_uri())
    shown.get_by_text(HOSTILE, exact=True).first.wait_for()
    assert shown.title() == "Whole"
    link = shown.get_by_role("link")
    assert link.evaluate("link => link.href").endswith("/a%20b%26%3Ci%3E.csv")
    shown.close()


def test_a_click_in_the_legend_hides_a_curve_and_the_pointer_shows_values(tmp_path, browser):
    x = np.linspace(0.0, 10.0, 101)
    panels = [Panel("bend angle (°)", [Curve("φ", x, 2 * x, "#c2268f")])]
    page.write_page(tmp_path / "p.html", "One", [page.chart(panels, "φ")])
    shown = browser.new_page(viewport={"width": 900, "height": 600})
    shown.goto((tmp_path / "p.html").as_uri())
    entry = shown.locator(".bk-label")
    entry.wait_for()
    visible = "Bokeh.documents[0].get_model_by_name('φ').visible"
    assert shown.evaluate(visible)
    box = shown.locator("figure.chart").bounding_box()
    shown.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 150)
    tip = shown.locator(".bk-tooltip-row-value")
    tip.first.wait_for()
    _, time, angle = tip.all_inner_texts()
    time, angle = float(time.rstrip(" s")), float(angle.rstrip("°"))
    assert angle == pytest.approx(2 * time)
    entry.click()
    assert not shown.evaluate(visible)
    shown.close()
