"""Chains in space against Drake's plant, which shares no code with them."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    RevoluteJoint,
    RotationalInertia,
    SpatialInertia,
)

from limb_systems.model.kinematics import Chain
from limb_systems.model.smooth_function import SmoothFunction

GRAVITY = np.array([-3.0, -7.0, 5.0])


@pytest.fixture(params=[1, 2], ids=["one axis each", "two axes each"])
def layout(request) -> SimpleNamespace:
    """Two uneven segments, with offsets and centres to all sides, and joints in any order."""
    rng, count = np.random.default_rng(27), request.param
    order = [2, 1, 1, 2, 2, 0, 1, 2, 1] if count == 2 else [2] * 9
    return SimpleNamespace(
        num_joints=9,
        axes=np.eye(3)[order] * rng.choice([-1.0, 1.0], (9, 1)),
        offsets=rng.uniform([0.01, -0.01, -0.01], [0.04, 0.01, 0.01], (9, 3)),
        body_joints=np.array([1, 3, 5, 8]),
        body_masses=rng.uniform(0.01, 0.05, 4),
        body_centres=rng.uniform(-0.02, 0.03, (4, 3)),
        body_moments=rng.uniform(2e-6, 3e-6, (4, 3)),
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
    arrays = layout.body_masses, layout.body_centres, layout.body_moments
    bodies = dict(zip(layout.body_joints, zip(*arrays, strict=True), strict=True))
    for joint, (axis, offset) in enumerate(zip(layout.axes, layout.offsets, strict=True)):
        inertia = SpatialInertia.Zero()
        if joint in bodies:
            mass, centre, moments = bodies[joint]
            inertia = SpatialInertia.MakeFromCentralInertia(
                mass, centre, RotationalInertia(*moments)
            )
        body = plant.AddRigidBody(f"body_{joint}", inertia)
        before = plant.AddFrame(
            FixedOffsetFrame(f"before_{joint}", parent.body_frame(), RigidTransform(offset))
        )
        plant.AddJoint(RevoluteJoint(f"joint_{joint}", before, body.body_frame(), axis))
        parent = body
    plant.mutable_gravity_field().set_gravity_vector(GRAVITY)
    plant.Finalize()
    return plant


def assert_close(actual, expected):
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_inverse_dynamics_are_those_of_drakes_plant(layout, angles):
    plant, (q, v, a) = plant_of(layout), (ca.SX.sym(name, 9) for name in "qva")
    torques = Chain(layout, q).inverse_dynamics(v, a, ca.DM(GRAVITY))
    inverse_dynamics = SmoothFunction(torques, ca.vertcat(q, v, a))
    context, rng = plant.CreateDefaultContext(), np.random.default_rng(29)
    for positions in angles:
        rates, accelerations = rng.normal(size=(2, 9)) * [[3.0], [50.0]]
        plant.SetPositionsAndVelocities(context, np.append(positions, rates))
        expected = plant.CalcMassMatrix(context) @ accelerations + plant.CalcBiasTerm(context)
        expected -= plant.CalcGravityGeneralizedForces(context)
        found = inverse_dynamics.values(np.concatenate([positions, rates, accelerations]))
        assert_close(found, expected)


def test_points_and_bends_are_those_of_drakes_plant(layout, angles):
    """The chord of the second segment is turned back into the frame of its base."""
    plant, q = plant_of(layout), ca.SX.sym("q", 9)
    context, world = plant.CreateDefaultContext(), plant.world_frame()
    ends = [plant.GetFrameByName(name) for name in ("body_3", "body_8")]
    bends = SmoothFunction(Chain(layout, q).bends(), q).values(angles)
    tip = SmoothFunction(Chain(layout, q).position(8, layout.end_offset[1]), q)
    for point, positions in enumerate(angles):
        plant.SetPositions(context, positions)
        bases = world, ends[0]
        starts = np.zeros(3), layout.end_offset[0]
        for segment, (base, start, end) in enumerate(zip(bases, starts, ends, strict=True)):
            offset = layout.end_offset[segment]
            chord = plant.CalcPointsPositions(context, end, offset, base)[:, 0] - start
            expected = np.arctan2(chord[1], chord[0])
            if bends.shape[1] == 4:
                across = np.hypot(*chord[1:])
                expected = np.arctan2(across, chord[0]) * chord[1:] / across
            assert_close(bends[point, layout.bends_of[segment]], expected)
        place = plant.CalcPointsPositions(context, end, offset, world)[:, 0]
        assert_close(tip.values(positions), place)


def test_bends_are_smooth_where_the_chain_is_straight(layout):
    """Series and closed form meet, and neither loses digits: a chord at 1e-9 to 1 rad."""
    layout.offsets[:, 1:] = layout.end_offset[:, 1:] = 0.0
    q = ca.SX.sym("q", 9)
    bends = SmoothFunction(Chain(layout, q).bends(), q)
    sizes = np.unique(np.append(np.logspace(-9, 0, 91), np.linspace(0.05, 0.2, 301)))
    course = sizes[:, None] * np.array([0.3, 0.1, 0.2, 0.3] + [0.2] * 5)
    values, slopes = bends.first(course)
    curved = bends.second(course, np.tile([1.0, -0.5][: values.shape[1] // 2], (len(course), 2)))
    steps = np.diff(course, axis=0)
    first_end = SmoothFunction(Chain(layout, q).position(3, layout.end_offset[0]), q)
    ahead, across = np.split(
        first_end.values(course)[:, : 1 + layout.bends_of[0].stop], [1], axis=1
    )
    size = np.linalg.norm(across, axis=1, keepdims=True)
    expected = np.arctan2(size, ahead) * across / size
    np.testing.assert_allclose(values[:, layout.bends_of[0]], expected, rtol=3e-14)
    for given, derivative in ((values, slopes), (slopes, curved)):
        if given is slopes:
            weights = np.tile([1.0, -0.5][: values.shape[1] // 2], 2)
            given = weights @ slopes
        trapezoid = 0.5 * (derivative[1:] + derivative[:-1]) @ steps[..., None]
        largest = np.abs(np.diff(given, axis=0) - trapezoid[..., 0])
        assert (largest < 3e-2 * np.linalg.norm(steps, axis=1)[:, None] ** 3 + 1e-14).all()
