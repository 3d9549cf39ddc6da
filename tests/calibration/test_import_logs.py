"""Logs of other programs, written here from signals that are known, and read back."""

import dataclasses
import datetime
import io
import json
import re

import numpy as np
import pytest
from any_log import any_log, faults
from logged_limb import OwnLimb

from calibration.import_logs import log_signals as reading
from calibration.import_logs import table
from calibration.import_logs.evidence import clear_pairs
from calibration.import_logs.importing import import_logs
from calibration.import_logs.mapping import LogMapping
from calibration.import_logs.points import is_clamped_at_first_point, link_directions
from limb_systems import ChordSensor, LimbError, LimbParameters, Recording
from soft_limb.command import main

LINKS = 4
RATE = 5.0  # Hz, of the log of most tests


class Truth:
    """A limb's signals at a logger's times: duty steps, wires that warm and cool, a bend."""

    def __init__(self, rate=RATE, duration=240.0, jitter=0.0, seed=0, wires=(0, 1)):
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


def check(recording, truth, tolerance_deg=0.1, sensors=(0, 1)):
    """A recording has the heat of the truth, and its readings when they were taken."""
    end = recording.time[-1]
    dose = [np.trapezoid(np.interp(truth.time, truth.time, d), truth.time) for d in truth.duty]
    heat = (recording.duty[:, 1:] * np.diff(recording.time)).sum(axis=1)
    np.testing.assert_allclose(heat, dose, rtol=0.02)
    taken = recording.time - recording.sample_age
    shown = ~recording.missing
    for wire in sensors:
        true = np.interp(taken, truth.time, truth.temperature[wire])
        np.testing.assert_allclose(
            recording.measured_temperature[wire][shown], true[shown], atol=0.06
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
    tagged += tags * np.random.default_rng(0).normal(0.0, 0.01, tagged.shape)  # as cameras have it
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


def test_bend_sensors_of_that_logger_show_the_tip_tangent(tmp_path, truth):
    path = sma_log(tmp_path / "log.csv", truth, tags=False)
    _, (recording,), remarks = read(path)
    check(recording, truth)
    assert not remarks
    path.write_text(path.read_text().replace("pwm_duty_limb0_rev", "lost"))
    with pytest.raises(LimbError, match=r"log\.csv: no column 'pwm_duty_limb0_rev'"):
        Recording.from_log(path)


def test_both_limbs_of_a_log_get_recordings(tmp_path, truth, capsys):
    path = sma_log(tmp_path / "two limbs.csv", truth)
    # The logger's other limb gets the duty of one wire; its bend does not follow it.
    text = path.read_text().replace("limb1_fwd", "limb2_fwd").replace("limb0_rev", "limb1_fwd")
    path.write_text(text.replace("limb2_fwd", "limb0_rev"))
    assert main(["import", str(path), "-o", str(tmp_path / "out"), "--json"]) == 2
    written = json.loads(capsys.readouterr().out)["written"]
    names = [name.removeprefix(str(tmp_path / "out")) for name in written]
    assert "/limb_0/two_limbs.csv" in names
    assert "/limb_1/two_limbs.mapping.yaml" in names
    assert "/limb_1/two_limbs.csv" not in names


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
    columns[4][400] = "0"
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
    # The applied duty is the mean since the row before, so that it has the heat of the log's rows.
    taken, first = np.unique((recording.time - recording.sample_age).round(6), return_index=True)
    heat = (recording.applied_duty[:, first[1:]] * np.diff(taken)).sum(axis=1)
    duty = np.round(255 * truth.duty[:, keep]) / 255
    np.testing.assert_allclose(heat, duty[:, :-1] @ np.diff(truth.time[keep]), rtol=1e-5)
    assert recording.sample_rate == pytest.approx(20.0, rel=0.05)
    assert any("lack a reading" in remark for remark in remarks)


NAMES = ("time_s", "duty_left", "duty_right", "temp_left_c", "temp_right_c", "bend_deg")


def signals(truth):
    return [truth.time, *truth.duty, *truth.temperature, np.rad2deg(truth.bend)]


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


def test_a_long_log_is_read_in_blocks_and_cut_into_parts(tmp_path, truth, monkeypatch):
    path = write(tmp_path / "log.csv", NAMES, signals(truth))
    _, (whole,), _ = read(path)
    monkeypatch.setattr(table, "BLOCK_CHARACTERS", 1000)
    monkeypatch.setattr(reading, "MAX_SAMPLES", 750)
    _, parts, remarks = read(path)
    assert [round(part.time[-1]) for part in parts] == [150, 90]
    assert any("no part has more than 750 samples" in remark for remark in remarks)
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


def test_one_wire_of_a_limb_of_two(tmp_path):
    one = Truth(wires=(1,))
    columns = [one.time, one.duty[1], one.temperature[1], np.rad2deg(one.bend)]
    path = write(tmp_path / "log.csv", ["t", "heater", "temperature", "angle"], columns)
    limb, (recording,), _ = read(path)
    assert recording.parameters.wire_names == ["right"]
    two = Recording.from_log(path, limb.mapping, LimbParameters())
    assert np.isnan(two.measured_temperature[0]).all()


def rows(names, form):
    return "\n".join([names, *(form.format(i, i % 2, i % 7) for i in range(50))]).encode()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "is not text"),
        (b"", "no rows of numbers"),
        (b"# limb recording, format 3\n", "is no log, but a recording of soft-limb"),
        (b"time,duty\n", "no rows of numbers"),
        (
            rows("time,duty,bend", "{0},{1},0") + b"\n1,2," + b"x" * 200_000,
            "no column seems to be the b",
        ),
        (rows("time,duty", "{0},{1},{2}"), "has 2 names in line 1, but 3 cells"),
        (b"x" * 10_000_000, "no rows of numbers"),
        (rows("time,duty,bend", "{0},{1},0"), "no column seems to be the bend"),
        (rows("ms,duty,bend", "5,{1},{2}"), "no column is a time that increases"),
        (rows("frame,duty,bend", "{2},{1},{2}"), "time that increases: give the rate of the rows"),
        (rows("time,wire,temp", "{0},1,{2}\n{0},2,9"), "temp has several rows for each time"),
        (rows("time,bend,temp", "{0},{2},22"), "no column seems to be the duty"),
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
        ("full: 1.0", "full: 0.1", "'duty' reaches 0.5, beyond full duty.*correct its full"),
        ("scale: 1.0", "scale: 1000.0", r"bend would be up to .*correct bend\.scale"),
        ("unit: C", "unit: K", "'temp_c' is beyond -60 to 600 °C .* correct its unit"),
        ("temperature: temp_c", "temperature: duty", "'duty' is given for two signals"),
        ("sign: 1.0", "sign: 0.5", r"wires\[0\]\.sign is '0\.5'; it must be one of 1\.0, -1\.0"),
    ):
        assert right in text
        (tmp_path / "m.yaml").write_text(text.replace(right, wrong))
        with pytest.raises(LimbError, match=said):
            Recording.from_log(path, tmp_path / "m.yaml")
    mapping.wires.append(dataclasses.replace(mapping.wires[0], name="left", temperature=""))
    with pytest.raises(LimbError, match="'duty' is given for two signals"):
        dataclasses.replace(mapping)


def test_a_line_without_names_gives_no_names(tmp_path, truth):
    columns = [truth.time, *truth.duty]
    path = write(tmp_path / "log.csv", [""] * 3, columns, head=",,\n")
    assert table.read_table(path).names == ["column_1", "column_2", "column_3"]


def test_numbers_that_no_sensor_reads_are_left_out_unless_readings_are_as_large(tmp_path, truth):
    signed = np.round(254 * (truth.duty[0] - truth.duty[1]))
    assert -127.0 in signed
    row = np.arange(len(truth.time))
    bend = np.where(row % 50 == 9, 1e12, np.rad2deg(truth.bend))
    columns = [truth.time, signed, *truth.temperature, bend]
    columns[3] = np.where(row % 20 == 3, 0.0, columns[3])
    names = ["time_s", "u", "T1", "T2", "bend_deg"]
    (log,) = import_logs([write(tmp_path / "signed.csv", names, columns)])
    assert (log.limb.mapping.missing, log.limb.questions) == ([], [])
    columns[2] = np.where(row % 50 == 7, -127.0, columns[2])
    (log,) = import_logs([write(tmp_path / "missing.csv", names, columns)])
    assert log.limb.mapping.missing == ["-127.0"]


def test_cells_are_numbers_with_units_and_switches_but_not_names_that_begin_with_a_number():
    cells = {"22.5 °C": 22.5, "-1,5 V": -1.5, "HIGH": 1.0, "low": 0.0, "on": 1.0}
    for cell, expected in cells.items():
        assert table.number(cell, "," if "," in cell else ".") == expected
    for name in ("101 (C)", "2 [V]"):
        assert np.isnan(table.number(name))
        assert table.is_name(name)


def test_a_few_bends_that_no_limb_has_are_left_out(tmp_path, truth):
    degrees = np.rad2deg(truth.bend)
    degrees[1::50] = 300.0
    duty_and_temperatures = [*truth.duty, *truth.temperature]
    path = write(tmp_path / "log.csv", NAMES, [truth.time, *duty_and_temperatures, degrees])
    _, (recording,), remarks = read(path)
    assert np.isnan(recording.bend_angle[0, 1::50]).all()
    assert any("lack a reading" in remark for remark in remarks)


def test_points_that_trackers_have_lost_have_no_direction():
    """Trackers repeat the last place of a point, or write 0, 0."""
    base = np.array([[50.0], [50.0]]) + np.zeros(20)
    tip = np.array([100.0, 50.0])[:, None] - [np.zeros(20), np.arange(20.0)]  # y points down
    tip[:, 8:15] = tip[:, 8:9]
    base[:, 18] = 0.0
    (directions,) = link_directions([*base, *tip])
    seen = [*range(13), 15, 16, 17, 19]  # the tip stands still for four rows at most
    expected = np.rad2deg(np.arctan2(50.0 - tip[1, seen], 50.0))
    np.testing.assert_allclose(directions[seen], expected)
    assert np.isnan(np.delete(directions, seen)).all()


@pytest.mark.parametrize(
    ("gains", "errors", "expected"),
    [
        ([[10.0, 1.0], [1.0, 10.0]], 1.0, [0, 1]),
        ([[10.0, 1.0], [1.0, 10.0]], 2.0, [None, None]),  # larger by 2.4 standard errors
        ([[10.0, 8.0], [8.0, 10.0]], 0.1, [None, None]),  # larger by less than the factor
        ([[10.0, 0.0]], [[1.0, np.inf]], [0, None]),  # a wire without heat
    ],
)
def test_a_wire_has_a_thermocouple_that_it_clearly_warms_more_than_others(gains, errors, expected):
    gains = np.array(gains)
    assert clear_pairs(gains, np.broadcast_to(errors, gains.shape)) == expected


def test_links_of_an_even_bend_turn_less_if_the_first_point_is_before_the_base():
    curvature = np.linspace(0.1, 0.9, 9)
    length = np.array([[0.0], [0.5], [1.0]])
    x = np.sin(curvature * length) / curvature
    y = (1.0 - np.cos(curvature * length)) / curvature
    assert is_clamped_at_first_point(x, y)
    x[0] = -0.5
    assert not is_clamped_at_first_point(x, y)


def moments(truth, form):
    start = datetime.datetime(2026, 3, 3, 23, 58, 3)
    return [(start + datetime.timedelta(seconds=round(t, 3))).strftime(form) for t in truth.time]


@pytest.fixture(scope="module")
def cases(truth):
    """Columns of logs in forms that practitioners' programs write, by their names."""
    counts = np.round(255 * truth.duty)
    temperatures = truth.temperature
    degrees = np.rad2deg(truth.bend)
    base = [truth.time, *counts, *temperatures, degrees]
    warm = truth.temperature + [[42.0], [26.0]] * np.exp(-truth.time / 200)
    noise = np.random.default_rng(0).normal(0.0, 0.05, (6, len(truth.time)))
    bent = 300 * np.array([np.cos(truth.bend), -np.sin(truth.bend)])
    middle = 150 * np.array([np.cos(truth.bend / 2), -np.sin(truth.bend / 2)])
    points = [*(noise[:2] - [[90.0], [0.0]]), *noise[2:4], *middle, *bent]
    seconds = np.floor(truth.time)
    stamps = [1.7e9 + seconds, np.round(1e9 * (truth.time - seconds))]
    dates = moments(truth, "%d-%b-%Y %H:%M:%S.%f")
    names = "time_s pwm_left pwm_right T_left_C T_right_C bend_deg"
    numbers = "time_s pwm_1 pwm_2 T_1 T_2 bend_deg"
    numbers_of_sensors = "time_s pwm_left pwm_right T1 T2 bend_deg"
    crossed = [base[k] for k in (0, 2, 1, 4, 3, 5)]
    single = [f"{t:.3f}" for t in np.float32(270_000 + truth.time)]
    coupled = [[0.55, 0.45], [0.45, 0.55]] @ temperatures
    raw = np.round(2048 + 11.4 * degrees)
    whole = [moment[:-7] for moment in dates]
    duty = truth.duty[0]
    relay = 1.0 * (counts[1] > 0)
    marked = names.replace("bend_deg", "m1_x m1_y m2_x m2_y m3_x m3_y")
    percent = np.round(94 * truth.duty)
    early = truth.time < 60.0
    seven_bits = np.round(248 * truth.duty)  # or of more, whose most is 124
    in_fives = np.interp(truth.duty, [0.0, 0.3, 0.4, 0.5], [0, 25, 105, 150])  # also 8 bits
    raw_temperatures = np.round(4 * temperatures)

    def with_(column, name, values):
        """The columns with another one in a place."""
        changed = names.split()
        changed[column] = name
        return " ".join(changed), [*base[:column], values, *base[column + 1 :]]

    return {
        "coil": ("time_s pwm_coil_R pwm_coil_L T_R_C T_L_C angle_deg", crossed),
        "control": ("time_s control_left control_right T1 T2 angle_deg", base),
        "controlled things": (
            "time_s wire_left wire_right T1 T2 angle_deg",
            [base[0], counts[0] + np.arange(len(truth.time)) % 2, *base[2:]],
        ),
        "warmed by the other wire": (
            "time_s pwm_left T_right_C bend_deg",
            [*base[:2], 0.5 * (22.0 + temperatures[0]), degrees],
        ),
        "glued": ("ms PWMlinks Rpwm T_left T_right bend_deg", [1000 * base[0], *base[1:]]),
        "warm": (names, [*base[:3], *warm, base[5]]),
        "inverted": (names, [base[0], *(255 - counts), *base[3:]]),
        "held": (names, [*base[:2], 20.0 + 0.0 * duty, *base[3:]]),
        "inverted, to 0": (names, [base[0], *np.round(255 - 510 * truth.duty), *base[3:]]),
        "inverted, T1 and T2": (numbers_of_sensors, [base[0], *(255 - counts), *base[3:]]),
        "swapped": ("time_s pwm_left pwm_right T_right_C T_left_C bend_deg", base),
        "relay": (names.replace("pwm_right", "relay_2"), [*base[:2], relay, *base[3:]]),
        "dropped": ("time_s pwm_left T_left_C T_right_C bend_deg", base[:2] + base[3:]),
        "mixed units": (names.replace("_C", ""), [*base[:3], 1.8 * base[3] + 32, *base[4:]]),
        "signed": ("time_s u T1 T2 bend_deg", [base[0], base[1] - base[2], *base[3:]]),
        "signed sides": ("t u T_left T_right angle", [base[0], base[1] - base[2], *base[3:]]),
        "whole seconds": with_(0, "when", whole),
        "1 and 2": (numbers, crossed),
        "raw 1 and 2": (numbers.replace("bend_deg", "flex_raw"), [*base[:5], raw]),
        "noise 1 and 2": (numbers, [*base[:5], 20 * noise[3]]),
        "one side": (
            "time_s pwm_1 pwm_2 T_right bend_deg",
            [*base[:3], temperatures[1], -degrees],
        ),
        "same sensor": with_(4, "T_right_C", temperatures[0] + noise[2]),
        "coupled": ("time_s pwm_left pwm_right T1 T2 angle_deg", [*base[:3], *coupled, base[5]]),
        "sides of sensors": (numbers.replace("T_1 T_2", "T_right T_left"), crossed),
        "offset": with_(3, "T_left_C", temperatures[0] + 40.0),
        "short": (names, [c[early] for c in with_(3, "", temperatures[0] + 12.0)[1]]),
        "raw temperatures": (
            names.replace("_C", "_raw"),
            [*base[:3], *raw_temperatures, base[5]],
        ),
        "seven bits": (names, [base[0], *seven_bits, *base[3:]]),
        "fives": ("t heat1 heat2 T1 T2 angle", [base[0], *in_fives, *base[3:]]),
        "two units": with_(1, "pwm_left", duty),
        "shares": (names, [base[0], 2.0 * duty, 1.2 * truth.duty[1], *base[3:]]),
        "switch and levels": ("t heat1 heat2 T1 T2 angle", [base[0], duty, relay, *base[3:]]),
        "per cent or counts": ("t heat1 heat2 T1 T2 angle", [base[0], *percent, *base[3:]]),
        "left only, crossed": (
            names,
            [*base[:2], 0 * duty, 22.0 + noise[0], temperatures[0], 11.0 - temperatures[0] / 2],
        ),
        "of 100": ("t heat1 heat2 T1 T2 angle", [base[0], *(200.0 * truth.duty), *base[3:]]),
        "amperes": (names.replace("pwm", "current"), [base[0], *(2.0 * truth.duty), *base[3:]]),
        "no word is known": ("tempo a b c d e", base),
        "curvature": with_(5, "kappa", 10.0 * truth.bend),
        "turns": with_(5, "bend", degrees / 360.0),
        "counts of a bend": with_(5, "flex", np.round(30.0 + 1.7 * degrees)),
        "upright": with_(5, "angle_deg", 45.0 + degrees),
        "compass": with_(5, "angle_deg", degrees % 360.0),
        "ticks": with_(0, "tick", 62.5 * truth.time),
        "tenths": with_(0, "time", np.arange(len(truth.time))),
        "hanging": (
            names.replace("bend_deg", "base_x base_y tip_x tip_y"),
            [*base[:5], *noise[:2], -bent[1], bent[0]],
        ),
        "named rad": with_(5, "bend_deg", truth.bend),
        "no names": ("", base),
        "single": (names, [single, *base[1:]]),
        "ros": (names.replace("time_s", "stamp_sec stamp_nanosec"), [*stamps, *base[1:]]),
        "frames": with_(0, "frame", np.arange(len(truth.time))),
        "clamp": (marked.replace("m1_x", "m0_x m0_y m1_x"), [*base[:5], *points]),
        "base": (marked, [*base[:5], *points[2:]]),
        "noise": with_(5, "bend_deg", 20 * noise[0]),
        "pressure": with_(5, "sensor/kPa", 0.1 * degrees),
        "gyro": with_(5, "gyro_deg_s", degrees),
        "tip": with_(5, "tip", 0.01 * degrees),
        "tip in mm": with_(5, "tip", 1.7 * degrees),
        "named mrad": with_(5, "bend_mrad", truth.bend),
        "current": with_(2, "Current", 2.0 * counts[1]),
        "milliseconds": with_(0, "time_s", 1000.0 * truth.time),
        "named °C": (names, [*base[:3], *(1.8 * temperatures + 32), base[5]]),
        "named °F": with_(3, "temp_left_f", temperatures[0]),
    }


@pytest.mark.parametrize(
    ("case", "asked"),
    [
        ("coil", ""), ("warm", ""), ("single", ""), ("ros", ""), ("base", ""),
        ("control", ""), ("glued", ""), ("no names", ""), ("signed", ""),
        ("signed sides", ""), ("1 and 2", ""), ("whole seconds", ""), ("shares", ""),
        ("sides of sensors", ""), ("compass", ""), ("hanging", ""),
        (
            "left only, crossed",
            "pwm_left heats, T_left_C and T_right_C.*pwm_right heats, T_right_C.*with another wire",
        ),
        ("of 100", "is 100: what is full duty"),
        ("amperes", "duty of the left wire.*of the right wire.*is full duty.*the sign of"),
        ("no word is known", "unit of tempo.*thermocouple of the left wire, c and d"),
        ("curvature", "how many degrees is a unit of kappa"),
        ("turns", "how many degrees is a unit of bend"),
        ("counts of a bend", "how many degrees is a unit of flex"),
        ("upright", "^which number of angle_deg is a straight limb"),
        ("ticks", "unit of tick, if it is the time"),
        ("tenths", "give the rate of the frames in time, Hz"),
        ("one side", "the sign of bend_deg.*heated by pwm_1.*heated by pwm_2"),
        ("raw 1 and 2", "degrees is a unit of flex_raw.*which wire is heated by pwm_1"),
        ("noise 1 and 2", "the sign of bend_deg.*which wire is heated by pwm_1"),
        ("same sensor", "Names say T_right_C, but it warms more with another wire"),
        ("coupled", "thermocouple of the wire that pwm_left heats, T1 and T2, or .*Neither"),
        ("offset", "unit of T_left_C: C, F or K.*unit of T_right_C"),
        ("short", "unit of T_left_C: C, F or K"),
        ("raw temperatures", "that pwm_left heats, T_left_raw.*that pwm_right heats, T_right_raw"),
        ("seven bits", "is 124: what is full duty"),
        ("fives", "is 150: what is full duty"),
        ("two units", "is 0.5 and 128: are they of one unit"),
        ("switch and levels", "are they of one unit"),
        ("per cent or counts", "what is full duty"),
        ("inverted", "^[^?]*looks inverted[^?]*the sign of bend_deg[^?]*$"),  # no thermocouple
        ("held", "^the sign of bend_deg[^?]*$"),
        ("inverted, to 0", "pwm_left and pwm_right: the duty looks inverted"),
        ("inverted, T1 and T2", "^[^?]*looks inverted[^?]*the sign of bend_deg[^?]*$"),
        ("swapped", "Names say T_left_C, but T_right_C warms with pwm_left"),
        ("relay", "relay_2 may be the heat of a wire"),
        ("dropped", "T_right_C is a temperature of no wire"),
        ("warmed by the other wire", "T_right_C is a temperature of no wire"),
        (
            "controlled things",
            r"^no column seems to be the duty of the left wire.*duty of the right wire.*"
            r"thermocouple of the left wire, T1 and T2.*of the right wire, T1 and T2",
        ),
        ("mixed units", "unit of T_left: C, F or K"),
        ("named rad", "degrees is a unit of bend_deg"),
        ("frames", "the frames in frame"),
        ("clamp", "which point is the limb's base"),
        ("noise", "the sign of bend_deg"),
        ("pressure", "no column seems to be the bend"),
        ("gyro", "no column seems to be the bend"),
        ("tip", "how many degrees is a unit of tip"), ("tip in mm", "degrees is a unit of tip"),
        ("named mrad", "degrees is a unit of bend_mrad"),
        ("current", "Current is a current, but may be the heat of a wire"),
        ("milliseconds", "unit of time_s, if it is the time.*too far apart"),
        ("named °F", "unit of temp_left_f: C, F or K"),
        ("named °C", "unit of T_left_C: C, F or K.*unit of T_right_C"),
    ],
)  # fmt: skip
def test_forms_of_practitioners_are_right_or_asked_about(tmp_path, truth, cases, case, asked):
    names, columns = cases[case]
    limb, recordings, _ = read(write(tmp_path / "log.csv", names.split(), columns, form="{:.13g}"))
    assert bool(recordings) == (not asked)
    assert bool(re.search(asked, " ".join(question.text for question in limb.questions)))
    if recordings and case not in ("warm", "single", "shares"):
        check(recordings[0], truth, 0.3)
        assert recordings[0].sample_rate == RATE


@pytest.mark.parametrize(
    ("case", "answers"),
    [
        (
            "raw 1 and 2",
            {"wires[0].name": "left", "wires[1].name": "right", "bend.scale": f"{1 / 11.4}"},
        ),
        ("inverted", {"full": "255", "inverted": "true", "bend.scale": "1"}),
        ("swapped", {"wires[0].temperature": "T_right_C", "wires[1].temperature": "T_left_C"}),
        ("upright", {"bend.zero": "45"}),
        ("clamp", {"bend.line": "[m1_x, m1_y, m3_x, m3_y]", "bend.zero": "0", "bend.scale": "1"}),
    ],
)
def test_an_answered_mapping_is_read(tmp_path, truth, cases, case, answers, capsys):
    """Each question has its field in the mapping that is written, and answers are enough."""
    names, columns = cases[case]
    path = write(tmp_path / "log.csv", names.split(), columns, form="{:.13g}")
    words = ["import", str(path), "-o", str(tmp_path / "out")]
    assert main(words) == 2
    assert not list((tmp_path / "out").glob("*.csv"))
    with pytest.raises(LimbError, match="give in a mapping"):
        Recording.from_log(path)
    mapping = tmp_path / "out" / "log.mapping.yaml"
    assert all(f"#     {field}" in mapping.read_text() for field in answers if field != "inverted")
    mapping = mapping.rename(tmp_path / "mine.yaml")
    capsys.readouterr()
    assert main([*words, "--mapping", str(mapping)]) != 0  # without the answers
    assert f"Correct {mapping} and give it with --mapping" in capsys.readouterr().out
    LogMapping.load(mapping).with_answers(answers).save(mapping)
    assert main([*words, "--mapping", str(mapping)]) == 0, capsys.readouterr()
    check(Recording.load(tmp_path / "out" / "log.csv"), truth, tolerance_deg=0.3)


HEAD = "pwm_left,pwm_right,T_left,T_right,bend_deg"
ROW = "{1:.0f},{2:.0f},{3:.2f},{4:.2f},{5:.3f}"
LABELLED = "t:{6:.1f},pwm_left:{1:.0f},pwm_right: {2:.0f},T_left:{3},T_right:{4},bend_deg:{5}"
LABVIEW = """Channels;5;;;;;
Samples;9;9;9;9;9;
Date;x;x;x;x;x;
X_Value;PWM left;PWM right;TC left;TC right;Bend [deg];"""
DIADEM = """Zeit;PWM_L;PWM_R;Temp_L;Temp_R;Biegung
s;-;-;°C;°C;Grad
DT_DOUBLE;DT_DOUBLE;DT_DOUBLE;DT_DOUBLE;DT_DOUBLE;DT_DOUBLE"""
DSPACE = '"Time [s]",' + ",".join(
    f'"Model Root/{name}/Out1"' for name in ("pwm_left", "pwm_right", "TC_left", "TC_right", "phi")
)
BENCHVUE = "Scan,Time,101 <TC_L> (C),Alarm 101,102 <TC_R> (C),Alarm 102,201 <PWM_L>,202 <PWM_R>,"
BENCHVUE += "301 <bend> (deg)"
NEXUS = """,Limb:Heat,,Limb:Temp,,
Time (s),left,right,left,right,bend [deg]"""
EXCEL = "Zeit;PWM links;PWM rechts;T links;T rechts;Winkel"


@pytest.mark.parametrize(
    ("form", "head"),
    [
        ("{0:%H:%M:%S.%f} -> " + ROW, f"23:58:03.0 -> {HEAD}"),
        ("[{0:%Y-%m-%d %H:%M:%S.%f}] " + ROW, HEAD),
        (
            "t:{6:.1f}|pwm_left:{1:.0f}|pwm_right: {2:.0f}|T_left:{3}|T_right:{4}|bend_deg:{5}",
            "",
        ),
        ("{6:.1f};{1:.0f};{2:.0f};{3:.2f};{4:.2f};{5:.3f};", LABVIEW),
        ("{6:.1f};{1:.0f};{2:.0f};{3:.2f};{4:.2f};{5:.3f}", DIADEM),
        ("{6:.1f}," + ROW, DSPACE),
        ("{6:.1f}," + ROW, NEXUS),
        ("{6:.1f}," + ROW, "Time,left PWM,right PWM,101 (C),102 (C),bend"),
        ("7,{0:%m/%d/%Y %H:%M:%S:%f},{3:.2f},0,{4:.2f},0,{1:.0f},{2:.0f},{5:.3f}", BENCHVUE),
        ("{0:%d.%m.%Y %H:%M:%S.%f};{1:.0f};{2:.0f};{3:.2f} °C;{4:.2f} °C;{5:.2f}°", EXCEL),
        ("ms={7:.0f}, pwmL={1:.0f}, pwmR={2:.0f}, tempL={3}, tempR={4}, angle={5}", ""),
    ],
)
def test_lines_of_terminals_sketches_and_labview(tmp_path, truth, form, head):
    start = datetime.datetime(2026, 3, 3, 23, 58, 3)
    signals_ = [np.round(255 * d) for d in truth.duty] + [
        *truth.temperature,
        np.rad2deg(truth.bend),
    ]
    lines = [
        form.format(start + datetime.timedelta(seconds=round(t, 3)), *row, t, 1000 * t)
        for t, *row in zip(truth.time, *signals_, strict=True)
    ]
    path = tmp_path / "log.txt"
    path.write_text("\n".join([*filter(None, [head]), *lines, ""]))
    limb, (recording,), _ = read(path)
    assert not limb.mapping.time.column[0].isdigit()  # it is no time of the head
    check(recording, truth)


@pytest.mark.filterwarnings("ignore:.*The mapping has no temperature")
def test_a_mapping_says_what_no_log_does(tmp_path, truth, cases):
    """Frames at a rate, inverted duty, a camera's file, and signed commands of a limb in space."""
    wires = "wires:\n- {name: left, duty: pwm_left, temperature: T_left_C}\n"
    wires += "- {name: right, duty: pwm_right, temperature: T_right_C}\nfull: 255\n"
    bend = "bend: {column: bend_deg}\n"

    def by(text, columns, names, limb=None):
        path = write(tmp_path / "log.csv", names.split(), columns, form="{:.13g}")
        (tmp_path / "m.yaml").write_text(text)
        return Recording.from_log(path, tmp_path / "m.yaml", limb)

    names, columns = cases["frames"]
    frames = f"time: {{column: frame, unit: frames}}\nrate: {RATE}\n"
    check(by(frames + wires + bend, columns, names), truth)
    check(by(f"rate: {RATE}\n" + wires + bend, columns[1:], names.removeprefix("frame ")), truth)
    names, columns = cases["inverted"]
    time = "time: {column: time_s}\n"
    check(by(f"{time}{wires}{bend}inverted: true\n", columns, names), truth)
    # A camera that began 7.3 s later sees how warm the left wire is.
    seen = np.arange(0.0, 200.0, 1 / 30)
    later = np.searchsorted(truth.time, seen + 7.3) - 1
    lamp = truth.temperature[0][later] / 2
    shown = np.rad2deg(np.interp(seen + 7.3, truth.time, truth.bend))
    write(tmp_path / "cam.csv", ["frame", "phi", "lamp"], [np.arange(len(seen)), shown, lamp])
    camera = (
        "bend: {column: phi}\njoin: {file: cam.csv, rate: 30, time: {column: frame, unit: frames}"
    )
    for offset in ("offset: 7.3", "align: [T_left_C, lamp]"):
        read_ = by(
            f"{time}{wires}{camera}, {offset}}}\n",
            columns[:1] + [255 - c for c in columns[1:3]] + columns[3:5],
            " ".join(NAMES[:1]) + " pwm_left pwm_right T_left_C T_right_C",
        )
        expected = np.rad2deg(np.interp(read_.time + 7.3, truth.time, truth.bend))
        assert np.nanmedian(np.abs(np.rad2deg(read_.bend_angle[0]) - expected)) < 0.5
    # Two signed commands for four wires, a sensor of two axes that is turned, no thermocouples.
    signed = "".join(
        f"- {{name: wire_{n}, duty: u{n % 2}, sign: {1 if n < 3 else -1}}}\n" for n in (1, 2, 3, 4)
    )
    command = truth.duty[1] - truth.duty[0]
    recording = by(
        f"{time}wires:\n{signed}bend: {{e2: ax, e3: ay, roll: 90}}\n",
        [truth.time, command, -command, np.rad2deg(truth.bend), 0 * command],
        "time_s u1 u0 ax ay",
        LimbParameters.in_space(4),
    )
    heats = recording.duty.mean(axis=1)
    np.testing.assert_allclose(
        heats[[0, 2, 1, 3]], [*truth.duty.mean(axis=1)[::-1], *truth.duty.mean(axis=1)], rtol=0.02
    )
    assert np.abs(recording.bend_angle[0]).max() < 1e-9
    assert np.abs(recording.bend_angle[1]).max() == pytest.approx(
        np.abs(truth.bend).max(), rel=0.01
    )


@pytest.mark.parametrize(
    ("e3_name", "scale", "shift", "wires", "answers"),
    [
        ("bend_y_deg", 1.0, 45.0, [0, 1, 2], {"bend.zero_e3": "45"}),
        ("bend_y", 10.0, 0.0, [0, 1, 2], {"bend.scale_e3": "0.1"}),
        ("bend_y_deg", -1.0, 0.0, [0, 2, 1], {"bend.scale": "-1"}),
    ],
)
def test_an_answer_about_bends_in_space_is_of_the_bends_that_the_question_is_of(
    tmp_path, truth, e3_name, scale, shift, wires, answers
):
    limb = LimbParameters.in_space()
    later = np.roll([truth.duty[0], truth.temperature[0]], 75, axis=1)
    temperatures = np.array([*truth.temperature, later[1]])
    levers = np.transpose([limb.wires[index].lever for index in wires])
    bends = 0.5 * levers @ temperatures
    shown = [np.sign(scale) * bends[0], np.round(scale * bends[1]) + shift]
    columns = [truth.time, *truth.duty, later[0], *temperatures, *shown]
    names = [f"{what}_{wire}" for what in ("pwm", "T_C") for wire in (1, 2, 3)]
    path = write(tmp_path / "log.csv", ["time_s", *names, "bend_x_deg", e3_name], columns)
    (log,) = import_logs([path], parameters=limb)
    assert [question.field for question in log.limb.questions] == list(answers)
    assert not log.recordings
    recording = Recording.from_log(path, log.limb.mapping.with_answers(answers), limb)
    assert np.rad2deg(recording.bend_angle) == pytest.approx(bends, abs=2.0)


def test_files_with_the_time_of_day_in_several_zones_have_one_clock(tmp_path, truth):
    """A logger in local time, past midnight, and a camera in UTC that began 7.3 s later."""
    start = datetime.datetime(2026, 3, 3, 23, 58, 3)

    def clock(seconds, ahead, zone):
        times = [start + datetime.timedelta(hours=ahead, seconds=round(t, 3)) for t in seconds]
        return [f"{time:%Y-%m-%dT%H:%M:%S.%f}{zone}" for time in times]

    counts = np.round(255 * truth.duty)
    local = clock(truth.time, 0.0, "+05:30")
    path = write(tmp_path / "log.csv", NAMES[:-1], [local, *counts, *truth.temperature])
    seen = np.arange(0.0, 200.0, 1 / 30) + 7.3
    shown = np.rad2deg(np.interp(seen, truth.time, truth.bend))
    write(tmp_path / "cam.csv", ["utc", "phi"], [clock(seen, -5.5, "Z"), shown])
    (tmp_path / "m.yaml").write_text(
        f"time: {{column: {NAMES[0]}, unit: date}}\nfull: 255\nwires:\n"
        f"- {{name: left, duty: {NAMES[1]}, temperature: {NAMES[3]}}}\n"
        f"- {{name: right, duty: {NAMES[2]}, temperature: {NAMES[4]}}}\n"
        "bend: {column: phi}\njoin: {file: cam.csv, time: {column: utc, unit: date}}\n"
    )
    recording = Recording.from_log(path, tmp_path / "m.yaml")
    expected = np.interp(recording.time + 7.3, truth.time, truth.bend)
    assert np.rad2deg(np.nanmedian(np.abs(recording.bend_angle[0] - expected))) < 0.5


def test_questions_are_answered_at_a_terminal(tmp_path, cases, capsys, monkeypatch):
    """The mapping keeps the answers."""
    names, columns = cases["frames"]
    path = write(tmp_path / "log.csv", names.split(), columns)
    terminal = io.StringIO("5\n")
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stdin", terminal)
    assert main(["import", str(path), "-o", str(tmp_path / "out")]) == 0
    assert "rate (Enter: leave it open): " in capsys.readouterr().out
    mapping = tmp_path / "out" / "log.mapping.yaml"
    assert LogMapping.load(mapping).rate == RATE


def test_duties_that_are_named_alike_are_proposed_to_each_wire_its_own_first(tmp_path, cases):
    names, columns = cases["controlled things"]
    questions = read(write(tmp_path / "log.csv", names.split(), columns))[0].questions
    assert questions[0].choices == ["wire_left", "wire_right"]
    assert questions[1].choices == ["wire_right", "wire_left"]


def test_a_heated_log_answers_for_a_log_without_heat(tmp_path, truth, cases):
    names, columns = cases["control"]
    heated = write(tmp_path / "heated.csv", names.split(), columns)
    still = [truth.time, 0 * truth.duty[0], 0 * truth.duty[1], *(22 + 0 * truth.duty), columns[5]]
    swing = write(tmp_path / "swing.csv", names.split(), still)
    assert "T1 and T2" in import_logs([swing])[0].limb.questions[0].text
    logs = import_logs([heated, swing])
    assert [wire.temperature for wire in logs[1].limb.mapping.wires] == ["T1", "T2"]
    assert logs[1].recordings
    # A question about names that contradict numbers stays.
    names, columns = cases["swapped"]
    crossed = write(tmp_path / "crossed.csv", names.split(), columns)
    right = [*columns[:3], columns[4], columns[3], columns[5]]
    good = write(tmp_path / "good.csv", names.split(), right)
    assert [bool(log.recordings) for log in import_logs([crossed, good])] == [False, True]


def test_words_of_a_lab(tmp_path, cases):
    names, columns = cases["relay"]
    path = write(tmp_path / "log.csv", names.replace("pwm", "brenner").split(), columns)
    (tmp_path / "words.yaml").write_text("duty: [brenner, relay]\n")
    words = ["import", str(path), "-o", str(tmp_path / "out")]
    assert main([*words, "--words", str(tmp_path / "words.yaml")]) == 2
    text = (tmp_path / "out" / "log.mapping.yaml").read_text()
    assert "duty: brenner_left" in text


def test_any_names_units_and_order_are_right_or_asked_about(tmp_path):
    limb = OwnLimb(8)
    draw = np.random.default_rng(3)
    starts = np.arange(5.0, 190.0, 20.0)
    levels = draw.uniform(0.15, 0.4, len(starts)).round(2)
    pulses = [
        (k % 2, level, s, 5.0) for k, (level, s) in enumerate(zip(levels, starts, strict=True))
    ]
    truth = limb.record(pulses, 200.0, 2.5)
    read_ = 0
    for seed in range(50):
        log = any_log(truth, seed)
        path = tmp_path / f"{seed}.csv"
        path.write_bytes(log.content)
        (imported,) = import_logs([path])
        if imported.recordings:
            read_ += 1
            assert faults(imported.recordings, truth, log) == [], log.names
    assert read_ > 5  # asking always is no way out
