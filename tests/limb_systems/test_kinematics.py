"""Forward kinematics against the plant's own body poses and eqns (8) and (11)."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, InitializeAutoDiff

from limb_systems import (
    Limb,
    LimbModel,
    LimbParameters,
    SegmentParameters,
    bend_angle,
    bend_angle_from_tip_tangent,
    joint_angles_from_bend_angle,
    make_manipulator,
    tip_position,
)
from limb_systems.kinematics import wrap_angle
from limb_systems.monte_carlo import OpenLoop, stack_limbs
from limb_systems.smooth_function import SmoothFunction
from limb_systems.symbolic_chain import Chain


def plant_tip(parameters, joint_angles, segment=-1, base="base") -> np.ndarray:
    """Tip of a segment in the frame of a body, from the poses of the plant's bodies."""
    plant = make_manipulator(parameters)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, joint_angles)
    last = LimbModel.of(parameters).layout.joints_of[segment].stop
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


def test_gradient_for_small_angles_equals_the_gradient_of_the_chord():
    """φ ≈ Σ_i (n - i + 1) θ_i / n: joint i turns that part of the equal links."""
    parameters = LimbParameters()
    value = bend_angle(parameters, InitializeAutoDiff(np.zeros(5))[:, 0])
    assert isinstance(value[0], AutoDiffXd)
    np.testing.assert_allclose(ExtractGradient(value), [[1.0, 0.8, 0.6, 0.4, 0.2]], rtol=1e-14)


def test_all_implementations_of_centred_joints_agree_in_a_plane():
    """Equal angles by (11) are the chord, and many limbs at once bend as the chain does."""
    limb = LimbParameters(segments=[SegmentParameters(links=4, centred_joints=True)])
    angles = joint_angles_from_bend_angle(limb, [0.4])
    np.testing.assert_allclose(bend_angle(limb, angles), [0.4], rtol=1e-12)
    law, ambient, rubber = stack_limbs([limb])
    duty = np.tile([0.0, 0.3], (200, 1, 1))
    cold = [np.full((1, 1, 2), 25.0)] * 2
    loop = OpenLoop(duty, 0.1, limb.segments[0])
    bend = loop.simulate(law, ambient[:, np.newaxis], cold, rubber)[2][-1, 0, 0]
    held = 4 / 2 / 0.1246 * 4.7e-4 * 20.0 * 0.3 / 0.07 * (1 - np.exp(-0.07 * 20.0))
    assert bend == pytest.approx(held, rel=1e-6)


# Chains with any offsets, against Drake's plant


@pytest.fixture(params=[1, 2], ids=["one axis each", "two axes each"])
def mechanics(request) -> SimpleNamespace:
    """Two uneven segments, with offsets and centres to all sides, and joints in any order."""
    rng, count = np.random.default_rng(27), request.param
    order = [2, 1, 1, 2, 2, 0, 1, 2, 1] if count == 2 else [2] * 9
    return SimpleNamespace(
        axes=np.eye(3)[order] * rng.choice([-1.0, 1.0], (9, 1)),
        offsets=rng.uniform([0.01, -0.01, -0.01], [0.04, 0.01, 0.01], (9, 3)),
        body_joints=np.array([1, 3, 5, 8]),
        body_masses=rng.uniform(0.01, 0.05, 4),
        body_centres=rng.uniform(-0.02, 0.03, (4, 3)),
        body_moments=rng.uniform(2e-6, 3e-6, (4, 3)),
        end_offset=np.array([[0.03, 0.002, 0.0], [0.02, 0.0, -0.004]]),
        layout=SimpleNamespace(
            joints_of=[slice(0, 4), slice(4, 9)],
            bends_of=[slice(0, count), slice(count, 2 * count)],
        ),
    )


def test_bends_are_smooth_where_the_chain_is_straight(mechanics):
    """Series and closed form meet, and neither loses digits: a chord at 1e-9 to 1 rad."""
    mechanics.offsets[:, 1:] = mechanics.end_offset[:, 1:] = 0.0
    q = ca.SX.sym("q", 9)
    bends = SmoothFunction(Chain(mechanics, q).bends(), q)
    sizes = np.unique(np.append(np.logspace(-9, 0, 91), np.linspace(0.05, 0.2, 301)))
    course = sizes[:, None] * np.array([0.3, 0.1, 0.2, 0.3] + [0.2] * 5)
    values, slopes = bends.first(course)
    curved = bends.second(course, np.tile([1.0, -0.5][: values.shape[1] // 2], (len(course), 2)))
    steps = np.diff(course, axis=0)
    first_end = SmoothFunction(Chain(mechanics, q).position(3, mechanics.end_offset[0]), q)
    ahead, across = np.split(
        first_end.values(course)[:, : 1 + mechanics.layout.bends_of[0].stop], [1], axis=1
    )
    size = np.linalg.norm(across, axis=1, keepdims=True)
    expected = np.arctan2(size, ahead) * across / size
    np.testing.assert_allclose(values[:, mechanics.layout.bends_of[0]], expected, rtol=3e-14)
    for given, derivative in ((values, slopes), (slopes, curved)):
        if given is slopes:
            weights = np.tile([1.0, -0.5][: values.shape[1] // 2], 2)
            given = weights @ slopes
        trapezoid = 0.5 * (derivative[1:] + derivative[:-1]) @ steps[..., None]
        largest = np.abs(np.diff(given, axis=0) - trapezoid[..., 0])
        assert (largest < 3e-2 * np.linalg.norm(steps, axis=1)[:, None] ** 3 + 1e-14).all()


def test_an_angle_and_the_same_after_turns_are_one():
    degrees = np.array([-180.0, 180.0, 190.0, -530.0, 540.0, np.nan])
    expected = [180.0, 180.0, -170.0, -170.0, 180.0, np.nan]
    np.testing.assert_allclose(wrap_angle(degrees, 360.0), expected)
    np.testing.assert_allclose(wrap_angle(np.deg2rad(degrees)), np.deg2rad(expected))
