"""Derivatives of elementwise functions against closed forms."""

import numpy as np
import pytest

from limb_systems.model.derivatives import gradients, hessians

SCALES = np.array([50.0, 1.0])


def logistic_times_cube(arguments):
    """s(T) D³ with a logistic s of width 5, and T D."""
    T, D = arguments
    return [D**3 / (1.0 + np.exp(-(T - 70.0) / 5.0)), T * D]


@pytest.fixture
def point():
    generator = np.random.default_rng(0)
    return [generator.uniform(40.0, 100.0, (4, 3)), generator.uniform(0.1, 1.0, (4, 1))]


def closed_forms(T, D):
    s = 1.0 / (1.0 + np.exp(-(T - 70.0) / 5.0))
    s1 = s * (1 - s) / 5.0
    s2 = s1 * (1 - 2 * s) / 5.0
    first = [[s1 * D**3, 3 * s * D**2], [D + 0 * T, T]]
    second = [[[s2 * D**3, 3 * s1 * D**2], [3 * s1 * D**2, 6 * s * D]], [[0 * T, 0 * T + 1]] * 2]
    second[1] = [[0 * T, 0 * T + 1], [0 * T + 1, 0 * T]]
    return np.array(first), np.array(second)


def test_gradients_are_exact(point):
    expected, _ = closed_forms(*point)
    found = gradients(logistic_times_cube, point, SCALES)
    np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_hessians_are_nearly_exact(point):
    _, expected = closed_forms(*point)
    found = hessians(logistic_times_cube, point, SCALES)
    units = SCALES[:, None] * SCALES
    error = (found - expected) * units[None, :, :, None, None]
    assert np.abs(error).max() < 1e-9 * 50.0


def test_infinitesimal_imaginary_parts_are_carried(point):
    """As in a complex step through a derivative: f'(x + i ε v) = f'(x) + i ε f''(x) v."""
    _, second = closed_forms(*point)
    T, D = point
    found = gradients(logistic_times_cube, [T + 2e-30j, D + 3e-30j], SCALES)
    expected = 2 * second[:, :, 0] + 3 * second[:, :, 1]
    np.testing.assert_allclose(found.imag / 1e-30, expected, atol=1e-9 * 50.0)
