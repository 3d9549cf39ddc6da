"""Symbolic functions as numpy code, against Drake's symbolic derivatives."""

import sys
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest
from pydrake import symbolic
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.symbolic import Variable

from limb_systems import LimbError, smooth_function
from limb_systems.smooth_function import FEW_POINTS, SmoothFunction, check_smooth

FUNCTIONS = {
    "quotient": lambda a, b, _: (a + b) / (2.0 + a * b),
    "powers": lambda a, b, _: a**3 * b + a**0.5 / b**2 + (a + b) ** (a * b),
    "circular": lambda a, b, m: m.sin(a * b) + m.cos(a - b) * m.tan(b) + m.atan(a / b),
    "hyperbolic": lambda a, b, m: m.sinh(a * b) + m.cosh(a - b) * m.tanh(3.0 * b),
    "inverse": lambda a, b, m: m.asin(a * b) + m.acos(a - b) + m.atan2(a, b),
    "logarithm": lambda a, b, m: m.log(a * b + 1.7) * m.exp(a) + m.sqrt(a + b**2),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_values_and_derivatives_are_drakes(name):
    a, b = Variable("a"), Variable("b")
    point, function = ca.SX.sym("p", 2), FUNCTIONS[name]
    theirs = function(a, b, symbolic)
    ours = SmoothFunction(function(point[0], point[1], ca), point)
    points = np.random.default_rng(0).uniform(0.2, 0.8, (5, 3, 2))
    many = np.repeat(points, FEW_POINTS, axis=0)
    pairs = [(a, a), (a, b), (b, a), (b, b)]
    for place in (*np.ndindex(5, 3), ()):
        one = points[place] if place else points[0, 0]
        environment = {a: one[0], b: one[1]}
        slopes = [theirs.Differentiate(v).Evaluate(environment) for v in (a, b)]
        curved = [theirs.Differentiate(v).Differentiate(w).Evaluate(environment) for v, w in pairs]
        # One point and few are evaluated by CasADi, and many by numpy.
        for at in (one, points, many):
            value, slope = ours.first(at)
            second = ours.second(at, np.full((*at.shape[:-1], 1), 2.0))
            chosen = () if at is one else place or (0, 0)
            if at is many:
                chosen = (chosen[0] * FEW_POINTS, chosen[1])
            assert value[chosen][0] == pytest.approx(theirs.Evaluate(environment), rel=1e-12)
            assert slope[chosen][0] == pytest.approx(slopes, rel=1e-11)
            assert second[chosen].ravel() == pytest.approx(2.0 * np.array(curved), rel=1e-9)
            np.testing.assert_array_equal(ours.values(at), value)


def test_only_derivatives_that_may_not_be_zero_have_a_place():
    point, weight = ca.SX.sym("p", 3), ca.SX.sym("c", 1)
    function = SmoothFunction(ca.vertcat(point[0] * point[1], weight * point[2]), point, weight)
    assert function.slope_places.tolist() == [[0, 0, 1], [0, 1, 2]]
    assert function.curvature_places.tolist() == [[1], [0]]
    points, given = np.array([[1.0, 2.0, 3.0]]), np.array([[5.0]])
    np.testing.assert_array_equal(function.first(points, given)[1][0], [[2, 1, 0], [0, 0, 5]])


def test_conditions_choose_between_branches_of_which_one_is_infinite():
    x = ca.SX.sym("x")
    function = SmoothFunction(ca.if_else(ca.logic_and(x > 0, x < 1), 1 / x, 3.0), x)
    points = np.array([[0.0], [0.5], [2.0]])
    values, slopes = function.first(points)
    assert values.ravel().tolist() == [3.0, 2.0, 3.0]
    assert slopes.ravel().tolist() == [0.0, -4.0, 0.0]
    assert [function.values(point)[0] for point in points] == [3.0, 2.0, 3.0]


def test_numbers_are_infinite_where_arrays_are():
    point = ca.SX.sym("p", 2)
    function = SmoothFunction(ca.exp(point[0]) + 1.0 / point[1], point)
    for values in ([1e4, 1.0], [1.0, 0.0]):
        assert function.values(np.array(values)) == function.values(np.array([values]))[0] == np.inf


def test_drakes_scalars_pass_through():
    """A constant among the values becomes one of Drake's scalars, too."""
    point = ca.SX.sym("p", 2)
    function = SmoothFunction(ca.vertcat(ca.tanh(point[0]) * point[1], 4.0), point)
    actual = function.values(InitializeAutoDiff(np.array([0.3, 2.0]))[:, 0])
    np.testing.assert_allclose(ExtractValue(actual)[:, 0], [2.0 * np.tanh(0.3), 4.0], rtol=1e-15)
    expected = [[2.0 / np.cosh(0.3) ** 2, np.tanh(0.3)], [0.0, 0.0]]
    np.testing.assert_allclose(ExtractGradient(actual), expected, rtol=1e-14)


NOT_SMOOTH = {
    "fmax": lambda x: ca.fmax(x, 0.0),
    "not": ca.logic_not,
    "and": lambda x: ca.logic_and(x, x - 1.0),
    "sign": ca.sign,
    "le": lambda x: x * (x <= 1.0),
    "if_else_zero": lambda x: ca.if_else(x, 1.0, 0.0),
}


@pytest.mark.parametrize("name", NOT_SMOOTH)
def test_operations_that_are_not_smooth_are_refused(name):
    x = ca.SX.sym("x")
    with pytest.raises(LimbError, match=f"uses {name}, which is not smooth"):
        check_smooth(ca.Function("law", [x], [NOT_SMOOTH[name](x)]))


def test_threads_do_not_mix_their_points():
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    point = ca.SX.sym("p", 3)
    function = SmoothFunction(ca.sin(point) * ca.sum1(point), point)

    def has_mixed(number):
        own = np.full(3, float(number))
        expected = np.sin(own) * own.sum()
        return any(abs(function.values(own) - expected).max() > 1e-9 for _ in range(10_000))

    try:
        with ThreadPoolExecutor() as pool:
            assert not any(pool.map(has_mixed, range(3)))
    finally:
        sys.setswitchinterval(interval)


def test_results_that_are_built_once_within_others_do_not_grow_without_end():
    for number in range(smooth_function._MAX_CACHED):

        def build_within(number=number) -> int:
            return smooth_function.build_once(("inner", number), lambda: number)

        assert smooth_function.build_once(("outer", number), build_within) == number
    assert len(smooth_function._CACHE) <= smooth_function._MAX_CACHED
