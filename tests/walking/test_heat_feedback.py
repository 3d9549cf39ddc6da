"""Feedback that holds the heat of a plan: wires that heat otherwise, and a robot that walks."""

import copy

import numpy as np
import pytest

from hardware import replay
from limb_systems import Limb, LimbParameters, SegmentParameters
from planners import plan, references
from walking import HeatFeedback, Robot, RobotParameters, plan_gait, walk


def test_wires_that_heat_otherwise_than_described_have_the_heat_of_the_plan():
    limb = LimbParameters(segments=[SegmentParameters(links=1)])
    reference = references.from_samples([0.0, 20.0, 23.0, 30.0], [0.0, 0.0, 0.2, -0.1])
    planned = plan(limb, reference, knot_rate=5.0)
    other = copy.deepcopy(limb)
    for wire, share in zip(other.wires, (0.9, 1.1), strict=True):
        wire.law.a2 *= share
    missed = []
    for controller in (None, HeatFeedback(planned)):
        recording = replay(planned, Limb(other), controller=controller)
        heat = [np.interp(recording.time, planned.time, T) for T in planned.wire_temperature]
        apart = recording.wire_temperature - heat
        missed.append(np.sqrt((apart**2).mean(axis=1)))
    open_loop, held = missed
    assert (held < 0.35 * open_loop).all()


def test_there_is_no_duty_after_the_plan_s_end(short_plan, fed):
    """Though wires that cool are colder than the plan left them."""
    ticks = round(short_plan.duration / 0.05) + 20
    inputs = {"measured_temperature": np.full((ticks, 2), 25.0), "bend_angle": np.zeros((ticks, 1))}
    duty = fed(HeatFeedback(short_plan), inputs).duty
    assert duty[-22].max() > 0.1
    np.testing.assert_array_equal(duty[-18:], 0.0)


@pytest.mark.whole
@pytest.mark.parametrize("seed", [0, 1])
def test_a_robot_in_space_walks_from_cold_with_other_wires_and_friction(seed):
    """Friction 30% less, and wires of each limb that heat and pull by up to 10% otherwise."""
    gait = plan_gait(RobotParameters.in_space(3), temperature_margin=5.0, check=False)
    robot, rng = copy.deepcopy(gait.robot), np.random.default_rng(seed)
    robot.ground.friction *= 0.7
    for limb in robot.limbs:
        heats, pulls = rng.uniform(0.9, 1.1, 2)
        for wire in limb.parameters.wires:
            wire.law.a2 *= heats
            wire.law.beta *= pulls
    walked = walk(gait, 2)
    recording = replay(walked, Robot(robot), controller=HeatFeedback(walked), unchecked=True)
    ends = walked.duration - gait.period * np.arange(3)[::-1]
    poses = np.array([np.interp(ends, recording.time, row) for row in recording.body_pose])
    along, aside = gait.progress(poses)
    assert along[1] == pytest.approx(1.0, abs=0.15)
    assert aside.max() < 0.2
    assert recording.wire_temperature.max() < gait.parameters.temperature_limits.maximum
