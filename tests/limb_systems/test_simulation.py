"""simulate(): when it samples, how accurate it is, what it refuses.

Accuracy is judged by the closed form of the heat, eqns (6)-(7), and for the
motion by an explicit integrator at tight accuracy.
"""

import numpy as np
import pytest
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.trajectories import PiecewisePolynomial

from limb_systems import (
    Limb,
    LimbError,
    LimbParameters,
    SegmentParameters,
    simulate,
)
from limb_systems.simulation import SimulationError, record


def small_limb(**segment) -> Limb:
    return Limb(LimbParameters(segments=[SegmentParameters(**{"links": 1, **segment})]))


def ramp(times, left, right) -> PiecewisePolynomial:
    """Piecewise linear duty."""
    return PiecewisePolynomial.FirstOrderHold(times, np.array([left, right], float))


# Accuracy


def heat_under_a_ramp(time, start, slope):
    """T and V of the nominal wire for D = start + slope t, from ambient.

    With e = T - T0: e = A + B t + C exp(a1 t), B = -a2 slope / a1,
    A = (B - a2 start) / a1, C = -A. And V - T0 = p + B t + q exp(a1 t) +
    r exp(a3 t) with p = A + B / a3, q = a3 C / (a3 - a1), r = -(p + q).
    """
    a1, a2, a3 = -0.07, 20.0, -1.0
    B = -a2 * slope / a1
    A = (B - a2 * start) / a1
    C = -A
    p, q = A + B / a3, a3 * C / (a3 - a1)
    wire = A + B * time + C * np.exp(a1 * time)
    measured = p + B * time + q * np.exp(a1 * time) - (p + q) * np.exp(a3 * time)
    return 25.0 + wire, 25.0 + measured


def test_heat_at_default_accuracy_is_within_a_thousandth_of_a_degree():
    recording = simulate(small_limb(links=5), ramp([0.0, 30.0], [0.4, 0.1], [0.0, 0.3]))
    for index, (start, slope) in enumerate([(0.4, -0.01), (0.0, 0.01)]):
        wire, measured = heat_under_a_ramp(recording.time, start, slope)
        np.testing.assert_allclose(recording.wire_temperature[index], wire, atol=1e-3)
        np.testing.assert_allclose(recording.measured_temperature[index], measured, atol=1e-3)
        assert np.ptp(wire) > 30


def test_pulse_between_two_samples_is_not_stepped_over():
    """A triangle of duty 0.2 s wide, seen through samples 10 s apart.

    It is a sum of three ramps, and so is its response.
    """
    duty = ramp([0.0, 13.7, 13.8, 13.9, 40.0], [0.0, 0.0, 1.0, 0.0, 0.0], np.zeros(5))
    recording = simulate(small_limb(), duty, sample_rate=0.1)
    after = recording.time[2:]
    ramps = [(13.7, 10.0), (13.8, -20.0), (13.9, 10.0)]
    wire = 25 + sum(heat_under_a_ramp(after - start, 0, slope)[0] - 25 for start, slope in ramps)
    assert wire[0] > 26
    np.testing.assert_allclose(recording.wire_temperature[0, 2:], wire, atol=0.01)
    np.testing.assert_allclose(recording.wire_temperature[0, :2], 25.0, atol=1e-9)


def explicit_bend_angle(limb, duty, times, initial_state) -> np.ndarray:
    simulator = Simulator(limb)
    ApplySimulatorConfig(
        SimulatorConfig(integration_scheme="runge_kutta3", accuracy=1e-9, max_step_size=0.01),
        simulator,
    )
    context = simulator.get_mutable_context()
    limb.GetInputPort("duty").FixValue(context, duty)
    context.SetContinuousState(initial_state)
    bends = []
    for time in times:
        simulator.AdvanceTo(time)
        bends.append(limb.GetOutputPort("bend_angle").Eval(context)[0])
    return np.array(bends)


def test_bend_angle_is_that_of_an_explicit_integrator():
    """Let go from a strong bend and heated at the same time."""
    state = np.concatenate([np.full(2, 0.4), np.zeros(2), np.full(4, 25.0)])
    duty, times = [0.0, 1.0], np.arange(11) / 20
    expected = np.degrees(explicit_bend_angle(small_limb(links=2), duty, times, state))
    assert np.ptp(expected) > 20
    for accuracy, tolerance_deg in [(1e-3, 0.01), (1e-6, 0.002)]:
        limb = small_limb(links=2)
        recording = simulate(limb, duty, 0.5, accuracy=accuracy, initial_state=state)
        np.testing.assert_allclose(recording.time, times, atol=1e-9)
        actual = np.degrees(recording.bend_angle[0])
        np.testing.assert_allclose(actual, expected, atol=tolerance_deg)


def test_a_stiff_limb_that_is_released_from_a_right_angle_is_simulated_to_its_end():
    """With smallest steps of 1.5 ms, Drake's implicit integrator tries the first one for ever."""
    limb = LimbParameters.in_space(links=3)
    segment = limb.segments[0]
    segment.length, segment.mass, segment.stiffness, segment.damping = 0.06, 0.014, 0.22, 1.66e-3
    limb.gravity = [9.81, 0.0, 0.0]
    W = len(limb.wires)
    angles = [0.797, 0.066, 0.066, 0.797, 0.797, 0.066]
    state = np.concatenate([angles, np.zeros(6), np.full(2 * W, 25.0)])
    recording = simulate(Limb(limb), np.zeros(W), 1.0, sample_rate=100, initial_state=state)
    bend = recording.bend_angle[0]
    assert bend.min() < -0.02  # it swings beyond where it ends
    assert abs(bend[-1]) < 1e-3


# Refusals


def test_duty_out_of_range_is_refused(refused):
    """Also between the samples, and if it is no number."""
    constant = [[0.1, 1.5], [-0.1, 0.2], [0.1, np.nan], [np.inf, 0.2], [1.0000001, 0.0]]
    knots = [0.0, 0.5, 1.0]
    ramps = [ramp(knots, [0.0, value, 0.0], [0.5] * 3) for value in (1.001, -1e-6, np.nan)]
    spike = ramp([0.0, 0.51, 0.52, 0.53, 1.0], [0.0, 0.0, 9.0, 0.0, 0.0], np.zeros(5))
    for duty in (*constant, *ramps, spike):
        with refused(SimulationError, "duty", "within 0 and 1"):
            simulate(small_limb(), duty, 1.0, sample_rate=20.0)


def test_wire_that_overheats_beyond_belief_is_refused_with_the_time(refused):
    hot = [0.0, 0.0, 25.0, 2500.0, 25.0, 25.0]
    with refused(LimbError, "temperature", "600", " s"):
        simulate(small_limb(), [0.0, 0.0], 1.0, initial_state=hot)


def test_duty_of_a_controller_beyond_its_range_is_named_and_not_hidden():
    builder = DiagramBuilder()
    limb = builder.AddSystem(Limb())
    duty = builder.AddSystem(ConstantVectorSource([0.0, 1.2]))
    with pytest.raises(LimbError, match=r"duty is \[0\.0, 1\.2\] at 0 s"):
        record(builder, limb, duty.get_output_port(), 0.2)
