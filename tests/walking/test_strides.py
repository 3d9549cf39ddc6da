"""What strides tell, of robots in Drake's contact whose friction and limbs are known."""

import copy

import numpy as np
import pytest

from calibration.remarks import CalibrationError
from controllers import PlanFeedback
from hardware import replay
from walking import Robot, RobotParameters, plan_gait, walk
from walking.strides import fit_strides

QUICK = 8.0  # times, that wires heat and cool faster, so that cycles are so much shorter


@pytest.fixture(scope="module")
def walked():
    """A gait, two strides of another robot by it, the start of the first, and the robot."""
    robot = RobotParameters()
    for wire in (wire for limb in robot.limbs for wire in limb.parameters.wires):
        wire.law.a1, wire.law.a2, wire.law.a3 = (
            QUICK * rate for rate in (wire.law.a1, wire.law.a2, wire.law.a3)
        )
    gait, other = plan_gait(robot, check=False, temperature_margin=10.0), copy.deepcopy(robot)
    other.ground.friction *= 0.7
    for wire in other.limb("front").wires:
        wire.law.beta *= 0.8
    for wire in other.limb("rear").wires:
        wire.law.a2 *= 1.2
    plan = walk(gait, 2)
    recording = replay(plan, Robot(other), controller=PlanFeedback(plan), unchecked=True)
    return gait, recording, plan.duration - 2 * gait.period, other


def test_strides_fit_recovers_friction_torque_and_heat(walked):
    gait, recording, start, other = walked
    fit = fit_strides(gait, recording, start, 2)
    found = {name: estimate.value for name, estimate in fit.estimates.items()}
    assert found["friction"] == pytest.approx(0.7, abs=0.12)
    strength = found["front.torque"] / found["front.stiffness"]  # which is what bends a limb
    assert strength == pytest.approx(0.8, abs=0.08)
    assert found["rear.torque"] / found["rear.stiffness"] == pytest.approx(1.0, abs=0.05)
    assert [found[f"rear_{wire}.a2"] for wire in ("left", "right")] == pytest.approx(
        [1.2] * 2, abs=0.04
    )
    assert fit.robot.ground.friction == pytest.approx(
        gait.robot.ground.friction * found["friction"]
    )
    assert fit.heat[:4] == pytest.approx(recording.wire_temperature[:, -1], abs=2.0)
    planned, true = plan_gait(fit.robot, check=False), plan_gait(other, check=False)
    assert planned.speed == pytest.approx(true.speed, rel=0.1)


def test_recording_without_sliding_feet_is_refused(walked):
    gait, recording, start, _ = walked
    still = copy.copy(recording)
    still.bend_angle = np.zeros_like(recording.bend_angle)
    with pytest.raises(CalibrationError, match="No foot slides as planned"):
        fit_strides(gait, still, start, 2)
