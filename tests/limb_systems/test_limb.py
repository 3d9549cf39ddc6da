"""The whole diagram: ports, sizes, signs, eqn (12), scalar types, and state (14)."""

import dataclasses

import numpy as np
import pytest
from pydrake.symbolic import Expression, Variable

from limb_systems import (
    Limb,
    LimbError,
    LimbParameters,
    LinearLaw,
    SegmentParameters,
    WireParameters,
    from_paper_state,
    simulate,
    split_state,
    to_paper_state,
)

OUTPUTS = ["measured_temperature", "bend_angle", "wire_temperature", "joint_state", "measurement"]


def fast_limb(**segment) -> LimbParameters:
    """A limb whose wires settle within some seconds."""
    left = WireParameters("left", -0.003, law=LinearLaw(-1.0, 60.0, -4.0, 4e-4))
    right = WireParameters("right", 0.003, law=LinearLaw(-2.0, 90.0, -5.0, 6e-4))
    return LimbParameters(segments=[SegmentParameters(wires=[left, right], **segment)])


def random_state(rng, parameters) -> np.ndarray:
    n, num_wires = parameters.num_joints, len(parameters.wires)
    return np.concatenate(
        [rng.uniform(-0.5, 0.5, n), rng.uniform(-5, 5, n), rng.uniform(20, 100, 2 * num_wires)]
    )


def evaluate(limb, state, duty) -> np.ndarray:
    """Time derivatives and all outputs in one vector, of any scalar type."""
    context = limb.CreateDefaultContext()
    context.SetContinuousState(state)
    limb.GetInputPort("duty").FixValue(context, duty)
    derivatives = limb.EvalTimeDerivatives(context).CopyToVector()
    outputs = [limb.GetOutputPort(name).Eval(context) for name in OUTPUTS]
    return np.concatenate([derivatives, *outputs])


def test_ports_have_the_names_order_and_sizes_of_the_convention():
    limb = Limb()
    assert limb.num_input_ports() == 1
    assert limb.get_input_port(0).get_name() == "duty"
    assert limb.get_input_port(0).size() == 2
    ports = [limb.get_output_port(index) for index in range(limb.num_output_ports())]
    assert [(port.get_name(), port.size()) for port in ports] == [
        ("measured_temperature", 2),
        ("bend_angle", 1),
        ("wire_temperature", 2),
        ("joint_state", 10),
        ("measurement", 3),
    ]
    assert limb.num_continuous_states() == 14
    assert limb.IsDifferentialEquationSystem()


def test_duty_is_not_clipped():
    limb = Limb()
    state = np.append(np.zeros(10), [25.0] * 4)
    rates = evaluate(limb, state, [-0.5, 1.5])[10:12]
    np.testing.assert_allclose(rates, [-10.0, 30.0])


def test_heated_equilibrium_has_the_bend_of_eqn_12():
    for duty in [[0.0, 0.8], [0.9, 0.0], [0.5, 1.0]]:
        for links in [1, 5]:
            recording = simulate(Limb(fast_limb(links=links)), duty, 20.0, sample_rate=1.0)
            excess_left, excess_right = 60 / 1.0 * duty[0], 90 / 2.0 * duty[1]
            bend = (links + 1) / (2 * 0.1246) * (6e-4 * excess_right - 4e-4 * excess_left)
            assert abs(bend) > np.radians(2)
            assert recording.bend_angle[0, -1] == pytest.approx(bend, rel=1e-4)
            np.testing.assert_allclose(
                recording.joint_state[:links, -1], 2 * bend / (links + 1), rtol=1e-4
            )
            expected = [25 + excess_left, 25 + excess_right]
            np.testing.assert_allclose(recording.measured_temperature[:, -1], expected, rtol=1e-4)


def symbols(name: str, size: int):
    variables = [Variable(f"{name}_{index}") for index in range(size)]
    return variables, np.array([Expression(variable) for variable in variables])


def test_symbolic_implicit_dynamics_vanish_at_the_numeric_derivatives(planar_chain):
    """M θ̈ + ... - f in symbols: zero at θ̈ of the Lagrangian, not zero elsewhere."""
    for links in [2, 3]:
        parameters = fast_limb(links=links)
        limb, rng = Limb(parameters).ToSymbolic(), np.random.default_rng(6)
        state, duty = random_state(rng, parameters), rng.uniform(0, 1, 2)
        angles, rates, wire, measured = split_state(parameters, state)
        force = 6e-4 * (wire[1] - 25.0) - 4e-4 * (wire[0] - 25.0)
        acceleration = planar_chain(parameters).acceleration(angles, rates, np.full(links, force))
        wire_rate = np.array([-1.0, -2.0]) * (wire - 25.0) + np.array([60.0, 90.0]) * duty
        measured_rate = np.array([-4.0, -5.0]) * (measured - wire)
        derivatives = np.concatenate([rates, acceleration, wire_rate, measured_rate])

        names_x, symbols_x = symbols("x", len(state))
        names_u, symbols_u = symbols("u", 2)
        names_d, symbols_d = symbols("d", len(state))
        context = limb.CreateDefaultContext()
        context.SetContinuousState(symbols_x)
        limb.GetInputPort("duty").FixValue(context, symbols_u)
        proposed = limb.AllocateTimeDerivatives()
        proposed.SetFromVector(symbols_d)
        residual = limb.CalcImplicitTimeDerivativesResidual(context, proposed)

        def evaluated(derivatives):
            values = np.concatenate([state, duty, derivatives])
            where = dict(zip(names_x + names_u + names_d, values, strict=True))
            return np.array([expression.Evaluate(where) for expression in residual])

        np.testing.assert_allclose(evaluated(derivatives), 0.0, atol=1e-9)
        elsewhere = evaluated(derivatives + 0.01 * np.abs(derivatives).max())
        assert np.abs(elsewhere).min() > 1e-9


def test_paper_state_has_the_order_and_meaning_of_eqn_14(uneven_limb):
    rng = np.random.default_rng(8)
    state = random_state(rng, uneven_limb)
    paper = to_paper_state(uneven_limb, state)
    derivatives = evaluate(Limb(uneven_limb), state, rng.uniform(0, 1, 4))[:18]
    angles, measured, rates, measured_rate = np.split(paper, [5, 9, 14])
    np.testing.assert_array_equal(angles, state[:5])
    np.testing.assert_array_equal(rates, state[5:10])
    np.testing.assert_array_equal(measured, state[14:])
    np.testing.assert_allclose(measured_rate, derivatives[14:], rtol=1e-12)


def test_the_two_conversions_of_eqn_14_invert_each_other(uneven_limb):
    for shape in [(18,), (18, 1), (18, 6)]:
        values = np.random.default_rng(9).uniform(-50, 100, shape)
        there = from_paper_state(uneven_limb, to_paper_state(uneven_limb, values))
        back = to_paper_state(uneven_limb, from_paper_state(uneven_limb, values))
        assert there.shape == back.shape == shape
        np.testing.assert_allclose(there, values, atol=1e-11)
        np.testing.assert_allclose(back, values, atol=1e-11)


@dataclasses.dataclass
class PeakLaw(LinearLaw):
    """A law that arrays obey, but symbols do not."""

    def rates(self, x, D, T0):
        return [rate.max() for rate in LinearLaw.rates(self, x, D, T0)]


def test_a_law_that_fails_in_symbols_is_named_in_a_sentence():
    parameters = LimbParameters()
    for wire in parameters.wires:
        wire.law = PeakLaw()
    with pytest.raises(LimbError, match=r"law \(PeakLaw\) takes no symbols: .*attribute 'max'"):
        Limb(parameters)
