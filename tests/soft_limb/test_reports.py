"""Reports escape all texts, and begin with an interruption."""

import dataclasses
import html

import numpy as np
import pytest

from calibration import validate
from limb_systems import (
    Limb,
    LimbParameters,
    PlanCheck,
    SegmentParameters,
    WireParameters,
    simulate,
)
from soft_limb.reports import page
from soft_limb.reports.calibration_report import validation_panels
from soft_limb.reports.plan_report import write_rollout_report
from soft_limb.runs.rollout import Rollout


@pytest.fixture(scope="module")
def rollout(plan_like) -> Rollout:
    """A limb of two segments with three wires and one, 1° beside its plan, cut off on the way."""
    wires = [WireParameters(name, e2=e2) for name, e2 in (("a", -3e-3), ("b", 1e-3), ("c", 3e-3))]
    limb = LimbParameters(
        segments=[
            SegmentParameters(links=2, wires=wires),
            SegmentParameters(links=2, wires=[WireParameters("d", e2=3e-3)]),
        ]
    )
    made = simulate(Limb(limb), [0.1, 0.0, 0.0, 0.2], 2.0)
    plan = plan_like(made, check=PlanCheck(bend_band_deg=0.7))
    read = made.measured_temperature[:, :21].copy()
    read[0, 4] = 700.0
    recording = dataclasses.replace(
        made,
        time=made.time[:21],
        duty=made.duty[:, :21],
        bend_angle=made.bend_angle[:, :21] + np.deg2rad(1.0),
        measured_temperature=read,
        applied_duty=made.duty[:, :21],
        joint_state=None,
        wire_temperature=None,
        source="limb <b>7</b>",
        interrupted="the <i>a</i> wire is open",
    )
    return Rollout("plan-feedback", plan, recording, np.array([0.0, 6e-3, 0.0, 0.0]), 2, None)


@pytest.mark.filterwarnings("ignore:Left out of the tracking errors")
def test_a_report_begins_with_the_interruption(rollout, tmp_path, look_at):
    folder = tmp_path / "of <runs> & more"
    folder.mkdir()
    report = folder / "report.html"
    write_rollout_report(rollout, rollout.summary(), report, {"plan": tmp_path / "plan.csv"})
    text = report.read_text(encoding="utf-8")
    verdict = text.partition('<p class="verdict">')[2].partition("</p>")[0]
    assert verdict == html.escape(
        "Interrupted at 1.0 s of 2.0 s: the <i>a</i> wire is open. Mean distance: measured 1.00°, "
        "planned 0.00°, best possible within the limits 0.00°. "
        "Doubtful: 1 of 21 samples out of range, the first at 0.2 s; they do not count."
    )
    assert "<b>7" not in text
    assert '<a href="../plan.csv">' in text
    look_at(report)


def test_a_page_holds_its_parts_as_text():
    made = page.make_page(
        "a < b & c",
        [
            page.section("Q = <Q>", page.paragraph("φ & <b>"), page.items(["<i>", "2"])),
            page.preformatted("k:  1\n  <l>"),
            page.table(["name", "°"], [["<k>", "-1.5"], ["b", "± 2"]], "measured & counted"),
        ],
    )
    for text in (
        "<title>a &lt; b &amp; c</title>",
        "<h1>a &lt; b &amp; c</h1>",
        '<h2 id="section-1">Q = &lt;Q&gt;</h2>',
        "<p>φ &amp; &lt;b&gt;</p>",
        "<ul><li>&lt;i&gt;</li><li>2</li></ul>",
        "<pre>k:  1\n  &lt;l&gt;</pre>",
        "<tr><th>name</th><th>°</th></tr>",
        "<tr><td>b</td><td>±\u00a02</td></tr>",  # no line break within
        "<figcaption>measured &amp; counted</figcaption>",
    ):
        assert text in made, text


def test_validation_draws_the_bend_of_each_segment():
    limb = LimbParameters(segments=[SegmentParameters(links=2) for _ in range(3)])
    recording = simulate(Limb(limb), [0.0, 0.2] * 3, 1.0)
    labels = [panel.label for panel in validation_panels(validate(limb, recording))]
    assert labels[:3] == [f"bend angle of segment {number} (°)" for number in (1, 2, 3)]
