"""Every trouble that a recording may have is recognized and named."""

import copy
import dataclasses

import numpy as np
import pytest

from calibration import (
    CalibrationError,
    Estimate,
    calibrate,
    check_recording,
    fit_damping,
    fit_force,
    fit_heat_transfer,
    fit_stiffness,
    kind_of,
    kinds_of,
    load_recordings,
    validate,
)
from calibration.recordings.at_rest import ambient_temperature
from calibration.recordings.repair import part
from limb_systems import LimbError, LimbParameters, Recording
from soft_limb.results.summaries import validation_summary


def test_good_recordings_are_what_they_are(model_recordings, logged):
    """Also by slow loggers, and whatever their files are named."""
    for kind in kinds_of(LimbParameters()):
        (recording,) = model_recordings[kind]
        nameless = dataclasses.replace(recording, kind="")
        assert kind_of(nameless) == kind_of(nameless, "sag_3") == kind
        assert kind_of(nameless, "motion_1") == ("motion" if recording.duty.any() else kind)
        assert kind_of(dataclasses.replace(recording, kind="heated"), "motion_1") == "heated"
        assert check_recording(recording, kind) == kind
        for rate in (5.0, 1.0) if recording.duty.any() else ():
            assert check_recording(logged(recording, rate), kind) == kind


@pytest.fixture
def right(model_recordings) -> Recording:
    return model_recordings["right"][0]


def changed(recording, **signals):
    """A recording with some of its signals made from its own."""
    return dataclasses.replace(recording, **{k: f(recording) for k, f in signals.items()})


def swap(name):
    return {name: lambda r: getattr(r, name)[::-1].copy()}


def at_zero(recording, noise):
    """Readings of a thermocouple that is not connected."""
    return noise * np.random.default_rng(0).normal(size=len(recording.time))


TROUBLES = {
    "milliseconds": ({"time": lambda r: 1000 * r.time}, "Is time in milliseconds"),
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
    "disconnected at zero": (
        {"measured_temperature": lambda r: np.vstack([at_zero(r, 1.0), r.measured_temperature[1]])},
        "left thermocouple reads -?0 °C, far below ambient and the others; is it connected",
    ),
    "disconnected and noisy": (
        {
            "measured_temperature": lambda r: np.vstack(
                [at_zero(r, 20.0) + 25, r.measured_temperature[1]]
            )
        },
        r"readings of the left thermocouple jump by \d+ °C",
    ),
    "dead and unheated": (
        {"measured_temperature": lambda r: np.vstack([at_zero(r, 0.0), r.measured_temperature[1]])},
        "left thermocouple reads 0 °C, far below ambient and the others; is it connected",
    ),
    "frozen bend": (
        {"bend_angle": lambda r: np.full_like(r.bend_angle, 0.1)},
        r"bend angle stays at 5\.7° while wires are heated; is the bend sensor connected",
    ),
    "milliseconds in the header, too": (
        {"time": lambda r: 1000 * r.time, "sample_rate": lambda r: r.sample_rate / 1000},
        r"samples come every 50 s, .* is time in milliseconds\?",
    ),
    "milliseconds of a fast logger": (
        {"time": lambda r: 90 * r.time, "sample_rate": lambda r: r.sample_rate / 90},
        r"nowhere faster than 0\.0\d\d °C/s; is time in milliseconds\?",
    ),
    "first rows zero": (
        {"measured_temperature": lambda r: r.measured_temperature * (r.time > 0.2)},
        r"left thermocouple reads exactly 0 from 0\.00 s to 0\.20 s, and 23\.0 beside it: .* empty",
    ),
    "the camera's zero": (
        {"bend_angle": lambda r: r.bend_angle * (abs(r.time - 40.0) > 5.0)},
        r"bend sensor reads exactly 0 from 35\.00 s to 45\.00 s, and \d.* beside it",
    ),
    "hardly any bend": (
        {"bend_angle": lambda r: np.where(r.time > 0.9, np.nan, r.bend_angle)},
        r"the bend angle is there in 19 of \d+ samples, which tell nothing; leave this",
    ),
    "no thermocouple": (
        {"measured_temperature": lambda r: np.full_like(r.measured_temperature, np.nan)},
        r"no thermocouple shows how warm a heated wire is, .*; bond one to a wire",
    ),
    "fahrenheit": (
        {"measured_temperature": lambda r: 1.8 * r.measured_temperature + 32},
        "degrees Fahrenheit",
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
        ({"measured_temperature": left_dead}, "left thermocouple is dead"),
    ):
        with pytest.raises(CalibrationError, match=message):
            check_recording(changed(both, **signals), "both")


def left_dead(recording):
    return np.vstack([np.full(len(recording.time), 23.0), recording.measured_temperature[1]])


def test_what_is_swapped_is_named_wherever_the_limb_rests(model_recordings):
    for kind, rest in (("right", -11.0), ("right", 11.0), ("left", -11.0), ("left", 11.0)):
        (recording,) = model_recordings[kind]
        bent = dataclasses.replace(recording, bend_angle=recording.bend_angle + np.deg2rad(rest))
        for signal, message in (
            ("measured_temperature", "the thermocouples are swapped"),
            ("duty", "the wires' outputs are swapped"),
        ):
            with pytest.raises(CalibrationError, match=message):
                check_recording(changed(bent, **swap(signal)))


def test_wires_may_be_hot_at_the_start(right):
    """Even where °F would be cold, or hottest of all; dead is what never moves."""
    measured = right.measured_temperature[1]
    for level in (77.0, measured.max() - 15.0):
        start = np.flatnonzero((abs(measured - level) < 3.0) & (right.time > 10.0))[0]
        warm = part(right, right.time >= right.time[start])
        assert check_recording(warm, "right") == "right"
        for trouble in ("dead", "fahrenheit", "swapped thermocouples", "reversed bend"):
            signals, message = TROUBLES[trouble]
            with pytest.raises(CalibrationError, match=message):
                check_recording(changed(warm, **signals))


def test_the_room_is_not_as_warm_as_recordings_that_are_never_cold(right):
    cooling = 35.0 + 40.0 * np.exp(-right.time / 15.0)
    for described, expected in ((25.0, 25.0), (34.0, 35.0)):
        parameters = copy.deepcopy(right.parameters)
        parameters.ambient_temperature = described
        signals = {"duty": right.duty[[1, 1]], "measured_temperature": np.array([cooling] * 2)}
        one = dataclasses.replace(right, parameters=parameters, **signals)
        assert ambient_temperature([one]).value == pytest.approx(expected, abs=0.1)


def test_a_kind_that_is_none_and_a_limb_at_rest_are_named(model_recordings):
    (recording,) = model_recordings["ring_down"]
    with pytest.raises(CalibrationError, match=r"its kind is 'wave'; it must be one of sag, ring_"):
        kind_of(dataclasses.replace(recording, kind="wave"))
    still = dataclasses.replace(recording, bend_angle=0.1 * recording.bend_angle, kind="")
    assert kind_of(still, "ring_down_2") == "ring_down"
    with pytest.raises(CalibrationError, match=r"a limb at rest, .* does its header's gravity say"):
        kind_of(still, "sag_1")


def test_ring_downs_that_show_none_are_left_out(model_recordings):
    (good,) = model_recordings["ring_down"]
    still = dataclasses.replace(good, bend_angle=0 * good.bend_angle, source="still")
    wires = {wire: model_recordings[wire] for wire in ("right", "left")}
    found = calibrate({**wires, "ring_down": [still, good]}, method="paper")
    assert found.damping.damping.value == pytest.approx(8e-4, rel=0.03)
    assert "still is left out: The signal does not move; there" in " ".join(map(str, found.remarks))
    found = calibrate({**wires, "ring_down": [still]}, method="paper")
    assert found.as_described == ["stiffness", "damping"]


def under(recording, gravity):
    """A recording with another gravity in its header."""
    parameters = copy.deepcopy(recording.parameters)
    parameters.gravity = gravity
    return dataclasses.replace(recording, parameters=parameters)


def test_heat_in_the_mounting_of_the_sag_and_other_planets_are_refused(model_recordings, right):
    with pytest.raises(
        CalibrationError, match=r"gravity \[0\.0, -9\.81, 0\.0\] bends.* record it level"
    ):
        check_recording(under(right, [0.0, -9.81, 0.0]), "right")
    (sag,) = model_recordings["sag"]
    with pytest.raises(
        CalibrationError, match=r"header's gravity is 98\.1 m/s², but it must be 9\.81"
    ):
        check_recording(under(sag, [0.0, -98.1, 0.0]), "sag")
    with pytest.raises(CalibrationError, match=r"bends upwards\. .* or gravity in the header"):
        fit_stiffness(sag.parameters, [under(sag, [0.0, 9.81, 0.0])])


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
    spring = Estimate(0.1, 0.0, "N·m/rad")
    uses = [
        (right, check_recording),
        (both, lambda recording: validate(true_limb, recording)),
        (sag, lambda recording: fit_stiffness(true_limb, [sag, recording])),
        (ring, lambda recording: fit_damping(true_limb, [ring, recording])),
        (right, lambda recording: fit_heat_transfer(recording, 1, 25.0)),
        (right, lambda recording: fit_force(true_limb, recording, 1, heat, spring)),
        (right, lambda recording: calibrate({"right": [recording]})),
    ]
    for recording, use in uses:
        bent, hot = spoilt(recording)
        at = f"{recording.time[100]:g} s; it must stay from"
        with pytest.raises(LimbError, match=rf"bend_angle is \[8\.93.* at {at}"):
            use(bent)
        with pytest.raises(LimbError, match=r"measured_temperature is \[700\.0, "):
            use(hot)


def test_what_was_interrupted_calibrates_nothing_but_is_validated_with(
    model_recordings, true_limb, tmp_path
):
    right, both = (
        dataclasses.replace(model_recordings[kind][0], interrupted="The cable is cut.")
        for kind in ("right", "both")
    )
    message = r"this was interrupted \(The cable is cut\), so record it again\."
    with pytest.raises(CalibrationError, match=message):
        calibrate({"right": [right]})
    right.save(tmp_path / "some_name.csv")
    with pytest.warns(UserWarning, match=rf"some_name\.csv is left out: {message}"):
        assert load_recordings(tmp_path) == {}
    summary = validation_summary(validate(true_limb, both)).line()
    assert summary.endswith("until it was interrupted: The cable is cut")


def test_unfinished_files_are_ignored(model_recordings, tmp_path):
    model_recordings["right"][0].save(tmp_path / "right.csv")
    for name in ("right.unfinished.csv", "left.unfinished_2.csv"):
        (tmp_path / name).write_text("# limb recording, format 2\n")
    assert {kind: len(group) for kind, group in load_recordings(tmp_path).items()} == {"right": 1}
