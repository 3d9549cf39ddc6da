"""Plans of the coming seconds: by themselves, in a loop, and from a process of their own."""

import dataclasses
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.optimize import lsq_linear

from controllers import Learner, RecedingHorizon, ReducedModel
from controllers.horizon import HorizonPlanner, horizon_task
from controllers.receding_horizon import PlannerProcess
from hardware import replay
from limb_systems import CoupledLaw, HystereticLaw, Limb, LimbError, LimbParameters, simulate
from planners import Planner, Task, plan, references

from .conftest import limb_of

ONCE = Task(angle_weight=100.0, duty_weight=0.5, terminal_factor=1.0, duty_hold=0.0)


def small_limb(law=None):
    parameters = limb_of(law)
    parameters.temperature_limits.warm_up_time = 0.0
    return parameters


def wave(amplitude_deg, num_segments=1):
    times = np.arange(0.0, 15.0, 0.1)
    sine = np.deg2rad(amplitude_deg) * np.sin(0.8 * times)
    return references.from_samples(times, np.outer((-1.0) ** np.arange(num_segments), sine))


def warm_heat(parameters, temperature=60.0):
    model = ReducedModel(parameters)
    return model.heated(np.full(model.num_wires, temperature))


def test_a_linear_limb_is_planned_by_least_squares():
    """The impulse responses of a linear model, and bounds of duty, determine the best duty.

    The linear cost of the temperatures is completed to squares.
    """
    parameters = small_limb()
    parameters.temperature_limits.warm = -20.0
    parameters.total_duty = 2.0
    model, K, heat = ReducedModel(parameters, 0.2), 20, warm_heat(parameters)

    def under(duty):
        """The bend at the knots, and the sum of the mean temperatures."""
        course = model.rollout(heat, duty)[1:]
        return np.append(model.bend_angle(course)[:, 0], course[:, :2].mean(axis=1).sum())

    still = under(np.zeros((K, 2)))
    impulses = np.eye(2 * K).reshape(2 * K, K, 2)
    changes = np.array([under(impulse) - still for impulse in impulses]).T
    free, responses, warming = still[:-1], changes[:-1], 0.002 * changes[-1]
    first, *target = wave(12.0).vector_values(3.0 + 0.2 * np.arange(K + 1))[0] - 0.02
    angle = np.sqrt(100.0 * 2 * (2 / 3) ** 2)  # two joints, each at 2/3 of the bend, by (11)
    A = np.vstack([angle * responses, np.sqrt(0.5) * np.eye(2 * K)])
    b = np.r_[angle * (target - free), np.zeros(2 * K)]
    squares = b - A @ np.linalg.solve(A.T @ A, warming)
    best = lsq_linear(A, squares, (0.0, 1.0), tol=1e-12)
    task = dataclasses.replace(ONCE, temperature_weight=0.002)
    found = HorizonPlanner(parameters, wave(12.0), task, duration=4.0).plan(
        3.0, heat, np.array([0.02])
    )
    assert found.success
    given = 0.5 * (angle * first) ** 2 + 0.002 * 35.0  # cost of the first knot, at 60 °C and 0°
    cost = 0.5 * ((A @ best.x - b) ** 2).sum() + warming @ best.x + 0.002 * (still[-1] - 25.0 * K)
    cost += given
    assert found.cost == pytest.approx(cost, rel=1e-6)
    np.testing.assert_allclose(found.duty.ravel(), best.x, atol=2e-3)
    np.testing.assert_allclose(found.bend_angle[1:, 0] - 0.02, free + responses @ best.x, atol=1e-4)


def test_it_is_as_good_as_the_planner_with_its_chain():
    parameters = small_limb()
    heat = warm_heat(parameters)
    found = HorizonPlanner(parameters, wave(12.0), ONCE).plan(0.0, heat, np.zeros(1))
    state = np.r_[np.zeros(4), heat]
    theirs = Planner(parameters, found.time, task=ONCE, tolerance_deg=1.0).plan(
        wave(12.0), state, elapsed=0.1
    )
    missed = [
        np.rad2deg(np.abs(bend - theirs.reference[0])).mean()
        for bend in (found.bend_angle[:, 0], theirs.bend_angle[0])
    ]
    assert missed[1] > 0.5  # the reference is not feasible
    assert missed[0] == pytest.approx(missed[1], rel=0.03)
    assert found.cost == pytest.approx(theirs.check.cost, rel=0.05)


def test_hysteresis_is_planned_from_a_plan_before():
    """One round from the plan before is as good as many from nothing."""
    parameters = small_limb(HystereticLaw)
    planner, heat = HorizonPlanner(parameters, wave(10.0)), warm_heat(parameters)
    first = planner.plan(0.0, heat, np.zeros(1))
    knots = first.time <= 5.0
    missed = np.rad2deg(first.bend_angle[:, 0] - wave(10.0).vector_values(first.time)[0])
    assert np.abs(missed[knots]).mean() < 2.5
    after = first.heat[2]
    anew = planner.plan(first.time[2], after, np.zeros(1))
    again = planner.plan(first.time[2], after, np.zeros(1), first)
    assert again.cost < 1.01 * anew.cost


@pytest.mark.whole
def test_a_wire_within_its_play_is_heated_as_in_the_plan_of_the_motion():
    """There the bend does not change with heat, so no slope leads on from a plan without duty."""
    parameters = small_limb(
        lambda: CoupledLaw(heating_middle=69.0, cooling_middle=46.0, width=5.7, play_share=1.0)
    )
    reference = references.from_samples([0.0, 4.0, 20.0], np.deg2rad([[0.0, -12.0, -12.0]]))
    model, off = ReducedModel(parameters, 0.2), np.zeros((50, 2))
    heat = model.rollout(warm_heat(parameters, 55.0), off[:10])[-1]
    whole = plan(parameters, reference, initial_state=np.r_[np.zeros(4), heat])
    bends = []
    for planned in (None, whole):
        planner = HorizonPlanner(parameters, reference, planned=planned)
        before = dataclasses.replace(planner.first_horizon(whole), duty=off)
        bends.append(np.rad2deg(planner.plan(0.0, heat, np.zeros(1), before).bend_angle[-1]))
    assert bends[0] == pytest.approx(0.0, abs=1.0)
    assert bends[1] == pytest.approx(-12.0, abs=0.5)


def test_a_horizon_has_no_other_limits_of_a_task():
    task = dataclasses.replace(
        horizon_task(), reach=True, max_bend_rate=0.01, stretch=(0.5, 2.0), customize=pytest.fail
    )
    parameters, offset = small_limb(), np.zeros(1)
    heat = warm_heat(parameters)
    expected, found = (
        HorizonPlanner(parameters, wave(12.0), each, duration=2.0).plan(0.0, heat, offset)
        for each in (horizon_task(), task)
    )
    np.testing.assert_array_equal(found.duty, expected.duty)


def test_there_is_a_plan_where_limits_are_passed_already():
    parameters, task = small_limb(), horizon_task()
    cold, hot = warm_heat(parameters, 25.0), warm_heat(parameters, 120.0)
    heat = np.where(np.arange(4) % 2, cold, hot)  # the left wire is hot
    found = HorizonPlanner(parameters, wave(0.0), task).plan(1.0, heat, np.zeros(1))
    assert found.success
    highest = 100.0 - task.temperature_margin
    assert found.duty[found.heat[:-1, 0] > highest + 1.0, 0].max() < 1e-3
    assert found.heat[-1, 0] < highest + 0.1
    assert found.duty[:3, 1].min() > 0.9  # the other is below T_warm, and bends it straight
    assert found.heat[-1, 1] > 45.0
    T = found.heat[:, :2]
    beyond = np.maximum(T[1:] - highest, 0.0).sum() + np.maximum(45.0 - T, 0.0).sum()
    missed = 50.0 * 2 * (2 / 3) ** 2 * (found.bend_angle**2).sum()
    heat = task.temperature_weight * (T.mean(axis=1) - 25.0).sum()
    duty = 0.5 * task.duty_weight * (found.duty**2).sum()
    assert found.cost == pytest.approx(beyond + missed + heat + duty, rel=1e-6)


def test_wires_stay_within_their_limits():
    parameters = small_limb()
    parameters.total_duty = 0.6
    task = Task(temperature_margin=25.0, duty_margin=0.5, terminal_factor=1.0, duty_weight=0.01)
    planner = HorizonPlanner(parameters, wave(60.0), task)
    found = planner.plan(0.0, warm_heat(parameters, 70.0), np.zeros(1))
    assert found.heat[:, :2].max() == pytest.approx(75.0, abs=0.01)
    assert found.heat[:, :2].min() > 45.0 - 0.01
    assert found.duty.max() == pytest.approx(0.5, abs=1e-6)
    cold = planner.plan(0.0, warm_heat(parameters, 25.0), np.zeros(1))  # both are to be warm
    assert cold.duty.sum(axis=1).max() == pytest.approx(0.6, abs=1e-6)


def test_both_bends_of_a_limb_in_space_follow_their_references():
    """Also where its weight turns it aside, and a bend from outside is made up for."""
    parameters = LimbParameters.in_space(wires=4)
    parameters.gravity, parameters.temperature_limits.warm_up_time = [3.0, -5.0, 4.0], 0.0
    offset, wanted = np.deg2rad([2.0, -1.0]), wave(8.0, 2)
    found = HorizonPlanner(parameters, wanted).plan(0.0, warm_heat(parameters), offset)
    missed = np.rad2deg(np.abs(found.bend_angle - wanted.vector_values(found.time).T))
    assert missed[10:].max() < 2.5
    assert missed[10:].mean() < 0.7


def test_residual_fades_and_lasting_bend_stays():
    """The plan straightens the limb now, and less so when the residual has gone."""
    parameters = small_limb()
    planner, heat = HorizonPlanner(parameters, wave(0.0)), warm_heat(parameters)
    lasting, residual = np.deg2rad([2.0]), np.deg2rad([-3.0])
    found = planner.plan(0.0, heat, lasting, residual=residual)
    beyond = found.bend_angle - ReducedModel(parameters).bend_angle(found.heat)
    fading = np.exp(-found.time / 20.0)[:, None]
    np.testing.assert_allclose(beyond, lasting + fading * residual, atol=1e-9)
    assert np.rad2deg(np.abs(found.bend_angle[10:])).max() < 0.5


def in_a_loop(controller, parameters):
    """A simulator of a limb that a controller drives, and the controller's context."""
    builder = DiagramBuilder()
    limb, controller = builder.AddSystem(Limb(parameters)), builder.AddSystem(controller)
    for name in ("measured_temperature", "bend_angle"):
        builder.Connect(limb.GetOutputPort(name), controller.GetInputPort(name))
    builder.Connect(controller.GetOutputPort("duty"), limb.GetInputPort("duty"))
    simulator = Simulator(builder.Build())
    return simulator, controller.GetMyContextFromRoot(simulator.get_context())


def replans(controller, context):
    return controller.GetOutputPort("replans").Eval(context).tolist()


def test_a_weaker_limb_follows_the_reference(short_plan):
    """Its wires pull 0.85 times as much as planned, and it rests at -2°."""
    weaker = small_limb()
    for wire in weaker.wires:
        wire.law.beta *= 0.85
    weaker.segments[0].rest_angle = np.deg2rad(-2.0)
    alone = simulate(Limb(weaker), short_plan)
    controller = RecedingHorizon(short_plan)
    followed = replay(short_plan, Limb(weaker), controller=controller)
    wanted = np.deg2rad(12.0)
    late = followed.time > 3.4
    missed = [np.rad2deg(np.abs(r.bend_angle[0, late] - wanted)).max() for r in (alone, followed)]
    assert missed[0] > 3.0
    assert missed[1] < 0.8


def test_feedback_between_plans_heats_no_wire_beyond_a_horizon(short_plan):
    """A wire at 89 °C has less duty than plan and feedback want, by the horizon's limit alone."""
    controller = RecedingHorizon(short_plan)
    parameters, estimator = short_plan.parameters, controller._estimator
    heat = estimator.model.heated(np.array([25.0, 89.0]))
    straight = dataclasses.replace(
        estimator.begin(heat[-2:], np.zeros(1)),
        heat=heat,
        lasting=-estimator.model.bend_angle(heat),
    )
    limits = [controller._temperature_limit(0.0, straight), None]
    caps = [controller._limiter.caps(straight, limit)[1] for limit in limits]
    assert limits[0] == pytest.approx(parameters.temperature_limits.maximum - 10.0)
    assert caps[0] < 0.5 * caps[1]


def test_plans_are_counted_and_those_that_fail_leave_the_last_in_force(short_plan):
    controller = RecedingHorizon(short_plan)
    simulator, context = in_a_loop(controller, short_plan.parameters)
    simulator.AdvanceTo(0.99)
    assert replans(controller, context) == [4, 0, 0]
    good = context.get_discrete_state(3).CopyToVector()
    made = controller._planner.plan
    controller._planner.plan = lambda *given: dataclasses.replace(made(*given), success=False)
    simulator.AdvanceTo(1.19)
    assert replans(controller, context) == [5, 0, 1]
    np.testing.assert_array_equal(context.get_discrete_state(3).value(), good)


def test_in_real_time_the_command_does_not_wait_for_a_plan(short_plan):
    """A process that has ended is an error."""
    controller = RecedingHorizon(short_plan, real_time=True)
    simulator, context = in_a_loop(controller, short_plan.parameters)
    planning = controller._process
    first = context.get_discrete_state(3).CopyToVector()
    os.kill(planning._process.pid, signal.SIGSTOP)
    simulator.AdvanceTo(0.79)  # four plans were due, but none is there
    assert replans(controller, context) == [1, 3, 0]
    np.testing.assert_array_equal(context.get_discrete_state(3).value(), first)
    os.kill(planning._process.pid, signal.SIGCONT)
    assert planning._connection.poll(600.0)
    simulator.AdvanceTo(0.81)
    newest = context.get_discrete_state(3).value()
    assert newest[0] == pytest.approx(0.05)  # from the tick after it was asked for
    planning._process.kill()
    assert planning._connection.poll(600.0)
    with pytest.raises(LimbError, match="The process that plans the coming seconds has ended"):
        planning.poll_plan()


def test_another_process_makes_the_same_plans_and_ends_with_its_owner(short_plan):
    here, there = HorizonPlanner.of(short_plan), PlannerProcess(short_plan)
    first = here.first_horizon(short_plan)
    question = 0.3, first.heat[1], np.array([0.02]), first
    there.begin(*question)
    ours = here.plan(*question)
    assert there._connection.poll(600.0)
    theirs = there.poll_plan()
    assert there.poll_plan() is None
    for name in ("time", "duty", "heat", "bend_angle"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    # It ends with the object, also if it is stopped.
    process_folder = Path(f"/proc/{there._process.pid}")
    there.begin(*question)
    os.kill(there._process.pid, signal.SIGSTOP)
    assert process_folder.exists()
    del there
    assert not process_folder.exists()


@pytest.fixture(scope="module")
def one_wire() -> LimbParameters:
    parameters = LimbParameters()
    segment = parameters.segments[0]
    segment.links, segment.wires = 2, segment.wires[1:]
    parameters.temperature_limits.warm_up_time = 1000.0
    return parameters


def test_it_plans_follows_and_learns(one_wire):
    reference = references.from_samples([0.0, 1.0, 2.0, 5.0], np.deg2rad([0.0, 0.0, 12.0, 10.0]))
    planned = plan(one_wire, reference, knot_rate=5.0, tolerance_deg=0.5)
    assert planned.duty.shape[0] == 1

    weak = LimbParameters.from_yaml(one_wire.to_yaml())
    weak.segments[0].wires[0].law.beta *= 0.8

    def distance(recording) -> float:
        asked = planned.bend_angle_at(recording.time)
        return float(np.rad2deg(np.abs(recording.bend_angle - asked).mean()))

    open_loop = simulate(Limb(weak), planned)
    followed = replay(planned, Limb(weak), controller=RecedingHorizon(planned))
    assert distance(followed) < 0.7 * distance(open_loop)

    learner = Learner(planned)
    learner.update(open_loop)
    duty = learner.duty_trajectory().vector_values(planned.time)
    assert np.abs(duty - planned.duty).max() > 0.05
    learned = simulate(Limb(weak), learner.duty_trajectory(), planned.duration)
    assert distance(learned) < 0.7 * distance(open_loop)
