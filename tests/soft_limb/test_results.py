"""``soft-limb show`` prints result files, and ``soft-limb compare`` their differences."""

import dataclasses
import json
import re
import shutil

import numpy as np
import pytest

from controllers import Learner
from limb_systems import (
    CalibrationRecord,
    EmulatedLimb,
    LimbParameters,
    PlanCheck,
    Provenance,
    Recording,
    Trajectory,
    joint_angles_from_bend_angle,
)
from limb_systems.connected_limbs import CONNECTED_FIELDS
from soft_limb.command import main
from soft_limb.reports import page
from soft_limb.results.comparison import Change, compare
from soft_limb.results.read_result import LIMB_FIELDS, read_result
from walking import RobotParameters

MADE = Provenance("0.1.0", "0123456789ab", "soft-limb plan", "a" * 12, "2030-01-31T12:00:00Z", 7, 3)
TIME = np.linspace(0.0, 4.0, 41)
BEND = 0.2 * np.sin(TIME)
CHECK = PlanCheck("IPOPT", "solved", 12, 0, 0.5, 0.7, 2.0, 3.0, 1e-9, "", 0.04, 0.1)


def make_recording(shift_deg=0.0, time=TIME, **changes) -> Recording:
    parameters = changes.pop("parameters", None) or LimbParameters(board=EmulatedLimb(7))
    return Recording(
        time=time,
        duty=np.full((2, len(time)), 0.1),
        measured_temperature=np.array([25 + time, 25 + 2 * time]),
        bend_angle=[0.2 * np.sin(time) + np.deg2rad(shift_deg)],
        parameters=parameters,
        source="emulated limb, seed 7",
        sample_rate=10.0,
        **{"provenance": MADE, **changes},
    )


def make_plan(start=5.0) -> Trajectory:
    parameters = LimbParameters()
    angles = joint_angles_from_bend_angle(parameters, BEND[np.newaxis])
    rates = joint_angles_from_bend_angle(parameters, 0.2 * np.cos(TIME)[np.newaxis])
    recording = make_recording()
    return Trajectory(
        time=TIME + start,  # on a clock of its own
        reference=recording.bend_angle,
        duty=recording.duty,
        joint_state=np.vstack([angles, rates]),
        wire_temperature=recording.measured_temperature,
        measured_temperature=recording.measured_temperature,
        parameters=parameters,
        check=CHECK,
        provenance=MADE,
    )


def calibrated() -> LimbParameters:
    record = CalibrationRecord(["left.a2"], [20.0], [1.0], [[1.0]], ["3 of right: a"], "off by 1")
    limb = LimbParameters(calibration=record, board=EmulatedLimb(7))
    record.provenance = dataclasses.replace(MADE, parameters=limb.digest)
    return limb


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A file of each kind."""
    folder = tmp_path_factory.mktemp("files")
    make_recording().save(folder / "recording.csv")
    make_plan().save(folder / "plan.csv")
    calibrated().save(folder / "limb.yaml")
    learner = Learner(make_plan(0.0))
    learner.provenance = MADE
    learner.save(folder / "learning.txt")
    page.write_page(folder / "report.html", "Limbs & wires", [page.paragraph("x")], MADE)
    return folder


@pytest.fixture
def folder(files, tmp_path, monkeypatch):
    """A copy of them, in the current folder."""
    monkeypatch.chdir(shutil.copytree(files, tmp_path, dirs_exist_ok=True))
    return tmp_path


def shown(arguments, capsys) -> dict:
    assert main(["show", *arguments, "--json"]) == 0
    return {file["file"]: file for file in json.loads(capsys.readouterr().out)["files"]}


def test_show_prints_kind_contents_and_origin(folder, capsys):
    wanted = {
        "recording.csv": ("recording", "source", "emulated limb, seed 7"),
        "plan.csv": ("trajectory", "largest_difference_deg", 0.04),
        "limb.yaml": ("limb", "validation", "off by 1"),
        "learning.txt": ("learning", "repetitions", []),
        "report.html": ("report", "title", "Limbs & wires"),
    }
    files = shown(wanted, capsys)
    assert list(files) == list(wanted)
    for name, (kind, fact, text) in wanted.items():
        assert files[name]["kind"] == kind
        assert files[name]["facts"][fact] == text
        made = files[name]["provenance"]
        if kind == "limb":
            assert made == dataclasses.asdict(calibrated().calibration.provenance)
        else:
            assert made == dataclasses.asdict(MADE)

    assert main(["show", *wanted]) == 0
    said = capsys.readouterr().out
    check = "check       passed, simulated again: within 0.0400° of the plan (allowed 0.1°)"
    assert check in said
    assert len(re.findall(r"^made at +2030-01-31T12:00:00Z$", said, re.MULTILINE)) == 5
    assert re.search(r"^limb seed   7$", said, re.MULTILINE)


def test_robots_are_known_by_all_fields_that_no_limb_has():
    assert {field.name for field in dataclasses.fields(RobotParameters)} - LIMB_FIELDS == (
        CONNECTED_FIELDS
    )


def damaged(text: str) -> str:
    return text.replace("0.1", "0.2", 1) + " "


def test_a_file_that_is_damaged_or_unknown_is_one_sentence(folder, capsys):
    for name, content, said in (
        ("recording.csv", damaged, "recording.csv: "),
        ("plan.csv", damaged, "plan.csv: "),
        ("learning.txt", damaged, "does not match the checksum"),
        ("limb.yaml", lambda text: text.replace("links: 5", "links: 0"), "segments[0].links is 0"),
        ("task.yaml", lambda _: "colour: blue\n", "is no recording"),
        ("report.html", lambda text: text.replace('"version"', "version"), "is damaged"),
        ("notes.md", lambda _: "# limb notes, format 3\n", "is no recording"),
        ("results.json", lambda _: "[]", "is no recording"),
    ):
        file = folder / name
        file.write_text(content(file.read_text() if file.exists() else ""))
        assert main(["show", name]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("error: ")
        assert said in line
    assert main(["show", str(folder)]) == 1
    assert "is a folder, but must be a file" in capsys.readouterr().err


def compared(arguments, capsys) -> dict:
    assert main(["compare", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_compare_tells_a_shift_of_one_degree(folder, capsys):
    later = np.arange(1.0, 6.01, 0.05)  # other samples, and only a part of the time in common
    make_recording(1.0, later, provenance=dataclasses.replace(MADE, seed=4)).save("shifted.csv")
    facts = compared(["recording.csv", "shifted.csv"], capsys)
    bend, heat, duty = facts["differences"]
    # But for the linear interpolation of a sine of 11.5° at 10 Hz, up to 0.0143°.
    for statistic in ("mean", "median", "percentile_90"):
        assert bend[statistic] == pytest.approx(1.0, abs=0.015)
        assert heat[statistic] == pytest.approx(0.0, abs=1e-9)
        assert duty[statistic] == 0.0
    changes = {change["name"]: change["values"] for change in facts["changes"]}
    assert set(changes) == {"duration", "samples", "motion", "heat", "seed"}
    assert changes["seed"] == [3, 4]
    # A plan solved again has the same distance but for the last digits.
    rounded = make_recording(parameters=LimbParameters(total_duty=1.5 * (1 + 1e-13)))
    make_recording(parameters=LimbParameters(total_duty=1.5)).save("exact.csv")
    rounded.save("rounded.csv")
    (change,) = compared(["exact.csv", "rounded.csv"], capsys)["changes"]
    assert change["name"] == "identity"  # by the digest
    # Seeds are names: none is nearly another.
    for seed in (2_000_000_000, 2_000_000_001):
        provenance = dataclasses.replace(MADE, seed=seed)
        make_recording(provenance=provenance).save(f"{seed}.csv")
    (change,) = compared(["2000000000.csv", "2000000001.csv"], capsys)["changes"]
    assert change["name"] == "seed"
    # A limb without thermocouples has no difference of readings.
    unread = make_recording()
    unread.measured_temperature[:] = np.nan
    unread.save("unread.csv")
    differences = compared(["unread.csv", "recording.csv"], capsys)["differences"]
    assert [difference["signal"] for difference in differences] == ["bend_angle", "duty"]
    make_recording(-1.0).save("same_times.csv")
    facts = compared(["recording.csv", "same_times.csv"], capsys)
    assert facts["differences"][0]["percentile_90"] == pytest.approx(1.0, abs=1e-9)


def test_compare_takes_the_readings_of_a_plan_solved_again_as_equal(folder, capsys):
    plan = make_plan()
    for name, factor in (("first.csv", 1.0), ("again.csv", 1 + 1e-13), ("another.csv", 1 + 1e-7)):
        check = dataclasses.replace(CHECK, highest_readings=[80.0 * factor, 60.0])
        dataclasses.replace(plan, check=check).save(name)
    assert compared(["first.csv", "again.csv"], capsys)["changes"] == []
    (change,) = compared(["first.csv", "another.csv"], capsys)["changes"]
    assert change["name"] == "highest_readings_c"


def test_compare_prints_the_digits_in_which_numbers_differ(folder):
    several = [
        Change("a", "s", [14.500000000000002, 20.0]),
        Change("b", "", [[14.500000000000002, 1.0], [14.6, 1.0]]),
        Change("c", "", [1234.5, 1234.6]),
        Change("d", "", [None, 1e-7]),
    ]
    results = [read_result(folder / name) for name in ("plan.csv", "recording.csv")]
    comparison = dataclasses.replace(compare(results), changes=several)
    shown = [row[2:] for row in comparison.changes_table()[1:]]
    assert [[cell.partition(" (")[0] for cell in row] for row in shown] == [
        ["14.5", "20"],
        ["14.5, 1", "14.6, 1"],
        ["1234.5", "1234.6"],
        ["-", "1e-07"],
    ]


def test_the_page_has_all_runs_and_their_origin(folder, capsys):
    make_recording(1.0).save("shifted.csv")
    order = ["compare", "plan.csv", "recording.csv", "shifted.csv", "-o", "compare.html"]
    assert main(order) == 0
    text = (folder / "compare.html").read_text()
    for name in ("Δ bend angle (°)", "reference φ_REF", "right, shifted.csv", "|Δφ|", "1.00°"):
        assert name in text or json.dumps(name)[1:-1] in text, name
    capsys.readouterr()
    assert shown(["compare.html"], capsys)["compare.html"]["provenance"]["version"]
    assert main(order) == 1
    assert "exists; give another name, or --force" in capsys.readouterr().err
    assert main(["compare", "limb.yaml", "limb.yaml", "-o", "limbs.html"]) == 0
    assert "Nothing changed." in (folder / "limbs.html").read_text()
