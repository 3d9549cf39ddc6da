"""What results say of themselves: as text, as JSON, at a prompt and in a notebook."""

from limb_systems.summary import Entry, Summary


def test_a_summary_has_texts_for_people_and_values_for_programs():
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
    assert str(summary).splitlines() == [
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
    assert str(summary + summary) == str(summary)
