"""Robots are shown where Drake's plant has them, and their feet do what is said of them."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from limb_systems import LimbError, Recording, wire_color, write_meshcat_replay
from limb_systems.views.panels import motion_panels
from limb_systems.views.plots import draw
from walking import (
    BodyParameters,
    Gait,
    GroundParameters,
    Robot,
    RobotLimb,
    RobotParameters,
)
from walking.foot_fall import foot_fall
from walking.robot_parameters import walking_limb
from walking.views.robot_panels import body_path_panel, foot_fall_panel

sys.path.insert(0, str(Path(__file__).parents[1] / "limb_systems"))

from meshcat_page import animation, boxes, poses_at, readouts, srgb, transforms

ROBOT = "/drake/visualizer/robot"


def recording_of(robot: RobotParameters, body_pose, joint_angles, contact_force) -> Recording:
    """A recording of any motion, 10 samples per second."""
    samples, wires = body_pose.shape[1], len(robot.as_single_limb.wires)
    heat = 25.0 + 75.0 * np.random.default_rng(1).random((wires, samples))
    return Recording(
        time=np.arange(samples) / 10,
        duty=np.random.default_rng(2).random((wires, samples)),
        measured_temperature=heat,
        bend_angle=np.zeros((len(robot.limbs), samples)),
        parameters=robot.as_single_limb,
        source="a test",
        sample_rate=10.0,
        wire_temperature=heat,
        joint_state=np.vstack([joint_angles, 0 * joint_angles]),
        robot=robot,
        body_pose=body_pose,
        contact_force=contact_force,
    )


def random_recording(robot: RobotParameters, travel: float) -> Recording:
    rng, samples = np.random.default_rng(4), 6
    pose = rng.normal(0, 0.1, (robot.pose_size, samples))
    pose[0] = np.linspace(0, travel, samples)
    angles = rng.normal(0, 0.2, (robot.joints_of[-1].stop, samples))
    forces = np.ones((robot.force_size * len(robot.limbs), samples))
    return recording_of(robot, pose, angles, forces)


def in_space() -> RobotParameters:
    """Three limbs around a body that moves in space."""
    limbs = []
    for number, name in enumerate("abc"):
        x, y = np.cos(2 * np.pi / 3 * number), np.sin(2 * np.pi / 3 * number)
        position, e2 = [0.03 * x, 0.03 * y, 0.0], [x, y, 0.0]
        limbs.append(RobotLimb(name, position, e2=e2, parameters=walking_limb()))
    return RobotParameters(body=BodyParameters(mount="free"), limbs=limbs)


def drake_poses(recording: Recording | Gait, sample: int) -> dict[str, RigidTransform]:
    """Poses of all bodies in the world, by the joints of the simulated plant."""
    robot = recording.robot
    system = Robot(robot)
    plant = system.GetSubsystemByName("plant")
    context = plant.GetMyMutableContextFromRoot(system.CreateDefaultContext())
    pose = recording.body_pose[:, sample]
    if robot.body.mount == "planar":
        plant.GetJointByName("body").set_translation(context, pose[:2])
        plant.GetJointByName("body").set_rotation(context, pose[2])
    else:
        placed = RigidTransform(RollPitchYaw(pose[3:]), pose[:3])
        plant.SetFreeBodyPose(context, plant.GetBodyByName("body"), placed)
    angles = iter(recording.joint_state[:, sample])
    for limb in robot.limbs:
        for number in range(1, limb.parameters.num_joints + 1):
            plant.GetJointByName(f"{limb.name}_joint_{number}").set_angle(context, next(angles))
    bodies = [
        plant.GetBodyByName(name)
        for name in ["body"]
        + [
            f"{limb.name}_{part}"
            for limb in robot.limbs
            for part in ("base", "link_1", f"link_{limb.parameters.segments[0].links}", "foot")
        ]
    ]
    return {body.name(): plant.EvalBodyPoseInWorld(context, body) for body in bodies}


@pytest.mark.parametrize("robot", [RobotParameters(ground=GroundParameters(0.4, 0.1)), in_space()])
def test_a_page_shows_bodies_and_wires_of_a_robot_where_drake_has_them(tmp_path, robot):
    recording = random_recording(robot, travel=0.1)
    write_meshcat_replay(tmp_path / "walk.html", recording, frames_per_second=10.0)
    page = (tmp_path / "walk.html").read_text(encoding="utf-8")
    tracks, _, _ = animation(page)
    for sample in (0, 3, 5):
        expected, pose_of = drake_poses(recording, sample), poses_at(tracks, sample)
        for name in ("body", *(f"{limb.name}_link_5" for limb in robot.limbs)):
            found = pose_of(f"{ROBOT}/{name}")
            assert found.IsNearlyEqualTo(expected[name], 1e-9), name
    # The scene is tilted as the ground is: +x rises.
    scene, slope = transforms(page)["/drake/visualizer"], robot.ground.slope
    np.testing.assert_allclose(scene[:3, 0], [np.cos(slope), 0, np.sin(slope)], atol=1e-9)
    np.testing.assert_allclose(scene[:3, 3], 0.0, atol=1e-12)
    turns = robot.pose_size // 2  # one in the plane, three in space
    pose = np.split(recording.body_pose, [robot.pose_size - turns])
    said = readouts(page)[len(robot.limbs) :][: robot.pose_size]
    np.testing.assert_allclose(said, [*(1e3 * pose[0]), *np.rad2deg(pose[1])], atol=0.0501)
    first = robot.limbs[0].name
    colors = srgb(tracks[f"{ROBOT}/{first}_link_2/robot/wire_right/<object>", "material.color"])
    wanted = wire_color(robot.as_single_limb, recording.wire_temperature[1])
    np.testing.assert_allclose(colors, wanted, atol=1e-9)
    # The ground's top is z = 0, under all of the way.
    ground = transforms(page)["/drake/ground/plane"][:3, 3]
    length, _, height = boxes(page)["/drake/ground/plane"]
    assert ground[2] + height / 2 == pytest.approx(0.0)
    assert ground[0] - length / 2 < -0.05
    assert ground[0] + length / 2 > 0.15
    caption = page.split('id="caption"')[1]
    assert f"μ = {robot.ground.friction:g}" in caption
    for name in ("x", "z", "pitch") if turns == 1 else ("x", "y", "z", "roll", "pitch", "yaw"):
        assert re.search(rf"(body )?\b{name} <output>", caption)
    assert ("rises by 5.7" in caption) == (slope > 0)
    with pytest.raises(LimbError, match="A robot is shown without a plan"):
        write_meshcat_replay(tmp_path / "other.html", recording, plan=recording)


def test_a_gait_is_drawn_as_it_is(gait):
    panel = foot_fall_panel(gait.robot, gait.phases, gait.period)
    assert panel.y_ticks == {0: "rear", 1: "front"}
    lasts = {
        (curve.name, foot): np.nansum(np.diff(curve.x)[curve.y[:-1] == foot][::2])
        for curve in panel.curves
        for foot in (0, 1)
    }
    assert lasts == {
        ("sticks", 0): 10.0,
        ("sticks", 1): 11.0,
        ("slides forward", 0): 5.0,
        ("slides forward", 1): 4.0,
    }
    axes = draw(motion_panels(gait)).axes
    labels = [axis.get_ylabel() for axis in axes]
    assert labels[:4] == ["foot", "body x (mm)", "body pitch (°)", "contact force (N)"]
    assert [text.get_text() for text in axes[0].get_yticklabels()] == ["rear", "front"]
    assert "temperature of front (°C)" in " ".join(labels).replace("\n", " ")
    (line,) = axes[1].lines
    np.testing.assert_allclose(line.get_ydata()[[0, -1]], [0.0, 30.0])

    long = gait.repeated(3)
    assert (long.stride, long.period) == pytest.approx((0.09, 45.0))
    assert len(long.phases) == 3 * len(gait.phases)
    assert (np.diff(long.body_pose[0]) > 0).all()


@pytest.mark.parametrize("noise", [0.0, 2e-4])
@pytest.mark.parametrize("robot", [RobotParameters(), in_space()])
def test_feet_slide_and_then_stick_also_where_a_camera_has_noise(robot, noise):
    time, rng = np.arange(121) / 10, np.random.default_rng(7)
    pose, feet = np.zeros((robot.pose_size, 121)), len(robot.limbs)
    pose[0], pose[robot.pose_size // 3] = 0.008 * np.minimum(time, 6.0), 0.06
    pose[:2] += noise * rng.normal(size=(2, 121))
    forces = np.zeros((feet, robot.force_size, 121))
    forces[:, -1] = 0.2
    recording = recording_of(robot, pose, np.zeros((5 * feet, 121)), forces.reshape(-1, 121))
    phases = foot_fall(recording)
    starts, ends = [phase.start for phase in phases], [*(p.start for p in phases[1:]), 12.0]
    lasts = dict.fromkeys(("slide", "slide_forward", "slide_backward", "stick"), 0.0)
    for phase, start, end in zip(phases, starts, ends, strict=True):
        for contact in phase.contacts:
            lasts[contact] += (end - start) / feet
    slides = "slide_forward" if robot.body.mount == "planar" else "slide"
    assert lasts[slides] == pytest.approx(6.0, abs=1e-6 if noise == 0 else 0.5)
    assert lasts["stick"] == pytest.approx(6.0, abs=1e-6 if noise == 0 else 0.5)


def test_the_way_of_a_body_is_drawn_from_above():
    recording = random_recording(in_space(), travel=0.1)
    panel = body_path_panel(recording, [[0.1, 0.02], [0.0, 0.0, 1.5]])
    way, places = panel.curves
    np.testing.assert_allclose([way.x, way.y], 1e3 * recording.body_pose[:2])
    np.testing.assert_allclose([places.x, places.y], [[100.0, 0.0], [20.0, 0.0]])
    assert (panel.x_label, panel.label, panel.equal) == ("x (mm)", "y (mm)", True)
