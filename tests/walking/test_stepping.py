"""Gaits that lift feet: what is planned at knots holds between them, in Drake."""

import numpy as np
import pytest

from limb_systems import simulate
from walking import Robot, RobotParameters, plan_gait
from walking.robot_parameters import RobotLimb, walking_limb
from walking.schedules import schedule_of
from walking.walker import Walker

COOLING = 4.0  # times the nominal, so that a phase is short


def stepper() -> RobotParameters:
    """A robot with two pairs of limbs, in the order around its body."""
    corners = {"rear_left": -1, "front_left": 1, "front_right": 1, "rear_right": -1}
    limbs = [
        RobotLimb(name, position=[0.03 * x, 0.0, 0.0], parameters=walking_limb())
        for name, x in corners.items()
    ]
    for limb in limbs:
        for wire in limb.parameters.segments[0].wires:
            wire.law.a1 *= COOLING
            wire.law.a2 *= COOLING
    return RobotParameters(limbs=limbs)


@pytest.mark.whole
def test_diagonal_pairs_lift_their_feet_clear_of_the_ground_in_drake():
    robot = stepper()
    schedule = schedule_of("lsls ssss slsl ssss", 4)
    gait = plan_gait(robot, schedule=schedule, intervals=12, check=False)
    swing = gait.phases[1].start
    recording = simulate(
        Robot(robot),
        gait.duty_trajectory(),
        swing,
        initial_state=gait.initial_state,
        sample_rate=100,
    )
    # Before, it starts from rest; after, contact gives way, so that feet land a little early.
    within = (recording.time > 0.2 * swing) & (recording.time < 0.9 * swing)
    loads = recording.contact_force[1::2, within]
    planar = Walker(robot)
    assert np.all(loads[::2] == 0)
    assert loads.sum(axis=0).mean() == pytest.approx(-planar.weight[2], rel=0.01)
    joints = recording.joint_state[: robot.as_single_limb.num_joints]
    feet = planar.feet(np.vstack([recording.body_pose, joints])[:, within].T)
    lifted = feet[:, ::2, 1] - planar.radius
    assert lifted.min() > 0.1e-3
    assert lifted.max() > 1e-3
    landing = np.argmin(np.abs(gait.time - swing))
    assert recording.body_pose[0, -1] == pytest.approx(gait.body_pose[0, landing], rel=0.05)
