"""Logs of other programs, written here from signals that are known, and read back."""

import dataclasses
import datetime
import json
import re

import numpy as np
import pytest

from calibration.import_logs import signals as reading
from calibration.import_logs import table
from calibration.import_logs.importing import import_logs
from calibration.import_logs.mapping import LogMapping
from limb_systems import ChordSensor, LimbError, LimbParameters, Recording
from limb_systems.model.bend_sensor import chord_angle
from soft_limb.command import main

LINKS = 4


class Truth:
    """A limb's signals at a logger's times: duty steps, wires that warm and cool, a bend."""

    def __init__(self, rate=10.0, duration=240.0, jitter=0.0, seed=0, wires=(0, 1)):
        random = np.random.default_rng(seed)
        steps = (1 + jitter * random.uniform(-1, 1, int(duration * rate))) / rate
        self.time = np.append(0.0, np.cumsum(steps))
        self.duty = np.zeros((2, len(self.time)))
        starts = np.arange(5.0, duration - 20, 30.0)
        for number, start in enumerate(starts):
            on = (self.time >= start) & (self.time < start + 8.0)
            self.duty[wires[number % len(wires)], on] = [0.3, 0.5, 0.4][number % 3]
        warm = np.zeros_like(self.duty)
        for k, step in enumerate(np.diff(self.time), 1):
            warm[:, k] = warm[:, k - 1] + step * (20 * self.duty[:, k - 1] - 0.07 * warm[:, k - 1])
        self.temperature = 22.0 + warm
        self.bend = np.deg2rad(0.5) * (warm[1] - warm[0])  # rad, right is positive


@pytest.fixture(scope="module")
def truth():
    return Truth()


def write(path, names, columns, *, delimiter=",", head="", decimal=".", form="{:.6g}"):
    rows = [delimiter.join(names)] if names else []
    for row in zip(*columns, strict=True):
        cells = [cell if isinstance(cell, str) else form.format(cell) for cell in row]
        rows.append(delimiter.join(cell.replace(".", decimal) for cell in cells))
    path.write_text(head + "\n".join(rows) + "\n")
    return path


def read(path):
    (log,) = import_logs([path])
    return log.limb, log.recordings, log.remarks


def check(recording, truth, tolerance_deg=0.1):
    """A recording has the heat of the truth, and its readings when they were taken."""
    end = recording.time[-1]
    dose = [np.trapezoid(np.interp(truth.time, truth.time, d), truth.time) for d in truth.duty]
    heat = (recording.duty[:, 1:] * np.diff(recording.time)).sum(axis=1)
    np.testing.assert_allclose(heat, dose, rtol=0.02)
    taken = recording.time - recording.sample_age
    shown = ~recording.missing
    for read_, true in zip(recording.measured_temperature, truth.temperature, strict=True):
        np.testing.assert_allclose(
            read_[shown], np.interp(taken, truth.time, true)[shown], atol=0.06
        )
    np.testing.assert_allclose(
        np.rad2deg(recording.bend_angle[0][shown]),
        np.rad2deg(np.interp(taken, truth.time, truth.bend))[shown],
        atol=tolerance_deg,
    )
    assert end > 0.98 * truth.time[-1]


def sma_log(path, truth, *, tags=True, pairs=(0, 1, 3, 2), limb=0, turned=20.0, down=1):
    """A logger of two limbs in series with nine tags; one limb is heated."""
    count = len(truth.time)
    zeros = np.zeros(count)
    duty = {(limb, "fwd"): truth.duty[1], (limb, "rev"): truth.duty[0]}
    order = [(0, "rev"), (0, "fwd"), (1, "rev"), (1, "fwd")]
    sensors = np.full((4, count), 22.0) + 0.01 * np.arange(4)[:, None] * np.ones(count)
    for wire, sensor in zip(order, pairs, strict=True):
        if wire[0] == limb:
            sensors[sensor] = truth.temperature[int(wire[1] == "fwd")]
    bends = {limb: truth.bend, 1 - limb: zeros}
    directions, points = np.full(count, np.deg2rad(turned)), [np.full((2, count), 100.0)]
    for one in (0, 1):
        for link in range(LINKS):  # constant curvature: the tangent turns by 2 φ over a limb
            middle = directions + down * 2 * bends[one] * (link + 0.5) / LINKS
            points.append(points[-1] + 60 * np.array([np.cos(middle), -np.sin(middle)]))
        directions = directions + down * 2 * bends[one]
    tagged = np.array(points).reshape(18, count) if tags else np.zeros((18, count))
    tagged[:, :6] = 0.0
    names = ["Timestamp (millisec since midnight today)", "Test time"]
    names += [f"pwm_duty_limb{k}_{w}" for k in (0, 1) for w in ("fwd", "rev")]
    names += ["temp_limit", "Bendlabs_0", "Bendlabs_1", *[f"MCPtemp_{i}" for i in range(4)]]
    names += [f"tagid_{axis}_{n}" for n in range(101, 110) for axis in "xy"]
    stamps = np.round(86_390_000 + 1000 * truth.time) % 86_400_000  # over midnight
    columns = [stamps, np.maximum(truth.time - 0.2, 0.0)]
    columns += [duty.get((k, w), zeros) for k in (0, 1) for w in ("fwd", "rev")]
    bendlabs = [zeros if tags else np.rad2deg(2 * down * bends[k]) for k in (0, 1)]
    columns += [zeros + 115, *bendlabs, *sensors, *tagged]
    head = (
        "ezloophw-py logger started on:,2023-4-5_103045\n"
        "ctrl_params:,{'u_offset': array([1030., 1030]), 'bookends': ('<', '>')}\n"
    )
    return write(path, names, columns, head=head, form="{:.8g}")


@pytest.mark.parametrize(
    ("limb", "tags", "pairs", "down"), [(0, True, (0, 1, 3, 2), -1), (1, True, (2, 0, 1, 3), 1)]
)
def test_logger_of_sma_limbs_over_midnight(tmp_path, limb, tags, pairs, down):
    truth = Truth(rate=5.0)
    path = sma_log(tmp_path / "log.csv", truth, tags=tags, pairs=pairs, limb=limb, down=down)
    found, (recording,), _ = read(path)
    chosen = [wire.temperature for wire in found.mapping.wires]
    assert chosen == [f"MCPtemp_{sensor}" for sensor in pairs[2 * limb : 2 * limb + 2]]
    truth.time -= truth.time[6]  # the first rows have no tags
    for name in ("time", "duty", "temperature", "bend"):
        setattr(truth, name, getattr(truth, name)[..., 6:])
    # A chord of four links of constant curvature shows φ exactly.
    check(recording, truth, tolerance_deg=0.02 + 0.1 * (limb == 1))
    assert isinstance(recording.parameters.segments[0].bend_sensor, ChordSensor)
    links = np.full(4, np.deg2rad(5.0))
    assert chord_angle(links) > 0  # E2 is where positive joints bend to


def test_bend_sensors_of_that_logger_show_the_tip_tangent(tmp_path, truth):
    _, (recording,), remarks = read(sma_log(tmp_path / "log.csv", truth, tags=False))
    check(recording, truth)
    assert not remarks


def test_both_limbs_of_a_log_get_recordings(tmp_path, truth, capsys):
    path = sma_log(tmp_path / "two limbs.csv", truth)
    text = path.read_text().replace("limb1_fwd", "limb2_fwd").replace("limb0_rev", "limb1_fwd")
    path.write_text(text.replace("limb2_fwd", "limb0_rev"))  # the other limb gets its duty
    assert main(["import", str(path), "-o", str(tmp_path / "out"), "--json"]) == 0
    written = json.loads(capsys.readouterr().out)["written"]
    names = [name.removeprefix(str(tmp_path / "out")) for name in written]
    assert "/limb_0/two_limbs.csv" in names
    assert "/limb_1/two_limbs.csv" in names


def test_any_table_of_a_spreadsheet(tmp_path):
    truth = Truth(rate=20.0, jitter=0.3)
    keep = np.random.default_rng(1).random(len(truth.time)) > 0.03
    keep[:2] = True
    start = datetime.datetime(2026, 3, 1, 23, 59, 0)
    moments = [
        (start + datetime.timedelta(seconds=t)).strftime("%d.%m.%Y %H:%M:%S.%f") for t in truth.time
    ]
    signals = [
        moments,
        np.round(255 * truth.duty[0]),
        np.round(255 * truth.duty[1]),
        1.8 * truth.temperature[1] + 32,  # the thermocouples are swapped
        1.8 * truth.temperature[0] + 32,
        -truth.bend,
    ]
    columns = [[c for c, k in zip(column, keep, strict=True) if k] for column in signals]
    columns[3][50] = "-999"
    columns[4][60] = "NaN"
    path = write(
        tmp_path / "log.csv",
        ["Zeit", "PWM L", "PWM R", "T1 [F]", "T2 [F]", "Winkel (rad)"],
        columns,
        delimiter=";",
        decimal=",",
        head="Messung 7;;;;;\n",
        form="{:.7g}",
    )
    found, (recording,), remarks = read(path)
    assert [wire.temperature for wire in found.mapping.wires] == ["T2 [F]", "T1 [F]"]
    check(recording, truth)
    assert recording.sample_rate == pytest.approx(20.0, rel=0.05)
    assert any("lack a reading" in remark for remark in remarks)


def test_counts_of_a_sensor_are_asked_for_and_then_read(tmp_path, truth, capsys):
    counts = np.round(2048 - 11.4 * np.rad2deg(truth.bend))
    path = write(
        tmp_path / "board.txt",
        ["ms", "duty_r", "duty_l", "flex_raw", "tc0", "tc1"],
        [1000 * truth.time, 100 * truth.duty[1], 100 * truth.duty[0], counts, *truth.temperature],
        delimiter="\t",
    )
    assert main(["import", str(path), "-o", str(tmp_path / "out")]) == 2
    assert "as a negative number" in capsys.readouterr().out
    mapping = tmp_path / "out" / "board.mapping.yaml"
    text = mapping.read_text()
    assert "scale: 0.0" in text
    mapping.write_text(text.replace("scale: 0.0", f"scale: {-1 / 11.4}"))
    recording = Recording.from_log(path, mapping)
    check(recording, truth)
    mapping.write_text(mapping.read_text().replace("full: 100.0", "full: 10.0"))
    with pytest.raises(LimbError, match=r"duty_l.*reaches 50.*correct its full"):
        Recording.from_log(path, mapping)


NAMES = ("time_s", "duty_left", "duty_right", "temp_left_c", "temp_right_c", "bend_deg")


def signals(truth):
    return [truth.time, *truth.duty, *truth.temperature, np.rad2deg(truth.bend)]


@pytest.mark.parametrize(
    ("column", "name", "scale", "asked"),
    [
        (5, "Voltage", 0.02, "? bend: .*Voltage is a voltage, by its name"),
        (5, "sensor [kPa]", 0.1, "? bend: .*is a pressure, by its unit kPa"),
        (5, "gyro_deg_s", 1.0, "? bend: .*gyro_deg_s is a rate"),
        (5, "tip", 0.01, "? bend.scale is 0: give the degrees of a unit of tip"),
        (2, "Current", 2.0, "? duty: Current is a current, by its name"),
        (1, "heater_left [W]", 6.0, "? full: .*what is full duty"),
        (0, "time_s", 1000.0, "? unit of time_s"),
        (0, "sample", 10.0, "? time: no column is a time"),
        (3, "temp_left_f", 1.0, "? unit of temp_left_f: C, F or K"),
    ],
)
def test_what_a_name_or_unit_contradicts_is_asked_for(
    tmp_path, truth, capsys, column, name, scale, asked
):
    names, columns = [*NAMES], signals(truth)
    names[column], columns[column] = name, scale * columns[column]
    path = write(tmp_path / "log.csv", names, columns, form="{:.8g}")
    assert main(["import", str(path), "-o", str(tmp_path / "out")]) == 2
    assert re.search(asked.replace("?", r"\?", 1), capsys.readouterr().out)
    assert not list((tmp_path / "out").glob("*.csv"))
    with pytest.raises(LimbError):
        Recording.from_log(path)


@pytest.mark.parametrize("most", [47, 6.05])
def test_full_duty_is_asked_for_where_per_cent_and_counts_are_alike(tmp_path, truth, most):
    columns = signals(truth)
    columns[1:3] = [np.round(2 * most * duty, 2 * (most < 10)) for duty in truth.duty]
    names = ["t", "heat1", "heat2", "T1", "T2", "angle"]
    limb, recordings, _ = read(write(tmp_path / "log.csv", names, columns))
    assert limb.mapping.full == 0
    assert not recordings
    names[1:3] = ["heat1 (%)", "heat2 (%)"]
    limb, (recording,), _ = read(write(tmp_path / "log.csv", names, columns))
    assert recording.duty.max() == pytest.approx(most / 100, abs=0.01)


@pytest.mark.parametrize(
    ("clock", "encoding"),
    [
        ("%I:%M:%S.%f %p", "utf-16"),
        ("%H:%M:%S:%f", "utf-16-le"),
        ("%d/%m/%Y %H:%M:%S.%f", "utf-8-sig"),
    ],
)
def test_a_warm_log_of_another_encoding_and_clock(tmp_path, clock, encoding):
    """Units in a row of their own or in the cells, °F, from the evening to the morning."""
    truth = Truth()
    truth.duty *= 0.94  # so that numbers alone do not tell per cent from counts
    truth.temperature += 40 * np.exp(-truth.time / 30)
    start = datetime.datetime(2026, 3, 4, 23, 59, 0)
    moments = [(start + datetime.timedelta(seconds=t)).strftime(clock) for t in truth.time]
    shares = [[f"{100 * d:.0f}%" for d in duty] for duty in truth.duty]
    columns = [moments, *shares, *(1.8 * truth.temperature + 32), np.rad2deg(truth.bend)]
    columns = [[unit, *column] for unit, column in zip(["", "", "", "°F", "°F", "°"], columns)]  # noqa: B905
    columns.append(["status", *['5" tube' if k % 9 else "ok" for k in range(len(moments))]])
    names = ["Uhrzeit", "links", "rechts", "T links", "T rechts", "Winkel", "Zustand"]
    path = write(tmp_path / "log.csv", names, columns, delimiter="\t", form="{:.6g}")
    path.write_bytes(path.read_text().encode(encoding))
    _, (recording,), _ = read(path)
    check(recording, truth)


def test_a_long_log_is_read_in_blocks_and_cut_where_it_is_cold(tmp_path, truth, monkeypatch):
    path = write(tmp_path / "log.csv", NAMES, signals(truth))
    _, (whole,), _ = read(path)
    monkeypatch.setattr(table, "BLOCK", 300)
    monkeypatch.setattr(reading, "MOST", 1500)
    _, parts, remarks = read(path)
    assert [round(part.time[-1]) for part in parts] == [125, 115]
    assert any("no part has more than 1500 samples" in remark for remark in remarks)
    joined = np.concatenate([part.bend_angle[0] for part in parts])
    np.testing.assert_array_equal(joined, whole.bend_angle[0])


def test_gaps_of_unknown_duty_cut_a_log_and_others_do_not(tmp_path, truth):
    heated = (truth.time > 66.0) & (truth.time < 80.0)  # duty falls to 0 in between
    off = (truth.time > 91.0) & (truth.time < 94.0)
    rows = np.flatnonzero(~(heated | off))
    path = write(tmp_path / "log.csv", NAMES, [column[rows] for column in signals(truth)])
    _, recordings, remarks = read(path)
    assert [round(recording.time[-1]) for recording in recordings] == [66, 160]
    assert any("Cut after 66 s" in remark for remark in remarks)
    gap = (recordings[1].time > 11.6) & (recordings[1].time < 13.9)
    assert recordings[1].missing[gap].all()
    with pytest.warns(UserWarning, match="longest of 2 parts"):
        assert Recording.from_log(path).time[-1] == pytest.approx(160, abs=0.2)


def test_times_without_fractions_of_seconds_are_spread(tmp_path, truth):
    start = datetime.datetime(2026, 3, 1, 12, 0, 0)
    cut = [(start + datetime.timedelta(seconds=t + 0.35)).strftime("%H:%M:%S") for t in truth.time]
    path = write(
        tmp_path / "log.csv",
        ["when", "heater_a", "heater_b", "probe_a", "probe_b", "bend"],
        [cut, *truth.duty, *truth.temperature, np.rad2deg(truth.bend)],
    )
    _, (recording,), remarks = read(path)
    assert any("spread" in remark for remark in remarks)
    check(recording, truth, tolerance_deg=0.3)


def test_signed_duty_and_one_wire(tmp_path, truth):
    signed = truth.duty[1] - truth.duty[0]
    readings = [*truth.temperature, np.rad2deg(truth.bend)]
    names = ["t", "u", "T_a", "T_b", "angle"]
    _, (recording,), _ = read(write(tmp_path / "a.csv", names, [truth.time, signed, *readings]))
    check(recording, truth)
    one = Truth(wires=(1,))
    columns = [one.time, one.duty[1], one.temperature[1], np.rad2deg(one.bend)]
    _, (recording,), _ = read(
        write(tmp_path / "b.csv", ["t", "heater", "temperature", "angle"], columns)
    )
    assert recording.parameters.wire_names == ["right"]
    two = Recording.from_log(
        tmp_path / "b.csv", import_logs([tmp_path / "b.csv"])[0].limb.mapping, LimbParameters()
    )
    assert np.isnan(two.measured_temperature[0]).all()


def test_a_log_without_a_column_of_its_format_is_named(tmp_path, truth):
    path = sma_log(tmp_path / "log.csv", truth)
    path.write_text(path.read_text().replace("pwm_duty_limb0_rev", "lost"))
    with pytest.raises(LimbError, match=r"log\.csv: no column 'pwm_duty_limb0_rev'"):
        Recording.from_log(path)


def rows(names, form):
    return "\n".join([names, *(form.format(i, i % 2, i % 7) for i in range(50))]).encode()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "is not text"),
        (b"", "no rows of numbers"),
        (b"# limb recording, format 3\n", "is no log, but a recording of soft-limb"),
        (b"time,duty\n", "no rows of numbers"),
        (rows("time,duty,bend", "{0},{1},{2}") + b"\n1,2," + b"x" * 200_000, "in line 52"),
        (rows("time,duty", "{0},{1},{2}"), "has 2 names in line 1, but 3 cells"),
        (b"x" * 10_000_000, "more than 100000 characters in line 1"),
        (rows("time,duty,bend", "{0},{1},0"), "no column is known for the bend"),
        (rows("ms,duty,bend", "5,{1},{2}"), "'ms' holds no time that increases"),
        (rows("time,bend,temp", "{0},{2},22"), "no column is known for duty"),
    ],
)
def test_what_is_no_log_is_refused_in_a_sentence(tmp_path, content, said):
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    with pytest.raises(LimbError, match=said) as caught:
        Recording.from_log(path)
    assert str(path) in str(caught.value)


def test_mapping_with_a_mistake_names_its_field(tmp_path, truth):
    path = write(
        tmp_path / "log.csv",
        ["time_s", "duty", "temp_c", "bend_deg"],
        [truth.time, truth.duty[1], truth.temperature[1], np.rad2deg(truth.bend)],
    )
    mapping = import_logs([path])[0].limb.mapping
    mapping.save(tmp_path / "m.yaml", ["a remark"])
    assert LogMapping.load(tmp_path / "m.yaml") == mapping
    text = (tmp_path / "m.yaml").read_text()
    for right, wrong, said in (
        ("unit: s", "unit: days", r"time\.unit is 'days'"),
        ("column: time_s", "column: tiem", "no column 'tiem'"),
        ("scale: 1.0", "scale: 1e300", r"bend\.scale is 1e\+300.* from -1e\+06 to 1e\+06"),
        ("scale: 1.0", "scale: .nan", r"bend\.scale"),
        ("scale: 1.0", "scale: 1000.0", r"bend would be up to .*correct bend\.scale"),
        ("unit: C", "unit: K", "'temp_c' is beyond -60 to 600 °C .* correct its unit"),
        ("temperature: temp_c", "temperature: duty", "'duty' is given for duty of the right wire"),
        ("sign: 1.0", "sign: 0.5", "sign of the right wire is 0.5; it must be 1 or -1"),
    ):
        assert right in text
        (tmp_path / "m.yaml").write_text(text.replace(right, wrong))
        with pytest.raises(LimbError, match=said):
            Recording.from_log(path, tmp_path / "m.yaml")
    mapping.wires.append(dataclasses.replace(mapping.wires[0], name="left", temperature=""))
    with pytest.raises(LimbError, match="'duty' is given for duty of the right wire and for duty"):
        dataclasses.replace(mapping)
