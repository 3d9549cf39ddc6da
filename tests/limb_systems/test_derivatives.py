"""Derivatives of a function of known pattern against closed forms."""

import numpy as np

from limb_systems.model.derivatives import Derivatives

SCALES = np.array([50.0, 1.0, 50.0, 1.0])
PATTERN = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [0, 1, 0, 0]], bool)
CURVATURE = np.kron(np.eye(2), np.ones((2, 2))).astype(bool)


def function(points):
    """s(T) D³ of each of two wires with a logistic s of width 5, and 2 D of the first."""
    T, D = points[..., ::2], points[..., 1::2]
    curved = D**3 / (1.0 + np.exp(-(T - 70.0) / 5.0))
    return np.concatenate([curved, 2.0 * D[..., :1]], axis=-1)


def test_first_derivatives_are_exact_and_second_ones_nearly():
    generator = np.random.default_rng(0)
    points = generator.uniform([40.0, 0.1] * 2, [100.0, 1.0] * 2, (5, 3, 4))
    weights = generator.normal(size=(5, 3, 3))
    first, second = np.zeros((5, 3, 3, 4)), np.zeros((5, 3, 4, 4))
    first[..., 2, 1] = 2.0
    for wire in range(2):
        T, D = points[..., 2 * wire], points[..., 2 * wire + 1]
        s = 1.0 / (1.0 + np.exp(-(T - 70.0) / 5.0))
        s1 = s * (1 - s) / 5.0
        s2 = s1 * (1 - 2 * s) / 5.0
        own = slice(2 * wire, 2 * wire + 2)
        first[..., wire, own] = np.stack([s1 * D**3, 3 * s * D**2], axis=-1)
        block = np.array([[s2 * D**3, 3 * s1 * D**2], [3 * s1 * D**2, 6 * s * D]])
        second[..., own, own] = np.moveaxis(weights[..., wire] * block, (0, 1), (-2, -1))
    derivatives = Derivatives(PATTERN, CURVATURE, SCALES)
    np.testing.assert_allclose(derivatives.first(function, points), first, rtol=1e-13)
    error = derivatives.second(function, points, weights) - second
    assert np.abs(SCALES[:, None] * error * SCALES).max() < 1e-9 * 50.0


def test_variables_that_are_moved_at_once_are_told_apart():
    """a and b are in no value together, but each is in one with c."""
    pattern = np.array([[1, 0, 1], [0, 1, 1]], bool)
    curvature = np.array([[0, 0, 1], [0, 0, 1], [1, 1, 0]], bool)

    def products(points):
        return points[..., 2:] * points[..., :2] * [3.0, 5.0]

    points = np.array([[7.0, 11.0, 2.0]])
    derivatives = Derivatives(pattern, curvature, np.ones(3))
    first = derivatives.first(products, points)
    np.testing.assert_allclose(first, [[[6.0, 0.0, 21.0], [0.0, 10.0, 55.0]]], rtol=1e-14)
    second = derivatives.second(products, points, np.array([[1.0, 10.0]]))
    expected = [[[0.0, 0.0, 3.0], [0.0, 0.0, 50.0], [3.0, 50.0, 0.0]]]
    np.testing.assert_allclose(second, expected, rtol=1e-9)
