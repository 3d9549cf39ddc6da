"""Gaits of planar robots: `plan_gait`."""

import copy
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydrake.solvers import IpoptSolver, SolverOptions

from limb_systems import Gait, GaitCheck, RobotParameters, Wires
from planners.gait.check import check_gait
from planners.gait.planar_robot import POSE
from planners.gait.program import LEAST_LOAD, LEAST_STRIDE, GaitProgram
from planners.gait.schedules import check_schedule, sensible_schedules
from planners.gait.standing import LEAST_PIVOT, Standing
from planners.transcription.ipopt import ExactHessianIpoptSolver
from planners.transcription.solving import PlanningError

INTERVALS, MOST_INTERVALS = 24, 240
START_WARMTH = 40.0  # °C above ambient, of the wires of a robot that stands
# Tried one after the other where the robot does not walk as planned: on rough ground, friction of
# a foot that slides lets the body sway more and more, though it is stable at rest.
CAUTION: tuple[dict[str, Any], ...] = (
    {},
    {"sticking_share": 0.6},
    {"steadiness": 2.0},
    {"steadiness": 4.0},
)
NEAR = {"mu_strategy": "monotone", "mu_init": 1e-3}  # barrier of IPOPT from a start that is near
START_CYCLES = 6  # after which heat and memory of wires nearly repeat
LONGEST_SOLVE = 60.0  # s of processor time, of each attempt; gaits take a few
MOST_ITERATIONS = 150  # of each attempt; gaits need 25 to 60, with memory of wires 100
# By what requests are relaxed to tell why there is no gait.
LESS_FRICTION, MORE_HEAT = 0.25, 100.0
RELAXED_TIME = 10.0  # s of processor time, of each relaxed request
TOO_SOFT = (
    "the limbs are too soft for the weight on them, so that it would tip over; make them stiffer, "
    "shorter or lighter"
)


def plan_gait(
    robot: RobotParameters | str | Path | None = None,
    *,
    schedule: Sequence[Sequence[str]] | None = None,
    objective: Literal["speed", "energy"] = "speed",
    temperature_margin: float = 0.0,
    intervals: int = INTERVALS,
    check: bool = True,
    spread: bool = True,
    explain: bool = True,
) -> Gait:
    """The fastest periodic motion of a robot, or the one that heats least per distance.

    The check simulates it with contact over eight cycles, and on other grounds and with other
    parameters, which takes a minute or two. Where the robot does not walk as planned, steadier
    gaits are planned, as `CAUTION` lists them.

    Args:
        robot: description of the robot, or the path of its YAML file; the crawler if None.
        schedule: what each foot does in each phase (P, F), of `CONTACTS`; the first of
            `sensible_schedules` if None.
        objective: "speed" for the largest stride by period, "energy" for the least duty, summed
            over time and wires, by stride.
        temperature_margin: how far T stays below T_max, °C.
        intervals: number of intervals between knots, shared by the phases.
        check, spread: whether to check it by `check_gait`, and with its spread.
        explain: whether to find out, in up to a minute, why there is no gait, if there is none.

    Raises:
        PlanningError: if there is no such motion, with what stays violated, or if the robot does
            not walk as planned in simulation.
        ParameterError: if the robot's description is wrong.
    """
    robot = RobotParameters.of(robot)
    schedule = schedule or sensible_schedules(len(robot.limbs))[0]
    check_schedule(schedule, len(robot.limbs))
    _check_request(robot, schedule, objective, temperature_margin, intervals)
    shares = np.diff(np.linspace(0, intervals, len(schedule) + 1).round().astype(int))
    program = partial(
        GaitProgram,
        robot,
        schedule,
        shares.tolist(),
        objective=objective,
        temperature_margin=temperature_margin,
    )
    try:
        gait = _solved(program())
    except PlanningError as error:
        reason = _reason(program) if explain else "its program has no solution"
        raise PlanningError(f"There is no gait: {reason} ({error}).") from error
    for caution in CAUTION if check else ():
        if caution:
            try:
                gait = _solved(program(**caution))
            except PlanningError:
                continue
        gait = check_gait(gait, spread=spread)
        if gait.passed:
            return gait
    if not check:
        return gait
    raise PlanningError(
        f"Gaits were planned, the last of them of {1e3 * gait.stride:.1f} mm in "
        f"{gait.period:.1f} s, but they are refused: {gait.check.failure()}"
    )


def _check_request(
    robot: RobotParameters,
    schedule: Sequence[Sequence[str]],
    objective: str,
    temperature_margin: float,
    intervals: int,
) -> None:
    """Raises PlanningError for what a gait cannot be asked for."""
    if objective not in ("speed", "energy"):
        raise PlanningError(f"The objective is {objective!r}; it must be 'speed' or 'energy'.")
    limits, ambient = robot.together.temperature_limits, robot.together.ambient_temperature
    if not 0 <= temperature_margin < limits.maximum - ambient:
        raise PlanningError(
            f"temperature_margin is {temperature_margin:g} °C; it must be from 0 to less than "
            f"{limits.maximum - ambient:g} °C, by which T_max is above ambient."
        )
    if not 2 * len(schedule) <= intervals <= MOST_INTERVALS:
        raise PlanningError(
            f"intervals is {intervals}; it must be from {2 * len(schedule)}, two for each phase, "
            f"to {MOST_INTERVALS}."
        )


def _solved(
    program: GaitProgram, longest: float = LONGEST_SOLVE, near: np.ndarray | None = None
) -> Gait:
    """The gait that solves a program, by the first start and barrier that succeed.

    Where feet do not slide evenly in it, it is solved again from there, so that they do: from
    afar, few starts lead to a gait with this constraint.

    Args:
        longest: longest time of each attempt, s of processor time.
        near: all decision variables of a gait to start from, if one is known.

    Raises:
        PlanningError: with the solver's status, if there is none.
    """
    attempts: list[tuple[dict[str, Any], Callable]]
    # An adaptive barrier needs fewer iterations, but with feet that swing it rarely converges.
    barriers = ["adaptive", "monotone"][:: -1 if (program.contacts == "swing").any() else 1]
    attempts = [({"mu_strategy": barrier}, standing_still) for barrier in barriers]
    if not program.wires.settles.all():
        attempts = [(NEAR, _without_memory)]
    if near is not None:
        attempts = [(NEAR, lambda _: near)]
    failures: list[str] = []
    iterations, solve_time = 0, 0.0
    for barrier, begin in attempts:
        start = begin(program)
        options = SolverOptions()
        limits = {"tol": 1e-6, "constr_viol_tol": 1e-9, "max_iter": MOST_ITERATIONS}
        limits["max_cpu_time"] = longest
        for name, value in (barrier | limits).items():
            options.SetOption(IpoptSolver.id(), name, value)
        solver = ExactHessianIpoptSolver(blocks=program.blocks)
        result = solver.Solve(program.prog, start, options)
        details = result.get_solver_details()
        iterations, solve_time = iterations + details.iterations, solve_time + details.solve_time
        name = f"IPOPT, {barrier['mu_strategy']} barrier"
        if result.is_success():
            x = result.get_x_val()
            if near is None and not program.slides_evenly(x):
                program.blocks.append(program.sliding)
                return _solved(program, longest, x)
            found = GaitCheck(
                solver=name,
                status=details.status,
                objective=program.objective,
                iterations=iterations,
                solve_time=solve_time,
                violation=program.violation(x),
            )
            return program.gait(x, found)
        failures.append(f"{name}: {details.status}")
    raise PlanningError("; ".join(failures))


def _without_memory(program: GaitProgram) -> np.ndarray:
    """All decision variables of the gait of wires without memory, with the heat and the memory
    that their duty leads to.

    Raises:
        PlanningError: if there is none.
    """
    robot = copy.deepcopy(program.robot)
    for wire in robot.together.wires:
        wire.law = wire.law.without_memory()
    if not Wires(robot.together).settles.all():
        return standing_still(program)
    shares = np.bincount(program.phase_of).tolist()
    gait = _solved(
        GaitProgram(robot, program.schedule, shares, program.objective, program.temperature_margin)
    )
    wires, N = program.wires, program.wires.num_states
    states = wires.settled_states(gait.wire_temperature.mean(axis=1))
    for _ in range(START_CYCLES):
        course = [states]
        for k, step in enumerate(np.diff(gait.time)):
            duty = np.tile(gait.duty[:, k], (2, 1))
            states = wires.under_duty(states, duty, np.array([0.0, step]))[-1]
            course.append(states)
    x = np.zeros(program.prog.num_vars())
    x[program.y] = np.vstack([gait.body_pose, gait.joint_angles]).T[:-1]
    x[program.forces], x[program.duty] = gait.contact_force.T[:-1], gait.duty.T[:-1]
    x[program.heat[:, :N]] = course[:-1]
    x[program.heat[:, N:]] = gait.measured_temperature.T[:-1]
    return program.complete(x, gait.stride, np.diff(gait.time))


def _reason(program: Callable[..., GaitProgram]) -> str:
    """What keeps a robot from a gait: that without which there would be one.

    Args:
        program: program of the gait, by further arguments.
    """
    asked = program()
    F, robot = asked.planar.num_feet, asked.robot
    standing = Standing(asked.planar, asked.wires, np.ones((F, 2)))
    still = standing_still(asked)[asked.points[0]]
    if standing.split(still)[2][:, 1].min() < LEAST_LOAD * asked.load:
        return (
            "there is no load transfer, as a foot carries nothing where the robot stands; set the "
            "limbs so that its weight is between the feet"
        )
    if (standing.values(still)[-(2 * F + POSE) : -F] < LEAST_PIVOT).any():
        return TOO_SOFT
    slippery = copy.deepcopy(robot)
    assert slippery.ground is not None
    mu = slippery.ground.friction
    slippery.ground.friction *= LESS_FRICTION
    shares = np.bincount(asked.phase_of).tolist()
    margin = asked.temperature_margin
    for relaxed, reason in (
        (
            GaitProgram(slippery, asked.schedule, shares, asked.objective, margin),
            f"friction does not work one way, as the wires are too weak to slide a foot at mu = "
            f"{mu:g}, though they could at {slippery.ground.friction:g}",
        ),
        (
            program(sticking_share=np.inf),
            "there is no load transfer, as a foot that slides is not relieved enough for the "
            "others to stick; set the limbs farther apart, or make the body lighter",
        ),
        (program(steadiness=-np.inf), TOO_SOFT),
        (
            program(temperature_margin=margin - MORE_HEAT),
            f"the wires are too weak, as it would take temperatures up to {MORE_HEAT:g} °C higher",
        ),
    ):
        try:
            _solved(relaxed, RELAXED_TIME)
        except PlanningError:
            continue
        return reason
    return "no single limit of friction, stability or heat keeps it from one; try another schedule"


def standing_still(program: GaitProgram) -> np.ndarray:
    """All decision variables of a robot that stands on straight limbs, all wires equally warm.

    Raises:
        PlanningError: if the robot does not come to rest.
    """
    wires, planar, load = program.wires, program.planar, program.load
    d, F, W = len(planar.stiffness), planar.num_feet, wires.num_wires
    ambient = program.robot.together.ambient_temperature
    states = wires.settled_states(np.full(W, ambient + START_WARMTH))
    standing = Standing(planar, wires, np.ones((F, 2)))
    standing_forces, travel = np.tile([0.0, load / F], F), planar.feet(planar.rest)[:, 0]
    point = np.concatenate([planar.rest, states, standing_forces, travel])
    point[1] = planar.radius - planar.feet(planar.rest)[:, 1].mean()
    targets = np.append(np.zeros(d + F), np.full(F, planar.radius))
    unknown = np.r_[:d, d + len(states) + np.arange(2 * F)]
    for _ in range(50):
        missed = targets - standing.values(point)[: d + 2 * F]
        # More than two straight limbs share the load in many ways; one of them is taken.
        step = np.linalg.lstsq(standing.derivatives(point)[: d + 2 * F, unknown], missed)[0]
        largest = np.abs(step[:d]).max()
        point[unknown] += step / max(1.0, largest / 0.2)
        if largest < 1e-10:
            break
    else:
        raise PlanningError("The robot does not stand on its straight limbs; are they too soft?")
    y, _, forces = standing.split(point)
    y[0] = 0.0
    x = np.zeros(program.prog.num_vars())
    x[program.y], x[program.forces] = y, forces.ravel()
    x[program.heat] = np.append(states, states[:W])
    cooling, heating = (wires.rates(states, np.full(W, D))[:W] for D in (0.0, 1.0))
    x[program.duty] = cooling / (cooling - heating)
    typical = [program.prog.GetVariableScaling()[int(step)] for step in program.time_steps]
    return program.complete(x, LEAST_STRIDE, np.array(typical))
