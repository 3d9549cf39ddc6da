"""Compiled functions and their derivatives against closed forms and difference quotients."""

import numpy as np
import pytest
from pydrake import symbolic
from pydrake.symbolic import Expression, Variable

from limb_systems import LimbError
from limb_systems.model.derivatives import CompiledFunction, Part, SideBySide

WIDTH = 5.0
T, D, w, a, b = (Variable(name) for name in "TDwab")
# s(T) D³ with a logistic s of width w, and 2 D.
WIRE = CompiledFunction([D**3 / (1.0 + symbolic.exp(-(T - 70.0) / w)), 2.0 * D], [T, D], [w])
TWO = SideBySide(
    [
        Part(
            WIRE,
            variables=np.array([[0, 2], [1, 3]]),
            values=np.array([[0, 1], [2, 3]]),
            constants=np.array([[WIDTH, WIDTH]]),
        )
    ],
    num_values=4,
    num_variables=4,
)


def test_derivatives_of_two_wires_are_those_of_the_closed_form():
    generator = np.random.default_rng(0)
    points = generator.uniform([40.0, 0.1] * 2, [100.0, 1.0] * 2, (5, 3, 4))
    weights = generator.normal(size=(5, 3, 4))
    values, first, second = np.zeros((5, 3, 4)), np.zeros((5, 3, 4, 4)), np.zeros((5, 3, 4, 4))
    for wire in range(2):
        T, D = points[..., 2 * wire], points[..., 2 * wire + 1]
        s = 1.0 / (1.0 + np.exp(-(T - 70.0) / WIDTH))
        s1 = s * (1 - s) / WIDTH
        s2 = s1 * (1 - 2 * s) / WIDTH
        own = slice(2 * wire, 2 * wire + 2)
        values[..., wire], values[..., 2 + wire] = s * D**3, 2.0 * D
        first[..., wire, own] = np.stack([s1 * D**3, 3 * s * D**2], axis=-1)
        first[..., 2 + wire, 2 * wire + 1] = 2.0
        block = np.array([[s2 * D**3, 3 * s1 * D**2], [3 * s1 * D**2, 6 * s * D]])
        second[..., own, own] = np.moveaxis(weights[..., wire] * block, (0, 1), (-2, -1))
    np.testing.assert_allclose(TWO.values(points), values, rtol=1e-13)
    for found, expected in zip(TWO.first(points), (values, first), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-13)
    np.testing.assert_allclose(TWO.second(points, weights), second, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(TWO.pattern, first.any(axis=(0, 1)))
    np.testing.assert_array_equal(TWO.curvature, second.any(axis=(0, 1)))
    # One point alone is calculated with Python's numbers.
    one, on = points[1, 2], weights[1, 2]
    np.testing.assert_allclose(TWO.values(one), values[1, 2], rtol=1e-13)
    np.testing.assert_allclose(TWO.first(one)[1], first[1, 2], rtol=1e-13)
    np.testing.assert_allclose(TWO.second(one, on), second[1, 2], rtol=1e-12, atol=1e-12)


FUNCTIONS = {
    "quotient": (a + b) / (2.0 + a * b),
    "powers": symbolic.pow(a, 3) * b + a**0.5 / b**2,
    "power of a variable": symbolic.pow(a + b, a * b),
    "power of a constant": symbolic.pow(a, w) * symbolic.pow(w, b),
    "circular": symbolic.sin(a * b) + symbolic.cos(a - b) * symbolic.tan(b),
    "hyperbolic": symbolic.sinh(a * b) + symbolic.cosh(a - b) * symbolic.tanh(3.0 * b),
    "inverse": symbolic.asin(a * b) + symbolic.acos(a - b) + symbolic.atan(a / b),
    "logarithm": symbolic.log(a * b + w) + symbolic.sqrt(a + b**2),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_each_operation_has_drakes_derivatives(name):
    function = CompiledFunction([FUNCTIONS[name]], [a, b], [w])
    for values in ((0.3, 0.8), (0.7, 0.4)):
        environment = dict(zip((a, b, w), (*values, 1.7), strict=True))

        def drakes(variables, environment=environment):
            found = FUNCTIONS[name]
            for variable in variables:
                found = found.Differentiate(variable)
            return found.Evaluate(environment)

        value, *slopes = function.first(values, (1.7,))
        assert value == pytest.approx(drakes([]), rel=1e-12)
        expected = [drakes([(a, b)[index]]) for _, index in function.first_places]
        assert slopes == pytest.approx(expected, rel=1e-12)
        second = function.second(values, (1.7,), (2.0,))
        pairs = [[(a, b)[index] for index in pair] for pair in function.second_places]
        assert second == pytest.approx([2.0 * drakes(pair) for pair in pairs], rel=1e-10)


def test_magnitudes_have_the_slope_of_their_side():
    function = CompiledFunction([symbolic.abs(a - b) ** 2 + symbolic.abs(a)], [a, b], [])
    for values, of_a in (((0.3, 0.8), 1.0), ((-0.7, 0.4), -1.0)):
        difference = values[0] - values[1]
        _, *slopes = function.first(values, [])
        assert slopes == pytest.approx([2 * difference + of_a, -2 * difference])


def test_numbers_are_infinite_where_arrays_are():
    function = CompiledFunction([symbolic.exp(a) + 1.0 / b], [a, b], [])
    with np.errstate(all="ignore"):
        for values in ((1e4, 1.0), (1.0, 0.0)):
            arrays = function.values([np.array([value]) for value in values], [])
            assert function.values(values, [])[0] == arrays[0] == np.inf


def test_what_is_not_smooth_is_refused():
    with pytest.raises(LimbError, match="uses Max, which is not smooth"):
        CompiledFunction([symbolic.max(Expression(a), 0.0)], [a], [])
