"""Laws of wires in warm silicone against closed forms, and hysteresis against another model."""

import dataclasses
import itertools

import numpy as np
import pytest
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from scipy.linalg import expm
from scipy.optimize import least_squares

from limb_systems import (
    HystereticLaw,
    Limb,
    LimbParameters,
    SaturatingLaw,
    ThresholdLaw,
    TwoMassLaw,
    Wires,
    simulate,
)

LAWS = [TwoMassLaw, ThresholdLaw, SaturatingLaw, HystereticLaw]
ROOM = 25.0


def limb_with(left, right) -> LimbParameters:
    limb = LimbParameters()
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
        Limb(limb_with(law, law)), [0.0, 0.3], 60.0, sample_rate=0.1, accuracy=1e-8
    )
    found = [recording.wire_temperature[1], recording.measured_temperature[1]]
    for k, time in enumerate(recording.time):
        T, _, V, _ = expm(np.array(rates) * time) @ [0.0, 0.0, 0.0, 0.3]
        np.testing.assert_allclose([row[k] for row in found], [25 + T, 25 + V], atol=1e-4)
    # In the end the silicone passes on all that it gets.
    (settled,) = Wires(limb_with(law, law)).at_constant_duty(
        np.full(4, 25.0), np.array([0.0, 0.3]), np.array([2000.0])
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


def test_torque_saturates_at_that_of_the_transformed_wire():
    law = SaturatingLaw(full_torque=0.04, middle=60.0, width=5.0)
    cold = 0.04 / (1.0 + np.exp(7.0))
    T = np.array([25.0, 60.0, 400.0])
    expected = [0.0, 0.02 - cold, 0.04 - cold]
    np.testing.assert_allclose(law.torque([T, None], ROOM, 0.0), expected, rtol=1e-9, atol=1e-18)


def shares(law: HystereticLaw, turns: list[float], share: float = 0.0) -> list[np.ndarray]:
    """ξ at each half degree while T goes from turn to turn, much faster than u switches."""
    courses = []
    for start, end in itertools.pairwise(turns):
        rate = 100.0 * law.switching_rate * np.sign(end - start)

        def slope(T, xi, rate=rate):
            """dξ/dT, with the silicone as warm as the wire."""
            return law.rates([T, T, xi], rate / law.a2, ROOM)[2] / rate

        T, course = np.linspace(start, end, round(2 * abs(end - start)) + 1), [share]
        for before, after in itertools.pairwise(T):  # by the classical Runge-Kutta method
            step, middle = after - before, (before + after) / 2
            k1 = slope(before, share)
            k2 = slope(middle, share + step / 2 * k1)
            k3 = slope(middle, share + step / 2 * k2)
            k4 = slope(after, share + step * k3)
            share = share + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            course.append(share)
        courses.append(np.array(course))
    return courses


def test_hysteresis_follows_the_closed_forms_of_duhems_law():
    """dξ/dT integrated by hand: ln(1 - ξ) falls on heating, ln ξ on cooling, by a softplus."""
    law = HystereticLaw(heating_middle=64.0, cooling_middle=52.0, width=5.0)
    heating, cooling, again = shares(law, [15.0, 68.0, 45.0, 100.0])
    T = np.linspace(15.0, 68.0, len(heating))
    left = (1 + np.exp((15.0 - 64.0) / 5)) / (1 + np.exp((T - 64.0) / 5))
    np.testing.assert_allclose(heating, 1 - left, atol=1e-7)
    np.testing.assert_allclose(heating, logistic((T - 64.0) / 5), atol=1e-4)  # from far below
    T = np.linspace(68.0, 45.0, len(cooling))
    kept = (1 + np.exp((52.0 - 68.0) / 5)) / (1 + np.exp((52.0 - T) / 5))
    np.testing.assert_allclose(cooling, heating[-1] * kept, atol=1e-7)
    T = np.linspace(45.0, 100.0, len(again))
    left = (1 + np.exp((45.0 - 64.0) / 5)) / (1 + np.exp((T - 64.0) / 5))
    np.testing.assert_allclose(again, 1 - (1 - cooling[-1]) * left, atol=1e-7)


def test_minor_loops_are_monotone_within_the_major_one_and_do_not_creep():
    law = HystereticLaw()
    up, down = shares(law, [20.0, 120.0, 20.0])
    for course in shares(law, [20.0, 70.0, 55.0, 66.0, 50.0, 120.0]):
        steps = np.diff(course)
        assert (steps > 0).all() or (steps < 0).all()
        assert 0.0 <= course.min() <= course.max() <= 1.0
    inner_up, inner_down = shares(law, [60.0, 72.0, 60.0], up[80])
    assert up[80] < inner_down[-1] < down[-81]
    assert (np.diff(inner_up) > 0).all()
    # At the duty that holds T nothing changes, whatever the history.
    T, S, xi = 66.0, 40.0, np.linspace(0.0, 1.0, 11)
    held = -law.a1 * (T - S) / law.a2
    np.testing.assert_allclose(law.rates([T, S, xi], held, ROOM)[2], 0.0, atol=1e-15)


def test_settled_hysteretic_wires_are_on_the_curve_of_heating():
    """They were heated from cold and held; what is transformed stays so."""
    law = HystereticLaw()
    T = np.array([80.0, 60.0])
    silicone = 25.0 + (T - 25.0) * 0.004 / 0.016
    start, end = np.exp((25.0 - 66.0) / 9.0), np.exp((T - 66.0) / 9.0)
    expected = [*T, *silicone, *(1.0 - (1.0 + start) / (1.0 + end))]
    np.testing.assert_allclose(Wires(limb_with(law, law)).settled_states(T), expected, rtol=1e-9)


@pytest.mark.parametrize("kind", LAWS)
def test_drakes_derivatives_are_those_of_complex_steps(kind):
    law, step = kind(), 1e-30
    point = np.array([*[70.0, 40.0, 0.4][: len(law.states)], 0.35, 55.0])

    def outputs(values):
        *x, D, V = values
        return [*law.rates(x, D, ROOM), law.torque(x, ROOM, 0.0), law.reading_rate(V, x)]

    found = np.array(outputs(InitializeAutoDiff(point)[:, 0]))
    moved = [outputs(point + 1j * step * one) for one in np.eye(len(point))]
    np.testing.assert_allclose(ExtractValue(found)[:, 0], outputs(point), rtol=1e-13)
    np.testing.assert_allclose(
        ExtractGradient(found), np.imag(moved).T / step, rtol=1e-11, atol=1e-15
    )


@pytest.mark.parametrize("kind", LAWS)
def test_the_limb_has_the_law_written_out(kind, planar_chain):
    """Heat, reading and torque of another wire on either side, in one diagram."""
    left = kind()
    right = dataclasses.replace(left, a1=-0.1, a2=25.0, a3=-0.7)
    limb, generator = limb_with(left, right), np.random.default_rng(3)
    angles, rates = generator.uniform(-0.4, 0.4, 5), generator.uniform(-2, 2, 5)
    T, S, xi, V = np.array([[70.0, 50.0], [35.0, 45.0], [0.3, 0.8], [60.0, 55.0]])
    D = np.array([0.4, 0.1])
    others = [S, xi] if kind is HystereticLaw else [S]
    system = Limb(limb)
    context = system.CreateDefaultContext()
    context.SetContinuousState(np.concatenate([angles, rates, T, *others, V]))
    system.GetInputPort("duty").FixValue(context, D)
    found = system.EvalTimeDerivatives(context).CopyToVector()

    heating = np.array([-0.08, -0.1]) * (T - S) + np.array([20.0, 25.0]) * D
    expected = [heating, 0.004 * (T - S) - 0.012 * (S - 25.0)]
    if kind is HystereticLaw:
        up = logistic(heating / 1.0)
        slope = up * (1 - xi) * logistic((T - 66) / 9) + (1 - up) * xi * logistic((58 - T) / 9)
        expected.append(slope / 9 * heating)
    expected.append(np.array([1.0, 0.7]) * (T - V))
    np.testing.assert_allclose(found[10:], np.concatenate(expected), rtol=1e-9)
    torque = {
        TwoMassLaw: 4.7e-4 * (T - 25.0),
        ThresholdLaw: 4.9e-3 * (np.log1p(np.exp((T - 48) / 7)) - np.log1p(np.exp(-23 / 7))),
        SaturatingLaw: 0.035 * (logistic((T - 62) / 10) - logistic(-3.7)),
        HystereticLaw: 0.038 * xi,
    }[kind]
    force = np.full(5, torque[1] - torque[0])
    expected = planar_chain(limb).acceleration(angles, rates, force)
    np.testing.assert_allclose(found[5:10], expected, rtol=1e-7)


@pytest.mark.parametrize("kind", LAWS)
def test_the_yaml_brings_back_the_law(kind, tmp_path):
    limb = limb_with(kind(a1=-0.123), kind())
    limb.save(tmp_path / "limb.yaml")
    loaded = LimbParameters.load(tmp_path / "limb.yaml")
    assert loaded == limb
    assert type(loaded.wires[0].law) is kind


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


def test_hysteresis_is_near_that_of_a_published_constitutive_model():
    """Four numbers are fitted to the major loop; minor loops are then predicted."""
    solver = pytest.importorskip("simcoon.solver")

    def difference(numbers, turns, reference):
        names = ["full_torque", "heating_middle", "cooling_middle", "width"]
        law = HystereticLaw(**dict(zip(names, map(float, numbers), strict=True)))
        ours = law.torque([None, None, np.concatenate(shares(law, turns))], ROOM, 0.0)
        return ours - reference

    major = [15.0, 100.0, 15.0]
    reference = np.concatenate(reference_shares(solver, major))
    fit = least_squares(
        difference, [1.0, 70.0, 55.0, 6.0], args=(major, reference), diff_step=1e-5
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
