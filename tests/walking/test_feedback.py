"""Feedback of robots that walk, by cycle and by heat, and what their strides tell."""

import copy
import dataclasses

import numpy as np
import pytest

from calibration.remarks import CalibrationError
from controllers import supervised
from hardware import replay
from limb_systems import HystereticLaw, Limb, LimbModel, LimbParameters, SegmentParameters, simulate
from limb_systems.simulation import PERIOD
from planners import plan, references
from walking import GaitFeedback, HeatFeedback, Robot, RobotParameters, plan_gait, walk
from walking.gait_check import warp_pattern, with_warp_and_friction
from walking.strides import fit_strides

from .conftest import with_quick_wires

TIME, PACE, AMPLITUDE = range(3)  # of the correction


@pytest.fixture(scope="module")
def gait(quick_crawl):
    return quick_crawl


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
        there = dataclasses.replace(rested, heat=heat)
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


def test_bends_that_the_ground_makes_in_the_gait_are_no_error(gait):
    """They change by degrees in half a second, which no filter could follow."""
    feedback = GaitFeedback(gait, 1)
    state = feedback.CreateDefaultContext().get_discrete_state()
    plan = feedback._plan
    first = round(feedback._begin / PERIOD)
    estimate = feedback._estimator.begin(plan.heat[first, -4:], np.zeros(2))
    estimate = dataclasses.replace(estimate, heat=plan.heat[first])
    changes = []
    for k in range(first, first + round(0.8 * gait.period / PERIOD)):
        bend = plan.bend_angle[k - 1]  # at the beginning of this period
        known_offset = feedback._known_offset(PERIOD * k)
        estimate = feedback._estimator.correct(estimate, plan.heat[k, -4:], bend, known_offset)
        error = feedback._predicted_error(PERIOD * k, estimate, state)
        assert np.rad2deg(np.abs(error)).max() < 1.0  # beyond which errors are corrected
        changes.append(known_offset)
        estimate = feedback._estimator.predict(estimate, plan.duty[k])
    assert np.rad2deg(np.ptp(changes, axis=0)).min() > 2.0


def test_the_ground_bends_limbs_as_in_the_gait_whatever_else_is_known_of_them(crawl):
    """Limbs that are now known to pull harder are no harder ground."""
    stronger = copy.deepcopy(crawl.parameters)
    for wire in stronger.wires:
        wire.law.beta *= 1.2
    known_again = GaitFeedback(crawl, 1, parameters=stronger)
    np.testing.assert_array_equal(
        known_again._planned_offset, GaitFeedback(crawl, 1)._planned_offset
    )


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


def test_three_feet_have_no_warp_and_four_have_one():
    assert not warp_pattern(RobotParameters.in_space(3)).any()
    robot = RobotParameters.in_space(4)  # rear left, front left, rear right, front right
    np.testing.assert_allclose(warp_pattern(robot), [1.0, -1.0, -1.0, 1.0])
    warped = with_warp_and_friction(robot, 1e-3, np.log(0.8))
    heights = np.array([limb.position[2] for limb in warped.limbs])
    assert heights @ [1.0, -1.0, -1.0, 1.0] == pytest.approx(1e-3)
    assert warped.ground.friction == pytest.approx(0.8 * robot.ground.friction)


@pytest.mark.whole
def test_strides_fit_in_space_recovers_warp_and_friction():
    robot = with_quick_wires(RobotParameters.in_space(4), 4.0)
    gait = plan_gait(robot, temperature_margin=5.0, check=False)
    other = with_warp_and_friction(robot, -1e-3, np.log(0.8))
    duty, duration = gait.duty_trajectory(2), 2 * gait.period + 0.05
    recording = simulate(Robot(other), duty, duration, initial_state=gait.initial_state)
    fit = fit_strides(gait, recording, 0.0, 2)
    assert fit.estimates["warp"].value == pytest.approx(-1e-3, abs=3e-4)
    assert fit.estimates["friction"].value == pytest.approx(0.8, abs=0.1)
    unseen = dataclasses.replace(recording, body_pose=None)
    with pytest.raises(CalibrationError, match="No camera sees the body"):
        fit_strides(gait, unseen, 0.0, 2)
