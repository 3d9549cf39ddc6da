"""What a replay's page holds."""

import html.parser
import itertools
import json
import logging
import re
import socket
import sys
from pathlib import Path

import matplotlib.colors
import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RotationMatrix

from limb_systems import (
    Layout,
    LimbError,
    LimbParameters,
    PlanCheck,
    Recording,
    Trajectory,
    bend_angle,
    joint_angles_from_bend_angle,
    tip_position,
    wire_color,
    write_meshcat_replay,
)
from limb_systems.model.kinematics import link_positions
from limb_systems.views import colors, replay_page

sys.path.insert(0, str(Path(__file__).parent))

from meshcat_page import (
    LIMB,
    animation,
    boxes,
    by_equation_11,
    check_ghost,
    check_link_poses,
    commands,
    link_poses,
    make_plan,
    make_recording,
    properties,
    srgb,
    transforms,
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
        check_link_poses(tracks, frame, parameters, modelled.joint_state[:5, frame])
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
    assert not any("ghosts" in path for path in boxes(page))  # there is no reference
    assert "reference" not in page.split('id="caption"')[1]


def test_without_joint_angles_the_bend_angle_and_measured_temperature_are_shown(
    tmp_path, two_segments
):
    recording = make_recording(two_segments)
    page = replay(tmp_path, recording)
    tracks, _, _ = animation(page)
    frame = 20
    for segment, last in ((0, 2), (1, 5)):
        # The chord of the segment, seen from its base, points to the bend angle.
        angles = joint_angles_from_bend_angle(two_segments, recording.bend_angle[:, frame])
        poses = link_poses(two_segments, angles)
        first = Layout(two_segments).joints_of[segment].start
        chord = poses[last][0] - poses[first][0]
        base = poses[first][1] - angles[first]
        assert np.arctan2(chord[1], chord[0]) - base == pytest.approx(
            recording.bend_angle[segment, frame]
        )
    check_link_poses(tracks, frame, two_segments, angles)
    shown = srgb(tracks[f"{LIMB}/link_1/limb/wire_left/<object>", "material.color"][frame])
    np.testing.assert_allclose(shown, wire_color(two_segments, 100.0), atol=1e-9)
    assert "measured temperature" in page.split('id="caption"')[1]


def test_a_trajectory_is_cubic_between_its_knots(tmp_path):
    parameters, heat = LimbParameters(), np.full((2, 2), 25.0)
    trajectory = Trajectory(
        time=np.array([0.0, 1.0]),
        reference=np.zeros((1, 2)),
        duty=np.zeros((2, 2)),
        joint_state=np.vstack([np.zeros((5, 2)), np.tile([0.4, -0.4], (5, 1))]),
        wire_temperature=heat,
        measured_temperature=heat,
        parameters=parameters,
        check=PlanCheck(),
    )
    page = replay(tmp_path, trajectory, frames_per_second=10.0)
    tracks, _, rate = animation(page)
    assert rate == pytest.approx(10.0)
    check_link_poses(tracks, 5, parameters, np.full(5, 0.1))  # θ(1/2) = (1/8) (0.4 + 0.4)
    check_link_poses(tracks, 10, parameters, np.zeros(5))
    assert "wire temperature" in page.split('id="caption"')[1]


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
        check_ghost("plan", tracks, frame, two_segments, plan.joint_angles[:, knot])
        wanted = by_equation_11(two_segments, plan.reference[:, knot])
        check_ghost("reference", tracks, frame, two_segments, wanted)
        for shown, expected in ((reference, plan.reference), (planned, plan.bend_angle)):
            degrees = np.rad2deg(expected[:, knot])
            np.testing.assert_allclose(shown[:, frame], degrees, atol=0.0501)
    halfway = plan.reference[:, 6:8].mean(axis=1)
    check_ghost("reference", tracks, 5, two_segments, by_equation_11(two_segments, halfway))
    # Cubic between the knots: the mean, and h/8 times the difference of the rates.
    angles, rates = plan.joint_angles[:, 6:8], plan.joint_rates[:, 6:8]
    halfway = angles.mean(axis=1) + 0.5 / 8 * (rates[:, 0] - rates[:, 1])
    check_ghost("plan", tracks, 5, two_segments, halfway)
    # What was measured stays where it was measured.
    measured = by_equation_11(two_segments, recording.bend_angle[:, 10])
    check_link_poses(tracks, 10, two_segments, measured)

    # Faces of ghosts and limb in one plane would flicker.
    shapes, poses, heights = boxes(page), transforms(page), []
    for path, (_, thickness, height) in shapes.items():
        if "ghosts" in path and path.endswith(("link_1/strip", "link_1/line")):
            top = poses[path][2, 3] + height / 2
            heights += [top, top - height]
            assert thickness < 0.01
    distances = np.diff(np.sort([*heights, 0.02 / 2]))  # the limb's top
    assert len(distances) == 8
    assert distances.min() > 1e-4

    found = {
        command["path"]: command["object"]["materials"][0]
        for command in commands(page)
        if command["type"] == "set_object" and "ghosts" in command["path"]
    }
    assert len(found) == 2 * 2 * 5
    for path, material in found.items():
        color = colors.PLAN_COLOR if "ghosts/plan" in path else colors.REFERENCE_COLOR
        assert f"#{material['color']:06x}" == matplotlib.colors.to_hex(color)
        assert material["opacity"] == pytest.approx(0.5 if path.endswith("strip") else 1.0)
        assert material["transparent"] == path.endswith("strip")

    caption = page.split('id="caption"')[1]
    assert "recorded bend angle (a test)" in caption
    assert re.search(r"--rgb: 66 112 236[^>]*></i>plan φ", caption)  # #4270ec
    assert re.search(r"--rgb: 153 153 153[^>]*></i>reference φ", caption)
    assert "duty from 0 to 1: left 1, right 1, left 2, right 2" in caption
    for name in ("left 1", "right 1", "left 2", "right 2"):
        assert f"<span>{name} <output>" in caption


def test_beside_a_planned_motion_a_plan_starts_with_it(tmp_path, two_segments):
    motion, plan = make_plan(two_segments), make_plan(two_segments)
    plan.time += 2.0
    plan.joint_state *= 0.5
    tracks, _, _ = animation(replay(tmp_path, motion, plan=plan))
    for frame, knot in ((0, 0), (50, 5), (80, 8)):
        check_ghost("plan", tracks, frame, two_segments, plan.joint_angles[:, knot])
        check_link_poses(tracks, frame, two_segments, motion.joint_angles[:, knot])


def test_without_a_plan_the_ghost_is_the_motion_s_own_reference(tmp_path, two_segments):
    for make, said in ((make_plan, "planned motion, nothing measured"), (make_recording, "a test")):
        motion = make(two_segments)
        motion.reference = np.outer([0.4, -0.3], np.sin(motion.time))
        page = replay(tmp_path, motion, frames_per_second=20.0)
        tracks, _, _ = animation(page)
        step = round(20.0 * (motion.time[1] - motion.time[0]))
        for sample in (0, 3, len(motion.time) - 1):
            angles = by_equation_11(two_segments, motion.reference[:, sample])
            check_ghost("reference", tracks, sample * step, two_segments, angles)
        assert not any("ghosts/plan" in path for path, _ in tracks)
        assert said in page.split('id="caption"')[1]


def test_bars_are_filled_by_duty(tmp_path, two_segments):
    rng = np.random.default_rng(3)
    recording = make_recording(two_segments)
    recording.duty = rng.random((4, 41))
    recording.duty[:, :2] = [0.0, 1.0]
    page = replay(tmp_path, recording)
    tracks, _, _ = animation(page)
    shapes, poses = boxes(page), transforms(page)
    lefts = []
    for wire, name in enumerate(["left_1", "right_1", "left_2", "right_2"]):
        path = f"/drake/duty/{name}"
        bar, track = shapes[f"{path}/fill/bar"], shapes[f"{path}/track"]
        scale = tracks[f"{path}/fill", "scale"]
        center = scale * (poses[f"{path}/fill/bar"] @ [0, 0, 0, 1])[:3]  # pushed along
        low, high = center[:, 1] - scale[:, 1] * bar[1] / 2, center[:, 1] + scale[:, 1] * bar[1] / 2
        np.testing.assert_allclose(high - low, recording.duty[wire] * bar[1], atol=1e-12)
        np.testing.assert_allclose(low, 0.0, atol=1e-12)
        # Full, the track is seen all around; it is wider by one margin.
        middle = poses[f"{path}/track"][1, 3]
        assert middle == pytest.approx(bar[1] / 2)
        assert track[1] - bar[1] == pytest.approx(track[0] - bar[0])
        assert 0 < track[1] - bar[1] < 0.1 * bar[1]
        outline = shapes[f"{path}/outline"]
        assert (outline[:2] > track[:2]).all()
        x = poses[path][0, 3]
        lefts += [x - outline[0] / 2, x + outline[0] / 2]
    # Beside each other, and all of them left of the base, which is 6 mm deep.
    assert (np.diff(lefts) > 0).all()
    assert lefts[-1] < -0.006


def test_any_number_of_wires_is_shown_by_name(tmp_path, three_and_one):
    recording = make_recording(three_and_one)
    recording.duty = np.random.default_rng(3).random((4, 41))
    page = replay(tmp_path, recording)
    tracks, _, _ = animation(page)
    for wire, (name, link) in enumerate(
        (("low", 1), ("middle", 2), ("high", 2), ("only", 5)),
    ):
        expected = wire_color(three_and_one, recording.measured_temperature[wire])
        color = tracks[f"{LIMB}/link_{link}/limb/wire_{name}/<object>", "material.color"]
        np.testing.assert_allclose(srgb(color), expected, atol=1e-9)
    bars = {path: pose[0, 3] for path, pose in transforms(page).items() if "/duty/" in path}
    names = ("low_1", "middle_1", "high_1", "only_2")
    places = [bars[f"/drake/duty/{name}"] for name in names]
    within, _, between = np.diff(places)
    assert 0 < within < between
    scales = [tracks[f"/drake/duty/{name}/fill", "scale"][:, 1] for name in names]
    np.testing.assert_allclose(scales, recording.duty)
    caption = page.split('id="caption"')[1]
    assert "wires from top to bottom: high, middle, low; only" in caption
    assert "duty from 0 to 1: low 1, middle 1, high 1, only 2" in caption
    assert readouts(page).shape == (2 + 2 * 4, 41)


def test_in_space_links_ghosts_and_paths_of_tips_are_where_kinematics_says(tmp_path):
    limb = LimbParameters.in_space(wires=4, links=3)
    limb.segments[0].centred_joints = True
    plan, recording = make_plan(limb), make_recording(limb)
    page = replay(tmp_path, recording, plan=plan)
    tracks, _, _ = animation(page)
    frame, knot = 20, 8
    bent = joint_angles_from_bend_angle(limb, recording.bend_angle)
    wanted = joint_angles_from_bend_angle(limb, plan.reference[:, knot])
    bodies = ("root_1", "link_1", "link_2", "link_3")
    for body, place in zip(bodies, link_positions(limb, bent[:, frame]), strict=False):
        shown = tracks[f"{LIMB}/{body}", "position"][frame]
        np.testing.assert_allclose(shown, place, atol=1e-12)
    for name, angles in (("plan", plan.joint_angles[:, knot]), ("reference", wanted)):
        path, pose = f"/drake/ghosts/{name}", RigidTransform()
        for body, place in zip(bodies, link_positions(limb, angles), strict=False):
            path += f"/{body}"
            x, y, z, w = tracks[path, "quaternion"][frame]
            turn = RotationMatrix(Quaternion(np.array([w, x, y, z]) / np.linalg.norm([w, x, y, z])))
            pose = pose @ RigidTransform(turn, tracks[path, "position"][frame])
            np.testing.assert_allclose(pose.translation(), place, atol=1e-7)
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


def readouts(page: str) -> np.ndarray:
    """What each output of the caption says in each frame (R, F)."""
    parser = Tags()
    parser.feed(page)
    values = json.loads(re.search(r"const values = (.*);$", page, re.MULTILINE)[1])
    assert len([tag for tag, _ in parser.found if tag == "output"]) == 1 + len(values)  # a clock
    (slider,) = (attributes for tag, attributes in parser.found if tag == "input")
    assert (slider["type"], slider["min"]) == ("range", "0")
    assert all(len(row) == int(slider["max"]) + 1 for row in values)
    return np.array(values)


def test_the_replay_lasts_as_long_as_the_recording(tmp_path):
    for num_samples, frames_per_second in ((2, 20.0), (15, 0.1), (41, 49.0), (64, 7.3)):
        recording = make_recording(LimbParameters(), num_samples)
        page = replay(tmp_path, recording, frames_per_second=frames_per_second)
        tracks, _, rate = animation(page)
        for track in tracks.values():
            assert (len(track) - 1) / rate == pytest.approx(2.0)
        assert float(re.search(r"const rate = (\S+);", page)[1]) == pytest.approx(rate)
        angles = joint_angles_from_bend_angle(LimbParameters(), recording.bend_angle[:, -1])
        check_link_poses(tracks, -1, LimbParameters(), angles)


@pytest.mark.parametrize("bend_angle", [-0.4, 1.6])
def test_the_camera_sees_the_whole_motion_and_little_else(tmp_path, bend_angle):
    parameters = LimbParameters()
    recording = make_recording(parameters)
    recording.bend_angle *= bend_angle / recording.bend_angle.max()
    plan = make_plan(parameters)
    plan.joint_state *= abs(bend_angle)
    page = replay(tmp_path, recording, plan=plan)
    scene = properties(page)
    camera = "/Cameras/default/rotated/<object>"
    (target,) = (np.array(c["value"]) for c in commands(page) if c["type"] == "set_target")
    eye = scene[camera, "position"]
    angles = joint_angles_from_bend_angle(parameters, recording.bend_angle)
    ends = np.array([end for column in angles.T for end, _ in link_poses(parameters, column)])
    ghosts = plan.joint_angles.T
    ends = np.vstack([ends, *([e for e, _ in link_poses(parameters, column)] for column in ghosts)])
    points = np.vstack([ends + np.array([0, 0, height]) for height in (-0.01, 0.01)])
    for name in ("left", "right"):
        path = f"/drake/duty/{name}"
        center = (transforms(page)[path] @ transforms(page)[f"{path}/outline"])[:3, 3]
        half = boxes(page)[f"{path}/outline"] / 2
        points = np.vstack([points, center + half, center - half])
    points = points[:, [0, 2, 1]] * [1, 1, -1]  # as three.js counts: E1, E3, -E2
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    np.testing.assert_allclose(right, [1, 0, 0], atol=1e-9)  # E1 points to the right
    assert up @ [0, 0, -1] > 0.8  # and E2 up
    slope = np.tan(np.radians(scene[camera, "fov"]) / 2)
    depth = (points - eye) @ forward
    assert scene[camera, "near"] < depth.min()
    assert depth.max() < scene[camera, "far"]
    height = (points - eye) @ up / depth / slope
    width = (points - eye) @ right / depth / slope
    aspect = float(re.search(r"camera\.aspect / ([0-9.]+)", page)[1])
    for extent, limit in ((height, 1.0), (width, aspect)):
        assert np.abs(extent).max() < 0.95 * limit
        assert np.ptp(extent) > 2 * 0.45 * limit


class Tags(html.parser.HTMLParser):
    """Collects the tags of a page with their attributes."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))


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
    assert "duty from 0 to 1: left, right<" in page
    assert "upper wire: right, lower wire: left" in page


def test_no_server_and_no_message_stays_behind(tmp_path, monkeypatch, caplog, capfd):
    ports = []

    def meshcat(params):
        server = Meshcat(params)
        ports.append(server.port())
        assert is_open(server.port())
        return server

    def is_open(port):
        with socket.socket() as client:
            return client.connect_ex(("127.0.0.1", port)) == 0

    monkeypatch.setattr(replay_page, "Meshcat", meshcat)
    caplog.set_level(logging.INFO, logger="drake")
    replay(tmp_path, make_recording(LimbParameters()))
    assert len(ports) == 1
    assert not is_open(ports[0])
    assert caplog.records == []
    assert capfd.readouterr() == ("", "")
    assert logging.getLogger("drake").level == logging.INFO
    assert [file.name for file in tmp_path.iterdir()] == ["replay.html"]


def test_a_page_that_cannot_be_written_leaves_all_as_it_was(tmp_path, monkeypatch):
    def full_disk(_):
        raise OSError("no space left")

    (tmp_path / "replay.html").write_text("the page before")
    monkeypatch.setattr("os.fsync", full_disk)
    with pytest.raises(OSError, match="no space left"):
        write_meshcat_replay(tmp_path / "replay.html", make_recording(LimbParameters()))
    assert (tmp_path / "replay.html").read_text() == "the page before"
    assert len(list(tmp_path.iterdir())) == 1


def test_refuses_what_cannot_be_replayed(tmp_path):
    sample = make_recording(LimbParameters(), 1)
    with pytest.raises(LimbError, match="two samples"):
        write_meshcat_replay(tmp_path / "replay.html", sample)
    other = LimbParameters()
    other.segments[0].links = 4
    with pytest.raises(LimbError, match=r"plan is for a limb of 4 links, 100 mm .* of one of 5 li"):
        replay(tmp_path, make_recording(LimbParameters()), plan=make_plan(other))
    limb = LimbParameters.in_space()
    recording, limb.segments[0].twists = make_recording(LimbParameters.in_space()), True
    with pytest.raises(LimbError, match=r"two axes, twists, but .* of one of .* two axes; they"):
        replay(tmp_path, recording, plan=make_plan(limb))
    for rate in (0.0, -20.0, np.nan, np.inf):
        with pytest.raises(LimbError, match="frames_per_second"):
            write_meshcat_replay(
                tmp_path / "replay.html", make_recording(LimbParameters()), frames_per_second=rate
            )
    assert list(tmp_path.iterdir()) == []
