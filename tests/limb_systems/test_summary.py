"""What results say of themselves: as text, as JSON, at a prompt and in a notebook."""

import dataclasses

import numpy as np

from limb_systems import Limb, PlanCheck, simulate
from limb_systems.summary import Entry, Summary
from limb_systems.views.plots import plot_tracking


def test_a_summary_is_told_to_people_and_to_programs():
    summary = Summary(
        [
            Entry("duration", 60.0, "s"),
            Entry("samples", 601, "", "601 knots"),
            Entry("bend", [-20.25, 25.0], "°"),
            Entry("replans"),
            Entry("remark", None, "", "all is well"),
            Entry("limb", "a <limb>"),
        ],
        details=[Entry("right.a1", -0.07, "1/s"), Entry("late", 0.1, "ms", None)],
    )
    assert summary.line() == "60 s, 601 knots, -20.25, 25°, all is well, a <limb>"
    assert summary.lines() == [
        "duration    60 s",
        "samples     601 knots",
        "bend        -20.25, 25°",
        "remark      all is well",
        "limb        a <limb>",
        "right.a1    -0.07 1/s",
    ]
    assert summary.to_json() == {
        "duration": 60.0,
        "samples": 601,
        "bend": [-20.25, 25.0],
        "replans": None,
        "limb": "a <limb>",
        "right.a1": -0.07,
        "late": 0.1,
    }
    table = summary.to_html("Things")
    assert table.count("<tr>") == 6
    assert "a &lt;limb&gt;" in table
    assert (summary + summary).lines() == summary.lines()


def test_a_trajectory_is_a_line_and_a_small_table(fig5_plan):
    assert repr(fig5_plan) == "Trajectory(60 s, 601 knots, bend -20° to 25°, checked)"
    assert fig5_plan._repr_html_().count("<tr>") == 4
    failed = dataclasses.replace(fig5_plan.check, largest_defect=1.0)
    assert "failed its check" in repr(dataclasses.replace(fig5_plan, check=failed))
    assert "not checked" in repr(dataclasses.replace(fig5_plan, check=PlanCheck()))


def test_a_recording_says_where_it_is_from():
    recording = simulate(Limb(), [0.0, 0.1], 4.0, sample_rate=10.0)
    recording.source = "a <limb>"
    assert repr(recording).startswith("Recording(a <limb>, 4 s, 41 samples, bend 0° to ")
    assert "a &lt;limb&gt;" in recording._repr_html_()
    nothing = dataclasses.replace(
        recording,
        **{
            name: np.zeros((*getattr(recording, name).shape[:-1], 0))
            for name in ("time", "duty", "measured_temperature", "bend_angle")
        },
        wire_temperature=None,
        joint_state=None,
    )
    assert repr(nothing) == "Recording(a <limb>, no samples)"


def test_figures_show_in_notebooks(fig5_plan):
    assert plot_tracking(fig5_plan)._repr_png_().startswith(b"\x89PNG")
