"""Feedback of a robot that walks: corrections from cycle to cycle, and in the loop."""

import dataclasses

import numpy as np
import pytest

from controllers import supervised
from limb_systems import HystereticLaw, LimbModel
from limb_systems.simulation import PERIOD
from walking import GaitFeedback, RobotParameters, plan_gait, walk

TIME, PACE, AMPLITUDE = range(3)  # of the correction


@pytest.fixture(scope="module")
def gait():
    """A crawl of 5 s per cycle, as of wires that heat and cool three times as fast."""
    robot = RobotParameters()
    for limb in robot.limbs:
        for wire in limb.parameters.wires:
            wire.law.a1 *= 3.0
            wire.law.a2 *= 3.0
    return plan_gait(robot, temperature_margin=10.0, check=False)


@pytest.fixture(scope="module")
def fed_walk(gait, fed):
    """Return what feedback shows until soon after two cycles of a robot that is read as planned.

    Its stride is a share of the plan's, and its bends are read off by some rad.
    """
    walked = walk(gait, 3)
    end = round((walked.duration - gait.period) / PERIOD)

    def after(stride=1.0, bend_error=0.0, seen=True):
        travel = stride * gait.speed * walked.time
        pose = np.array([travel, 0 * travel + 0.06, 0 * travel])
        inputs = {
            "measured_temperature": walked.measured_temperature.T,
            "bend_angle": walked.bend_angle.T + bend_error,
            "body_pose": (pose if seen else np.nan * pose).T,
        }
        inputs = {name: rows[: end + 10] for name, rows in inputs.items()}
        return fed(GaitFeedback(gait, 3), inputs), end

    return after


def test_feedback_corrects_nothing_on_a_robot_as_planned(fed_walk):
    found, _ = fed_walk()
    assert found.correction[-1, [PACE, AMPLITUDE]] == pytest.approx(1.0, abs=0.02)


def test_amplitude_follows_the_stride_after_two_cycles(fed_walk):
    found, end = fed_walk(stride=0.8)
    assert (found.correction[: end - 2, AMPLITUDE] == 1.0).all()
    assert found.correction[-1, AMPLITUDE] == pytest.approx(0.8**-0.5, abs=0.02)


def test_the_clock_waits_for_a_limb_that_lags_also_if_the_body_is_not_seen(gait, fed_walk):
    found, _ = fed_walk(stride=0.5, bend_error=np.deg2rad([0.0, -8.0]), seen=False)
    assert (found.correction[:, AMPLITUDE] == 1.0).all()
    in_warm_up = found.correction[:, TIME] < walk(gait, 3).duration - 3 * gait.period - PERIOD
    assert (found.correction[in_warm_up, PACE] == 1.0).all()
    assert found.correction[-1, PACE] == 0.5
    assert np.diff(found.correction[-5:, TIME]) == pytest.approx(0.5 * PERIOD)


def test_bends_near_the_plan_are_left_and_wires_held_to_its_heat(gait):
    """Wires cannot be cooled: small corrections to and fro would warm both wires of a limb."""
    feedback = GaitFeedback(gait, 1)
    state = feedback.CreateDefaultContext().get_discrete_state()
    plan = feedback._plan
    time = feedback._begin + 0.6 * gait.period
    k = plan.index(time)
    rested = feedback._estimator.begin(plan.heat[k, -4:], np.zeros(2))

    def desired(error, warmer=0.0):
        heat = plan.heat[k] + warmer * (np.arange(len(plan.heat[k])) < 4)
        there = dataclasses.replace(rested, heat=heat, lasting=feedback._planned_offset[k])
        predicted = feedback._predicted_error(time, there, state)
        there = dataclasses.replace(there, lasting=there.lasting + predicted - error)
        return feedback._desired_duty(time, there, np.ones(4), state)

    rates = feedback._estimator.model.heating_rates
    for error, rate in ((0.9, 0.0), (-0.9, 0.0), (2.0, 2.5), (-3.0, -5.0)):
        duty, bend_rate = desired(np.deg2rad([error, 0.0]))
        assert np.rad2deg(bend_rate) == pytest.approx([rate, 0.0], abs=1e-6)
        assert duty == pytest.approx(plan.duty[k], abs=1e-6)
    duty, _ = desired(np.zeros(2), warmer=4.0)
    assert duty == pytest.approx(plan.duty[k] - 4.0 / rates)


def test_supervised_robot_has_the_ports_of_a_robot(gait):
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
