"""A wire law of one's own: stated here in a few lines, and nothing else is edited.

Two laws: torque quadratic in temperature, and one with all that a law may have,
a second thermal mass, a threshold, and torque that depends on the joint's angle.
"""

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, ExtractValue, InitializeAutoDiff
from pydrake.symbolic import Expression, Variable
from wire_laws import LIMBS, QuadraticLaw, SiliconeLaw, limb_with, mixed_limb, random_state

from limb_systems import (
    HystereticLaw,
    Limb,
    LimbModel,
    LimbParameters,
    RestMemory,
    SaturatingLaw,
    ThresholdLaw,
    Trajectory,
    make_manipulator,
    simulate,
    split_state,
)
from planners import InfeasibleError, plan, references
from planners.plan_check import simulated_differences

TWO_MASS_LAWS = {
    "threshold": ThresholdLaw,
    "saturating": SaturatingLaw,
    "hysteretic": HystereticLaw,
}


@pytest.fixture(params=LIMBS)
def limb(request) -> LimbParameters:
    return LIMBS[request.param]()


def derivatives_of(system, state, duty):
    context = system.CreateDefaultContext()
    context.SetContinuousState(state)
    system.GetInputPort("duty").FixValue(context, duty)
    return system.EvalTimeDerivatives(context).CopyToVector()


class RadiatingSilicone(SiliconeLaw):
    """Silicone whose heat is lost by the square of its temperature over the room."""

    def rates(self, x, D, T0):
        T_rate, _ = SiliconeLaw.rates(self, x, D, T0)
        return [T_rate, 0.06 * (x[0] - x[1]) - 0.01 * (x[1] - T0) ** 2]


def test_states_settle_where_their_rates_vanish_also_far_from_linear():
    wires = LimbModel.of(limb_with(RadiatingSilicone(), RadiatingSilicone())).wires
    states = wires.settled_states(np.array([60.0, 90.0]))
    rise = np.sqrt(3.0**2 + 6.0 * np.array([35.0, 65.0])) - 3.0  # of 0.01 r² = 0.06 (T - T0 - r)
    np.testing.assert_allclose(states, [60.0, 90.0, *(25.0 + rise)], rtol=1e-9)


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
    left = 6.0e-4 * 8.0 * np.log1p(np.exp(15.0 / 8.0)) * (1.0 + 0.3 * 0.1)
    right = 4.7e-4 * 55.0 + 6.0e-6 * 55.0**2
    plant = make_manipulator(limb)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, angles)
    torques = np.full(5, right - left)
    plant.get_applied_generalized_force_input_port().FixValue(context, torques)
    expected = plant.EvalTimeDerivatives(context).CopyToVector()[5:]
    np.testing.assert_allclose(rates[5:10], expected, rtol=1e-9)


def test_the_lever_of_a_wire_gives_its_torque_a_direction():
    wires = LimbModel.of(mixed_limb()).wires
    np.testing.assert_allclose(wires.levers[0], [-1.0, 1.0, 0.6, 0.0, 0.0], rtol=1e-15)
    np.testing.assert_allclose(wires.levers[4], [0.0, 0.0, 0.0, -1.0, 1.0], rtol=1e-15)
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
    for kind in (AutoDiffXd, lambda value: Expression(Variable("z")) * 0 + value):
        rates = law.rates([kind(value) for value in x], kind(D), 25.0)
        plain = law.rates(list(x), D, 25.0)
        assert all(isinstance(rate, type(kind(0.0))) for rate in rates)
        assert len(plain) == len(rates)


def test_plans_with_other_wire_laws_pass_their_check_and_are_saved(tmp_path):
    for name in ["silicone", "soft"]:
        limb = LIMBS[name]()
        limb.temperature_limits.warm_up_time = 1000.0
        turns = np.deg2rad([0, 0, 15, 15, -8, -8])
        reference = references.from_samples([0, 2, 5, 11, 15, 22], turns)
        trajectory = plan(limb, reference, knot_rate=5.0)
        assert trajectory.check.failure() is None
        assert trajectory.check.largest_difference_deg < 0.1
        late = trajectory.time > 6.0
        missed = np.rad2deg(np.abs(trajectory.bend_angle - trajectory.reference))[0, late]
        assert np.median(missed) < 1.5
        hottest = trajectory.wire_temperature.max()
        assert hottest <= limb.temperature_limits.maximum + 1e-6

        trajectory.save(tmp_path / "plan.csv")
        loaded = Trajectory.load(tmp_path / "plan.csv")
        assert loaded.parameters == limb
        np.testing.assert_array_equal(loaded.state, trajectory.state)
        states = split_state(limb, trajectory.state)[2]
        assert states.shape == (LimbModel.of(limb).wires.num_states, len(trajectory.time))


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


def test_the_check_simulates_wires_and_motion_as_the_whole_limb():
    """The integration of the limb's equations against Drake's diagram, ten times finer."""
    for name in ("threshold", "hysteretic"):
        limb = limb_with(TWO_MASS_LAWS[name](), TWO_MASS_LAWS[name]())
        limb.segments[0].links = 2
        limb.segments[0].stiffness = 0.0623  # bends as five links do
        limb.segments[0].stiffening = 0.4 if name == "threshold" else 0.0
        limb.segments[0].rest_angle, limb.temperature_limits.warm_up_time = 0.1, 1000.0
        reference = references.from_samples([0, 2, 6, 8], np.deg2rad([0, 0, 20, -20]))
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
        assert expected.max() > 0.02


def test_temperature_limits_are_those_of_the_law():
    """At full duty the silicone law's wire settles where both flows balance."""
    limb = limb_with(SiliconeLaw(heating=1.5), SiliconeLaw(heating=1.5))
    steady = 25.0 + 1.5 / 0.25 + 1.5 / 0.25 * 0.06 / 0.05
    with pytest.raises(InfeasibleError, match=f"never gets above {steady:.4g} °C"):
        plan(limb, references.from_samples([0.0, 40.0], [0.0, 0.1]), knot_rate=2.0)
