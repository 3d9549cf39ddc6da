"""simulate(): when it samples, how accurate it is, what it refuses.

Accuracy is judged by the closed form of the heat, eqns (6)-(7), and for the
motion by an explicit integrator at tight accuracy.
"""

import numpy as np
import pytest
import scipy.linalg
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput
from pydrake.trajectories import PiecewisePolynomial

from limb_systems import (
    Limb,
    LimbError,
    LimbParameters,
    SegmentParameters,
    ThresholdLaw,
    simulate,
)
from limb_systems.limb import make_manipulator
from limb_systems.simulation import (
    SimulationError,
    jump_times,
    last_sample_time,
    make_simulator,
    record,
)


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


@pytest.mark.parametrize("frequency", [10.0, 50.0])
def test_pwm_heats_as_its_mean(frequency):
    """Error control would step over most pulses of 2 ms; the ripple of T is 0.4 °C and less."""
    on = np.arange(0.0, 8.0, 1 / frequency)
    breaks = np.append(np.column_stack([on, on + 0.1 / frequency]).ravel(), 8.0)
    levels = np.append(np.tile([[0.0, 0.0], [1.0, 0.0]], len(on)), [[0.0], [0.0]], axis=1)
    pulses = simulate(small_limb(), PiecewisePolynomial.ZeroOrderHold(breaks, levels))
    mean = simulate(small_limb(), [0.0, 0.1], 8.0)
    missed = pulses.wire_temperature - mean.wire_temperature
    np.testing.assert_allclose(missed, 0.0, atol=0.11 * 20.0 / frequency)
    np.testing.assert_allclose(pulses.bend_angle, mean.bend_angle, atol=2.5e-3 * 20.0 / frequency)


def test_duty_that_jumps_faster_than_a_system_reads_it_raises_a_warning():
    breaks = np.arange(0.0, 0.1, 5e-4)
    fast = PiecewisePolynomial.ZeroOrderHold(breaks, np.arange(2 * len(breaks)).reshape(2, -1) % 2)
    with pytest.warns(UserWarning, match="jumps after 0.5 ms already: its wires respond to the"):
        simulate(small_limb(), fast)
    slower = PiecewisePolynomial.ZeroOrderHold(
        40 * breaks, np.tile([[0.0], [1.0]], 200).reshape(2, -1)
    )
    assert not len(jump_times(slower))


def energy(limb: LimbParameters, joint_state: np.ndarray) -> float:
    plant = make_manipulator(limb)
    context = plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(context, joint_state)
    return plant.CalcPotentialEnergy(context) + plant.CalcKineticEnergy(context)


@pytest.mark.parametrize("amplitude", [1e-2, 1e-3])
def test_small_swings_keep_their_energy_at_the_accuracy_for_them(amplitude):
    """At 16 Hz, by the first mode's own decay; radau3 at 1e-3 would take 15% and 70% of it."""
    limb = LimbParameters(gravity=[0.0, 0.0, 0.0])
    limb.segments[0].stiffness, limb.segments[0].damping = 1.4752, 1e-6
    plant = make_manipulator(limb)
    masses = plant.CalcMassMatrix(plant.CreateDefaultContext())
    squares, modes = scipy.linalg.eigh(1.4752 * np.eye(5), masses)
    swing = amplitude * modes[:, 0] / np.abs(modes[:, 0]).max()
    state = np.concatenate([swing, np.zeros(5), np.full(4, 25.0)])
    seen = simulate(Limb(limb), [0.0, 0.0], 1.0, accuracy=1e-3 * amplitude, initial_state=state)
    left = energy(limb, seen.joint_state[:, -1]) / energy(limb, seen.joint_state[:, 0])
    assert left == pytest.approx(np.exp(-squares[0] * 1e-6 / 1.4752), abs=2e-3)


def test_a_law_with_a_threshold_is_not_simulated_in_the_smallest_steps():
    """Those that the error control would hold on to are 0.1 ms, in which 60 s take minutes."""
    limb = LimbParameters()
    for wire in limb.wires:
        wire.law = ThresholdLaw()
    builder = DiagramBuilder()
    system = builder.AddSystem(Limb(limb))
    duty = builder.AddSystem(ConstantVectorSource([0.0, 0.3]))
    builder.Connect(duty.get_output_port(), system.GetInputPort("duty"))
    LogVectorOutput(system.GetOutputPort("joint_state"), builder, 0.05)
    simulator = make_simulator(builder.Build(), 1e-4)
    simulator.AdvanceTo(2.0)
    assert simulator.get_num_steps_taken() < 2000  # 9400 with smallest steps of 0.1 ms


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


def test_bend_angle_equals_the_result_of_an_explicit_integrator():
    """Let go from a strong bend and heated at the same time."""
    state = np.concatenate([np.full(2, 0.4), np.zeros(2), np.full(4, 25.0)])
    duty, times = [0.0, 1.0], np.arange(6) / 20
    expected = np.degrees(explicit_bend_angle(small_limb(links=2), duty, times, state))
    assert np.ptp(expected) > 20
    for accuracy, tolerance_deg in [(1e-3, 0.01), (1e-6, 0.002)]:
        limb = small_limb(links=2)
        recording = simulate(limb, duty, 0.25, accuracy=accuracy, initial_state=state)
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


def test_the_last_tick_of_drakes_clock_is_within_a_simulation():
    """For example the 96th of 20 Hz, which is later than 96 / 20 s by rounding."""
    assert 96 * (1 / 20) > 96 / 20
    for rate in (7.0, 20.0, 30.0, 100.0):
        for count in range(1, 500):
            end = last_sample_time(count / rate, rate)
            assert count * (1 / rate) <= end < count / rate + 1e-9


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
