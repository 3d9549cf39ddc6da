"""Feedback of a robot that walks: corrections from cycle to cycle, and in the loop."""

import dataclasses

import numpy as np
import pytest

from controllers import supervised
from limb_systems import HystereticLaw, LimbModel
from walking import GaitFeedback, RobotParameters, plan_gait, walk

PERIOD = 0.05  # s
TIME, AMPLITUDE, DURATION = range(3)  # of the correction


@pytest.fixture(scope="module")
def gait():
    """A crawl of 2 s per cycle, as of wires that heat and cool eight times as fast."""
    robot = RobotParameters()
    for limb in robot.limbs:
        for wire in limb.parameters.wires:
            wire.law.a1 *= 8.0
            wire.law.a2 *= 8.0
    return plan_gait(robot, temperature_margin=10.0, check=False)


@pytest.fixture(scope="module")
def corrections(gait, fed):
    """The correction (K, ...) until soon after two cycles, of a robot that is read as planned but
    for the shares of the stride and of the bends; and the tick at which they end."""
    walked = walk(gait, 3)
    begin, end = (round((walked.duration - n * gait.period) / PERIOD) for n in (3, 1))

    def after(stride=1.0, bend=1.0, seen=True):
        planned = walked.bend_angle
        mean = planned[:, begin:].mean(axis=1, keepdims=True)
        travel = stride * gait.speed * walked.time
        pose = np.array([travel, 0 * travel + 0.06, 0 * travel])
        inputs = {
            "measured_temperature": walked.measured_temperature.T,
            "bend_angle": (mean + bend * (planned - mean)).T,
            "body_pose": (pose if seen else np.nan * pose).T,
        }
        inputs = {name: rows[: end + 10] for name, rows in inputs.items()}
        return fed(GaitFeedback(gait, 3), inputs).correction, end

    return after


def test_nothing_is_corrected_where_all_is_as_planned(corrections):
    found, _ = corrections()
    assert found[-1, [AMPLITUDE, DURATION]] == pytest.approx(1.0, abs=0.02)  # of 40 ticks


def test_amplitude_follows_the_stride_and_the_clock_the_bends_after_two_cycles(corrections):
    found, after = corrections(stride=0.8, bend=0.9)
    assert (found[: after - 2, AMPLITUDE] == 1.0).all()
    assert found[-1, AMPLITUDE] == pytest.approx(0.8**-0.5, abs=0.02)
    assert found[-1, DURATION] == pytest.approx(1 / 0.9, abs=0.03)
    assert np.diff(found[after + 2 :, TIME]) == pytest.approx(PERIOD / found[-1, DURATION])


def test_a_body_that_is_not_seen_leaves_the_amplitude(corrections):
    found, _ = corrections(stride=0.5, seen=False)
    assert (found[:, AMPLITUDE] == 1.0).all()


def test_a_supervised_one_has_the_ports_of_a_robot(gait):
    system = supervised(GaitFeedback(gait, 1), gait.parameters)
    names = {system.get_input_port(i).get_name() for i in range(system.num_input_ports())}
    assert names == {"measured_temperature", "bend_angle", "body_pose"}


def test_the_duty_that_holds_wires_with_memory_is_finite(gait):
    """The memory of a wire does not change with its duty within a step."""
    robot = RobotParameters()
    for limb in robot.limbs:
        for wire in limb.parameters.wires:
            wire.law = HystereticLaw()
    states = LimbModel.of(robot.as_single_limb).wires.settled_states(
        gait.wire_temperature.mean(axis=1)
    )
    others = np.tile(states[4:, None], len(gait.time))
    gait = dataclasses.replace(gait, robot=robot, other_wire_state=others)
    with np.errstate(divide="raise", invalid="raise"):
        feedback = GaitFeedback(gait, 1)
    assert np.isfinite(feedback._holding).all()
