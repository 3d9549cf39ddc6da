"""Grips against an independent statement of the same beam, and grips that cannot be had."""

import itertools

import numpy as np
import pytest
from grip import grip
from scipy.optimize import minimize

from limb_systems import LimbError, LimbParameters

from ..limb_systems.plant_links import link_positions

CENTER, RADIUS = np.array([0.085, 0.035]), 0.02


def gap(angles):
    """From a sampled axis to the ball, less half the thickness, m."""
    places = link_positions(LimbParameters(), angles)[:, :2]
    axis = np.array([np.linspace(a, b, 400) for a, b in itertools.pairwise(places)])
    return np.linalg.norm(axis.reshape(-1, 2) - CENTER, axis=1).min() - RADIUS - 0.005


def test_a_grip_minimizes_the_energy_of_springs_wires_and_a_stiff_ball():
    """The ball is a penalty of 1e5 N/m, whose force is that with which the finger presses."""
    limb = LimbParameters()
    found = grip(limb, CENTER, RADIUS, 0.1)
    torque = limb.wires[1].law.beta * np.diff(found.wire_temperature)[0]
    k, stiff = limb.segments[0].stiffness, 1e5

    def energy(angles):
        spring = 0.5 * k * angles @ angles - torque * angles.sum()
        return spring + 0.5 * stiff * min(gap(angles), 0.0) ** 2

    rest = minimize(energy, np.full(5, 0.05), method="Nelder-Mead", options={"maxiter": 8000})
    for _ in range(3):
        rest = minimize(energy, rest.x, method="Nelder-Mead", options={"maxiter": 8000})
    assert -stiff * gap(rest.x) == pytest.approx(0.1, rel=0.02)
    np.testing.assert_allclose(found.joint_angles, rest.x, atol=2e-3)
    assert found.bend_angle == pytest.approx(3 * torque / k)  # of the free finger, by (12) and (11)
    assert np.linalg.norm(found.normal) == pytest.approx(1.0)


def test_both_sides_are_alike():
    left, right = (grip(LimbParameters(), [0.085, side * 0.035], RADIUS, 0.1) for side in (-1, 1))
    np.testing.assert_allclose(left.joint_angles, -right.joint_angles, atol=1e-9)
    np.testing.assert_allclose(left.wire_temperature, right.wire_temperature[::-1])


@pytest.mark.parametrize(
    ("limb", "center", "force", "said"),
    [
        (
            LimbParameters(),
            [0.085, 0.035],
            1.0,
            "up to 0.268 N, its wires at 95 °C, and not with 1 N",
        ),
        (LimbParameters(), [0.05, 0.06], 0.1, "does not reach the ball"),
        (LimbParameters(), [0.085, 0.02], 0.1, "touches the ball with all wires at 45 °C"),
        (LimbParameters(), [0.085, 0.0], 0.1, "to one side of the straight finger"),
        (LimbParameters.in_space(), [0.085, 0.035], 0.1, "planar limbs of one segment"),
    ],
)
def test_impossible_grips_are_refused(limb, center, force, said):
    with pytest.raises(LimbError, match=said):
        grip(limb, center, RADIUS, force)
