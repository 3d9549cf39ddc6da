"""A wire law of one's own: stated here in a few lines, and nothing else is edited.

Two laws: torque quadratic in temperature, and one with all that a law may have,
a second thermal mass, a threshold, and torque that depends on the joint's angle.
"""

import dataclasses

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.planning import DirectCollocationConstraint
from pydrake.solvers import SnoptSolver
from pydrake.symbolic import Expression, Variable
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from limb_systems import (
    HystereticLaw,
    Limb,
    LimbError,
    LimbParameters,
    LinearLaw,
    RestMemory,
    SaturatingLaw,
    SegmentParameters,
    ThresholdLaw,
    Trajectory,
    TwoMassLaw,
    WireLaw,
    WireParameters,
    Wires,
    make_manipulator,
    simulate,
    split_state,
)
from limb_systems.model.statics import static_equilibrium
from limb_systems.schema import quantity
from limb_systems.simulation import make_simulator
from planners import InfeasibleError, plan, references
from planners.chain import PlanarChain
from planners.check import simulated_differences
from planners.defects import LimbDefects


@dataclasses.dataclass
class QuadraticLaw(LinearLaw):
    beta_2: float = quantity(6.0e-6, "N·m/°C²", 0.0, 1.0)

    def torque(self, x, T0, theta):
        return self.beta * (x[0] - T0) + self.beta_2 * (x[0] - T0) ** 2


@dataclasses.dataclass
class SiliconeLaw(WireLaw):
    """Heat goes to silicone, S, and torque sets in at a threshold and fades with the angle."""

    states = {"T": 50.0, "S": 50.0}  # noqa: RUF012
    to_silicone: float = quantity(0.25, "1/s", 0.0, 10.0)
    from_wire: float = quantity(0.06, "1/s", 0.0, 10.0)
    to_room: float = quantity(0.05, "1/s", 0.0, 10.0)
    heating: float = quantity(45.0, "°C/s", 0.0, 1000.0)
    lag: float = quantity(-0.4, "1/s", -10.0, 0.0)
    slope: float = quantity(6.0e-4, "N·m/°C", 0.0, 1.0)
    softness: float = quantity(0.3, "1/rad", 0.0, 10.0)

    def rates(self, x, D, T0):
        T, S = x
        flow = T - S
        return [
            self.heating * D - self.to_silicone * flow,
            self.from_wire * flow - self.to_room * (S - T0),
        ]

    def torque(self, x, T0, theta):
        above = 8.0 * np.log(1.0 + np.exp((x[0] - 45.0) / 8.0))
        return self.slope * above * (1.0 - self.softness * theta)

    def reading_rate(self, V, x):
        return self.lag * (V - x[0])


@dataclasses.dataclass
class RadiatingLaw(LinearLaw):
    """Heat that is not linear: it radiates."""

    radiation: float = quantity(3.0e-4, "1/(s °C)", 0.0, 1.0)

    def rates(self, x, D, T0):
        above = x[0] - T0
        return [self.a1 * above - self.radiation * above**2 + self.a2 * D]


def limb_with(*laws: WireLaw) -> LimbParameters:
    limb = LimbParameters()
    for wire, law in zip(limb.wires, laws, strict=True):
        wire.law = law
    return limb


def mixed_limb() -> LimbParameters:
    """Laws of one and of two states side by side, three wires, one of them off both axes."""
    wires = [
        WireParameters("low", -0.003, law=SiliconeLaw()),
        WireParameters("high", 0.003, law=QuadraticLaw()),
        WireParameters("slanting", 0.003, 0.004, law=SiliconeLaw(slope=4.0e-4)),
    ]
    return LimbParameters(
        segments=[SegmentParameters(links=3, wires=wires), SegmentParameters(links=2)]
    )


def remembering_limb() -> LimbParameters:
    """Rubber that rests bent, stiffens and remembers, with laws of two and of three states."""
    wires = [
        WireParameters("left", -0.003, law=HystereticLaw()),
        WireParameters("right", 0.003, 0.002, law=ThresholdLaw()),
    ]
    first = SegmentParameters(
        links=3, wires=wires, rest_angle=0.1, stiffening=0.4, rest_memory=RestMemory()
    )
    second = SegmentParameters(links=2, rest_memory=RestMemory(0.05, 1.0))
    return LimbParameters(segments=[first, second])


def soft_limb() -> LimbParameters:
    """Its cold wires hardly pull, and so its memory hardly follows them at first."""
    limb = limb_with(ThresholdLaw(), ThresholdLaw())
    rubber = {"rest_angle": 0.05, "stiffening": 0.3, "rest_memory": RestMemory()}
    limb.segments[0] = dataclasses.replace(limb.segments[0], **rubber)
    return limb


LIMBS = {
    "quadratic": lambda: limb_with(QuadraticLaw(), QuadraticLaw(beta_2=2e-6)),
    "silicone": lambda: limb_with(SiliconeLaw(), SiliconeLaw(slope=5e-4)),
    "radiating": lambda: limb_with(RadiatingLaw(), LinearLaw()),
    "mixed": mixed_limb,
    "remembering": remembering_limb,
    "soft": soft_limb,
}


TWO_MASS_LAWS = {
    "threshold": ThresholdLaw,
    "saturating": SaturatingLaw,
    "hysteretic": HystereticLaw,
}


@pytest.fixture(params=LIMBS)
def limb(request) -> LimbParameters:
    return LIMBS[request.param]()


def random_state(limb: LimbParameters, generator, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Warm states (size, 2n + N + W) and duty (size, W)."""
    n, wires = limb.num_joints, Wires(limb)
    is_temperature = wires.heat_scales == 50.0
    low, high = np.where(is_temperature, [[30.0], [100.0]], [[0.0], [1.0]] * wires.heat_scales)
    return (
        np.hstack(
            [
                generator.uniform(-1, 1, (size, n)),
                generator.uniform(-5, 5, (size, n)),
                generator.uniform(low, high, (size, len(low))),
            ]
        ),
        generator.uniform(0, 1, (size, wires.num_wires)),
    )


def derivatives_of(system, state, duty):
    context = system.CreateDefaultContext()
    context.SetContinuousState(state)
    system.GetInputPort("duty").FixValue(context, duty)
    return system.EvalTimeDerivatives(context).CopyToVector()


def test_blocks_have_the_rates_of_the_law_written_out_by_hand():
    limb = limb_with(SiliconeLaw(), QuadraticLaw())
    angles, T, S, V, D = np.full(5, 0.1), [60.0, 80.0], 50.0, [55.0, 70.0], [0.2, 0.4]
    state = np.concatenate([angles, np.zeros(5), T, [S], V])
    rates = derivatives_of(Limb(limb), state, D)
    np.testing.assert_allclose(
        rates[10:],
        [
            45.0 * 0.2 - 0.25 * 10.0,
            -0.07 * 55.0 + 20.0 * 0.4,
            0.06 * 10.0 - 0.05 * 25.0,
            -0.4 * (55.0 - 60.0),
            -1.0 * (70.0 - 80.0),
        ],
        rtol=1e-12,
    )
    left = 6.0e-4 * 8.0 * np.log1p(np.exp(15.0 / 8.0)) * (1.0 - 0.3 * 0.1)
    right = 4.7e-4 * 55.0 + 6.0e-6 * 55.0**2
    chain = PlanarChain(make_manipulator(limb))
    expected = chain.accelerations(angles[None], np.zeros((1, 5)), np.full((1, 5), right - left))
    np.testing.assert_allclose(rates[5:10], expected[0], rtol=1e-9)


def test_the_lever_of_a_wire_gives_its_torque_a_direction():
    wires = Wires(mixed_limb())
    np.testing.assert_allclose(wires.directions[0], [-1.0, 1.0, 0.6, 0.0, 0.0], rtol=1e-15)
    np.testing.assert_allclose(wires.directions[4], [0.0, 0.0, 0.0, -1.0, 1.0], rtol=1e-15)
    assert wires.state_names == [
        *["T_low_1", "T_high_1", "T_slanting_1", "T_left_2", "T_right_2"],
        *["S_low_1", "S_slanting_1"],
    ]


def test_laws_take_all_of_drakes_scalars(limb):
    state, duty = (values[0] for values in random_state(limb, np.random.default_rng(0), 1))
    expected = derivatives_of(Limb(limb), state, duty)
    variables = InitializeAutoDiff(np.concatenate([state, duty]))[:, 0]
    found = derivatives_of(
        Limb(limb).ToAutoDiffXd(), variables[: len(state)], variables[len(state) :]
    )
    np.testing.assert_allclose(ExtractValue(found)[:, 0], expected, rtol=1e-9, atol=1e-9)
    law, x, D = limb.wires[0].law, state[-1] + np.arange(4.0), 0.3
    x = x[: len(law.states)]
    for kind in (AutoDiffXd, lambda value: Expression(Variable("z")) * 0 + value, complex):
        rates = law.rates([kind(value) for value in x], kind(D), 25.0)
        plain = law.rates(list(x), D, 25.0)
        assert all(isinstance(rate, type(kind(0.0))) for rate in rates)
        assert len(plain) == len(rates)


def test_constraints_and_their_jacobian_agree_with_drakes_autodiff(limb):
    """θ rows are exact at once; rows of θ̇ where those of θ vanish, as in `LimbDefects`."""
    step = 5e-4
    states, duty = random_state(limb, np.random.default_rng(1), 2)
    system = Limb(limb)
    port = system.GetInputPort("duty").get_index()
    constraint = DirectCollocationConstraint(
        system, system.CreateDefaultContext(), input_port_index=port
    )
    n, size = limb.num_joints, states.shape[1]

    def variables():
        return np.r_[step, states[0], states[1], duty[0], duty[1]]

    for _ in range(60):  # closes the θ rows
        states[1, :n] -= constraint.Eval(variables())[:n] * step / 1.5
    chain = PlanarChain(make_manipulator(limb))
    weight = np.linalg.inv(chain.straight_mass_matrix) @ np.diag(chain.stiffness)
    scales = Wires(limb).heat_scales[:, None]

    def unscaled(rows):
        rows = rows.reshape(size, -1)
        return np.vstack(
            [step / 8 * weight @ rows[:n], weight @ rows[n : 2 * n], rows[2 * n :] * scales / step]
        )

    defects = LimbDefects(system, 2, step)
    ours = unscaled(defects.evaluate(states, duty, np.array([step]))[0])[:, 0]
    np.testing.assert_allclose(ours, constraint.Eval(variables()), rtol=1e-7, atol=1e-5)

    theirs = ExtractGradient(constraint.Eval(InitializeAutoDiff(variables())[:, 0]))
    jacobian = np.zeros((size, 2 * size + 2 * duty.shape[1] + 1))
    jacobian[defects.rows, defects.columns] = defects.jacobian(states, duty, np.array([step]))[0]
    jacobian = unscaled(jacobian)
    theirs = np.hstack([theirs[:, 1:], theirs[:, :1]])  # h is last here
    heat = slice(2 * n, size)
    np.testing.assert_allclose(jacobian[heat], theirs[heat], rtol=1e-11, atol=1e-11)
    # Rows of θ̇ differ by multiples of those of θ.
    difference = (jacobian - theirs)[n : 2 * n]
    combination = np.linalg.lstsq(theirs[:n].T, difference.T, rcond=None)[0]
    remainder = difference - combination.T @ theirs[:n]
    assert np.abs(remainder).max() < 1e-8 * np.abs(theirs[n : 2 * n]).max()


def test_the_hessian_is_the_difference_of_jacobians(limb):
    generator, step = np.random.default_rng(2), 0.1
    states, duty = random_state(limb, generator, 3)
    steps = np.full(2, step)
    defects = LimbDefects(Limb(limb), 3, step)
    multipliers = generator.normal(size=(2, states.shape[1]))
    found = np.zeros((2, *[2 * states.shape[1] + 2 * duty.shape[1] + 1] * 2))
    found[:, defects.hessian_rows, defects.hessian_columns] = defects.hessian(
        states, duty, steps, multipliers
    )
    found = found + np.tril(found.swapaxes(1, 2), -1) + np.triu(found.swapaxes(1, 2), 1)

    def gradient(states, duty):
        """Of the first interval's part of the Lagrangian."""
        values = multipliers[0, defects.rows] * defects.jacobian(states, duty, steps)[0]
        return np.bincount(defects.columns, values, found.shape[1])

    sizes = np.append(np.ones(2 * limb.num_joints), Wires(limb).heat_scales)
    for variables, offset in ((states, 0), (duty, 2 * states.shape[1])):
        for index in range(variables.shape[1]):
            change = 1e-5 * (sizes[index] if variables is states else 1.0)
            moved = [variables.copy(), variables.copy()]
            moved[0][0, index] += change
            moved[1][0, index] -= change
            above, below = (
                gradient(m, duty) if variables is states else gradient(states, m) for m in moved
            )
            expected = (above - below) / (2 * change)
            scale = np.abs(expected).max() + 1e-3
            np.testing.assert_allclose(
                found[0, offset + index] / scale, expected / scale, atol=2e-6
            )


@pytest.mark.parametrize("name", [*LIMBS, *TWO_MASS_LAWS])
def test_the_curvature_of_the_wires_is_that_of_the_constraints_by_heat_and_duty(name):
    """The second derivatives of the wires' laws against differences of the Jacobian."""
    limb = LIMBS[name]() if name in LIMBS else limb_with(*[TWO_MASS_LAWS[name]()] * 2)
    generator, step, n = np.random.default_rng(3), 0.1, limb.num_joints
    states, duty = random_state(limb, generator, 2)
    transformed = [s.startswith("xi") for s in Wires(limb).state_names]
    states[:, 2 * n :][:, np.flatnonzero(transformed)] /= 100.0
    defects = LimbDefects(Limb(limb), 2, step)
    multipliers = generator.normal(size=(1, states.shape[1]))
    point = np.r_[states.ravel(), duty.ravel(), step]

    def gradient(point):
        parts = np.split(point, [states.size, states.size + duty.size])
        parts = parts[0].reshape(states.shape), parts[1].reshape(duty.shape), parts[2]
        nonzeros = defects.jacobian(*parts)[0] * multipliers[0, defects.rows]
        return np.bincount(defects.columns, weights=nonzeros, minlength=len(point))

    heat = np.arange(2 * n, states.shape[1])
    of_wires = np.r_[heat, states.shape[1] + heat, np.arange(states.size, len(point) - 1)]
    scales = np.r_[np.tile(Wires(limb).heat_scales, 2), np.ones(duty.size)]
    expected = np.empty((len(of_wires), len(of_wires)))
    for row, (index, scale) in enumerate(zip(of_wires, scales, strict=True)):
        change = 1e-6 * scale * np.eye(len(point))[index]
        slope = (gradient(point + change) - gradient(point - change)) / (2e-6 * scale)
        expected[row] = slope[of_wires] * scale * scales
    found = np.zeros((len(point), len(point)))
    found[defects.wire_hessian_rows, defects.wire_hessian_columns] = defects.wire_hessian(
        states, duty, np.array([step]), multipliers
    )[0]
    found += np.tril(found, -1).T
    found = found[np.ix_(of_wires, of_wires)] * scales[:, None] * scales
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("law", "most"), [(TwoMassLaw, 20), (ThresholdLaw, 15), (SaturatingLaw, 20)]
)
def test_the_first_attempt_plans_fig_5_in_few_iterations(law, most):
    reference = references.step_and_decaying_sine()
    check = plan(limb_with(law(), law()), reference, knot_rate=5.0).check
    assert check.solver in ("IPOPT, Gauss-Newton", "IPOPT, curvature of the wires")
    assert check.iterations <= most


@pytest.mark.parametrize("name", ["quadratic", "silicone", "radiating", "soft"])
def test_plans_are_found_checked_and_saved(name, tmp_path):
    limb = LIMBS[name]()
    reference = references.from_samples([0, 22, 25, 32, 35, 45], np.deg2rad([0, 0, 15, 15, -8, -8]))
    trajectory = plan(limb, reference, knot_rate=5.0)
    assert trajectory.check.failure() is None
    assert trajectory.check.largest_difference_deg < 0.1
    late = trajectory.time > 27.0
    missed = np.rad2deg(np.abs(trajectory.bend_angle - trajectory.reference))[0, late]
    assert np.median(missed) < 1.5
    hottest = trajectory.wire_temperature.max()
    assert hottest <= limb.temperature_limits.maximum + 1e-6

    trajectory.save(tmp_path / "plan.csv")
    loaded = Trajectory.load(tmp_path / "plan.csv")
    assert loaded.parameters == limb
    np.testing.assert_array_equal(loaded.state, trajectory.state)
    states = split_state(limb, trajectory.state)[2]
    assert states.shape == (Wires(limb).num_states, len(trajectory.time))


def test_hysteresis_and_a_memory_of_the_rubber_are_planned_with_their_curvature():
    """The warm-up and the first motion, in which the wires heat and the rest angle moves."""
    limb = limb_with(HystereticLaw(), HystereticLaw())
    limb.segments[0].rest_angle, limb.segments[0].stiffening = 0.05, 0.3
    limb.segments[0].rest_memory = RestMemory()
    reference = references.from_samples([0, 12, 15, 20], np.deg2rad([0, 0, 15, 15]))
    trajectory = plan(limb, reference, knot_rate=5.0)
    assert trajectory.check.failure() is None
    assert trajectory.check.largest_difference_deg < 0.1
    assert trajectory.check.solver == "IPOPT, curvature of the wires"
    assert trajectory.check.iterations <= 40


def test_hysteresis_that_takes_many_iterations_is_planned_by_the_first_attempt():
    """With IPOPT's adaptive barrier it takes 60 iterations."""
    limb = LimbParameters()
    limb.segments[0].links = 2
    limb.segments[0].wires = [WireParameters("only", e2=0.0034, law=HystereticLaw())]
    reference = references.from_samples([0, 22, 25, 32], np.deg2rad([0, 0, 20, 20]))
    check = plan(limb, reference, knot_rate=10.0).check
    assert check.solver == "IPOPT, curvature of the wires"
    assert check.iterations <= 40


@pytest.mark.parametrize("name", TWO_MASS_LAWS)
def test_another_solver_finds_the_same_optimum(name):
    limb = limb_with(TWO_MASS_LAWS[name](), TWO_MASS_LAWS[name]())
    limb.segments[0].links = 1
    limb.temperature_limits.warm_up_time = 6.0
    reference = references.from_samples([0, 2, 4, 8], np.deg2rad([0, 0, 10, 5]))
    ours = plan(limb, reference, knot_rate=4.0, tolerance_deg=1.0).check
    theirs = plan(limb, reference, knot_rate=4.0, tolerance_deg=1.0, solver=SnoptSolver()).check
    assert ours.solver == "IPOPT, curvature of the wires"
    assert theirs.solver == "SNOPT"
    assert theirs.cost == pytest.approx(ours.cost, rel=1e-4)


@pytest.mark.parametrize("name", TWO_MASS_LAWS)
def test_the_check_simulates_wires_and_motion_as_the_whole_limb(name):
    """Wires that are simulated before the motion against both in one diagram, ten times finer."""
    limb = limb_with(TWO_MASS_LAWS[name](), TWO_MASS_LAWS[name]())
    reference = references.from_samples([0, 20, 22, 24], np.deg2rad([0, 0, 20, -20]))
    trajectory = plan(limb, reference, knot_rate=2.0, tolerance_deg=10.0)
    times, differences = simulated_differences(trajectory)
    finer = simulate(
        Limb(limb),
        trajectory,
        sample_rate=20.0,
        accuracy=3e-5,
        initial_state=trajectory.state[:, 0],
    )
    planned = trajectory.bend_angle_at(finer.time)
    np.testing.assert_allclose(times, finer.time, atol=1e-12)
    expected = np.rad2deg(np.abs(finer.bend_angle - planned))[0]
    np.testing.assert_allclose(np.rad2deg(differences), expected, atol=0.004)
    assert expected.max() > 0.03


def test_a_check_that_cannot_be_simulated_says_so_in_a_sentence():
    limb = limb_with(HystereticLaw(), HystereticLaw())
    trajectory = plan(limb, references.from_samples([0, 22], [0, 0]), knot_rate=2.0)
    trajectory.wire_temperature[:, 0] = np.nan
    with pytest.raises(LimbError, match=r"The simulation stopped at .* of 22 s: "):
        simulated_differences(trajectory)


def test_the_yaml_names_the_law(tmp_path):
    limb = limb_with(QuadraticLaw(beta_2=1e-7), LinearLaw())
    limb.save(tmp_path / "limb.yaml")
    text = (tmp_path / "limb.yaml").read_text()
    assert "!QuadraticLaw {" in text
    assert "!LinearLaw {" in text
    assert LimbParameters.load(tmp_path / "limb.yaml") == limb


def test_temperature_limits_are_those_of_the_law():
    """At full duty the silicone law's wire settles where both flows balance."""
    limb = limb_with(SiliconeLaw(heating=1.5), SiliconeLaw(heating=1.5))
    steady = 25.0 + 1.5 / 0.25 + 1.5 / 0.25 * 0.06 / 0.05
    with pytest.raises(InfeasibleError, match=f"never gets above {steady:.4g} °C"):
        plan(limb, references.from_samples([0.0, 40.0], [0.0, 0.1]), knot_rate=2.0)


def test_a_memory_does_not_hinder_the_check_of_temperature_limits():
    limb = limb_with(HystereticLaw(a2=0.5), HystereticLaw(a2=0.5))
    limb.segments[0].rest_memory = RestMemory()
    steady = 25.0 + 0.5 / 0.08 * (1 + 0.004 / 0.012)
    with pytest.raises(InfeasibleError, match=f"never gets above {steady:.4g} °C"):
        plan(limb, references.from_samples([0.0, 40.0], [0.0, 0.1]), knot_rate=2.0)


def test_statics_hold_the_other_states_until_they_settle():
    limb = limb_with(SiliconeLaw(), SiliconeLaw())
    settled = Wires(limb).settled_states(np.array([80.0, 60.0]))
    silicone = 25.0 + np.array([55.0, 35.0]) * 0.06 / (0.06 + 0.05)
    np.testing.assert_allclose(settled, [80.0, 60.0, *silicone], rtol=1e-12)
    angles, _ = static_equilibrium(limb, [80.0, 60.0])
    recording = simulate(
        Limb(limb),
        # Duty that holds these temperatures: what flows on to the silicone.
        0.25 * (np.array([80.0, 60.0]) - silicone) / 45.0,
        60.0,
        sample_rate=1.0,
        initial_state=np.concatenate([np.zeros(10), settled, [80.0, 60.0]]),
    )
    np.testing.assert_allclose(recording.wire_temperature[:, -1], [80.0, 60.0], atol=0.01)
    np.testing.assert_allclose(recording.joint_state[:5, -1], angles, atol=1e-4)


def test_nonlinear_torque_does_not_hold_up_the_integrator():
    limb = Limb(limb_with(ThresholdLaw(), ThresholdLaw()))
    builder = DiagramBuilder()
    builder.AddSystem(limb)
    times = np.arange(0.0, 2.0, 0.1)
    duty = 0.3 + 0.3 * np.sin(times / 3 + np.array([[0.0], [2.0]]))
    source = builder.AddSystem(TrajectorySource(PiecewisePolynomial.FirstOrderHold(times, duty)))
    builder.Connect(source.get_output_port(), limb.GetInputPort("duty"))
    simulator = make_simulator(builder.Build(), 3e-4)
    for end in (0.01, 0.02, 0.05, 0.1, 0.2):
        simulator.AdvanceTo(end)
    assert simulator.get_integrator().get_num_steps_taken() < 500


def test_a_law_out_of_its_range_is_refused():
    limb = limb_with(QuadraticLaw(beta_2=2.0), LinearLaw())
    with pytest.raises(LimbError, match=r"wires\[0\]\.law\.beta_2 is 2\.0; it must be a number"):
        Limb(limb)
