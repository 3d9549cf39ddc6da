"""The Gauss-Newton IPOPT front end on problems with known solutions."""

import numpy as np
import pytest
from pydrake.solvers import MathematicalProgram, SnoptSolver

from planners import ipopt


def nearest_point_on_circle():
    """min |x - (2, 1)|² on the unit circle: (2, 1)/√5, at distance √5 - 1."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2)
    prog.AddQuadraticErrorCost(np.eye(2), [2.0, 1.0], x)
    prog.AddConstraint(x[0] ** 2 + x[1] ** 2 == 1.0)
    return prog, x


def test_nonlinear_constraint_is_met_at_the_known_optimum():
    prog, _ = nearest_point_on_circle()
    solution = ipopt.solve(prog, np.array([0.5, 0.5]))
    assert solution.success
    np.testing.assert_allclose(solution.x, np.array([2.0, 1.0]) / np.sqrt(5), atol=1e-4)
    assert solution.cost == pytest.approx((np.sqrt(5) - 1) ** 2, rel=1e-6)


def test_scaling_of_variables_does_not_move_the_optimum():
    prog, x = nearest_point_on_circle()
    prog.SetVariableScaling(x[0], 50.0)
    prog.SetVariableScaling(x[1], 0.01)
    solution = ipopt.solve(prog, np.array([0.5, 0.5]))
    assert solution.success
    np.testing.assert_allclose(solution.x, np.array([2.0, 1.0]) / np.sqrt(5), atol=1e-4)


def test_linear_constraints_bounds_and_linear_costs():
    """min x² + y² - 4x, x + y = 1, y >= 0.25: the bound is active, x = 0.75."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2)
    prog.AddQuadraticCost(x[0] ** 2 + x[1] ** 2)
    prog.AddLinearCost(-4 * x[0] + 3.0)
    prog.AddLinearConstraint(x[0] + x[1] == 1.0)
    prog.AddBoundingBoxConstraint(0.25, np.inf, x[1])
    solution = ipopt.solve(prog, np.zeros(2))
    assert solution.success
    np.testing.assert_allclose(solution.x, [0.75, 0.25], atol=1e-4)
    assert solution.cost == pytest.approx(0.75**2 + 0.25**2 - 3.0 + 3.0, abs=1e-4)


def test_infeasible_program_is_no_success():
    prog, x = nearest_point_on_circle()
    prog.AddBoundingBoxConstraint(2.0, 3.0, x)
    solution = ipopt.solve(prog, np.array([2.5, 2.5]))
    assert not solution.success
    assert "infeasible" in solution.status or "failed" in solution.status


def test_costs_of_other_kinds_are_refused():
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(1)
    prog.AddCost(lambda z: z[0] ** 4, vars=x)
    with pytest.raises(ValueError, match="quadratic and linear costs"):
        ipopt.solve(prog, np.zeros(1))


def test_agrees_with_snopt_on_a_random_nonlinear_program():
    generator = np.random.default_rng(5)
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(6)
    root = generator.normal(size=(6, 6))
    prog.AddQuadraticCost(root @ root.T + np.eye(6), generator.normal(size=6), x)
    prog.AddConstraint(x[0] * x[1] + np.sin(1.0) * x[2] ** 2 == 0.5)
    prog.AddConstraint(x[3] ** 2 + x[4] * x[5] >= 1.0)
    prog.AddBoundingBoxConstraint(-2.0, 2.0, x)
    guess = np.full(6, 0.5)
    solution = ipopt.solve(prog, guess)
    reference = SnoptSolver().Solve(prog, guess, None)
    assert solution.success
    assert reference.is_success()
    assert solution.cost == pytest.approx(reference.get_optimal_cost(), rel=1e-5)
