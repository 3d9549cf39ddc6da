"""The convex program about a point of a quasi-static program, solved by Clarabel."""

import time
from typing import Any

import numpy as np
import scipy.sparse
from pydrake.solvers import (
    ClarabelSolver,
    LinearEqualityConstraint,
    MathematicalProgram,
    MathematicalProgramResult,
    SolverOptions,
)

from planners.transcription.ipopt import bounds_of_variables
from planners.transcription.program import PlanProgram
from planners.transcription.solving import Solution

# A start keeps some distance from its bounds, from where a solver goes on in fewer iterations.
CLARABEL_START_OPTIONS: dict[str, Any] = {
    "tol_gap_abs": 1e-5,
    "tol_gap_rel": 1e-5,
    "tol_feas": 1e-5,
    "iterative_refinement_enable": 0,
}


class LinearizedProgram:
    """A program whose ``cheap_blocks``, or ``blocks`` if there are none, are linearized.

    It shares the costs and the linear constraints with the program, so that an update of the
    program updates both. Variables that nothing depends on, such as fixed time steps, are left out.

    Args:
        program: program without other nonlinear constraints.
    """

    def __init__(self, program: PlanProgram):
        prog = program.prog
        self._blocks = program.cheap_blocks or program.blocks
        self._whole = prog
        self._scales = program.scales
        self._num_rows = np.cumsum([0, *(len(block.lower) for block in self._blocks)])
        costs = prog.GetAllCosts()
        self._linear = [*prog.linear_constraints(), *prog.linear_equality_constraints()]
        # Find the variables that count.
        self._is_used = np.zeros(prog.num_vars(), bool)
        for block in self._blocks:
            self._is_used[block.columns] = True
        for binding in (*costs, *self._linear):
            self._is_used[prog.FindDecisionVariableIndices(binding.variables())] = True
        # Share all terms but the blocks and the bounds.
        self._prog = MathematicalProgram()
        variables = prog.decision_variables()[self._is_used]
        self._prog.AddDecisionVariables(variables)
        for cost in costs:
            self._prog.AddCost(cost)
        for constraint in self._linear:
            self._prog.AddConstraint(constraint)
        # Add bounds and equations, whose values `solve` sets.
        free = np.full(len(variables), np.inf)
        no_slopes = scipy.sparse.csc_matrix((self._num_rows[-1], len(variables)))
        equations = LinearEqualityConstraint(no_slopes, np.zeros(self._num_rows[-1]))
        self._bounds = self._prog.AddBoundingBoxConstraint(-free, free, variables)
        self._equations = self._prog.AddConstraint(equations, variables)

    def solve(
        self, x: np.ndarray, *, is_start: bool = False, with_multipliers: bool = True
    ) -> Solution | None:
        """Return the solution with the blocks linearized about x; None if infeasible.

        Variables that nothing depends on keep their values in x.

        Args:
            x: all decision variables.
            is_start: whether it is the start of another program, and need not be accurate.
            with_multipliers: whether the multipliers are needed; Drake takes some ms for them.
        """
        started = time.perf_counter()
        # Linearize the blocks.
        rows = []
        for block, first_row in zip(self._blocks, self._num_rows[:-1], strict=True):
            rows.append(first_row + block.rows)
        columns = [block.columns for block in self._blocks]
        slopes = [block.jacobian(x) for block in self._blocks]
        places = np.concatenate(rows), np.concatenate(columns)
        shape = self._num_rows[-1], len(x)
        jacobian = scipy.sparse.csc_matrix((np.concatenate(slopes), places), shape)
        jacobian.eliminate_zeros()
        ends = jacobian @ x - np.concatenate([block.evaluate(x) for block in self._blocks])
        # Set the equations and the bounds.
        self._equations.evaluator().UpdateCoefficients(jacobian[:, self._is_used], ends)
        lower, upper = bounds_of_variables(self._whole)
        self._bounds.evaluator().set_bounds(lower[self._is_used], upper[self._is_used])
        # Solve the program.
        options = SolverOptions()
        for name, value in CLARABEL_START_OPTIONS.items() if is_start else ():
            options.SetOption(ClarabelSolver.id(), name, value)
        result = ClarabelSolver().Solve(self._prog, None, options)
        if not result.is_success():
            return None
        solution = x.copy()
        solution[self._is_used] = result.get_x_val()
        return Solution(
            x=solution,
            cost=result.get_optimal_cost(),
            iterations=result.get_solver_details().iterations,
            solve_time=time.perf_counter() - started,
            solver="Clarabel",
            status="solved",
            multipliers=self._multipliers(result) if with_multipliers else None,
        )

    def _multipliers(self, result: MathematicalProgramResult) -> tuple[np.ndarray, np.ndarray]:
        """Return the multipliers of a `Solution`, of the constraints and of the bounds."""
        # Drake's multipliers are derivatives of the cost by the bounds; IPOPT has the other sign.
        in_order = [self._equations, *self._linear]
        of_rows = [-result.GetDualSolution(binding) for binding in in_order]
        of_bounds = np.zeros(len(self._is_used))
        of_bounds[self._is_used] = -result.GetDualSolution(self._bounds)
        return np.concatenate(of_rows), of_bounds * self._scales
