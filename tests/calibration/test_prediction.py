"""Calibration by prediction error, on data of known laws."""

import dataclasses

import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial

from calibration import CalibrationError, calibrate
from calibration.collecting.excitation import excitations
from calibration.prediction.heated_run import HeatedRun
from calibration.prediction.law_fit import fit_law
from calibration.prediction.selection import beaten, compare_laws, simplest_unbeaten
from limb_systems import (
    HystereticLaw,
    Limb,
    LimbParameters,
    LinearLaw,
    Recording,
    RestMemory,
    SaturatingLaw,
    ThresholdLaw,
    TwoMassLaw,
    simulate,
)
from limb_systems.model.ensemble import OpenLoop, draw_ensemble, stacked

AMBIENT = 22.0
LAWS = {
    "linear": lambda: LinearLaw(a1=-0.06, a2=18.0, a3=-0.8),
    "two masses": lambda: TwoMassLaw(a1=-0.09, a2=24.0, a3=-0.7),
    "threshold": lambda: ThresholdLaw(a2=23.0, a3=-0.8, knee=45.0),
    "saturating": lambda: SaturatingLaw(a2=22.0, a3=-0.6, middle=65.0),
    "hysteretic": lambda: HystereticLaw(a2=21.0, a3=-0.9, heating_middle=69.0),
}


def limb_with(law) -> LimbParameters:
    limb = LimbParameters(ambient_temperature=AMBIENT)
    left, right = limb.wires
    left.law, right.law = law(), law()
    right.law.a2 *= 1.1
    return limb


def recordings_of(limb: LimbParameters, *names: str) -> list[Recording]:
    """Of the model itself, by Drake, with some of the excitations.

    Duty changes just after samples, as that of controllers does, so that the sample after shows it.
    """
    recordings = []
    for excitation in excitations(2):
        if excitation.name in names:
            course = later(excitation.duty)
            recordings.append(simulate(Limb(limb), course, sample_rate=10.0))
    return recordings


def later(course: PiecewisePolynomial) -> PiecewisePolynomial:
    """Steps of duty, each 1 ms later."""
    times = np.array(course.get_segment_times())
    levels = [course.value(t)[:, 0] for t in times]
    times[1:] += 1e-3
    return PiecewisePolynomial.ZeroOrderHold(times, np.transpose(levels))


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_found_again_in_its_own_data(name, monkeypatch):
    """By another integrator than Drake's, from other values; "told" within their errors."""
    monkeypatch.setattr(
        "calibration.collecting.excitation.LEVEL_STEP", 2.0
    )  # each step takes Drake long
    limb = limb_with(LAWS[name])
    courses = [HeatedRun.of(r) for r in recordings_of(limb, "conditioning", "ramps")]
    fit = fit_law(type(limb.wires[0].law), courses, LimbParameters().segments[0], AMBIENT + 0.3)
    applied = LimbParameters().segments[0]
    fit.apply(applied)
    for wire, law in zip(limb.wires, (w.law for w in applied.wires), strict=True):
        for field in dataclasses.fields(law):
            estimate = fit.estimates[f"{wire.name}.{field.name}"]
            away = abs(estimate.value - getattr(wire.law, field.name))
            assert away < max(0.02 * abs(estimate.value), 1.5 * estimate.standard_error), estimate
    assert max(p.bend_error for p in fit.predicted) < np.deg2rad(0.15)
    assert max(p.temperature_error for p in fit.predicted) < 0.3


def test_spikes_do_not_pull():
    limb = limb_with(LAWS["two masses"])
    (recording,) = recordings_of(limb, "conditioning")
    clean = fit_law(TwoMassLaw, [HeatedRun.of(recording)], LimbParameters().segments[0], AMBIENT)
    bend, measured = recording.bend_angle.copy(), recording.measured_temperature.copy()
    bend[0, ::97] += np.deg2rad(60.0)
    measured[1, ::53] = 200.0
    spoiled = dataclasses.replace(recording, bend_angle=bend, measured_temperature=measured)
    fit = fit_law(TwoMassLaw, [HeatedRun.of(spoiled)], LimbParameters().segments[0], AMBIENT)
    for name, estimate in clean.estimates.items():
        assert abs(fit.estimates[name].value - estimate.value) < 1.5 * estimate.standard_error


def test_the_simplest_law_that_predicts_as_well_is_used():
    limb = limb_with(LAWS["two masses"])
    *heated, motion = recordings_of(limb, "conditioning", "pulses", "motion_1")
    noise = np.random.default_rng(0)
    courses = []
    for recording in (*heated, motion):
        noisy = dataclasses.replace(
            recording,
            bend_angle=recording.bend_angle + noise.normal(0, 0.008, recording.bend_angle.shape),
        )
        courses.append(HeatedRun.of(noisy))
    candidates, best = compare_laws(
        (LinearLaw, TwoMassLaw, SaturatingLaw),
        courses[:-1],
        courses[-1:],
        LimbParameters().segments[0],
        AMBIENT,
        options=("rest_memory",),
    )
    assert [c.name for c in candidates][:3] == ["LinearLaw", "TwoMassLaw", "SaturatingLaw"]
    assert candidates[-1].name == "TwoMassLaw + rest_memory"
    assert best.name == "TwoMassLaw"
    assert beaten(candidates[0], candidates[1])
    assert not beaten(candidates[1], candidates[2])
    assert simplest_unbeaten(candidates[1:3]) is candidates[1]


def test_the_open_loop_is_the_diagram_with_rubber_that_remembers():
    """Against Drake's simulation of the whole limb, with its mechanics."""
    limb = limb_with(LAWS["hysteretic"])
    segment = limb.segments[0]
    segment.rest_angle, segment.stiffening = 0.05, 0.3
    segment.rest_memory = RestMemory(0.03, 2.0)
    (recording,) = recordings_of(limb, "conditioning")
    course = HeatedRun.of(recording)
    law, ambient, rubber = stacked([limb])
    cold = [np.full((1, 1, 2), value) for value in law.cold_states(AMBIENT)]
    open_loop = OpenLoop(course.duty[:, np.newaxis], 0.5, segment)
    _, readings, bends = open_loop.simulate(
        law, ambient[:, np.newaxis], [*cold, np.full((1, 1, 2), AMBIENT)], rubber
    )
    reading, bend = course.interpolated(readings[:, 0, 0], bends[:, 0, 0])
    assert np.abs(reading - course.temperature).max() < 0.8
    assert np.rad2deg(np.abs(bend - course.bend)).mean() < 0.1


def test_draws_scatter_as_the_covariance_says():
    limb = limb_with(LAWS["threshold"])
    courses = [HeatedRun.of(r) for r in recordings_of(limb, "conditioning")]
    fit = fit_law(ThresholdLaw, courses, LimbParameters().segments[0], AMBIENT)
    known = fit.calibrated(LimbParameters())
    draws = draw_ensemble(known, 2000)
    for wire in (0, 1):
        values = np.array([[d.wires[wire].law.a2, d.wires[wire].law.knee] for d in draws])
        name = known.wires[wire].name
        for column, field in enumerate(("a2", "knee")):
            estimate = fit.estimates[f"{name}.{field}"]
            assert values[:, column].mean() == pytest.approx(estimate.value, rel=0.01)
            assert values[:, column].std() == pytest.approx(estimate.standard_error, rel=0.1)


def test_calibrates_from_any_heated_recordings():
    limb = limb_with(LAWS["two masses"])
    heated = recordings_of(limb, "conditioning")
    calibration = calibrate({"heated": heated}, LimbParameters(), laws=(TwoMassLaw,))
    assert calibration.parameters.wires[1].law.a2 == pytest.approx(22.0 * 1.2, rel=0.05)
    assert calibration.prediction is not None
    assert "last part of each recording" in calibration.prediction.judges
    record = calibration.parameters.calibration
    assert record is not None
    assert record.bend_error > 0
    assert record.temperature_error > 0
    assert LimbParameters.from_yaml(calibration.parameters.to_yaml()) == calibration.parameters
    with pytest.raises(CalibrationError, match="There are no recordings"):
        calibrate({"ring_down": []} | {"sag": recordings_of(limb)}, LimbParameters())


def test_a_course_has_even_steps_of_any_samples():
    """5 Hz with a drifting clock, and 20 Hz: the same steps of duty and readings."""
    limb = limb_with(LAWS["linear"])
    levels = PiecewisePolynomial.ZeroOrderHold(
        [0.0, 4.0, 11.0, 20.0], [[0, 0.3, 0, 0], [0, 0, 0.2, 0]]
    )
    levels = later(levels)
    fast = HeatedRun.of(simulate(Limb(limb), levels, sample_rate=20.0))
    slow = HeatedRun.of(simulate(Limb(limb), levels, sample_rate=5.0))
    np.testing.assert_allclose(fast.duty, slow.duty, atol=0.15)
    np.testing.assert_allclose(fast.duty.sum(axis=0), slow.duty.sum(axis=0), atol=0.1)
    at_slow = np.array([np.interp(slow.times, fast.times, v) for v in fast.temperature.T]).T
    np.testing.assert_allclose(at_slow, slow.temperature, atol=0.3)


def test_what_is_held_out_has_heat():
    """Though most of the end is rest: an eighth of the heat, which is in the first half."""
    limb = limb_with(LAWS["linear"])
    levels = PiecewisePolynomial.ZeroOrderHold([0.0, 30.0, 60.0], [[0.3, 0, 0], [0.1, 0, 0]])
    course = HeatedRun.of(simulate(Limb(limb), levels, sample_rate=5.0))
    early, late = course.held_out(0.12, 0.4)
    assert late.times[0] == pytest.approx(36.0, abs=0.5)
    assert len(early.times) + len(late.times) == len(course.times)
    assert len(late.duty) == len(course.duty)
