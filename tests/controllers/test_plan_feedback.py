"""Feedback about a plan: duty and gains by least squares, and limbs that are not as planned."""

import copy
import dataclasses

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from controllers import PlanFeedback, PlanRegulator, ReducedModel
from controllers.plan_controller import SampledPlan, allocate, limit_total_duty
from controllers.plan_feedback import (
    BEND_DEVIATION,
    DUTY_DEVIATION,
    TEMPERATURE_DEVIATION,
    regulator_gains,
)
from hardware import replay
from limb_systems import Limb, LimbModel, LimbParameters, simulate
from limb_systems.limb_parameters import CalibrationRecord
from planners import plan, references

LEFT, RIGHT = -0.12, 0.11  # rad/s, bend rates by full duty


def least_change(bend_rate, duty, gains, caps):
    """That of all changes which come nearest to the bend rate, by two convex programs."""
    prog = MathematicalProgram()
    change = prog.NewContinuousVariables(len(duty))
    prog.AddBoundingBoxConstraint(-duty, caps - duty, change)
    missed = prog.Add2NormSquaredCost(gains, bend_rate, change)
    nearest = gains @ ClarabelSolver().Solve(prog).GetSolution(change)
    prog.RemoveCost(missed)
    prog.AddLinearEqualityConstraint(gains, nearest, change)
    prog.Add2NormSquaredCost(np.eye(len(duty)), np.zeros(len(duty)), change)
    return duty + ClarabelSolver().Solve(prog).GetSolution(change)


def around_an_axis(wires):
    """Gains of wires at 17° and on, rad/s by full duty."""
    angles = 0.3 + 2 * np.pi * np.arange(wires) / wires
    return RIGHT * np.array([np.cos(angles), np.sin(angles)])


@pytest.mark.parametrize(
    "gains",
    [
        np.array([[LEFT, RIGHT]]),
        np.array([[LEFT, RIGHT, 0.0, 0.0], [0.0, 0.0, 1.2 * LEFT, RIGHT]]),
        around_an_axis(7),
    ],
)
def test_bend_rates_are_made_by_the_least_change_of_duty(gains):
    """Also where wires are off or at their caps, and cannot do all of it."""
    (num_bends, wires), made = gains.shape, []
    rng = np.random.default_rng(wires)
    for _ in range(20):
        caps = rng.uniform(0.0, 1.0, wires) * (rng.random(wires) < 0.8)
        duty = caps * np.clip(rng.uniform(-0.5, 1.5, wires), 0.0, 1.0)
        wanted = rng.uniform(-0.08, 0.08, num_bends)
        found = allocate(wanted, duty, gains, caps)
        assert ((found >= 0.0) & (found <= caps)).all()
        np.testing.assert_allclose(
            found, least_change(wanted, duty, gains, caps), atol=3e-4, err_msg=f"{wanted}"
        )
        made.append(np.allclose(gains @ (found - duty), wanted, atol=1e-5))
    assert 3 < sum(made) < 20


def test_duty_within_the_supply_keeps_its_proportions():
    np.testing.assert_allclose(limit_total_duty(np.array([0.9, 0.6]), 1.0), [0.6, 0.4])
    np.testing.assert_array_equal(limit_total_duty(np.array([0.3, 0.2]), 1.0), [0.3, 0.2])
    np.testing.assert_array_equal(limit_total_duty(np.zeros(2), 1.0), np.zeros(2))


def test_gains_follow_from_the_springs(two_segments):
    """a2 β (n + 1) / (2 k) of the segment's own wires, and zero for the other segment's."""
    gains = ReducedModel(two_segments).mean_gains
    for index, (segment, wires) in enumerate(
        zip(two_segments.segments, LimbModel.of(two_segments).layout.wires_of, strict=True)
    ):
        own = [
            wire.lever[0] * wire.law.a2 * wire.law.beta * (segment.links + 1) / 2
            for wire in segment.wires
        ]
        expected = np.zeros(4)
        expected[wires] = np.array(own) / segment.stiffness
        np.testing.assert_allclose(gains[index], expected, rtol=0.01)


def test_feedback_compensates_a_payload_except_towards_the_reference(short_plan):
    limb = copy.deepcopy(short_plan.parameters)
    limb.segments[0].rest_angle = np.deg2rad(-4.0)  # as by a payload of steady torque
    alone = simulate(Limb(limb), short_plan)
    late = alone.time > 3.4
    planned = short_plan.bend_angle_at(alone.time)

    def missed(recording):
        return np.rad2deg(np.abs(recording.bend_angle - planned)[0, late]).max()

    assert missed(alone) > 3.5
    for controller in (PlanFeedback, PlanRegulator):
        held = replay(short_plan, Limb(limb), controller=controller(short_plan))
        # A part is taken for the sensor's drift, at first.
        assert missed(held) < 0.25 * missed(alone)
        assert held.duty.max() <= 1.0
        assert held.duty.min() >= 0.0
    asked = dataclasses.replace(short_plan, reference=short_plan.bend_angle - np.deg2rad(10.0))
    left = replay(asked, Limb(limb), controller=PlanFeedback(asked))
    np.testing.assert_allclose(left.bend_angle, alone.bend_angle, atol=np.deg2rad(0.05))


def under(fed, controller, limb, ticks=100, readings=None, bend=None):
    """The duty of a controller of which the readings stay the same, °C and rad."""
    W, S = len(limb.wires), len(limb.segments)
    readings = np.full(W, limb.ambient_temperature) if readings is None else readings
    bend = np.zeros(S) if bend is None else bend
    rng = np.random.default_rng(1)
    return fed(
        controller,
        {
            "measured_temperature": readings + rng.normal(0.0, 0.2, (ticks, W)),
            "bend_angle": bend + rng.normal(0.0, 0.003, (ticks, S)),
        },
    ).duty


def test_wires_stay_cool_enough_and_duty_within_the_supply(fed, short_plan):
    """The limb never bends as planned, and so ever more is wanted, but not given."""
    limb = copy.deepcopy(short_plan.parameters)
    limb.total_duty = 0.8
    duty = under(fed, PlanFeedback(short_plan, parameters=limb), limb, bend=np.deg2rad([-15.0]))
    assert duty.sum(axis=1).max() == pytest.approx(0.8)
    hot = under(fed, PlanFeedback(short_plan), limb, readings=np.array([40.0, 104.5]))
    law = limb.segments[0].wire("right").law
    holds = -law.a1 * (104.5 - limb.ambient_temperature) / law.a2
    assert hot[20:, 1].max() < holds  # less than what would keep it there


def test_feedback_holds_the_bend_that_the_coming_duty_makes_and_gives_up_common_heat(short_plan):
    """Half a second later, by a simulation of the limb; both wires are warmer than planned."""
    limb = short_plan.parameters
    feedback, model = PlanFeedback(short_plan), ReducedModel(limb)
    heat, pushed = model.heated(np.array([40.0, 70.0])), np.deg2rad(-3.0)
    at_rest = feedback._estimator.begin(heat[-2:], np.zeros(1))
    estimate = dataclasses.replace(at_rest, heat=heat, lasting=np.array([pushed]))
    base, rate = feedback._desired_duty(0.0, estimate, np.ones(2), None)
    start = np.concatenate([model.joint_angles(heat), np.zeros(2), heat])
    later = simulate(Limb(limb), short_plan, 0.5, initial_state=start).bend_angle[:, -1] + pushed
    missed = short_plan.bend_angle_at([0.5])[:, 0] - later
    planned = SampledPlan(short_plan, limb).duty[0]
    np.testing.assert_array_equal(base, np.zeros(2))  # 30 °C too warm
    np.testing.assert_allclose(rate, 2.5 * missed + feedback._gains_at(0.0) @ planned, rtol=0.01)


def test_both_bends_of_a_limb_in_space_are_held():
    """Whose torque is 10% weaker than known, and which rests bent in another direction."""
    parameters = LimbParameters.in_space(wires=3, links=2)
    parameters.gravity = [0.0, -6.0, 7.0]
    parameters.temperature_limits.warm_up_time = 1000.0
    turned = np.deg2rad([[0.0, 0.0, 9.0, 9.0], [0.0, 0.0, -6.0, -6.0]])
    start = LimbModel.of(parameters).mechanics.bend_angle(
        LimbModel.of(parameters).statics.rest_angles
    )[:, None]
    course = plan(
        parameters, references.from_samples([0.0, 1.0, 3.0, 5.0], start + turned), knot_rate=5.0
    )
    other = copy.deepcopy(parameters)
    other.segments[0].rest_angle, other.segments[0].rest_angle_e3 = np.deg2rad([-2.0, 3.0]).tolist()
    for wire in other.wires:
        wire.law.beta *= 0.9
    missed = []
    for controller in (None, PlanFeedback(course), PlanRegulator(course)):
        held = replay(course, Limb(other), controller=controller)
        late = held.time > 4.0
        errors = LimbModel.of(other).layout.distances(
            held.bend_angle - course.bend_angle_at(held.time)
        )
        missed.append(np.rad2deg(errors[0, late]).max())
    assert missed[0] > 3.0
    assert max(missed[1:]) < 0.25 * missed[0]


def test_no_wire_is_heated_far_beyond_the_plan(short_plan):
    """Than in the next 2 s of the plan, plus what holds a bend from outside; or 30 °C over warm.

    If the limb is not calibrated, that is at most the plan's highest, or 10 °C below T_max.
    """
    for calibrated, warmer in ((True, 6.0), (False, 20.0)):
        parameters = copy.deepcopy(short_plan.parameters)
        parameters.temperature_limits.maximum = 150.0
        parameters.calibration = CalibrationRecord([], [], [], []) if calibrated else None
        lukewarm = PlanFeedback(short_plan, parameters=parameters)
        parameters.temperature_limits.warm = -40.0
        feedback = PlanFeedback(short_plan, parameters=parameters)
        estimate = feedback._estimator.begin(np.full(2, 25.0), np.zeros(1))
        soon, planned = np.linspace(1.0, 3.0, 200), short_plan.wire_temperature
        hottest = [np.interp(soon, short_plan.time, row).max() for row in planned]
        limit = feedback._temperature_limit(1.0, estimate)
        np.testing.assert_allclose(limit, np.array(hottest) + warmer, atol=0.5)
        pushed = dataclasses.replace(estimate, lasting=np.deg2rad([-5.0]))
        law, segment = parameters.wires[1].law, parameters.segments[0]
        holds = np.deg2rad(5.0) * segment.stiffness / law.beta * 2 / (segment.links + 1)
        more = feedback._temperature_limit(1.0, pushed) - limit
        np.testing.assert_allclose(more, [0.0, holds], rtol=0.01, atol=1e-9)
        limited = lukewarm._temperature_limit(1.0, estimate)
        np.testing.assert_allclose(limited, np.maximum(limit, 55.0))
    for maximum in (max(hottest) + 15.0, max(hottest) + 5.0):
        parameters.temperature_limits.maximum = maximum
        limit = PlanFeedback(short_plan, parameters=parameters)._temperature_limit(1.0, estimate)
        most = np.maximum(maximum - 10.0, planned.max(axis=1))
        np.testing.assert_allclose(limit, np.minimum(np.add(hottest, 20.0), most), atol=0.5)


def test_the_regulator_minimizes_its_cost(short_plan):
    """For linear wires whose duty is free, over a plan of six periods, by least squares."""
    model = ReducedModel(short_plan.parameters)
    sampled = SampledPlan(short_plan, short_plan.parameters)
    K = 6
    sampled.heat, sampled.duty = sampled.heat[:K], sampled.duty[:K]
    _, A, B = (values[0] for values in model.linearized_step(sampled.heat, sampled.duty))
    (C,) = model.bend_slopes(sampled.heat[0])[1]
    start, bent = np.append([8.0, -5.0], np.zeros(2)), 0.02  # of T and V, °C, and of p, rad

    def deviations(duty):
        """All that costs, for duty (2 K,), over its scale."""
        x, costs = start, []
        for k, change in enumerate(duty.reshape(K, 2)):
            costs += [change / DUTY_DEVIATION, x[:2] / TEMPERATURE_DEVIATION]
            if k < K - 1:  # the bend at the beginning of a period counts at its end
                costs.append((C @ x + bent).ravel() / BEND_DEVIATION)
            x = A @ x + B @ change
        return np.concatenate(costs)

    still = deviations(np.zeros(2 * K))
    slopes = np.array([deviations(one) - still for one in np.eye(2 * K)]).T
    best = np.linalg.lstsq(slopes, -still, rcond=None)[0]
    gains = regulator_gains(model, sampled)
    assert gains.shape == (K, 2, 3)
    np.testing.assert_allclose(-gains[0] @ np.append(start[:2], bent), best[:2], rtol=1e-9)


def test_the_regulator_of_a_limb_that_is_as_planned_applies_the_planned_duty(short_plan):
    """Its bend is read one period before, and swings, as the reduced model's does not."""
    regulator, sampled = PlanRegulator(short_plan), SampledPlan(short_plan, short_plan.parameters)
    estimator = regulator._estimator
    for k in (25, 45):
        heat = sampled.heat[k]
        offset = sampled.bend_angle[k - 1] - estimator.model.bend_angle(heat)
        assert np.abs(offset).max() > 1e-4
        estimate = estimator.begin(heat[-2:], np.zeros(1))
        estimate = dataclasses.replace(estimate, heat=heat, lasting=offset)
        duty, _ = regulator._desired_duty(0.05 * k, estimate, np.ones(2), None)
        np.testing.assert_allclose(duty, sampled.duty[k], atol=1e-9)
