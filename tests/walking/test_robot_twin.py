"""Emulated robots against their weight, Coulomb's law, `Robot`, and what was drawn."""

import copy

import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial
from scipy.special import expit
from simulated_board import SimulatedBoard

from hardware import LimbTwin, replay
from hardware.emulation.emulated_board import RunningTwin
from limb_systems import Recording, SaturatingLaw, simulate
from walking import Robot, RobotParameters, RobotTwin
from walking.robot_specimen import RobotSpecimen

OFF = np.zeros(4)
GRAVITY = 9.81
TIME_STEP = 2e-3  # s, twice as long as by default


def mass(robot: RobotParameters) -> float:
    limbs = sum(s.mass for limb in robot.limbs for s in limb.parameters.segments)
    return robot.body.mass + limbs + len(robot.limbs) * robot.feet.mass


@pytest.fixture(scope="module")
def resting():
    """A robot on a slope of 5°, with the recording of its rest."""
    robot = RobotParameters()
    robot.ground.slope, robot.feet.mass = np.deg2rad(5.0), 0.002
    twin = RobotTwin(robot, seed=1, truth=True, time_step=TIME_STEP)
    return twin, simulate(twin, OFF, 2.5)


def test_at_rest_its_feet_carry_its_own_weight(resting):
    twin, recording = resting
    rear_x, rear_z, front_x, front_z = recording.contact_force[:, -1]
    weight = GRAVITY * mass(twin.specimen.drawn)
    assert weight != pytest.approx(GRAVITY * mass(twin.robot), rel=0.005)
    assert rear_z + front_z == pytest.approx(weight * np.cos(np.deg2rad(5.0)), rel=1e-3)
    assert rear_x + front_x == pytest.approx(weight * np.sin(np.deg2rad(5.0)), rel=5e-3)
    assert rear_z > front_z > 0.0  # the rear feet are below


def test_a_camera_sees_the_body_ten_times_a_second_with_noise(resting):
    _, recording = resting
    seen = recording.body_pose[:, 21:].reshape(3, -1, 2)  # when it has settled
    assert (seen[:, :, 0] == seen[:, :, 1]).all()
    noise = seen[:, :, 0].std(axis=1)
    assert noise == pytest.approx([3e-4, 3e-4, np.deg2rad(0.2)], rel=0.5)


def test_each_foot_slides_by_coulombs_law_with_its_own_friction():
    """Down a slope that is too steep for both; where a foot sticks, its force is less."""
    robot = RobotParameters()
    robot.ground.slope = np.deg2rad(20.0)
    specimen = RobotSpecimen(robot, 4)
    specimen.foot_friction = [0.15, 0.25]
    twin = RobotTwin(specimen=specimen, truth=True)
    force = simulate(twin, OFF, 0.2, sample_rate=500.0).contact_force.reshape(2, 2, -1)
    for (x, z), friction in zip(force, specimen.foot_friction, strict=True):
        loaded = z > 0.02
        assert (np.abs(x[loaded]) / z[loaded]).max() == pytest.approx(friction, rel=1e-3)


def test_with_all_effects_taken_out_it_is_the_model():
    """With the law of its wires, 25 ms later: smoothed by 50 ms, less half of the wires' steps."""
    specimen = RobotSpecimen(RobotParameters(), 3).without(*RobotSpecimen.effects)
    described, model = RobotParameters(), specimen.true_robot()
    assert mass(model) == mass(described)
    assert model.ground == described.ground
    for limb, place in zip(model.limbs, model.wires_of, strict=True):
        limb.parameters.ambient_temperature = specimen.ambient
        for wire, true in zip(limb.parameters.wires, specimen.wires[place], strict=True):
            cold = expit((true.austenite - specimen.ambient) / true.austenite_width)
            wire.law = SaturatingLaw(
                a1=-1 / true.fast_time,
                a2=true.heating,
                a3=true.lag_rate,
                silicone_warming=1e-5,
                full_torque=true.torque / cold,
                middle=true.austenite,
                width=true.austenite_width,
            )
    duty = np.array([102, 0, 204, 51]) / 255  # steps of the PWM
    found = simulate(RobotTwin(specimen=specimen, truth=True, time_step=TIME_STEP), duty, 2.0)
    expected = simulate(Robot(model, time_step=TIME_STEP), duty, 2.0)
    assert found.wire_temperature == pytest.approx(expected.wire_temperature, abs=0.1)

    def later(signal):
        return np.array([np.interp(found.time - 0.025, found.time, row) for row in signal])

    angles, true_angles = found.joint_state[:10], later(expected.joint_state[:10])
    assert np.abs(true_angles).max() > 0.03
    assert np.abs(angles - true_angles).max() < 2e-3


def test_a_seed_draws_a_robot_and_its_identity_makes_it_again():
    first, again, other = (RobotTwin(seed=seed).specimen for seed in (5, 5, 6))
    assert again.drawn == first.drawn
    assert again.foot_friction == first.foot_friction
    assert (again.wires, again.segments) == (first.wires, first.segments)
    assert other.drawn != first.drawn
    shares = [specimen.drawn.feet.stiffness / 2e4 for specimen in (first, other)]
    assert 0.0 < max(np.abs(np.array(shares) - 1)) <= 0.2
    assert shares[0] != shares[1]
    assert other.wires != first.wires
    assert RobotSpecimen.of(first.without("body").board).board == first.without("body").board
    numbers = {first.board.serial_number, other.board.serial_number}
    numbers |= {first.limb(name).board.serial_number for name in ("rear", "front")}
    assert len(numbers) == 4


def test_limb_specimen_equals_the_limb_on_the_robot():
    robot = RobotTwin(seed=5)
    specimen = robot.specimen.limb("front")
    twin = LimbTwin(specimen=specimen)
    assert specimen.wires == robot.specimen.wires[2:]
    assert specimen.segments == robot.specimen.segments[1:]
    assert twin.parameters.board == robot.robot.limb("front").board
    assert LimbTwin.of(twin.parameters).specimen.wires == specimen.wires
    again = RobotTwin.of(robot.robot.with_limbs({"front": twin.parameters}))
    assert again.specimen.foot_friction == robot.specimen.foot_friction
    weighed = robot.specimen.drawn.limb("front").segments[0].mass
    assert twin.parameters.segments[0].mass == weighed != 0.015
    # It is much stiffer than the nominal limb, and is let go as in a ring-down.
    hand = PiecewisePolynomial.FirstOrderHold([0.0, 0.4, 0.6], [[0.0, 0.8, 0.8]])
    let_go = simulate(twin.after_rest(hand=hand), [0.0, 0.0], 0.8)
    assert np.rad2deg(let_go.bend_angle[0, 11]) > 35.0
    assert np.abs(np.rad2deg(let_go.bend_angle[0, -1])) < 30.0


def test_a_replay_has_its_pose_and_it_goes_on_from_there(tmp_path, plan_like):
    twin = RobotTwin(seed=2, time_step=TIME_STEP)
    model = simulate(Robot(time_step=TIME_STEP), [0.3, 0.0, 0.0, 0.3], 1.0, sample_rate=10.0)
    journal = tmp_path / "recording.csv"
    recording = replay(plan_like(model), twin, unchecked=True, journal=journal)
    assert recording.source == "emulated robot, seed 2"
    assert recording.how == "emulated"
    loaded = Recording.load(journal)
    assert loaded.robot == recording.robot == twin.robot
    assert loaded.body_pose == pytest.approx(recording.body_pose, abs=1e-9)
    state = copy.deepcopy(twin.specimen.state)
    on = simulate(twin.after_rest(truth=True), OFF, 0.05)
    assert on.joint_state[:10, 0] == pytest.approx(state["joints"][:10])
    assert on.wire_temperature[0, 0] == pytest.approx(state["wires"][0])
    assert on.wire_temperature[0, 0] > twin.specimen.ambient + 3.0
    later = twin.after_rest(0.2).specimen.state
    assert later["wires"][0] < state["wires"][0]


def test_each_limb_has_a_board_of_its_own_on_one_robot():
    running = RunningTwin(RobotTwin(seed=1, truth=True, time_step=TIME_STEP))
    rear, front = (SimulatedBoard(running, step=5, limb=name) for name in ("rear", "front"))

    def run(seconds, duty=None):
        for _ in range(round(seconds / 0.05)):
            rear.run(0.05, duty)
            front.run(0.05)

    run(0.6)
    cold = front.temperature
    assert rear.arm()
    run(2.0, [0.0, 0.1])
    assert running.duty == pytest.approx([0.0, 0.1, 0.0, 0.0], abs=1e-4)
    assert rear.temperature[1] > cold[1] + 1.5
    assert front.temperature == pytest.approx(cold, abs=1.1)
    assert np.argmax(running.wire_temperature()) == 1
    for board, bend in zip((rear, front), running.reading("bend_angle"), strict=True):
        (sensor,) = (segment.bend_sensor for segment in board.parameters.segments)
        assert np.rad2deg(sensor.bend_angle(board.samples[-1].tip_tangent)) == pytest.approx(
            np.rad2deg(bend), abs=0.3
        )
    rear.emulation.inject_fault("open right")
    run(0.2, [0.0, 0.1])
    assert rear.duty == (0.0, 0.0)
    assert front.reason != rear.reason
    assert not running.duty.any()


def test_one_board_has_all_limbs():
    twin = RobotTwin(seed=1)
    board = SimulatedBoard(twin, step=5)
    board.run(0.6)
    assert len(board.temperature) == 4
    assert len(board.samples[-1].tip_tangent) == 2
    assert board.emulation.board.serial_number == twin.specimen.board.serial_number.encode()
