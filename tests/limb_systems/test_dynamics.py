"""The equation of motion in symbols against the limb's diagram, and its derivatives."""

import dataclasses

import numpy as np
import pytest

from limb_systems import (
    HystereticLaw,
    Limb,
    LimbModel,
    LimbParameters,
    LinearLaw,
    RestMemory,
    SaturatingLaw,
    SegmentParameters,
    ThresholdLaw,
    WireParameters,
)

STEP = 1e-6  # of typical changes


@dataclasses.dataclass
class WeakeningLaw(ThresholdLaw):
    """Torque that fades with the joint's angle."""

    def torque(self, x, T0, theta):
        return super().torque(x, T0, theta) * (1.0 - 0.3 * theta)


def planar(*laws, **rubber) -> LimbParameters:
    """Two segments under gravity, and a wire in the first that is off both axes."""
    wires = [
        WireParameters("left", -0.003, law=laws[0]),
        WireParameters("right", 0.003, law=laws[1]),
        WireParameters("slanting", 0.003, -0.004, law=laws[2]),
    ]
    first = SegmentParameters(links=3, wires=wires, rest_angle=0.2, **rubber)
    second = SegmentParameters(links=2, stiffening=0.3, rest_memory=RestMemory(0.02, 1.0))
    return LimbParameters(segments=[first, second], gravity=[-4.0, -9.0, 1.0], payload=0.002)


def in_space(law, **changes) -> LimbParameters:
    limb = LimbParameters.in_space(3, 2)
    limb.gravity, limb.payload = [9.81, 0.0, 0.0], 0.005
    for name, value in changes.items():
        setattr(limb.segments[0], name, value)
    for wire in limb.wires:
        wire.law = law
    return limb


LIMBS = {
    "the paper's": LimbParameters,
    "laws": lambda: planar(
        HystereticLaw(), ThresholdLaw(), LinearLaw(), stiffening=0.5, rest_memory=RestMemory()
    ),
    "angle": lambda: planar(WeakeningLaw(), HystereticLaw(), WeakeningLaw()),
    "centred": lambda: planar(LinearLaw(), LinearLaw(), SaturatingLaw(), centred_joints=True),
    "space": lambda: in_space(LinearLaw()),
    "space with all": lambda: in_space(
        HystereticLaw(), stiffening=0.4, rest_memory=RestMemory(0.04, 3.0), rest_angle_e3=0.1
    ),
}


@pytest.fixture(params=LIMBS, scope="module")
def limb(request) -> LimbParameters:
    return LIMBS[request.param]()


def random_points(limb: LimbParameters, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points [θ, θ̇, x, V, D] (count, P) of moving limbs with warm wires, and typical changes."""
    generator, wires, n = np.random.default_rng(0), LimbModel.of(limb).wires, limb.num_joints
    is_warm, is_shift = wires.heat_scales == 50.0, wires.heat_scales == 0.03
    low, high = np.where(is_warm, 40.0, 0.2), np.where(is_warm, 80.0, 0.8)
    low[is_shift], high[is_shift] = -0.02, 0.02
    low = np.concatenate([np.full(n, -0.4), np.full(n, -5.0), low, np.zeros(wires.num_wires)])
    high = np.concatenate([np.full(n, 0.4), np.full(n, 5.0), high, np.ones(wires.num_wires)])
    of_duty = np.ones(wires.num_wires)
    scales = np.concatenate([np.full(n, 0.1), np.ones(n), wires.heat_scales, of_duty])
    return generator.uniform(low, high, (count, len(low))), scales


def test_accelerations_and_heat_rates_equal_the_derivatives_of_the_diagram(limb):
    """Drake's plant and blocks are the witness."""
    points, _ = random_points(limb, 3)
    model, n, W = LimbModel.of(limb), limb.num_joints, len(limb.wires)
    dynamics, wires = model.dynamics, model.wires
    states = points[:, : 2 * n + wires.num_states]
    heat_rates = wires.heat_rates(points[:, 2 * n : -W], points[:, -W:])
    values = np.hstack([dynamics.accelerations(states), heat_rates])
    system = Limb(limb)
    context = system.CreateDefaultContext()
    for point, value in zip(points, values, strict=True):
        context.SetContinuousState(point[:-W])
        system.GetInputPort("duty").FixValue(context, point[-W:])
        expected = system.EvalTimeDerivatives(context).CopyToVector()[n:]
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def quotients(function, points, scales):
    """Central differences of a function of points (K, P) by each variable, (K, ..., P), scaled."""
    return np.stack(
        [
            (function(points + step) - function(points - step)) / (2 * STEP)
            for step in np.diag(STEP * scales)
        ],
        axis=-1,
    )


def test_equilibria_have_exact_derivatives_and_no_acceleration(limb):
    held, n = LimbModel.of(limb).statics, limb.num_joints
    N = held.wires.num_states
    points, scales = random_points(limb, 3)
    states, scales = points[:, 2 * n : 2 * n + N], scales[2 * n : 2 * n + N]
    still = np.zeros((3, n + 2 * len(limb.wires)))
    at_rest = np.hstack([held.angles(states), still[:, :n], states, still[:, n:]])
    dynamics, states_of = LimbModel.of(limb).dynamics, slice(2 * n + N)
    accelerations = dynamics.accelerations(at_rest[:, states_of])
    moving = dynamics.accelerations(points[:, states_of])
    assert np.abs(accelerations).max() < 1e-6 * np.abs(moving).max()

    bends, slopes = held.first(states)
    weights = np.random.default_rng(1).normal(size=bends.shape)
    expected = quotients(held.values, states, scales)
    np.testing.assert_allclose(slopes * scales, expected, atol=1e-7 * np.abs(expected).max())

    def weighted(at):
        return np.einsum("ki,kij->kj", weights, held.first(at)[1]) * scales

    expected = quotients(weighted, states, scales)
    actual = scales[:, None] * held.second(states, weights) * scales
    np.testing.assert_allclose(actual, expected, atol=1e-7 * np.abs(expected).max() + 1e-9)
