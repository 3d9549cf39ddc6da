"""The whole of Sec. V: on the model, whose truth is known, and on an emulated limb."""

import copy
import dataclasses
import html
import json
import re
from unittest import mock

import numpy as np
import pytest
from markupsafe import Markup
from pydrake.trajectories import PiecewisePolynomial

from calibration import (
    CalibrationError,
    Estimate,
    Validation,
    calibrate,
    collect_equilibria,
    kinds_of,
    validate,
)
from calibration.recordings.repair import select_samples
from calibration.remarks import Remark, Severity, remarks_on_estimate
from hardware import LimbTwin
from limb_systems import (
    HystereticLaw,
    Limb,
    LimbParameters,
    LinearLaw,
    SerialBoard,
    TwoMassLaw,
    WireParameters,
    simulate,
)
from limb_systems.monte_carlo import parameter_owner
from soft_limb.command import main


def test_the_model_is_calibrated_to_its_own_parameters(true_limb, by_the_paper):
    """k within 1%, σ, a1, a2, a3 within 3%, β within 2%."""
    calibration = by_the_paper
    found, true = calibration.parameters.segments[0], true_limb.segments[0]
    assert found.stiffness == pytest.approx(true.stiffness, rel=0.01)
    assert found.damping == pytest.approx(true.damping, rel=0.03)
    for side in ("left", "right"):
        for name, tolerance in (("a1", 0.03), ("a2", 0.03), ("a3", 0.03), ("beta", 0.02)):
            value = getattr(found.wire(side).law, name)
            assert value == pytest.approx(getattr(true.wire(side).law, name), rel=tolerance)
    assert calibration.parameters.ambient_temperature == pytest.approx(23.0, abs=0.01)
    # (9) by small angles, which are as 4 to 1, and whose chord is at 2/3 of their weighted sum.
    assert calibration.stiffness.correction_factor == pytest.approx(10 / 9, abs=0.01)
    assert np.rad2deg(calibration.validation.percentile_90) < 0.2
    assert [remark.kind for remark in calibration.remarks] == ["few", "stiffness"]  # one sag
    assert calibration.verdict.startswith("Use with care: too few trials; the model is 0.")


@pytest.mark.whole
def test_an_emulated_limb_is_calibrated_by_prediction(by_prediction, emulated_folder):
    """To what it was made of, and to what was calibrated when it was recorded."""
    found, specimen = by_prediction.estimates, LimbTwin(seed=7).specimen
    (physics,), (segment,) = specimen.segments, by_prediction.parameters.segments
    assert found["ambient_temperature"].value == pytest.approx(specimen.ambient, abs=0.2)
    assert found["stiffness"].value == pytest.approx(physics.stiffness, rel=0.2)
    assert isinstance(segment.wires[0].law, HystereticLaw)  # as the emulated wires' is
    for wire, made in zip(segment.wires, specimen.wires, strict=True):
        assert wire.law.a3 == pytest.approx(made.lag_rate, rel=0.1)
        assert -wire.law.a1 == pytest.approx(1 / made.fast_time, rel=0.25)
        assert wire.law.a2 == pytest.approx(made.heating, rel=0.2)
        # k is known to 7%, and bends relieve the wires.
        assert wire.law.full_torque == pytest.approx(made.torque, rel=0.2)
    assert by_prediction.prediction.judges == "3 motions, fitted last"
    assert np.rad2deg(by_prediction.prediction.best.bend_error) < 0.8
    assert by_prediction.prediction.best.temperature_error < 0.5
    assert by_prediction.verdict.startswith("Good enough to plan with: in open loop, a plan will")
    record = LimbParameters.load(emulated_folder / "calibrated.yaml").calibration
    assert record.names == list(found)
    assert record.recordings == by_prediction.parameters.calibration.recordings
    for value, estimate in zip(record.values, found.values(), strict=True):
        assert abs(value - estimate.value) < 0.2 * estimate.standard_error


def test_description_keeps_what_is_not_calibrated(model_recordings, described):
    """Also from recordings of which a logger lost a tenth of the rows."""
    described.temperature_limits.maximum = 90.0
    before = copy.deepcopy(described)
    (left,), (right,) = model_recordings["left"], model_recordings["right"]
    of_a_board = copy.deepcopy(right)
    of_a_board.parameters.board = SerialBoard("twin0007")
    of_a_board = select_samples(of_a_board, np.arange(len(right.time)) % 10 != 5)
    recordings = {"left": [left], "right": [of_a_board, right]}
    calibration = calibrate(recordings, described, method="paper")
    assert calibration.parameters.wires[1].law.a1 == pytest.approx(-0.07, rel=0.03)
    assert calibration.parameters.board == SerialBoard("twin0007")
    assert calibration.parameters.temperature_limits.maximum == 90.0
    assert calibration.parameters.segments[0].stiffness == described.segments[0].stiffness
    assert calibration.as_described == ["stiffness", "damping"]
    assert calibration.validation is None
    remarks = list(map(str, calibration.remarks))
    assert "Of 2 recordings of the kind right only one was used." in remarks
    assert sum("There is no usable recording" in remark for remark in remarks) == 3
    assert calibration.verdict == ("Use with care: it is not validated; mechanics is as described.")
    assert described == before


def test_rows_that_a_logger_lost_leave_even_steps(model_recordings, described):
    """A damped sinusoid is fitted to even steps; what was not read in them is missing."""
    (whole,) = model_recordings["ring_down"]
    is_kept = np.arange(len(whole.time)) % 10 != 5
    recordings = {**model_recordings, "ring_down": [select_samples(whole, is_kept)]}
    with (
        mock.patch("calibration.calibrate.fit_damping", side_effect=InterruptedError) as fit,
        pytest.raises(InterruptedError),
    ):
        calibrate(recordings, described, method="paper")
    _, (given,) = fit.call_args.args
    np.testing.assert_allclose(given.time, whole.time, atol=1e-9)
    np.testing.assert_array_equal(np.isnan(given.bend_angle[0]), ~is_kept)


def test_errors_and_covariance_of_a_calibration_are_data_in_its_file(
    by_the_paper, model_recordings, described, tmp_path
):
    by_the_paper.parameters.save(tmp_path / "limb.yaml")
    loaded = LimbParameters.load(tmp_path / "limb.yaml")
    assert [wire.heat_bounds for wire in loaded.wires] == by_the_paper.parameters.heat_bounds
    record = loaded.calibration
    assert record == by_the_paper.parameters.calibration
    values = {name: estimate.value for name, estimate in by_the_paper.estimates.items()}
    assert dict(zip(record.names, record.values, strict=True)) == values
    assert record.names[:3] == ["ambient_temperature", "stiffness", "damping"]
    assert len(record.names) == 11
    assert record.recordings[0] == f"1 of sag: {by_the_paper.sources['sag'][0]}"
    errors, covariance = np.array(record.standard_errors), np.array(record.covariance)
    np.testing.assert_array_equal(covariance, covariance.T)
    np.testing.assert_allclose(np.diag(covariance), errors**2, rtol=1e-12)
    scales = np.where(errors > 0, errors, 1.0)  # nothing disturbs the model's T0
    assert np.linalg.eigvalsh(covariance / np.outer(scales, scales)).min() > -1e-9
    for row, column in zip(*np.nonzero(np.triu(covariance, 1)), strict=True):
        pair = record.names[row], record.names[column]
        rates_of_a_wire = pair[0].split(".")[0] == pair[1].split(".")[0]
        multiples_of_k = all(name == "stiffness" or name.endswith("beta") for name in pair)
        assert rates_of_a_wire or multiples_of_k, pair
    # What β shares with k: both as the whole calibration moves when the limb sags a little more.
    (sag,) = model_recordings["sag"]
    more = dataclasses.replace(sag, bend_angle=1.001 * sag.bend_angle)
    others = {kind: model_recordings[kind] for kind in ("ring_down", "left", "right")}
    moved = calibrate({"sag": [more], **others}, described, method="paper")
    names = ["stiffness", "left.beta", "right.beta"]
    steps = np.array([moved.estimates[name].value - values[name] for name in names])
    rows = [record.names.index(name) for name in names]
    expected = errors[rows[0]] ** 2 * np.outer(steps, steps) / steps[0] ** 2
    off = ~np.eye(3, dtype=bool)
    np.testing.assert_allclose(covariance[np.ix_(rows, rows)][off], expected[off], rtol=1e-3)


def test_missing_and_unknown_recordings_are_named(model_recordings, tmp_path):
    right = model_recordings["right"]
    for given, method, message in (
        ({"right": right}, "paper", "only the left wire heated"),
        ({"up": right}, "prediction", "'up' is no kind of recording"),
        ({"sag": model_recordings["sag"]}, "prediction", "no recording with heat"),
        ({}, "prediction", "There are no recordings"),
        (tmp_path / "nothing", "prediction", "There is no folder"),
        (model_recordings, "guess", "method is 'guess'; it must be one of pred"),
    ):
        with pytest.raises(CalibrationError, match=message):
            calibrate(given, method=method)
    other = LimbParameters()
    other.wires[0].name = "dorsal"
    with pytest.raises(CalibrationError, match="no recording with heat") as caught:
        calibrate({"right": right}, other)
    (note,) = caught.value.__notes__
    assert "left out: it is of the wires left, right, but the limb is described with dor" in note


def test_a_limb_with_one_wire_is_calibrated(described):
    law = LinearLaw(-0.06, 24.0, -1.3, 6.0e-4)
    limb = described
    limb.ambient_temperature = 23.0
    limb.segments[0].wires = [WireParameters("only", 0.0034, 0.0, law)]
    assert list(kinds_of(limb)) == ["sag", "ring_down", "only"]
    recording = collect_equilibria(Limb(limb), "only", num_angles=3, longest=15.0)
    for method in ("paper", "prediction"):
        calibration = calibrate({"only": [recording]}, limb, method=method, laws=[LinearLaw])
        (found,) = calibration.parameters.wires
        for name in ("a1", "a2", "beta"):
            assert getattr(found.law, name) == pytest.approx(getattr(law, name), rel=0.05)


def test_validation_of_the_truth_has_no_error_and_of_another_limb_has(true_limb, model_recordings):
    (whole,) = model_recordings["both"]
    both = select_samples(whole, whole.time < 30.0)
    assert np.rad2deg(validate(true_limb, both).mean) < 0.1
    wrong = copy.deepcopy(true_limb)
    wrong.segments[0].wire("left").law.beta *= 1.2
    assert np.rad2deg(validate(wrong, both).mean) > 1.0


def test_validation_may_start_warm(true_limb):
    """While the wire cools, with silicone on its way."""
    limb = copy.deepcopy(true_limb)
    limb.segments[0].links = 2
    for wire in limb.wires:
        wire.law = TwoMassLaw()
    levels = PiecewisePolynomial.ZeroOrderHold(
        [0.0, 10.0, 40.0], [[0.0, 0.0, 0.0], [0.6, 0.0, 0.0]]
    )
    recording = simulate(Limb(limb), levels, 40.0, sample_rate=5.0)
    warm = select_samples(recording, recording.time >= 14.0)
    assert validate(limb, warm).temperature_mean < 1.0


@pytest.mark.parametrize(
    ("fraction", "words"),
    [
        (0.09, "Good enough to plan with: the model is 3.6° (9% of its range) from"),
        (0.11, "Use with care: the model is 4.4° (11% of its range) from"),
        (0.26, "Do not plan with this: the model is 10.4° (26% of its range) from"),
    ],
)
def test_the_validation_s_error_counts_by_the_range_of_bend(model_recordings, fraction, words):
    """Of a bend to and fro over 40°."""
    (both,) = model_recordings["both"]
    bend = np.deg2rad([np.linspace(-20.0, 20.0, len(both.time))])
    limb = dataclasses.replace(both, bend_angle=bend)
    found = Validation(limb, copy.deepcopy(limb), fraction * np.ptp(bend), 0.0, 0.0, 0.0)
    assert found.verdict.startswith(words)
    limb.bend_angle *= 0  # which is not divided by
    assert dataclasses.replace(found, mean=0.0).verdict.startswith("Good enough")


def test_what_the_data_do_not_tell_stops():
    assert remarks_on_estimate("β", Estimate(1.0, 0.9, "")) == []
    (remark,) = remarks_on_estimate("β", Estimate(-1.0, 1.1, ""))
    assert remark.severity == Severity.STOP
    assert remark.sentence == "The data do not determine β; record more trials of it."


@pytest.mark.whole
def test_command_fits_a_folder_and_validates(
    emulated_folder, by_prediction, tmp_path, capsys, monkeypatch
):
    limb, report, plot = (tmp_path / name for name in ("limb.yaml", "report.html", "fig4.png"))
    fit = ["fit", str(emulated_folder), "-o", str(limb), "--report", str(report)]
    fits = mock.Mock(return_value=by_prediction)
    monkeypatch.setattr("soft_limb.commands.calibration.calibrate", fits)
    assert main([*fit, "--method", "prediction"]) == 0
    assert fits.call_args.args == (emulated_folder, None)
    assert fits.call_args.kwargs["method"] == "prediction"
    said = capsys.readouterr().out
    assert re.search(
        r"^correction_factor +λ = 1\.8\d\d of the bend that the sensor shows; of ", said, re.M
    )
    found = LimbParameters.load(limb)
    assert found == by_prediction.parameters
    assert "# " not in limb.read_text(encoding="utf-8")
    told = f"bend angle off by {re.search(r': mean ([0-9.]+)°', said)[1]} deg on average"
    assert found.calibration.validation.startswith(told)
    page = html.unescape(report.read_text(encoding="utf-8"))
    fitted = by_prediction.prediction.fit.predicted
    # Validation, and each recording.
    assert page.count('<figure class="chart"') == 1 + len(fitted)
    verdict = re.search("^verdict +(.*)$", said, re.MULTILINE)[1]
    assert verdict == by_prediction.verdict
    assert page.index(verdict) < page.index("<table")
    links = [tmp_path / link for link in re.findall(r'<a href="([^"#]+)">', page)]
    assert [limb, *sorted(emulated_folder.glob("*.csv"))] == [link.resolve() for link in links]

    both, validated = emulated_folder / "both.csv", tmp_path / "validation.html"
    pages = ["--plot", str(plot), "--report", str(validated)]
    assert main(["validate", str(limb), str(both), *pages]) == 0
    mean = float(re.search(r"mean ([\d.]+)°", capsys.readouterr().out)[1])
    assert f"mean {mean:.2f}°" in validated.read_text(encoding="utf-8")
    assert mean < 2.0
    assert plot.read_bytes().startswith(b"\x89PNG")

    # The same for programs.
    monkeypatch.setattr("soft_limb.commands.calibration.write_report", lambda *_: None)
    assert main([*fit, "--json", "--force"]) == 0
    said = json.loads(capsys.readouterr().out)
    for name, estimate in said["estimates"].items():
        owner, field = parameter_owner(found, name)
        assert estimate["value"] == getattr(owner, field)
        assert estimate["standard_error"] > 0
    assert list(said)[:2] == ["verdict", "remarks"]
    assert said["estimates"]["stiffness"]["unit"] == "N·m/rad"
    assert said["correction_factor"] == by_prediction.stiffness.correction_factor
    assert said["written"] == [str(limb), str(report)]


def test_remarks_are_ranked(by_the_paper, model_recordings, capsys, tmp_path, monkeypatch):
    """In the summary and on the page, worst first, whatever their order was."""
    unranked = dataclasses.replace(by_the_paper, left_out=[Remark("lag", "The lag is unknown.")])
    fits = mock.Mock(return_value=unranked)
    monkeypatch.setattr("soft_limb.commands.calibration.calibrate", fits)
    picture = Markup('<figure class="chart"></figure>')  # the real one takes long
    monkeypatch.setattr("soft_limb.reports.page.chart", lambda *_: picture)
    limb, report = tmp_path / "limb.yaml", tmp_path / "report.html"
    fit = ["fit", str(tmp_path), "-o", str(limb), "--report", str(report)]
    assert main([*fit, "--method", "paper"]) == 0
    said, page = capsys.readouterr().out, html.unescape(report.read_text(encoding="utf-8"))
    ranked_remarks = re.findall("^(?:remarks)? +((?:stop|care|note): .*)$", said, re.MULTILINE)
    ranks = [["stop", "care", "note"].index(remark.split(":")[0]) for remark in ranked_remarks]
    assert ranks == sorted(ranks)
    assert {1, 2} <= set(ranks)
    places = [page.index(line) for line in ranked_remarks]
    assert places == sorted(places)
    assert page.count(picture) == 1  # the validation; the fits are in words
    both = tmp_path / "both.csv"
    model_recordings["both"][0].save(both)
    assert main(["validate", str(limb), str(both), "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    (told,) = re.findall(r"^validation +.*: mean ([\d.]+)°", said, re.MULTILINE)
    assert f"{again['bend_angle_mean_deg']:.2f}" == told
    validation = LimbParameters.load(limb).calibration.validation
    assert validation.startswith(f"bend angle off by {told} deg on average")


def test_a_limb_that_must_not_be_planned_with_is_no_success(
    by_the_paper, capsys, monkeypatch, tmp_path
):
    """The file is kept for looking at, and the exit status is 1."""
    stop = dataclasses.replace(by_the_paper, left_out=[Remark("start", "It starts at 900 °C.")])
    fit = ["fit", str(tmp_path), "-o", str(tmp_path / "limb.yaml"), "--force"]
    for calibration, status in ((by_the_paper, 0), (stop, 1)):
        found = mock.Mock(return_value=calibration)
        monkeypatch.setattr("soft_limb.commands.calibration.calibrate", found)
        assert main(fit) == status
        printed = capsys.readouterr()
        assert ("Do not plan with" in printed.err) == bool(status)
    assert "Do not plan with this: a recording starts" in printed.out


def test_wires_on_the_wrong_side_are_a_question(emulated_folder, capsys, tmp_path):
    """Nothing is fitted, and the description that the recordings tell is there to be given."""
    wrong, output = tmp_path / "wrong.yaml", tmp_path / "limb.yaml"
    limb = LimbParameters()
    for wire in limb.wires:
        wire.e2 = -wire.e2
    limb.save(wrong)
    assert main(["fit", str(emulated_folder), "-o", str(output), "-l", str(wrong)]) == 2
    said = capsys.readouterr().err
    assert "the description seems to have left and right on the wrong side" in said
    assert said.count("the left wire bends to 180° (+180 ±") == 2  # also in the table
    assert not output.exists()
    corrected = LimbParameters.load(tmp_path / "limb_described.yaml")
    assert [wire.e2 for wire in corrected.wires] == [wire.e2 for wire in LimbParameters().wires]
