"""What a replay's page and a live view hold, read back as the browser reads it."""

import base64
import html.parser
import itertools
import logging
import re
import socket
import struct

import numpy as np
import pytest
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from limb_systems import (
    Limb,
    LimbError,
    LimbParameters,
    PlanCheck,
    Recording,
    Trajectory,
    joint_angles_from_bend_angle,
    visualization,
)
from limb_systems.visualization import LimbVisualizer, wire_color, write_meshcat_replay

LIMB = "/drake/visualizer/limb"


def unpack(data: bytes, at: int = 0):
    """A MessagePack value, and where it ends: the part of the format that Drake writes."""
    tag, at = data[at], at + 1
    if tag < 0x80 or tag >= 0xE0:
        return (tag if tag < 0x80 else tag - 0x100), at
    if tag in (0xC0, 0xC2, 0xC3):
        return {0xC0: None, 0xC2: False, 0xC3: True}[tag], at
    if tag in (0xCB, 0xCC, 0xCD, 0xCE):
        code = {0xCB: ">d", 0xCC: ">B", 0xCD: ">H", 0xCE: ">I"}[tag]
        return struct.unpack_from(code, data, at)[0], at + struct.calcsize(code)
    if tag < 0xC0:
        kind, mask = ("map", 0xF) if tag < 0x90 else ("array", 0xF) if tag < 0xA0 else ("str", 0x1F)
        size = tag & mask
    else:
        kind, code = {
            0xD9: ("str", ">B"),
            0xDA: ("str", ">H"),
            0xDC: ("array", ">H"),
            0xDD: ("array", ">I"),
            0xDE: ("map", ">H"),
        }[tag]
        (size,) = struct.unpack_from(code, data, at)
        at += struct.calcsize(code)
    if kind == "str":
        return data[at : at + size].decode(), at + size
    values = []
    for _ in range(size if kind == "array" else 2 * size):
        value, at = unpack(data, at)
        values.append(value)
    return (values if kind == "array" else dict(zip(values[::2], values[1::2], strict=True))), at


def commands(page: str) -> list[dict]:
    """What a page tells Meshcat, in order."""
    messages = re.findall(r'fetch\("data:application/octet-binary;base64,([^"]+)"\)', page)
    return [unpack(base64.b64decode(message))[0] for message in messages]


def properties(page: str) -> dict:
    """The last value of each property that a page sets, by path and name."""
    return {
        (command["path"], command["property"]): np.array(command["value"])
        for command in commands(page)
        if command["type"] == "set_property"
    }


def animation(page: str) -> tuple[dict, dict, float]:
    """Tracks (frames, size) by path and property, the options, and the frame rate."""
    (command,) = (c for c in commands(page) if c["type"] == "set_animation")
    tracks, rates = {}, set()
    for part in command["animations"]:
        rates.add(part["clip"]["fps"])
        for track in part["clip"]["tracks"]:
            assert [key["time"] for key in track["keys"]] == list(range(len(track["keys"])))
            values = np.array([key["value"] for key in track["keys"]])
            tracks[part["path"], track["name"].removeprefix(".")] = values
    (rate,) = rates
    return tracks, command["options"], rate


def srgb(linear: np.ndarray) -> np.ndarray:
    """What a screen shows for linear RGB (IEC 61966-2-1)."""
    return np.where(linear > 0.0031308, 1.055 * linear ** (1 / 2.4) - 0.055, 12.92 * linear)


def link_poses(parameters: LimbParameters, joint_angles) -> list[tuple[np.ndarray, float]]:
    """Origin (3,) and direction of each link: along each link before, turned by each joint."""
    origin, direction, poses = np.zeros(3), 0.0, []
    lengths = [s.length / s.links for s in parameters.segments for _ in range(s.links)]
    for angle, length in zip(joint_angles, lengths, strict=True):
        direction += angle
        poses.append((origin, direction))
        origin = origin + length * np.array([np.cos(direction), np.sin(direction), 0.0])
    return [*poses, (origin, direction)]


def check_link_poses(tracks: dict, frame: int, parameters: LimbParameters, joint_angles):
    for number, (origin, direction) in enumerate(link_poses(parameters, joint_angles)[:-1], 1):
        path = f"{LIMB}/link_{number}"
        np.testing.assert_allclose(tracks[path, "position"][frame], origin, atol=1e-12)
        x, y, z, w = tracks[path, "quaternion"][frame]
        assert (x, y) == pytest.approx((0, 0), abs=1e-12)
        turned = np.exp(1j * direction)
        assert complex(w, z) ** 2 == pytest.approx(turned, abs=1e-9)


def make_recording(parameters: LimbParameters, num_samples: int = 41, **signals) -> Recording:
    """A bend to and fro over 2 s; wires from ambient temperature to T_max and back."""
    time = np.linspace(3.0, 5.0, num_samples)
    num_wires, num_segments = len(parameters.wires), len(parameters.segments)
    wave = np.sin(np.pi * (time - 3.0) / 2)
    heat = 25.0 + 75.0 * np.outer(1 / np.arange(1, num_wires + 1), wave)
    return Recording(
        time=time,
        duty=np.zeros((num_wires, num_samples)),
        measured_temperature=heat,
        bend_angle=np.outer(np.linspace(0.9, -0.6, num_segments), wave),
        parameters=parameters,
        source="a test",
        sample_rate=20.0,
        **signals,
    )


@pytest.fixture
def modelled(two_segments) -> Recording:
    """A recording of a model, whose joints do not bend alike and whose V lags behind T."""
    rng = np.random.default_rng(5)
    angles = np.cumsum(rng.normal(0, 0.02, (5, 41)), axis=1)
    rates = rng.normal(0, 0.1, (5, 41))
    heat = 25 + 75 * rng.random((4, 41))
    heat[:, 0], heat[:, 40] = 25.0, 100.0
    return make_recording(
        two_segments, joint_state=np.vstack([angles, rates]), wire_temperature=heat
    )


def replay(tmp_path, motion, **options) -> str:
    write_meshcat_replay(tmp_path / "replay.html", motion, **options)
    return (tmp_path / "replay.html").read_text(encoding="utf-8")


def test_wire_color_runs_from_greyish_blue_at_ambient_to_orange_at_the_maximum():
    parameters = LimbParameters(ambient_temperature=10.0)
    parameters.temperature_limits.maximum = 90.0
    cold, hot = wire_color(parameters, [10.0, 90.0])
    assert cold[2] > cold[1] > cold[0]
    assert np.ptp(cold) < 0.4
    assert hot[0] > 0.95
    assert hot[0] > hot[1] + 0.3 > hot[2] + 0.6
    np.testing.assert_array_equal(wire_color(parameters, [-40.0, 400.0]), [cold, hot])
    between = wire_color(parameters, np.linspace(10.0, 90.0, 101).reshape(1, 101))
    assert between.shape == (1, 101, 3)
    assert between.min() >= 0
    assert between.max() <= 1
    # Heat can be told from any colour: red less blue only ever grows.
    assert (np.diff(between[0, :, 0] - between[0, :, 2]) > 0).all()


def test_links_move_as_the_joint_angles_say(tmp_path, modelled):
    tracks, options, rate = animation(replay(tmp_path, modelled))
    assert rate == pytest.approx(20.0)
    assert len(tracks[f"{LIMB}/link_1", "quaternion"]) == 41
    for frame in (0, 1, 23, 40):
        check_link_poses(tracks, frame, modelled.parameters, modelled.joint_state[:5, frame])
    assert options["play"] is True
    assert options["repetitions"] > 10_000


def test_wires_are_coloured_by_their_temperature_at_each_frame(tmp_path, modelled):
    page = replay(tmp_path, modelled)
    tracks, _, _ = animation(page)
    meshes = {c["path"] for c in commands(page) if c["type"] == "set_object"}
    num_tracks = 0
    for wire, (links, side) in enumerate(itertools.product([(1, 2), (3, 4, 5)], ["left", "right"])):
        expected = wire_color(modelled.parameters, modelled.wire_temperature[wire])
        for link in links:
            path = f"{LIMB}/link_{link}/limb/wire_{side}"
            assert path in meshes
            shown = srgb(tracks[f"{path}/<object>", "material.color"])
            np.testing.assert_allclose(shown, expected, atol=1e-9)
            num_tracks += 1
    assert num_tracks == sum(name == "material.color" for _, name in tracks)
    ends = wire_color(modelled.parameters, [25.0, 100.0])
    np.testing.assert_allclose(shown[[0, -1]], ends, atol=1e-9)


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
        first = two_segments.joint_slices[segment].start
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


@pytest.mark.parametrize("num_samples", [2, 15, 41, 64])
@pytest.mark.parametrize("frames_per_second", [0.1, 7.3, 20.0, 49.0])
def test_the_replay_lasts_as_long_as_the_recording(tmp_path, num_samples, frames_per_second):
    recording = make_recording(LimbParameters(), num_samples)
    page = replay(tmp_path, recording, frames_per_second=frames_per_second)
    tracks, _, rate = animation(page)
    for track in tracks.values():
        assert (len(track) - 1) / rate == pytest.approx(2.0)
    angles = joint_angles_from_bend_angle(LimbParameters(), recording.bend_angle[:, -1])
    check_link_poses(tracks, -1, LimbParameters(), angles)


@pytest.mark.parametrize("bend_angle", [0.4, -0.9, 1.6])
def test_the_camera_sees_the_whole_motion_and_little_else(tmp_path, bend_angle):
    parameters = LimbParameters()
    recording = make_recording(parameters)
    recording.bend_angle *= bend_angle / recording.bend_angle.max()
    page = replay(tmp_path, recording)
    scene = properties(page)
    camera = "/Cameras/default/rotated/<object>"
    (target,) = (np.array(c["value"]) for c in commands(page) if c["type"] == "set_target")
    eye = scene[camera, "position"]
    angles = joint_angles_from_bend_angle(parameters, recording.bend_angle)
    ends = np.array([end for column in angles.T for end, _ in link_poses(parameters, column)])
    points = np.vstack([ends + np.array([0, 0, height]) for height in (-0.01, 0.01)])
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


def test_the_page_needs_nothing_but_itself(tmp_path):
    page = replay(tmp_path, make_recording(LimbParameters()))
    parser = Tags()
    parser.feed(page)
    assert ("div", {"id": "meshcat-pane"}) in parser.found
    assert ("div", {"id": "caption"}) in parser.found
    for tag, attributes in parser.found:
        assert tag not in ("link", "img", "iframe", "object", "embed")
        assert not {"src", "href"} & set(attributes)
    assert len(re.findall(r'fetch\("(?!data:)', page)) == 0
    assert len(page) < 4e6


def test_the_title_is_text(tmp_path):
    page = replay(tmp_path, make_recording(LimbParameters()), title="$a <script>&</script>")
    assert "<b>$a &lt;script&gt;&amp;&lt;/script&gt;</b>" in page


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

    monkeypatch.setattr(visualization, "Meshcat", meshcat)
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
    for rate in (0.0, -20.0, np.nan, np.inf):
        with pytest.raises(LimbError, match="frames_per_second"):
            write_meshcat_replay(
                tmp_path / "replay.html", make_recording(LimbParameters()), frames_per_second=rate
            )
    assert list(tmp_path.iterdir()) == []


def test_live_view_follows_the_limb_in_a_simulation(two_segments):
    meshcat = Meshcat(MeshcatParams(host="localhost", port=0))
    builder = DiagramBuilder()
    limb = builder.AddSystem(Limb(two_segments))
    visualizer = builder.AddSystem(LimbVisualizer(two_segments, meshcat))
    duty = builder.AddSystem(ConstantVectorSource([0.0, 0.5, 1.0, 0.0]))
    builder.Connect(duty.get_output_port(), limb.GetInputPort("duty"))
    for name in ("joint_state", "wire_temperature"):
        assert visualizer.GetInputPort(name).size() == limb.GetOutputPort(name).size()
        builder.Connect(limb.GetOutputPort(name), visualizer.GetInputPort(name))
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(
        SimulatorConfig(integration_scheme="radau3", accuracy=1e-3, use_error_control=True),
        simulator,
    )
    limb_context = limb.GetMyContextFromRoot(simulator.get_context())
    shown = []
    for time in (0.5, 2.0):
        simulator.AdvanceTo(time)
        page = meshcat.StaticHtml()
        heat = limb.GetOutputPort("wire_temperature").Eval(limb_context)
        joint_angles = limb.GetOutputPort("joint_state").Eval(limb_context)[:5]
        scene = properties(page)
        for path, temperature in (
            ("link_2/limb/wire_left", heat[0]),
            ("link_1/limb/wire_right", heat[1]),
            ("link_5/limb/wire_left", heat[2]),
            ("link_3/limb/wire_right", heat[3]),
        ):
            *color, opacity = scene[f"{LIMB}/{path}", "color"]
            assert opacity == 1.0
            expected = wire_color(two_segments, temperature)
            np.testing.assert_allclose(srgb(np.array(color)), expected, atol=1e-9)
        transforms = {
            c["path"]: np.array(c["matrix"]).reshape(4, 4).T
            for c in commands(page)
            if c["type"] == "set_transform"
        }
        for number, (origin, direction) in enumerate(link_poses(two_segments, joint_angles)[:-1]):
            matrix = transforms[f"{LIMB}/link_{number + 1}"]
            np.testing.assert_allclose(matrix[:3, 3], origin, atol=1e-9)
            axis = [np.cos(direction), np.sin(direction), 0.0]
            np.testing.assert_allclose(matrix[:3, 0], axis, atol=1e-9)
        shown.append(heat)
    assert (shown[1] - shown[0])[[1, 2]].min() > 5.0
