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


def limb_of(law=None, **segment):
    parameters = LimbParameters()
    parameters.segments[0].links = 2
    for name, value in segment.items():
        setattr(parameters.segments[0], name, value)
    for wire in parameters.wires:
        wire.law = law() if law else wire.law
    return parameters


def stiff():
    return limb_of(stiffening=0.4, rest_angle=0.1)


def hysteretic():
    return limb_of(HystereticLaw)


def in_space():
    parameters = LimbParameters.in_space(wires=3, links=2)
    parameters.gravity = [3.0, -6.0, 7.0]
    return parameters


LIMBS = [limb_of, stiff, hysteretic, in_space]


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


def test_it_is_where_a_slowly_heated_limb_is():
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


def test_derivatives_are_those_of_differences():
    for limb in CURVED:
        model = ReducedModel(limb())
        rng = np.random.default_rng(3)
        W = model.num_wires
        heat = model.heated(np.linspace(60.0, 71.0, W)) + 0.02 * model.scales * rng.normal(
            size=model.size
        )
        duty = np.linspace(0.3, 0.7, W)
        after, by_heat, by_duty = model.linearized_step(heat, duty)
        bend, slopes = model.bend_slopes(heat)
        np.testing.assert_allclose(after, model.step(heat, duty), rtol=1e-12)
        np.testing.assert_allclose(bend, model.bend_angle(heat), rtol=1e-12)
        for index, scale in enumerate(model.scales):
            move = 1e-5 * scale * np.eye(model.size)[index]
            difference = model.step(heat + move, duty) - model.step(heat - move, duty)
            np.testing.assert_allclose(
                by_heat[:, index] / model.scales,
                difference / (2e-5 * scale) / model.scales,
                rtol=1e-5,
                atol=1e-9,
            )
            difference = model.bend_angle(heat + move) - model.bend_angle(heat - move)
            np.testing.assert_allclose(
                slopes[:, index], difference / (2e-5 * scale), rtol=1e-4, atol=1e-8
            )
        for wire in range(W):
            move = 1e-5 * np.eye(W)[wire]
            difference = model.step(heat, duty + move) - model.step(heat, duty - move)
            np.testing.assert_allclose(by_duty[:, wire], difference / 2e-5, rtol=1e-6, atol=1e-9)
