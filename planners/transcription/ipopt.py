"""IPOPT with exact Hessians, for Drake programs.

Drake's `IpoptSolver` gives IPOPT a limited-memory Hessian and ignores the program's variable
scaling. `ExactHessianIpoptSolver` gives it the Hessian of the Lagrangian and scaled variables.
"""

import contextlib
import dataclasses
import functools
import os
import signal
import threading
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any, Protocol

import casadi as ca
import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import (
    Binding,
    EvaluatorBase,
    IpoptSolver,
    MathematicalProgram,
    SolutionResult,
    SolverOptions,
)

INTERRUPT_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # whose handlers may end a solve
OPTIONS = {
    "mu_strategy": "adaptive",
    # For an objective that is scaled to at most 100. A tenth of this value makes costs ten times
    # better, which are right to 5e-5 or better, and takes up to 4 iterations more.
    "tol": 1e-5,
    # Links in a row amplify residual defects of the dynamics: with 1e-10, the defects of some plans
    # with nonlinear torque were larger than their check allows.
    "constr_viol_tol": 1e-12,
    # With relaxed bounds, the projection onto them at the end moves temperatures by 1e-6 °C,
    # too far for stiff accelerations.
    "bound_relax_factor": 0.0,
    "nlp_scaling_method": "none",  # variables, rows and objective come scaled
    "min_refinement_steps": 0,  # of linear systems; IPOPT refines where they need it
    "mumps_permuting_scaling": 0,
    "mumps_scaling": 0,
    # % of memory beyond the estimate of MUMPS; with IPOPT's default, 1000, a solution takes longer.
    "mumps_mem_percent": 100,
    "mumps_pivot_order": 2,  # approximate minimum fill: a quarter less time than the default
    "max_iter": 300,
    "print_level": 0,
    "sb": "yes",
}

WARM_START_OPTIONS = {
    "warm_start_init_point": "yes",
    "warm_start_bound_push": 1e-9,
    "warm_start_mult_bound_push": 1e-9,
    "mu_init": 1e-7,
    "mu_strategy": "monotone",
}

INFEASIBLE_STATUS = "infeasible problem detected"
RESULT_BY_STATUS = {  # words and Drake's result, by the name that IPOPT returns
    "Solve_Succeeded": ("solved", SolutionResult.kSolutionFound),
    "Infeasible_Problem_Detected": (INFEASIBLE_STATUS, SolutionResult.kInfeasibleConstraints),
    "Maximum_Iterations_Exceeded": (
        "maximum number of iterations exceeded",
        SolutionResult.kIterationLimit,
    ),
    "Maximum_CpuTime_Exceeded": ("maximum CPU time exceeded", SolutionResult.kSolverSpecificError),
    "Invalid_Problem_Definition": ("invalid problem definition", SolutionResult.kInvalidInput),
}


@functools.cache
def _load_ipopt() -> None:
    """Load CasADi's IPOPT with one thread for its matrices, which are small.

    Its BLAS reads the number of its threads when it is loaded; further threads would only wait.
    """
    name = "OPENBLAS_NUM_THREADS"
    number = os.environ.get("OPENBLAS_NUM_THREADS")
    os.environ[name] = "1"
    try:
        ca.load_nlpsol("ipopt")
    finally:
        del os.environ[name]
        if number is not None:
            os.environ[name] = number


class ConstraintBlock(Protocol):
    """Constraints lower <= g(x) <= upper that are evaluated together.

    - ``lower``, ``upper``: (m,).
    - ``replaces``: the program's constraints that they replace.
    """

    lower: np.ndarray
    upper: np.ndarray
    replaces: Collection[Binding]

    @property
    def rows(self) -> np.ndarray:
        """Rows of the Jacobian's nonzeros."""

    @property
    def columns(self) -> np.ndarray:
        """Columns of the Jacobian's nonzeros."""

    @property
    def hessian_rows(self) -> np.ndarray:
        """Rows of the nonzeros of the Hessian of λᵀ g, of its lower triangle alone.

        Values of the same place, or of its mirror image, add up.
        """

    @property
    def hessian_columns(self) -> np.ndarray:
        """Columns of these nonzeros."""

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        """Return g(x) (m,)."""

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the nonzeros of dg/dx, in the order of ``columns``."""

    def hessian(self, x: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return the nonzeros of the Hessian of multipliers · g."""


@dataclasses.dataclass
class IpoptDetails:
    """IPOPT's status in words, iterations, and time, s.

    - ``multipliers``: multipliers of the scaled constraints and of the bounds of variables, for the
      cost as it is.
    """

    status: str
    iterations: int
    solve_time: float
    multipliers: tuple[np.ndarray, np.ndarray]


@dataclasses.dataclass(frozen=True, eq=False)
class IpoptResult:
    """The result of `ExactHessianIpoptSolver`, as Drake's MathematicalProgramResult."""

    _prog: MathematicalProgram
    _x: np.ndarray
    _cost: float
    _solution_result: SolutionResult
    _details: IpoptDetails

    def is_success(self) -> bool:
        return self._solution_result == SolutionResult.kSolutionFound

    def get_solution_result(self) -> SolutionResult:
        return self._solution_result

    def get_optimal_cost(self) -> float:
        return self._cost

    def get_x_val(self) -> np.ndarray:
        return self._x

    def get_solver_details(self) -> IpoptDetails:
        return self._details

    def GetSolution(self, variables: np.ndarray) -> np.ndarray:
        """Return the values of an array of decision variables, in its shape."""
        variables = np.asarray(variables)
        indices = self._prog.FindDecisionVariableIndices(variables.ravel())
        return self._x[indices].reshape(variables.shape)


class ExactHessianIpoptSolver:
    """A solver for programs of any smooth costs and constraints, IPOPT.

    It is used as Drake's own solvers are: ``Solve(prog, initial_guess)``. Bounds, linear and
    quadratic terms are read from the program, all other terms are evaluated with AutoDiff.
    Ctrl-C raises KeyboardInterrupt after the current iteration, whatever its point.

    Args:
        blocks: constraints in addition to the program's. A block stands in place of the
            program's constraints that it ``replaces``, up to a scaling of the rows.
        fixed: indices of variables that keep their initial values.
        scales: typical changes of the variables (num_vars,), by which they are scaled; those of
            the program's `SetVariableScaling` if None.
        on_iteration: function that is called with iteration, cost and constraint violation.
    """

    def __init__(
        self,
        *,
        blocks: Sequence[ConstraintBlock] = (),
        fixed: ArrayLike = (),
        scales: np.ndarray | None = None,
        on_iteration: Callable[[int, float, float], None] | None = None,
    ):
        self._blocks = blocks
        self._fixed = np.array(fixed, int)
        self._scales = scales
        self._on_iteration = on_iteration

    def Solve(
        self,
        prog: MathematicalProgram,
        initial_guess: np.ndarray | None = None,
        solver_options: SolverOptions | None = None,
        *,
        multipliers: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> IpoptResult:
        """Solve a program.

        Args:
            initial_guess: values of all decision variables, (num_vars,); by default the program's.
            solver_options: options for `IpoptSolver.id()` go over this module's ``OPTIONS``.
            multipliers: multipliers of a neighbouring solution, for a warm start.

        Raises:
            ValueError: if the program has constraints that are not smooth, such as cones.
        """
        guess = prog.initial_guess() if initial_guess is None else np.asarray(initial_guess)
        guess = np.nan_to_num(guess)
        scales = self._scales
        if scales is None:
            scales = scales_of_variables(prog, np.ones(prog.num_vars()))
        problem = _ScaledProblem(prog, guess, self._blocks, self._fixed, scales, self._on_iteration)
        # Choose the options.
        options = dict(OPTIONS)
        if solver_options is not None:
            options |= solver_options.options.get(IpoptSolver.id().name(), {})
        if multipliers is not None:
            options |= WARM_START_OPTIONS
        # Solve, unless a signal or an error of a function ends it.
        start = time.perf_counter()
        with _interruptible(problem):
            y, status, multipliers = problem.solve(options, multipliers)
        if problem.raised is not None:
            raise problem.raised
        # Scale back, without rounding beyond the bounds.
        x = np.clip(problem.scale * y, problem.lower, problem.upper)
        other = status.replace("_", " ").lower(), SolutionResult.kSolverSpecificError
        words, outcome = RESULT_BY_STATUS.get(status, other)
        details = IpoptDetails(
            status=words,
            iterations=problem.iterations,
            solve_time=time.perf_counter() - start,
            multipliers=multipliers,
        )
        return IpoptResult(prog, x, problem.cost.evaluate(x), outcome, details)


class _Function(ca.Callback):
    """A function of numpy arrays, as CasADi calls it.

    Args:
        problem: problem that keeps the error that the function raises.
        function: called with the nonzeros of its inputs, and with the arrays to write to; each of
            these is None where it is not asked for.
        inputs, outputs: their sparsities.
    """

    def __init__(
        self,
        problem: "_ScaledProblem",
        function: Callable[..., None],
        inputs: Sequence[ca.Sparsity],
        outputs: Sequence[ca.Sparsity],
    ):
        super().__init__()
        self._problem = problem
        self._function = function
        self._inputs = inputs
        self._outputs = outputs
        self.construct(function.__name__.strip("_"), {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_sparsity_in(self, index: int) -> ca.Sparsity:
        return self._inputs[index]

    def get_sparsity_out(self, index: int) -> ca.Sparsity:
        return self._outputs[index]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, inputs: Sequence[Any], outputs: Sequence[Any]) -> int:
        arrays = [None if of is None else np.frombuffer(of) for of in (*inputs, *outputs)]
        try:
            self._function(*arrays)
        except BaseException as error:  # CasADi would print it and go on
            self._problem.raised = error
        return int(self._problem.raised is not None)


class _SparsePattern:
    """The places of a sparse matrix's nonzeros in CasADi's order, column by column.

    Nonzeros at the same place add up.

    - ``sparsity``: the places.

    Args:
        shape: of the matrix.
        rows, columns: of each nonzero.
    """

    def __init__(self, shape: tuple[int, int], rows: np.ndarray, columns: np.ndarray):
        short = np.min_scalar_type(max(shape))  # sorting short integers is fast
        self._order = order = np.lexsort((rows.astype(short), columns.astype(short)))
        rows = rows[order]
        columns = columns[order]
        is_new = np.ones(len(order), bool)
        is_new[1:] = (np.diff(rows) != 0) | (np.diff(columns) != 0)
        self._starts = np.flatnonzero(is_new)
        self._has_sums = len(self._starts) < len(order)
        ends = np.cumsum(np.bincount(columns[is_new], minlength=shape[1]))
        self.sparsity = ca.Sparsity(*shape, [0, *ends.tolist()], rows[is_new].tolist())

    def fill(self, values: np.ndarray, out: np.ndarray) -> None:
        """Write the values of the nonzeros in CasADi's order."""
        if self._has_sums:
            np.add.reduceat(values[self._order], self._starts, out=out)
        else:
            np.take(values, self._order, out=out)


class _StackedEvaluators:
    """Costs or constraints of a program, stack_limbs, evaluated by Drake's AutoDiff.

    - ``size``: number of their values.
    - ``rows``, ``columns``: places of the Jacobian's nonzeros.
    - ``hessian_rows``, ``hessian_columns``: places in the Hessian's lower triangle.
    """

    def __init__(self, prog: MathematicalProgram, bindings: Sequence[Binding]):
        # Pairs of an evaluator and the indices of its variables.
        self._parts: list[tuple[EvaluatorBase, np.ndarray]] = []
        for binding in bindings:
            indices = np.array(prog.FindDecisionVariableIndices(binding.variables()))
            self._parts.append((binding.evaluator(), indices))
        sizes = [evaluator.num_outputs() for evaluator, _ in self._parts]
        self.size = sum(sizes)
        self._ends = np.cumsum(sizes)[:-1]
        # The Jacobian of each part is dense, and so is its Hessian.
        rows, columns, hessian_rows, hessian_columns = [], [], [], []
        start = 0
        for size, (_, indices) in zip(sizes, self._parts, strict=True):
            rows.append(np.repeat(np.arange(start, start + size), len(indices)))
            columns.append(np.tile(indices, size))
            pairs = indices[np.array(np.tril_indices(len(indices)))]
            hessian_rows.append(pairs.max(axis=0))
            hessian_columns.append(pairs.min(axis=0))
            start += size
        self.rows = _concatenate(rows, int)
        self.columns = _concatenate(columns, int)
        self.hessian_rows = _concatenate(hessian_rows, int)
        self.hessian_columns = _concatenate(hessian_columns, int)

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        return _concatenate([evaluator.Eval(x[indices]) for evaluator, indices in self._parts])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        gradients = [gradient_of(evaluator, x[indices]) for evaluator, indices in self._parts]
        return _concatenate([gradient.ravel() for gradient in gradients])

    def hessian(self, x: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        weights = np.split(multipliers, self._ends)
        return _concatenate(
            [
                _weighted_hessian(evaluator, x[indices], weight)
                for (evaluator, indices), weight in zip(self._parts, weights, strict=False)
            ]
        )


class _GenericConstraints(_StackedEvaluators):
    """Constraints of a program as a `ConstraintBlock`."""

    replaces: Collection[Binding] = ()

    def __init__(self, prog: MathematicalProgram, bindings: Sequence[Binding]):
        super().__init__(prog, bindings)
        self.lower = _concatenate([evaluator.lower_bound() for evaluator, _ in self._parts])
        self.upper = _concatenate([evaluator.upper_bound() for evaluator, _ in self._parts])


class _LinearConstraints:
    """Linear constraints of a program as one sparse product.

    - ``matrix``: A (m, num_vars).
    - ``lower``, ``upper``: bounds of A x (m,).
    """

    def __init__(self, prog: MathematicalProgram, bindings: Sequence[Binding]):
        rows = []
        columns = []
        values = []
        lower = []
        upper = []
        size = 0
        for binding in bindings:
            evaluator = binding.evaluator()
            indices = np.array(prog.FindDecisionVariableIndices(binding.variables()), int)
            part = evaluator.get_sparse_A().tocoo()
            rows.append(size + part.row)
            columns.append(indices[part.col])
            values.append(part.data)
            lower.append(evaluator.lower_bound())
            upper.append(evaluator.upper_bound())
            size += part.shape[0]
        places = _concatenate(rows, int), _concatenate(columns, int)
        shape = size, prog.num_vars()
        self.matrix = scipy.sparse.coo_array((_concatenate(values), places), shape)
        self.lower = _concatenate(lower)
        self.upper = _concatenate(upper)


class _ScaledProblem:
    """A program in IPOPT's form: y = x / scale, the objective of size 100."""

    def __init__(self, prog, guess, blocks, fixed, scales, on_iteration):
        # Read the constraints: linear ones, blocks, and others.
        linear = [*prog.linear_constraints(), *prog.linear_equality_constraints()]
        curved = [
            *prog.generic_constraints(),
            *prog.quadratic_constraints(),
            *prog.lorentz_cone_constraints(),
            *prog.rotated_lorentz_cone_constraints(),
        ]
        num_bounds = len(prog.bounding_box_constraints())
        if len(linear) + len(curved) + num_bounds != len(prog.GetAllConstraints()):
            raise ValueError(
                "This solver takes bounds, linear, quadratic and generic constraints and Lorentz "
                "cones; the program has others."
            )
        self._linear = _LinearConstraints(prog, linear)
        replaced = {binding for block in blocks for binding in block.replaces}
        others = _GenericConstraints(prog, [b for b in curved if b not in replaced])
        self._curved: list[ConstraintBlock] = [others, *blocks]
        self._in_order: list[Any] = [*self._curved, self._linear]
        self._g_lower = np.concatenate([block.lower for block in self._in_order])
        self._g_upper = np.concatenate([block.upper for block in self._in_order])

        # Scale variables and objective.
        self.cost = _Cost(prog)
        self.lower, self.upper = bounds_of_variables(prog)
        # A given initial value goes before the guess, which may be of an earlier plan.
        kept = np.clip(guess[fixed], self.lower[fixed], self.upper[fixed])
        self.lower[fixed] = kept
        self.upper[fixed] = kept
        self.scale = scales
        guess = np.clip(guess, self.lower, self.upper)
        self._cost_scale = min(1.0, 100.0 / max(abs(self.cost.evaluate(guess)), 1e-9))
        self._guess = guess / self.scale

        # Places of the Jacobian's nonzeros, block by block.
        self._starts = np.cumsum([0, *(len(block.lower) for block in self._in_order)])
        rows = [b.rows + start for start, b in zip(self._starts, self._curved, strict=False)]
        matrix = self._linear.matrix
        self._rows = np.concatenate([*rows, matrix.row + self._starts[-2]])
        self._columns = np.concatenate([*(block.columns for block in self._curved), matrix.col])
        self._jacobian_scale = self.scale[self._columns]

        # Places of the nonzeros of the Hessian's lower triangle.
        rows = [self.cost.rows]
        columns = [self.cost.columns]
        for block in self._curved:
            rows.append(np.maximum(block.hessian_rows, block.hessian_columns))
            columns.append(np.minimum(block.hessian_rows, block.hessian_columns))
        self._hessian_rows = np.concatenate(rows)
        self._hessian_columns = np.concatenate(columns)
        self._hessian_scale = self.scale[self._hessian_rows] * self.scale[self._hessian_columns]

        self._on_iteration = on_iteration
        self.iterations = 0
        # By a function of the program or a signal's handler.
        self.raised: BaseException | None = None

    def solve(self, options, multipliers):
        """Return the best y, IPOPT's status, and the multipliers of constraints and bounds."""
        _load_ipopt()
        # Sparsities of all functions.
        n, m = len(self.scale), len(self._g_lower)
        self._jacobian_pattern = _SparsePattern((m, n), self._rows, self._columns)
        # CasADi expects the upper triangle.
        self._hessian_pattern = _SparsePattern((n, n), self._hessian_columns, self._hessian_rows)
        jacobian = self._jacobian_pattern.sparsity
        hessian = self._hessian_pattern.sparsity
        dense = ca.Sparsity.dense
        one, y, g, none = dense(1), dense(n), dense(m), ca.Sparsity(0, 0)

        # The functions, with names, because CasADi does not keep Python's objects alive.
        cost = _Function(self, self._cost, [y, none], [one])
        constraints = _Function(self, self._constraints, [y, none], [g])
        derivatives = {
            "grad_f": _Function(self, self._cost_gradient, [y, none], [one, y]),
            "jac_g": _Function(self, self._jacobian, [y, none], [g, jacobian]),
            "hess_lag": _Function(self, self._hessian, [y, none, one, g], [hessian]),
        }
        after = _Function(self, self._after_iteration, [y, one, g, y, g, none], [one])
        variables = ca.MX.sym("y", n)
        no_parameters = ca.MX(0, 0)
        solver = ca.nlpsol(
            "solver",
            "ipopt",
            {
                "x": variables,
                "f": cost(variables, no_parameters),
                "g": constraints(variables, no_parameters),
            },
            {
                **derivatives,
                "iteration_callback": after,
                "no_nlp_grad": True,
                "print_time": False,
                "show_eval_warnings": False,
                "ipopt": options,
            },
        )

        # Solve, with multipliers of the scaled cost.
        constraint_multipliers, bound_multipliers = multipliers or (np.zeros(m), np.zeros(n))
        solution = solver(
            x0=self._guess,
            lam_g0=self._cost_scale * constraint_multipliers,
            lam_x0=self._cost_scale * bound_multipliers,
            lbx=self.lower / self.scale,
            ubx=self.upper / self.scale,
            lbg=self._g_lower,
            ubg=self._g_upper,
        )
        statistics = solver.stats()
        self.iterations = statistics["iter_count"]
        constraint_multipliers = solution["lam_g"].full().ravel() / self._cost_scale
        bound_multipliers = solution["lam_x"].full().ravel() / self._cost_scale
        best = solution["x"].full().ravel()
        return best, statistics["return_status"], (constraint_multipliers, bound_multipliers)

    def _cost(self, y, _, cost):
        cost[:] = self._cost_scale * self.cost.evaluate(self.scale * y)

    def _cost_gradient(self, y, _, cost, gradient):
        if cost is not None:
            self._cost(y, _, cost)
        if gradient is not None:
            gradient[:] = self._cost_scale * self.scale * self.cost.gradient(self.scale * y)

    def _constraints(self, y, _, values):
        x = self.scale * y
        linear = self._linear.matrix @ x
        np.concatenate([*(block.evaluate(x) for block in self._curved), linear], out=values)

    def _jacobian(self, y, _, values, jacobian):
        if values is not None:
            self._constraints(y, _, values)
        if jacobian is not None:
            x = self.scale * y
            parts = [*(block.jacobian(x) for block in self._curved), self._linear.matrix.data]
            nonzeros = np.concatenate(parts) * self._jacobian_scale
            self._jacobian_pattern.fill(nonzeros, jacobian)

    def _hessian(self, y, _, cost_factor, multipliers, hessian):
        x = self.scale * y
        parts = [cost_factor[0] * self._cost_scale * self.cost.hessian(x)]
        for block, start in zip(self._curved, self._starts, strict=False):
            parts.append(block.hessian(x, multipliers[start : start + len(block.lower)]))
        nonzeros = np.concatenate(parts) * self._hessian_scale
        self._hessian_pattern.fill(nonzeros, hessian)

    def _after_iteration(self, _y, cost, values, *_):
        if self._on_iteration:
            missed = np.maximum(self._g_lower - values, values - self._g_upper)
            violation = float(missed.max(initial=0.0))
            self._on_iteration(self.iterations, float(cost[0]) / self._cost_scale, violation)
        self.iterations += 1


class _Cost:
    """All costs of a program: ½ xᵀ Q x + bᵀ x + c, Q by its nonzeros, and generic ones.

    - ``rows``, ``columns``: places of the nonzeros of the Hessian's lower triangle.
    """

    def __init__(self, prog: MathematicalProgram):
        # Sum quadratic and linear costs.
        self._b = np.zeros(prog.num_vars())
        self._c = 0.0
        rows = []
        columns = []
        values = []
        for binding in prog.quadratic_costs():
            evaluator = binding.evaluator()
            indices = np.array(prog.FindDecisionVariableIndices(binding.variables()))
            Q = evaluator.Q()
            row, column = Q.nonzero()
            rows.append(indices[row])
            columns.append(indices[column])
            values.append(Q[row, column])
            np.add.at(self._b, indices, evaluator.b())
            self._c += evaluator.c()
        for binding in prog.linear_costs():
            indices = prog.FindDecisionVariableIndices(binding.variables())
            np.add.at(self._b, indices, binding.evaluator().a())
            self._c += binding.evaluator().b()
        self._rows = _concatenate(rows, int)
        self._columns = _concatenate(columns, int)
        self._values = _concatenate(values)
        # Generic costs, whose Hessians follow in the lower triangle.
        generic = _StackedEvaluators(prog, [*prog.generic_costs(), *prog.l2norm_costs()])
        self._generic = generic
        self._triangle = self._rows >= self._columns
        self.rows = np.append(self._rows[self._triangle], generic.hessian_rows)
        self.columns = np.append(self._columns[self._triangle], generic.hessian_columns)

    def evaluate(self, x: np.ndarray) -> float:
        # No dot product of BLAS, because its threads may stall on busy machines.
        quadratic = (x * (0.5 * self._times(x) + self._b)).sum() + self._c
        return float(quadratic + self._generic.evaluate(x).sum())

    def gradient(self, x: np.ndarray) -> np.ndarray:
        gradient = self._times(x) + self._b
        np.add.at(gradient, self._generic.columns, self._generic.jacobian(x))
        return gradient

    def hessian(self, x: np.ndarray) -> np.ndarray:
        generic = self._generic.hessian(x, np.ones(self._generic.size))
        return np.append(self._values[self._triangle], generic)

    def _times(self, x: np.ndarray) -> np.ndarray:
        products = self._values * x[self._columns]
        return np.bincount(self._rows, weights=products, minlength=len(x))


@contextlib.contextmanager
def _interruptible(problem: _ScaledProblem) -> Iterator[None]:
    """End IPOPT after the current iteration if a signal's handler raises an error; keep it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # Replace the handlers of Python functions.
    handlers: dict[int, Any] = {}
    for interrupt in INTERRUPT_SIGNALS:
        handler = signal.getsignal(interrupt)
        if callable(handler):
            handlers[interrupt] = handler

    def keep_error(number, frame):
        try:
            handlers[number](number, frame)
        except BaseException as error:
            problem.raised = error

    for number in handlers:
        signal.signal(number, keep_error)
    # Restore them after the solve.
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def bounds_of_variables(prog: MathematicalProgram) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper bounds of all decision variables (num_vars,)."""
    lower = np.full(prog.num_vars(), -np.inf)
    upper = np.full(prog.num_vars(), np.inf)
    for binding in prog.bounding_box_constraints():
        indices = prog.FindDecisionVariableIndices(binding.variables())
        np.maximum.at(lower, indices, binding.evaluator().lower_bound())
        np.minimum.at(upper, indices, binding.evaluator().upper_bound())
    return lower, upper


def scales_of_variables(prog: MathematicalProgram, scales: np.ndarray) -> np.ndarray:
    """Return the scales (num_vars,) of decision variables, with those set in the program."""
    scales = scales.copy()
    for index, scale in prog.GetVariableScaling().items():
        scales[index] = scale
    return scales


def gradient_of(evaluator: EvaluatorBase, x: np.ndarray) -> np.ndarray:
    """Return the gradient (rows, variables); zero if the evaluator depends on no variable."""
    values = evaluator.Eval(InitializeAutoDiff(x)[:, 0])
    gradient = ExtractGradient(values)
    return gradient if gradient.size else np.zeros((len(ExtractValue(values)), len(x)))


def _weighted_hessian(evaluator, x: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the lower triangle of the Hessian of weights · evaluator, by gradient differences."""
    hessian = np.empty((len(x), len(x)))
    for index, value in enumerate(x):
        step = np.zeros(len(x))
        step[index] = 1e-5 * max(1.0, abs(value))
        change = gradient_of(evaluator, x + step) - gradient_of(evaluator, x - step)
        hessian[index] = weights @ change / (2 * step[index])
    return (0.5 * (hessian + hessian.T))[np.tril_indices(len(x))]


def _concatenate(arrays: Sequence[np.ndarray], dtype=float) -> np.ndarray:
    return np.concatenate([np.zeros(0, dtype), *arrays])
