"""Recording and trajectory files: what comes back, and what is refused.

Damage is done to the bytes of good files. Where a check other than the
checksum is meant, the end line is made to fit the changed content again.
"""

import csv
import dataclasses
import hashlib
import os

import numpy as np
import pytest

from limb_systems import (
    ActiveConstraint,
    LimbError,
    LimbParameters,
    PlanCheck,
    Recording,
    SegmentParameters,
    Trajectory,
)
from limb_systems.files.csv_format import FileFormatError
from limb_systems.files.output import OutputError

PASSED = PlanCheck(
    solver="IPOPT",
    status='Solve_Succeeded: it\'s "fine", # 1; °C',
    iterations=13,
    solve_time=0.1 + 0.2,
    total_time=1.25,
    cost=17.3,
    guess_cost=18.9,
    largest_defect=3.2e-9,
    largest_difference_deg=0.04,
    tolerance_deg=0.5,
    active_constraints=[ActiveConstraint("duty_left >= 0", 1.5, 3.0)],
)

TOP = 31  # lines of a recording's header, before the names of its columns


def make_recording(parameters=None, samples=4, **changes) -> Recording:
    parameters = parameters or LimbParameters(segments=[SegmentParameters(links=2)])
    rng = np.random.default_rng(0)
    num_wires, num_segments = len(parameters.wires), len(parameters.segments)
    signals = {
        "time": np.cumsum(rng.uniform(0.01, 0.2, samples)),
        "duty": rng.uniform(0, 1, (num_wires, samples)),
        "measured_temperature": rng.uniform(20, 110, (num_wires, samples)),
        "bend_angle": rng.uniform(-np.pi, np.pi, (num_segments, samples)),
        "wire_temperature": rng.uniform(20, 110, (num_wires, samples)),
        "joint_state": rng.normal(0, 10, (2 * parameters.num_joints, samples)),
    }
    return Recording(
        **{**signals, **changes}, parameters=parameters, source="a test", sample_rate=10.0
    )


def make_trajectory(parameters=None, samples=4, check=PASSED, **changes) -> Trajectory:
    recording = make_recording(parameters, samples)
    names = ("time", "duty", "joint_state", "wire_temperature", "measured_temperature")
    signals = {name: getattr(recording, name) for name in names}
    signals["reference"] = np.random.default_rng(1).uniform(-1, 1, recording.bend_angle.shape)
    return Trajectory(**{**signals, **changes}, parameters=recording.parameters, check=check)


MAKERS = (make_recording, make_trajectory)


def assert_identical(actual, expected):
    """Every field the same; arrays bit by bit, the sign of zero included."""
    for field in dataclasses.fields(expected):
        left, right = getattr(actual, field.name), getattr(expected, field.name)
        if isinstance(right, np.ndarray):
            assert left.shape == right.shape, field.name
            assert left.tobytes() == right.tobytes(), field.name
        else:
            assert left == right, field.name


def save_and_load(original, path):
    original.save(path)
    return type(original).load(path)


def test_round_trip_is_bit_identical(tmp_path, uneven_limb):
    for make in MAKERS:
        for original in (make(samples=2), make(samples=500), make(uneven_limb, samples=50)):
            assert_identical(save_and_load(original, tmp_path / "file.csv"), original)


def test_columns_are_named_with_their_units_and_angles_are_in_degrees(tmp_path):
    path = tmp_path / "file.csv"
    original = make_recording(bend_angle=[[np.pi / 6, -np.pi / 2, 0.0, np.pi]])
    original.save(path)
    with path.open(newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    names = "time_s duty_left duty_right measured_temperature_left_c measured_temperature_right_c "
    names += "bend_angle_deg wire_temperature_left_c wire_temperature_right_c "
    names += "joint_angle_1_deg joint_angle_2_deg joint_rate_1_deg_s joint_rate_2_deg_s"
    assert list(rows[0]) == names.split()
    bend = [float(row["bend_angle_deg"]) for row in rows]
    np.testing.assert_allclose(bend, [30.0, -90.0, 0.0, 180.0], rtol=1e-15)
    rate = [float(row["joint_rate_2_deg_s"]) for row in rows]
    np.testing.assert_allclose(rate, np.degrees(original.joint_state[3]), rtol=1e-15)
    measured = [float(row["measured_temperature_right_c"]) for row in rows]
    assert measured == original.measured_temperature[1].tolist()


def test_every_truncation_is_refused(tmp_path, refused):
    path = tmp_path / "file.csv"
    make_recording(samples=2).save(path)
    whole = path.stat().st_size
    assert whole > 1000
    for size in reversed(range(whole)):
        os.truncate(path, size)
        with refused(FileFormatError, path):
            Recording.load(path)


def test_changes_of_one_byte_are_refused(tmp_path):
    """A flipped bit, another byte, one more and one less, in turn."""
    path = tmp_path / "file.csv"
    make_trajectory(samples=2).save(path)
    data = path.read_bytes()
    for position in range(0, len(data), 7):
        before, byte, after = data[:position], data[position], data[position + 1 :]
        changes = [bytes([byte ^ 1]), b"e\n\x80"[position % 3 :][:1], b"", b"77"]
        change = changes[position % 4]
        if change != bytes([byte]):
            path.write_bytes(before + change + after)
            with pytest.raises(FileFormatError):
                Trajectory.load(path)


def saved_lines(original, path) -> list[str]:
    """The lines of a file without its end line."""
    original.save(path)
    return path.read_text().splitlines()[:-1]


def names_line(lines) -> int:
    return next(index for index, line in enumerate(lines) if line.startswith("time_s"))


def set_cell(lines, sample, name, text):
    top = names_line(lines)
    cells = lines[top + 1 + sample].split(",")
    cells[lines[top].split(",").index(name)] = text
    lines[top + 1 + sample] = ",".join(cells)


def write_sealed(path, lines):
    """Writes the lines with an end line that fits them."""
    body = "\n".join(lines) + "\n"
    rows = len(lines) - names_line(lines) - 1
    digest = hashlib.sha256(body.encode()).hexdigest()
    path.write_text(f"{body}# end, {rows} rows, sha256 {digest}\n")


@pytest.fixture
def lines(tmp_path) -> list[str]:
    """Of a recording that is then changed; its first sample stands in line TOP + 2."""
    return saved_lines(make_recording(), tmp_path / "file.csv")


@pytest.fixture
def refuse_sealed(tmp_path, refused):
    """Seals the lines and expects that loading them is refused."""

    def check(lines, *words, kind=Recording):
        path = tmp_path / "file.csv"
        write_sealed(path, lines)
        with refused(FileFormatError, path, *words):
            kind.load(path)

    return check


def test_another_version_and_shuffled_rows_are_refused(lines, refuse_sealed):
    refuse_sealed(["# limb recording, format 2", *lines[1:]], "format 2", "reads format 3")
    lines[TOP + 2], lines[TOP + 3] = lines[TOP + 3], lines[TOP + 2]
    refuse_sealed(lines, "time goes from", "must increase")


def test_cells_that_are_no_finite_numbers_are_refused_with_their_place(tmp_path, refuse_sealed):
    good = saved_lines(make_recording(), tmp_path / "file.csv")
    texts = ("nan", "inf", f"-1e{'9' * 20}", "", "abc", "0x1", "snan", "1_0", "٣")
    for name in ("time_s", "duty_left", "joint_rate_2_deg_s", "bend_angle_deg"):
        for text in texts:
            if name != "bend_angle_deg" or text not in ("", "nan"):  # a reading may be missing
                lines = [*good]
                set_cell(lines, 2, name, text)
                refuse_sealed(lines, f"line {TOP + 4}")


def test_more_columns_than_any_robot_has_are_refused_at_the_header(lines, refuse_sealed):
    lines[TOP] += ",a" * 10**6
    refuse_sealed(lines, f"line {TOP + 1} names 10000", "columns; no robot has more than 50000")


def test_readings_that_are_missing_come_back(tmp_path, lines, refuse_sealed):
    """As an empty cell, which is written, or as nan; those of a trajectory are refused."""
    set_cell(lines, 1, "bend_angle_deg", "")
    set_cell(lines, 2, "measured_temperature_right_c", "nan")
    write_sealed(tmp_path / "file.csv", lines)
    loaded = Recording.load(tmp_path / "file.csv")
    assert loaded.missing.tolist() == [False, True, True, False]
    assert np.isnan(loaded.bend_angle[0]).tolist() == [False, True, False, False]
    assert "2 of 4 samples missing" in str(loaded)
    assert_identical(save_and_load(loaded, tmp_path / "again.csv"), loaded)
    assert "nan" not in (tmp_path / "again.csv").read_text()
    with pytest.raises(LimbError, match="not finite"):
        make_trajectory(measured_temperature=[[np.nan] * 4] * 2)
    plan = saved_lines(make_trajectory(), tmp_path / "plan.csv")
    set_cell(plan, 2, "bend_angle_deg", "nan")
    refuse_sealed(plan, "contains a cell that is not a number", kind=Trajectory)


def test_values_out_of_range_are_refused_with_their_time(tmp_path, refuse_sealed):
    time = make_recording().time[2]
    for make, kind, name, text, words in (
        (make_recording, Recording, "duty_right", "1.0000000000000002", ["duty", "0 to 1"]),
        (make_recording, Recording, "wire_temperature_right_c", "-273.15", ["-60"]),
        (make_trajectory, Trajectory, "duty_left", "-5e-324", ["duty", "0 to 1"]),
    ):
        lines = saved_lines(make(), tmp_path / "file.csv")
        set_cell(lines, 2, name, text)
        refuse_sealed(lines, *words, f"{time:g} s", kind=kind)


def test_implausible_measurements_are_kept_and_reported(tmp_path, refused):
    path, time = tmp_path / "file.csv", make_recording().time[2]
    for name, value, said, allowed in (
        ("bend_angle_deg", -180.0000001, "bend_angle is [-3.14", "from -3.14159 to 3.14159 rad"),
        ("measured_temperature_right_c", 700.0, "measured_temperature is [", "-60 to 600 °C"),
    ):
        lines = saved_lines(make_recording(), path)
        for sample in (2, 3):
            set_cell(lines, sample, name, repr(value))
        write_sealed(path, lines)
        recording = Recording.load(path)
        assert recording.implausible.tolist() == [False, False, True, True]
        assert_identical(save_and_load(recording, path), recording)
        doubt = recording.summary().texts()["doubt"]
        assert doubt == f"2 of 4 samples out of range, the first at {time:g} s"
        with refused(LimbError, said, f"at {time:g} s", allowed):
            recording.check_plausible()


def test_trajectory_whose_check_failed_is_not_saved(tmp_path, refused):
    for change, words in (
        ({"largest_defect": 2e-6}, ["dynamics"]),
        ({"largest_difference_deg": 0.51}, ["0.510", "0.5°", "knots"]),
    ):
        failed = make_trajectory(check=dataclasses.replace(PASSED, **change))
        with refused(LimbError, "failed its check", *words):
            failed.save(tmp_path / "file.csv")
    assert list(tmp_path.iterdir()) == []


def test_interrupted_writing_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "file.csv"
    make_recording().save(path)
    before = path.read_bytes()
    for function in ("replace", "fsync", "chmod"):
        for error in (OSError("disk full"), KeyboardInterrupt()):

            def interrupt(*_, error=error, **__):
                raise error

            expected_error = OutputError if isinstance(error, OSError) else type(error)
            with monkeypatch.context() as patch:
                patch.setattr(os, function, interrupt)
                with pytest.raises(expected_error):
                    make_recording(samples=10).save(path)
                with pytest.raises(expected_error):
                    LimbParameters().save(tmp_path / "limb.yaml")
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
