"""IPOPT with the exact Hessian of a quadratic cost, for Drake programs.

Drake's `IpoptSolver` gives IPOPT a limited-memory Hessian and ignores the
program's variable scaling. Where the cost is quadratic its Hessian is known,
and where constraints bend little the cost's Hessian alone (Gauss-Newton) is
nearly that of the Lagrangian.
"""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Protocol

import ipyopt
import numpy as np
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.solvers import MathematicalProgram

OPTIONS = {
    "mu_strategy": "adaptive",
    "tol": 1e-4,  # of the scaled objective, whose size is 100 at the most
    "constr_viol_tol": 1e-8,
    # Else bounds are relaxed, and the projection onto them at the end moves
    # temperatures by 1e-6 °C, which stiff accelerations do not forgive.
    "bound_relax_factor": 0.0,
    "nlp_scaling_method": "none",  # variables, rows and objective come scaled
    "mumps_permuting_scaling": 0,
    "mumps_scaling": 0,
    "max_iter": 300,
    "print_level": 0,
    "sb": "yes",
}

STATUS = {
    0: "solved",
    1: "solved to acceptable level",
    2: "infeasible problem detected",
    3: "search direction becomes too small",
    4: "diverging iterates",
    5: "stopped by the user",
    -1: "maximum number of iterations exceeded",
    -2: "restoration failed",
    -3: "error in step computation",
    -4: "maximum CPU time exceeded",
    -10: "not enough degrees of freedom",
    -11: "invalid problem definition",
    -13: "invalid number detected",
}


class ConstraintBlock(Protocol):
    """Constraints lower <= g(x) <= upper that are evaluated together.

    - ``lower``, ``upper``: (m,).
    - ``rows``, ``columns``: of the nonzeros of the Jacobian, in (m, len(x)).
    """

    lower: np.ndarray
    upper: np.ndarray
    rows: np.ndarray
    columns: np.ndarray

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        """g(x) (m,)."""

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """The nonzeros of dg/dx, in the order of ``rows`` and ``columns``."""


@dataclasses.dataclass
class Solution:
    """What IPOPT came back with.

    - ``x``: all decision variables of the program.
    - ``cost``: at x, unscaled.
    - ``success``, ``status``: whether it converged, and in words.
    - ``iterations``, ``solve_time``: s.
    """

    x: np.ndarray
    cost: float
    success: bool
    status: str
    iterations: int
    solve_time: float


class BindingBlock:
    """Constraints of a program, evaluated by Drake's AutoDiff."""

    def __init__(self, prog: MathematicalProgram, bindings: Sequence):
        self._bindings = [
            (binding.evaluator(), np.array(prog.FindDecisionVariableIndices(binding.variables())))
            for binding in bindings
        ]
        sizes = [evaluator.num_constraints() for evaluator, _ in self._bindings]
        starts = np.cumsum([0, *sizes])
        grids = [
            np.meshgrid(np.arange(start, start + size), indices, indexing="ij")
            for start, size, (_, indices) in zip(starts, sizes, self._bindings, strict=False)
        ]
        self.rows = _concatenate([grid[0].ravel() for grid in grids], int)
        self.columns = _concatenate([grid[1].ravel() for grid in grids], int)
        self.lower = _concatenate([evaluator.lower_bound() for evaluator, _ in self._bindings])
        self.upper = _concatenate([evaluator.upper_bound() for evaluator, _ in self._bindings])

    def evaluate(self, x):
        return _concatenate([evaluator.Eval(x[indices]) for evaluator, indices in self._bindings])

    def jacobian(self, x):
        return _concatenate(
            [
                ExtractGradient(evaluator.Eval(InitializeAutoDiff(x[indices])[:, 0])).ravel()
                for evaluator, indices in self._bindings
            ]
        )


def solve(
    prog: MathematicalProgram,
    initial_guess: np.ndarray,
    nonlinear: ConstraintBlock | None = None,
    on_iteration: Callable[[int, float, float], None] | None = None,
) -> Solution:
    """Solves a program of quadratic costs, bounds, linear and nonlinear constraints.

    Variables are scaled as `SetVariableScaling` of the program says.

    Args:
        initial_guess: for all decision variables.
        nonlinear: evaluates all nonlinear constraints of the program, up to
            their scaling; by default they evaluate themselves.
        on_iteration: is told the iteration, cost and constraint violation.

    Raises:
        ValueError: if the program has costs or constraints of other kinds.
    """
    nonlinear_bindings = [*prog.generic_constraints(), *prog.quadratic_constraints()]
    num_supported = sum(
        len(bindings)
        for bindings in (
            prog.quadratic_costs(),
            prog.linear_costs(),
            prog.bounding_box_constraints(),
            prog.linear_constraints(),
            prog.linear_equality_constraints(),
            nonlinear_bindings,
        )
    )
    if num_supported != len(prog.GetAllCosts()) + len(prog.GetAllConstraints()):
        raise ValueError(
            "This solver takes quadratic and linear costs, and bounds, linear, quadratic and "
            "generic constraints; the program has others."
        )
    cost = _QuadraticCost(prog)
    linear = [*prog.linear_constraints(), *prog.linear_equality_constraints()]
    blocks = [nonlinear or BindingBlock(prog, nonlinear_bindings)]
    blocks.append(BindingBlock(prog, linear))

    scale = np.ones(prog.num_vars())
    for index, value in prog.GetVariableScaling().items():
        scale[index] = value
    lower, upper = _bounds(prog)
    cost_scale = min(1.0, 100.0 / max(cost.evaluate(initial_guess), 1e-9))
    row_starts = np.cumsum([0, *(len(block.lower) for block in blocks)])
    rows = np.concatenate(
        [start + block.rows for start, block in zip(row_starts, blocks, strict=False)]
    )
    columns = np.concatenate([block.columns for block in blocks])
    hessian = cost_scale * cost.values * scale[cost.rows] * scale[cost.columns]
    triangle = cost.rows >= cost.columns

    def evaluate_cost_gradient(y, out):
        out[:] = cost_scale * scale * cost.gradient(scale * y)

    def evaluate_constraints(y, out):
        out[:] = np.concatenate([block.evaluate(scale * y) for block in blocks])

    def evaluate_jacobian(y, out):
        nonzeros = np.concatenate([block.jacobian(scale * y) for block in blocks])
        out[:] = nonzeros * scale[columns]

    def evaluate_hessian(_y, _multipliers, cost_factor, out):
        out[:] = cost_factor * hessian[triangle]

    iterations = 0

    def after_iteration(_mode, iteration, scaled_cost, violation, *_):
        nonlocal iterations
        iterations = iteration
        if on_iteration:
            on_iteration(iteration, scaled_cost / cost_scale, violation)
        return True

    start = time.perf_counter()
    problem = ipyopt.Problem(
        prog.num_vars(),
        lower / scale,
        upper / scale,
        int(row_starts[-1]),
        np.concatenate([block.lower for block in blocks]),
        np.concatenate([block.upper for block in blocks]),
        (rows, columns),
        (cost.rows[triangle], cost.columns[triangle]),
        lambda y: cost_scale * cost.evaluate(scale * y),
        evaluate_cost_gradient,
        evaluate_constraints,
        evaluate_jacobian,
        evaluate_hessian,
        after_iteration,
        ipopt_options=OPTIONS,
    )
    y, _, status = problem.solve(initial_guess / scale)
    x = np.clip(scale * y, lower, upper)  # scaling rounds, and bounds are bounds
    return Solution(
        x=x,
        cost=cost.evaluate(x),
        success=status == 0,
        status=STATUS.get(status, f"IPOPT status {status}"),
        iterations=iterations,
        solve_time=time.perf_counter() - start,
    )


def _bounds(prog: MathematicalProgram) -> tuple[np.ndarray, np.ndarray]:
    lower, upper = np.full(prog.num_vars(), -np.inf), np.full(prog.num_vars(), np.inf)
    for binding in prog.bounding_box_constraints():
        indices = prog.FindDecisionVariableIndices(binding.variables())
        np.maximum.at(lower, indices, binding.evaluator().lower_bound())
        np.minimum.at(upper, indices, binding.evaluator().upper_bound())
    return lower, upper


class _QuadraticCost:
    """½ xᵀ Q x + bᵀ x + c over all variables, Q by its nonzeros."""

    def __init__(self, prog: MathematicalProgram):
        self._b, self._c = np.zeros(prog.num_vars()), 0.0
        rows, columns, values = [], [], []
        for binding in [*prog.quadratic_costs(), *prog.linear_costs()]:
            evaluator = binding.evaluator()
            indices = np.array(prog.FindDecisionVariableIndices(binding.variables()))
            linear = evaluator.b() if hasattr(evaluator, "Q") else evaluator.a()
            np.add.at(self._b, indices, linear)
            self._c += evaluator.c() if hasattr(evaluator, "Q") else evaluator.b()
            if hasattr(evaluator, "Q"):
                Q = evaluator.Q()
                row, column = np.nonzero(Q)
                rows.append(indices[row])
                columns.append(indices[column])
                values.append(Q[row, column])
        self.rows, self.columns = _concatenate(rows, int), _concatenate(columns, int)
        self.values = _concatenate(values)

    def evaluate(self, x: np.ndarray) -> float:
        return float(0.5 * x @ self._times(x) + self._b @ x + self._c)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return self._times(x) + self._b

    def _times(self, x: np.ndarray) -> np.ndarray:
        products = self.values * x[self.columns]
        return np.bincount(self.rows, weights=products, minlength=len(x))


def _concatenate(arrays: Sequence[np.ndarray], dtype=float) -> np.ndarray:
    return np.concatenate([np.zeros(0, dtype), *arrays])
