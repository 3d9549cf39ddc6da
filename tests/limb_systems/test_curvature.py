"""Derivatives of wires and rubber against difference quotients."""

import numpy as np
import pytest

from limb_systems import (
    HystereticLaw,
    LimbParameters,
    LinearLaw,
    RestMemory,
    SegmentParameters,
    ThresholdLaw,
    WireParameters,
    Wires,
)

STEP = 1e-6  # of typical changes


class WeakeningLaw(ThresholdLaw):
    """Torque that fades with the joint's angle."""

    def torque(self, x, T0, theta):
        return super().torque(x, T0, theta) * (1.0 - 0.3 * theta)


def limb_with(*laws, **rubber) -> LimbParameters:
    """Two segments, and a wire in the first that is off both axes."""
    wires = [
        WireParameters("left", -0.003, law=laws[0]),
        WireParameters("right", 0.003, law=laws[1]),
        WireParameters("slanting", 0.003, -0.004, law=laws[2]),
    ]
    rubber = {"rest_memory": RestMemory(0.04, 3.0), **rubber}
    first = SegmentParameters(links=3, wires=wires, rest_angle=0.2, **rubber)
    second = SegmentParameters(links=2, stiffening=0.3, rest_memory=RestMemory(0.02, 1.0))
    return LimbParameters(segments=[first, second])


LIMBS = {
    "memory": lambda: limb_with(LinearLaw(), LinearLaw(beta=3e-4), LinearLaw(a1=-0.1)),
    "laws": lambda: limb_with(HystereticLaw(), ThresholdLaw(), HystereticLaw(), stiffening=0.5),
    "angle": lambda: limb_with(WeakeningLaw(), HystereticLaw(), WeakeningLaw(), stiffening=0.5),
    "one memory": lambda: limb_with(
        HystereticLaw(), HystereticLaw(), LinearLaw(), rest_memory=None, stiffening=0.5
    ),
}


@pytest.fixture(params=LIMBS)
def point(request):
    """Wires, and [x, V] (4, N + W), D (4, W) and angles (4, n): the wires heat, or cool."""
    limb, generator = LIMBS[request.param](), np.random.default_rng(0)
    wires = Wires(limb)
    is_warm = wires.heat_scales == 50.0
    low, high = np.where(is_warm, 40.0, 0.2), np.where(is_warm, 80.0, 0.8)
    is_shift = wires.heat_scales == 0.03
    low[is_shift], high[is_shift] = -0.02, 0.02
    return (
        wires,
        generator.uniform(low, high, (4, len(low))),
        generator.uniform(0.0, 0.6, (4, wires.num_wires)),
        generator.uniform(-0.4, 0.4, (4, limb.num_joints)),
    )


def quotient(function, points, scales):
    """Scaled central differences of a function of points (K, P), (K, P, ...)."""
    return np.moveaxis(
        [
            (function(points + d) - function(points - d)) / (2 * STEP)
            for d in np.diag(STEP * scales)
        ],
        0,
        1,
    )


def test_of_the_rates_of_heat_and_of_the_rest_angle(point):
    wires, heat, duty, _ = point
    weights = np.random.default_rng(1).normal(size=heat.shape) / wires.heat_scales
    sizes = np.append(wires.heat_scales, np.ones(wires.num_wires))
    points, M = np.hstack([heat, duty]), heat.shape[1]

    slopes = wires.heat_jacobian(heat, duty) * sizes
    expected = quotient(lambda p: wires.heat_rates(p[:, :M], p[:, M:]), points, sizes)
    np.testing.assert_allclose(slopes, expected.swapaxes(1, 2), atol=1e-8 * np.abs(slopes).max())

    def weighted(p):
        return np.einsum("ki,kij->kj", weights, wires.heat_jacobian(p[:, :M], p[:, M:])) * sizes

    expected = quotient(weighted, points, sizes)
    found = sizes[:, None] * wires.heat_hessian(heat, duty, weights) * sizes
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    assert not found[:, ~wires.heat_curvature].any()
    is_shift = sizes == 0.03
    assert np.abs(expected[:, is_shift]).max() > 1e-3


def test_of_the_forces(point):
    wires, heat, _, angles = point
    states = heat[:, : wires.num_states]
    weights = np.random.default_rng(1).normal(size=angles.shape)
    sizes = wires.heat_scales[: wires.num_states]
    by_states, by_angle = wires.force_derivatives(states, angles)
    expected = quotient(lambda x: wires.forces(x, angles), states, sizes).swapaxes(1, 2)
    np.testing.assert_allclose(by_states * sizes, expected, atol=1e-8 * np.abs(expected).max())
    if by_angle is not None:
        ones = np.ones(angles.shape[1])
        expected = quotient(lambda q: wires.forces(states, q), angles, ones).swapaxes(1, 2)
        np.testing.assert_allclose(by_angle, expected, atol=1e-8 * np.abs(expected).max() + 1e-12)

    def weighted(x):
        slopes = np.broadcast_to(wires.force_derivatives(x, angles)[0], (*angles.shape, len(sizes)))
        return np.einsum("ki,kij->kj", weights, slopes) * sizes

    expected = quotient(weighted, states, sizes)
    found = sizes[:, None] * wires.force_hessian(states, angles, weights) * sizes
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max() + 1e-12)
    assert not found[:, ~wires.torque_curvature].any()
