"""What ``show`` says of files, and what ``compare`` finds between them."""

import dataclasses
import json
import re
import shutil
from pathlib import Path

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
    SegmentParameters,
    Trajectory,
    joint_angles_from_bend_angle,
)
from limb_systems.summary import Summary
from soft_limb.command import main
from soft_limb.reports import page
from soft_limb.results.comparison import Change, compare, flattened
from soft_limb.results.reading import ResultFile, read_result

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
    (folder / "task.yaml").write_text("# of a plan\nreach: true\nphases: []\n")
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


def test_show_says_what_each_file_is_and_what_made_it(folder, capsys):
    wanted = {
        "recording.csv": ("recording", "source", "emulated limb, seed 7"),
        "plan.csv": ("trajectory", "largest_difference_deg", 0.04),
        "limb.yaml": ("limb", "validation", "off by 1"),
        "task.yaml": ("task", "reach", "True"),
        "learning.txt": ("learning", "repetitions", []),
        "report.html": ("report", "title", "Limbs & wires"),
    }
    files = shown(wanted, capsys)
    assert list(files) == list(wanted)
    for name, (kind, fact, text) in wanted.items():
        assert files[name]["kind"] == kind
        assert files[name]["facts"][fact] == text
        made = files[name]["provenance"]
        if kind == "task":
            assert made is None
        elif kind == "limb":
            assert made == dataclasses.asdict(calibrated().calibration.provenance)
        else:
            assert made == dataclasses.asdict(MADE)

    assert main(["show", *wanted]) == 0
    said = capsys.readouterr().out
    check = "check       simulated again: within 0.0400° of the plan (allowed 0.1°); largest defect"
    assert check in said
    assert len(re.findall(r"^made at +2030-01-31T12:00:00Z$", said, re.MULTILINE)) == 5
    assert re.search(r"^limb seed   7$", said, re.MULTILINE)


def test_show_reads_what_is_older_and_what_is_unfinished(folder, capsys):
    recording = make_recording(provenance=None)
    recording.save("old.csv")
    lines = (folder / "old.csv").read_text().splitlines(keepends=True)
    (folder / "cut.unfinished.csv").write_text("".join(lines[:-5]))
    page.write_page("old.html", "Old", [])
    old = ["old.csv", "cut.unfinished.csv", "old.html"]
    files = shown(old, capsys)
    assert [file["provenance"] for file in files.values()] == [None] * 3
    assert "killed" in files["cut.unfinished.csv"]["facts"]["end"]
    assert main(["show", "old.csv"]) == 0
    assert "made by     not known\n" in capsys.readouterr().out


def test_show_tells_a_limb_that_was_changed_since_it_was_calibrated(folder, capsys):
    assert "changed" not in shown(["limb.yaml"], capsys)["limb.yaml"]["facts"]
    limb = LimbParameters.load("limb.yaml")
    digest, limb.total_duty = limb.digest, 1.4
    limb.save("limb.yaml")
    assert digest in shown(["limb.yaml"], capsys)["limb.yaml"]["facts"]["changed"]


def damaged(text: str) -> str:
    return text.replace("0.1", "0.2", 1) + " "


def test_a_file_that_is_damaged_or_unknown_is_one_sentence(folder, capsys):
    for name, content, said in (
        ("recording.csv", damaged, "recording.csv: "),
        ("plan.csv", damaged, "plan.csv: "),
        ("learning.txt", damaged, "does not match the checksum"),
        ("limb.yaml", lambda text: text.replace("links: 5", "links: 0"), "segments[0].links is 0"),
        ("task.yaml", lambda _: "reach: perhaps\n", "task.yaml: reach is 'perhaps'"),
        ("task.yaml", lambda _: "colour: blue\n", "no field of a limb, a robot or a task"),
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


def test_compare_finds_the_parameter_that_was_changed_and_no_other(folder, capsys):
    limb = LimbParameters.load("limb.yaml")
    limb.segments[0].wire("right").law.a2 *= 1.05
    limb.calibration.provenance = None
    limb.save("other.yaml")
    facts = compared(["limb.yaml", "other.yaml"], capsys)
    of_limb = [change for change in facts["changes"] if "." in change["name"]]
    (change,) = of_limb
    assert (change["name"], change["unit"]) == ("right.law.a2", "°C/s")
    assert change["values"] == [20.0, 21.0]
    assert change["relative"] == [None, pytest.approx(0.05)]
    assert main(["compare", "limb.yaml", "other.yaml"]) == 0
    assert re.search(r"right\.law\.a2 +°C/s +20 +21 \(\+5%\)\n", capsys.readouterr().out)
    assert main(["compare", "limb.yaml", "limb.yaml"]) == 0
    assert capsys.readouterr().out == "nothing changed\n"


def test_every_number_of_a_limb_is_compared_under_a_name_of_its_own(two_segments):
    names = flattened(two_segments)
    assert names["1.left.law.beta"][0] == two_segments.segments[0].wires[0].law.beta
    assert names["2.left.law.beta"][0] == 2.5e-4
    assert names["2.length"] == (0.06, "m")
    numbers = [value for value, _ in names.values() if isinstance(value, float | int)]
    yaml = two_segments.to_yaml()
    assert len(numbers) == len(re.findall(r"(?<=[ \[])-?[0-9][0-9.e+-]*(?=[,\]}\n])", yaml))


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
    make_recording(1.0).save("same_times.csv")
    facts = compared(["recording.csv", "same_times.csv"], capsys)
    assert facts["differences"][0]["percentile_90"] == pytest.approx(1.0, abs=1e-9)


def test_compare_tells_numbers_apart_with_no_more_digits_than_that_takes(folder):
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


def test_show_reads_a_reference(tmp_path, capsys):
    (tmp_path / "mine.csv").write_text("t;bend\n0;0\n2,5;-10\n4;20\n")
    (tmp_path / "list.csv").write_text("a,b\nc,d\n")
    assert main(["show", *map(str, [tmp_path / "mine.csv", tmp_path / "list.csv"])]) == 1
    said = capsys.readouterr()
    for line in ("duration    4 s", "points      3", "motion      bend -10.0° to 20.0°"):
        assert line in said.out
    assert said.err.startswith("error: ")
    assert "list.csv is nothing that soft-limb writes, and no reference" in said.err


def test_compare_takes_a_plan_beside_its_recordings(folder, capsys):
    make_recording(-2.0).save("below.csv")
    facts = compared(["plan.csv", "recording.csv", "below.csv"], capsys)
    assert facts["kinds"] == ["trajectory", "recording", "recording"]
    means = [item["mean"] for item in facts["tracking"]]
    assert means == pytest.approx([0.0, 2.0], abs=1e-3)
    assert [item["run"] for item in facts["tracking"]] == [1, 2]
    bend = [item["mean"] for item in facts["differences"] if item["signal"] == "bend_angle"]
    assert bend == pytest.approx(means, abs=1e-6)


def test_samples_that_are_not_plausible_are_left_out(folder):
    broken = make_recording()
    broken.measured_temperature = broken.measured_temperature.copy()
    broken.measured_temperature[0, 7] = 5000.0
    results = [read_result("recording.csv")] * 2
    results[1] = dataclasses.replace(results[1], value=broken)
    assert all(difference.mean < 1e-9 for difference in compare(results).differences)


def test_runs_are_called_by_what_tells_them_apart():
    for paths, names in (
        (["out/plan.csv", "out/recording.csv"], ["plan.csv", "recording.csv"]),
        (["/a/b/limb.yaml", "limb.yaml"], ["b/limb.yaml", "limb.yaml"]),
        (["x/a/out", "y/a/out", "z"], ["x/a/out", "y/a/out", "z"]),
        (["/out", "out"], ["/out", "out"]),
        (["a/out", "a/out"], ["out", "out"]),
    ):
        limb = LimbParameters()
        runs = [ResultFile(Path(path), "limb", Summary([]), None, limb) for path in paths]
        assert compare(runs).names == names


def test_what_cannot_be_compared_is_one_sentence(folder, capsys):
    make_recording(time=TIME + 10).save("late.csv")
    limb = LimbParameters(segments=[SegmentParameters(), SegmentParameters()])
    two = make_recording()
    two = Recording(
        time=two.time,
        duty=np.tile(two.duty, (2, 1)),
        measured_temperature=np.tile(two.measured_temperature, (2, 1)),
        bend_angle=np.tile(two.bend_angle, (2, 1)),
        parameters=limb,
        source="two",
        sample_rate=10.0,
    )
    two.save("two.csv")
    for runs, said in (
        (["plan.csv", "limb.yaml"], "plan.csv is a trajectory and limb.yaml is a limb; compare"),
        (["plan.csv"], "a comparison needs two or more"),
        (["task.yaml", "task.yaml"], "task.yaml is a task; plans, recordings and limbs are"),
        (["recording.csv", "two.csv"], "of 1 segments and 2 wires, but two.csv of 2 and 4"),
        (["recording.csv", "late.csv"], "they have no time in common"),
    ):
        assert main(["compare", *runs]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert said in line


def test_the_page_has_all_runs_and_what_made_it(folder, capsys):
    make_recording(1.0).save("shifted.csv")
    order = ["compare", "plan.csv", "recording.csv", "shifted.csv", "-o", "compare.html"]
    assert main(order) == 0
    text = (folder / "compare.html").read_text()
    for name in ("Δφ (°)", "reference φ_REF", "shifted.csv, right", "|Δφ|", "1.00°"):
        assert name in text or json.dumps(name)[1:-1] in text, name
    capsys.readouterr()
    assert shown(["compare.html"], capsys)["compare.html"]["provenance"]["version"]
    assert main(order) == 1
    assert "exists; give another name, or --force" in capsys.readouterr().err
    assert main(["compare", "limb.yaml", "limb.yaml", "-o", "limbs.html"]) == 0
    assert "Nothing changed." in (folder / "limbs.html").read_text()


def test_a_seed_is_no_larger_than_another():
    assert Change("board.seed", "", [3, 4]).relative == [None, None]
    assert Change("a2", "°C/s", [3.0, 4.0]).relative[1] == pytest.approx(1 / 3)
