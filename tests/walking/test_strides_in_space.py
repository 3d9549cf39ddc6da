"""What strides in space tell, of robots in Drake's contact whose friction and feet are known."""

import dataclasses

import numpy as np
import pytest

from calibration.remarks import CalibrationError
from limb_systems import simulate
from walking import Robot, RobotParameters, plan_gait
from walking.strides_in_space import fit_strides_in_space, warp_pattern, with_warp_and_friction

QUICK = 4.0  # times, that wires heat and cool faster, so that cycles are so much shorter


def test_three_feet_have_no_warp_and_four_have_one():
    assert not warp_pattern(RobotParameters.in_space(3)).any()
    robot = RobotParameters.in_space(4)  # rear left, front left, rear right, front right
    np.testing.assert_allclose(warp_pattern(robot), [1.0, -1.0, -1.0, 1.0])
    warped = with_warp_and_friction(robot, 1e-3, np.log(0.8))
    heights = np.array([limb.position[2] for limb in warped.limbs])
    assert heights @ [1.0, -1.0, -1.0, 1.0] == pytest.approx(1e-3)
    assert warped.ground.friction == pytest.approx(0.8 * robot.ground.friction)


@pytest.mark.whole
def test_warp_and_friction_are_those_of_the_robot_that_walked():
    robot = RobotParameters.in_space(4)
    for law in (wire.law for limb in robot.limbs for wire in limb.parameters.wires):
        law.a1, law.a2, law.a3 = QUICK * law.a1, QUICK * law.a2, QUICK * law.a3
    gait = plan_gait(robot, temperature_margin=5.0, check=False)
    other = with_warp_and_friction(robot, -1e-3, np.log(0.8))
    duty, duration = gait.duty_trajectory(2), 2 * gait.period + 0.05
    recording = simulate(Robot(other), duty, duration, initial_state=gait.initial_state)
    fit = fit_strides_in_space(gait, recording, 0.0, 2)
    assert fit.estimates["warp"].value == pytest.approx(-1e-3, abs=3e-4)
    assert fit.estimates["friction"].value == pytest.approx(0.8, abs=0.1)
    unseen = dataclasses.replace(recording, body_pose=None)
    with pytest.raises(CalibrationError, match="No camera sees the body"):
        fit_strides_in_space(gait, unseen, 0.0, 2)
