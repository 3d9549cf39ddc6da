"""Chains in space against Drake's plant, which shares no code with them, and complex steps."""

from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia

from limb_systems.model.chain import Chain

GRAVITY = np.array([-3.0, -7.0, 5.0])
SPRINGS = np.linspace(0.02, 0.05, 9)  # so soft that gravity folds some of the chains


@pytest.fixture(params=[1, 2], ids=["one axis each", "two axes each"])
def layout(request) -> SimpleNamespace:
    """Two uneven segments, with offsets and centres to all sides, and joints in any order."""
    rng, count = np.random.default_rng(27), request.param
    order = [2, 1, 1, 2, 2, 0, 1, 2, 1] if count == 2 else [2] * 9
    return SimpleNamespace(
        axes=np.eye(3)[order] * rng.choice([-1.0, 1.0], (9, 1)),
        offsets=rng.uniform([0.01, -0.01, -0.01], [0.04, 0.01, 0.01], (9, 3)),
        body_joints=np.array([1, 3, 5, 8]),
        body_masses=rng.uniform(0.01, 0.05, 4),
        body_centres=rng.uniform(-0.02, 0.03, (4, 3)),
        joints_of=[slice(0, 4), slice(4, 9)],
        end_offset=np.array([[0.03, 0.002, 0.0], [0.02, 0.0, -0.004]]),
        bends_of=[slice(0, count), slice(count, 2 * count)],
        bend_direction=np.tile(range(count), 2),
    )


@pytest.fixture
def angles() -> np.ndarray:
    """(7, 9), rad, far from straight, and straight."""
    return np.random.default_rng(28).uniform(-0.8, 0.8, (7, 9)) * np.r_[[1.0] * 6, 0.0][:, None]


def plant_of(layout) -> MultibodyPlant:
    """Drake's plant of the same arrays."""
    plant = MultibodyPlant(time_step=0.0)
    parent = plant.world_body()
    spheres = zip(layout.body_masses, layout.body_centres, strict=True)
    bodies = dict(zip(layout.body_joints, spheres, strict=True))
    for joint, (axis, offset) in enumerate(zip(layout.axes, layout.offsets, strict=True)):
        mass, centre = bodies.get(joint, (0.0, np.zeros(3)))
        inertia = SpatialInertia.SolidSphereWithMass(mass or 1.0, 0.01).Shift(-centre)
        body = plant.AddRigidBody(f"body_{joint}", inertia if mass else SpatialInertia.Zero())
        before = plant.AddFrame(
            FixedOffsetFrame(f"before_{joint}", parent.body_frame(), RigidTransform(offset))
        )
        plant.AddJoint(RevoluteJoint(f"joint_{joint}", before, body.body_frame(), axis))
        parent = body
    plant.mutable_gravity_field().set_gravity_vector(GRAVITY)
    plant.Finalize()
    return plant


def by_complex_steps(function, angles: np.ndarray) -> np.ndarray:
    """Derivatives of a function of angles (..., n) along a new last axis."""
    steps = 1e-30j * np.eye(angles.shape[-1])
    return np.stack([function(angles + step).imag / 1e-30 for step in steps], axis=-1)


def assert_close(actual, expected):
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_gravity_is_that_of_drakes_plant(layout, angles):
    chain, plant = Chain(layout, GRAVITY), plant_of(layout).ToAutoDiffXd()
    context = plant.CreateDefaultContext()
    load, stiffness = chain.held(angles, SPRINGS)
    hessian = stiffness.matrix() - np.diag(SPRINGS)
    for point, q in enumerate(angles):
        plant.SetPositions(context, InitializeAutoDiff(q)[:, 0])
        expected = plant.CalcGravityGeneralizedForces(context)
        assert_close(-load[point], ExtractValue(expected)[:, 0])
        assert_close(-hessian[point], ExtractGradient(expected))


def test_points_and_bends_are_those_of_drakes_plant(layout, angles):
    """The chord of the second segment is turned back into the frame of its base."""
    chain, plant = Chain(layout, GRAVITY), plant_of(layout)
    context, world = plant.CreateDefaultContext(), plant.world_frame()
    ends = [plant.GetFrameByName(name) for name in ("body_3", "body_8")]
    bends = chain.bends(angles)
    for point, q in enumerate(angles):
        plant.SetPositions(context, q)
        bases = world, ends[0]
        starts = np.zeros(3), layout.end_offset[0]
        for segment, (base, start, end) in enumerate(zip(bases, starts, ends, strict=True)):
            offset = layout.end_offset[segment]
            chord = plant.CalcPointsPositions(context, end, offset, base)[:, 0] - start
            expected = np.arctan2(chord[1], chord[0])
            if chain.num_bends == 4:
                across = np.hypot(*chord[1:])
                expected = np.arctan2(across, chord[0]) * chord[1:] / across
            assert_close(bends[point, layout.bends_of[segment]], expected)
        place, slopes = chain.expanded_position(q, 8, offset)
        assert_close(place, plant.CalcPointsPositions(context, end, offset, world)[:, 0])
        assert_close(
            slopes, by_complex_steps(lambda q: chain.expanded_position(q, 8, offset)[0], q)
        )


def test_stiffness_and_its_derivatives_are_those_of_complex_steps(layout, angles):
    chain, rng = Chain(layout, GRAVITY), np.random.default_rng(29)
    matrix = np.diag(SPRINGS) + by_complex_steps(lambda q: chain.held(q, SPRINGS)[0], angles)
    _, stiffness = chain.held(angles, SPRINGS)
    assert_close(stiffness.matrix(), matrix)
    forces = rng.normal(size=(7, 9, 2))
    assert_close(stiffness.solve(forces), np.linalg.solve(matrix, forces))
    stable = np.linalg.eigvalsh(matrix)[:, 0] > 0
    assert len(set(stable)) == 2
    np.testing.assert_array_equal(stiffness.is_stable, stable)

    weights = rng.normal(size=(7, 9))
    assert_close(
        chain.gravity_curvature(angles, weights),
        by_complex_steps(
            lambda q: (weights[..., None, :] @ chain.held(q, SPRINGS)[1].matrix())[..., 0, :],
            angles,
        ),
    )


def test_derivatives_of_bends_are_those_of_complex_steps(layout, angles):
    chain, rng = Chain(layout, GRAVITY), np.random.default_rng(29)
    values, slopes = chain.expanded_bends(angles)
    assert_close(slopes, by_complex_steps(chain.bends, angles))
    weights = rng.normal(size=values.shape)
    assert_close(
        chain.bend_curvature(angles, weights),
        by_complex_steps(
            lambda q: (weights[..., None, :] @ chain.expanded_bends(q)[1])[..., 0, :], angles
        ),
    )


def test_bends_are_smooth_where_the_chain_is_straight(layout):
    """Series and closed form meet, and neither loses digits: a chord at 1e-9 to 1 rad."""
    layout.offsets[:, 1:] = layout.end_offset[:, 1:] = 0.0
    chain = Chain(layout, GRAVITY)
    angles = np.logspace(-9, 0, 91)[:, None] * np.array([0.3, 0.1, 0.2, 0.3] + [0.2] * 5)
    _, slopes = chain.expanded_bends(angles)
    assert_close(slopes, by_complex_steps(chain.bends, angles))
    weights = np.tile([1.0, -0.5][: chain.num_bends // 2], (91, 2))
    assert_close(
        chain.bend_curvature(angles, weights),
        by_complex_steps(
            lambda q: (weights[..., None, :] @ chain.expanded_bends(q)[1])[..., 0, :], angles
        ),
    )
