"""Prediction from what labs have: long logs, gaps, one thermocouple, slow and drifting loggers.

Most recordings are of a limb of another physics than models and emulation.
"""

import dataclasses

import numpy as np
import pytest
from logged_limb import OwnLimb
from loggers import logged

from calibration import CalibrationError, calibrate
from calibration.prediction.heated_run import HeatedRun
from calibration.prediction.law_fit import fit_law
from calibration.recordings.recording_checks import check_without_gaps
from calibration.recordings.repair import in_pieces, select_samples
from limb_systems import LimbParameters, LinearLaw, Recording, SaturatingLaw, SegmentParameters
from soft_limb.reports.calibration_report import write_report
from soft_limb.results.summaries import calibration_summary

PERIOD = 130.0  # s, from one heat to the next
LEFT, RIGHT = 0, 1


def chatter(wire: int, start: float, level: float, duration: float) -> list:
    """Duty as a controller at 5 Hz with a limit of temperature applies it: on and off."""
    times = np.arange(start, start + duration, 0.8)
    return [
        (wire, level, float(time), 0.2 if number % 3 else 0.6) for number, time in enumerate(times)
    ]


@pytest.fixture(scope="module")
def log() -> Recording:
    """Thirteen minutes at 5 Hz, in which the wires are heated in turn."""
    pulses = []
    for number, (level, duration) in enumerate(
        ((0.4, 6), (0.6, 5), (0.5, 8), (0.4, 9), (0.7, 4), (0.5, 7))
    ):
        pulses += chatter((RIGHT, LEFT)[number % 2], PERIOD * number + 8.0, level, duration)
    return OwnLimb(4).record(pulses, 6 * PERIOD, 5.0)


@pytest.fixture(scope="module")
def poor(log) -> Recording:
    """That log with one thermocouple, 3% of its samples lost and a gap while a wire is heated."""
    random = np.random.default_rng(0)
    bend, measured = log.bend_angle.copy(), log.measured_temperature.copy()
    bend[0, random.choice(len(log.time), 20, replace=False)] = np.nan
    measured[LEFT] = np.nan
    kept = random.uniform(size=len(log.time)) > 0.03
    in_heat = log.time - 2 * PERIOD - 8.0  # of the third
    kept[(in_heat > 2.0) & (in_heat < 6.1)] = False
    kept[0] = True
    return select_samples(
        dataclasses.replace(log, bend_angle=bend, measured_temperature=measured), kept
    )


def test_a_long_log_is_cut_where_it_rests(log, monkeypatch):
    pieces, remarks = in_pieces(log)
    assert remarks == []
    starts = [0.0, *(PERIOD * np.arange(1, 6) + 3.0)]
    assert [piece.time[0] for piece in pieces] == pytest.approx(starts, abs=0.21)
    assert sum(len(piece.time) for piece in pieces) == len(log.time)
    assert not any(piece.duty[:, piece.time < piece.time[0] + 4.0].any() for piece in pieces)
    dose = sum(HeatedRun.of(piece).duty.sum(axis=0) * 0.5 for piece in pieces)
    np.testing.assert_allclose(dose, log.duty.sum(axis=1) * 0.2, atol=0.02)

    monkeypatch.setattr("calibration.recordings.repair.PAUSE_TIME", 1000.0)
    assert len(in_pieces(log)[0]) == 1
    monkeypatch.setattr("calibration.recordings.repair.MAX_PIECE_DURATION", 270.0)
    pieces = in_pieces(log)[0]
    assert [piece.time[0] for piece in pieces] == pytest.approx([0.0, 283.0, 556.0], abs=15.0)
    for piece in pieces:
        assert not piece.duty[:, 1 : 1 + round(3.0 * 5.0)].any()


def test_a_gap_is_cut_where_the_duty_is_not_known(poor):
    pieces, (remark,) = in_pieces(poor)
    assert len(pieces) == 5
    assert "left out: what duty there was in the gap at 270.0 s is not known; pieces" in str(remark)
    # What comes after it begins when the wire without a thermocouple is cold, and has no heat.
    hot = (poor.time > 2 * PERIOD + 14.0) & (poor.time < 2 * PERIOD + 60.0)
    assert not any(np.isin(piece.time, poor.time[hot]).any() for piece in pieces)
    steady = dataclasses.replace(poor, duty=np.where(poor.time > 8.0, [[0.0], [0.1]], 0.0))
    assert len(in_pieces(steady)[0]) == 1  # as the duty is the same on both sides
    with pytest.raises(CalibrationError, match="nothing is left of it to fit"):
        in_pieces(select_samples(poor, abs(poor.time - 2 * PERIOD - 14.0) < 6.0))


def test_a_log_begins_where_all_sensors_are_read_and_wires_rest(log):
    bend = np.where(log.time < 12.0, np.nan, log.bend_angle)  # the first wire is hot before
    late = dataclasses.replace(log, bend_angle=bend)
    pieces, _ = in_pieces(late)
    assert pieces[0].time[0] >= 12.0
    assert not pieces[0].duty[:, pieces[0].time < pieces[0].time[0] + 3.0].any()
    with pytest.raises(CalibrationError, match="no reading is there before 12"):
        check_without_gaps(late)


def test_what_one_thermocouple_tells(poor, log, tmp_path):
    """Of a file that has any name: it predicts what it never saw, and says what is not known."""
    poor.save(tmp_path / "log of march.csv")
    select_samples(poor, poor.time < 7.0).save(tmp_path / "log of april.csv")
    calibration = calibrate(tmp_path, laws=[SaturatingLaw])
    assert calibration.prediction.judges.startswith("the last 2 of 5 heated recordings or")
    assert calibration.as_described == ["stiffness", "damping", "left.a3"]
    wires = calibration.parameters.wires
    assert wires[LEFT].law.a3 == LimbParameters().wires[LEFT].law.a3 != wires[RIGHT].law.a3
    summary = str(calibration_summary(calibration))
    assert "The left wire has no thermocouple: its a3 stays as described" in summary
    assert "with a thermocouple on it, heat the left wire alone from cold for 60 s" in summary
    assert "s are left out: what duty there was" in summary
    assert "log of april.csv is left out: it shows a limb at rest, which tells" in summary
    write_report(calibration, tmp_path / "report.html")
    assert "next recording: with a therm" in (tmp_path / "report.html").read_text()
    # The third heat, most of which was lost.
    (predicted,) = calibration.prediction.fit.predict([HeatedRun.of(in_pieces(log)[0][2])])
    assert np.rad2deg(predicted.bend_error) < 2.0
    assert predicted.temperature_error < 2.0


PULSES = ((RIGHT, 0.9, 2.0), (LEFT, 0.8, 2.2))  # wire, duty and duration


@pytest.fixture(scope="module")
def pulses():
    """One of each wire, with heat from 0 and from 1.2 s; and the same a few minutes later."""
    limb, result = OwnLimb(4), []
    for starts in ((0.0, 1.2), (5.0, 5.0)):
        for (wire, level, duration), start in zip(PULSES, starts, strict=True):
            result.append(limb.record([(wire, level, start, duration)], 60.0))
            limb.record([], 180.0)
    return result[:2], result[2:]


def test_heat_from_the_beginning_leaves_the_start_at_the_room(pulses):
    """The first seconds show heat, not where the wires and the silicone were before."""
    recorded, again = pulses
    segment = LimbParameters().segments[0]
    fit = fit_law(SaturatingLaw, [HeatedRun.of(r) for r in recorded], segment, 22.0)
    assert np.abs(fit.initial_conditions - 22.0).max() < 8.0
    for predicted in fit.predict([HeatedRun.of(recording) for recording in again]):
        assert np.rad2deg(predicted.bend_error) < 2.0
        assert predicted.temperature_error < 2.0


def with_holes(recording):
    """Without readings of some seconds, half of the samples of one sensor, and some rows."""
    bend, measured = recording.bend_angle.copy(), recording.measured_temperature.copy()
    bend[0, 200:300] = bend[0, 400::3] = np.nan
    measured[1, 100:130] = np.nan
    holes = dataclasses.replace(recording, bend_angle=bend, measured_temperature=measured)
    return select_samples(holes, ~np.isin(np.arange(bend.size), [150, 151, 350]))


def test_what_is_missing_is_fitted_without(pulses):
    fits = [
        fit_law(LinearLaw, [HeatedRun.of(r) for r in runs], SegmentParameters(), 22.0).estimates
        for runs in (pulses[1], map(with_holes, pulses[1]))
    ]
    for name, estimate in fits[0].items():
        assert abs(fits[1][name].value - estimate.value) < 2 * estimate.standard_error


def warming(heated):
    """The room warms by 5 °C in each, and by as much between them: wires are as much above it."""
    return [
        dataclasses.replace(
            r, measured_temperature=r.measured_temperature + 5.0 * (n + r.time / r.time[-1])
        )
        for n, r in enumerate(heated)
    ]


def with_spikes(heated):
    result = [dataclasses.replace(r, bend_angle=r.bend_angle.copy()) for r in heated]
    for recording in result:
        recording.bend_angle[0, 100::400] += np.deg2rad(60.0)
    return result


@pytest.mark.parametrize(
    "change",
    [
        lambda heated: [logged(r, 1.0) for r in heated],
        lambda heated: [dataclasses.replace(r, time=1.001 * r.time) for r in heated],
        warming,
        with_spikes,
    ],
    ids=["1 Hz", "a clock that drifts", "warming", "spiked"],
)
def test_laws_are_within_their_errors(true_limb, model_recordings, change):
    """Two minutes of each wire, with the noise of thermocouples and bend sensor."""
    random, heated = np.random.default_rng(0), []
    for kind in ("right", "left"):
        (whole,) = model_recordings[kind]
        recording = logged(select_samples(whole, whole.time <= 120.0), 20.0)
        noisy = {
            name: getattr(recording, name)
            + size * random.normal(size=getattr(recording, name).shape)
            for name, size in zip(Recording.MEASURED, (0.25, np.deg2rad(0.5)), strict=True)
        }
        heated.append(dataclasses.replace(recording, **noisy))
    runs = [HeatedRun.of(recording) for recording in change(heated)]
    segment = SegmentParameters(links=2, stiffness=true_limb.segments[0].stiffness)
    estimates = fit_law(LinearLaw, runs, segment, 23.0).estimates
    for wire in true_limb.segments[0].wires:
        for field in ("a1", "a2", "a3", "beta"):
            found, truth = estimates[f"{wire.name}.{field}"], getattr(wire.law, field)
            assert abs(found.value - truth) < 3 * found.standard_error < 0.9 * abs(truth)
