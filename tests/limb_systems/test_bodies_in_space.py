"""Bodies of limbs in space: kinematics and energies against a beam that is cut by hand."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from limb_systems import LimbParameters, SegmentParameters, bend_angle, tip_position
from limb_systems.limb import make_manipulator

BEND_E2, BEND_E3, TWIST = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])


def limb_of_three_kinds() -> LimbParameters:
    """A segment that twists, with centred joints, one that bends about two axes, a planar one."""
    parts = LimbParameters.in_space(links=3).segments[0]
    twisting = dataclasses.replace(
        parts, twists=True, centred_joints=True, rest_angle_e3=0.2, stiffness_ratio=1.5
    )
    in_space = dataclasses.replace(parts, links=2, length=0.07, mass=0.012, width=0.015)
    planar = SegmentParameters(links=1, length=0.04, mass=0.01)
    limb = LimbParameters(segments=[twisting, in_space, planar], payload=0.005)
    limb.gravity = [2.0, -7.0, 6.0]
    return limb


def cut(angles):
    """Bodies of that limb: mass, centre, rotation, moments of inertia; and the segments' ends."""
    joints = iter(angles)
    frame, place, bodies, ends = np.eye(3), np.zeros(3), [], []

    def piece(length, of_length, mass, e2, e3):
        nonlocal place
        share = length / of_length * mass
        squares = np.array([e2**2 + e3**2, length**2 + e3**2, length**2 + e2**2])
        bodies.append((share, place + frame[:, 0] * length / 2, frame, share * squares / 12))
        place = place + frame[:, 0] * length

    def turn(*axes):
        nonlocal frame
        for axis in axes:
            frame = frame @ Rotation.from_rotvec(axis * next(joints)).as_matrix()

    piece(0.1 / 6, 0.1, 0.02, 0.0125, 0.0125)
    for length, order in zip((0.1 / 3, 0.1 / 3, 0.1 / 6), (1, -1, 1), strict=True):
        turn(*[BEND_E2, BEND_E3, TWIST][::order])
        piece(length, 0.1, 0.02, 0.0125, 0.0125)
    ends.append((place, frame))
    for order in (1, -1):
        turn(*[BEND_E2, BEND_E3][::order])
        piece(0.035, 0.07, 0.012, 0.0125, 0.015)
    ends.append((place, frame))
    turn(BEND_E2)
    piece(0.04, 0.04, 0.01, 0.010, 0.020)
    ends.append((place, frame))
    bodies.append((0.005, place, frame, np.zeros(3)))
    assert next(joints, None) is None
    return bodies, ends


@pytest.fixture
def point():
    """The plant of that limb and its context, at random angles and rates."""
    plant, generator = make_manipulator(limb_of_three_kinds()), np.random.default_rng(0)
    context = plant.CreateDefaultContext()
    angles, rates = generator.uniform(-0.5, 0.5, 14), generator.normal(0.0, 3.0, 14)
    plant.SetPositions(context, angles)
    plant.SetVelocities(context, rates)
    return plant, context, angles, rates


def test_bends_and_tip_equal_the_bends_and_tip_of_the_beam(point):
    *_, angles, _ = point
    _, ends = cut(angles)
    np.testing.assert_allclose(tip_position(limb_of_three_kinds(), angles), ends[-1][0], atol=1e-14)
    expected, base, frame = [], np.zeros(3), np.eye(3)
    for end, frame_there in ends:
        along, *across = frame.T @ (end - base)
        length = np.hypot(*across)
        expected += [np.arctan2(length, along) * part / length for part in across]
        base, frame = end, frame_there
    assert expected.pop() == pytest.approx(0.0, abs=1e-12)  # the last segment is planar
    actual = bend_angle(limb_of_three_kinds(), angles)
    np.testing.assert_allclose(actual, expected, atol=1e-12)


def test_potential_and_kinetic_energy_equal_the_energies_of_the_beam(point):
    plant, context, angles, rates = point
    k = 0.1246 * np.array([1, 1.5, 2 / 3, 2 / 3, 1.5, 1, 1, 1.5, 2 / 3, 1, 1, 1, 1, 1])
    rest = np.zeros(14)
    rest[[1, 4, 7]] = 2 * 0.2 / 3  # (11), with centred joints
    potential = k @ (angles - rest) ** 2 / 2
    potential -= sum(mass * center @ [2.0, -7.0, 6.0] for mass, center, *_ in cut(angles)[0])
    assert plant.CalcPotentialEnergy(context) == pytest.approx(potential, abs=1e-14)

    kinetic, step = 0.0, 1e-6
    around = (cut(angles + sign * step * rates)[0] for sign in (-1, 1))
    for (mass, begin, frame, moments), (_, end, turned, _) in zip(*around, strict=True):
        spin = Rotation.from_matrix(frame.T @ turned).as_rotvec() / (2 * step)
        kinetic += mass * np.sum((end - begin) ** 2) / (2 * step) ** 2 / 2 + moments @ spin**2 / 2
    assert plant.CalcKineticEnergy(context) == pytest.approx(kinetic, rel=1e-6)
