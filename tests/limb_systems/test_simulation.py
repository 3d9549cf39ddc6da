"""simulate(): when it samples, how accurate it is, what it refuses.

Accuracy is judged by the closed form of the heat, eqns (6)-(7), and for the
motion by an explicit integrator at tight accuracy.
"""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.trajectories import CompositeTrajectory, PiecewisePolynomial

from limb_systems import (
    Limb,
    LimbError,
    LimbParameters,
    PlanCheck,
    SegmentParameters,
    Trajectory,
    simulate,
)
from limb_systems.simulation import SimulationError, record


def small_limb(**segment) -> Limb:
    return Limb(LimbParameters(segments=[SegmentParameters(**{"links": 1, **segment})]))


def ramp(times, left, right) -> PiecewisePolynomial:
    """Piecewise linear duty."""
    return PiecewisePolynomial.FirstOrderHold(times, np.array([left, right], float))


def planned(duty, time) -> Trajectory:
    """A trajectory of one link that asks for this duty."""
    knots = len(time)
    ambient = np.full((2, knots), 25.0)
    return Trajectory(
        time=time,
        reference=np.zeros((1, knots)),
        duty=duty,
        joint_state=np.zeros((2, knots)),
        wire_temperature=ambient,
        measured_temperature=ambient,
        parameters=LimbParameters(segments=[SegmentParameters(links=1)]),
        check=PlanCheck(),
    )


# Samples


def test_samples_reach_from_zero_to_the_duration():
    """Also where the duration is a multiple of the period but for rounding, or none."""
    for duration, rate, samples in [
        (1.0, 20.0, 21),
        (0.25, 100.0, 26),
        (60.0, 0.5, 31),
        (0.3, 10.0, 4),
        (2.3, 10.0, 24),
        (0.57, 100.0, 58),
        (0.99, 10.0, 10),
    ]:
        recording = simulate(small_limb(), [0.1, 0.2], duration, sample_rate=rate)
        np.testing.assert_allclose(recording.time, np.arange(samples) / rate, atol=1e-9)
        assert recording.sample_rate == rate


def test_samples_of_a_trajectory_count_from_its_own_start():
    """D = t/2 after the start, wherever on the clock that is."""
    for start in (0.0, 0.03, 100.01, -1.0):
        duty = ramp([start, start + 1.0], [0.0, 0.5], [0.0, 0.25])
        recording = simulate(small_limb(), duty, sample_rate=20.0)
        np.testing.assert_allclose(recording.time, np.arange(21) / 20, atol=1e-9)
        expected = np.outer([0.5, 0.25], recording.time)
        np.testing.assert_allclose(recording.duty, expected, atol=1e-9)
        assert recording.measured_temperature[0, 0] == 25.0


def test_planned_trajectory_runs_from_its_first_to_its_last_knot():
    time = np.array([5.0, 5.5, 6.5])
    duty = np.array([[0.0, 0.4, 0.2], [0.1, 0.1, 0.3]])
    recording = simulate(small_limb(), planned(duty, time), sample_rate=4.0)
    np.testing.assert_allclose(recording.time, [0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5], atol=1e-9)
    np.testing.assert_allclose(recording.duty[0], [0.0, 0.2, 0.4, 0.35, 0.3, 0.25, 0.2], atol=1e-9)


def test_duration_cuts_a_trajectory_short():
    duty = ramp([0.0, 10.0], [0.0, 1.0], [0.0, 0.0])
    recording = simulate(small_limb(), duty, 2.0, sample_rate=10.0)
    assert recording.time[-1] == pytest.approx(2.0)
    assert recording.duty[0, -1] == pytest.approx(0.2)


def test_duty_at_its_limits_is_recorded_within_them():
    """Interpolation between 1 and 1 may round to 1 + 2e-16, which no recording takes."""
    times = np.linspace(0, 1, 8)
    recording = simulate(small_limb(), ramp(times, np.ones(8), np.zeros(8)), sample_rate=97.0)
    np.testing.assert_allclose(recording.duty[0], 1.0, atol=1e-15)
    assert recording.duty.max() <= 1.0
    assert recording.duty.min() >= 0.0


def test_recording_tells_where_it_comes_from(uneven_limb):
    recording = simulate(Limb(uneven_limb), [0.1, 0.2, 0.3, 0.4], 0.5)
    assert recording.source == "model"
    assert recording.parameters == uneven_limb
    np.testing.assert_array_equal(recording.duty[:, -1], [0.1, 0.2, 0.3, 0.4])
    assert recording.bend_angle.shape == (2, 11)
    assert recording.joint_state.shape == (10, 11)


def test_initial_state_is_where_it_starts():
    state = np.array([0.1, -2.0, 40.0, 50.0, 60.0, 70.0])
    recording = simulate(small_limb(), [0.0, 0.0], 0.5, initial_state=state)
    np.testing.assert_array_equal(recording.joint_state[:, 0], [0.1, -2.0])
    np.testing.assert_array_equal(recording.wire_temperature[:, 0], [40.0, 50.0])
    np.testing.assert_array_equal(recording.measured_temperature[:, 0], [60.0, 70.0])
    assert recording.bend_angle[0, 0] == pytest.approx(0.1, rel=1e-12)


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


def test_heat_at_tighter_accuracy_is_within_a_millionth_of_a_degree():
    recording = simulate(small_limb(), [0.3, 0.0], 20.0, accuracy=1e-7)
    wire, measured = heat_under_a_ramp(recording.time, 0.3, 0.0)
    np.testing.assert_allclose(recording.wire_temperature[0], wire, atol=1e-6)
    np.testing.assert_allclose(recording.measured_temperature[0], measured, atol=1e-6)
    np.testing.assert_allclose(recording.wire_temperature[1], 25.0, atol=1e-9)


def test_pulse_between_two_samples_is_not_stepped_over():
    """A triangle of duty 0.2 s wide, seen through samples 10 s apart.

    It is a sum of three ramps, and so is its response.
    """
    duty = ramp([0.0, 13.7, 13.8, 13.9, 40.0], [0.0, 0.0, 1.0, 0.0, 0.0], np.zeros(5))
    recording = simulate(small_limb(), duty, sample_rate=0.1)
    after = recording.time[2:]
    knots = [0.0, 0.5, 1.0]
    ramps = [ramp(knots, [0.0, value, 0.0], [0.5] * 3) for value in (1.001, -1e-6, np.nan)]
    spike = ramp([0.0, 0.51, 0.52, 0.53, 1.0], [0.0, 0.0, 9.0, 0.0, 0.0], np.zeros(5))
    for duty in (*constant, *ramps, spike):
        with refused(SimulationError, "duty", "within 0 and 1"):
            simulate(small_limb(), duty, 1.0, sample_rate=20.0)


def test_initial_state_that_is_no_state_of_the_limb_is_refused(refused):
    for state in ([], [0.0, 0.0], np.zeros(7), np.zeros((2, 3)), [0, 0, np.nan, 25, 25, 25]):
        with refused(SimulationError, "initial_state"):
            simulate(small_limb(), [0.1, 0.2], 1.0, initial_state=state)


def test_wire_that_overheats_beyond_belief_is_refused_with_the_time(refused):
    hot = [0.0, 0.0, 25.0, 2500.0, 25.0, 25.0]
    with refused(LimbError, "temperature", "600", " s"):
        simulate(small_limb(), [0.0, 0.0], 1.0, initial_state=hot)


def test_a_limb_that_is_part_of_a_diagram_already_is_refused(refused):
    limb = small_limb()
    simulate(limb, [0.1, 0.2], 0.1)
    with refused(SimulationError, "diagram"):
        simulate(limb, [0.1, 0.2], 0.1)


def test_duty_of_a_controller_beyond_its_range_is_named_and_not_hidden():
    builder = DiagramBuilder()
    limb = builder.AddSystem(Limb())
    duty = builder.AddSystem(ConstantVectorSource([0.0, 1.2]))
    with pytest.raises(LimbError, match=r"duty is \[0\.0, 1\.2\] at 0 s"):
        record(builder, limb, duty.get_output_port(), 0.2)


def test_controller_whose_duty_is_no_number_ends_the_simulation_with_a_sentence(refused):
    builder = DiagramBuilder()
    limb = builder.AddSystem(Limb())
    duty = builder.AddSystem(ConstantVectorSource([0.0, np.nan]))
    with refused(SimulationError, "stopped at 0 s of 0.2 s", "NaN"):
        record(builder, limb, duty.get_output_port(), 0.2)


def test_trajectory_that_starts_late_and_cannot_be_shifted_is_refused(refused):
    late = CompositeTrajectory([PiecewisePolynomial.ZeroOrderHold([1.0, 2.0], np.zeros((2, 2)))])
    with refused(SimulationError, "starts at 1 s", "must start at 0 s"):
        simulate(small_limb(), late)
