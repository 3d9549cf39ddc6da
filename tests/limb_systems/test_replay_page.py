"""What a replay's page holds."""

import itertools
import re
import sys
from pathlib import Path

import matplotlib.colors
import numpy as np
import pytest

from limb_systems import (
    LimbError,
    LimbParameters,
    Recording,
    bend_angle,
    joint_angles_from_bend_angle,
    tip_position,
    wire_color,
    write_meshcat_replay,
)
from limb_systems.views import colors

sys.path.insert(0, str(Path(__file__).parent))

from meshcat_page import (
    LIMB,
    Tags,
    animation,
    check_bodies,
    commands,
    make_plan,
    make_recording,
    poses_at,
    readouts,
    srgb,
)


@pytest.fixture
def modelled(two_segments) -> Recording:
    """A recording of a model, whose joints do not bend alike and whose V lags behind T."""
    rng = np.random.default_rng(5)
    angles = np.cumsum(rng.normal(0, 0.02, (5, 41)), axis=1)
    rates = rng.normal(0, 0.1, (5, 41))
    heat = 25 + 75 * rng.random((4, 41))
    heat[:, 0], heat[:, 40] = 25.0, 100.0
    recording = make_recording(
        two_segments, joint_state=np.vstack([angles, rates]), wire_temperature=heat
    )
    recording.bend_angle = bend_angle(two_segments, angles)
    recording.duty = rng.random((4, 41))
    return recording


def test_wire_color_runs_from_greyish_blue_at_ambient_to_orange_at_the_maximum():
    parameters = LimbParameters(ambient_temperature=10.0)
    parameters.temperature_limits.maximum = 90.0
    cold, hot = wire_color(parameters, [10.0, 90.0])
    assert cold[2] > cold[1] > cold[0]
    assert hot[0] > hot[1] + 0.3 > hot[2] + 0.6
    np.testing.assert_array_equal(wire_color(parameters, [-40.0, 400.0]), [cold, hot])
    between = wire_color(parameters, np.linspace(10.0, 90.0, 101))
    # Heat can be told from any colour: red less blue only ever grows.
    assert (np.diff(between[:, 0] - between[:, 2]) > 0).all()


def replay(tmp_path, motion, **options) -> str:
    write_meshcat_replay(tmp_path / "replay.html", motion, **options)
    return (tmp_path / "replay.html").read_text(encoding="utf-8")


def test_links_and_wires_are_as_the_model_s_recording_says(tmp_path, modelled):
    parameters = modelled.parameters
    page = replay(tmp_path, modelled)
    tracks, options, rate = animation(page)
    assert rate == pytest.approx(20.0)
    assert len(tracks[f"{LIMB}/link_1", "quaternion"]) == 41
    for frame in (0, 1, 23, 40):
        check_bodies(poses_at(tracks, frame), parameters, modelled.joint_state[:5, frame])
    assert options["play"] is True
    assert options["repetitions"] > 10_000

    meshes = {c["path"] for c in commands(page) if c["type"] == "set_object"}
    num_tracks = 0
    for wire, (links, side) in enumerate(itertools.product([(1, 2), (3, 4, 5)], ["left", "right"])):
        expected = wire_color(parameters, modelled.wire_temperature[wire])
        for link in links:
            path = f"{LIMB}/link_{link}/limb/wire_{side}"
            assert path in meshes
            shown = srgb(tracks[f"{path}/<object>", "material.color"])
            np.testing.assert_allclose(shown, expected, atol=1e-9)
            num_tracks += 1
    assert num_tracks == sum(name == "material.color" for _, name in tracks)

    limb, *wires = np.split(readouts(page), [2, 4, 6, 8])
    np.testing.assert_allclose(limb, np.rad2deg(modelled.bend_angle), atol=0.0501)
    for wire, (heat, duty) in enumerate(wires):
        np.testing.assert_allclose(heat, modelled.wire_temperature[wire], atol=0.0501)
        np.testing.assert_allclose(duty, modelled.duty[wire], atol=0.00501)
    assert "nothing measured" in page.split('id="caption"')[1]
    assert not any(
        "ghosts" in c["path"] for c in commands(page) if c["type"] == "set_object"
    )  # there is no reference
    assert "reference" not in page.split('id="caption"')[1]


def test_beside_a_recording_ghosts_keep_to_the_time_of_the_plan(tmp_path, two_segments):
    plan, recording = make_plan(two_segments), make_recording(two_segments)
    recording.duty = np.random.default_rng(3).random((4, 41))
    page = replay(tmp_path, recording, plan=plan)
    tracks, _, _ = animation(page)
    limb, reference, planned, *wires = np.split(readouts(page), [2, 4, 6, 8, 10, 12])
    np.testing.assert_allclose(limb, np.rad2deg(recording.bend_angle), atol=0.0501)
    for wire, (heat, duty) in enumerate(wires):
        np.testing.assert_allclose(heat, recording.measured_temperature[wire], atol=0.0501)
        np.testing.assert_allclose(duty, recording.duty[wire], atol=0.00501)
    # The recording begins 3 s after the plan, which ends 1 s later; both go on for another 1 s.
    for frame, knot in ((0, 6), (10, 7), (20, 8), (33, 8), (40, 8)):
        pose_of, angles = poses_at(tracks, frame), plan.joint_angles[:, knot]
        check_bodies(pose_of, two_segments, angles, "plan")
        wanted = joint_angles_from_bend_angle(two_segments, plan.reference[:, knot])
        check_bodies(pose_of, two_segments, wanted, "reference")
        for shown, expected in ((reference, plan.reference), (planned, plan.bend_angle)):
            degrees = np.rad2deg(expected[:, knot])
            np.testing.assert_allclose(shown[:, frame], degrees, atol=0.0501)
    halfway = joint_angles_from_bend_angle(two_segments, plan.reference[:, 6:8].mean(axis=1))
    check_bodies(poses_at(tracks, 5), two_segments, halfway, "reference")
    # Cubic between the knots: the mean, and h/8 times the difference of the rates.
    angles, rates = plan.joint_angles[:, 6:8], plan.joint_rates[:, 6:8]
    halfway = angles.mean(axis=1) + 0.5 / 8 * (rates[:, 0] - rates[:, 1])
    check_bodies(poses_at(tracks, 5), two_segments, halfway, "plan")
    # What was measured stays where it was measured.
    measured = joint_angles_from_bend_angle(two_segments, recording.bend_angle[:, 10])
    check_bodies(poses_at(tracks, 10), two_segments, measured)
    # A plan of another limb is no ghost of this one.
    with pytest.raises(LimbError, match="of other segments than the motion's"):
        replay(tmp_path, recording, plan=make_plan(LimbParameters()))

    actual = {
        command["path"]: command["object"]["materials"][0]
        for command in commands(page)
        if command["type"] == "set_object" and "ghosts" in command["path"]
    }
    assert len(actual) == 2 * 5
    for path, material in actual.items():
        color = colors.PLAN_COLOR if "ghosts/plan" in path else colors.REFERENCE_COLOR
        assert f"#{material['color']:06x}" == matplotlib.colors.to_hex(color)

    caption = page.split('id="caption"')[1]
    assert "recorded bend angle (a test)" in caption
    assert re.search(r"--rgb: 66 112 236[^>]*></i>plan φ", caption)  # #4270ec
    assert re.search(r"--rgb: 153 153 153[^>]*></i>reference φ", caption)
    for name in ("left 1", "right 1", "left 2", "right 2"):
        assert f"<span>{name} <output>" in caption


def test_in_space_links_ghosts_and_paths_of_tips_are_where_kinematics_says(tmp_path):
    limb = LimbParameters.in_space(wires=4, links=3)
    limb.segments[0].centred_joints = True
    plan, recording = make_plan(limb), make_recording(limb)
    page = replay(tmp_path, recording, plan=plan)
    tracks, _, _ = animation(page)
    frame, knot = 20, 8
    bent = joint_angles_from_bend_angle(limb, recording.bend_angle)
    wanted = joint_angles_from_bend_angle(limb, plan.reference[:, knot])
    pose_of = poses_at(tracks, frame)
    check_bodies(pose_of, limb, bent[:, frame])
    check_bodies(pose_of, limb, plan.joint_angles[:, knot], "plan")
    check_bodies(pose_of, limb, wanted, "reference")
    dots = {
        command["path"]: np.frombuffer(
            command["object"]["geometries"][0]["data"]["attributes"]["position"]["array"], "<f4"
        ).reshape(-1, 3)
        for command in commands(page)
        if command["type"] == "set_object" and command["path"].endswith("/tip")
    }
    np.testing.assert_allclose(dots["/drake/ghosts/tip"], tip_position(limb, bent).T, atol=1e-7)
    last = tip_position(limb, plan.joint_angles[:, -1])
    np.testing.assert_allclose(dots["/drake/ghosts/plan/tip"][-1], last, atol=1e-7)
    assert {"/drake/ghosts/reference/tip"} < set(dots)
    assert readouts(page).shape == (3 * 2 + 2 * 4, 41)
    caption = page.split('id="caption"')[1]
    assert "wire_1 0°, wire_2 90°, wire_3 180°, wire_4 -90°" in caption
    assert "φ<sub>e3</sub>" in caption


def test_the_page_needs_nothing_but_itself_and_its_title_is_text(tmp_path):
    page = replay(tmp_path, make_recording(LimbParameters()), title="$a {{ b }} <script>&</script>")
    parser = Tags()
    parser.feed(page)
    assert ("div", {"id": "meshcat-pane"}) in parser.found
    assert ("div", {"id": "caption"}) in parser.found
    for tag, attributes in parser.found:
        assert tag not in ("link", "img", "iframe", "object", "embed")
        assert not {"src", "href"} & set(attributes)
    assert len(re.findall(r'fetch\("(?!data:)', page)) == 0
    assert len(page) < 4e6
    assert "<b>$a {{ b }} &lt;script&gt;&amp;&lt;/script&gt;</b>" in page
    assert "upper wire: right, lower wire: left" in page
