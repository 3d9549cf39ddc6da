"""Collocation in closed form against Drake's own constraints and dynamics."""

import numpy as np
import pytest
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import LinearSpringDamper, SpatialInertia
from pydrake.planning import DirectCollocationConstraint

from limb_systems import (
    Limb,
    LimbParameters,
    SegmentParameters,
    add_manipulator,
    make_manipulator,
)
from limb_systems.model import limb
from limb_systems.model.wire_law import TEMPERATURE_SCALE
from planners import TrajectoryProgram
from planners.chain import PlanarChain
from planners.defects import LimbDefects

TIME_STEP = 5e-4  # s, short enough for the fixed point that closes the θ rows below


def limbs():
    soft_tip = SegmentParameters(links=1, length=0.05, mass=0.02, thickness=0.02, stiffness=0.05)
    soft_tip.wire("left").law.beta, soft_tip.wire("right").law.a3 = 2e-4, -2.5
    return {
        "one link": LimbParameters(segments=[SegmentParameters(links=1)]),
        "nominal": LimbParameters(),
        "two segments": LimbParameters(segments=[SegmentParameters(links=3), soft_tip]),
        "gravity": LimbParameters(gravity=[-4.0, -9.0, 1.0]),
    }


@pytest.fixture(params=limbs().items(), ids=lambda item: item[0])
def parameters(request) -> LimbParameters:
    return request.param[1]


def random_interval(parameters, generator):
    """Two knots and duties, and Drake's constraint for the interval between them."""
    n, num_wires = parameters.num_joints, len(parameters.wires)
    states = np.hstack(
        [
            generator.uniform(-1, 1, (2, n)),
            generator.uniform(-5, 5, (2, n)),
            generator.uniform(20, 100, (2, 2 * num_wires)),
        ]
    )
    duty = generator.uniform(0, 1, (2, num_wires))
    limb = Limb(parameters)
    port = limb.GetInputPort("duty").get_index()
    constraint = DirectCollocationConstraint(
        limb, limb.CreateDefaultContext(), input_port_index=port
    )
    return states, duty, constraint


def drake_variables(states, duty):
    return np.r_[TIME_STEP, states[0], states[1], duty[0], duty[1]]


STEP = np.array([TIME_STEP])


def defects_for(parameters, num_knots=2):
    return LimbDefects(Limb(parameters), num_knots, TIME_STEP)


def unscaled(parameters, rows):
    """Rows of LimbDefects (m, ...) in the units of Drake's constraint."""
    n = parameters.num_joints
    chain = PlanarChain(make_manipulator(parameters))
    weight = np.linalg.inv(chain.straight_mass_matrix) @ np.diag(chain.stiffness)
    return np.concatenate(
        [
            TIME_STEP / 8 * weight @ rows[:n],
            weight @ rows[n : 2 * n],
            rows[2 * n :] * TEMPERATURE_SCALE / TIME_STEP,
        ]
    )


def close_angle_rows(parameters, states, duty, constraint):
    """Moves θ1 until the θ rows of Drake's constraint vanish."""
    n = parameters.num_joints
    for _ in range(60):
        residual = constraint.Eval(drake_variables(states, duty))[:n]
        states[1, :n] -= residual * TIME_STEP / 1.5
    assert np.abs(residual).max() < 1e-9
    return states


def test_angle_and_heat_rows_are_those_of_drake_at_any_point(parameters):
    states, duty, constraint = random_interval(parameters, np.random.default_rng(1))
    ours = unscaled(parameters, defects_for(parameters).evaluate(states, duty, STEP)[0])
    theirs = constraint.Eval(drake_variables(states, duty))
    n = parameters.num_joints
    rows = np.r_[0:n, 2 * n : len(theirs)]
    np.testing.assert_allclose(ours[rows], theirs[rows], rtol=1e-9, atol=1e-7)


def test_rate_rows_are_those_of_drake_where_angle_rows_vanish(parameters):
    states, duty, constraint = random_interval(parameters, np.random.default_rng(2))
    states = close_angle_rows(parameters, states, duty, constraint)
    ours = unscaled(parameters, defects_for(parameters).evaluate(states, duty, STEP)[0])
    theirs = constraint.Eval(drake_variables(states, duty))
    assert np.abs(theirs).max() > 1.0  # it is no feasible point
    np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-5)


def test_jacobian_differs_from_drake_by_multiples_of_the_angle_rows_only(parameters):
    states, duty, constraint = random_interval(parameters, np.random.default_rng(3))
    states = close_angle_rows(parameters, states, duty, constraint)
    defects = defects_for(parameters)
    ours = np.zeros((states.shape[1], 2 * states.shape[1] + 2 * duty.shape[1] + 1))
    ours[defects.rows, defects.columns] = defects.jacobian(states, duty, STEP)[0]
    ours = unscaled(parameters, ours)
    variables = drake_variables(states, duty)
    theirs = ExtractGradient(constraint.Eval(InitializeAutoDiff(variables)[:, 0]))
    theirs = np.roll(theirs, -1, axis=1)  # the time step is Drake's first and our last variable

    n = parameters.num_joints
    same = np.r_[0:n, 2 * n : len(theirs)]
    scale = np.abs(theirs).max(axis=0) + 1.0
    ours, theirs = ours / scale, theirs / scale
    np.testing.assert_allclose(ours[same], theirs[same], rtol=1e-8, atol=1e-8)
    difference = ours[n : 2 * n] - theirs[n : 2 * n]
    multiples = np.linalg.lstsq(theirs[:n].T, difference.T, rcond=None)[0]
    np.testing.assert_allclose(multiples.T @ theirs[:n], difference, atol=1e-7)


def test_intervals_of_a_long_trajectory_are_those_of_short_ones(parameters):
    """Uneven time steps, seen at once and one by one."""
    generator = np.random.default_rng(6)
    pieces = [random_interval(parameters, generator)[:2] for _ in range(2)]
    states, duty = (np.vstack(signals) for signals in zip(*pieces, strict=True))
    steps = np.array([1.0, 0.5, 2.0]) * TIME_STEP
    defects, short = defects_for(parameters, 4), defects_for(parameters)
    values = defects.evaluate(states, duty, steps)
    nonzeros = defects.jacobian(states, duty, steps)
    for k in range(3):
        part = states[k : k + 2], duty[k : k + 2], steps[k : k + 1]
        np.testing.assert_allclose(values[k], short.evaluate(*part)[0], rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(nonzeros[k], short.jacobian(*part)[0], rtol=1e-10, atol=1e-10)


def test_hessian_is_the_difference_quotient_of_the_jacobian(parameters):
    states, duty, _ = random_interval(parameters, np.random.default_rng(7))
    generator = np.random.default_rng(8)
    h = 0.05
    defects = LimbDefects(Limb(parameters), 2, h)
    multipliers = generator.normal(size=(1, states.shape[1]))
    point = np.r_[states.ravel(), duty.ravel(), h]

    def gradient(point):
        parts = np.split(point, [states.size, states.size + duty.size])
        parts = parts[0].reshape(states.shape), parts[1].reshape(duty.shape), parts[2]
        nonzeros = defects.jacobian(*parts)[0] * multipliers[0, defects.rows]
        return np.bincount(defects.columns, weights=nonzeros, minlength=len(point))

    quotient = np.empty((len(point), len(point)))
    for index in range(len(point)):
        step = np.zeros(len(point))
        step[index] = 1e-6 * max(1.0, abs(point[index])) if index < len(point) - 1 else 1e-7
        quotient[index] = (gradient(point + step) - gradient(point - step)) / (2 * step[index])
    hessian = np.zeros_like(quotient)
    hessian[defects.hessian_rows, defects.hessian_columns] = defects.hessian(
        states, duty, np.array([h]), multipliers
    )[0]
    assert not (hessian * hessian.T - np.diag(np.diag(hessian) ** 2)).any()  # each pair once
    hessian += hessian.T - np.diag(np.diag(hessian))
    np.testing.assert_allclose(hessian, quotient, atol=2e-6 * np.abs(quotient).max())


def test_accelerations_and_derivatives_are_the_plants(parameters):
    plant = make_manipulator(parameters)
    chain = PlanarChain(plant)
    generator = np.random.default_rng(4)
    n = parameters.num_joints
    angles, rates, forces = (generator.uniform(-s, s, (1, n)) for s in (2.0, 20.0, 0.1))
    ours = chain.derivatives(angles, rates, forces)

    plant = plant.ToAutoDiffXd()
    context = plant.CreateDefaultContext()
    variables = InitializeAutoDiff(np.concatenate([angles[0], rates[0], forces[0]]))[:, 0]
    plant.SetPositionsAndVelocities(context, variables[: 2 * n])
    plant.get_applied_generalized_force_input_port().FixValue(context, variables[2 * n :])
    accelerations = plant.EvalTimeDerivatives(context).CopyToVector()[n:]
    theirs = np.split(ExtractGradient(accelerations), 3, axis=1)

    np.testing.assert_allclose(ours[0][0], ExtractValue(accelerations)[:, 0], rtol=1e-9)
    for our, their in zip(ours[1:], theirs, strict=True):
        np.testing.assert_allclose(our[0], their, atol=1e-9 * np.abs(their).max())


def loaded(parameters, add):
    """The manipulator with something more in it."""
    plant = MultibodyPlant(time_step=0.0)
    add_manipulator(plant, parameters)
    add(plant, plant.GetBodyByName("link_5"))
    plant.Finalize()
    plant.set_name("manipulator")
    return plant


def test_a_limb_that_is_no_planar_chain_is_noticed(monkeypatch):
    """With a spring from its tip to the wall the closed form is not used."""

    def add_spring(plant, link):
        wall, tip = [0.1, 0.1, 0.0], [0.02, 0.0, 0.0]
        spring = LinearSpringDamper(plant.world_body(), wall, link, tip, 0.05, 5.0, 0.0)
        plant.AddForceElement(spring)

    times = np.linspace(0.0, 1.0, 3)
    assert TrajectoryProgram(LimbParameters(), times).defects is not None
    monkeypatch.setattr(limb, "make_manipulator", lambda p: loaded(p, add_spring))
    with pytest.warns(UserWarning, match="not the planar chain"):
        program = TrajectoryProgram(LimbParameters(), times)
    assert program.defects is None


def test_a_load_on_the_tip_is_part_of_the_chain(monkeypatch):
    def add_load(plant, link):
        inertia = SpatialInertia.SolidSphereWithMass(0.01, 0.01)
        load = plant.AddRigidBody("load", link.model_instance(), inertia)
        plant.WeldFrames(link.body_frame(), load.body_frame())

    times = np.linspace(0.0, 1.0, 3)
    unloaded = TrajectoryProgram(LimbParameters(), times).defects
    monkeypatch.setattr(limb, "make_manipulator", lambda p: loaded(p, add_load))
    program = TrajectoryProgram(LimbParameters(), times)
    x = np.random.default_rng(0).uniform(0.1, 0.3, program.prog.num_vars())
    assert np.abs(program.defects.evaluate(x) - unloaded.evaluate(x)).max() > 1e-3
