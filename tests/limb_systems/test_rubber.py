"""Rubber that rests bent, stiffens and remembers, against formulas written out by hand."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from limb_systems import (
    Limb,
    LimbModel,
    LimbParameters,
    LinearLaw,
    RestMemory,
    SegmentParameters,
    WireParameters,
    bend_angle,
)
from limb_systems.simulation import make_simulator
from limb_systems.statics import static_equilibrium

K = 0.1246  # N·m/rad, of the nominal limb


def limb_with(**rubber) -> LimbParameters:
    return LimbParameters(segments=[SegmentParameters(**rubber)])


def two_segments() -> LimbParameters:
    """All of it in both segments; three wires in the first, one of them off both axes."""
    wires = [
        WireParameters("low", -0.003, law=LinearLaw(a1=-0.1, a2=30.0, beta=3e-4)),
        WireParameters("high", 0.003, law=LinearLaw(a2=25.0)),
        WireParameters("slanting", 0.003, -0.004, law=LinearLaw(beta=6e-4)),
    ]
    return LimbParameters(
        segments=[
            SegmentParameters(
                links=3,
                stiffness=0.2,
                wires=wires,
                rest_angle=0.2,
                stiffening=0.5,
                rest_memory=RestMemory(0.04, 3.0),
            ),
            SegmentParameters(links=2, rest_angle=-0.1, stiffening=0.2, rest_memory=RestMemory()),
        ]
    )


def test_a_limb_rests_at_its_rest_angle_and_stays_there():
    parameters = two_segments()
    limb = Limb(parameters)
    context = limb.CreateDefaultContext()
    limb.GetInputPort("duty").FixValue(context, np.zeros(5))
    np.testing.assert_allclose(limb.GetOutputPort("bend_angle").Eval(context), [0.2, -0.1])
    rates = limb.EvalTimeDerivatives(context).CopyToVector()
    np.testing.assert_allclose(rates, 0.0, atol=1e-11)
    angles, _ = static_equilibrium(parameters)
    np.testing.assert_allclose(angles, [0.1] * 3 + [-0.2 / 3] * 2, rtol=1e-12)


def test_stiffening_adds_its_share_where_the_segment_bends_by_45_degrees():
    """Torque that bends from the rest angle by 45°, where the spring has 1 + s of k."""
    beyond = np.pi / 4 + 0.3
    for links, side in ((5, 1.0), (2, -1.0)):
        joint = 2 * (np.pi / 4) / (links + 1)
        warmer = K * 1.25 * joint / 4.7e-4
        wires = np.full(2, 25.0) + warmer * np.array([side < 0, side > 0])
        limb = limb_with(links=links, stiffening=0.25, rest_angle=side * 0.3)
        angles, compliance = static_equilibrium(limb, wires)
        assert bend_angle(limb, angles)[0] == pytest.approx(side * beyond, rel=1e-9)
        np.testing.assert_allclose(np.diag(compliance), 1 / (K * 1.75), rtol=1e-9)  # 1 + 3 s


def test_accelerations_equal_the_accelerations_of_the_hand_derived_chain(planar_chain):
    parameters = two_segments()
    parameters.gravity = [1.0, -9.0, 0.0]
    generator = np.random.default_rng(2)
    angles, rates = generator.uniform(-0.4, 0.4, 5), generator.uniform(-3, 3, 5)
    T, shifts = np.array([60.0, 70.0, 50.0, 40.0, 90.0]), np.array([0.02, -0.01])
    limb = Limb(parameters)
    context = limb.CreateDefaultContext()
    context.SetContinuousState(np.concatenate([angles, rates, T, shifts, T]))
    limb.GetInputPort("duty").FixValue(context, np.zeros(5))
    actual = limb.EvalTimeDerivatives(context).CopyToVector()[5:10]

    springs, links = np.array([0.2] * 3 + [K] * 2), np.array([3] * 3 + [2] * 2)
    rest = np.array([0.2] * 3 + [-0.1] * 2) * 2 / (links + 1)
    at_45 = np.pi / 2 / (links + 1)
    bent = angles - rest
    torques = [
        6e-4 * 0.6 * 25.0 + 4.7e-4 * 45.0 - 3e-4 * 35.0,
        4.7e-4 * (65.0 - 15.0),
    ]
    force = np.repeat(torques, [3, 2]) + springs * 2 * np.repeat(shifts, [3, 2]) / (links + 1)
    force -= springs * np.array([0.5] * 3 + [0.2] * 2) * (bent / at_45) ** 2 * bent
    expected = planar_chain(parameters).acceleration(angles, rates, force + springs * rest)
    np.testing.assert_allclose(actual, expected, rtol=1e-8)


def test_the_memory_has_the_rates_of_its_law_written_out():
    parameters = two_segments()
    wires = LimbModel.of(parameters).wires
    assert wires.state_names[5:] == ["rest_shift_1", "rest_shift_2"]
    assert len(wires.cold_states) == wires.num_states == 7
    np.testing.assert_array_equal(wires.heat_scales[5:7], 0.03)
    T, shifts = np.array([60.0, 70.0, 50.0, 40.0, 90.0]), np.array([0.02, -0.01])
    D = np.array([0.5, 0.2, 0.1, 0.03, 0.2])
    a1, a2 = np.array([-0.1, -0.07, -0.07, -0.07, -0.07]), np.array([30.0, 25.0, 20.0, 20.0, 20.0])
    torque_rates = np.array([3e-4, 4.7e-4, 6e-4, 4.7e-4, 4.7e-4]) * (a1 * (T - 25.0) + a2 * D)
    bend = np.array([1.0, 1.0, 0.6, 1.0, 1.0]) / [0.1, 0.1, 0.1, 2 * K / 3, 2 * K / 3]
    rates = bend * torque_rates
    p = rates / (1.0 + np.exp(-rates / 0.01))  # a soft ramp
    to = 0.04
    first = 3.0 * (p[0] * (-to - 0.02) + p[1] * (to - 0.02) + p[2] * (to - 0.02))
    second = 2.0 * (p[3] * (-0.0305 + 0.01) + p[4] * (0.0305 + 0.01))
    actual = wires.rates(np.append(T, shifts), D)
    np.testing.assert_allclose(actual[5:], [first, second], rtol=1e-9)


def simulated_states(limb: LimbParameters, duty, duration: float, start=None) -> np.ndarray:
    """The state of the `Limb` after a time of constant duty."""
    system = Limb(limb)
    simulator = make_simulator(system, 1e-3)
    context = simulator.get_mutable_context()
    system.GetInputPort("duty").FixValue(context, duty)
    if start is not None:
        context.SetContinuousState(start)
    simulator.AdvanceTo(duration)
    return context.get_continuous_state_vector().CopyToVector()


def test_a_cold_limb_rests_on_the_side_of_the_wire_that_was_hot_last():
    limb = limb_with(links=2, stiffness=K / 2, rest_memory=RestMemory(0.03, 2.0), rest_angle=0.1)
    for wire in limb.wires:
        wire.law = LinearLaw(a1=-1.0, a2=150.0)  # which cools soon
    state, rests = None, []
    for duty in ([0.0, 0.8], [0.8, 0.0]):
        state = simulated_states(limb, duty, 1.0, state)
        state = simulated_states(limb, [0.0, 0.0], 8.0, state)
        np.testing.assert_allclose(state[4:6], 25.0, atol=0.05)
        rests.append(bend_angle(limb, state[:2])[0])
    assert 0.1 + 0.005 < rests[0] < 0.13
    assert 0.07 < rests[1] < 0.1 - 0.005
    assert rests[1] == pytest.approx(0.1 + state[6], abs=1e-3)


def test_settled_wires_have_the_memory_of_being_heated_at_once():
    """Both wires heated within a second, in proportion; the shift bends the limb at rest."""
    limb = limb_with(rest_memory=RestMemory(0.03, 2.0))
    wires, ends = LimbModel.of(limb).wires, np.array([45.0, 85.0])

    def slope(_, states):
        rate = ends - 25.0
        return wires.rates(states, (rate + 0.07 * (states[:2] - 25.0)) / 20.0)

    actual = solve_ivp(slope, (0.0, 1.0), [25.0, 25.0, 0.0], rtol=1e-9, atol=1e-12).y[:, -1]
    settled = wires.settled_states(ends)
    np.testing.assert_allclose(settled, actual, rtol=1e-6)
    assert settled[2] > 0.005
    angles, _ = static_equilibrium(limb, ends)
    np.testing.assert_allclose(angles, 4.7e-4 * 40.0 / K + settled[2] / 3, rtol=1e-9)
    for equal in (70.0, 25.0):
        assert wires.settled_states(np.full(2, equal))[2] == pytest.approx(0.0, abs=1e-15)
