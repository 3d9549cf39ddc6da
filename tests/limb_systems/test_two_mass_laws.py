"""Laws of wires in warm silicone against closed forms, and hysteresis against another model."""

import dataclasses
import itertools
import warnings

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares

from controllers.reduced_model import ReducedModel
from limb_systems import (
    CoupledLaw,
    HeatBounds,
    HystereticLaw,
    Limb,
    LimbModel,
    LimbParameters,
    SaturatingLaw,
    ThresholdLaw,
    TwoMassLaw,
    simulate,
)
from limb_systems.law_functions import with_fields
from limb_systems.monte_carlo import OpenLoop
from limb_systems.simulation import make_simulator
from limb_systems.wire_laws.hysteretic import BACKLASH

LAWS = [TwoMassLaw, ThresholdLaw, SaturatingLaw, HystereticLaw, CoupledLaw]
ROOM = 25.0


def limb_with(left, right, links: int = 5) -> LimbParameters:
    limb = LimbParameters()
    limb.segments[0].links = links
    for wire, law in zip(limb.wires, (left, right), strict=True):
        wire.law = law
    return limb


def logistic(z):
    return 1.0 / (1.0 + np.exp(-z))


def test_heat_of_two_masses_is_the_matrix_exponential():
    """Of [T, S, V] above ambient, and the duty, which is constant."""
    law = TwoMassLaw(a1=-0.1, a2=15.0, a3=-0.8, silicone_warming=0.02, silicone_cooling=0.03)
    rates = [
        [-0.1, 0.1, 0.0, 15.0],
        [0.02, -0.05, 0.0, 0.0],
        [0.8, 0.0, -0.8, 0.0],
        [0.0, 0.0, 0.0, 0.0],
    ]
    recording = simulate(
        Limb(limb_with(law, law, 1)), [0.0, 0.3], 30.0, sample_rate=0.1, accuracy=1e-8
    )
    actual = [recording.wire_temperature[1], recording.measured_temperature[1]]
    for k, time in enumerate(recording.time):
        T, _, V, _ = expm(np.array(rates) * time) @ [0.0, 0.0, 0.0, 0.3]
        np.testing.assert_allclose([row[k] for row in actual], [25 + T, 25 + V], atol=1e-4)
    # In the end the silicone passes on all that it gets.
    _, settled = LimbModel.of(limb_with(law, law)).wires.integrate_states(
        np.full(4, 25.0), np.array([[0.0, 0.3]] * 2), np.array([0.0, 2000.0]), longest_step=1.0
    )
    silicone = 0.3 * 15.0 / 0.1 * 0.02 / 0.03
    np.testing.assert_allclose(settled[[1, 3]], [25 + silicone + 45.0, 25 + silicone], atol=1e-6)


def test_torque_with_a_threshold_sets_in_and_is_linear_far_above():
    law = ThresholdLaw(beta=6e-4, knee=55.0, width=4.0)
    cold = 6e-4 * 4.0 * np.log1p(np.exp(-30.0 / 4.0))
    T = np.array([25.0, 55.0, 155.0, 255.0])
    expected = [0.0, 6e-4 * 4.0 * np.log(2.0) - cold, 6e-4 * 100.0 - cold, 6e-4 * 200.0 - cold]
    np.testing.assert_allclose(law.torque([T, None], ROOM, 0.0), expected, rtol=1e-9, atol=1e-18)
    assert law.torque([40.0, None], ROOM, 0.0) < 0.1 * law.torque([55.0, None], ROOM, 0.0)


def shares(
    law: HystereticLaw, turns: list[float], rate: float = 1.0, share: float = 0.0, step: float = 0.1
) -> list[np.ndarray]:
    """T and ξ (2, K) at each step, s, while T goes from turn to turn at a rate, °C/s."""
    x, courses = np.array([turns[0] - BACKLASH, share]), []
    for start, end in itertools.pairwise(turns):
        times = np.linspace(0.0, abs(end - start) / rate, round(abs(end - start) / rate / step) + 1)
        T, course = np.linspace(start, end, len(times)), [x]
        for before, after in itertools.pairwise(T):  # by the classical Runge-Kutta method
            middle = (before + after) / 2

            def slopes(T, x):
                return np.array(law.rates([T, T, *x], 0.0, ROOM)[2:])

            k1 = slopes(before, x)
            k2 = slopes(middle, x + times[1] / 2 * k1)
            k3 = slopes(middle, x + times[1] / 2 * k2)
            k4 = slopes(after, x + times[1] * k3)
            x = x + times[1] / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            course.append(x)
        courses.append(np.array([T, np.array(course)[:, 1]]))
    return courses


def test_hysteresis_follows_the_closed_forms_of_duhems_law():
    """dξ/dT integrated by hand: ln(1 - ξ) falls on heating, ln ξ on cooling, by a softplus.

    After a turn this begins once T has gone back by the backlash on both sides, with a soft corner.
    """
    law = HystereticLaw(heating_middle=64.0, cooling_middle=52.0, width=5.0)
    (T, heating), cooling, again = shares(law, [15.0, 68.0, 45.0, 100.0])
    left = (1 + np.exp((15.0 - 64.0) / 5)) / (1 + np.exp((T - 64.0) / 5))
    np.testing.assert_allclose(heating, 1 - left, atol=1e-4)
    np.testing.assert_allclose(heating, logistic((T - 64.0) / 5), atol=2e-4)  # from far below
    T, turn = cooling[0], 68.0 - 2 * BACKLASH
    kept = (1 + np.exp((52.0 - turn) / 5)) / (1 + np.exp((52.0 - np.minimum(T, turn)) / 5))
    np.testing.assert_allclose(cooling[1], heating[-1] * kept, atol=0.01)
    T, turn = again[0], 45.0 + 2 * BACKLASH
    left = (1 + np.exp((turn - 64.0) / 5)) / (1 + np.exp((np.maximum(T, turn) - 64.0) / 5))
    np.testing.assert_allclose(again[1], 1 - (1 - cooling[1][-1]) * left, atol=0.01)


def test_minor_loops_are_monotone_within_the_major_one_and_do_not_creep():
    law = HystereticLaw()
    up, down = shares(law, [20.0, 120.0, 20.0])
    for T, course in shares(law, [20.0, 70.0, 55.0, 66.0, 50.0, 120.0]):
        assert 0.0 <= course.min() <= course.max() <= 1.0
        steps = np.diff(course[np.abs(T - T[0]) > 2 * BACKLASH])
        assert (steps > 0).all() or (steps < 0).all()
    inner_up, inner_down = shares(law, [60.0, 72.0, 60.0], share=np.interp(60.0, *up))
    assert np.interp(60.0, *up) < inner_down[1, -1] < np.interp(60.0, *down[:, ::-1])
    assert (np.diff(inner_up[1]) > 0).all()
    # While T is held for ten minutes, what is left of the path is less than the backlash.
    for share in np.linspace(0.0, 1.0, 5):
        ((_, held),) = shares(law, [66.0, 66.0006], 1e-6, share, step=0.5)
        most = BACKLASH * (1 - share) * logistic(0.0) / 9
        assert -0.01 < held[-1] - share < most + 0.02


def test_minor_loops_of_plays_close_and_those_of_duhems_law_creep():
    """Return-point memory (Mayergoyz): after a smaller loop the wire is where it was."""
    creep: dict[float, float] = {}
    for share in (0.0, 0.5, 1.0):
        law = CoupledLaw(heating_middle=72.0, cooling_middle=56.0, play_share=share)
        state, torques = np.array(law.cold_states(ROOM)), []
        for turn in (70.0, 55.0, 70.0, 55.0, 70.0):
            start = state[0]
            for along in np.linspace(0.0, 1.0, 1000):
                state[0] = start + along * (turn - start)
                state[3:] += 0.05 * np.array(law.rates(state, 0.0, ROOM)[3:])
            torques.append(law.torque(state, ROOM, 0.0) / law.full_torque)
        gained = logistic((70 - 8 - 64) / 9) - logistic((25 - 8 - 64) / 9)
        creep[share] = torques[4] - torques[0]
        if share == 1.0:
            np.testing.assert_allclose(torques[::2], gained, atol=0.01)  # they lag by 0.3 s
    # What is left of plays' creep is their soft corner.
    assert creep[1.0] < 0.015
    assert creep[0.0] > 0.08
    middle = (creep[0.0] + creep[1.0]) / 2
    assert creep[0.5] == pytest.approx(middle, abs=1e-6)


def test_a_transforming_wire_absorbs_its_latent_heat():
    """Without losses, a wire gets as hot as its heat says, less that of the transformation."""
    law = CoupledLaw(a1=-1e-4, latent_heat=12.0, direct_cooling=0.0, convection=0.0)
    limb = limb_with(law, law, 1)
    recording = simulate(Limb(limb), [0.0, 0.25], 16.0, sample_rate=1.0, accuracy=1e-6)
    states = LimbModel.of(limb).wires.integrate_states(
        LimbModel.of(limb).wires.cold_states,
        np.array([[0.0, 0.25]] * 17),
        recording.time,
        longest_step=0.02,
    )
    gained = law.torque(states.T[1::2], ROOM, 0.0) / law.full_torque
    assert gained[-1] > 0.9
    heated = ROOM + law.a2 * 0.25 * recording.time - law.latent_heat * gained
    np.testing.assert_allclose(recording.wire_temperature[1], heated, atol=0.1)


def test_rubber_that_creeps_is_a_standard_linear_solid():
    """A spring k beside a spring m k with a dashpot, time τ, under the pull of a wire at rest.

    It bends at once to 1 / (1 + m) of what it comes to, and on with the time (1 + m) τ.
    """
    m, tau = 0.25, 4.0
    law = CoupledLaw(creep_share=m / (1 + m), creep_rate=1 / ((1 + m) * tau))
    state, step = np.array(law.warm_states(70.0, ROOM)), 0.01
    held, state[-1] = law.torque(state, ROOM, 0.0), 0.0
    spring, dashpot = [], 0.0  # angles by k θ + m k (θ - q) = torque, q' = (θ - q) / τ
    torques = []
    for _ in range(1500):
        angle = (held + m * dashpot) / (1 + m)
        spring.append(angle)
        torques.append(law.torque(state, ROOM, 0.0))
        dashpot += step * (angle - dashpot) / tau
        state[-1] += step * law.rates(state, 0.0, ROOM)[-1]
    np.testing.assert_allclose(torques, spring, rtol=1e-9)
    assert torques[0] == pytest.approx(0.8 * held)


def test_stress_moves_the_curve_of_a_wire_by_its_pull():
    """Half of it is transformed at T_h + σ / 2, where it is at T_h without stress."""
    middles = []
    for shift in (0.0, 10.0):
        law = CoupledLaw(play_share=0.0, stress_shift=shift)
        state = np.array(law.cold_states(ROOM))
        while state[5] < 0.5:
            state[0] += 0.01
            state[3:] += 0.05 * np.array(law.rates(state, 0.0, ROOM)[3:])
        middles.append(state[0])
        assert law.warm_states(state[0], ROOM)[5] == pytest.approx(0.5, abs=0.02)
    assert middles[1] - middles[0] == pytest.approx(5.0, abs=0.1)
    # The law that plans start from has the same curve, midway between heating and cooling.
    start = law.smoothed().smoothed()
    cooler, warmer = (law.warm_states(middles[1] + step, ROOM)[5] for step in (-1.0, 1.0))
    assert (warmer - cooler) / 2 == pytest.approx(1 / (4 * start.width), rel=0.02)
    assert start.middle == 66.0 + 5.0 - 4.0


@pytest.mark.parametrize("drop", [-0.25, 0.25])
def test_bounds_of_a_board_hold_wires_of_both_phases(drop):
    law = CoupledLaw(heating_drop=drop)
    bounds, heating = HeatBounds.around(law), sorted([law.a2, law.a2 * (1 - drop)])
    assert bounds.least_heating < heating[0]
    assert heating[1] < bounds.most_heating


def test_the_share_stays_from_0_to_1_in_every_simulation():
    """From starts that are not consistent, as fits and estimators have them, under sudden duty."""
    for start in (-0.3, 1.4):
        law = HystereticLaw(a1=-0.3, a2=150.0, a3=-0.5, heating_middle=75.0, width=3.0)
        limb, generator = limb_with(law, law, 1), np.random.default_rng(2)
        wires, low, high = LimbModel.of(limb).wires, min(start, 0.0), max(start, 1.0)
        duty = generator.uniform(0.0, 1.0, (120, 2)) * generator.integers(0, 2, (120, 2))
        for T in (25.0, 110.0):
            states = np.array([T, T, 30.0, 30.0, T - 3.0, T + 3.0, start, start])
            cases = {
                "steps": ReducedModel(limb).rollout(np.r_[states, T, T], duty.repeat(4, 0))[:, 6:8],
                "planner": wires.integrate_states(states, duty, 0.4 * np.arange(120))[:, 6:8],
            }
            system = Limb(limb)
            simulator = make_simulator(system)
            context = simulator.get_mutable_context()
            context.SetContinuousState(np.r_[np.zeros(2), states, T, T])
            system.GetInputPort("duty").FixValue(context, duty[0])
            simulator.AdvanceTo(5.0)
            cases["Drake"] = context.get_continuous_state_vector().CopyToVector()[8:10]
            for name, share in cases.items():
                assert low <= share.min() + 1e-4, name  # the integrator's accuracy
                assert share.max() - 1e-4 <= high, name
            runs = OpenLoop(duty[:, None], 0.5, limb.segments[0])
            heat = [np.full((1, 1, 2), value) for value in (*states[::2], T)]
            rubber = {"stiffness": np.array([1.0]), "rest_angle": np.zeros(1)}
            limit = law.full_torque  # of the bend, (n + 1) / 2 torque / k
            _, _, bend = runs.simulate(law, np.full((1, 1), ROOM), heat, rubber)
            assert np.abs(bend).max() <= limit


def test_a_step_that_is_too_long_is_halved_where_it_diverges():
    """A coupled wire that a fit met, beside the law as it is, which does not diverge."""
    fast = {"latent_heat": 8.3, "stress_shift": 5.3, "backlash": 0.06, "play_share": 0.15}
    fast |= {"a1": -0.035, "a2": 23.3, "heating_middle": 71.5, "cooling_middle": 53.7}
    law, fields = CoupledLaw(), {}
    for name in vars(law):
        pair = [fast.get(name, getattr(law, name)), getattr(law, name)]
        fields[name] = np.array(pair)[:, None, None] * np.ones((2, 1, 2))
    start = [78.1, 49.8, 25.9, 65.5, 80.4, 0.07, 0.0, 76.5]  # T, S, R, B, P, xi, C, V

    def simulated(step, sets):
        runs = OpenLoop(np.zeros((round(10 / step), 1, 2)), step, LimbParameters().segments[0])
        chosen = {name: values[sets] for name, values in fields.items()}
        count = len(chosen["a1"])
        return runs.simulate(
            with_fields(CoupledLaw, chosen),
            np.full((count, 1), ROOM),
            [np.full((count, 1, 2), value) for value in start],
            {"stiffness": np.ones(count), "rest_angle": np.zeros(count)},
        )[0]

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        both = simulated(0.5, slice(None))
    np.testing.assert_allclose(both, simulated(1 / 32, slice(None))[::16], atol=0.3)
    alone = simulated(0.5, slice(1, None))
    np.testing.assert_array_equal(both[..., 1:], simulated(0.25, slice(1, None))[::2])
    assert np.abs(both[..., 1:] - alone).max() > 0.0  # it keeps its step where none diverges


def test_the_limb_has_the_law_written_out(planar_chain):
    """Heat, reading and torque of another wire on either side, in one diagram."""
    for kind in LAWS:
        parts = (
            {"stress_shift": 6.0, "creep_share": 0.2, "heating_drop": 0.1}
            if kind is CoupledLaw
            else {}
        )
        left = kind(**parts)
        right = dataclasses.replace(left, a1=-0.1, a2=25.0, a3=-0.7)
        limb, generator = limb_with(left, right), np.random.default_rng(3)
        angles, rates = generator.uniform(-0.4, 0.4, 5), generator.uniform(-2, 2, 5)
        T, S, V = np.array([[70.0, 50.0], [35.0, 45.0], [60.0, 55.0]])
        R, B, P, xi = np.array([[30.0, 32.0], [68.5, 52.0], [65.5, 55.0], [0.3, 0.8]])
        C = np.array([0.5, 0.2])
        D = np.array([0.4, 0.1])
        others = {HystereticLaw: [S, B, xi], CoupledLaw: [S, R, B, P, xi, C]}.get(kind, [S])
        system = Limb(limb)
        context = system.CreateDefaultContext()
        context.SetContinuousState(np.concatenate([angles, rates, T, *others, V]))
        system.GetInputPort("duty").FixValue(context, D)
        actual = system.EvalTimeDerivatives(context).CopyToVector()

        heating = np.array([-0.08, -0.1]) * (T - S) + np.array([20.0, 25.0]) * D
        expected = [heating, 0.004 * (T - S) - 0.012 * (S - 25.0)]
        shown = T
        if kind in (HystereticLaw, CoupledLaw):
            # Both are beyond the backlash of 1 °C, with a corner of 0.15 °C and a time of 0.3 s.
            free = T - 6.0 * xi if kind is CoupledLaw else T
            rise = 0.15 / 0.3 * np.log1p(np.exp((free - B - 1.0) / 0.15))
            fall = 0.15 / 0.3 * np.log1p(np.exp((B - free - 1.0) / 0.15))
            up, down = (free - 66) / 9, (58 - free) / 9
            slope = rise * (1 - xi) * logistic(up)
            slope -= fall * xi * logistic(down)
            path = [rise - fall, slope / 9]
        if kind is CoupledLaw:
            risen = 0.15 / 0.3 * np.log1p(np.exp((free - P - 4.0) / 0.15))
            fallen = 0.15 / 0.3 * np.log1p(np.exp((P - free - 4.0) / 0.15))
            F = logistic((P - 62) / 9)
            along = F * (1 - F) / 9 * (risen - fallen)
            lost = 0.01 * (T - 25) + 1e-4 * (T - 25) ** 2
            heating -= 0.1 * xi * np.array([20.0, 25.0]) * D
            expected[0] = heating - lost - 8.0 * (0.5 * slope / 9 + 0.5 * along)
            expected[1] = 0.004 * (T - S) - 0.012 * (S - R)
            expected.append(0.005 * (S - R) - 0.008 * (R - 25))
            z = 0.5 * xi + 0.5 * (F - logistic((25 - 4 - 62) / 9))
            path = [path[0], risen - fallen, path[1], 0.2 * (z - C)]
            shown = 0.9 * T + 0.1 * S
        expected += path if kind in (HystereticLaw, CoupledLaw) else []
        expected.append(np.array([1.0, 0.7]) * (shown - V))
        np.testing.assert_allclose(actual[10:], np.concatenate(expected), rtol=1e-9)
        torque = {
            TwoMassLaw: 4.7e-4 * (T - 25.0),
            ThresholdLaw: 4.9e-3 * (np.log1p(np.exp((T - 48) / 7)) - np.log1p(np.exp(-23 / 7))),
            SaturatingLaw: 0.035 * (logistic((T - 62) / 10) - logistic(-3.7)),
            HystereticLaw: 0.038 * xi,
            CoupledLaw: 0.038 * (0.8 * z + 0.2 * C) if kind is CoupledLaw else None,
        }[kind]
        force = np.full(5, torque[1] - torque[0])
        expected = planar_chain(limb).acceleration(angles, rates, force)
        np.testing.assert_allclose(actual[5:10], expected, rtol=1e-7)


def reference_shares(solver, turns: list[float]) -> list[np.ndarray]:
    """Austenite in simcoon's model of shape-memory alloy while T goes from turn to turn, °C.

    It is that of Lagoudas et al., Int. J. Plasticity 32-33 (2012), with smooth
    hardening, extended by Chatziathanasiou (2016), free of stress.
    """
    kelvin, smoothness = 273.15, [0.5] * 4
    transformation = np.array([68.0, 44.0, 54.0, 80.0]) + kelvin  # M_s, M_f, A_s, A_f
    elastic, strain = [7e4, 7e4, 0.3, 0.3, 0.0, 0.0], [0.03, 0.03, 0.02, 0.1]
    criterion = [100.0, 0.0, 2.0, 1e-6, 1e-3, 2.0, 1.0]
    props = [1, *elastic, *strain, 7.0, 7.0, *transformation, *smoothness, *criterion]
    turns = [110.0, *turns]  # austenite at first
    steps = [
        solver.StepMeca(
            control="stress",
            value=[0.0] * 6,
            ninc=round(2 * abs(end - start)),
            T_final=end + kelvin,
        )
        for start, end in itertools.pairwise(turns)
    ]
    results = solver.solve(
        [solver.Block(steps=steps)], "SMADI", props, 17, T_init=turns[0] + kelvin
    )
    austenite = 1.0 - results["Statev"][1]
    ends = np.cumsum([step.ninc for step in steps])
    return [
        austenite[start - 1 : end] for start, end in itertools.pairwise(ends)
    ]  # each from its turn on


def test_hysteresis_is_near_a_published_constitutive_model():
    """Four numbers are fitted to the major loop; minor loops are then predicted."""
    solver = pytest.importorskip("simcoon.solver")

    def difference(numbers, turns, reference):
        names = ["full_torque", "heating_middle", "cooling_middle", "width"]
        law = HystereticLaw(**dict(zip(names, map(float, numbers), strict=True)))
        ours = [
            np.interp(np.linspace(0, 1, round(2 * abs(end - start)) + 1), along, share)
            for (start, end), (T, share) in zip(
                itertools.pairwise(turns), shares(law, turns, step=0.5), strict=True
            )
            for along in [np.abs(T - start) / abs(end - start)]
        ]
        return law.full_torque * np.concatenate(ours) - reference

    major = [15.0, 100.0, 15.0]
    reference = np.concatenate(reference_shares(solver, major))
    fit = least_squares(
        difference, [1.0, 67.0, 49.0, 6.0], args=(major, reference), diff_step=1e-5
    ).x
    error = np.abs(difference(fit, major, reference))
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert error.max() < 0.06
    for minor in ([15.0, 67.0, 15.0], [15.0, 73.0, 15.0], [15.0, 100.0, 56.0, 100.0]):
        reference = np.concatenate(reference_shares(solver, minor))
        error = np.abs(difference(fit, minor, reference))
        assert np.sqrt(np.mean(error**2)) < 0.07
        # Just after a turn: there the law goes back at once, and the model waits.
        assert error.max() < 0.25
        assert error[-20:].max() < 0.02
