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


def test_a_start_that_cannot_be_is_not_planned_with(pulses):
    """As where a logger's duty is late against its readings."""
    late = [
        dataclasses.replace(r, duty=np.pad(r.duty[:, :-50], ((0, 0), (50, 0)))) for r in pulses[0]
    ]
    calibration = calibrate({"heated": late}, LimbParameters(), laws=[SaturatingLaw])
    assert calibration.verdict.startswith("Do not plan with this: a recording starts at an imposs")
    assert "duty and readings are of the same time" in str(calibration.remarks[0])


def test_laws_are_judged_by_each_wire_that_is_fitted(pulses):
    """Not by the last recording, of a wire that the others do not heat."""
    right, left = pulses[0]
    for recordings, words in (
        ({"right": [right], "left": [left]}, "the last part of each recording"),
        ({"right": [right], "motion": [left]}, "the last part of each recording"),
        ({"heated": [right, left], "motion": [left]}, "1 motion left out"),
    ):
        found = calibrate(recordings, LimbParameters(), laws=[LinearLaw]).prediction
        assert words in found.judges
        judged = {tuple(p.run.duty.any(axis=0)) for p in found.best.judged}
        fitted = {tuple(p.run.duty.any(axis=0)) for p in found.best.fit.predicted}
        assert judged <= fitted


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


def test_a_camera_that_loses_the_limb_now_and_then_changes_nothing(pulses):
    """4% of the samples are off by 60°, some of them beside each other."""
    random = np.random.default_rng(0)
    for recording in pulses[1]:
        off = random.choice([0.0, 60.0, -60.0], recording.bend_angle.shape, p=[0.96, 0.02, 0.02])
        spoilt = dataclasses.replace(recording, bend_angle=recording.bend_angle + np.deg2rad(off))
        away = np.abs(HeatedRun.of(spoilt).bend - HeatedRun.of(recording).bend)
        assert np.rad2deg(away.max()) < 1.0
