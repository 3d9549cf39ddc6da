"""The solvers of a plan's program, in the order in which they are tried."""

import dataclasses
import time
from collections.abc import Callable

import numpy as np
from pydrake.solvers import IpoptSolver, SolverInterface, SolverOptions

from limb_systems import LimbError
from limb_systems.progress import Progress
from planners.transcription.ipopt import INFEASIBLE_STATUS, ExactHessianIpoptSolver
from planners.transcription.program import PlanProgram

# Near the solution, the barrier begins small enough to leave the guess near its bounds, and ends so
# low that it raises the cost by less than 1e-6 of it. With multipliers it begins at its end. IPOPT
# with a ``tol`` of 1e-5 takes one to four iterations more, for changes of the cost below 1e-7.
NEAR_OPTIONS = {
    "tol": 1e-3,
    "constr_viol_tol": 1e-8,
    "mu_strategy": "monotone",
    "mu_init": 3e-5,
    "mu_linear_decrease_factor": 0.05,
    "mu_superlinear_decrease_power": 1.8,
    "compl_inf_tol": 1e-6,
    "bound_push": 1e-5,
    "bound_frac": 1e-5,
    "max_iter": 400,
}
# Hysteresis and references far out of reach may need hundreds of cheap iterations. This small first
# barrier halves their number in comparison with IPOPT's own, 0.1.
PATIENT_OPTIONS = {"mu_strategy": "monotone", "mu_init": 0.01, "max_iter": 600}
# The start of another program need not be accurate, least of all at a few of the knots. Far from a
# solution, IPOPT's estimate of multipliers makes the Hessian indefinite, so they begin at zero.
START_OPTIONS = {
    "tol": 1e-3,
    "constr_viol_tol": 1e-6,
    "compl_inf_tol": 3e-6,
    "constr_mult_init_max": 0.0,
}
COARSE_START_OPTIONS = START_OPTIONS | {
    "tol": 1e-2,
    "constr_viol_tol": 1e-4,
    "compl_inf_tol": 1e-2,
}
# s of processor time, after which no attempt begins and IPOPT ends; plans take seconds.
LONGEST_SOLVE = 300.0


class PlanningError(LimbError):
    """No plan: the request is impossible, or the plan failed its check."""


class InfeasibleError(PlanningError):
    """No duty within [0, 1] meets the temperature constraints (19)-(20) and the task's limits."""


@dataclasses.dataclass
class Solution:
    """A point that solves a trajectory program.

    - ``x``: all decision variables.
    - ``cost``, ``iterations``, ``solve_time``: s, of all attempts together.
    - ``solver``: solver that solved it, and those that failed before.
    - ``status``: the solver's status.
    - ``multipliers``: multipliers for a warm start, or None.
    """

    x: np.ndarray
    cost: float
    iterations: int
    solve_time: float
    solver: str
    status: str
    multipliers: tuple[np.ndarray, np.ndarray] | None = None


def solve_program(
    program: PlanProgram,
    guess: np.ndarray,
    multipliers: tuple[np.ndarray, np.ndarray] | None = None,
    solver: SolverInterface | None = None,
    starts_near: bool = False,
    ipopt_options: dict[str, float] | None = None,
) -> Solution:
    """Solve a program by the first of these attempts that succeeds.

    1. IPOPT with the Hessian of the ``cheap_blocks``, if there are some: from near the solution,
       if the guess is, then with patience;
    2. IPOPT with the Hessian of the Lagrangian;
    3. IPOPT with this Hessian and a monotone barrier.

    All of them together end after `LONGEST_SOLVE`, and Ctrl-C ends each of them after an iteration.

    Args:
        guess: values of all decision variables.
        multipliers: multipliers of a neighbouring solution, for a warm start.
        solver: one of Drake's solvers, in place of all these.
        starts_near: whether the guess is near the solution.
        ipopt_options: options of IPOPT, in place of those of the attempts.

    Raises:
        InfeasibleError: if a quasi-static program has no solution.
        PlanningError: if all attempts fail.
        KeyboardInterrupt: after Ctrl-C, even at a good point.
    """
    failures: list[str] = []
    iterations = 0
    started = time.perf_counter()
    first_process_time = time.process_time()
    with Progress("planning", None, "iterations") as progress:

        def report(iteration, cost, violation):
            progress.update(iteration, f"(cost {cost:.6g}, violation {violation:.1e})")

        attempts = _attempts(
            program, guess, multipliers, solver, starts_near, ipopt_options or {}, report
        )
        for name, blocks, attempt in attempts:
            if time.process_time() - first_process_time > LONGEST_SOLVE:
                failures.append(f"{LONGEST_SOLVE:g} s of processor time are over")
                break
            # Solve, and count the iterations of all attempts.
            result = attempt()
            details = result.get_solver_details()
            iterations += getattr(details, "iterations", 0)
            status = getattr(details, "status", result.get_solution_result().name)
            if result.is_success():
                x = np.array(result.get_x_val())
                # Drake's solvers let bounds be exceeded by 1e-8.
                x[program.duty] = np.clip(x[program.duty], 0.0, 1.0)
                program.set_free_readings(x)
                after = f" (after {'; '.join(failures)})" if failures else ""
                return Solution(
                    x=x,
                    cost=result.get_optimal_cost(),
                    iterations=iterations,
                    solve_time=time.perf_counter() - started,
                    solver=name + after,
                    status=status,
                    # Warm starts are of the cheap blocks, which may have fewer rows.
                    multipliers=details.multipliers if blocks is program.cheap_blocks else None,
                )
            failures.append(f"{name}: {status}")
            if status == INFEASIBLE_STATUS and not program.has_inertia:
                raise InfeasibleError(
                    "The temperature constraints (19)-(20)"
                    f"{program.task.named_limits} cannot all be met with duty between 0 and "
                    f"{1.0 - program.task.duty_margin:g} and a total_duty of "
                    f"{program.parameters.total_duty:g} ({name}: {status})."
                )
    raise PlanningError(f"No solver found a plan: {'; '.join(failures)}.")


def _attempts(
    program: PlanProgram,
    guess,
    multipliers,
    solver,
    starts_near: bool,
    ipopt_options: dict[str, float],
    report: Callable,
):
    """Yield the names of the attempts, their blocks, and functions that make them."""
    if solver is not None:
        yield solver.SolverName(), (), lambda: solver.Solve(program.prog, guess, None)
        return

    begun = time.process_time()

    def ipopt(options: dict, multipliers=None, blocks=program.blocks):
        """Solve the program with IPOPT in the remaining time."""
        left = max(LONGEST_SOLVE - (time.process_time() - begun), 1e-3)
        solver_options = SolverOptions()
        for option, value in {"max_cpu_time": left, **options, **ipopt_options}.items():
            solver_options.SetOption(IpoptSolver.id(), option, value)
        fixed = program.free_readings if blocks is program.cheap_blocks else ()
        solver = ExactHessianIpoptSolver(
            blocks=blocks, fixed=fixed, scales=program.scales, on_iteration=report
        )
        return solver.Solve(program.prog, guess, solver_options, multipliers=multipliers)

    # With the cheap Hessian, then with the exact one.
    if (cheap := program.cheap_blocks) is not None:
        name = "IPOPT, curvature of the wires" if program.has_inertia else "IPOPT, quasi-static"
        if multipliers is not None or starts_near:
            yield name, cheap, lambda: ipopt(NEAR_OPTIONS, multipliers, cheap)
            name += ", patient"
        yield name, cheap, lambda: ipopt(PATIENT_OPTIONS, None, cheap)
    whole = program.blocks
    yield "IPOPT, exact Hessian", whole, lambda: ipopt({})
    name = "IPOPT, exact Hessian, monotone barrier"
    yield name, whole, lambda: ipopt({"mu_strategy": "monotone"})
