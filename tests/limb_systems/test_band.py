"""Bands about a plan, against those of a linear limb on paper."""

import copy
import dataclasses

import numpy as np
import pytest

from limb_systems import CalibrationRecord, LimbError, LinearLaw, band

DEVIATION = 0.05  # of a2, relative


@pytest.fixture
def uncertain(fig5_plan):
    """The paper's plan for a limb of which the heating of one wire is not well known."""
    parameters = copy.deepcopy(fig5_plan.parameters)
    a2 = parameters.segments[0].wire("left").law.a2
    error = DEVIATION * a2
    parameters.calibration = CalibrationRecord(
        ["left.a2"], [a2], [error], [[error**2]], bend_error=0.01, temperature_error=0.8
    )
    return dataclasses.replace(fig5_plan, parameters=parameters)


def test_the_band_of_a_linear_limb_follows_from_its_one_parameter(uncertain):
    """V - T0 and the bend by this wire are proportional to its a2."""
    around = band(uncertain)
    form = 1.25 * 0.8  # a normal deviate's standard deviation is 1.25 of its mean size
    sampled = 0.2  # relative, of the deviation of 64 limbs

    def planned(signal):
        return np.array([np.interp(around.time, uncertain.time, row) for row in signal])

    left, right = 0, 1
    warmth = planned(uncertain.measured_temperature)[left] - 25.0
    expected = 2.6 * np.hypot(DEVIATION * warmth, form)
    np.testing.assert_allclose(around.measured_temperature[left], expected, rtol=sampled)
    np.testing.assert_allclose(around.measured_temperature[right], 2.6 * form, rtol=1e-9)
    highest = planned(uncertain.measured_temperature)[right].max()
    assert around.highest_readings[right] - highest == pytest.approx(2.6 * form, rel=0.05)

    segment = uncertain.parameters.segments[0]
    by_left = 3.0 * segment.wire("left").law.beta / segment.stiffness  # (5 + 1) / 2 joints
    bend = by_left * (planned(uncertain.wire_temperature)[left] - 25.0)
    sensor, drawn = segment.bend_sensor, np.random.default_rng(2).normal(size=(4, 20_000, 1))
    true = DEVIATION * bend * drawn[0] + 1.25 * 0.01 * drawn[1]
    read = true + sensor.noise * drawn[2] + sensor.drift * drawn[3]
    expected = np.quantile(np.abs(read), 0.95, axis=0)
    np.testing.assert_allclose(around.bend_reading, expected, rtol=sampled)


def test_there_is_no_band_of_a_limb_that_was_not_calibrated(fig5_plan):
    assert band(fig5_plan) is None


@dataclasses.dataclass
class WordLaw(LinearLaw):
    """A lab's law, of which a word chooses the equations."""

    cooling: str = "still"

    def rates(self, x, D, T0):
        return LinearLaw.rates(self, x, D if self.cooling == "fan" else 0.0, T0)


def test_a_law_with_a_word_has_the_band_of_its_equations(uncertain):
    """And wires of one limb have one class of law, and one word."""
    limb = copy.deepcopy(uncertain.parameters)
    for wire in limb.wires:
        wire.law = WordLaw(**vars(wire.law), cooling="fan")
    of_words = band(dataclasses.replace(uncertain, parameters=limb))
    expected = band(uncertain)
    np.testing.assert_allclose(of_words.bend_reading, expected.bend_reading, rtol=1e-9)
    np.testing.assert_allclose(of_words.highest_readings, expected.highest_readings, rtol=1e-9)
    limb.wires[0].law.cooling = "still"
    with pytest.raises(LimbError, match="several words for cooling, fan and still; use one"):
        band(dataclasses.replace(uncertain, parameters=limb))
    limb.wires[0].law = LinearLaw()
    with pytest.raises(LimbError, match="laws of several classes, LinearLaw and WordLaw; use one"):
        band(dataclasses.replace(uncertain, parameters=limb))
