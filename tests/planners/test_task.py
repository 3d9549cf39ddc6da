"""Tasks beyond the paper's, and planning again and again."""

import importlib
import inspect
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from pydrake.solvers import SnoptSolver

from controllers.horizon import HorizonPlanner
from controllers.temperature_supervisor import TemperatureLimiter
from limb_systems import (
    LimbModel,
    LimbParameters,
    SaturatingLaw,
    Trajectory,
    bend_angle,
    joint_angles_from_bend_angle,
)
from limb_systems.limb_parameters import CalibrationRecord
from planners import (
    ExactHessianIpoptSolver,
    Planner,
    PlanningError,
    Task,
    TrajectoryProgram,
    nearest_bend_angle,
    plan,
    planning,
    references,
)
from planners.transcription import solving
from planners.transcription.quasi_static import QuasiStaticProgram
from planners.transcription.solving import solve_program
from soft_limb.results.summaries import plan_summary

from .conftest import cold_parameters

DOCS = Path(__file__).parents[2] / "docs"


def largest_change_of_duty(trajectory, seconds):
    """Between knots, in the time before the end."""
    late = trajectory.time >= trajectory.time[-1] - seconds - 1e-9
    return np.abs(np.diff(trajectory.duty[:, late])).max()


def test_duty_is_constant_at_the_end_and_tracking_as_good_as_the_papers():
    step = references.from_samples([0.0, 28.0, 28.01, 30.0], np.deg2rad([0.0, 0.0, 20.0, 20.0]))
    quiet, papers = (plan(LimbParameters(), step, task=task) for task in (None, Task.paper()))
    assert largest_change_of_duty(quiet, 1.0) < 1e-6
    assert largest_change_of_duty(papers, 1.0) > 0.3
    missed = [np.rad2deg(np.abs(t.bend_angle - t.reference).mean()) for t in (quiet, papers)]
    assert missed[0] < missed[1] + 0.02


def test_paper_task_has_the_printed_weights():
    weights, _ = Task.paper().weights(np.linspace(0.0, 1.0, 11))
    assert weights.tolist() == [100.0] * 10 + [100_000.0]
    assert Task.paper().duty_hold == 0.0


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


def test_minimum_time_is_reached_with_full_duty():
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


def test_plans_for_feedback_go_to_the_reference_of_limbs_that_are_calibrated(fig5_plan):
    """And those of other limbs stay away from it."""
    parameters, calibrated = LimbParameters(), LimbParameters()
    known = ["right.a1"], [-0.07], [1e-3], [[1e-6]]
    calibrated.calibration = CalibrationRecord(*known, bend_error=0.02, temperature_error=1.0)
    reference, missed = references.step_and_decaying_sine(), []
    of_each = [
        plan(p, reference, task=Task.closed_loop(p), knot_rate=5.0)
        for p in (calibrated, parameters)
    ]
    for course, limb in zip(
        (of_each[0], fig5_plan, of_each[1]), (calibrated, parameters, parameters), strict=True
    ):
        missed.append(np.rad2deg(np.abs(course.bend_angle - course.reference).mean()))
        highest = TemperatureLimiter(limb).limit
        assert course.wire_temperature.max() <= highest + 0.01
    assert missed[0] < missed[1] - 0.2
    assert missed[1] < missed[2] - 0.2


def add_custom_terms(program):
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


def test_custom_costs_and_constraints_hold_with_every_solver(monkeypatch):
    for way in ["curvature of the wires", "exact", "SNOPT"]:
        parameters, solver = cold_parameters(), None
        parameters.segments[0].links = 1
        if way == "curvature of the wires":
            for wire in parameters.segments[0].wires:
                wire.law = SaturatingLaw()
        elif way == "exact":
            monkeypatch.setitem(solving.PATIENT_OPTIONS, "max_iter", 2)
        elif way == "SNOPT":
            solver = SnoptSolver()
        task = Task(customize=add_custom_terms)
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


def test_check_names_a_violated_custom_constraint(monkeypatch):
    for description in ["a cap", ""]:

        def customize(program):
            duty = program.prog.decision_variables()[program.duty]
            for k in range(9, 13):
                cap = program.prog.AddConstraint(duty[k, 1] ** 3 <= 0.1 * (k - 7))
                cap.evaluator().set_description(description)

        def forgetful(program, *arguments):
            """Leaves out all curved constraints, those that were added, too."""
            for block in (program.defects, *program.cheap_blocks):
                block.replaces = program.prog.generic_constraints()
            return solve_program(program, *arguments)

        monkeypatch.setattr(planning, "solve_program", forgetful)
        name = description or r"-inf <= pow\(u\(21\), 3\) <= 0\.30*\d*"
        message = rf"task's constraint '{name}' \(number 2 of 4, at 1 s\) is missed by 0\.\d+"
        with pytest.raises(PlanningError, match=message):
            plan(cold_parameters(), step_to_20_degrees(), task=Task(customize=customize))


def test_custom_terms_are_in_the_summary_and_in_the_file(tmp_path):
    """Of both programs, and for costs and constraints with and without descriptions."""

    def customize(program):
        prog, variables = program.prog, program.prog.decision_variables()
        duty = variables[program.duty]
        T = variables[program.heat[:, : duty.shape[1]]].ravel()
        for k, of_knot in enumerate(duty):
            gentle = prog.AddConstraint(of_knot @ of_knot <= 0.4**2)
            gentle.evaluator().set_description("gentle")
            prog.AddConstraint(of_knot[0] ** 3 <= 2 + 0.123456 * k)
        bounds = prog.AddBoundingBoxConstraint(-np.inf, 40.0, T)  # one for many knots
        bounds.evaluator().set_description("cool")
        prog.AddLinearCost(1e-3 * (T - 25.0).sum()).evaluator().set_description("warmth")
        for change in np.diff(duty, axis=0):
            prog.AddQuadraticCost(change @ change).evaluator().set_description("even\nduty")

    space = LimbParameters.in_space()
    space.temperature_limits.warm_up_time = 1000.0
    up_and_still = references.from_samples([0, 1, 8], np.deg2rad([[0, 20, 20], [0, 0, 0]]))
    for limb, reference in ((cold_parameters(), step_to_20_degrees()), (space, up_and_still)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it is far from its reference
            found = plan(limb, reference, task=Task(customize=customize), knot_rate=2.5)
        found.save(tmp_path / "plan.csv")
        loaded = Trajectory.load(tmp_path / "plan.csv")
        assert loaded.check == found.check
        texts = plan_summary(loaded).texts()
        assert "duty" in texts["limits"]
        assert "gentle" not in texts["limits"]
        # What its own constraints leave cannot be told from a file.
        assert "the limits leave" not in texts["reference"]
        assert nearest_bend_angle(loaded) is None
        assert loaded.summary().texts().keys() >= {"check", "limits", "added", "reference"}
        lines = texts["added"].split("\n")
        T, duty = found.wire_temperature, found.duty
        assert lines[:2] == [
            f"warmth (cost): {1e-3 * (T - 25.0).sum():.3g}",
            f"even duty ({len(found.time) - 1} costs): {(np.diff(duty) ** 2).sum():.3g}",
        ]
        formula, *described = sorted(lines[2:])
        alike = r"-inf <= pow\(\w+\([\d,]+\), 3\) <= 2 and alike \(\d+ constraints\): not active"
        assert re.fullmatch(alike, formula)
        expected = []
        for name, is_active in (
            ("cool (constraint)", T.max(axis=0) > 40.0 - 0.05),
            (f"gentle ({len(found.time)} constraints)", np.linalg.norm(duty, axis=0) > 0.4 - 1e-3),
        ):
            edges = np.flatnonzero(np.diff(is_active, prepend=False, append=False)).reshape(-1, 2)
            times = [
                f"{found.time[a]:.1f}-{found.time[b - 1]:.1f}"
                if b - a > 1
                else f"{found.time[a]:.1f}"
                for a, b in edges
            ]
            expected.append(f"{name}: active at {', '.join(times)} s")
        assert described == expected
    plain = plan(cold_parameters(), ramp_to_20_degrees(), knot_rate=2.5)
    assert "added" not in plan_summary(plain).texts()


@pytest.mark.parametrize("package", ["limb_systems", "planners", "controllers", "hardware"])
def test_constructors_on_the_pages_are_those_of_the_classes(package):
    """A section with a table of ports has the constructor of its system."""
    from soft_limb.live_page import LivePage  # takes long to import

    text = (DOCS / f"{package}.md").read_text(encoding="utf-8")
    constructors = re.findall(r"^(?:\| )?`([A-Z]\w+)\((.*)\)`(?: \|.*)?$", text, re.MULTILINE)
    assert constructors
    sections = re.findall(r"^### `(\w+)`\n(.*?)(?=^#|\Z)", text, re.DOTALL | re.MULTILINE)
    systems = {name for name, section in sections if "\n| port |" in section}
    assert systems <= dict(constructors).keys()
    others = {kind.__name__: kind for kind in (QuasiStaticProgram, HorizonPlanner, LivePage)}
    for name, arguments in constructors:
        kind = others.get(name) or getattr(importlib.import_module(package), name)
        parameters = inspect.signature(kind).parameters.values()
        signature = inspect.Signature([p.replace(annotation=p.empty) for p in parameters])
        written = inspect.signature(eval(f"lambda {arguments}: None"))
        assert f"{name}{written}" == f"{name}{signature}"


def test_programs_have_the_attributes_on_the_page():
    text = (DOCS / "planners.md").read_text(encoding="utf-8")
    attributes = dict(re.findall(r"^\| `(\w+)\(.*\)` \| (.*) \|$", text, re.MULTILINE))
    limb, times = LimbParameters(), np.linspace(0.0, 1.0, 3)
    for made in (
        Planner(limb, times),
        TrajectoryProgram(limb, times),
        QuasiStaticProgram(limb, times, LimbModel.of(limb).statics, Task()),
        ExactHessianIpoptSolver(),
    ):
        names = re.findall(r"`(\w+)`", attributes[type(made).__name__])
        assert all(hasattr(made, name) for name in names)


def test_starts_are_as_accurate_as_they_are_asked_to_be(monkeypatch):
    used = []

    class Solver(ExactHessianIpoptSolver):
        def Solve(self, prog, guess, options, **arguments):
            used.append(options.options["Ipopt"])
            return super().Solve(prog, guess, options, **arguments)

    monkeypatch.setattr(solving, "ExactHessianIpoptSolver", Solver)
    limb, times = LimbParameters(), np.linspace(0.0, 1.0, 11)
    program = QuasiStaticProgram(limb, times, LimbModel.of(limb).statics, Task())
    program.update(np.zeros((1, 11)), np.full(4, 25.0), 20.0)
    for options in (None, solving.COARSE_START_OPTIONS):
        solve_program(program, program.guess(), starts_near=True, ipopt_options=options)
    asked = solving.NEAR_OPTIONS, solving.NEAR_OPTIONS | solving.COARSE_START_OPTIONS
    for options, expected in zip(used, asked, strict=True):
        assert expected.items() <= options.items()


def test_a_task_may_scale_variables():
    def customize(program):
        program.prog.SetVariableScaling(program.prog.decision_variable(program.duty[1, 0]), 0.25)

    limb, times, task = LimbParameters(), np.linspace(0.0, 1.0, 3), Task(customize=customize)
    for program in (
        TrajectoryProgram(limb, times, task),
        QuasiStaticProgram(limb, times, LimbModel.of(limb).statics, task),
    ):
        assert program.scales[program.duty[:, 0]].tolist() == [1.0, 0.25, 1.0]
        assert (program.scales[program.heat] == program.wires.heat_scales).all()


@pytest.fixture
def planner():
    return Planner(LimbParameters(), np.linspace(0.0, 10.0, 101), tolerance_deg=0.5)


HOT = np.r_[np.zeros(10), np.full(4, 60.0)]


def swing(amplitude_deg):
    times = np.arange(0.0, 10.0, 0.05)
    return references.from_samples(times, np.deg2rad(amplitude_deg) * np.sin(times))


def test_replanning_equals_planning_with_a_new_planner(planner):
    planner.plan(swing(10.0), HOT, elapsed=20.0)
    for amplitude, angle in ((10.05, 0.0), (13.0, 0.02)):
        state = HOT.copy()
        state[:5] += joint_angles_from_bend_angle(LimbParameters(), [angle])
        again = planner.plan(swing(amplitude), state, elapsed=20.0)
        anew = Planner(LimbParameters(), planner.times, tolerance_deg=0.5)
        anew = anew.plan(swing(amplitude), state, elapsed=20.0)
        assert again.check.cost == pytest.approx(anew.check.cost, rel=1e-5)
        np.testing.assert_allclose(again.state[:, 0], state)


def test_a_wire_that_is_a_little_too_hot_is_planned_to_cool(planner):
    """As a robot may be after a plan along T_max."""
    hot = HOT.copy()
    hot[10] = 100.5
    hot[:5] = -4.7e-4 * (100.5 - 60.0) / 0.1246  # where the wires hold it
    trajectory = planner.plan(swing(5.0), hot, elapsed=20.0)
    assert trajectory.wire_temperature[0, 0] == 100.5
    assert trajectory.wire_temperature[0, 1:].max() <= 100.0 + 1e-4
