"""Gaits of planar robots: `plan_gait`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from pydrake.solvers import IpoptSolver, SolverOptions

from limb_systems import Gait, GaitCheck, RobotParameters
from planners.gait.check import check_gait
from planners.gait.program import GaitProgram
from planners.gait.schedules import check_schedule, sensible_schedules
from planners.gait.standing import Standing
from planners.transcription.ipopt import ExactHessianIpoptSolver
from planners.transcription.solving import PlanningError

INTERVALS = 24
START_WARMTH = 40.0  # °C above ambient, of the wires of a robot that stands
# Tried one after the other where the robot does not walk as planned: on rough ground, friction of
# a foot that slides lets the body sway more and more, though it is stable at rest.
CAUTION: tuple[dict[str, float], ...] = (
    {},
    {"sticking_share": 0.6},
    {"steadiness": 2.0},
    {"steadiness": 4.0},
)
MOST_ITERATIONS = 150  # of each attempt; gaits need 25 to 60


def plan_gait(
    robot: RobotParameters | str | Path | None = None,
    *,
    schedule: Sequence[Sequence[str]] | None = None,
    objective: Literal["speed", "energy"] = "speed",
    temperature_margin: float = 0.0,
    intervals: int = INTERVALS,
    check: bool = True,
    spread: bool = True,
) -> Gait:
    """The fastest periodic motion of a robot, or the one that heats least per distance.

    The check simulates it with contact over eight cycles, and on other grounds and with other
    parameters, which takes a minute or two. Where the robot does not walk as planned, steadier
    gaits are planned, as of `CAUTION`.

    Args:
        robot: description of the robot, or the path of its YAML file; the crawler if None.
        schedule: what each foot does in each phase (P, F), of `CONTACTS`; the first of
            `sensible_schedules` if None.
        objective: "speed" for the largest stride by period, "energy" for the least duty, summed
            over time and wires, by stride.
        temperature_margin: how far T stays below T_max, °C.
        intervals: number of intervals between knots, shared by the phases.
        check, spread: whether to check it by `check_gait`, and with its spread.

    Raises:
        PlanningError: if there is no such motion, with what stays violated, or if the robot does
            not walk as planned in simulation.
        ParameterError: if the robot's description is wrong.
    """
    robot = RobotParameters.of(robot)
    schedule = schedule or sensible_schedules(len(robot.limbs))[0]
    check_schedule(schedule, len(robot.limbs))
    shares = np.diff(np.linspace(0, intervals, len(schedule) + 1).round().astype(int))
    for caution in CAUTION:
        program = GaitProgram(robot, schedule, shares, objective, temperature_margin, **caution)
        gait = _solved(program)
        if not check:
            return gait
        gait = check_gait(gait, spread=spread)
        if gait.passed:
            return gait
    raise PlanningError(
        f"Gaits were planned, the last of them of {1e3 * gait.stride:.1f} mm in "
        f"{gait.period:.1f} s, but they are refused: {gait.check.failure()}"
    )


def _solved(program: GaitProgram) -> Gait:
    """The gait that solves a program; PlanningError if there is none."""
    start = standing_still(program)
    failures: list[str] = []
    iterations, solve_time = 0, 0.0
    for barrier in ("adaptive", "monotone"):
        options = SolverOptions()
        for name, value in {
            "mu_strategy": barrier,
            "tol": 1e-6,
            "constr_viol_tol": 1e-9,
            "max_iter": MOST_ITERATIONS,
        }.items():
            options.SetOption(IpoptSolver.id(), name, value)
        solver = ExactHessianIpoptSolver(exact=True, blocks=program.blocks)
        result = solver.Solve(program.prog, start, options)
        details = result.get_solver_details()
        iterations, solve_time = iterations + details.iterations, solve_time + details.solve_time
        if result.is_success():
            check = GaitCheck(
                solver=f"IPOPT, {barrier} barrier",
                status=details.status,
                objective=program.objective,
                iterations=iterations,
                solve_time=solve_time,
                violation=program.violation(result.get_x_val()),
            )
            return program.gait(result.get_x_val(), check)
        failures.append(f"{barrier} barrier: {details.status}")
    raise PlanningError(
        f"No gait was found ({'; '.join(failures)}): {explain(program, result.get_x_val())}."
    )


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
    point = np.concatenate([planar.rest, states, np.tile([0.0, load / F], F)])
    point[1] = planar.radius - planar.feet(planar.rest)[:, 1].mean()
    targets = np.concatenate(
        [np.zeros(d), planar.feet(planar.rest)[:, 0], np.full(F, planar.radius)]
    )
    unknown = np.r_[:d, len(point) - 2 * F : len(point)]
    for _ in range(50):
        missed = targets - standing.values(point)[: d + 2 * F]
        step = np.linalg.solve(standing.derivatives(point)[: d + 2 * F, unknown], missed)
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
    x[program.travel] = planar.feet(y)[:, 0]
    cooling, heating = (wires.rates(states, np.full(W, D))[:W] for D in (0.0, 1.0))
    x[program.duty] = cooling / (cooling - heating)
    x[program.steps] = [program.prog.GetVariableScaling()[int(step)] for step in program.steps]
    x[program.stride] = 1e-3
    x[program.merit] = x[program.stride] / x[program.time_steps].sum()
    if program.objective == "energy":
        used = (x[program.time_steps][:, None] * x[program.duty]).sum()
        x[program.merit] = used / x[program.stride]
    return x


def explain(program: GaitProgram, x: np.ndarray) -> str:
    """What of a program is violated most at x, in words."""
    return "it is not known what keeps it from one"
