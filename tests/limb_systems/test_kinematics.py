"""Forward kinematics against the plant's own body poses and eqns (8) and (11)."""

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, InitializeAutoDiff

from limb_systems import (
    Layout,
    Limb,
    LimbParameters,
    SegmentParameters,
    bend_angle,
    bend_angle_from_tip_tangent,
    joint_angles_from_bend_angle,
    make_manipulator,
    tip_position,
)
from limb_systems.model.ensemble import OpenLoop, stacked


def plant_tip(parameters, joint_angles, segment=-1, base="base") -> np.ndarray:
    """Tip of a segment in the frame of a body, from the poses of the plant's bodies."""
    plant = make_manipulator(parameters)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, joint_angles)
    last = Layout(parameters).joints_of[segment].stop
    length = parameters.segments[segment].length / parameters.segments[segment].links
    link = plant.GetFrameByName(f"link_{last}")
    tip = plant.CalcPointsPositions(
        context, link, np.array([length, 0.0, 0.0]), plant.GetFrameByName(base)
    )[:, 0]
    assert tip[2] == pytest.approx(0.0, abs=1e-12)
    return tip[:2]


def test_a_limb_bent_back_over_its_base_has_a_bend_beyond_a_right_angle():
    parameters = LimbParameters(segments=[SegmentParameters(links=2)])
    # First link along E2, the second half back: the chord points to 90° + 60°/2.
    angles = np.radians([90.0, 60.0])
    np.testing.assert_allclose(bend_angle(parameters, angles), np.radians([120.0]))


def test_equal_joint_angles_have_the_bend_of_eqn_11_exactly():
    for links in [1, 2, 5, 10]:
        parameters = LimbParameters(segments=[SegmentParameters(links=links)])
        for joint_angle in (-0.3, -0.01, 0.05, 0.3):
            expected = [(links + 1) * joint_angle / 2]
            actual = bend_angle(parameters, np.full(links, joint_angle))
            np.testing.assert_allclose(actual, expected, atol=1e-13)
            back = joint_angles_from_bend_angle(parameters, expected)
            np.testing.assert_allclose(back, np.full(links, joint_angle), atol=1e-14)


def test_tip_tangent_of_a_circular_arc_is_twice_its_bend():
    """Under constant curvature (8) is exact, and the fine chain is an arc."""
    parameters = LimbParameters(segments=[SegmentParameters(links=100)])
    joint_angles = np.full(100, np.radians(60.0) / 100)  # tip tangent 60°
    measured = bend_angle_from_tip_tangent(np.radians(60.0))
    assert measured == pytest.approx(np.radians(30.0), rel=1e-15)
    assert bend_angle(parameters, joint_angles)[0] == pytest.approx(measured, rel=0.011)
    sensor = parameters.segments[0].bend_sensor
    assert sensor.bend_angle(np.radians(60.0)) == measured
    assert sensor.reading(measured) == pytest.approx(np.radians(60.0), rel=1e-15)


def test_bend_angles_are_the_plants(uneven_limb):
    """Each in the frame of its own base, which is the tip of the segment before."""
    angles = np.array([0.2, -0.3, 0.5, 0.1, 0.4])
    x1, y1 = plant_tip(uneven_limb, angles, segment=0)
    x2, y2 = plant_tip(uneven_limb, angles, segment=1, base="link_3")
    expected = [np.arctan2(y1, x1), np.arctan2(y2, x2 - 0.03)]
    np.testing.assert_allclose(bend_angle(uneven_limb, angles), expected, atol=1e-12)
    tip = plant_tip(uneven_limb, angles)
    np.testing.assert_allclose(tip_position(uneven_limb, angles), tip, atol=1e-14)
    limb = Limb(uneven_limb)
    context, rates = limb.CreateDefaultContext(), [9.0, -8.0, 7.0, -6.0, 5.0]
    context.SetContinuousState(np.concatenate([angles, rates, np.full(8, 25.0)]))
    np.testing.assert_allclose(limb.GetOutputPort("bend_angle").Eval(context), expected, atol=1e-12)


def test_gradient_for_small_angles_is_that_of_the_chord():
    """φ ≈ Σ_i (n - i + 1) θ_i / n: joint i turns that part of the equal links."""
    parameters = LimbParameters()
    value = bend_angle(parameters, InitializeAutoDiff(np.zeros(5))[:, 0])
    assert isinstance(value[0], AutoDiffXd)
    np.testing.assert_allclose(ExtractGradient(value), [[1.0, 0.8, 0.6, 0.4, 0.2]], rtol=1e-14)


def test_centred_joints_bend_alike_in_a_plane_however_they_are_calculated():
    """Equal angles by (11) are the chord, and many limbs at once bend as the chain does."""
    limb = LimbParameters(segments=[SegmentParameters(links=4, centred_joints=True)])
    angles = joint_angles_from_bend_angle(limb, [0.4])
    np.testing.assert_allclose(bend_angle(limb, angles), [0.4], rtol=1e-12)
    law, ambient, rubber = stacked([limb])
    duty = np.tile([0.0, 0.3], (200, 1, 1))
    cold = [np.full((1, 1, 2), 25.0)] * 2
    loop = OpenLoop(duty, 0.1, limb.segments[0])
    bend = loop.simulate(law, ambient[:, np.newaxis], cold, rubber)[2][-1, 0, 0]
    held = 4 / 2 / 0.1246 * 4.7e-4 * 20.0 * 0.3 / 0.07 * (1 - np.exp(-0.07 * 20.0))
    assert bend == pytest.approx(held, rel=1e-6)
