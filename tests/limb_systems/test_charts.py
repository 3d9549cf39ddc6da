"""Charts show what is in the files, and the pages that hold them need nothing else."""

import base64
import dataclasses
import gzip
import itertools
import json
import re

import numpy as np
import pytest

from limb_systems import Limb, LimbParameters, PlanCheck, Recording, Trajectory, simulate
from limb_systems.views import charts, page
from limb_systems.views.charts import Curve, panel, stacked, tracking_chart


def items_of(html: str) -> list[dict]:
    """The charts of a page, as BokehJS reads them."""
    return [
        json.loads(text)
        for text in re.findall(r'<script type="application/json">(.*?)</script>', html, re.DOTALL)
    ]


def models_of(item: dict) -> dict[str, dict]:
    """The models of a chart by their ids."""
    found = {}

    def look(part):
        if isinstance(part, dict):
            if part.get("type") == "object" and "id" in part:
                found[part["id"]] = part
            for value in part.values():
                look(value)
        elif isinstance(part, list):
            for value in part:
                look(value)

    look(item["doc"])
    return found


def value_of(models: dict, part):
    """What a part of a chart's JSON stands for: arrays, maps and references."""
    if not isinstance(part, dict):
        return part
    if part.get("type") == "ndarray":
        data = gzip.decompress(base64.b64decode(part["array"]["data"]))
        return np.frombuffer(data, part["dtype"]).reshape(part["shape"])
    if part.get("type") == "map":
        return {key: value_of(models, value) for key, value in part["entries"]}
    return models[part["id"]] if set(part) == {"id"} else part


def curves_of(item: dict) -> list[dict[str, tuple[np.ndarray, ...]]]:
    """x, y, low and high, as far as there are such, of each panel's curves by their names."""
    models, panels = models_of(item), []
    for plot in models.values():
        if plot["name"] != "Figure":
            continue
        curves = {}
        for part in plot["attributes"]["renderers"]:
            renderer = value_of(models, part)
            source = value_of(models, renderer["attributes"]["data_source"])
            data = value_of(models, source["attributes"]["data"])
            if name := renderer["attributes"].get("name"):
                columns = [
                    value_of(models, data[key]) for key in ("x", "y", "low", "high")[: len(data)]
                ]
                curves[name] = tuple(columns)
        panels.append(curves)
    return panels


def chart_of(model) -> dict:
    (item,) = items_of(page.chart(model, "a chart"))
    return item


@pytest.fixture(scope="module")
def model_recording():
    return simulate(Limb(), [0.05, 0.3], 4.0)


def plan_like(recording: Recording) -> Trajectory:
    """Not a plan, but a trajectory with the samples of a recording of a model."""
    return Trajectory(
        time=recording.time + 3.0,
        reference=recording.bend_angle + 0.1,
        duty=recording.duty,
        joint_state=recording.joint_state,
        wire_temperature=recording.wire_temperature,
        measured_temperature=recording.measured_temperature,
        parameters=recording.parameters,
        check=PlanCheck(),
    )


def test_the_data_of_a_chart_is_that_of_the_files(model_recording, tmp_path):
    plan_like(model_recording).save(tmp_path / "plan.csv")
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
    chart = tracking_chart(
        Trajectory.load(tmp_path / "plan.csv"), [Recording.load(tmp_path / "recording.csv")]
    )
    bend, temperature, duty = curves_of(chart_of(chart))
    for curve, data, column in (
        (bend["simulated φ"], recorded, "bend_angle_deg"),
        (bend["plan φ*"], planned, "bend_angle_deg"),
        (bend["reference φ_REF"], planned, "reference_angle_deg"),
        (temperature["right, V simulated"], recorded, "measured_temperature_right_c"),
        (temperature["left, T* planned"], planned, "wire_temperature_left_c"),
        (duty["right, D"], recorded, "duty_right"),
    ):
        # Time is since the start of the plan; seven digits are kept.
        np.testing.assert_allclose(curve[0], data["time_s"] - data["time_s"][0], rtol=1e-5)
        np.testing.assert_allclose(curve[1], data[column], rtol=2e-6, atol=1e-5)


def test_several_rollouts_are_their_mean_and_band_of_95_percent(model_recording):
    shifted = [
        dataclasses.replace(
            model_recording, bend_angle=model_recording.bend_angle + np.deg2rad(degrees)
        )
        for degrees in (-1.0, 0.0, 1.0)
    ]
    bend, *_ = curves_of(chart_of(tracking_chart(plan_like(model_recording), shifted)))
    x, y, low, high = bend["simulated rollouts φ"]
    np.testing.assert_allclose(y, np.rad2deg(model_recording.bend_angle[0]), atol=1e-4)
    np.testing.assert_allclose(high - y, 1.96, atol=1e-4)  # s = 1°
    np.testing.assert_allclose(y - low, 1.96, atol=1e-4)
    assert len(x) == len(model_recording.time)


def test_panels_share_one_time_axis_and_each_segment_has_its_own(three_and_one):
    wires, joints = len(three_and_one.wires), three_and_one.num_joints
    warm = np.arange(2.0 * wires).reshape(wires, 2)
    plan = Trajectory(
        time=np.array([0.0, 30.0]),
        reference=np.zeros((2, 2)),
        duty=warm / 10,
        joint_state=np.zeros((2 * joints, 2)),
        wire_temperature=25.0 + warm,
        measured_temperature=25.0 + warm,
        parameters=three_and_one,
        check=PlanCheck(),
    )
    item = chart_of(tracking_chart(plan))
    plots = [model for model in models_of(item).values() if model["name"] == "Figure"]
    assert len(plots) == 6
    assert len({plot["attributes"]["x_range"]["id"] for plot in plots}) == 1
    panels = curves_of(item)
    assert list(panels[2]) == ["low, D* planned", "middle, D* planned", "high, D* planned"]
    np.testing.assert_allclose(panels[5]["only, D* planned"][1], plan.duty[3], rtol=1e-6)


def test_long_curves_keep_their_extremes():
    x = np.arange(50_000.0)
    y = np.sin(x / 500)
    y[12_345], y[40_001] = 90.0, -70.0
    (curves,) = curves_of(chart_of(stacked([panel("a (°)", [Curve("long", x, y, "#808080")])])))
    shown, values = curves["long"]
    assert len(shown) <= charts.MAX_POINTS
    assert shown[np.argmax(values)] == 12_345
    assert shown[np.argmin(values)] == 40_001
    assert shown[0] == 0.0
    assert shown[-1] == 49_999


def test_a_page_has_bokeh_once_and_is_the_same_each_time(model_recording, tmp_path):
    def write(name: str) -> str:
        parts = [
            page.chart(tracking_chart(plan_like(model_recording), recordings), 'the "bend"')
            for recordings in ([], [model_recording])
        ]
        page.write_page(tmp_path / name, "Two charts", parts)
        return (tmp_path / name).read_text(encoding="utf-8")

    text = write("first.html")
    assert write("second.html") == text
    assert text.count("Bokeh.embed.embed_item(") == 1
    assert 1e6 < len(text) < 2e6  # one BokehJS
    assert 'aria-label="the &quot;bend&quot;"' in text
    outside = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r"(src|href)=|@import|<link", outside)
    page.write_page(
        tmp_path / "none.html", "No chart", [page.preformatted('<figure class="chart"')]
    )
    assert (tmp_path / "none.html").stat().st_size < 1e4


HOSTILE = "</script><script>document.title = 'broken'</script>$$x$$ @y $name"


def test_names_are_text(tmp_path, browser):
    x = np.arange(3.0)
    chart = stacked([panel("a (°)", [Curve(HOSTILE, x, x, "#808080")])])
    parts = [page.chart(chart, HOSTILE), page.links(tmp_path / "p.html", {HOSTILE: "a b&<i>.csv"})]
    page.write_page(tmp_path / "p.html", "Whole", parts)
    shown = browser.new_page()
    shown.goto((tmp_path / "p.html").as_uri())
    shown.get_by_text(HOSTILE, exact=True).first.wait_for()
    assert shown.title() == "Whole"
    link = shown.get_by_role("link")
    assert link.evaluate("link => link.href").endswith("/a%20b%26%3Ci%3E.csv")
    shown.close()


def test_a_long_name_makes_no_page_wider_than_a_phone(tmp_path, look_at):
    name = "model, k = 0.1255 N·m/rad (the data do not determine it)"
    chart = panel("sag (°)", [Curve(name, np.arange(3.0), np.arange(3.0), "#4270ec")])
    page.write_page(tmp_path / "long.html", "Long", [page.chart(stacked([chart]), "sag")])
    look_at(tmp_path / "long.html")


def test_a_click_in_the_legend_hides_a_curve_and_the_pointer_shows_values(tmp_path, browser):
    x = np.linspace(0.0, 10.0, 101)
    chart = stacked([panel("bend angle (°)", [Curve("φ", x, 2 * x, "#c2268f")])])
    page.write_page(tmp_path / "p.html", "One", [page.chart(chart, "φ")])
    shown = browser.new_page(viewport={"width": 900, "height": 600})
    shown.goto((tmp_path / "p.html").as_uri())
    entry = shown.get_by_text("φ", exact=True)
    entry.wait_for()
    visible = "Bokeh.documents[0].get_model_by_name('φ').visible"
    assert shown.evaluate(visible)
    box = shown.locator("figure.chart").bounding_box()
    shown.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 150)
    tip = shown.locator(".bk-tooltip-row-value")
    tip.first.wait_for()
    time, angle = (float(text.rstrip(" s°")) for text in tip.all_inner_texts())
    assert angle == pytest.approx(2 * time)
    entry.click()
    assert not shown.evaluate(visible)
    shown.close()


def test_limits_are_from_when_they_hold():
    recording = simulate(Limb(LimbParameters()), [0.0, 0.0], 1.0)
    _, temperature, _ = curves_of(chart_of(tracking_chart(plan_like(recording))))
    assert temperature["T_max"][0].tolist() == [0.0, 1.0]
    assert "T_warm" not in temperature  # it holds from 20 s on
