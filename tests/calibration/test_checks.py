"""Every trouble that a recording may have is recognized and named in one sentence."""

import copy
import dataclasses
import itertools
import re
import warnings

import numpy as np
import pytest
from loggers import logged
from pydrake.trajectories import PiecewisePolynomial

from calibration import (
    CalibrationError,
    Estimate,
    calibrate,
    check_recording,
    fit_damping,
    fit_force,
    fit_heat_transfer,
    fit_law,
    fit_stiffness,
    kind_of,
    kinds_of,
    load_recordings,
    validate,
)
from calibration.prediction.heated_run import HeatedRun
from calibration.recordings.files import read_folder, select_usable
from calibration.recordings.recording_checks import frozen_since
from calibration.recordings.repair import select_samples
from limb_systems import (
    Limb,
    LimbError,
    LimbParameters,
    LinearLaw,
    Recording,
    SegmentParameters,
    simulate,
)
from soft_limb.results.summaries import validation_summary

SPRING = Estimate(0.1, 0.0, "N·m/rad")


def test_good_recordings_are_what_they_are(model_recordings):
    """Also by slow loggers, and whatever their files are named."""
    for kind in kinds_of(LimbParameters()):
        (recording,) = model_recordings[kind]
        nameless = dataclasses.replace(recording, kind="")
        assert kind_of(nameless) == kind_of(nameless, "sag_3") == kind
        assert kind_of(nameless, "motion_1") == ("motion" if recording.duty.any() else kind)
        assert kind_of(dataclasses.replace(recording, kind="heated"), "motion_1") == "heated"
        for slow in (recording, logged(recording, 1.0) if recording.duty.any() else recording):
            check_recording(slow, kind)


@pytest.fixture
def right(model_recordings) -> Recording:
    return model_recordings["right"][0]


def changed(recording, **signals):
    """A recording with some of its signals made from its own."""
    return dataclasses.replace(recording, **{k: f(recording) for k, f in signals.items()})


def swap(name):
    return {name: lambda r: getattr(r, name)[::-1].copy()}


def left_reads(readings):
    """Other readings of the left thermocouple, made from those of the recording."""
    return {
        "measured_temperature": lambda r: np.vstack(
            [readings(r.measured_temperature[0]), r.measured_temperature[1]]
        )
    }


def noise(size):
    return lambda v: size * np.random.default_rng(0).normal(size=len(v))


TROUBLES = {
    "milliseconds": ({"time": lambda r: 1000 * r.time}, "Is time in milliseconds"),
    "milliseconds in the header, too": (
        {"time": lambda r: 1000 * r.time, "sample_rate": lambda r: r.sample_rate / 1000},
        r"samples come every 50 s, .* is time in milliseconds\?",
    ),
    "milliseconds of a fast logger": (
        {"time": lambda r: 90 * r.time, "sample_rate": lambda r: r.sample_rate / 90},
        r"nowhere faster than 0\.0\d\d °C/s; is time in milliseconds\?",
    ),
    "dead": (
        {"measured_temperature": lambda r: np.full_like(r.measured_temperature, 23.0)},
        r"right thermocouple is dead: it moves by 0\.0 °C",
    ),
    "swapped thermocouples": (swap("measured_temperature"), "the thermocouples are swapped"),
    "swapped outputs": (swap("duty"), "the wires' outputs are swapped"),
    "reversed bend": ({"bend_angle": lambda r: -r.bend_angle}, "bend sensor is reversed"),
    "radians": ({"bend_angle": lambda r: np.deg2rad(r.bend_angle)}, "is it in radians"),
    "kelvin": (
        {"measured_temperature": lambda r: r.measured_temperature + 273.15},
        "seems to be in kelvin",
    ),
    "fahrenheit": (
        {"measured_temperature": lambda r: 1.8 * r.measured_temperature + 32},
        "degrees Fahrenheit",
    ),
    "disconnected at zero": (
        left_reads(noise(1.0)),
        "left thermocouple reads -?0 °C, far below ambient and the others; is it connected",
    ),
    "disconnected and noisy": (
        left_reads(lambda v: 25.0 + noise(20.0)(v)),
        r"readings of the left thermocouple jump by \d+ °C",
    ),
    "frozen bend": (
        {"bend_angle": lambda r: np.full_like(r.bend_angle, 0.1)},
        r"bend angle stays at 5\.7° while wires are heated; is the bend sensor connected",
    ),
    "the camera's zero": (
        {"bend_angle": lambda r: r.bend_angle * (abs(r.time - 40.0) > 5.0)},
        r"bend sensor reads exactly 0 from 35\.00 s to 45\.00 s, and \d.* beside it",
    ),
    "hardly any bend": (
        {"bend_angle": lambda r: np.where(r.time > 0.9, np.nan, r.bend_angle)},
        r"the bend angle is there in 19 of \d+ samples, which tell nothing; leave this",
    ),
}


def test_trouble_is_named(right, model_recordings):
    for signals, message in TROUBLES.values():
        with pytest.raises(CalibrationError, match=message) as caught:
            check_recording(changed(right, **signals))
        assert "\n" not in str(caught.value)
    (both,) = model_recordings["both"]
    for signals, message in (
        TROUBLES["frozen bend"],
        (swap("duty"), "duty columns .* swapped"),
        (left_reads(lambda v: 0 * v + 23.0), "left thermocouple is dead"),
    ):
        with pytest.raises(CalibrationError, match=message):
            check_recording(changed(both, **signals), "both")


def test_what_is_swapped_is_named_wherever_the_limb_rests(model_recordings):
    for kind, rest in (("right", -11.0), ("left", 11.0)):
        (recording,) = model_recordings[kind]
        bent = dataclasses.replace(recording, bend_angle=recording.bend_angle + np.deg2rad(rest))
        for trouble in ("swapped thermocouples", "swapped outputs"):
            signals, message = TROUBLES[trouble]
            with pytest.raises(CalibrationError, match=message):
                check_recording(changed(bent, **signals))


def test_wires_may_be_hot_at_the_start(right):
    """Even where °F would be cold, or hottest of all; dead is what never moves."""
    measured = right.measured_temperature[1]
    for level in (77.0, measured.max() - 15.0):
        start = np.flatnonzero((abs(measured - level) < 3.0) & (right.time > 10.0))[0]
        warm = select_samples(right, right.time >= right.time[start])
        check_recording(warm, "right")
        for trouble in ("dead", "fahrenheit", "swapped thermocouples", "reversed bend"):
            signals, message = TROUBLES[trouble]
            with pytest.raises(CalibrationError, match=message):
                check_recording(changed(warm, **signals))


def with_gravity(recording, gravity):
    """A recording with another gravity in its header."""
    parameters = dataclasses.replace(recording.parameters, gravity=gravity)
    return dataclasses.replace(recording, parameters=parameters)


def test_kinds_and_mountings_that_make_no_sense_are_named(model_recordings, right):
    (swing,), (sag,) = model_recordings["ring_down"], model_recordings["sag"]
    with pytest.raises(CalibrationError, match=r"its kind is 'wave'; it must be one of sag, ring_"):
        kind_of(dataclasses.replace(swing, kind="wave"))
    still = dataclasses.replace(swing, bend_angle=0.1 * swing.bend_angle, kind="")
    assert kind_of(still, "ring_down_2") == "ring_down"
    with pytest.raises(CalibrationError, match=r"a limb at rest, .* does its header's gravity say"):
        kind_of(still, "sag_1")
    with pytest.raises(CalibrationError, match=r"gravity \[0\.0, -9\.81.* record it level"):
        check_recording(with_gravity(right, [0.0, -9.81, 0.0]), "right")
    with pytest.raises(CalibrationError, match=r"gravity is 98\.1 m/s², but it must be 9\.81"):
        check_recording(with_gravity(sag, [0.0, -98.1, 0.0]), "sag")


def spoilt(recording, sample=100):
    """With one reading that no limb has: as a bend sensor and a thermocouple may give."""
    angle, measured = recording.bend_angle.copy(), recording.measured_temperature.copy()
    angle[0, sample], measured[0, sample] = np.deg2rad(32767 / 64), 700.0
    return (
        dataclasses.replace(recording, bend_angle=angle),
        dataclasses.replace(recording, measured_temperature=measured),
    )


def test_a_value_that_no_limb_has_is_named(model_recordings, true_limb):
    """By everything that calculates with it."""
    right, both = model_recordings["right"][0], model_recordings["both"][0]
    (sag,), (ring,) = model_recordings["sag"], model_recordings["ring_down"]
    heat = fit_heat_transfer(right, 1, 25.0)
    uses = [
        (right, check_recording),
        (both, lambda recording: validate(true_limb, recording)),
        (sag, lambda recording: fit_stiffness(true_limb, [sag, recording])),
        (ring, lambda recording: fit_damping(true_limb, [ring, recording])),
        (right, lambda recording: fit_heat_transfer(recording, 1, 25.0)),
        (right, lambda recording: fit_force(true_limb, recording, 1, heat, SPRING)),
    ]
    for recording, use in uses:
        bent, hot = spoilt(recording)
        at = f"{recording.time[100]:g} s; it must stay from"
        with pytest.raises(LimbError, match=rf"bend_angle is \[8\.93.* at {at}"):
            use(bent)
        with pytest.raises(LimbError, match=r"measured_temperature is \[700\.0, "):
            use(hot)


def test_what_cannot_be_used_is_left_out_and_named(model_recordings, true_limb, tmp_path):
    """Interrupted recordings calibrate nothing, but validate; unfinished files are ignored."""
    right, both = (
        dataclasses.replace(
            select_samples(whole, whole.time < 20.0), interrupted="The cable is cut.", kind=kind
        )
        for kind in ("right", "both")
        for whole in model_recordings[kind]
    )
    right.save(tmp_path / "some_name.csv")
    model_recordings["left"][0].save(tmp_path / "left.csv")
    for name in ("right.unfinished.csv", "left.unfinished_2.csv"):
        (tmp_path / name).write_text("# limb recording, format 2\n")
    message = r"this was interrupted \(The cable is cut\), so record it again\."
    with pytest.warns(UserWarning, match=rf"some_name\.csv is left out: {message}"):
        assert list(load_recordings(tmp_path)) == ["left"]
    summary = validation_summary(validate(true_limb, both)).line()
    assert summary.endswith("until it was interrupted: The cable is cut")

    still = copy.deepcopy(model_recordings["ring_down"][0])
    still.bend_angle[:], still.source = 0.0, "still"
    (swing,) = model_recordings["ring_down"]
    slow = dataclasses.replace(
        swing, time=2.5 * swing.time, sample_rate=swing.sample_rate / 2.5, source="slow"
    )
    coarse = dataclasses.replace(
        select_samples(swing, np.arange(len(swing.time)) % 10 == 0),
        sample_rate=10.0,
        source="coarse",
    )
    swings = {"ring_down": [still, swing, slow, coarse]}
    wires = {wire: model_recordings[wire] for wire in ("right", "left")}
    found = calibrate(wires | swings, method="paper")
    assert found.damping.damping.value == pytest.approx(8e-4, rel=0.03)
    assert found.as_described == ["stiffness"]
    remarks = " ".join(map(str, found.remarks))
    assert "still is left out: The signal does not move; there" in remarks
    assert re.search(
        r"slow is left out: The limb rings at 1\.\d* Hz, but its model .* at 3\.9", remarks
    )
    assert re.search(r"coarse is left out: .* recorded at 10 Hz, but .* 3\.9 Hz; record", remarks)


BREAKS = {
    "one sample": lambda r: select_samples(r, r.time < r.time[1]),
    "a second": lambda r: select_samples(r, r.time < 1.2),
    "huge bend": lambda r: changed(r, bend_angle=lambda r: np.clip(4.0 * r.bend_angle, -3.1, 3.1)),
    "noise": lambda r: changed(
        r, bend_angle=lambda r: np.random.default_rng(0).uniform(-1.0, 1.0, r.bend_angle.shape)
    ),
    "uneven times": lambda r: changed(
        r, time=lambda r: r.time + noise(0.1)(r.time).clip(-0.4, 0.4) / r.sample_rate
    ),
    "huge temperature": lambda r: changed(
        r, measured_temperature=lambda r: np.minimum(10.0 * r.measured_temperature, 599.0)
    ),
    "hardly any duty": lambda r: changed(r, duty=lambda r: 1e-6 * r.duty),
}


def by_the_paper(kind, recording):
    """Values and errors of the fits to a recording of a kind."""
    limb = recording.parameters
    if kind == "sag":
        return fit_stiffness(limb, [recording]).stiffness.standard_error
    if kind == "ring_down":
        return fit_damping(limb, [recording]).damping.standard_error
    heat = fit_heat_transfer(recording, 1, 23.0)
    return fit_force(limb, recording, 1, heat, SPRING).beta.standard_error


def by_prediction(recording):
    runs = [HeatedRun.of(recording)]
    return fit_law(LinearLaw, runs, recording.parameters.segments[0], 23.0).covariance


@pytest.mark.parametrize("name", BREAKS)
def test_a_broken_recording_is_fitted_or_refused_in_one_sentence(
    model_recordings, monkeypatch, name
):
    """A minute of each kind. Some iterations by prediction are enough to break."""
    monkeypatch.setattr("calibration.prediction.law_fit.MAX_ITERATIONS", 2)
    for kind in ("right", "sag", "ring_down"):
        (whole,) = model_recordings[kind]
        short = changed(
            select_samples(whole, whole.time < 60.0),
            measured_temperature=lambda r: r.measured_temperature + noise(0.2)(r.time),
        )
        for fit in (lambda r, k=kind: by_the_paper(k, r), *[by_prediction] * (kind == "right")):
            refused = ""
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                try:
                    recording = BREAKS[name](short)
                    check_recording(recording, kind)
                    assert np.isfinite(fit(recording)).all()
                except LimbError as error:
                    refused = str(error)
            assert "\n" not in refused
            assert refused[-1:] in ".?"


def test_a_sensor_that_freezes_on_the_way_is_cut_there(emulated_folder):
    """Coarse sensors, and limbs at rest, are no fault."""
    recordings, _ = read_folder(emulated_folder)
    for recording in itertools.chain(*recordings.values()):
        assert frozen_since(recording) is None
        coarse = recording.measured_temperature.round()
        assert frozen_since(changed(recording, measured_temperature=lambda _, v=coarse: v)) is None
    (motion, *_) = recordings["motion"]
    for name in ("bend_angle", "measured_temperature"):
        readings = getattr(motion, name).copy()
        readings[0, 100:] = readings[0, 100]
        frozen = dataclasses.replace(motion, **{name: readings})
        with pytest.raises(CalibrationError, match="repeats one reading from 25"):
            check_recording(frozen)
        found = select_usable({"motion": [frozen]})
        assert found.heated["motion"][0].time[-1] < 25.0
        assert "repeats one reading" in str(found.left_out[0])


def test_readings_that_repeat_at_rest_or_of_coarse_sensors_are_no_fault():
    limb = LimbParameters(segments=[SegmentParameters(links=1, stiffness=0.0623)])
    levels = [[0.0, 0.0, 0.0, 0.0], [0.0, 0.2, 0.0, 0.0]]
    duty = PiecewisePolynomial.ZeroOrderHold([0.0, 2.0, 60.0, 200.0], levels)
    recording = simulate(Limb(limb), duty, 200.0, sample_rate=10.0)
    at_rest = 0.25 * np.round(recording.measured_temperature / 0.25)
    assert (at_rest[1, -300:] == at_rest[1, -1]).all()
    assert frozen_since(dataclasses.replace(recording, measured_temperature=at_rest)) is None
    step = np.deg2rad(2.0)
    coarse = step * np.round(recording.bend_angle / step)
    assert frozen_since(dataclasses.replace(recording, bend_angle=coarse)) is None
