"""Plans against the paper's program (15)-(20), Drake's evaluators and simulation."""

import os
import signal

import numpy as np
import pytest
import scipy.sparse
from pydrake.solvers import SnoptSolver
from pydrake.trajectories import PiecewisePolynomial

from limb_systems import (
    Limb,
    LimbError,
    LimbModel,
    LimbParameters,
    SegmentParameters,
    ThresholdLaw,
    bend_angle,
    joint_angles_from_bend_angle,
    simulate,
)
from planners import (
    InfeasibleError,
    Planner,
    PlanningError,
    Task,
    nearest_bend_angle,
    plan,
    plan_check,
    planning,
    radau,
    references,
)
from planners.transcription import ipopt, solving
from planners.transcription.program import TrajectoryProgram
from planners.transcription.quasi_static import QuasiStaticProgram, solve_quasi_static
from planners.transcription.warm_start import estimate_multipliers, solve_motion
from soft_limb.reports.plan_report import plan_verdict
from soft_limb.results.summaries import plan_summary

from .conftest import cold_parameters


def paper_cost(angles, duty, angles_ref):
    """Eqn (15), term by term as the paper prints it; arrays are (size, N)."""
    cost = 0.0
    for k in range(angles.shape[1] - 1):
        deviation = angles[:, k] - angles_ref[:, k]
        cost += 0.5 * (deviation @ (100 * deviation) + duty[:, k] @ (2 * duty[:, k]))
    deviation = angles[:, -1] - angles_ref[:, -1]
    return cost + 0.5 * deviation @ (1000 * 100 * deviation)


def short_reference(amplitude_deg=15.0, duration=6.0):
    return references.from_samples(
        [0.0, 1.0, 1.01, duration], np.deg2rad([0.0, 0.0, amplitude_deg, amplitude_deg])
    )


def test_cost_is_eqn_15(fig5_plan):
    angles_ref = joint_angles_from_bend_angle(fig5_plan.parameters, fig5_plan.reference)
    cost = paper_cost(fig5_plan.joint_angles, fig5_plan.duty, angles_ref)
    assert fig5_plan.check.cost == pytest.approx(cost, rel=1e-9)


def test_starts_at_the_initial_state(fig5_plan):
    np.testing.assert_array_equal(fig5_plan.state[:, 0], np.r_[np.zeros(10), np.full(4, 25.0)])


def test_bounds_hold_at_every_knot(fig5_plan):
    time, wire = fig5_plan.time, fig5_plan.wire_temperature
    assert fig5_plan.duty.min() >= 0.0
    assert fig5_plan.duty.max() <= 1.0
    assert wire.max() <= 100.0 + 50 * 1e-6
    assert wire[:, time > 20.0].min() >= 45.0 - 50 * 1e-6
    assert wire[:, time <= 19.0].min() < 44.0  # (20) is a bound on the time after k_warm only


def test_knots_are_evenly_spaced_at_the_knot_rate(fig5_plan):
    assert len(fig5_plan.time) == 601
    np.testing.assert_allclose(fig5_plan.time, np.arange(601) / 10, atol=1e-12)


def test_dynamics_hold_by_drakes_own_constraints(fig5_plan):
    program = TrajectoryProgram(fig5_plan.parameters, fig5_plan.time)
    program.update(fig5_plan.reference, fig5_plan.state[:, 0], 20.0)
    x = program.variables(fig5_plan.state, fig5_plan.duty)
    prog = program.prog
    every_third = prog.generic_constraints()[::3]
    defects = prog.EvalBindings(every_third, x).reshape(200, 14)
    plant = program.limb.GetSubsystemByName("manipulator")
    straight = plant.CalcMassMatrix(plant.CreateDefaultContext())
    stiffness, h = fig5_plan.parameters.segments[0].stiffness, 0.1
    assert np.abs(defects[:, :5] * h).max() < 1e-6
    assert np.abs(defects[:, 5:10] @ straight / stiffness).max() < 1e-6
    assert np.abs(defects[:, 10:] * h / 50).max() < 1e-6
    # Bounds, the initial state and the time steps, as Drake has them.
    assert prog.CheckSatisfied(prog.bounding_box_constraints(), x, 1e-6)
    # The record of the check is of the same size.
    disturbed = x.copy()
    disturbed[program.states[300, 0]] += 1e-3
    assert program.largest_defect(x) == pytest.approx(fig5_plan.check.largest_defect, abs=1e-9)
    assert program.largest_defect(disturbed) > 1e-4


def test_an_accurate_simulation_of_the_duty_stays_within_a_tenth_of_a_degree(fig5_plan):
    recording = simulate(Limb(), fig5_plan, sample_rate=50.0, accuracy=1e-6)
    checked = bend_angle(LimbParameters(), radau.simulate_plan(fig5_plan, recording.time))
    np.testing.assert_allclose(np.rad2deg(checked), np.rad2deg(recording.bend_angle), atol=1e-3)
    planned = fig5_plan.bend_angle_at(recording.time)
    difference = np.rad2deg(np.abs(recording.bend_angle - planned)).max()
    assert difference < 0.1
    assert fig5_plan.check.largest_difference_deg < 0.1
    at_knots = np.interp(recording.time, fig5_plan.time, fig5_plan.wire_temperature[1])
    assert np.abs(recording.wire_temperature[1] - at_knots).max() < 0.2


def test_plan_is_better_than_its_quasi_static_start(fig5_plan):
    """The start's duty, simulated, costs about what the check says; the plan costs less."""
    parameters, times = fig5_plan.parameters, fig5_plan.time
    heat = np.full(4, parameters.ambient_temperature)
    program, solution = solve_quasi_static(
        fig5_plan.model,
        times,
        fig5_plan.reference,
        heat,
        Task.paper(),
        20.0,
    )
    duty = solution.x[program.duty].T
    course = PiecewisePolynomial.FirstOrderHold(times, duty)
    rollout = simulate(Limb(), course, sample_rate=10.0, accuracy=1e-4)
    angles_ref = joint_angles_from_bend_angle(parameters, fig5_plan.reference)
    cost = paper_cost(rollout.joint_state[:5], duty, angles_ref)
    assert fig5_plan.check.guess_cost == pytest.approx(cost, rel=0.01)
    assert fig5_plan.check.cost < 0.998 * cost
    assert fig5_plan.check.cost < 0.9999 * fig5_plan.check.guess_cost


def test_tighter_tolerances_find_the_same_cost(monkeypatch):
    usual = plan(cold_parameters(), short_reference())
    monkeypatch.setitem(ipopt.OPTIONS, "tol", 1e-8)
    tight = plan(cold_parameters(), short_reference())
    assert tight.check.cost == pytest.approx(usual.check.cost, rel=1e-6)


def test_snopt_finds_the_same_optimum_of_the_same_program():
    """From our start, without our evaluation, Hessian or scaling of rows."""
    parameters = cold_parameters(segments=[SegmentParameters(links=1)])
    trajectory = plan(parameters, short_reference(), knot_rate=10.0, tolerance_deg=1.0)
    program = TrajectoryProgram(parameters, trajectory.time)
    program.update(trajectory.reference, trajectory.state[:, 0], 1000.0)
    guess = program.variables(trajectory.state, np.full_like(trajectory.duty, 0.1))
    result = SnoptSolver().Solve(program.prog, guess, None)
    assert result.is_success()
    assert result.get_optimal_cost() == pytest.approx(trajectory.check.cost, rel=1e-5)


@pytest.mark.parametrize("num_knots", [2, 4])
def test_plans_of_few_knots_are_checked(num_knots):
    straight = references.from_samples([0.0, 1.0], [0.0, 0.0])
    trajectory = plan(cold_parameters(), straight, knot_rate=num_knots - 1.0)
    assert len(trajectory.time) == num_knots
    assert trajectory.check.largest_difference_deg < 0.1


def test_gravity_is_planned_against():
    """The limb starts where gravity holds it, and wires lift it from there."""
    parameters = cold_parameters(gravity=[0.0, -9.81, 0.0])
    level = references.from_samples([0.0, 1.0, 5.0, 12.0], np.deg2rad([-10.0, -10.0, 0.0, 0.0]))
    trajectory = plan(parameters, level, knot_rate=20.0)
    assert np.rad2deg(trajectory.bend_angle[0, 0]) == pytest.approx(-10.0, abs=0.2)
    # (15) weighs joints, which gravity bends unevenly: level on average is not level.
    assert np.rad2deg(trajectory.joint_angles[:, -1].sum()) == pytest.approx(0.0, abs=0.5)
    assert np.rad2deg(trajectory.bend_angle[0, -1]) == pytest.approx(0.0, abs=3.0)
    assert trajectory.wire_temperature[1, -1] > trajectory.wire_temperature[0, -1] + 5


def test_active_constraints_are_named_with_their_time(fig5_plan):
    stretches = {(active.bound, active.start) for active in fig5_plan.check.active_constraints}
    for active in fig5_plan.check.active_constraints:
        assert active.start <= active.end
    # Before the step to +25° at 22 s the right wire is heated at full duty.
    assert any(bound == "duty right = 1" and 21 < start < 22 for bound, start in stretches)
    assert any(bound == "wire left = T_warm" and 22 < start < 25 for bound, start in stretches)


def test_unreachable_temperatures_are_named_before_ipopt_runs(monkeypatch):
    hot = np.r_[np.zeros(10), [25.0, 130.0, 25.0, 25.0]]
    for changes, arguments, message in [
        ({"warm_up_time": 0.5}, {}, r"left wire cannot be at T_warm = 45 °C .* from 1\.0[45]"),
        ({"a2": 1.0}, {}, r"right wire cannot .* it never gets above 39\.29 °C"),
        ({}, {"initial_state": hot}, r"right wire starts at 130 °C, above T_max = 100"),
    ]:
        monkeypatch.setattr(planning, "solve_program", lambda *_: pytest.fail("IPOPT ran"))
        parameters = LimbParameters()
        if "a2" in changes:
            parameters.segments[0].wire("right").law.a2 = changes["a2"]
        else:
            for name, value in changes.items():
                setattr(parameters.temperature_limits, name, value)
        with pytest.raises(InfeasibleError, match=message):
            plan(parameters, references.step_and_decaying_sine(), **arguments)


def test_a_plan_that_fails_its_check_is_not_returned():
    with pytest.raises(PlanningError, match="failed its check: simulating the planned duty"):
        plan(cold_parameters(), short_reference(duration=2.0), tolerance_deg=1e-9, max_knots=30)


def test_a_simulation_that_differs_from_the_plan_fails_the_check(fig5_plan, monkeypatch):
    """The check simulates the limb that the plan names, not the program's equations."""
    other = LimbParameters()
    other.segments[0].wire("right").law.beta *= 1.02
    monkeypatch.setattr(type(fig5_plan), "model", property(lambda _: LimbModel(other)))
    _, differences = plan_check.simulated_differences(fig5_plan)
    assert np.rad2deg(differences.max()) > 0.3


def small_limb():
    return cold_parameters(segments=[SegmentParameters(links=1)])


def test_all_attempts_together_end_after_the_time_limit(monkeypatch):
    monkeypatch.setattr(solving, "LONGEST_SOLVE", 1e-3)
    message = r"plan: (IPOPT, .*CPU time exceeded; )?0\.001 s of processor time are over\."
    with pytest.raises(PlanningError, match=message):
        plan(small_limb(), short_reference())


def test_ctrl_c_raises_even_at_a_feasible_point(monkeypatch):
    """At iteration 3 the point of IPOPT is feasible, and the solution."""
    usual = solving.Progress
    for iteration in (1, 3):

        class Interrupting(usual):
            def update(self, done, _remark=""):
                if done == iteration:
                    os.kill(os.getpid(), signal.SIGINT)

        monkeypatch.setattr(solving, "Progress", Interrupting)
        with pytest.raises(KeyboardInterrupt):
            plan(LimbParameters(), references.step_and_decaying_sine(), knot_rate=5.0)


def test_knots_are_added_after_a_sudden_change_of_duty():
    """Full duty at once makes the limb ring at 4.6 Hz, which 10 knots a second do not see."""
    parameters = cold_parameters()
    at_once = references.from_samples([0.0, 0.01, 5.0], np.deg2rad([0.0, 30.0, 30.0]))
    trajectory = plan(parameters, at_once, tolerance_deg=0.05)
    assert trajectory.check.refinements > 0
    assert trajectory.check.largest_difference_deg <= 0.05
    steps = np.diff(trajectory.time)
    assert steps.min() <= 0.05 + 1e-9
    np.testing.assert_allclose(steps[(trajectory.time[:-1] > 2) & (trajectory.time[1:] < 4)], 0.1)


def test_a_warning_names_distance_place_and_cause_of_a_plan_far_from_its_reference():
    far = references.from_samples([0.0, 22.0, 25.0, 32.0], np.deg2rad([0.0, 0.0, 90.0, 90.0]))
    with pytest.warns(UserWarning, match=r"^The plan is far from its reference: ") as warned:
        trajectory = plan(LimbParameters(), far, knot_rate=5.0)
    said = str(warned[0].message)
    assert "90.0° are asked for, and the plan has 3" in said
    assert "wire left = T_warm, wire right = T_max" in said
    # (4) of joints alike, (11): φ = (n + 1) / 2 β (T_max - T_warm) / k
    assert "this limb can hold -35.7° to 35.7°" in said
    assert said in plan_verdict(trajectory, plan_summary(trajectory))
    # The best plan that the limits leave ends there, too, but for the last heating.
    nearest = nearest_bend_angle(trajectory)
    assert np.rad2deg(nearest.max()) == pytest.approx(35.7, abs=0.1)


def test_readings_stay_below_the_boards_maximum_by_a_margin():
    limb, times = LimbParameters(), np.linspace(0.0, 40.0, 161)
    reference = references.from_samples([0, 22, 25, 40], np.deg2rad([0, 0, 30, 30]))
    free = Planner(limb, times).plan(reference)
    limb.temperature_limits.measured_maximum = 80.0
    trajectory = Planner(limb, times, measured_margin=[5.0, 12.0]).plan(reference)
    assert free.measured_temperature[1].max() > 70.0
    assert trajectory.measured_temperature[1].max() == pytest.approx(68.0, abs=1e-3)
    bounds = {active.bound for active in trajectory.check.active_constraints}
    assert "reading right = measured_maximum" in bounds
    assert "reading left = measured_maximum" not in bounds


def test_a_reading_above_the_boards_maximum_is_refused():
    limb, hot = cold_parameters(), np.r_[np.zeros(10), 60.0, 60.0, 60.0, 99.0]
    limb.temperature_limits.measured_maximum = 80.0
    with pytest.raises(InfeasibleError, match=r"right wire reads .* let it cool first"):
        plan(limb, short_reference(), initial_state=hot)


def test_multipliers_of_the_start_balance_the_cost_of_its_motion():
    """A motion that follows from the heat has no gradient of the Lagrangian."""
    model, times, task = LimbModel(LimbParameters()), np.linspace(0.0, 3.0, 31), Task.paper()
    n, reference = 5, np.deg2rad(10.0) * np.sin(times)[None]
    state = model.statics.resting_state(model.wires.cold_states[:2])
    quasi_static, solution = solve_quasi_static(
        model, times, reference, state[2 * n :], task, warm_up_time=20.0
    )
    program = TrajectoryProgram(model, times, task, with_constraints=False)
    program.update(reference, state, 20.0)
    states = np.zeros((len(state), len(times)))
    states[2 * n :] = solution.x[quasi_static.heat].T
    start = program.variables(states, solution.x[quasi_static.duty].T)
    start, motion_slopes = solve_motion(program, start)
    assert np.abs(program.defects.evaluate(start)).max() < 1e-9

    multipliers, _ = estimate_multipliers(program, start, motion_slopes, quasi_static, solution)
    block, step = program.defects, 1e-4
    shape = len(block.lower), len(start)
    slopes = scipy.sparse.coo_array((block.jacobian(start), (block.rows, block.columns)), shape)
    balance = slopes.T @ multipliers[: shape[0]]
    for index in program.motion[1:].ravel()[::37]:
        change = step * np.eye(1, len(start), index)[0]
        by_cost = (program.cost(start + change) - program.cost(start - change)) / (2 * step)
        assert balance[index] == pytest.approx(-by_cost, rel=1e-5, abs=1e-6)
    solution.multipliers = None
    with pytest.raises(LimbError, match="was not solved by its cheap blocks"):
        estimate_multipliers(program, start, motion_slopes, quasi_static, solution)


def test_a_last_duty_that_may_jump_starts_in_the_middle_of_its_range():
    """At a bound, where the quasi-static plan has it, IPOPT needs twice the iterations."""
    model, times = LimbModel(LimbParameters()), np.linspace(0.0, 3.0, 31)
    reference = np.deg2rad(10.0) * np.sin(times)[None]
    middle = 0.5 * model.parameters.total_duty / 2
    for task in (Task.paper(), Task(duty_hold=0.5)):
        program, solution = solve_quasi_static(
            model, times, reference, np.full(4, 25.0), task, warm_up_time=20.0, is_start=True
        )
        last = program.duty[-1]
        assert (solution.x[last] == middle).all() == (task.duty_hold == 0)
        assert solution.multipliers[1][last].any() == (task.duty_hold > 0)


def test_clarabel_and_ipopt_solve_the_start_with_the_same_multipliers():
    """All but the bend of linear wires is linear, and here the bend is, too."""
    model = LimbModel(LimbParameters())
    times = np.linspace(0.0, 24.0, 61)
    reference = np.deg2rad(25.0) * np.sin(times / 2)[None]
    program = QuasiStaticProgram(model, times, model.statics, Task.paper())
    program.update(reference, np.full(4, 25.0), 20.0)
    start = program.linear_start()
    by_clarabel = program.linearized.solve(start.x)
    by_ipopt = solving.solve_program(program, program.guess())
    assert start.cost == pytest.approx(by_ipopt.cost, rel=1e-3)
    assert by_clarabel.cost == pytest.approx(by_ipopt.cost, rel=1e-4)
    np.testing.assert_allclose(start.x, by_ipopt.x, atol=0.5)
    for found, expected in zip(by_clarabel.multipliers, by_ipopt.multipliers, strict=True):
        np.testing.assert_allclose(found, expected, atol=0.02 * np.abs(expected).max())


def test_the_start_of_a_limb_whose_bend_is_not_linear_obeys_the_program():
    model = LimbModel(LimbParameters(gravity=[9.81, 0.0, 0.0], payload=0.02))
    times = np.linspace(0.0, 24.0, 61)
    program = QuasiStaticProgram(model, times, model.statics, Task.paper())
    program.update(np.deg2rad(25.0) * np.sin(times / 2)[None], np.full(4, 25.0), 20.0)
    x = program.linear_start().x
    for block in program.blocks:
        np.testing.assert_allclose(block.evaluate(x), block.lower, atol=1e-4)


def test_plans_that_may_be_stretched_start_from_the_plan_at_the_times_of_the_reference():
    """Also where wires are not linear, whose start is the best duty of linear wires."""
    times, cold, limb = np.linspace(0.0, 24.0, 61), np.full(6, 25.0), LimbParameters()
    reference = np.deg2rad(25.0) * np.sin(times / 2)[None]
    linear = LimbModel(LimbParameters())
    for wire in limb.wires:
        wire.law = ThresholdLaw()
    curved = LimbModel(limb)
    starts = []
    for task in (Task(), Task(stretch=(0.5, 2.0), time_weight=10.0)):
        _, start = solve_quasi_static(
            linear, times, reference, cold[:4], task, warm_up_time=20.0, is_start=True
        )
        program = QuasiStaticProgram(curved, times, curved.statics, task)
        program.update(reference, cold, 20.0)
        starts.append(np.append(start.x, program.guess()[program.duty]))
    np.testing.assert_array_equal(*starts)


@pytest.fixture
def planner():
    """A planner of 12 s; no bound of readings V is below what they may come to."""
    limb = LimbParameters(segments=[SegmentParameters(links=1)])
    return Planner(limb, np.linspace(0.0, 12.0, 61))


def test_a_plan_from_the_plan_before_begins_with_the_given_reading(planner):
    """Another V alone is a small change, from which the planner goes on."""
    reference = references.from_samples([0.0, 4.0, 12.0], [0.0, 0.1, 0.1])
    before, _, _ = planner.plan_unchecked(reference)
    state = np.array(before.state[:, 0])
    state[-1] += 0.5
    again, _, _ = planner.plan_unchecked(reference, state)
    assert again.measured_temperature[1, 0] == pytest.approx(state[-1], abs=1e-6)
    assert again.check.largest_defect < 1e-6


def test_after_a_plan_by_the_exact_hessian_the_next_one_is_solved(planner, monkeypatch):
    """Multipliers of the exact Hessian's rows are no start of the cheap ones."""
    reference = references.from_samples([0.0, 4.0, 12.0], [0.0, 0.1, 0.1])
    with monkeypatch.context() as patched:
        for name in ("NEAR_OPTIONS", "PATIENT_OPTIONS"):
            patched.setattr(solving, name, {"max_iter": 0})
        by_exact, _, _ = planner.plan_unchecked(reference)
        assert "exact" in by_exact.check.solver.partition(" (after")[0]
    assert planner.plan_unchecked(reference)[0].check.status == "solved"
