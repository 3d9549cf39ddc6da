"""The MultibodyPlant against Lagrange's equations and beam theory."""

import numpy as np
import pytest
from pydrake.systems.primitives import Linearize

from limb_systems import LimbParameters, SegmentParameters, make_manipulator


def random_segment(rng, links: int) -> SegmentParameters:
    return SegmentParameters(
        links=links,
        length=rng.uniform(0.05, 0.3),
        mass=rng.uniform(0.01, 0.1),
        thickness=rng.uniform(0.005, 0.03),
        stiffness=rng.uniform(0.01, 1.0),
        damping=rng.uniform(1e-4, 1e-2),
    )


def plant_acceleration(plant, angles, rates, force) -> np.ndarray:
    context = plant.CreateDefaultContext()
    context.SetContinuousState(np.concatenate([angles, rates]))
    plant.get_applied_generalized_force_input_port().FixValue(context, force)
    derivatives = plant.EvalTimeDerivatives(context).CopyToVector()
    np.testing.assert_array_equal(derivatives[: len(angles)], rates)
    return derivatives[len(angles) :]


def random_state(rng, n: int):
    """θ, θ̇ and a generalized force, large enough for every term to count."""
    return rng.uniform(-2, 2, n), rng.uniform(-20, 20, n), rng.uniform(-1, 1, n)


def test_forward_dynamics_equal_the_accelerations_of_the_lagrangian(planar_chain):
    for links in [(1,), (5,), (10,), (1, 4), (2, 1, 3)]:
        rng = np.random.default_rng(sum(links))
        parameters = LimbParameters(segments=[random_segment(rng, n) for n in links])
        angle = rng.uniform(-np.pi, np.pi)
        parameters.gravity = [9.81 * np.cos(angle), 9.81 * np.sin(angle), 0.0]
        plant, chain = make_manipulator(parameters), planar_chain(parameters)
        for _ in range(20):
            angles, rates, force = random_state(rng, parameters.num_joints)
            expected = chain.acceleration(angles, rates, force)
            actual = plant_acceleration(plant, angles, rates, force)
            assert np.abs(actual - expected).max() <= 1e-9 * np.abs(expected).max()


def test_fine_chain_rings_like_an_euler_bernoulli_cantilever():
    """ω = 1.8751² sqrt(EI / (m L³)) for a thin beam of mass m; k = n EI / L.

    A chain with equal springs converges with 1/n, so two sizes extrapolate.
    """
    rigidity, length, mass = 2e-3, 0.1, 0.025

    def lowest_frequency(n):
        segment = SegmentParameters(
            links=n,
            length=length,
            mass=mass,
            width=1.0,  # else it would be denser than any metal
            thickness=1e-4,
            stiffness=n * rigidity / length,
            damping=0.0,
        )
        plant = make_manipulator(LimbParameters(segments=[segment]))
        context = plant.CreateDefaultContext()
        port = plant.get_applied_generalized_force_input_port()
        port.FixValue(context, np.zeros(n))
        output = plant.get_state_output_port()
        linear = Linearize(plant, context, port.get_index(), output.get_index())
        return np.abs(np.linalg.eigvals(linear.A())).min()

    extrapolated = 2 * lowest_frequency(40) - lowest_frequency(20)
    expected = 1.875104**2 * np.sqrt(rigidity / (mass * length**3))
    assert extrapolated == pytest.approx(expected, rel=5e-3)
