"""Calibration from what a lab has: one long log at 5 Hz, with gaps, and one thermocouple."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from calibration import CalibrationError, calibrate
from calibration.prediction.heated_run import HeatedRun
from calibration.recordings.repair import in_pieces, part
from limb_systems import LimbParameters, Recording, SaturatingLaw
from soft_limb.reports.calibration import write_report
from soft_limb.results.summaries import calibration_summary

sys.path.insert(0, str(Path(__file__).parent))
from own_limb import OwnLimb

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
    return part(dataclasses.replace(log, bend_angle=bend, measured_temperature=measured), kept)


@pytest.fixture(scope="module")
def calibration(poor, tmp_path_factory):
    """From a file that has any name."""
    folder = tmp_path_factory.mktemp("recordings")
    poor.save(folder / "log of march.csv")
    part(poor, poor.time < 7.0).save(folder / "log of april.csv")
    return calibrate(folder, laws=[SaturatingLaw])


def test_a_long_log_is_cut_where_it_rests(log):
    pieces, remarks = in_pieces(log)
    assert remarks == []
    assert [piece.time[0] for piece in pieces] == pytest.approx(
        [0.0, *(PERIOD * np.arange(1, 6) + 3.0)], abs=0.21
    )
    assert sum(len(piece.time) for piece in pieces) == len(log.time)
    assert not any(piece.duty[:, piece.time < piece.time[0] + 4.0].any() for piece in pieces)
    np.testing.assert_allclose(
        sum(HeatedRun.of(piece).duty.sum(axis=0) * 0.5 for piece in pieces),
        log.duty.sum(axis=1) * 0.2,
        atol=0.02,
    )


def test_what_is_long_is_cut_where_it_rests(log, monkeypatch):
    monkeypatch.setattr("calibration.recordings.repair.PAUSE", 1000.0)
    assert len(in_pieces(log)[0]) == 1
    monkeypatch.setattr("calibration.recordings.repair.LONGEST", 270.0)
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
        in_pieces(part(poor, abs(poor.time - 2 * PERIOD - 14.0) < 6.0))


def test_what_one_thermocouple_tells(calibration, log, tmp_path):
    """It predicts what it never saw, and says what it does not know."""
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
