"""Recordings and plans in Parquet and MCAP, read back by these tools alone, and logs in them."""

import dataclasses
import io
import json

import numpy as np
import pytest

pytest.importorskip("mcap")
pytest.importorskip("pyarrow")
import convert
import pandas
import pyarrow.parquet
from mcap.reader import make_reader
from mcap.writer import Writer

from limb_systems import Limb, PlanCheck, Provenance, Recording, simulate
from soft_limb.command import run_words

pytestmark = pytest.mark.whole


def run(*words) -> int:
    return run_words(convert.COMMAND, "convert.py", list(map(str, words)))


@pytest.fixture(scope="module")
def recording():
    recorded = simulate(Limb(), [0.0, 0.3], 1.0)
    recorded.bend_angle = recorded.bend_angle + np.deg2rad(0.4)
    return recorded


@pytest.fixture
def path(recording, tmp_path):
    recording.save(tmp_path / "recording.csv")
    return tmp_path / "recording.csv"


@pytest.fixture
def table(path):
    """Return the CSV as pandas reads it."""
    return pandas.read_csv(path, comment="#", index_col="time_s")


def test_parquet_has_the_numbers_units_and_provenance(recording, path, table, capsys):
    output = path.with_suffix(".parquet")
    assert run(path, "-o", output) == 0
    assert capsys.readouterr().out == f"written     {output}\n"
    read = pyarrow.parquet.read_table(output)
    assert {str(kind) for kind in read.schema.types} == {"double"}
    assert read["time_s"].to_numpy().tobytes() == recording.time.tobytes()
    measured = read["measured_temperature_right_c"].to_numpy()
    assert measured.tobytes() == recording.measured_temperature[1].tobytes()
    assert read.schema.field("bend_angle_deg").metadata == {b"unit": "°".encode()}
    about = json.loads(read.schema.metadata[b"soft_limb"])
    assert about["parameters"] == recording.parameters.to_yaml()
    frame = pandas.read_parquet(output)
    pandas.testing.assert_frame_equal(frame, table, check_exact=True)
    assert frame["bend_angle_deg"].iloc[0] == 0.4
    units = frame.attrs["units"]
    assert set(units) == {"time_s", *frame}
    assert units["joint_rate_1_deg_s"] == "°/s"
    assert units["measured_temperature_left_c"] == "°C"
    assert (units["time_s"], units["duty_left"]) == ("s", "1")
    assert Provenance(**frame.attrs["provenance"]) == recording.provenance


def test_a_plan_without_a_check_becomes_parquet(recording, tmp_path, plan_like):
    plan = plan_like(recording, check=PlanCheck("IPOPT", "solved", cost=0.1 + 0.2))
    plan.save(tmp_path / "plan.csv")
    assert run(tmp_path / "plan.csv", "-o", tmp_path / "p.parquet") == 0
    attrs = pandas.read_parquet(tmp_path / "p.parquet").attrs
    assert attrs["check"]["tolerance_deg"] is None  # JSON has no NaN
    assert attrs["check"]["cost"] == 0.1 + 0.2


def test_mcap_has_a_channel_for_each_signal(recording, path, table, gait):
    gait.save(path.with_name("gait.csv"))
    assert run(path, path.with_name("gait.csv"), "--format", "mcap", "-o", path.parent / "m") == 0
    assert b"/body_pose" in (path.parent / "m" / "gait.mcap").read_bytes()
    reader = make_reader(io.BytesIO((path.parent / "m" / "recording.mcap").read_bytes()))
    rows = {}
    for schema, channel, message in reader.iter_messages():
        assert schema.encoding == "jsonschema"
        properties = json.loads(schema.data)["properties"]
        content = json.loads(message.data)
        assert list(properties) == list(content)
        assert message.log_time == round(content["time_s"] * 1e9)
        rows.setdefault(channel.topic, []).append(content)
        if channel.topic == "/bend_angle":
            assert properties["bend_angle_deg"]["description"] == "°"
    signals = ("duty", "measured_temperature", "bend_angle", "wire_temperature", "joint_state")
    assert set(rows) == {f"/{signal}" for signal in signals}
    frames = [pandas.DataFrame(group).set_index("time_s") for group in rows.values()]
    read = pandas.concat(frames, axis=1)
    pandas.testing.assert_frame_equal(read[list(table)], table, check_exact=True)
    (metadata,) = reader.iter_metadata()
    assert json.loads(metadata.metadata["provenance"]) == dataclasses.asdict(recording.provenance)


@pytest.mark.parametrize("kind", ["parquet", "mcap"])
def test_a_log_becomes_a_csv_that_import_reads(tmp_path, kind):
    """Each bag has messages of one topic in JSON, and of another as ROS 2 writes it."""
    pytest.importorskip("cyclonedds")
    from ros_bridge.dds import Dimension, Float64MultiArray, Layout

    time = np.arange(0.0, 60.0, 0.1)
    duty = 0.5 * (time % 20 > 10)
    heat = np.convolve(duty, np.exp(-0.02 * np.arange(len(time))))[: len(time)]
    log = pandas.DataFrame({"heater_duty": duty, "tc_c": 25 + heat, "bend_deg": 2 * heat})
    path = tmp_path / f"log.{kind}"
    if kind == "parquet":
        log.insert(0, "time_s", time)
        log.to_parquet(path)
    else:
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            floats = writer.register_schema("std_msgs/msg/Float64MultiArray", "ros2msg", b"")
            sensors = writer.register_channel("/sensors", "cdr", floats)
            command = writer.register_channel("/heater_duty", "json", 0)
            layout = Layout([Dimension("tc_c,bend_deg", 2, 2)], 0)
            for moment, (share, *numbers) in zip(time, log.to_numpy().tolist(), strict=True):
                at = 10**18 + round(1e9 * moment)
                content = json.dumps({"heater_duty": share}).encode()
                writer.add_message(command, at, content, at)
                data = Float64MultiArray(layout, numbers).serialize()
                writer.add_message(sensors, at, data, at)
            writer.finish()
    assert run(path, "-o", tmp_path / "log.csv") == 0
    read = Recording.from_log(tmp_path / "log.csv")
    np.testing.assert_allclose(read.time, time, atol=1e-6)
    np.testing.assert_allclose(read.measured_temperature[0], log["tc_c"], atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(read.bend_angle[0]), log["bend_deg"], atol=1e-9)
    np.testing.assert_allclose(read.duty[0][1:], duty[:-1], atol=1e-9)  # since the row before


def test_other_files_are_not_converted(path, tmp_path, capsys):
    (tmp_path / "empty.mcap").write_bytes(b"")
    for words, said in (
        ([path, "-o", tmp_path / "x.csv"], "cannot become"),
        ([path, "-o", tmp_path / "x.xlsx"], "cannot become"),
        ([path, "-o", path, "--format", "mcap"], "is read by the same command"),
    ):
        assert run(*words) == 1
        assert said in capsys.readouterr().err
