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

from limb_systems.wires import Wires
from planners.transcription.ipopt import ExactHessianIpoptSolver
from planners.transcription.solving import PlanningError
from walking.course import Course, check_course
from walking.gait import STRIDE_TOLERANCE, STRIDE_TOLERANCE_IN_SPACE, Gait, GaitCheck
from walking.gait_check import SPREAD_CYCLES, check_gait, simulate_gait, with_friction
from walking.gait_program import (
    MIN_LOAD_SHARE,
    STICKING_SHARE,
    GaitProgram,
    default_steadiness,
    default_sticking_share,
    is_calibrated,
)
from walking.gait_request import GaitRequest
from walking.robot_parameters import RobotParameters
from walking.schedules import candidate_schedules, check_schedule
from walking.standing import MIN_PIVOT, Stability, make_balance
from walking.walker import check_walker

# °C above ambient: warmth of the wires of a robot that stands at the start. In space programs that
# have a solution may fail in the middle of a wire's transformation; the others are tried there.
START_WARMTH = 40.0
ALTERNATIVE_WARMTHS = (55.0, 30.0)
# Shares of the requested steadiness. Where no gait is so steady, gaits are planned up these shares,
# each from the last.
STEADINESS_SHARES = (0.125, 0.25, 0.5, 1.0)
# Multiples of the requested steadiness, where the robot does not walk as planned: on rough ground,
# friction of a foot that slides lets the body sway more and more, though it is stable at rest.
STEADINESS_FACTORS = (2.0, 4.0)
# In space, multiples of the requested share of friction that feet that stick may use.
STICKING_FACTORS = (0.75,)
# Knots are dense enough when strides in MuJoCo miss the planned ones by less than this share.
# Between knots, a foot that sticks in the program slides; it slides farther between distant knots.
MAX_STRIDE_ERROR = 0.01
MAX_REFINED_INTERVALS = 96
# Barriers of IPOPT from a gait of a program that differs little, and from one whose feet slide
# unevenly.
WARM_START_BARRIER = {"mu_strategy": "monotone", "mu_init": 1e-4}
FRICTION_BARRIER = {"mu_strategy": "monotone", "mu_init": 1e-3}
START_CYCLES = 6  # after which heat and memory of wires nearly repeat
MAX_SOLVE_TIME = 60.0  # s of processor time, of each attempt; gaits take a few
# Iterations of each attempt; gaits need 25 to 60, with memory of wires 60 to 110; in space up to 90
# and 350.
MAX_ITERATIONS = 200
MAX_ITERATIONS_IN_SPACE = 400
# Requests are relaxed by these to find the reason why there is no gait: times μ, and °C.
RELAXED_FRICTION_FACTOR = 0.25
RELAXED_TEMPERATURE_RISE = 100.0
RELAXED_TIME = 10.0  # s of processor time, of each relaxed request
MIN_STANCE_SHARE = 0.1  # of limbs' length, from foot to foot where the robot stands
TURN_SHARES = 0.25, 0.5  # of the turn asked for, by which a gait ahead becomes one along an arc
TOO_SOFT_REASON = (
    "the limbs are too soft for the weight on them, so that it would tip over; make them stiffer, "
    "shorter or lighter"
)


def plan_gait(
    robot: RobotParameters | str | Path | None = None,
    request: GaitRequest | None = None,
    **changes: Any,
) -> Gait:
    """Return the fastest periodic motion of a robot, or the motion that heats least per distance.

    The check simulates the gait with contact, also with varied friction and parameters, which takes
    ten seconds on two cores. In a plane, where no gait is as steady as requested, the gait is less
    steady; where the robot does not walk as planned, it is steadier. The gait's check then has a
    remark on its steadiness.

    Args:
        robot: description of the robot, or the path of its YAML file; the crawler if None.
        request: the properties that the gait must have; the defaults of `GaitRequest` if None.
        changes: fields of `GaitRequest` that replace the request's, such as ``turn=0.2``.

    Raises:
        PlanningError: if there is no such motion, with the constraints that stay violated, or if
            the robot does not walk as planned in simulation.
        ParameterError: if the robot's description is wrong.
    """
    # Check the request, and choose the schedules.
    robot = RobotParameters.of(robot)
    request = dataclasses.replace(request or GaitRequest(), **changes)
    check_walker(robot)
    check_course(robot, request.course)
    schedules: Sequence[Sequence[Sequence[str]]] = candidate_schedules(robot)
    if request.schedule:
        schedules = [request.schedule]
    elif robot.body.mount != "free":
        schedules = schedules[:1]
    steadiness = default_steadiness(robot) if request.steadiness is None else request.steadiness
    sticking_share = request.sticking_share
    if sticking_share is None:
        sticking_share = default_sticking_share(robot, request.course)
    if request.course.on_the_spot and sticking_share < STICKING_SHARE:
        # With less friction, IPOPT takes 20 to 40 s for each schedule without rests, and fails.
        still = ["stick"] * len(robot.limbs)
        schedules = sorted(schedules, key=lambda schedule: still not in schedule)
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
            sticking_share=sticking_share,
            begins_as=request.begins_as,
        )
        is_last = number == len(schedules)
        explain = request.explain and is_last
        try:
            gait = _plan_course(program, request.course, steadiness, request.near, explain)
            if request.check:
                gait = _ensure_walking(gait, program, request.course, request.spread)
        except PlanningError:
            if is_last:
                raise
        else:
            return gait
    raise AssertionError("there is always a schedule")


def _plan_course(
    program: Callable[..., GaitProgram],
    course: Course,
    steadiness: float,
    near: Gait | None,
    explain: bool,
) -> Gait:
    """Return a gait along a course, not checked.

    Args:
        program: makes the program of the gait from further arguments.
        near: a gait to start from, if any.
        explain: whether the error gives the reason why there is no gait.

    Raises:
        PlanningError: if there is none.
    """
    try:
        # Find a gait to start from: the fastest, or a gait ahead that is bent to the arc.
        if course.speed is not None:
            fastest = dataclasses.replace(course, speed=None)
            near = _plan_course(
                partial(program, objective="speed"), fastest, steadiness, near, explain
            )
            if near.speed < course.speed:
                raise PlanningError(
                    f"{1e3 * course.speed:.3g} mm/s cannot be had: the fastest gait of this "
                    f"schedule goes {1e3 * near.speed:.3g} mm/s"
                )
        elif course.turn and near is None and not course.on_the_spot:
            ahead = dataclasses.replace(course, turn=0.0)
            near = _plan_course(program, ahead, steadiness, None, explain=False)
            for share in TURN_SHARES:
                part = dataclasses.replace(course, turn=share * course.turn)
                near = _solve(program(steadiness=steadiness, course=part), near)
        # Solve the program of the course itself.
        return _solve_steadily(partial(program, course=course), steadiness, near)
    except PlanningError as error:
        reason = "its program has no solution"
        if explain:
            relaxed = partial(program, steadiness=STEADINESS_SHARES[0] * steadiness, course=course)
            reason = _infeasibility_reason(relaxed)
        raise PlanningError(f"There is no gait: {reason} ({error}).") from error


def _ensure_walking(
    gait: Gait, program: Callable[..., GaitProgram], course: Course, spread: bool
) -> Gait:
    """Return the gait with its check, or a steadier gait that walks as planned.

    In space, where steadiness is not bounded, feet that stick use less friction instead.

    Raises:
        PlanningError: if no gait walks as planned.
    """
    # Check the gait.
    if not gait.in_space:
        gait = _refine_knots(gait, partial(program, course=course))
    first = gait.check
    planned = gait
    gait = check_gait(gait, spread=spread)

    # Plan safer gaits where it fails, until one passes.
    remedy = "steadiness"
    factors: tuple[float, ...] = STEADINESS_FACTORS
    difference = f"steadier than the {first.steadiness:g}"
    if gait.in_space:
        remedy = "sticking_share"
        factors = STICKING_FACTORS
        difference = f"with less of friction used than the {first.sticking_share:g}"
    for factor in factors:
        if gait.passed:
            break
        changed = {remedy: factor * getattr(first, remedy)}
        try:
            safer = _solve(program(course=course, intervals=planned.intervals, **changed), planned)
        except PlanningError:
            break
        safer.check.remark = f"{difference} planned first, with which {gait.check.failure()}"
        gait = check_gait(safer, spread=spread)
    if gait.passed:
        return gait
    travel = f"{np.rad2deg(gait.turn):.1f}°" if gait.on_the_spot else f"{1e3 * gait.stride:.1f} mm"
    raise PlanningError(
        f"Gaits were planned, the last of them of {travel} in {gait.period:.1f} s, but they are "
        f"refused: {gait.check.failure()}"
    )


def _refine_knots(gait: Gait, program: Callable[..., GaitProgram]) -> Gait:
    """Double the knots of a gait until its strides in MuJoCo are as planned.

    Args:
        program: makes the program of the gait from further arguments.
    """
    while 2 * sum(gait.intervals) <= MAX_REFINED_INTERVALS:
        strides = simulate_gait(gait, "", gait.robot, SPREAD_CYCLES).strides
        if len(strides) == SPREAD_CYCLES and abs(strides[-1] - 1) < MAX_STRIDE_ERROR:
            break
        intervals = (2 * np.array(gait.intervals)).tolist()
        try:
            finer = _solve(program(steadiness=gait.check.steadiness, intervals=intervals), gait)
        except PlanningError:
            break
        finer.check.remark = gait.check.remark
        gait = finer
    return gait


def _solve_steadily(
    program: Callable[..., GaitProgram], steadiness: float, near: Gait | None
) -> Gait:
    """Return the gait of a steadiness, or of the largest share of it with a gait.

    Args:
        program: makes the program of the gait from further arguments.
        near: a gait to start from; if it leads to none in a plane, the robot stands at the start.

    Raises:
        PlanningError: with the solver's status, if there is no gait of any share.
    """
    # Ask for the whole steadiness.
    requested = program(steadiness=steadiness)
    if near and requested.in_space:
        return _solve(requested, near)
    if near:
        with contextlib.suppress(PlanningError):
            return _solve(requested, near)
    # Go up its shares, each from the gait before, where there is no gait.
    try:
        return _solve(requested)
    except PlanningError:
        if requested.in_space:
            raise
        gait = _solve(program(steadiness=STEADINESS_SHARES[0] * steadiness))
    for share in STEADINESS_SHARES[1:]:
        try:
            gait = _solve(program(steadiness=share * steadiness), gait)
        except PlanningError:
            break
    else:
        return gait
    gait.check.remark = f"no gait was found that is as steady as asked for, {steadiness:g}"
    return gait


def _solve(
    program: GaitProgram, near: Gait | None = None, max_time: float = MAX_SOLVE_TIME
) -> Gait:
    """Solve a program with the first start and barrier that succeed.

    Where the solution violates the limit of `FrictionGain`, the program is solved again from there
    with this constraint: from afar, few starts lead to a gait with it.

    Args:
        near: a gait of a program that differs little, to start from.
        max_time: longest time of each attempt, s of processor time.

    Raises:
        PlanningError: with the solver's status, if there is none.
    """
    laws = [wire.law for wire in program.robot.as_single_limb.wires]
    smoothed_laws = [law.smoothed() for law in laws if law.smoothed() is not law]
    if program.in_space and any(law.memory for law in smoothed_laws):
        return _solve_with_gradual_turns(program, near, max_time)

    # List attempts: pairs of a barrier and a start.
    attempts: list[tuple[dict[str, Any], Callable]]
    # An adaptive barrier needs fewer iterations, but with feet that swing it rarely converges.
    barriers = ["adaptive", "monotone"][:: -1 if (program.contacts == "swing").any() else 1]
    starts = [standing_start]
    if program.in_space:
        starts += [partial(standing_start, warmth=warmth) for warmth in ALTERNATIVE_WARMTHS]
    attempts = [({"mu_strategy": barriers[0]}, start) for start in starts]
    attempts.append(({"mu_strategy": barriers[1]}, standing_start))
    if near or smoothed_laws:
        start = partial(_start_from_gait, gait=near) if near else _start_from_smoothed_laws
        attempts = [(WARM_START_BARRIER, start)]

    failures: list[str] = []
    iterations = 0
    solve_time = 0.0
    while attempts:
        # Solve the program by the next attempt.
        barrier, start = attempts.pop(0)
        initial_guess = start(program)
        options = SolverOptions()
        limits = {"tol": 1e-6, "constr_viol_tol": 1e-9, "max_cpu_time": max_time}
        limits["max_iter"] = MAX_ITERATIONS_IN_SPACE if program.in_space else MAX_ITERATIONS
        for name, value in (barrier | limits).items():
            options.SetOption(IpoptSolver.id(), name, value)
        solver = ExactHessianIpoptSolver(blocks=program.blocks)
        result = solver.Solve(program.prog, initial_guess, options)
        details = result.get_solver_details()
        iterations += details.iterations
        solve_time += details.solve_time
        name = f"IPOPT, {barrier['mu_strategy']} barrier"
        if not result.is_success():
            failures.append(f"{name}: {details.status}")
            continue
        x = result.get_x_val()

        # Solve again with the limit of friction on itself, if it is violated.
        if program.sliding not in program.blocks and not program.has_stable_friction(x):
            assert program.sliding is not None
            program.blocks.append(program.sliding)
            attempts = [(FRICTION_BARRIER, lambda _, x=x: x)]
            continue
        check = GaitCheck(
            solver=name,
            status=details.status,
            objective=program.objective,
            iterations=iterations,
            solve_time=solve_time,
            violation=program.violation(x),
            steadiness=np.nan if program.in_space else program.steadiness,
            sticking_share=program.sticking_share,
            tolerance=STRIDE_TOLERANCE_IN_SPACE if program.in_space else STRIDE_TOLERANCE,
        )
        return program.gait(x, check)
    raise PlanningError("; ".join(failures))


def _solve_with_gradual_turns(program: GaitProgram, near: Gait | None, max_time: float) -> Gait:
    """Return the gait of wires whose paths turn gradually, with the heat of the true laws.

    True hysteretic paths turn within tenths of a degree and a second. Knots half a second apart do
    not resolve this, and IPOPT rarely converges. The check then says what the motion makes.

    Raises:
        PlanningError: if there is no such gait.
    """
    gait = _solve(_with_robot(program, _with_smoothed_laws(program.robot)), near, max_time)
    states = _periodic_states(program.wires, gait)
    return dataclasses.replace(gait, robot=program.robot, **program.wires.signals(states.T))


def _start_from_smoothed_laws(program: GaitProgram) -> np.ndarray:
    """Return all decision variables of the gait of a robot with smoothed laws of wires.

    If the smoothed laws have no memory, the memory follows from the gait's duty.

    Raises:
        PlanningError: if there is no such gait.
    """
    smoothed_program = _with_robot(program, _with_smoothed_laws(program.robot))
    gait = _solve(smoothed_program)
    if smoothed_program.wires.num_states == program.wires.num_states:
        return _start_from_gait(program, gait)
    return _start_from_gait(program, gait, _periodic_states(program.wires, gait))


def _periodic_states(wires: Wires, gait: Gait) -> np.ndarray:
    """Return states x (K, N) of wires under a gait's duty, whose heat and memory nearly repeat."""
    state = wires.settled_states(gait.wire_temperature.mean(axis=1))
    for _ in range(START_CYCLES):
        states = [state]
        for k, step in enumerate(np.diff(gait.time)):
            duty = np.tile(gait.duty[:, k], (2, 1))
            state = wires.integrate_states(state, duty, np.array([0.0, step]))[-1]
            states.append(state)
    return np.array(states)


def _with_smoothed_laws(robot: RobotParameters) -> RobotParameters:
    """Return a copy of a robot with smoothed laws of wires."""
    robot = copy.deepcopy(robot)
    for wire in robot.as_single_limb.wires:
        wire.law = wire.law.smoothed()
    return robot


def _without_calibration(robot: RobotParameters) -> RobotParameters:
    """Return a copy of a robot whose limbs are as if they were only described."""
    robot = copy.deepcopy(robot)
    for limb in robot.limbs:
        limb.parameters.calibration = None
    return robot


def _with_robot(program: GaitProgram, robot: RobotParameters) -> GaitProgram:
    """Return the same program for another robot."""
    return GaitProgram(
        robot,
        program.schedule,
        np.bincount(program.phase_of).tolist(),
        program.objective,
        program.temperature_margin,
        program.sticking_share,
        steadiness=program.steadiness,
        course=program.course,
        begins_as=program.begins_as,
    )


def _start_from_gait(
    program: GaitProgram, gait: Gait, states: np.ndarray | None = None
) -> np.ndarray:
    """Return all decision variables of a gait.

    Args:
        states: states x of the wires (K + 1, N), in place of the gait's.
    """
    N = program.wires.num_states
    x = np.zeros(program.prog.num_vars())
    # Divide the phases of the gait into the program's intervals.
    starts = np.append(gait.phase_starts, gait.period)
    steps = (np.diff(starts) / np.bincount(program.phase_of))[program.phase_of]
    times = np.append(0.0, np.cumsum(steps)[:-1])

    def at_knots(values: np.ndarray) -> np.ndarray:
        return PchipInterpolator(gait.time, values, axis=1)(times).T

    # Interpolate the gait's signals at the program's knots; its duty is constant in an interval.
    x[program.y] = at_knots(np.vstack([gait.body_pose, gait.joint_angles]))
    x[program.forces.reshape(len(program.y), -1)] = at_knots(gait.contact_force)
    intervals = np.searchsorted(gait.time, times + 0.5 * steps) - 1
    x[program.duty] = gait.duty.T[intervals]
    x[program.heat[:, :N]] = at_knots(gait.wire_states if states is None else states.T)
    x[program.heat[:, N:]] = at_knots(gait.measured_temperature)
    return program.complete(x, steps, gait.displacement)


def _infeasibility_reason(program: Callable[..., GaitProgram]) -> str:
    """Return the limit that keeps a robot from a gait: without it there would be one.

    Args:
        program: makes the program of the gait from further arguments.
    """
    # Look at the robot where it stands.
    requested = program()
    walker = requested.walker
    point = standing_start(requested)[requested.points[0]]
    y, _, forces = requested.balance.split(point)
    places = walker.feet(y)[:, 0]
    if np.ptp(places) < MIN_STANCE_SHARE * walker.size:
        return (
            f"all feet are within {1e3 * np.ptp(places):.1f} mm of each other along x, so that "
            "the body tips over; set the limbs apart"
        )
    if forces[:, -1].min() < MIN_LOAD_SHARE * requested.load:
        return (
            "there is no load transfer, as a foot carries nothing where the robot stands; set the "
            "limbs so that its weight is between the feet"
        )
    if not requested.in_space:
        supported = np.ones((walker.num_feet, 2))
        pivots = Stability(walker, requested.wires, supported).values(point)
        if (pivots[: -walker.num_feet] < MIN_PIVOT).any():
            return TOO_SOFT_REASON

    # Relax one limit after the other, until there is a gait.
    relaxations = []
    if requested.in_space and is_calibrated(requested.robot):
        relaxations.append(
            (
                _with_robot(requested, _without_calibration(requested.robot)),
                "some foot carries too little, or the feet stand too close together, for a robot "
                "whose limbs and hips are not quite as described; set the limbs farther apart",
            )
        )
    margin = requested.temperature_margin
    if margin:
        relaxations.append(
            (
                program(temperature_margin=0.0),
                f"wires that stay {margin:g} °C below T_max are too cold, as there would be one "
                "without a margin; ask for a smaller one",
            )
        )
    slippery = _with_robot(requested, with_friction(requested.robot, RELAXED_FRICTION_FACTOR))
    relaxations += [
        (
            slippery,
            f"friction does not work one way, as the wires are too weak to slide a foot at mu = "
            f"{walker.friction:g}, though they could at {slippery.walker.friction:g}",
        ),
        (
            program(sticking_share=np.inf),
            "there is no load transfer, as a foot that slides is not relieved enough for the "
            "others to stick; set the limbs farther apart, make the body lighter, or let feet "
            f"that stick use more of the friction than {requested.sticking_share:g} "
            "(sticking_share)",
        ),
        (program(steadiness=-np.inf), TOO_SOFT_REASON),
        (
            program(temperature_margin=margin - RELAXED_TEMPERATURE_RISE),
            f"the wires are too weak, as it would take temperatures up to "
            f"{RELAXED_TEMPERATURE_RISE:g} °C higher",
        ),
    ]
    for relaxed, reason in relaxations:
        try:
            _solve(relaxed, max_time=RELAXED_TIME)
        except PlanningError:
            continue
        return reason
    return "no single limit of friction, stability or heat keeps it from one; try another schedule"


def standing_start(program: GaitProgram, warmth: float = START_WARMTH) -> np.ndarray:
    """Return all decision variables of a robot that stands on straight, equally warm limbs.

    Args:
        warmth: how far the wires are above ambient, °C.

    Raises:
        PlanningError: if the robot does not come to rest.
    """
    wires = program.wires
    walker = program.walker
    d = len(walker.stiffness)
    F = walker.num_feet
    W = wires.num_wires

    # Start at straight limbs, each of which carries the same load.
    ambient = program.robot.as_single_limb.ambient_temperature
    states = wires.settled_states(np.full(W, ambient + warmth))
    up = np.eye(walker.num_tangents + 1)[-1]
    forces = np.tile(program.load / F * up, F)
    feet = walker.feet(walker.rest)
    point = np.concatenate([walker.rest, states, forces, feet[:, :-1].ravel()])
    point[walker.height] = walker.radius - feet[:, -1].mean()

    # Find the balance of configuration and forces by Newton's method.
    balance = make_balance(walker, wires)
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

    # Stand so at all knots, with the duty that keeps the heat.
    x = np.zeros(program.prog.num_vars())
    x[program.y] = y
    x[program.forces] = forces
    x[program.heat] = np.append(states, states[:W])
    x[program.duty] = wires.holding_duty(states)
    scales = program.prog.GetVariableScaling()
    typical_steps = np.array([scales[int(step)] for step in program.time_steps])
    return program.complete(x, typical_steps)
