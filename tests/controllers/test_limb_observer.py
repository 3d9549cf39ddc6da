"""The observer in a diagram: what it shows of limbs whose heat and torques are known."""

import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial

from controllers import LimbObserver
from hardware import LimbTwin
from limb_systems import Limb, LimbParameters, simulate


def course_of(levels, seconds):
    return PiecewisePolynomial.ZeroOrderHold(
        np.linspace(0.0, seconds, len(levels) + 1), np.transpose([*levels, levels[-1]])
    )


def observed(fed, parameters, recording):
    return fed(
        LimbObserver(parameters),
        {
            "duty": recording.duty.T,
            "measured_temperature": recording.measured_temperature.T,
            "bend_angle": recording.bend_angle.T,
        },
    )


def test_it_knows_the_temperature_of_emulated_wires(fed):
    """Within 3 °C nearly always, although the limb is not calibrated and thermocouples lag."""
    levels = np.random.default_rng(6).uniform(0.0, 0.45, (10, 2))
    recording = simulate(LimbTwin(seed=14, truth=True), course_of(levels, 20.0), 20.0)
    shown = observed(fed, LimbParameters(), recording)
    missed = np.abs(shown.wire_temperature.T - recording.wire_temperature)
    lag = np.abs(recording.measured_temperature - recording.wire_temperature)
    assert np.percentile(lag, 95) > 4.0
    assert np.percentile(missed, 95) < 3.0
    assert np.mean(missed < 2 * shown.temperature_deviation.T) > 0.9


def test_it_finds_a_torque_from_outside(fed):
    """A rest angle of 6° that it does not know is what 2 k 6° / (n + 1) would hold, by (11)."""
    bent, known = LimbParameters(), LimbParameters()
    bent.segments[0].rest_angle = np.deg2rad(6.0)
    recording = simulate(Limb(bent), course_of([[0.2, 0.4], [0.4, 0.2]], 10.0), 10.0)
    shown = observed(fed, known, recording)
    torque = 2 * known.segments[0].stiffness * np.deg2rad(6.0) / (known.segments[0].links + 1)
    assert shown.torque_disturbance[-1, 0] == pytest.approx(torque, rel=0.1)
    explained = shown.bend_angle + shown.sensor_drift
    assert np.rad2deg(np.abs(explained.T - recording.bend_angle))[:, 20:].max() < 0.5
    assert (shown.believed == 1.0).all()


def test_it_says_which_sensor_it_does_not_believe(fed):
    limb = LimbParameters()
    recording = simulate(Limb(limb), course_of([[0.3, 0.5]], 3.0), 3.0)
    spoilt = recording.bend_angle.T.copy()
    spoilt[30:] += np.deg2rad(30.0)
    readings = recording.measured_temperature.T.copy()
    readings[40:, 1] = np.nan
    shown = fed(
        LimbObserver(limb),
        {"duty": recording.duty.T, "measured_temperature": readings, "bend_angle": spoilt},
    )
    np.testing.assert_array_equal(shown.believed[30], [1, 1, 1])
    np.testing.assert_array_equal(shown.believed[31:41], np.tile([1, 1, 0], (10, 1)))
    np.testing.assert_array_equal(shown.believed[41:], np.tile([1, 0, 0], (20, 1)))


def test_it_foretells_the_highest_temperature_of_the_next_second(fed):
    """(6) with constant duty: one wire warms, the other one was warmest at first."""
    limb = LimbParameters()
    warm, duty = np.array([80.0, 40.0]), np.array([0.0, 0.9])
    shown = fed(
        LimbObserver(limb),
        {"duty": [duty], "measured_temperature": [warm], "bend_angle": [[np.nan]]},
    )
    law, T0 = limb.segments[0].wire("right").law, limb.ambient_temperature
    end = T0 - law.a2 * 0.9 / law.a1
    later = end + (40.0 - end) * np.exp(law.a1 * 1.0)
    np.testing.assert_allclose(shown.highest_temperature[0], [80.0, later], atol=0.05)


def test_what_it_foretells_has_the_heat_that_the_law_does_not_know(fed):
    """A supply of 10% more voltage heats by 21% more, 2.5 °C/s."""
    known, limb = LimbParameters(), LimbParameters()
    for wire in limb.wires:
        wire.law.a2 *= 1.21
    recording = simulate(Limb(limb), course_of([[0.0, 0.6]], 5.0), 5.0)
    shown = observed(fed, known, recording)
    foretold, then = shown.highest_temperature[60, 1], recording.wire_temperature[1, 80]
    assert foretold == pytest.approx(then, abs=2.0)
