"""Recordings as labs have them, of a limb of another physics than models and emulation."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from calibration import calibrate
from calibration.prediction.heated_run import HeatedRun
from calibration.prediction.law_fit import fit_law
from limb_systems import LimbParameters, LinearLaw, SaturatingLaw

sys.path.insert(0, str(Path(__file__).parent))
from own_limb import OwnLimb

SIGNALS = ("time", "duty", "measured_temperature", "bend_angle")
PULSES = {"right": (1, 0.9, 2.0), "left": (0, 0.8, 2.2)}  # index, duty and duration


def pulse(limb, wire, start):
    index, level, duration = PULSES[wire]
    return limb.record([(index, level, start, duration)], 60.0)


@pytest.fixture(scope="module")
def pulses():
    """One of each wire, with heat from 0 and from 1.2 s; and the same a few minutes later."""
    limb, result = OwnLimb(4), []
    for starts in ((0.0, 1.2), (5.0, 5.0)):
        for wire, start in zip(PULSES, starts, strict=True):
            result.append(pulse(limb, wire, start))
            limb.record([], 180.0)
    return result[:2], result[2:]


def test_heat_from_the_beginning_leaves_the_start_at_the_room(pulses):
    """The first seconds show heat, not where the wires and the silicone were before."""
    recorded, again = pulses
    segment = LimbParameters().segments[0]
    fit = fit_law(SaturatingLaw, [HeatedRun.of(r) for r in recorded], segment, 22.0)
    assert np.abs(fit.nuisances - 22.0).max() < 8.0
    for predicted in fit.predict([HeatedRun.of(recording) for recording in again]):
        assert np.rad2deg(predicted.bend_error) < 2.0
        assert predicted.temperature_error < 2.0


def test_what_is_missing_is_fitted_without(pulses):
    """Readings of some seconds, rows that were lost, and half of the samples of one sensor."""
    whole = pulses[1]
    gappy = []
    for recording in whole:
        bend, measured = recording.bend_angle.copy(), recording.measured_temperature.copy()
        bend[0, 200:300] = np.nan
        measured[1, 100:130] = np.nan
        bend[0, 400::3] = np.nan
        holes = dataclasses.replace(recording, bend_angle=bend, measured_temperature=measured)
        kept = np.ones(len(bend[0]), bool)
        kept[[150, 151, 350]] = False
        signals = {n: getattr(holes, n)[..., kept] for n in SIGNALS}
        gappy.append(dataclasses.replace(holes, **signals))
    fits = [
        calibrate({"heated": recordings}, LimbParameters(), laws=[LinearLaw]).prediction.fit
        for recordings in (whole, gappy)
    ]
    for name, estimate in fits[0].estimates.items():
        assert abs(fits[1].estimates[name].value - estimate.value) < 2 * estimate.standard_error
