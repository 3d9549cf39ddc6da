"""Tasks beyond the paper's, and planning again and again."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.solvers import SnoptSolver

from hardware import LimbTwin
from limb_systems import (
    Limb,
    LimbError,
    LimbParameters,
    SaturatingLaw,
    bend_angle,
    joint_angles_from_bend_angle,
    simulate,
)
from planners import (
    InfeasibleError,
    Phase,
    Planner,
    PlanningError,
    Task,
    TaskError,
    plan,
    planning,
    references,
)
from planners.transcription import solving
from planners.transcription.solving import solve_program

ROOT = Path(__file__).parents[2]


def largest_change_of_duty(trajectory, seconds):
    """Between knots, in the time before the end."""
    late = trajectory.time >= trajectory.time[-1] - seconds - 1e-9
    return np.abs(np.diff(trajectory.duty[:, late])).max()


def test_plans_end_quietly_and_follow_as_well_as_the_papers():
    for reference in [
        references.step_and_decaying_sine(),
        references.from_samples([0.0, 28.0, 28.01, 30.0], np.deg2rad([0.0, 0.0, 20.0, 20.0])),
    ]:
        quiet, papers = (
            plan(LimbParameters(), reference, task=task) for task in (None, Task.paper())
        )
        assert largest_change_of_duty(quiet, 1.0) < 1e-6
        assert largest_change_of_duty(papers, 1.0) > 0.3
        missed = [np.rad2deg(np.abs(t.bend_angle - t.reference).mean()) for t in (quiet, papers)]
        assert missed[0] < missed[1] + 0.02


def test_duty_is_held_over_the_last_interval_at_least():
    trajectory = plan(
        cold_parameters(), ramp_to_20_degrees(), knot_rate=2.0, task=Task(duty_hold=0.1)
    )
    assert np.abs(np.diff(trajectory.duty)[:, -1]).max() < 1e-6
    assert np.abs(np.diff(trajectory.duty)[:, -2]).max() > 1e-3


def test_the_papers_task_is_as_it_is_printed():
    weights, _ = Task.paper().weights(np.linspace(0.0, 1.0, 11))
    assert weights.tolist() == [100.0] * 10 + [100_000.0]
    assert Task.paper().duty_hold == 0.0


def cold_parameters():
    parameters = LimbParameters()
    parameters.temperature_limits.warm_up_time = 1000.0
    return parameters


def step_to_20_degrees():
    return references.from_samples([0.0, 1.0, 1.01, 8.0], np.deg2rad([0.0, 0.0, 20.0, 20.0]))


def ramp_to_20_degrees():
    return references.from_samples([0.0, 8.0], np.deg2rad([0.0, 20.0]))


def test_bend_rate_is_limited_at_the_knots():
    limit = np.deg2rad(6.0)
    free = plan(cold_parameters(), step_to_20_degrees())
    slow = plan(cold_parameters(), step_to_20_degrees(), task=Task(max_bend_rate=limit))

    def largest_rates(trajectory):
        """By (11), and of the chord along the joints' motion."""
        by_11 = 3 * np.abs(trajectory.joint_rates.mean(axis=0)).max()
        small = 1e-6
        ahead = trajectory.joint_angles + small * trajectory.joint_rates
        change = bend_angle(trajectory.parameters, ahead) - trajectory.bend_angle
        return np.array([by_11, np.abs(change).max() / small])

    assert (largest_rates(free) > 1.5 * limit).all()
    assert largest_rates(slow)[0] == pytest.approx(limit, rel=1e-5)
    assert largest_rates(slow)[1] < 1.2 * limit


def test_temperature_rate_is_limited():
    slow = plan(cold_parameters(), step_to_20_degrees(), task=Task(max_temperature_rate=8.0))
    rate = -0.07 * (slow.wire_temperature - 25.0) + 20.0 * slow.duty  # (6)
    assert np.abs(rate).max() <= 8.0 + 1e-6
    assert np.abs(rate).max() > 7.9


def test_temperature_rate_that_forbids_the_warm_up_is_named():
    parameters = LimbParameters()
    parameters.temperature_limits.warm_up_time = 3.0
    with pytest.raises(InfeasibleError, match="max_temperature_rate"):
        plan(parameters, step_to_20_degrees(), task=Task(max_temperature_rate=2.0))


def test_reach_and_hold():
    task = Task(reach=True, final_hold=2.0, terminal_factor=1.0, angle_weight=1.0)
    trajectory = plan(cold_parameters(), step_to_20_degrees(), task=task)
    end = np.rad2deg(trajectory.bend_angle[0])
    assert end[-1] == pytest.approx(20.0, abs=0.15)
    held = trajectory.time >= 6.0 - 1e-9
    assert np.ptp(end[held]) < 2.0 * 0.5 + 0.05
    loose = plan(cold_parameters(), step_to_20_degrees(), task=Task(angle_weight=1e-3))
    assert np.rad2deg(loose.bend_angle[0, -1]) < 15.0


def test_minimum_energy_heats_as_late_as_it_can():
    """Heat leaks, so the least energy comes last: full duty at the very end."""
    task = Task(
        angle_weight=0.0,
        duty_weight=1e-3,
        energy_weight=1.0,
        terminal_factor=0.0,
        reach=True,
        duty_hold=0.0,
    )
    least = plan(cold_parameters(), ramp_to_20_degrees(), task=task)
    usual = plan(cold_parameters(), ramp_to_20_degrees(), task=Task(reach=True))
    heat = [np.trapezoid(t.duty.sum(axis=0), t.time) for t in (least, usual)]
    assert heat[0] < 0.9 * heat[1]
    assert least.duty[0].max() < 1e-3
    early = least.time < 5.0
    assert least.duty[1, early].max() < 1e-2
    assert least.duty[1].max() > 0.95


def test_minimum_time_is_that_of_full_duty():
    """(6), (12): from cold to 20° at full duty, but for the mechanics' swing."""
    task = Task(
        angle_weight=0.0,
        duty_weight=1e-3,
        terminal_factor=0.0,
        time_weight=1.0,
        reach=True,
        duty_hold=0.0,
        stretch=(0.05, 1.0),
    )
    trajectory = plan(cold_parameters(), ramp_to_20_degrees(), task=task, knot_rate=4.0)
    assert trajectory.check.solver == "IPOPT, exact Hessian"
    excess = np.deg2rad(20.0) * 0.1246 / (3 * 4.7e-4)
    quickest = np.log(1 - excess * 0.07 / 20.0) / -0.07
    assert trajectory.duration == pytest.approx(quickest, abs=0.15)
    assert trajectory.duty[1].mean() > 0.85
    np.testing.assert_allclose(np.diff(trajectory.time), trajectory.duration / 32, rtol=1e-6)


def test_margins_leave_feedback_its_authority():
    task = Task(temperature_margin=52.0, duty_margin=0.7)
    free, close = (
        plan(cold_parameters(), step_to_20_degrees(), task=task, knot_rate=4.0)
        for task in (None, task)
    )
    assert free.wire_temperature.max() > 55.0
    assert free.duty.max() > 0.5
    assert close.wire_temperature.max() == pytest.approx(48.0, abs=0.01)
    assert close.duty.max() == pytest.approx(0.3, abs=1e-4)
    assert close.parameters == cold_parameters()
    bounds = {active.bound for active in close.check.active_constraints}
    assert {"duty right = 0.3", "wire right = T_max - 52 °C"} <= bounds


def test_margins_that_leave_nothing_are_named():
    for task, message in (
        (Task(temperature_margin=60.0), r"T_max = 100 °C less a margin of 60 °C is below T_warm"),
        (Task(duty_margin=0.99), r"at a duty of 0\.01 from 25 °C"),
    ):
        with pytest.raises(InfeasibleError, match=message):
            plan(LimbParameters(), references.from_samples([0.0, 30.0], [0.0, 0.0]), task=task)


def test_temperature_weight_keeps_wires_cool():
    """It costs what (15) and the mean temperature of the wires above ambient add up to."""
    costs, means = [], []
    for weight in (0.0, 0.01):
        found = Planner(
            LimbParameters(), np.linspace(0.0, 10.0, 41), task=Task(temperature_weight=weight)
        ).plan(references.from_samples([0.0, 10.0], [0.0, 0.0]), WARM, elapsed=20.0)
        above = found.wire_temperature.mean(axis=0) - 25.0
        of_heat = weight * above.sum()
        of_duty = (found.duty[:, :-1] ** 2).sum()
        factors = np.r_[np.ones(40), 100.0]
        of_angle = 50.0 * (factors * found.joint_angles**2).sum()
        assert found.check.cost == pytest.approx(of_heat + of_duty + of_angle, rel=1e-6)
        costs.append(of_duty + of_angle)
        means.append(above.mean())
    assert means[1] < means[0] - 0.5
    assert costs[1] > costs[0]


def test_phases_weigh_time_differently():
    """What is not weighed is not followed."""
    task = Task(phases=(Phase(0.0, 0.0, 2.0), Phase(5.0, 1000.0, 2.0)))
    trajectory = plan(cold_parameters(), step_to_20_degrees(), task=task)
    error = np.rad2deg(np.abs(trajectory.bend_angle - trajectory.reference)[0])
    assert error[(trajectory.time > 1.5) & (trajectory.time < 2.5)].min() > 5.0
    assert error[trajectory.time > 6.0].max() < 0.2


def of_ones_own(program):
    """A constraint of each kind, on the duty of knots of its own, and two costs."""
    prog = program.prog
    duty = prog.decision_variables()[program.duty]
    prog.AddBoundingBoxConstraint(0.0, 0.0, duty[20:30, 1])
    prog.AddLinearConstraint(duty[31, 0] - duty[31, 1] >= 0.1)
    prog.AddLinearConstraint(duty[32, 0] == duty[32, 1] + 0.2)
    for k in range(10, 20):
        prog.AddQuadraticConstraint(2 * np.eye(2), np.zeros(2), -np.inf, 0.15**2, duty[k])
    prog.AddConstraint(duty[34, 0] * (1 + duty[35, 0] ** 2) >= 0.05)
    prog.AddConstraint(
        lambda z: [z[0] ** 3], [-np.inf], [0.001], vars=duty[11, 1:], description="a cap"
    )
    prog.AddLorentzConeConstraint(np.array([[0, 0], [1, 0], [0, 1.0]]), [0.1, 0, 0], duty[12])
    prog.AddCost(lambda z: 1e4 * (z[0] - 0.3) ** 4, vars=duty[40, :1])
    prog.AddCost(1e4 * (duty[42, 0] - 0.3) ** 4)


def test_costs_and_constraints_of_ones_own_hold_however_they_are_solved(monkeypatch):
    for way in ["Gauss-Newton", "curvature of the wires", "exact", "SNOPT"]:
        parameters, solver = cold_parameters(), None
        parameters.segments[0].links = 1
        if way == "curvature of the wires":
            for wire in parameters.segments[0].wires:
                wire.law = SaturatingLaw()
        elif way == "exact":
            monkeypatch.setattr(solving, "GAUSS_NEWTON_ITERATIONS", 2)
        elif way == "SNOPT":
            solver = SnoptSolver()
        task = Task(customize=of_ones_own)
        trajectory = plan(parameters, step_to_20_degrees(), task=task, solver=solver)
        assert way in trajectory.check.solver.partition("(")[0]
        left, right = trajectory.duty
        assert right[20:30].max() < 1e-8
        assert left[31] - right[31] > 0.1 - 1e-6
        assert left[32] - right[32] == pytest.approx(0.2, abs=1e-6)
        assert np.hypot(left, right)[10:20].max() == pytest.approx(0.15, abs=1e-4)
        assert left[34] * (1 + left[35] ** 2) > 0.05 - 1e-6
        assert right[11] < 0.1 + 1e-5
        assert np.hypot(left, right)[12] < 0.1 + 1e-5
        for costly in (40, 42):
            assert left[costly] == pytest.approx(0.3, abs=0.1)
            assert left[costly - 3] < 0.1


def test_the_check_names_a_constraint_of_ones_own_that_does_not_hold(monkeypatch):
    for description in ["a cap", ""]:

        def customize(program):
            duty = program.prog.decision_variables()[program.duty]
            for k in range(9, 13):
                cap = program.prog.AddConstraint(duty[k, 1] ** 3 <= 0.1 * (k - 7))
                cap.evaluator().set_description(description)

        def forgetful(program, *arguments):
            """Leaves out all curved constraints, those that were added, too."""
            program.defects.replaces = program.prog.generic_constraints()
            return solve_program(program, *arguments)

        monkeypatch.setattr(planning, "solve_program", forgetful)
        name = description or r"-inf <= pow\(u\(21\), 3\) <= 0\.30*\d*"
        message = rf"task's constraint '{name}' \(number 2 of 4, at 1 s\) is missed by 0\.\d+"
        with pytest.raises(PlanningError, match=message):
            plan(cold_parameters(), step_to_20_degrees(), task=Task(customize=customize))


def test_tasks_that_make_no_sense_are_refused():
    for changes, message in [
        ({"angle_weight": -1.0}, "angle_weight is -1.0"),
        ({"duty_weight": np.nan}, "duty_weight is nan"),
        ({"temperature_margin": -1.0}, "temperature_margin is -1.0"),
        ({"duty_margin": 1.0}, "duty_margin is 1.0; it must be less than 1"),
        ({"max_bend_rate": 0.0}, "max_bend_rate is 0.0"),
        ({"stretch": (2.0, 1.0)}, "stretch is"),
        ({"time_weight": 1.0}, "time_weight needs a stretch"),
        ({"angle_weight": "100"}, "angle_weight is '100'; it must be a number"),
        ({"angle_weight": True}, "angle_weight is True"),
        ({"max_bend_rate": "slow"}, "max_bend_rate is 'slow'"),
        ({"reach": "yes"}, "reach is 'yes'; it must be True or False"),
        ({"stretch": 2.0}, "stretch is 2.0"),
        ({"phases": (1.0,)}, "must be a sequence of Phase"),
        ({"customize": 1}, "customize is 1"),
        ({"phases": (Phase(5, 1, 1), Phase(0, 1, 1))}, "in the order of their start"),
    ]:
        with pytest.raises(TaskError, match=message):
            Task(**changes)


def test_uneven_knots_weigh_as_much_as_the_time_they_stand_for():
    weights, _ = Task.paper().weights(np.array([0.0, 0.1, 0.15, 0.2, 0.3]))
    np.testing.assert_allclose(weights, [100.0, 50.0, 50.0, 100.0, 100_000.0])
    even, _ = Task().weights(np.linspace(0.0, 60.0, 601))
    assert set(even[:-1]) == {100.0}


@pytest.fixture
def planner():
    return Planner(LimbParameters(), np.linspace(0.0, 10.0, 101), tolerance_deg=0.5)


WARM = np.r_[np.zeros(10), 50.0, 50.0, 25.0, 25.0]
HOT = np.r_[np.zeros(10), np.full(4, 60.0)]


def swing(amplitude_deg):
    times = np.arange(0.0, 10.0, 0.05)
    return references.from_samples(times, np.deg2rad(amplitude_deg) * np.sin(times))


def test_planning_again_finds_what_planning_anew_finds(planner):
    planner.plan(swing(10.0), HOT, elapsed=20.0)
    for amplitude, angle in ((10.05, 0.0), (13.0, 0.02)):
        state = HOT.copy()
        state[:5] += joint_angles_from_bend_angle(LimbParameters(), [angle])
        again = planner.plan(swing(amplitude), state, elapsed=20.0)
        anew = Planner(LimbParameters(), planner.times, tolerance_deg=0.5)
        anew = anew.plan(swing(amplitude), state, elapsed=20.0)
        assert again.check.cost == pytest.approx(anew.check.cost, rel=1e-5)
        np.testing.assert_allclose(again.state[:, 0], state)


def test_a_small_change_is_planned_from_the_plan_before(planner):
    first = planner.plan(swing(10.0), HOT, elapsed=20.0)
    again = planner.plan(swing(10.05), HOT, elapsed=20.0)
    assert again.check.iterations < first.check.iterations / 2 + 1


def test_replanning_from_a_state_that_was_reached(planner):
    """Half a plan, then a new one from where a simulation of it ended."""
    first = planner.plan(swing(10.0), HOT, elapsed=20.0)
    limb = Limb()
    rollout = simulate(limb, first, duration=5.0, initial_state=HOT, sample_rate=20.0)
    state = np.r_[
        rollout.joint_state[:, -1],
        rollout.wire_temperature[:, -1],
        rollout.measured_temperature[:, -1],
    ]
    rest = references.from_samples([0.0, 10.0], [0.0, 0.0])
    second = planner.plan(rest, state, elapsed=25.0)
    np.testing.assert_allclose(second.state[:, 0], state)
    assert np.rad2deg(np.abs(second.bend_angle[0, -20:])).max() < 0.5


def test_warm_up_is_over_when_it_has_elapsed(planner):
    cold = np.r_[np.zeros(10), np.full(4, 30.0)]
    with pytest.raises(InfeasibleError, match=r"by 0\.1 s"):
        planner.plan(swing(10.0), cold, elapsed=20.0)
    assert planner.plan(swing(10.0), cold, elapsed=0.0).wire_temperature.min() < 45.0


def test_knots_that_make_no_sense_are_refused():
    for times in [[0.0], [0.0, 0.0], [1.0, 2.0], [0.0, np.nan]]:
        with pytest.raises(PlanningError, match="times"):
            Planner(LimbParameters(), times)


def test_a_wire_that_is_a_little_too_hot_is_planned_to_cool(planner):
    """As a robot may be after a plan along T_max."""
    hot = HOT.copy()
    hot[10] = 100.5
    hot[:5] = -4.7e-4 * (100.5 - 60.0) / 0.1246  # where the wires hold it
    trajectory = planner.plan(swing(5.0), hot, elapsed=20.0)
    assert trajectory.wire_temperature[0, 0] == 100.5
    assert trajectory.wire_temperature[0, 1:].max() <= 100.0 + 1e-4


def test_tasks_are_read_from_files(tmp_path):
    path = tmp_path / "task.yaml"
    path.write_text(
        "max_bend_rate: 0.2\nreach: true\nstretch: [1, 2.5]\n"
        "phases:\n- {start: 0, angle_weight: 1, duty_weight: 2}\n"
    )
    read = Task.load(path)
    phases = [Phase(0.0, 1.0, 2.0)]
    assert read == Task(max_bend_rate=0.2, reach=True, stretch=(1.0, 2.5), phases=phases)
    path.write_text("{}")
    assert Task.load(path) == Task()
    assert Task.load(ROOT / "examples" / "task.yaml").reach


def test_task_files_that_make_no_sense_are_refused(tmp_path):
    for text, message in [
        ("angel_weight: 1", r"angel_weight is not a known field \(did you mean angle_weight\?\)"),
        ("angle_weight: heavy", "angle_weight is 'heavy'; it must be a number"),
        ("angle_weight: -1", "angle_weight is -1.0; it must be a number, zero or more"),
        ("reach: 1", "reach is '1'; it must be true or false"),
        ("stretch: [1]", "stretch must be a list of 2"),
        ("phases:\n- start: 0", r"phases\[0\]\.angle_weight is missing"),
        ("customize: x", "customize is not a known field"),
        ("- 1", "the document must have the fields"),
        (":", "not valid YAML|must have the fields"),
    ]:
        path = tmp_path / "task.yaml"
        path.write_text(text)
        with pytest.raises(TaskError, match=message) as caught:
            Task.load(path)
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)


def test_limbs_can_be_named_by_their_files(tmp_path):
    parameters = cold_parameters()
    parameters.save(tmp_path / "limb.yaml")
    ramp = references.from_samples([0.0, 2.0], [0.0, 0.1])
    for path in (tmp_path / "limb.yaml", str(tmp_path / "limb.yaml")):
        assert plan(path, ramp).parameters == parameters
        assert LimbTwin(path).parameters.temperature_limits.warm_up_time == 1000.0
    with pytest.raises(LimbError, match="this is a int"):
        plan(5, ramp)
