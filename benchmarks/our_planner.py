"""The problem of the planner's benchmark, our planner stage by stage, and the judge of all."""

import contextlib
import time
from unittest import mock

import numpy as np
from pydrake.systems.analysis import BatchEvalTimeDerivatives

import planners.planning
from limb_systems import (
    Limb,
    LimbParameters,
    SegmentParameters,
    joint_angles_from_bend_angle,
)
from planners import Task, plan, references
from planners.transcription import ipopt

DURATION = 60.0  # s
# No knots are added: a plan may differ by this from its simulation.
TOLERANCE_DEG = 2.0

# What `planners.planning` calls one after the other, to be timed.
STAGES = {
    "guess": "solve_quasi_static",
    "build": "TrajectoryProgram",
    "solve": "solve_program",
    "check": "simulated_differences",
}


def limb_parameters(links: int) -> LimbParameters:
    """Return the nominal limb cut into another number of links, as stiff as a whole."""
    segment = SegmentParameters(links=links, stiffness=0.1246 * (links + 1) / 6)
    return LimbParameters(segments=[segment])


def make_problem(links: int, knots: int) -> dict:
    """Return the fields of `casadi_peer.Problem` for the Fig. 5 reference."""
    program, guess = _program_and_guess(links, knots)
    states, duty = _states_and_duty(program, guess)
    parameters = limb_parameters(links)
    task = Task.paper()
    segment = parameters.segments[0]
    limits = parameters.temperature_limits
    times = np.linspace(0.0, DURATION, knots)
    reference = references.step_and_decaying_sine().vector_values(times)
    of_wires = {
        name: np.array([getattr(wire.law, name) for wire in parameters.wires])
        for name in ("a1", "a2", "a3", "beta")
    }
    return of_wires | {
        "links": links,
        "length": segment.length,
        "mass": segment.mass,
        "thickness": segment.thickness,
        "stiffness": segment.stiffness,
        "damping": segment.damping,
        "ambient": parameters.ambient_temperature,
        "maximum": limits.maximum,
        "warm": limits.warm,
        "warm_up_time": limits.warm_up_time,
        "angle_weight": task.angle_weight,
        "duty_weight": task.duty_weight,
        "terminal_factor": task.terminal_factor,
        "times": times,
        "angles_ref": joint_angles_from_bend_angle(parameters, reference),
        "initial_state": states[:, 0],
        "guess_states": states,
        "guess_duty": duty,
    }


def run(problem: dict, time_limit: float) -> dict:
    """Run our planner, from nothing to a plan that was checked, stage by stage.

    Returns:
        What `casadi_peer.run` returns, and ``guess``, ``check`` and ``whole``
        (s), ``evaluation`` (s in our functions and derivatives) and
        ``inside_ipopt`` (s in IPOPT outside of them).
    """
    del time_limit  # our planner has none
    times = dict.fromkeys([*STAGES, "evaluation", "ipopt"], 0.0)
    with contextlib.ExitStack() as stack:
        for stage, name in STAGES.items():
            original = getattr(planners.planning, name)
            replacement = _timed(times, stage, original)
            stack.enter_context(mock.patch.object(planners.planning, name, replacement))
        for name, owner, method in (
            ("evaluation", ipopt._Function, "eval_buffer"),
            ("ipopt", ipopt._ScaledProblem, "solve"),
        ):
            timed = _timed(times, name, getattr(owner, method))
            stack.enter_context(mock.patch.object(owner, method, timed))
        started = time.process_time()
        trajectory = plan(
            limb_parameters(problem["links"]),
            references.step_and_decaying_sine(),
            task=Task.paper(),
            knot_rate=(len(problem["times"]) - 1) / DURATION,
            tolerance_deg=TOLERANCE_DEG,
        )
        whole = time.process_time() - started
    check = trajectory.check
    inside = times.pop("ipopt") - times["evaluation"]
    return times | {
        "whole": whole,
        "inside_ipopt": inside,
        "status": f"{check.solver}: {check.status}",
        "success": True,
        "iterations": check.iterations,
        "states": trajectory.state,
        "duty": trajectory.duty,
        "difference_deg": check.largest_difference_deg,
    }


def judge(problem: dict, states: np.ndarray, duty: np.ndarray) -> dict:
    """Return cost, feasibility and bounds of a solution, the same for all solvers.

    Returns:
        ``cost`` (15); ``defect``, the largest violation of (17) with the
        dynamics of `Limb`: defects of θ times the time step, in rad, of θ̇ times
        K⁻¹ M(0), in rad, of T and V times the time step, in units of 50 °C;
        and ``violation``, the largest of (16) and (18)-(20), rad, rad/s, °C
        or 1.
    """
    n = problem["links"]
    times = problem["times"]
    deviation = states[:n] - problem["angles_ref"]
    weights = np.full(len(times), problem["angle_weight"])
    weights[-1] *= problem["terminal_factor"]
    cost = 0.5 * np.sum(weights * deviation**2)
    cost += 0.5 * problem["duty_weight"] * np.sum(duty[:, :-1] ** 2)

    limb = Limb(limb_parameters(n))
    context = limb.CreateDefaultContext()
    port = limb.GetInputPort("duty").get_index()

    def derivatives(x, u):
        no_times = np.zeros((1, x.shape[1]))
        x = np.asfortranarray(x)
        u = np.asfortranarray(u)
        return BatchEvalTimeDerivatives(limb, context, no_times, x, u, port)

    h = np.diff(times)
    rates = derivatives(states, duty)
    middle_states = (states[:, :-1] + states[:, 1:]) / 2 - h / 8 * np.diff(rates)
    middle_rates = 1.5 / h * np.diff(states) - (rates[:, :-1] + rates[:, 1:]) / 4
    middle_duty = (duty[:, :-1] + duty[:, 1:]) / 2
    defects = middle_rates - derivatives(middle_states, middle_duty)
    plant = limb.GetSubsystemByName("manipulator")
    straight = plant.CalcMassMatrixViaInverseDynamics(plant.CreateDefaultContext())
    defects[:n] *= h
    defects[n : 2 * n] = straight / problem["stiffness"] @ defects[n : 2 * n]
    defects[2 * n :] *= h / 50.0

    wire = states[2 * n : 2 * n + 2]
    warm = wire[:, times > problem["warm_up_time"]]
    violations = [
        np.abs(states[:, 0] - problem["initial_state"]),
        -duty,
        duty - 1.0,
        wire - problem["maximum"],
        problem["warm"] - warm,
    ]
    return {
        "cost": float(cost),
        "defect": float(np.abs(defects).max()),
        "violation": max(0.0, *(float(violation.max()) for violation in violations)),
    }


class _FoundError(Exception):
    """An error that carries the program and the guess out of our planner."""


def _program_and_guess(links: int, knots: int):
    """Return the `TrajectoryProgram` of our planner and the start of its solver."""

    def instead_of_solving(program, guess, *_):
        raise _FoundError(program, guess)

    try:
        with mock.patch.object(planners.planning, "solve_program", instead_of_solving):
            plan(
                limb_parameters(links),
                references.step_and_decaying_sine(),
                task=Task.paper(),
                knot_rate=(knots - 1) / DURATION,
            )
    except _FoundError as found:
        return found.args
    raise RuntimeError("Our planner does not call solve_program any more.")


def _states_and_duty(program, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return states (2n + 4, N) and duty (2, N) of all decision variables."""
    signals = program.signals(x)
    names = "joint_state", "wire_temperature", "measured_temperature"
    return np.vstack([signals[name] for name in names]), signals["duty"]


def _timed(times: dict, name: str, function):
    """Return a function that adds to `times` how long it takes, s."""

    def timed(*arguments, **options):
        started = time.process_time()
        try:
            return function(*arguments, **options)
        finally:
            times[name] += time.process_time() - started

    return timed
