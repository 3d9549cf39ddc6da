"""Recordings that are broken in some way are refused in one sentence, or calibrated."""

import contextlib
import dataclasses
import warnings

import numpy as np
import pytest

from calibration import (
    Estimate,
    calibrate,
    check_recording,
    fit_damping,
    fit_force,
    fit_heat_transfer,
    fit_law,
    fit_stiffness,
)
from calibration.prediction.heated_run import HeatedRun
from limb_systems import LimbError, LimbParameters, LinearLaw, Recording

SIGNALS = ("time", "duty", "measured_temperature", "bend_angle")


@pytest.fixture(scope="module")
def short(model_recordings) -> dict[str, Recording]:
    """The beginning of a recording of each kind."""
    random = np.random.default_rng(0)
    result = {}
    for kind, (recording,) in model_recordings.items():
        kept = part(recording, 0, int(60.0 * recording.sample_rate))
        noise = 0.2 * random.normal(size=kept.measured_temperature.shape)
        result[kind] = dataclasses.replace(
            kept, measured_temperature=kept.measured_temperature + noise
        )
    return result


def part(recording, start, end, every=1):
    """Some samples of a recording."""
    signals = {name: getattr(recording, name)[..., start:end:every] for name in SIGNALS}
    return dataclasses.replace(
        recording,
        **signals,
        sample_rate=recording.sample_rate / every,
        reference=None,
        joint_state=None,
        wire_temperature=None,
    )


def changed(recording, **signals):
    return dataclasses.replace(part(recording, 0, None), **signals)


def uneven(recording):
    random = np.random.default_rng(0)
    shift = random.uniform(-0.4, 0.4, len(recording.time)) / recording.sample_rate
    return changed(recording, time=recording.time + shift)


BREAKS = {
    "one sample": lambda r: part(r, 0, 1),
    "two samples": lambda r: part(r, 0, 2),
    "a second": lambda r: part(r, 0, int(1.2 * r.sample_rate)),
    "some seconds": lambda r: part(r, 0, int(6.0 * r.sample_rate)),
    "zeros": lambda r: changed(
        r, measured_temperature=0 * r.measured_temperature, bend_angle=0 * r.bend_angle
    ),
    "no bend": lambda r: changed(r, bend_angle=0 * r.bend_angle),
    "no temperature": lambda r: changed(r, measured_temperature=0 * r.measured_temperature + 25.0),
    "huge bend": lambda r: changed(r, bend_angle=np.clip(4.0 * r.bend_angle, -3.1, 3.1)),
    "huge temperature": lambda r: changed(
        r, measured_temperature=np.minimum(10.0 * r.measured_temperature, 599.0)
    ),
    "full duty": lambda r: changed(r, duty=np.where(r.duty > 0, 1.0, 0.0)),
    "hardly any duty": lambda r: changed(r, duty=1e-6 * r.duty),
    "noise": lambda r: changed(
        r, bend_angle=np.random.default_rng(0).uniform(-1.0, 1.0, r.bend_angle.shape)
    ),
    "uneven times": uneven,
    "backwards": lambda r: changed(
        r, measured_temperature=r.measured_temperature[:, ::-1], bend_angle=r.bend_angle[:, ::-1]
    ),
    "late": lambda r: changed(r, time=r.time + 1e6),
    "a sample each second": lambda r: part(r, 0, None, int(r.sample_rate)),
}

OF_HEAT = ("no temperature", "huge temperature", "full duty", "hardly any duty")  # not of the rest


def calibrated_or_refused(recordings, method):
    """Whether recordings are calibrated; any trouble must be one sentence of ours."""
    refused = None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            calibration = calibrate(recordings, method=method, laws=[LinearLaw])
        except LimbError as error:
            refused = str(error)
    if refused is not None:
        assert "\n" not in refused
        assert refused.endswith((".", "?"))
        return False
    errors = [estimate.standard_error for estimate in calibration.estimates.values()]
    assert np.isfinite(errors).all()
    return True


def beta(recording):
    heat = fit_heat_transfer(recording, 1, 23.0)
    return fit_force(recording.parameters, recording, 1, heat, Estimate(0.1, 0.0, "N·m/rad")).beta


FITS = {
    "right": beta,
    "sag": lambda recording: fit_stiffness(recording.parameters, [recording]).stiffness,
    "ring_down": lambda recording: fit_damping(recording.parameters, [recording]).damping,
}


def test_broken_recordings_by_the_paper(short):
    for name, broken in BREAKS.items():
        kinds = ("right",) if name in OF_HEAT else FITS
        for kind in kinds:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                with contextlib.suppress(LimbError):
                    recording = broken(short[kind])
                    check_recording(recording, kind)
                    assert np.isfinite(FITS[kind](recording).standard_error)


def test_broken_recordings_by_prediction(short, monkeypatch):
    """After some iterations, which is enough to break."""
    monkeypatch.setattr("calibration.prediction.law_fit.MOST_ITERATIONS", 2)
    segment = LimbParameters().segments[0]
    for broken in BREAKS.values():
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with contextlib.suppress(LimbError):
                recording = broken(short["right"])
                check_recording(recording, "heated")
                fit = fit_law(LinearLaw, [HeatedRun.of(recording)], segment, 23.0)
                assert np.isfinite(fit.covariance).all()


def test_subsets_of_kinds_by_prediction(short, monkeypatch):
    monkeypatch.setattr("calibration.prediction.law_fit.MOST_ITERATIONS", 2)
    for kinds in ((), ("sag",), ("both",), ("sag", "right", "left")):
        enough = bool({"right", "left", "both"} & set(kinds))
        assert calibrated_or_refused({k: [short[k]] for k in kinds}, "prediction") == enough
