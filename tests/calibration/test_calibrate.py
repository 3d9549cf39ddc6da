"""The whole of Sec. V: on the model, whose truth is known, and on an emulated limb."""

import copy
import dataclasses
import html
import io
import json
import re
from unittest import mock

import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial

from calibration import (
    CalibrationError,
    calibrate,
    kind_of,
    save_recordings,
    validate,
)
from calibration.recordings.repair import part
from limb_systems import (
    Limb,
    LimbParameters,
    Recording,
    SerialBoard,
    TwoMassLaw,
    WireParameters,
    simulate,
)
from soft_limb.command import main


@pytest.fixture(scope="module")
def folder(model_recordings, tmp_path_factory):
    """Those recordings as files."""
    folder = tmp_path_factory.mktemp("recordings")
    save_recordings(model_recordings, folder)
    return folder


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
    assert calibration.stiffness.correction_factor == pytest.approx(1.22, abs=0.01)
    assert np.rad2deg(calibration.validation.percentile_90) < 0.2
    assert [remark.kind for remark in calibration.remarks] == ["few"]  # trials of the sag
    assert calibration.verdict.startswith("Use with care: too few trials; the model is 0.")


def test_description_keeps_what_is_not_calibrated(model_recordings):
    description = LimbParameters()
    description.temperature_limits.maximum = 90.0
    (left,), (right,) = model_recordings["left"], model_recordings["right"]
    of_a_board = copy.deepcopy(right)
    of_a_board.parameters.board = SerialBoard("twin0007")
    recordings = {"left": [left], "right": [of_a_board, right]}
    calibration = calibrate(recordings, description, method="paper")
    assert calibration.parameters.board == SerialBoard("twin0007")
    assert "Of 2 recordings of the kind right only one was used." in map(str, calibration.remarks)
    assert calibration.parameters.temperature_limits.maximum == 90.0
    assert calibration.parameters.segments[0].stiffness == description.segments[0].stiffness
    assert calibration.validation is None
    assert (
        len(
            [remark for remark in calibration.remarks if "There is no recording" in remark.sentence]
        )
        == 3
    )
    assert calibration.verdict == (
        "Use with care: it is not validated; mechanics is that of the description."
    )
    assert description == LimbParameters(temperature_limits=description.temperature_limits)


@pytest.fixture(scope="module")
def sagging_and_heated(model_recordings):
    """Recordings with a sag that differs from trial to trial, so that k has an error."""

    def scaled(factor):
        (sag,) = model_recordings["sag"]
        sags = [dataclasses.replace(sag, bend_angle=f * factor * sag.bend_angle) for f in SAGS]
        return {"sag": sags} | {side: model_recordings[side] for side in ("left", "right")}

    return scaled


SAGS = (0.95, 0.98, 1.04)


def test_errors_and_covariance_of_a_calibration_are_data_in_its_file(sagging_and_heated, tmp_path):
    calibration = calibrate(sagging_and_heated(1.0), method="paper")
    calibration.parameters.save(tmp_path / "limb.yaml")
    record = LimbParameters.load(tmp_path / "limb.yaml").calibration
    assert record == calibration.parameters.calibration
    assert dict(zip(record.names, record.values, strict=True)) == {
        name: estimate.value for name, estimate in calibration.estimates.items()
    }
    assert record.names[:2] == ["ambient_temperature", "stiffness"]
    assert len(record.names) == 10
    assert record.recordings[0] == f"3 of sag: {calibration.sources['sag'][0]}"
    assert record.validation == ""
    errors, covariance = np.array(record.standard_errors), np.array(record.covariance)
    np.testing.assert_array_equal(covariance, covariance.T)
    np.testing.assert_allclose(np.diag(covariance), errors**2, rtol=1e-12)
    scales = np.where(errors > 0, errors, 1.0)  # nothing disturbs the model's T0
    correlation = covariance / np.outer(scales, scales)
    assert np.linalg.eigvalsh(correlation).min() > -1e-9
    groups = {name.split(".")[0] for name in record.names}
    assert groups == {"ambient_temperature", "stiffness", "left", "right"}
    for row, column in zip(*np.nonzero(np.triu(covariance, 1)), strict=True):
        pair = record.names[row], record.names[column]
        rates_of_a_wire = pair[0].split(".")[0] == pair[1].split(".")[0]
        multiples_of_k = all(name == "stiffness" or name.endswith("beta") for name in pair)
        assert rates_of_a_wire or multiples_of_k, pair
    # What β shares with k: both as the whole calibration moves when the limb sags a little more.
    names = ["stiffness", "left.beta", "right.beta"]
    more = calibrate(sagging_and_heated(1.001), method="paper").estimates
    moved = [more[name].value - calibration.estimates[name].value for name in names]
    slopes = np.array(moved) / moved[0]
    rows = [record.names.index(name) for name in names]
    expected = errors[rows[0]] ** 2 * np.outer(slopes, slopes)
    off = ~np.eye(3, dtype=bool)
    np.testing.assert_allclose(covariance[np.ix_(rows, rows)][off], expected[off], rtol=1e-3)


def test_missing_and_unknown_recordings_are_named(model_recordings, tmp_path):
    with pytest.raises(CalibrationError, match="only the left wire heated"):
        calibrate({"right": model_recordings["right"]}, method="paper")
    with pytest.raises(CalibrationError, match="'up' is no kind of recording"):
        calibrate({"up": model_recordings["right"]})
    with pytest.raises(CalibrationError, match="There is no folder"):
        calibrate(tmp_path / "nothing")
    with pytest.raises(CalibrationError, match="method is 'guess'; it must be one of pred"):
        calibrate(model_recordings, method="guess")


def test_validation_of_the_truth_has_no_error_and_of_another_limb_has(true_limb, model_recordings):
    (both,) = model_recordings["both"]
    assert np.rad2deg(validate(true_limb, both).mean) < 0.1
    wrong = copy.deepcopy(true_limb)
    wrong.segments[0].wire("right").law.beta *= 1.2
    assert np.rad2deg(validate(wrong, both).mean) > 1.0


def test_validation_may_start_warm(true_limb):
    """In the middle of a heat, and while the wire cools, with silicone on its way."""
    limb = copy.deepcopy(true_limb)
    for wire in limb.wires:
        wire.law = TwoMassLaw()
    levels = PiecewisePolynomial.ZeroOrderHold(
        [0.0, 10.0, 70.0], [[0.0, 0.0, 0.0], [0.6, 0.0, 0.0]]
    )
    recording = simulate(Limb(limb), levels, 70.0, sample_rate=5.0)
    for start in (8.0, 14.0):
        warm = part(recording, recording.time >= start)
        assert validate(limb, warm).temperature_mean < 1.0


def test_command_fits_a_folder_and_validates(folder, tmp_path, capsys, monkeypatch, look_at):
    limb, report, plot = (tmp_path / name for name in ("limb.yaml", "report.html", "fig4.png"))
    fit = ["fit", str(folder), "-o", str(limb), "--report", str(report), "--method", "paper"]
    made = []

    def calibrated(*arguments, **options):
        made.append(calibrate(*arguments, **options))
        return made[0]

    monkeypatch.setattr("soft_limb.commands.calibration.calibrate", calibrated)
    assert main(fit) == 0
    said = capsys.readouterr().out
    assert re.search(r"^correction_factor +λ = 1\.2", said, re.MULTILINE)
    calibrated = LimbParameters.load(limb)
    assert calibrated.segments[0].stiffness == pytest.approx(0.115, rel=0.01)
    assert "# " not in limb.read_text(encoding="utf-8")
    assert calibrated.calibration.names[:3] == ["ambient_temperature", "stiffness", "damping"]
    told = f"bend angle off by {re.search(r': mean ([0-9.]+)°', said)[1]} deg on average"
    assert calibrated.calibration.validation.startswith(told)
    page = html.unescape(report.read_text(encoding="utf-8"))
    # Validation, stiffness, damping, and each wire.
    assert page.count('<figure class="chart"') == 5
    verdict = re.search("^verdict +(.*)$", said, re.MULTILINE)[1]
    ranked = re.findall("^(?:remarks)? +((?:stop|care|note): .*)$", said, re.MULTILINE)
    assert re.match("(Good enough to plan with|Use with care|Do not plan with this): ", verdict)
    ranks = [["stop", "care", "note"].index(remark.split(":")[0]) for remark in ranked]
    assert ranks == sorted(ranks)
    assert len(ranks) > 0
    places = [page.index(line) for line in (verdict, *ranked)]
    assert places == sorted(places)
    assert places[-1] < page.index("<table")
    links = [tmp_path / link for link in re.findall(r'<a href="([^"#]+)">', page)]
    assert [limb, *sorted(folder.glob("*.csv"))] == [link.resolve() for link in links]

    look_at(report)

    both, validated = folder / "both.csv", tmp_path / "validation.html"
    pages = ["--plot", str(plot), "--report", str(validated)]
    assert main(["validate", str(limb), str(both), *pages]) == 0
    mean = float(re.search(r"mean ([\d.]+)°", capsys.readouterr().out)[1])
    assert f"mean {mean:.2f}°" in validated.read_text(encoding="utf-8")
    look_at(validated)
    assert mean < 0.2
    assert plot.read_bytes().startswith(b"\x89PNG")

    # The same for programs, of what was calibrated then.
    commands = "soft_limb.commands.calibration"
    monkeypatch.setattr(f"{commands}.calibrate", lambda *_, **__: made[0])
    monkeypatch.setattr(f"{commands}.write_report", lambda *_: None)
    assert main([*fit, "--json", "--force"]) == 0
    said = json.loads(capsys.readouterr().out)
    found = LimbParameters.load(limb)
    (segment,) = found.segments
    values = {name: estimate["value"] for name, estimate in said["estimates"].items()}
    assert values.pop("ambient_temperature") == found.ambient_temperature
    assert values.pop("stiffness") == segment.stiffness
    assert values.pop("damping") == segment.damping
    assert values == {
        f"{side}.{name}": getattr(segment.wire(side).law, name)
        for side in ("left", "right")
        for name in ("a1", "a2", "a3", "beta")
    }
    assert all(estimate["standard_error"] > 0 for estimate in said["estimates"].values())
    assert list(said)[:2] == ["verdict", "remarks"]
    assert said["estimates"]["stiffness"]["unit"] == "N·m/rad"
    assert said["correction_factor"] == pytest.approx(1.22, abs=0.01)
    assert said["written"] == [str(limb), str(report)]

    check = ["validate", str(limb), str(both), "--plot", str(plot), "--json", "--force"]
    assert main(check) == 0
    again = json.loads(capsys.readouterr().out)
    assert again.pop("written") == [str(plot)]
    assert again == pytest.approx(said["validation"])
    errors = validate(found, Recording.load(folder / "both.csv"))
    assert again["bend_angle_mean_deg"] == pytest.approx(np.rad2deg(errors.mean))
    assert again["temperature_mean_c"] == pytest.approx(errors.temperature_mean)


def test_collect_looks_for_the_board_first_and_needs_a_terminal(tmp_path, monkeypatch, capsys):
    arguments = ["collect", "-o", str(tmp_path / "new"), "-p", str(tmp_path / "no_port")]
    assert main(arguments) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert "no_port: No such file or directory; soft-limb ports" in said.err
    monkeypatch.setattr("soft_limb.commands.calibration.open_link", mock.MagicMock())
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main(arguments) == 1
    assert "error: There is no terminal to press Enter in" in capsys.readouterr().err


def test_command_collects_three_wires_from_a_robot_as_four_kinds(tmp_path, monkeypatch):
    """With the model in place of the robot. Two of the wires are on one side."""
    monkeypatch.setattr("calibration.collecting.protocol.SAG_TRIALS", 1)
    monkeypatch.setattr("calibration.collecting.protocol.RING_DOWNS", 1)
    ports, asked = [], []

    class Robot(Limb):
        __slots__ = ()

        def __init__(self, port, parameters, board=None):
            super().__init__(parameters)
            ports.append(port)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

    monkeypatch.setattr("soft_limb.commands.calibration.SerialLimb", Robot)
    monkeypatch.setattr("soft_limb.commands.calibration.open_link", mock.MagicMock())
    monkeypatch.setattr("builtins.input", asked.append)
    limb = LimbParameters(ambient_temperature=21.5)
    limb.segments[0].links = 2  # which are simulated fast
    limb.segments[0].wires = [
        WireParameters("low", -0.0034),
        WireParameters("near", 0.0034, 0.003),
        WireParameters("far", 0.0034, -0.003),
    ]
    limb.save(tmp_path / "limb.yaml")
    arguments = ["collect", "-p", "/dev/robot", "-o", str(tmp_path / "new"), "--seed", "3"]
    arguments += ["--protocol", "paper", "--angles", "1", "-l", str(tmp_path / "limb.yaml")]
    assert main(arguments) == 0
    assert ports == ["/dev/robot"] * 8
    names = ["sag_1", "ring_down_1", "first_contact", "warm_up", "near", "far", "low", "both"]
    assert [what.split(":")[0] for what in asked] == names
    assert "towards its low wire" in asked[0]
    assert all(what.endswith(".\nPress Enter when this is done. ") for what in asked)
    found = {path.stem: Recording.load(path) for path in (tmp_path / "new").iterdir()}
    assert sorted(found) == sorted(names)
    assert {recording.parameters.ambient_temperature for recording in found.values()} == {21.5}
    for name, heated in (("near", [1]), ("low", [0]), ("both", [0, 1, 2]), ("sag_1", [])):
        assert np.flatnonzero(found[name].duty.max(axis=1)).tolist() == heated
        assert kind_of(found[name]) == name.removesuffix("_1")
    # Each kind has random angles of its own, from the seed on.
    for name, seed, low in (("near", 3, 0), ("low", 5, -1)):
        angles = np.deg2rad(45.0) * np.random.default_rng(seed).uniform(low, low + 1, 1)
        assert np.unique(found[name].reference) == pytest.approx(np.sort(angles))
    found["both"].duty[0] = 0.0
    assert kind_of(dataclasses.replace(found["both"], kind="")) == "heated"
