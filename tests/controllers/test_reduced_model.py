"""The limb without its swinging, against the whole limb and closed forms."""

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from controllers import ReducedModel
from limb_systems import (
    HystereticLaw,
    Limb,
    LimbParameters,
    RestMemory,
    ThresholdLaw,
    TwoMassLaw,
    simulate,
)

from .conftest import limb_of


def in_space():
    parameters = LimbParameters.in_space(wires=3, links=2)
    parameters.gravity = [3.0, -6.0, 7.0]
    return parameters


LIMBS = [
    limb_of,
    lambda: limb_of(stiffening=0.4, rest_angle=0.1),
    lambda: limb_of(HystereticLaw),
    in_space,
]


def along(parameters, seconds=8.0):
    """A limb whose wires are heated one after the other, and the heat of the model beside it."""
    W, model = len(parameters.wires), ReducedModel(parameters)
    first, then = [0.0, 0.8, 0.7, 0.0, 0.0], [0.0, 0.0, 0.1, 0.4, 0.6]
    levels = np.array([then, first, first, then])[:W]
    course = PiecewisePolynomial.FirstOrderHold(np.linspace(0.0, seconds, 5), levels)
    start = model.joint_angles(model.cold)
    at_rest = np.concatenate([start, np.zeros_like(start), model.cold])
    recording = simulate(Limb(parameters), course, seconds, accuracy=1e-4, initial_state=at_rest)
    middles = recording.time[:-1] + model.period / 2
    heats = model.rollout(model.cold, course.vector_values(middles).T)
    return recording, model, heats


def test_reduced_model_equals_a_slowly_heated_limb():
    for limb in LIMBS:
        recording, model, heats = along(limb())
        T, V = model.temperatures(heats).T, model.readings(heats).T
        np.testing.assert_allclose(T, recording.wire_temperature, atol=0.02)
        np.testing.assert_allclose(V, recording.measured_temperature, atol=0.02)
        bend = np.rad2deg(model.bend_angle(heats).T - recording.bend_angle)
        assert np.ptp(recording.bend_angle, axis=1).max() > np.deg2rad(10.0)
        assert np.abs(bend).max() < 0.1


def test_a_torque_bends_by_the_springs():
    """(11) and (12): φ = (n + 1) / 2 · β (T - T0) / k."""
    parameters = LimbParameters()
    segment, model = parameters.segments[0], ReducedModel(parameters)
    heat = model.heated(np.array([25.0, 80.0]))
    torque = segment.wire("right").law.beta * (80.0 - parameters.ambient_temperature)
    torque -= segment.wire("left").law.beta * (25.0 - parameters.ambient_temperature)
    bend = (segment.links + 1) / 2 * torque / segment.stiffness
    np.testing.assert_allclose(model.bend_angle(heat), [bend], rtol=1e-9)
    np.testing.assert_allclose(model.bend_by_torque * torque, [bend], rtol=1e-9)


CURVED = [
    *LIMBS,
    lambda: limb_of(ThresholdLaw, stiffening=0.4),
    lambda: limb_of(TwoMassLaw, rest_memory=RestMemory()),
]


def slopes_by_differences(function, x, scales):
    """Derivatives (M, N) of a function of x (N,), from changes of a small share of the scales."""
    moves = 1e-5 * np.diag(scales)
    return np.transpose([function(x + m) - function(x - m) for m in moves]) / (2e-5 * scales)


def test_derivatives_equal_difference_quotients():
    for limb in CURVED:
        model, rng = ReducedModel(limb()), np.random.default_rng(3)
        W, scales = model.num_wires, model.scales
        heat = model.heated(np.linspace(60.0, 71.0, W)) + 0.02 * scales * rng.normal(
            size=model.size
        )
        duty = np.linspace(0.3, 0.7, W)
        _, by_heat, by_duty = model.linearized_step(heat, duty)
        expected = slopes_by_differences(lambda x, m=model, D=duty: m.step(x, D), heat, scales)
        weights = scales / scales[:, None]
        np.testing.assert_allclose(by_heat * weights, expected * weights, rtol=1e-5, atol=1e-9)
        expected = slopes_by_differences(lambda D, m=model, x=heat: m.step(x, D), duty, np.ones(W))
        np.testing.assert_allclose(by_duty, expected, rtol=1e-6, atol=1e-9)
        expected = slopes_by_differences(model.bend_angle, heat, scales)
        np.testing.assert_allclose(model.bend_slopes(heat)[1], expected, rtol=1e-4, atol=1e-8)
