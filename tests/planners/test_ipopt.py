"""The IPOPT front end on problems with known solutions."""

import os
import signal

import numpy as np
import pytest
from pydrake.solvers import MathematicalProgram

from planners import ExactHessianIpoptSolver


def nearest_point_on_circle():
    """min |x - (2, 1)|² on the unit circle: (2, 1)/√5, at distance √5 - 1."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2)
    prog.AddQuadraticErrorCost(np.eye(2), [2.0, 1.0], x)
    prog.AddConstraint(x[0] ** 2 + x[1] ** 2 == 1.0)
    return prog, x


@pytest.mark.parametrize("scales", [(1.0, 1.0), (50.0, 0.01)])
def test_nonlinear_constraint_is_met_at_the_known_optimum_with_any_scaling(scales):
    prog, x = nearest_point_on_circle()
    for variable, scale in zip(x, scales, strict=True):
        prog.SetVariableScaling(variable, scale)
    solution = ExactHessianIpoptSolver().Solve(prog, np.array([0.5, 0.5]))
    assert solution.is_success()
    np.testing.assert_allclose(solution.get_x_val(), np.array([2.0, 1.0]) / np.sqrt(5), atol=1e-4)
    assert solution.get_optimal_cost() == pytest.approx((np.sqrt(5) - 1) ** 2, rel=1e-6)


def test_infeasible_program_is_no_success():
    prog, x = nearest_point_on_circle()
    prog.AddBoundingBoxConstraint(2.0, 3.0, x)
    solution = ExactHessianIpoptSolver().Solve(prog, np.array([2.5, 2.5]))
    assert not solution.is_success()
    status = solution.get_solver_details().status
    assert "infeasible" in status or "failed" in status


def test_a_linear_cost_needs_the_curvature_of_its_constraint():
    """max x + y on the unit circle: a linear cost, all curvature in the constraint."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2)
    prog.AddLinearCost(-x[0] - x[1])
    prog.AddConstraint(x[0] ** 2 + x[1] ** 2 == 1.0)
    result = ExactHessianIpoptSolver().Solve(prog, np.array([0.9, 0.1]))
    assert result.is_success()
    np.testing.assert_allclose(result.get_x_val(), np.full(2, np.sqrt(0.5)), atol=1e-5)
    assert result.get_solver_details().iterations < 15


def test_a_signal_at_a_feasible_point_raises_the_error_of_its_handler():
    for number in [signal.SIGINT, signal.SIGTERM]:
        prog, _ = nearest_point_on_circle()
        feasible = []

        def interrupt(_iteration, _cost, violation):
            if violation < 1e-9:
                feasible.append(violation)
                os.kill(os.getpid(), number)

        def handler(*_):
            raise KeyboardInterrupt

        before = signal.signal(number, handler)
        try:
            with pytest.raises(KeyboardInterrupt):
                ExactHessianIpoptSolver(on_iteration=interrupt).Solve(prog, np.array([-0.5, 0.8]))
            assert len(feasible) == 1
            assert signal.getsignal(number) is handler
        finally:
            signal.signal(number, before)


def test_an_error_in_a_custom_constraint_is_raised_unchanged():
    prog, x = nearest_point_on_circle()

    def broken(_):
        raise ZeroDivisionError("of one's own")

    prog.AddConstraint(broken, [-1.0], [1.0], vars=x)
    with pytest.raises(ZeroDivisionError, match="of one's own"):
        ExactHessianIpoptSolver().Solve(prog, np.array([0.5, 0.5]))
