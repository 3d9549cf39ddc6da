"""Static equilibria against hand-written statics, beam theory and the paper's numbers."""

import itertools
from functools import partial

import numpy as np
import pytest
from pydrake.multibody.tree import MultibodyForces
from scipy.integrate import solve_ivp

from limb_systems import (
    CoupledLaw,
    Limb,
    LimbError,
    LimbModel,
    LimbParameters,
    SegmentParameters,
    bend_angle,
    joint_angles_from_bend_angle,
    resting_state,
    simulate,
    wires_around,
)
from limb_systems.limb import make_manipulator
from limb_systems.statics import static_equilibrium

SIDEWAYS = [0.0, -9.81, 0.0]


def sag(parameters) -> float:
    """Bend angle under gravity, rad."""
    return bend_angle(parameters, static_equilibrium(parameters)[0])[0]


def test_forces_balance_at_equilibrium_and_energy_is_lowest(planar_chain):
    for links in [1, 5]:
        parameters = LimbParameters(
            segments=[SegmentParameters(links=links, mass=0.05)], gravity=[4.0, -8.0, 1.0]
        )
        angles, _ = static_equilibrium(parameters, [45.0, 60.0])
        chain = planar_chain(parameters)
        torque = np.full(links, 4.7e-4 * (60.0 - 45.0))
        np.testing.assert_allclose(chain.holding_torque(angles), torque, atol=1e-12)

        def potential(angles):
            return chain.potential_energy(angles) - torque @ angles

        for shift in np.random.default_rng(links).normal(0, 0.05, (50, links)):
            assert potential(angles + shift) > potential(angles)


def test_the_motion_of_a_rested_limb_is_predicted_from_its_readings_alone():
    """It is heated for a minute, rests for four, as silicone cools slowly, and is heated again."""
    limb = LimbParameters()
    for wire in limb.wires:
        wire.law = CoupledLaw(outer_cooling=0.003)
    wires, n = LimbModel.of(limb).wires, limb.num_joints

    def heated(heat, duty, duration):
        """[x, V] each second (N + W, K)."""
        span, times = (0.0, duration), np.arange(duration + 1.0)
        rates = partial(wires.heat_rates, duty=np.array(duty))
        return solve_ivp(
            lambda _, heat: rates(heat), span, heat, "LSODA", t_eval=times, max_step=1.0
        ).y

    hot = heated(resting_state(limb, 25.0)[2 * n :], [0.3, 0.2], 60.0)[:, -1]
    rested = heated(hot, [0.0, 0.0], 240.0)[:, -1]
    assert (rested[-2:] > 27.0).all()  # in a room of 25 °C
    readings = heated(rested, [0.25, 0.05], 30.0)[-2:]

    def missed(start):
        foreseen = heated(resting_state(limb, start)[2 * n :], [0.25, 0.05], 30.0)[-2:]
        return np.abs(foreseen - readings).mean()

    assert missed(rested[-2:]) < 0.2 * missed(25.0)
    np.testing.assert_array_equal(resting_state(limb, [np.nan, 31.0])[-2:], [25.0, 31.0])
    with pytest.raises(LimbError, match="give °C, one number or one for each of 2 wires"):
        resting_state(limb, [30.0, 31.0, 32.0])


def test_compliance_is_the_derivative_by_the_torque_of_each_joint():
    """Segments of one link have wires of their own, which turn one joint each."""
    segment = SegmentParameters(links=1, length=0.03, mass=0.01, stiffness=0.1)
    parameters = LimbParameters(segments=[segment] * 3, gravity=SIDEWAYS)
    temperatures = np.array([30.0, 60.0, 50.0, 40.0, 25.0, 70.0])
    _, compliance = static_equilibrium(parameters, temperatures)
    for joint in range(3):
        shift = np.zeros(6)
        shift[2 * joint + 1] = 0.1  # °C on the right wire
        above, _ = static_equilibrium(parameters, temperatures + shift)
        below, _ = static_equilibrium(parameters, temperatures - shift)
        expected = (above - below) / (2 * 0.1 * 4.7e-4)
        np.testing.assert_allclose(compliance[:, joint], expected, rtol=1e-6, atol=1e-8)


def test_fine_chain_sags_like_an_euler_bernoulli_cantilever():
    """Tip deflection w L⁴ / (8 EI), so the chord's angle is w L³ / (8 EI).

    A chain with equal springs k = n EI / L converges with 1/n, so two sizes
    extrapolate.
    """
    rigidity, length, weight = 2e-3, 0.1, 0.025 * 0.01

    def small_sag(n):
        segment = SegmentParameters(links=n, length=length, stiffness=n * rigidity / length)
        return sag(LimbParameters(segments=[segment], gravity=[0.0, -0.01, 0.0]))

    extrapolated = 2 * small_sag(60) - small_sag(30)
    expected = -weight / length * length**3 / (8 * rigidity)
    assert extrapolated == pytest.approx(expected, rel=1e-3)


# Angles and bends that wires hold, at many states of the wires


def two_unlike_segments(base: SegmentParameters, axes: int) -> LimbParameters:
    tip = SegmentParameters(links=2, mass=0.01, axes=axes)
    for segment in (base, tip):
        segment.wires = wires_around(3) if segment.axes == 2 else segment.wires
    return LimbParameters(segments=[base, tip], gravity=[2.0, -9.0, 3.0])


def with_a_heavy_tip(stiffening: float) -> LimbParameters:
    """A limb which Newton's method alone does not settle at two of the states."""
    parameters = LimbParameters.in_space(links=3)
    parameters.segments[0].stiffness, parameters.segments[0].stiffening = 0.07476, stiffening
    parameters.payload = 0.06
    parameters.gravity = [-9.5, -2.0, 1.0]
    return parameters


HELD_LIMBS = {
    "planar": two_unlike_segments(SegmentParameters(3, rest_angle=0.2), 1),
    "planar, stiffens": two_unlike_segments(SegmentParameters(3, stiffening=0.5), 1),
    "space": two_unlike_segments(SegmentParameters(3, axes=2, rest_angle=0.2), 1),
    "space, stiffens": two_unlike_segments(
        SegmentParameters(3, axes=2, twists=True, centred_joints=True, stiffening=0.5), 2
    ),
}
HEAVY_LIMBS = {
    "heavy tip": with_a_heavy_tip(0.0),
    "heavy tip, stiffens": with_a_heavy_tip(1e-5),
}


def of_each(limbs: dict[str, LimbParameters]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("held_limb", limbs.values(), ids=limbs.keys())


def states_of(parameters) -> np.ndarray:
    return np.random.default_rng(5).uniform(25.0, 100.0, (6, len(parameters.wires)))


@of_each(HELD_LIMBS | HEAVY_LIMBS)
def test_drakes_plant_stays_at_rest_where_wires_hold_it(held_limb):
    held, states = LimbModel.of(held_limb).statics, states_of(held_limb)
    plant = make_manipulator(held_limb)
    context, forces = plant.CreateDefaultContext(), MultibodyForces(plant)
    angles = held.angles(states)
    for q, force in zip(angles, held.wires.forces(states, angles), strict=True):
        plant.SetPositions(context, q)
        plant.CalcForceElementsContribution(context, forces)
        load = plant.CalcInverseDynamics(context, np.zeros(len(q)), forces)
        np.testing.assert_allclose(load, force, rtol=0, atol=1e-12 * np.abs(force).max())
    np.testing.assert_allclose(held.values(states).T, bend_angle(held_limb, angles.T), atol=1e-14)


def test_bends_of_equal_angles_follow_from_the_mean_angle_by_eqn_11():
    """Segments of three and two links, whose angles are not equal under gravity."""
    limb = HELD_LIMBS["planar"]
    statics = LimbModel.of(limb).mean_angle_statics
    states = states_of(limb)
    first, second = np.split(statics.angles(states), [3], axis=1)
    expected = [4 / 2 * first.mean(axis=1), 3 / 2 * second.mean(axis=1)]
    np.testing.assert_allclose(statics.values(states).T, expected, rtol=1e-12)


def test_points_without_an_equilibrium_are_named(refused):
    held = LimbModel.of(HELD_LIMBS["planar"]).statics
    states = np.array([[30.0] * 4, [30.0, 1e6, 30.0, 30.0], [40.0] * 4])
    with refused(LimbError, "no static equilibrium", "at point 1 of 3"):
        held.angles(states)


# The paper's numbers (Sec. V-A, V-B; design facts of the nominal limb)


def test_nominal_limb_comes_to_rest_at_its_static_sag():
    parameters = LimbParameters(gravity=SIDEWAYS)
    recording = simulate(Limb(parameters), [0.0, 0.0], 6.0)
    assert recording.bend_angle[0, 0] == 0.0
    assert np.degrees(recording.bend_angle[0, -1]) == pytest.approx(-10.0, abs=0.02)
    assert recording.bend_angle[0, -1] == pytest.approx(sag(parameters), abs=1e-5)
    assert np.abs(recording.joint_state[5:, -1]).max() < 1e-3


def free_oscillation():
    """Time and bend angle of the nominal limb, let go from a bend of 5 degrees."""
    parameters = LimbParameters()
    angles = joint_angles_from_bend_angle(parameters, np.radians([5.0]))
    recording = simulate(
        Limb(parameters),
        [0.0, 0.0],
        1.2,
        sample_rate=500.0,
        accuracy=1e-5,
        initial_state=np.concatenate([angles, np.zeros(5), np.full(4, 25.0)]),
    )
    return recording.time, recording.bend_angle[0]


def test_free_oscillation_has_the_first_mode_of_the_nominal_limb():
    """4.6 Hz and ζ = 0.12, from zero crossings and the logarithmic decrement."""
    time, bend = free_oscillation()
    before = np.flatnonzero(bend[:-1] * bend[1:] < 0)
    fraction = bend[before] / (bend[before] - bend[before + 1])
    crossings = time[before] + fraction * (time[before + 1] - time[before])
    half_periods = np.diff(crossings[2:])  # the higher modes have died out by then
    assert len(half_periods) >= 6
    damped = 1 / (2 * half_periods.mean())

    swings = [np.abs(bend[a:b]).max() for a, b in itertools.pairwise(before[2:])]
    decrement = np.log(swings[0] / swings[-1]) / (len(swings) - 1)  # per half period
    damping_ratio = decrement / np.hypot(np.pi, decrement)
    undamped = damped / np.sqrt(1 - damping_ratio**2)
    assert damped == pytest.approx(4.6, rel=0.02)
    assert undamped == pytest.approx(4.6, rel=0.02)
    assert damping_ratio == pytest.approx(0.12, abs=0.005)


# No equilibrium


def test_unstable_equilibrium_of_a_limb_that_gravity_folds_is_refused(refused):
    """Upright and too soft: straight is a balance of forces, but nothing rests there."""
    for lean in [0.0, 1e-6]:
        segment = SegmentParameters(stiffness=0.01)
        parameters = LimbParameters(segments=[segment], gravity=[-9.81, lean, 0.0])
        with refused(LimbError):
            static_equilibrium(parameters)
