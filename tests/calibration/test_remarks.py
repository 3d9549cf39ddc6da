"""Whether to plan with a calibration: the rules, one by one."""

import copy

import numpy as np

from calibration import Estimate, Validation
from calibration.remarks import (
    Severity,
    remarks_on_estimate,
)
from limb_systems import LimbParameters, Recording


def validation_that_misses_by(fraction: float) -> Validation:
    """Of a bend to and fro over 40°."""
    time = np.linspace(0.0, 10.0, 101)
    cold = np.full((2, 101), 25.0)
    limb = Recording(
        time=time,
        duty=np.zeros((2, 101)),
        measured_temperature=cold,
        bend_angle=np.deg2rad(20.0) * np.sin(2 * np.pi * time[np.newaxis] / 10.0),
        parameters=LimbParameters(),
        source="a test",
        sample_rate=10.0,
    )
    model = copy.deepcopy(limb)
    return Validation(limb, model, fraction * np.ptp(limb.bend_angle), 0.0, 0.0, 0.0)


def test_the_validation_s_error_counts_by_the_range_of_bend():
    for fraction, words in (
        (0.09, "Good enough to plan with: the model is 3.6° (9% of its range) from"),
        (0.11, "Use with care: the model is 4.4° (11% of its range) from"),
        (0.24, "Use with care: the model is 9.6° (24% of its range) from"),
        (0.26, "Do not plan with this: the model is 10.4° (26% of its range) from"),
    ):
        assert validation_that_misses_by(fraction).verdict.startswith(words)
    resting = validation_that_misses_by(0.0)
    resting.recording.bend_angle *= 0
    assert resting.verdict.startswith("Good enough")  # no division by zero


def test_what_the_data_do_not_tell_stops():
    assert remarks_on_estimate("β", Estimate(1.0, 0.9, "")) == []
    (remark,) = remarks_on_estimate("β", Estimate(-1.0, 1.1, ""))
    assert remark.severity == Severity.STOP
    assert remark.sentence == "The data do not determine β; record more trials of it."
