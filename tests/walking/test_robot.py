"""Robots of several limbs: the plant, the ground, the files."""

import numpy as np
import pytest

from limb_systems import (
    CalibrationRecord,
    Limb,
    LimbError,
    LimbParameters,
    Recording,
    simulate,
)
from limb_systems.simulation import make_simulator
from urdf import robot_urdf
from walking import BodyParameters, Robot, RobotParameters

COLD = np.zeros(4)
TIME_STEP = 2e-3  # s, twice as long as by default


def weight(robot):
    """Of the whole robot, N, along x and z of its world."""
    limbs = sum(s.mass for limb in robot.limbs for s in limb.parameters.segments)
    mass = robot.body.mass + limbs + len(robot.limbs) * robot.feet.mass
    return mass * robot.world_gravity[[0, 2]]


def test_welded_robot_of_one_limb_equals_the_limb(tmp_path):
    limb = LimbParameters()
    limb.gravity = [0.0, -9.81, 0.0]
    limb.save(tmp_path / "limb.yaml")
    robot = Robot(tmp_path / "limb.yaml")
    assert robot.parameters.digest == limb.digest
    alone, on_body = (simulate(system, [0.1, 0.6], 5.0) for system in (Limb(limb), robot))
    for signal in ("bend_angle", "wire_temperature", "measured_temperature", "joint_state"):
        np.testing.assert_allclose(
            getattr(on_body, signal), getattr(alone, signal), rtol=1e-5, atol=1e-6
        )


def test_the_duty_of_a_limb_takes_the_place_of_its_part_of_all_duty():
    robot = Robot()
    heating = robot.GetSubsystemByName("joule_heating")

    def assert_duty(context, expected):
        duty = heating.get_input_port().Eval(heating.GetMyContextFromRoot(context))
        np.testing.assert_array_equal(duty, expected)

    context = robot.CreateDefaultContext()
    for port, given, expected in (
        ("duty", [0.1, 0.2, 0.3, 0.4], [0.1, 0.2, 0.3, 0.4]),
        ("rear.duty", [0.5, 0.6], [0.5, 0.6, 0.3, 0.4]),
        ("duty", [0.0, 0.0, 0.7, 0.8], [0.5, 0.6, 0.7, 0.8]),
    ):
        robot.GetInputPort(port).FixValue(context, given)
        assert_duty(context, expected)
    context = robot.CreateDefaultContext()
    for port in ("rear.duty", "front.duty"):
        robot.GetInputPort(port).FixValue(context, [0.5, 0.6])
    assert_duty(context, [0.5, 0.6, 0.5, 0.6])


def test_a_simulation_takes_the_steps_of_the_mechanics():
    simulator = make_simulator(robot := Robot(time_step=TIME_STEP), None)
    robot.GetInputPort("duty").FixValue(simulator.get_mutable_context(), COLD)
    simulator.AdvanceTo(0.1)
    assert simulator.get_num_steps_taken() == 50


def test_the_first_sample_has_the_contact_force_of_a_robot_that_stands():
    simulator = make_simulator(robot := Robot(time_step=TIME_STEP), None)
    context = simulator.get_mutable_context()
    robot.GetInputPort("duty").FixValue(context, COLD)
    simulator.AdvanceTo(1.0)
    steps, heat = context.get_discrete_state_vector(), context.get_continuous_state_vector()
    standing = np.concatenate([steps.CopyToVector(), heat.CopyToVector()])
    recording = simulate(Robot(time_step=TIME_STEP), COLD, 0.1, initial_state=standing)
    on_each = np.full(recording.contact_force[1::2].shape, 0.05 * 9.81 / 2)
    np.testing.assert_allclose(recording.contact_force[1::2], on_each, rtol=2e-3)


def test_a_plate_rounded_to_ten_digits_keeps_its_inertia():
    robot = RobotParameters()
    robot.body.inertia = [2e-6, 9e-6, 1.100000001e-5]
    body = Robot(robot).GetSubsystemByName("plant").GetBodyByName("body")
    moments = body.default_rotational_inertia().get_moments()
    np.testing.assert_allclose(moments, [2e-6, 9e-6, 1.1e-5], rtol=1e-9)
    robot.body.inertia[2] = 1.10001e-5
    with pytest.raises(LimbError, match="none of them larger than the other two together"):
        Robot(robot)


@pytest.mark.parametrize("mount", ["planar", "free"])
def test_the_ground_carries_the_weight(mount):
    robot = RobotParameters()
    robot.body.mount, robot.ground.slope, robot.feet.mass = mount, 0.1, 0.002
    robot.body.width = 0.1
    if mount == "free":  # two feet in a line do not stand
        for index, y in enumerate((-0.04, 0.04)):
            limb = RobotParameters().limbs[index]
            limb.name, limb.position = f"side_{index}", [0.0, y, 0.0]
            robot.limbs.append(limb)
    system = Robot(robot, time_step=TIME_STEP)
    recording = simulate(system, np.zeros(2 * len(robot.limbs)), 2.0)
    forces = recording.contact_force[:, -1].reshape(len(robot.limbs), -1)
    np.testing.assert_allclose(forces.sum(axis=0)[[0, -1]], -weight(robot), rtol=2e-3)
    np.testing.assert_allclose(recording.body_pose[:, -1], recording.body_pose[:, -11], atol=1e-5)


def test_a_robot_sinks_into_its_feet_by_their_stiffness():
    """Beside a robot on feet that are twice as stiff, whose limbs give way alike."""
    heights, robot = [], RobotParameters()
    for stiffness in (200.0, 400.0):
        robot.feet.radius, robot.feet.stiffness, robot.feet.damping = 0.003, stiffness, 2.0
        recording = simulate(Robot(robot, time_step=TIME_STEP), COLD, 2.0)
        heights.append(recording.body_pose[1, -1])
    on_each = 0.5 * -weight(robot)[1]
    assert heights[1] - heights[0] == pytest.approx(on_each / 200 - on_each / 400, rel=2e-3)
    assert f'relaxation_time value="{2.0 / 400.0:g}"' in robot_urdf(robot)
    robot.feet.stiffness = 20.0
    with pytest.raises(LimbError, match=r"presses its feet in by 12\.3 mm, more than the 6 mm"):
        robot.validate()


def test_feet_slide_down_with_the_acceleration_of_coulombs_law():
    robot = RobotParameters()
    robot.ground.slope, robot.ground.friction = 0.3, 0.1
    recording = simulate(Robot(robot), COLD, 0.5, sample_rate=100.0)
    rate = np.diff(recording.body_pose[0]) * 100.0
    expected = -9.81 * (np.sin(0.3) - 0.1 * np.cos(0.3))
    # Feet swing back and forth under the body by the way; the mean is that of the whole.
    assert rate[-1] / 0.495 == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(("damping", "holds"), [(7e-5, True), (6e-5, False)])
def test_springs_that_would_blow_up_in_steps_are_refused(damping, holds):
    """Where Drake's simulation begins to fail, found by trying."""
    robot = RobotParameters()
    for limb in robot.limbs:
        limb.parameters.segments[0].damping = damping
    if not holds:
        with pytest.raises(LimbError, match="too stiff for their mass and damping"):
            Robot(robot)
        Robot(robot, time_step=5e-4)
        return
    recording = simulate(Robot(robot), COLD + 0.2, 0.5)
    assert np.abs(recording.joint_state[10:, -1]).max() < 0.1


def test_limbs_bend_the_way_they_are_mounted():
    robot = RobotParameters(body=BodyParameters(mount="welded"), ground=None)
    robot.gravity = [0.0, 0.0, 0.0]
    robot.limbs[0].e2 = [-1.0, 0.0, 0.0]
    system = Robot(robot)
    recording = simulate(system, [0.0, 0.5, 0.0, 0.5], 3.0)
    assert recording.bend_angle[0, -1] == pytest.approx(recording.bend_angle[1, -1], abs=1e-12)
    plant = system.GetSubsystemByName("plant")
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, recording.joint_state[:10, -1])
    rear, front = (
        plant.GetBodyByName(f"{name}_foot").EvalPoseInWorld(context).translation()
        for name in ("rear", "front")
    )
    assert front[0] > 0.032
    np.testing.assert_allclose(rear, front * [-1, 1, 1], atol=1e-12)


def test_descriptions_that_no_robot_has_are_refused(refused):
    for words, change in (
        (
            ["limbs[1].name is 'rear'", "another limb"],
            lambda r: setattr(r.limbs[1], "name", "rear"),
        ),
        (["limbs[0].name is 'body'"], lambda r: setattr(r.limbs[0], "name", "body")),
        (["body.mass is 20 kg", "in grams"], lambda r: setattr(r.body, "mass", 20.0)),
        (["limbs[0]", "right angles"], lambda r: setattr(r.limbs[0], "e2", [0.0, 0.0, 1.0])),
        (["gravity", "press the robot"], lambda r: setattr(r, "gravity", [0.0, 0.0, 9.81])),
    ):
        robot = RobotParameters()
        change(robot)
        with refused(LimbError, *words):
            robot.validate()


def test_a_calibrated_robot_of_four_limbs_is_written_and_read():
    robot = RobotParameters.in_space(4)
    size = 66  # parameters of three wires with memory that warm each other
    numbers = np.random.default_rng(0).standard_normal((size, size)).tolist()
    for limb in robot.limbs:
        names = [f"wire_1.a{index}" for index in range(size)]
        limb.parameters.calibration = CalibrationRecord(names, numbers[0], numbers[1], numbers)
    assert RobotParameters.from_yaml(robot.to_yaml()) == robot


def test_robot_and_recording_files_round_trip(tmp_path):
    robot = RobotParameters()
    robot.limbs[1].parameters.segments[0].wires[0].law.a1 = -0.06
    robot.save(tmp_path / "robot.yaml")
    assert RobotParameters.load(tmp_path / "robot.yaml") == robot
    hanging = RobotParameters.of(LimbParameters())
    assert RobotParameters.from_yaml(hanging.to_yaml()) == hanging  # without a ground
    recording = simulate(Robot(robot), COLD + 0.1, 0.2)
    recording.save(tmp_path / "recording.csv")
    loaded = Recording.load(tmp_path / "recording.csv")
    assert loaded.robot == robot
    assert loaded.parameters == robot.as_single_limb
    assert "duty_front_left" in loaded.columns()
    np.testing.assert_array_equal(loaded.contact_force, recording.contact_force)
    np.testing.assert_array_equal(loaded.body_pose, recording.body_pose)
