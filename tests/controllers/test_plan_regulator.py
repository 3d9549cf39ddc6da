"""The regulator against a Riccati recursion that is written out, and margins against the loop."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from controllers import PlanFeedback, PlanRegulator, ReducedModel, stability_margins
from controllers.plan_controller import SampledPlan
from controllers.plan_regulator import BEND, DUTY, TEMPERATURE, regulator_gains

PERIOD = 0.05


def test_gains_are_those_of_the_riccati_recursion(short_plan):
    """For x = [T, p] of linear wires, and the cost of the bend that the next period begins with."""
    model = ReducedModel(short_plan.parameters)
    sampled = SampledPlan(short_plan, short_plan.parameters)
    _, A_heat, B_heat = model.linearized_step(sampled.heat[0], sampled.duty[0])
    C_heat = model.bend_slopes(sampled.heat[0])[1]
    A, B = np.eye(3), np.vstack([B_heat[:2], np.zeros((1, 2))])
    A[:2, :2] = A_heat[:2, :2]
    C = np.append(C_heat[:, :2], [[1.0]], axis=1)
    # The bend at the beginning of a period costs in its successor's state, so not at the last.
    cost = np.diag([TEMPERATURE**-2, TEMPERATURE**-2, 0.0])
    P, expected = np.zeros((3, 3)), []
    for _ in sampled.duty:
        K = np.linalg.solve(np.eye(2) * DUTY**-2 + B.T @ P @ B, B.T @ P @ A)
        expected.append(K)
        Q = cost + (C.T @ C * BEND**-2 if len(expected) > 1 else 0.0)
        P = Q + A.T @ P @ (A - B @ K)
    gains = regulator_gains(model, sampled)
    np.testing.assert_allclose(gains, expected[::-1], rtol=1e-6, atol=1e-9)


def largest_late(controller, model, start, gain=1.0, delay=0.0):
    """The largest distance from the plan in the last of 12 s, of one that begins 0.5° beside it.

    The limb is the model, its wires heat more by a factor, and the bend is read late by s.
    """
    plan = controller._plan
    k = plan.index(start)
    simulator = Simulator(controller)
    context = simulator.get_mutable_context()
    ports = [controller.GetInputPort(name) for name in ("measured_temperature", "bend_angle")]
    heat, late = plan.heat[k].copy(), round(delay / PERIOD) + 1
    bends = [plan.bend_angle[k]] * late
    context.SetTime(start)
    missed = []
    for tick in range(240):
        ports[0].FixValue(context, model.readings(heat))
        ports[1].FixValue(context, bends[-late])
        duty = controller.GetOutputPort("duty").Eval(context).copy()
        simulator.AdvanceTo(start + PERIOD * (tick + 1))
        more = (gain - 1.0) * (duty - plan.duty[k]) if tick else 0.0
        heat = model.step(heat, duty + more)
        bends.append(model.bend_angle(heat) + np.deg2rad(0.5))
        missed.append(bends[-1] - plan.bend_angle[plan.index(start + PERIOD * tick)])
    return np.rad2deg(np.abs(missed[-20:]).max())


@pytest.mark.parametrize("kind", [PlanFeedback, PlanRegulator])
def test_margins_are_where_the_loop_begins_to_oscillate(kind, steady_plan):
    model = ReducedModel(steady_plan.parameters)
    margins = stability_margins(kind(steady_plan), 2.0)
    assert 1.5 < margins.gain < 20.0
    assert 0.2 < margins.delay < 2.0
    for share, oscillates in ((0.7, False), (2.0, True)):
        late = largest_late(kind(steady_plan), model, 2.0, delay=share * margins.delay)
        assert (late > 0.3) == oscillates, (kind, share, late)
        much = largest_late(kind(steady_plan), model, 2.0, gain=share * margins.gain)
        assert (much > 0.3) == oscillates, (kind, share, much)


def test_a_plan_is_the_model_under_its_own_duty(short_plan):
    """So that only what the limb does otherwise is regulated, from the first period on."""
    controller = PlanRegulator(short_plan)
    assert np.rad2deg(np.abs(controller._unlike_plan[[0, 1, -1]])).max() < 0.05
