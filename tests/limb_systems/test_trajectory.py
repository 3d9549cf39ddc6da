"""Trajectories between their knots, on another clock."""

import dataclasses

import numpy as np
import pytest
from pydrake.systems.primitives import PassThrough

from calibration import validate
from hardware import replay
from limb_systems import (
    ActiveConstraint,
    Limb,
    LinearLaw,
    bend_angle,
    simulate,
)
from limb_systems.tracking import tracking_errors


@pytest.fixture(scope="module")
def late_plan(fig5_plan):
    """The same plan, on a clock that is at 5 s when it starts."""
    bounds = [
        ActiveConstraint(bound.bound, bound.start + 5.0, bound.end + 5.0)
        for bound in fig5_plan.check.active_constraints
    ]
    check = dataclasses.replace(fig5_plan.check, active_constraints=bounds)
    return dataclasses.replace(fig5_plan, time=fig5_plan.time + 5.0, check=check)


def test_a_plan_that_starts_late_is_followed_and_judged_as_from_zero(fig5_plan, late_plan):
    plan = late_plan.since_start()
    np.testing.assert_allclose(plan.time, fig5_plan.time, atol=1e-12)
    starts = [bound.start for bound in fig5_plan.check.active_constraints]
    np.testing.assert_allclose([b.start for b in plan.check.active_constraints], starts)
    early, late = (replay(p, Limb(p.parameters)) for p in (fig5_plan, late_plan))
    np.testing.assert_allclose(late.bend_angle, early.bend_angle, atol=1e-6)
    errors = [tracking_errors(p, [late]).mean for p in (fig5_plan, late_plan)]
    assert errors[1] == pytest.approx(errors[0], rel=1e-3)


def test_a_recording_that_starts_late_is_validated_as_from_zero(fig5_plan):
    recording = simulate(Limb(fig5_plan.parameters), fig5_plan, 10.0)
    late = dataclasses.replace(recording, time=recording.time + 5.0)
    validation = validate(fig5_plan.parameters, late)
    assert validation.mean < np.deg2rad(0.1)
    np.testing.assert_array_equal(validation.simulation.time, late.time)


def test_values_of_a_plan_at_one_time_are_vectors_that_ports_take(fig5_plan):
    """An array of shape (1, 1), such as Drake's trajectories of one row give, is none to 1.58."""
    bend, duty = fig5_plan.bend_angle_at(7.3), fig5_plan.duty_at(7.3)
    np.testing.assert_array_equal(bend, fig5_plan.bend_angle_at([7.3])[:, 0])
    np.testing.assert_array_equal(duty, fig5_plan.duty_at([7.3])[:, 0])
    for value in (bend, duty, fig5_plan.interpolated(fig5_plan.reference, 7.3)):
        port = PassThrough(len(value)).get_input_port()
        context = port.get_system().CreateDefaultContext()
        port.FixValue(context, value)
        np.testing.assert_array_equal(port.Eval(context), value)


def test_states_between_knots_have_the_slopes_of_the_dynamics(fig5_plan):
    states = fig5_plan.state_trajectory()
    np.testing.assert_allclose(states.vector_values(fig5_plan.time), fig5_plan.state, atol=1e-9)
    times = fig5_plan.time[5:-5:7] + 0.03
    angles = bend_angle(fig5_plan.parameters, states.vector_values(times)[:5])
    np.testing.assert_allclose(angles, fig5_plan.bend_angle_at(times), atol=1e-9)
    heat = states.derivative().vector_values(fig5_plan.time[1:-1])[10:12]
    law = LinearLaw()
    expected = law.a1 * (fig5_plan.wire_temperature - 25.0) + law.a2 * fig5_plan.duty
    np.testing.assert_allclose(heat, expected[:, 1:-1], atol=1e-6)
    middle = fig5_plan.time[3:5].mean()
    duty = fig5_plan.duty_at(middle)  # linear between knots
    np.testing.assert_allclose(duty, fig5_plan.duty[:, 3:5].mean(axis=1), atol=1e-12)
