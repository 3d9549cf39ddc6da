"""Limbs that bend in space against a Kirchhoff rod, which is checked against closed forms first."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

sys.path.insert(0, str(Path(__file__).parent))

from kirchhoff import Rod

SAG = Path(__file__).parents[1] / "data" / "rod" / "sag.csv"

# The rod itself


def test_rod_is_an_arc_under_wires_alone():
    tip = Rod(length=0.5, bending=2.0, towards_e2=1.2, towards_e3=-1.6).tip()
    turned = 0.5 * np.hypot(1.2, 1.6) / 2.0
    sideways = 0.5 * (1 - np.cos(turned)) / turned * np.array([0.6, -0.8])
    np.testing.assert_allclose(tip.position[1:], sideways, atol=1e-9)
    np.testing.assert_allclose(tip.bend, turned / 2 * np.array([0.6, -0.8]), atol=1e-9)


def test_rod_sags_as_a_cantilever_does_if_it_sags_little():
    """w L⁴ / 8 EI."""
    tip = Rod(length=0.5, bending=2.0, weight=(0.0, 0.0, -1e-3)).tip()
    assert tip.position[2] == pytest.approx(-1e-3 * 0.5**4 / (8 * 2.0), rel=1e-6)


@pytest.mark.parametrize("load", [1.0, 3.0, 10.0])
def test_rod_is_an_elastica_under_a_load_at_its_tip(load):
    """Bisshopp and Drucker: √(P L²/EI) = K(k) - F(φ, k), with k² = (1 + sin α)/2."""

    def integrals(slope):
        square = (1 + np.sin(slope)) / 2
        start = np.arcsin(1 / np.sqrt(2 * square))
        return ellipk(square) - ellipkinc(start, square), ellipe(square) - ellipeinc(start, square)

    slope = brentq(lambda a: integrals(a)[0] - np.sqrt(load), 1e-9, np.pi / 2 - 1e-9)
    expected = [np.sqrt(2 * np.sin(slope) / load), 0.0, 1 - 2 / np.sqrt(load) * integrals(slope)[1]]
    tip = Rod(payload=(0.0, 0.0, load)).tip()
    np.testing.assert_allclose(tip.position, expected, atol=1e-8)
    assert np.arcsin(tip.tangent[2]) == pytest.approx(slope, abs=1e-8)
    if load == 1.0:
        assert tip.position[2] == pytest.approx(0.3017, abs=5e-5)  # as tabulated


def test_rod_that_is_bent_sideways_twists():
    """Castigliano's ring: an arc of the angle ψ under a small load across its plane."""
    arc, torsional, load = 1.4, 0.3, 1e-4
    tip = Rod(torsional=torsional, towards_e2=arc, payload=(0.0, 0.0, load)).tip()
    bending = arc / 2 - np.sin(2 * arc) / 4
    twist = 1.5 * arc - 2 * np.sin(arc) + np.sin(2 * arc) / 4
    expected = load / arc**3 * (bending + twist / torsional)
    assert tip.position[2] == pytest.approx(expected, rel=1e-6)


def test_rod_sags_as_that_of_another_library():
    """PyElastica's, whose shear moves the tip but turns no tangent (tests/data/rod)."""
    *_, half_of_tangent = np.loadtxt(SAG, delimiter=",", skiprows=1)[-1]
    weight = (0.0, -0.025 * 9.81 / 0.10, 0.0)
    tip = Rod(length=0.10, bending=1.727e-3, torsional=1e-3, weight=weight).tip()
    found = np.degrees(np.arctan2(tip.tangent[1], tip.tangent[0])) / 2
    assert found == pytest.approx(half_of_tangent, abs=2e-3)
