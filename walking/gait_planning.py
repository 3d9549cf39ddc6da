"""Gaits of robots, in the vertical plane and in space: `plan_gait`."""

import contextlib
import copy
import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.solvers import IpoptSolver, SolverOptions
from scipy.interpolate import PchipInterpolator

from planners.transcription.ipopt import ExactHessianIpoptSolver
from planners.transcription.solving import PlanningError
from walking.course import Course, check_course
from walking.gait import Gait, GaitCheck
from walking.gait_check import SPREAD_CYCLES, check_gait, simulate_gait, with_friction
from walking.gait_program import (
    LEAST_LOAD,
    GaitProgram,
    usual_steadiness,
)
from walking.gait_request import GaitRequest
from walking.robot_parameters import RobotParameters
from walking.schedules import check_schedule, sensible_schedules
from walking.standing import LEAST_PIVOT, Stability, balance_of
from walking.walker import check_walker

# °C above ambient, of the wires of a robot that stands; in space also these, as in the middle of a
# wire's transformation programs may fail that have a solution.
START_WARMTH, OTHER_WARMTHS = 40.0, (55.0, 30.0)
# Shares of the steadiness asked for, up which gaits are planned from each other where none can be
# as steady; and times it, where the robot does not walk as planned: on rough ground, friction of a
# foot that slides lets the body sway more and more, though it is stable at rest.
LESS_STEADY, STEADIER = (0.125, 0.25, 0.5, 1.0), (2.0, 4.0)
# In space, shares of friction that feet that stick may use, in place of what was asked for.
LESS_FRICTION_USED = 0.75, 0.6
# Share by which strides in MuJoCo may miss those planned on knots that are dense enough, and most
# intervals: between knots, a foot that sticks in the program slides, more if they are far apart.
COARSE, MOST_KNOTS = 0.01, 96
# Barriers of IPOPT from a gait of a program that differs little, and from one whose feet slide
# unevenly.
FROM_GAIT = {"mu_strategy": "monotone", "mu_init": 1e-4}
FROM_UNEVEN = {"mu_strategy": "monotone", "mu_init": 1e-3}
START_CYCLES = 6  # after which heat and memory of wires nearly repeat
LONGEST_SOLVE = 60.0  # s of processor time, of each attempt; gaits take a few
# Iterations of each attempt; gaits need 25 to 60, with memory of wires 60 to 110; in space up to 90
# and 240.
MOST_ITERATIONS, MOST_ITERATIONS_IN_SPACE = 200, 400
# By what requests are relaxed to tell why there is no gait.
LESS_FRICTION, MORE_HEAT = 0.25, 100.0
RELAXED_TIME = 10.0  # s of processor time, of each relaxed request
LEAST_STANCE = 0.1  # of limbs' length, from foot to foot where the robot stands
TURNS = 0.25, 0.5  # of the turn asked for, by which a gait ahead becomes one along an arc
TOO_SOFT = (
    "the limbs are too soft for the weight on them, so that it would tip over; make them stiffer, "
    "shorter or lighter"
)


def plan_gait(
    robot: RobotParameters | str | Path | None = None,
    request: GaitRequest | None = None,
    **changes: Any,
) -> Gait:
    """The fastest periodic motion of a robot, or the one that heats least per distance.

    The check simulates it with contact, and on other grounds and with other parameters, which
    takes ten seconds on two cores. In a plane, where no gait is as steady as asked for, the gait is
    less steady; where the robot does not walk as planned, it is steadier. The gait's check has a
    remark that says so.

    Args:
        robot: description of the robot, or the path of its YAML file; the crawler if None.
        request: what is asked for; the defaults of `GaitRequest` if None.
        changes: fields of `GaitRequest`, in place of those of the request, such as ``turn=0.2``.

    Raises:
        PlanningError: if there is no such motion, with what stays violated, or if the robot does
            not walk as planned in simulation.
        ParameterError: if the robot's description is wrong.
    """
    # Check what is asked for.
    robot = RobotParameters.of(robot)
    request = dataclasses.replace(request or GaitRequest(), **changes)
    check_walker(robot)
    check_course(robot, request.course)
    schedules: Sequence[Sequence[Sequence[str]]] = sensible_schedules(robot)
    if request.schedule:
        schedules = [request.schedule]
    elif robot.body.mount != "free":
        schedules = schedules[:1]
    steadiness = usual_steadiness(robot) if request.steadiness is None else request.steadiness
    # Take the first schedule that gives a gait.
    for number, schedule in enumerate(schedules, 1):
        check_schedule(schedule, robot)
        request.validate(robot, schedule)
        knots = np.linspace(0, request.intervals, len(schedule) + 1).round().astype(int)
        program = partial(
            GaitProgram,
            robot,
            schedule,
            intervals=np.diff(knots).tolist(),
            objective=request.objective if request.speed is None else "energy",
            temperature_margin=request.temperature_margin,
            sticking_share=request.sticking_share,
            begins_as=request.begins_as,
        )
        is_last = number == len(schedules)
        explain = request.explain and is_last
        try:
            gait = _along(program, request.course, steadiness, request.near, explain)
            if request.check:
                gait = _walking(gait, program, request.course, request.spread)
            return gait
        except PlanningError:
            if is_last:
                raise
    raise AssertionError("there is always a schedule")


def _along(
    program: Callable[..., GaitProgram],
    course: Course,
    steadiness: float,
    near: Gait | None,
    explain: bool,
) -> Gait:
    """The gait of a course, not checked.

    Args:
        program: program of the gait, by further arguments.
        near: a gait to start from, if any.

    Raises:
        PlanningError: if there is none.
    """
    try:
        if course.speed is not None:
            fastest = dataclasses.replace(course, speed=None)
            near = _along(partial(program, objective="speed"), fastest, steadiness, near, explain)
            if near.speed < course.speed:
                raise PlanningError(
                    f"{1e3 * course.speed:.3g} mm/s cannot be had: the fastest gait of this "
                    f"schedule goes {1e3 * near.speed:.3g} mm/s"
                )
        elif course.turn and near is None and not course.on_the_spot:
            ahead = dataclasses.replace(course, turn=0.0)
            near = _along(program, ahead, steadiness, None, explain=False)
            for share in TURNS:
                part = dataclasses.replace(course, turn=share * course.turn)
                near = _solved(program(steadiness=steadiness, course=part), near)
        return _steady(partial(program, course=course), steadiness, near)
    except PlanningError as error:
        reason = "its program has no solution"
        if explain:
            relaxed = partial(program, steadiness=LESS_STEADY[0] * steadiness, course=course)
            reason = _reason(relaxed)
        raise PlanningError(f"There is no gait: {reason} ({error}).") from error


def _walking(gait: Gait, program: Callable[..., GaitProgram], course: Course, spread: bool) -> Gait:
    """The gait with its check, or one that is steadier and walks as planned.

    In space, where steadiness is not bounded, it is one whose feet that stick use less of friction.

    Raises:
        PlanningError: if none does.
    """
    if not gait.in_space:
        gait = _refined(gait, partial(program, course=course))
    first, planned = gait.check, gait
    gait = check_gait(gait, spread=spread)
    remedies: list[tuple[dict[str, float], str]] = [
        ({"steadiness": factor * first.steadiness}, f"steadier than the {first.steadiness:g}")
        for factor in STEADIER
    ]
    if gait.in_space:
        asked = f"with less of friction used than the {first.sticking_share:g}"
        shares = [share * first.sticking_share for share in LESS_FRICTION_USED]
        remedies = [({"sticking_share": share}, asked) for share in shares]
    for changes, what in () if gait.passed else remedies:
        try:
            finer = {"intervals": planned.intervals, **changes}
            other = _solved(program(course=course, **finer), planned)
        except PlanningError:
            break
        other.check.remark = f"{what} planned first, with which {gait.check.failure()}"
        gait = check_gait(other, spread=spread)
        if gait.passed:
            break
    if gait.passed:
        return gait
    goes = f"{np.rad2deg(gait.turn):.1f}°" if gait.on_the_spot else f"{1e3 * gait.stride:.1f} mm"
    raise PlanningError(
        f"Gaits were planned, the last of them of {goes} in {gait.period:.1f} s, but they are "
        f"refused: {gait.check.failure()}"
    )


def _refined(gait: Gait, program: Callable[..., GaitProgram]) -> Gait:
    """The gait on knots that are twice as dense, until strides in MuJoCo are as planned.

    Args:
        program: program of the gait, by further arguments.
    """
    while 2 * sum(gait.intervals) <= MOST_KNOTS:
        strides = simulate_gait(gait, "", gait.robot, SPREAD_CYCLES).strides
        if len(strides) == SPREAD_CYCLES and abs(strides[-1] - 1) < COARSE:
            break
        intervals = [2 * number for number in gait.intervals]
        try:
            finer = _solved(program(steadiness=gait.check.steadiness, intervals=intervals), gait)
        except PlanningError:
            break
        finer.check.remark = gait.check.remark
        gait = finer
    return gait


def _steady(program: Callable[..., GaitProgram], steadiness: float, near: Gait | None) -> Gait:
    """The gait of a steadiness, or of the next lower share of it that there is.

    Args:
        program: program of the gait, by further arguments.
        near: a gait to start from; if it leads to none in a plane, the robot stands at the start.

    Raises:
        PlanningError: with the solver's status, if there is no gait of any share.
    """
    asked = program(steadiness=steadiness)
    if near and asked.in_space:
        return _solved(asked, near)
    if near:
        with contextlib.suppress(PlanningError):
            return _solved(asked, near)
    try:
        return _solved(asked)
    except PlanningError:
        if asked.in_space:
            raise
        gait = _solved(program(steadiness=LESS_STEADY[0] * steadiness))
    for share in LESS_STEADY[1:]:
        try:
            gait = _solved(program(steadiness=share * steadiness), gait)
        except PlanningError:
            break
    else:
        return gait
    gait.check.remark = f"no gait was found that is as steady as asked for, {steadiness:g}"
    return gait


def _solved(program: GaitProgram, near: Gait | None = None, longest: float = LONGEST_SOLVE) -> Gait:
    """The gait that solves a program, by the first start and barrier that succeed.

    Where feet do not slide evenly in it, it is solved again from there, so that they do: from
    afar, few starts lead to a gait with this constraint.

    Args:
        near: a gait of a program that differs little, to start from.
        longest: longest time of each attempt, s of processor time.

    Raises:
        PlanningError: with the solver's status, if there is none.
    """
    attempts: list[tuple[dict[str, Any], Callable]]
    laws = [wire.law for wire in program.robot.as_single_limb.wires]
    is_hard = any(law.smoothed() is not law for law in laws)
    # An adaptive barrier needs fewer iterations, but with feet that swing it rarely converges.
    barriers = ["adaptive", "monotone"][:: -1 if (program.contacts == "swing").any() else 1]
    attempts = [({"mu_strategy": barrier}, standing_still) for barrier in barriers]
    if program.in_space:
        others = [partial(standing_still, warmth=warmth) for warmth in OTHER_WARMTHS]
        attempts[1:1] = [({"mu_strategy": barriers[0]}, begin) for begin in others]
    if near or is_hard:
        begin = partial(_from_gait, gait=near) if near else _easier
        attempts = [(FROM_GAIT, begin)]
    failures: list[str] = []
    iterations, solve_time = 0, 0.0
    while attempts:
        barrier, begin = attempts.pop(0)
        start = begin(program)
        options = SolverOptions()
        limits = {"tol": 1e-6, "constr_viol_tol": 1e-9, "max_cpu_time": longest}
        limits["max_iter"] = MOST_ITERATIONS_IN_SPACE if program.in_space else MOST_ITERATIONS
        for name, value in (barrier | limits).items():
            options.SetOption(IpoptSolver.id(), name, value)
        solver = ExactHessianIpoptSolver(blocks=program.blocks)
        result = solver.Solve(program.prog, start, options)
        details = result.get_solver_details()
        iterations, solve_time = iterations + details.iterations, solve_time + details.solve_time
        name = f"IPOPT, {barrier['mu_strategy']} barrier"
        if result.is_success():
            x = result.get_x_val()
            if program.sliding not in program.blocks and not program.slides_evenly(x):
                assert program.sliding is not None
                program.blocks.append(program.sliding)
                attempts = [(FROM_UNEVEN, lambda _, x=x: x)]
                continue
            found = GaitCheck(
                solver=name,
                status=details.status,
                objective=program.objective,
                iterations=iterations,
                solve_time=solve_time,
                violation=program.violation(x),
                steadiness=np.nan if program.in_space else program.steadiness,
                sticking_share=program.sticking_share,
            )
            return program.gait(x, found)
        failures.append(f"{name}: {details.status}")
    raise PlanningError("; ".join(failures))


def _easier(program: GaitProgram) -> np.ndarray:
    """All decision variables of the gait of a robot whose wires are easier to plan with.

    If its wires have less memory, the memory is what their duty leads to.

    Raises:
        PlanningError: if there is none.
    """
    robot = copy.deepcopy(program.robot)
    for wire in robot.as_single_limb.wires:
        wire.law = wire.law.smoothed()
    gait = _solved(easier := _for_robot(program, robot))
    wires = program.wires
    if easier.wires.num_states == wires.num_states:
        return _from_gait(program, gait)
    states = wires.settled_states(gait.wire_temperature.mean(axis=1))
    for _ in range(START_CYCLES):
        course = [states]
        for k, step in enumerate(np.diff(gait.time)):
            duty = np.tile(gait.duty[:, k], (2, 1))
            states = wires.integrate_states(states, duty, np.array([0.0, step]))[-1]
            course.append(states)
    return _from_gait(program, gait, np.array(course))


def _for_robot(program: GaitProgram, robot: RobotParameters) -> GaitProgram:
    """The same program for another robot."""
    return GaitProgram(
        robot,
        program.schedule,
        np.bincount(program.phase_of).tolist(),
        program.objective,
        program.temperature_margin,
        program.sticking_share,
        steadiness=program.steadiness,
        course=program.course,
    )


def _from_gait(program: GaitProgram, gait: Gait, states: np.ndarray | None = None) -> np.ndarray:
    """All decision variables of a gait, with other states x of the wires (K + 1, N), if given."""
    N = program.wires.num_states
    x = np.zeros(program.prog.num_vars())
    # Divide the phases of the gait into the program's intervals.
    starts = np.append([phase.start for phase in gait.phases], gait.period)
    steps = (np.diff(starts) / np.bincount(program.phase_of))[program.phase_of]
    times = np.append(0.0, np.cumsum(steps)[:-1])

    def at_knots(values: np.ndarray) -> np.ndarray:
        return PchipInterpolator(gait.time, values, axis=1)(times).T

    # Take everything from there.
    x[program.y] = at_knots(np.vstack([gait.body_pose, gait.joint_angles]))
    x[program.forces.reshape(len(program.y), -1)] = at_knots(gait.contact_force)
    held = np.searchsorted(gait.time, times + 0.5 * steps) - 1
    x[program.duty] = gait.duty.T[held]
    x[program.heat[:, :N]] = at_knots(gait.wire_states if states is None else states.T)
    x[program.heat[:, N:]] = at_knots(gait.measured_temperature)
    return program.complete(x, steps, gait.displacement)


def _reason(program: Callable[..., GaitProgram]) -> str:
    """What keeps a robot from a gait: that without which there would be one.

    Args:
        program: program of the gait, by further arguments.
    """
    asked = program()
    walker = asked.walker
    point = standing_still(asked)[asked.points[0]]
    y, _, forces = asked.balance.split(point)
    places = walker.feet(y)[:, 0]
    if np.ptp(places) < LEAST_STANCE * walker.size:
        return (
            f"all feet are within {1e3 * np.ptp(places):.1f} mm of each other along x, so that "
            "the body tips over; set the limbs apart"
        )
    if forces[:, -1].min() < LEAST_LOAD * asked.load:
        return (
            "there is no load transfer, as a foot carries nothing where the robot stands; set the "
            "limbs so that its weight is between the feet"
        )
    if not asked.in_space:
        still = Stability(walker, asked.wires, np.ones((walker.num_feet, 2))).values(point)
        if (still[: -walker.num_feet] < LEAST_PIVOT).any():
            return TOO_SOFT
    margin = asked.temperature_margin
    slippery = _for_robot(asked, with_friction(asked.robot, LESS_FRICTION))
    too_cold = (
        program(temperature_margin=0.0),
        f"wires that stay {margin:g} °C below T_max are too cold, as there would be one without a "
        "margin; ask for a smaller one",
    )
    for relaxed, reason in (
        *([too_cold] if margin else []),
        (
            slippery,
            f"friction does not work one way, as the wires are too weak to slide a foot at mu = "
            f"{walker.friction:g}, though they could at {slippery.walker.friction:g}",
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
            _solved(relaxed, longest=RELAXED_TIME)
        except PlanningError:
            continue
        return reason
    return "no single limit of friction, stability or heat keeps it from one; try another schedule"


def standing_still(program: GaitProgram, warmth: float = START_WARMTH) -> np.ndarray:
    """All decision variables of a robot that stands on straight limbs, all wires equally warm.

    Args:
        warmth: how far the wires are above ambient, °C.

    Raises:
        PlanningError: if the robot does not come to rest.
    """
    wires, walker, load = program.wires, program.walker, program.load
    d, F, W = len(walker.stiffness), walker.num_feet, wires.num_wires
    ambient = program.robot.as_single_limb.ambient_temperature
    states = wires.settled_states(np.full(W, ambient + warmth))
    balance, up = balance_of(walker, wires), np.eye(walker.num_tangents + 1)[-1]
    forces, feet = np.tile(load / F * up, F), walker.feet(walker.rest)
    point = np.concatenate([walker.rest, states, forces, feet[:, :-1].ravel()])
    point[walker.height] = walker.radius - feet[:, -1].mean()
    targets = np.zeros(balance.num_values)
    targets[-F:] = walker.radius
    unknown = np.r_[:d, d + len(states) + np.arange(len(forces))]
    for _ in range(50):
        values, slopes = balance.first(point)
        # More than two straight limbs share the load in many ways; one of them is taken.
        step = np.linalg.lstsq(slopes[:, unknown], targets - values)[0]
        largest = np.abs(step[:d]).max()
        point[unknown] += step / max(1.0, largest / 0.2)
        if largest < 1e-10:
            break
    else:
        raise PlanningError("The robot does not stand on its straight limbs; are they too soft?")
    y, _, forces = balance.split(point)
    y[: walker.num_tangents] = 0.0
    x = np.zeros(program.prog.num_vars())
    x[program.y], x[program.forces] = y, forces
    x[program.heat] = np.append(states, states[:W])
    x[program.duty] = wires.holding_duty(states)
    typical = [program.prog.GetVariableScaling()[int(step)] for step in program.time_steps]
    return program.complete(x, np.array(typical))
