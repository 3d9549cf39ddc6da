"""What a page or a Meshcat shows, read back as the browser reads it, and what is shown in tests."""

import base64
import html.parser
import json
import re
from collections.abc import Callable

import msgpack
import numpy as np
from plant_links import link_positions
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform

from limb_systems import LimbModel, LimbParameters, PlanCheck, Recording, Trajectory

LIMB = "/drake/visualizer/limb"


def commands(page: str) -> list[dict]:
    """What a page tells Meshcat, in order."""
    messages = re.findall(r'fetch\("data:application/octet-binary;base64,([^"]+)"\)', page)
    return [
        msgpack.unpackb(base64.b64decode(message), ext_hook=lambda _, data: data)
        for message in messages
    ]


def properties(page: str) -> dict:
    """The last value of each property that a page sets, by path and name."""
    return {
        (command["path"], command["property"]): np.array(command["value"])
        for command in commands(page)
        if command["type"] == "set_property"
    }


def transforms(page: str) -> dict:
    """The last pose (4, 4) of each path relative to the path above."""
    return {
        command["path"]: np.array(command["matrix"]).reshape(4, 4).T
        for command in commands(page)
        if command["type"] == "set_transform"
    }


def boxes(page: str) -> dict:
    """The sides (3,) along E1, E2 and E3 of each box, by path."""
    return {
        command["path"]: np.array([shape[side] for side in ("width", "height", "depth")])
        for command in commands(page)
        if command["type"] == "set_object"
        for shape in command["object"]["geometries"]
        if shape["type"] == "BoxGeometry"
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


def poses_at(tracks: dict, frame: int) -> Callable[[str], RigidTransform]:
    """A function that returns the pose which an animation gives a path."""

    def pose_of(path: str) -> RigidTransform:
        x, y, z, w = tracks[path, "quaternion"][frame]
        turn = Quaternion(np.array([w, x, y, z]) / np.linalg.norm([w, x, y, z]))
        return RigidTransform(turn, tracks[path, "position"][frame])

    return pose_of


def check_bodies(pose_of: Callable, parameters: LimbParameters, joint_angles, ghost: str = ""):
    """Each body begins where kinematics says, and points to where the next one begins."""
    ends = link_positions(parameters, joint_angles)
    links = sum(segment.links for segment in parameters.segments)
    bodies = ["root_1"] * (len(ends) - 1 - links) + [f"link_{n}" for n in range(1, links + 1)]
    path = f"/drake/ghosts/{ghost}" if ghost else LIMB
    for body, place, end in zip(bodies, ends, ends[1:], strict=False):
        pose = pose_of(f"{path}/{body}")
        np.testing.assert_allclose(pose.translation(), place, atol=1e-7)
        along = (end - place) / np.linalg.norm(end - place)
        np.testing.assert_allclose(pose.rotation().matrix()[:, 0], along, atol=1e-6)


class Tags(html.parser.HTMLParser):
    """Collects the tags of a page with their attributes."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))


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


def make_plan(parameters: LimbParameters) -> Trajectory:
    """A motion from 7 s to 11 s in which no joint bends like another."""
    time = np.linspace(7.0, 11.0, 9)
    num_joints, num_wires = parameters.num_joints, len(parameters.wires)
    rng = np.random.default_rng(11)
    heat = np.full((num_wires, 9), 25.0)
    return Trajectory(
        time=time,
        reference=rng.uniform(-0.5, 0.5, (LimbModel.of(parameters).layout.num_bends, 9)),
        duty=rng.random((num_wires, 9)),
        joint_state=rng.uniform(-0.2, 0.2, (2 * num_joints, 9)),
        wire_temperature=heat,
        measured_temperature=heat,
        parameters=parameters,
        check=PlanCheck(),
    )


def make_recording(parameters: LimbParameters, num_samples: int = 41, **signals) -> Recording:
    """A bend to and fro over 2 s; wires from ambient temperature to T_max and back."""
    time = np.linspace(3.0, 5.0, num_samples)
    num_wires, num_bends = len(parameters.wires), LimbModel.of(parameters).layout.num_bends
    wave = np.sin(np.pi * (time - 3.0) / 2)
    heat = 25.0 + 75.0 * np.outer(1 / np.arange(1, num_wires + 1), wave)
    return Recording(
        time=time,
        duty=np.zeros((num_wires, num_samples)),
        measured_temperature=heat,
        bend_angle=np.outer(np.linspace(0.9, -0.6, num_bends), wave),
        parameters=parameters,
        source="a test",
        sample_rate=20.0,
        **signals,
    )
