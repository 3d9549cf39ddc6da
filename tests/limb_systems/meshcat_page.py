"""What a page or a Meshcat shows, read back as the browser reads it, and what is shown in tests."""

import base64
import re
import struct

import numpy as np
import pytest

from limb_systems import Layout, LimbParameters, PlanCheck, Recording, Trajectory

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
    if tag in (0xC7, 0xC8, 0xC9):  # an array: its size in bytes, its type, its numbers
        code = {0xC7: ">B", 0xC8: ">H", 0xC9: ">I"}[tag]
        at += struct.calcsize(code) + 1
        (size,) = struct.unpack_from(code, data, at - struct.calcsize(code) - 1)
        return data[at : at + size], at + size
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


def pose(tracks: dict, frame: int, path: str) -> np.ndarray:
    """A planar pose (3, 3) in (E1, E2) that an animation gives a path."""
    x, y, z, w = tracks[path, "quaternion"][frame]
    assert (x, y) == pytest.approx((0, 0), abs=1e-12)
    turn = complex(w, z) ** 2
    matrix = np.array([[turn.real, -turn.imag, 0], [turn.imag, turn.real, 0], [0, 0, 1.0]])
    matrix[:, 2] += [*tracks[path, "position"][frame][:2], 0]
    return matrix


def check_ghost(name: str, tracks: dict, frame: int, parameters: LimbParameters, joint_angles):
    """Each link hangs on the one before, so that poses multiply along the chain."""
    path, matrix = f"/drake/ghosts/{name}", np.eye(3)
    for number, (origin, direction) in enumerate(link_poses(parameters, joint_angles)[:-1], 1):
        path += f"/link_{number}"
        matrix = matrix @ pose(tracks, frame, path)
        np.testing.assert_allclose(matrix[:2, 2], origin[:2], atol=1e-7)
        np.testing.assert_allclose(matrix[:2, 0], [np.cos(direction), np.sin(direction)], atol=1e-6)


def by_equation_11(parameters: LimbParameters, bend_angle) -> np.ndarray:
    """θ_i = 2 φ / (n + 1) of each joint."""
    segments = zip(parameters.segments, bend_angle, strict=True)
    return np.concatenate([np.full(s.links, 2 * angle / (s.links + 1)) for s, angle in segments])


def make_plan(parameters: LimbParameters) -> Trajectory:
    """A motion from 7 s to 11 s in which no joint bends like another."""
    time = np.linspace(7.0, 11.0, 9)
    num_joints, num_wires = parameters.num_joints, len(parameters.wires)
    rng = np.random.default_rng(11)
    heat = np.full((num_wires, 9), 25.0)
    return Trajectory(
        time=time,
        reference=rng.uniform(-0.5, 0.5, (Layout(parameters).num_bends, 9)),
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
    num_wires, num_bends = len(parameters.wires), Layout(parameters).num_bends
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
