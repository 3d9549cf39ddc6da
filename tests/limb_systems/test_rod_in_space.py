"""Limbs that bend in space against a Kirchhoff rod, which is checked against closed forms first."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from limb_systems import LimbParameters, tip_position
from limb_systems.statics import static_equilibrium

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


@pytest.mark.parametrize("load", [1.0, 10.0])
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


def test_rod_sags_as_the_rod_of_another_library():
    """PyElastica's, whose shear moves the tip but turns no tangent (tests/data/rod)."""
    *_, half_of_tangent = np.loadtxt(SAG, delimiter=",", skiprows=1)[-1]
    weight = (0.0, -0.025 * 9.81 / 0.10, 0.0)
    tip = Rod(length=0.10, bending=1.727e-3, torsional=1e-3, weight=weight).tip()
    actual = np.degrees(np.arctan2(tip.tangent[1], tip.tangent[0])) / 2
    assert actual == pytest.approx(half_of_tangent, abs=2e-3)


def misses(limb: LimbParameters, bend=(0.0, 0.0)) -> float:
    """Angle between the chords of limb and rod, °, where wires alone would bend both by so much, °.

    The rod has the limb's length, weight and payload. EI is k times a link's length, GJ that share
    of it which a twist's stiffness has of k, and the moment of the wires is their torque.
    """
    segment, gravity = limb.segments[0], np.array(limb.gravity)
    piece = segment.length / segment.links
    torque = 2 * np.radians(bend) * segment.stiffness / segment.links
    rod = Rod(
        segment.length,
        bending=segment.stiffness * piece,
        torsional=segment.torsional_ratio * segment.stiffness * piece,
        weight=tuple(gravity * segment.mass / segment.length),
        payload=tuple(gravity * limb.payload),
        towards_e2=torque[0],
        towards_e3=torque[1],
    )
    warmer = np.maximum([*torque, *-torque], 0.0) / segment.wires[0].law.beta
    angles, _ = static_equilibrium(limb, limb.ambient_temperature + warmer)
    chord = tip_position(limb, angles)
    rods = rod.tip().position
    cosine = chord @ rods / np.linalg.norm(chord) / np.linalg.norm(rods)
    return float(np.degrees(np.arccos(min(cosine, 1.0))))


def limb_in_space(links: int, gravity=(0.0, 0.0, 0.0), payload=0.0, **segment) -> LimbParameters:
    """A limb with wires at +E2, +E3, -E2 and -E3 that is as stiff for any number of links."""
    limb = LimbParameters.in_space(wires=4, links=links)
    limb.segments[0] = dataclasses.replace(limb.segments[0], centred_joints=True, **segment)
    limb.segments[0].stiffness *= links / 5
    limb.gravity, limb.payload = list(gravity), payload
    return limb


def test_wires_alone_bend_the_limb_as_they_bend_the_rod():
    assert misses(limb_in_space(5), (28.0, 28.0)) < 0.4
    assert misses(limb_in_space(10), (28.0, 28.0)) < 0.1
    assert misses(limb_in_space(10, twists=True), (-20.0, 34.0)) < 0.1


def test_limb_that_twists_sags_as_a_rod_and_another_misses_it():
    """A load sideways twists it."""
    assert misses(limb_in_space(10, (5, -6, 6), twists=True), (20.0, -20.0)) < 0.2
    sideways = (0, 0, -9.81)
    twisting = misses(limb_in_space(10, sideways, 0.02, twists=True), (30.0, 0.0))
    assert twisting < 0.4
    assert misses(limb_in_space(10, sideways, 0.02), (30.0, 0.0)) > 10 * twisting


def test_centred_joints_sag_as_a_rod():
    sag = limb_in_space(5, (0.0, 0.0, -9.81))
    centred = misses(sag)
    sag.segments[0].centred_joints = False
    assert centred < 0.15
    assert misses(sag) > 10 * centred
