"""Tables of measurements with names, units and faults of anybody's, of emulated limbs."""

import dataclasses
from collections.abc import Callable
from datetime import datetime, timedelta

import numpy as np
from lab_logs import SIDES, Log, Truth, drive, tags


@dataclasses.dataclass(frozen=True)
class Style:
    """The columns, units and faults of somebody's table.

    - ``columns``: "NAME: ROLE | ...", where a role is one of

        - "time", and one of `TIMES`;
        - "duty", the wire, and the number that is full duty; "signed" and that number, of which
          negative ones heat the left wire;
        - "temperature", the wire, and "C", "F" or "K";
        - "bend", degrees that one unit is, what it measures, and the number that stands for 0;
        - "tag", the number of a tag on the limb, and "x" or "y";
        - "about", a number and its spread; "text" and a word; "index".

    - ``faults``: words, of "lost", "cells", "gap", "duplicates", "back", "bom", "crlf",
      "trailing", "quotes" and "nameless".
    - ``rate``, ``spread``: of the rows, Hz, and of the time between them, in shares of it.
    """

    name: str
    columns: str
    faults: str = "lost cells"
    delimiter: str = ","
    decimal: str = "."
    head: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    rate: float = 20.0
    spread: float = 0.2
    kind: str = "steps"
    minutes: float = 4.0
    physics: str = "continuum"


TIMES: dict[str, tuple[str, Callable[[float], str]]] = {  # what a mapping calls it, and a cell
    "s": ("s", "{:.3f}".format),
    "ms": ("ms", lambda t: str(round(1000 * t))),
    "us": ("us", lambda t: str(round(1e6 * t) % 2**32)),
    "ns": ("ns", lambda t: str(1_709_640_000_000_000_000 + round(1e9 * t))),
    "min": ("min", lambda t: f"{t / 60:.6f}"),
    "epoch": ("s", lambda t: f"{1_709_640_000 + t:.3f}"),
    "epoch_ms": ("ms", lambda t: str(1_709_640_000_000 + round(1000 * t))),
    "serial": ("d", lambda t: f"{45_356 + t / 86400:.9f}"),
    "iso": ("date", lambda t: f"{_moment(t).isoformat(timespec='milliseconds')}Z"),
    "coarse": ("date", lambda t: f"{_moment(t):%Y-%m-%d %H:%M:%S}"),
    "german": ("date", lambda t: f"{_moment(t):%d.%m.%Y %H:%M:%S,%f}"[:-3]),
    "clock": ("date", lambda t: f"{_moment(t):%H:%M:%S.%f}"[:-3]),
}
UNITS = {"C": (1.0, 0.0), "F": (1.8, 32.0), "K": (1.0, 273.15)}
STYLES = [
    Style(
        "arduino",
        "ms: time ms | pwmL: duty left 255 | pwmR: duty right 255 | T1: temperature right C"
        " | T2: temperature left C | flex_raw: bend -0.31 tip_tangent 512",
        rate=15,
    ),
    Style(
        "german_excel",
        "Zeit: time s | Heizung links: duty left 100 | Heizung rechts: duty right 100"
        " | Temp. links: temperature left C | Temp. rechts: temperature right C"
        " | Biegewinkel: bend 1 bend_angle 0",
        "lost cells gap bom crlf",
        ";",
        ",",
        units=("s", "%", "%", "°C", "°C", "°"),
        rate=10,
    ),
    Style(
        "data_base",
        ": index | _time: time iso | device: text limb_a | heater_right_duty: duty right 1"
        " | heater_left_duty: duty left 1 | tc_right: temperature right K"
        " | tc_left: temperature left K | supply_V: about 12.1 0.05"
        " | tip_angle_deg: bend -1 tip_tangent 0",
        "lost gap duplicates back",
        kind="ramps",
    ),
    Style(
        "labview",
        "Time (s): time s | PWM A: duty right 255 | PWM B: duty left 255"
        " | TC A (F): temperature right F | TC B (F): temperature left F"
        " | Angle (deg): bend 1 bend_angle 0 | Comment: text -",
        "cells trailing",
        "\t",
        head=("# LabVIEW Measurement", "# Operator: A. Nobody", "# Project: limb 3"),
        rate=25,
        kind="bang-bang",
        physics="lumped",
    ),
    Style(
        "single_wire",
        "t_ms: time ms | pwm: duty right 255 | temp: temperature right C"
        " | angle: bend -1 bend_angle 0",
        rate=10,
        minutes=5,
    ),
    Style(
        "one_thermocouple",
        "zeit: time ms | u1: duty left 100 | u2: duty right 100 | temp: temperature right C"
        " | phi_deg: bend 1 bend_angle 0",
        "lost cells quotes",
        rate=30,
        physics="lumped",
    ),
]


# Of these the import knew nothing when it was made.
UNSEEN = [
    Style(
        "teensy",
        "a: time ms | b: duty right 255 | c: duty left 255 | d: temperature left C"
        " | e: temperature right C | f: bend 1 bend_angle 0",
        "lost nameless",
        "\t",
        rate=25,
    ),
    Style(
        "power",
        "Elapsed [min]: time min | P1 [W]: duty left 6.4 | P2 [W]: duty right 6.4"
        " | Thermo1 [degC]: temperature left C | Thermo2 [degC]: temperature right C"
        " | Encoder [rad]: bend 57.2958 tip_tangent 0",
        "lost cells",
        rate=10,
        kind="ramps",
    ),
    Style(
        "matlab",
        "t: time s | u_agonist: duty right 1 | u_antagonist: duty left 1"
        " | y_T_ag: temperature right C | y_T_ant: temperature left C"
        " | theta_ref: about 0 0.2 | theta: bend -57.2958 bend_angle 0",
        "lost",
        rate=12,
        physics="lumped",
    ),
    Style(
        "clock",
        "Uhrzeit: time clock | S1: duty left 1023 | S2: duty right 1023"
        " | NTC1: temperature right C | NTC2: temperature left C"
        " | IMU_Yaw: bend -1 tip_tangent 0",
        "lost cells crlf",
        ";",
        ",",
        rate=16,
        kind="bang-bang",
    ),
    Style(
        "signed",
        "sec: time s | cmd: signed 100 | tc0: temperature right C | tc1: temperature left C"
        " | camera_angle: bend 1 bend_angle 0",
        "lost cells",
        kind="motion",
        physics="lumped",
    ),
    Style(
        "bag",
        "%time: time ns | field.header.seq: index | field.data0: duty left 1"
        " | field.data1: duty right 1 | field.temperature0: temperature left C"
        " | field.temperature1: temperature right C | field.bend: bend 57.2958 bend_angle 0",
        "lost duplicates",
        spread=0.4,
    ),
    Style(
        "pico",
        "us: time us | L: duty left 65535 | R: duty right 65535 | TL: temperature left C"
        " | TR: temperature right C | as5600: bend 0.087890625 tip_tangent 2048",
        "lost",
        ", ",
        rate=30,
        kind="ramps",
    ),
    Style(
        "misleading",
        "time: time s | temp_set: about 90 0 | temp_left: temperature left C"
        " | temp_right: temperature right C | pwm_limit: about 60 0 | left: duty left 100"
        " | right: duty right 100 | pos: bend -1 bend_angle 0",
        "lost cells gap",
        rate=10,
    ),
    Style(
        "two_headers",
        "Time (ms): time ms | Left (%): duty left 100 | Right (%): duty right 100"
        " | Left (K): temperature left K | Right (K): temperature right K"
        " | Tip (deg): bend 1 tip_tangent 0",
        "lost back",
        head=("Clock,Heaters,,Thermocouples,,Camera",),
        physics="lumped",
    ),
    Style(
        "coarse",
        "when: time coarse | heater_a: duty right 1 | heater_b: duty left 1"
        " | probe_a: temperature right F | probe_b: temperature left F"
        " | bend: bend 1 bend_angle 0 | note: text ok",
        "lost",
        "|",
        rate=10,
    ),
    Style(
        "picture",
        "frame: index | t: time s | pwm0: duty left 255 | pwm1: duty right 255"
        " | temp0: temperature left C | temp1: temperature right C | x0: tag 0 x"
        " | y0: tag 0 y | x1: tag 1 x | y1: tag 1 y | x2: tag 2 x | y2: tag 2 y | x3: tag 3 x"
        " | y3: tag 3 y | x4: tag 4 x | y4: tag 4 y",
        "lost",
        rate=15,
    ),
    Style(
        "french",
        "Temps (s): time s | Cmd G: duty left 100 | Cmd D: duty right 100"
        " | T° G: temperature left C | T° D: temperature right C"
        " | Courbure (1/m): bend 5.7296 tip_tangent 0",
        delimiter=";",
        decimal=",",
        rate=10,
    ),
    Style(
        "japanese",
        "時間: time ms | 左: duty left 255 | 右: duty right 255 | 左温度: temperature left C"
        " | 右温度: temperature right C | 角度: bend 1 bend_angle 0",
        rate=10,
        kind="ramps",
    ),
    Style(
        "per_mille",
        "t: time s | out_1: duty right 1000 | out_2: duty left 1000 | in_1: temperature left C"
        " | in_2: temperature right C | in_3: bend -1 bend_angle 0",
        kind="bang-bang",
        physics="lumped",
    ),
    Style(
        "volts",
        "sec: time s | heat_l: duty left 1 | heat_r: duty right 1 | T_l: temperature left C"
        " | T_r: temperature right C | Vflex: bend -60 bend_angle 1.65",
    ),
    Style(
        "letters",
        "time_ms: time ms | A_pwm: duty right 255 | A_T: temperature right C | B_pwm: duty left 255"
        " | B_T: temperature left C | roll_mdeg: bend 0.001 tip_tangent 0",
        kind="ramps",
        physics="lumped",
    ),
    Style(
        "fast",
        "t_us: time us | d0: duty left 4095 | d1: duty right 4095 | k0: temperature left K"
        " | k1: temperature right K | q: bend 57.2958 bend_angle 0",
        rate=100,
        minutes=3,
    ),
    Style(
        "slow",
        "Time: time german | Heater L: duty left 100 | Heater R: duty right 100"
        " | TC L: temperature left F | TC R: temperature right F | Angle: bend -1 bend_angle 0",
        "quotes",
        rate=1,
        minutes=10,
    ),
    Style(
        "epoch_ms",
        "ts: time epoch_ms | dutyL: duty left 1 | dutyR: duty right 1 | tempL: temperature right C"
        " | tempR: temperature left C | tip_tangent_rad: bend 57.2958 tip_tangent 0",
        "lost cells duplicates back",
        kind="pulses",
    ),
    Style(
        "serial_date",
        "DateTime: time serial | PWM1: duty left 255 | PWM2: duty right 255"
        " | T1: temperature left C | T2: temperature right C | Bend angle: bend 1 bend_angle 0",
        rate=5,
        physics="lumped",
    ),
]


def _moment(t: float) -> datetime:
    return datetime(2024, 3, 5, 23, 58, 30) + timedelta(seconds=t)


def table(style: Style, seed: int = 0) -> Log:
    """Return a log in somebody's style, of a limb that a seed draws."""
    draw = np.random.default_rng([3, seed, sum(map(ord, style.name))])
    columns = [column.partition(":") for column in style.columns.split(" | ")]
    names = [c[0].strip() for c in columns]
    roles = [c[2].split() for c in columns]
    if "nameless" in style.faults:
        names = [f"column_{number}" for number in range(1, len(roles) + 1)]
    heated = tuple(i for i, side in enumerate(SIDES) if any(["duty", side] == r[:2] for r in roles))
    heated = heated or (0, 1)  # by one signed column
    arguments = (100 + seed, style.physics, style.kind, 60 * style.minutes, 0.1, heated)
    limb = drive(*arguments)
    count = int(60 * style.minutes * style.rate) - 10
    late = style.spread * draw.normal(0, 1, count).clip(-2, 2)
    times = np.maximum.accumulate(np.maximum(np.arange(count) + late, 0.0)) / style.rate
    keep = np.ones(count, bool)
    if "lost" in style.faults:
        keep &= draw.uniform(size=count) > 0.03
    if "gap" in style.faults:
        keep[int(0.6 * count) : int(0.6 * count + 5 * style.rate)] = False
    times = times[keep] - times[keep][0]
    rows = limb.at(times)
    begin = draw.uniform(2, 20) if ": time ms" in style.columns else 0.0
    seen = tags([limb.joints[:, rows], 0 * limb.joints[:, rows]], draw)
    cells = []
    times_in = []
    bend = ("", 0.0, "", 0.0)
    wires: dict[str, tuple[str, str, float, str]] = {}
    for name, (what, *how) in zip(names, roles, strict=True):
        side = SIDES.index(how[0]) if how and how[0] in SIDES else 0
        mates = {
            r[1]: (n, r[2]) for n, r in zip(names, roles, strict=True) if r[0] == "temperature"
        }
        if what == "time":
            unit, cell = TIMES[how[0]]
            texts = [cell(begin + t) for t in times]
            times_in.append((name.lstrip("%"), unit))
        elif what == "duty":
            full = float(how[1])
            texts = [f"{d:.0f}" if full > 1 else f"{d:.2f}" for d in full * limb.duty[side][rows]]
            thermocouple, unit = mates.get(how[0], ("", "C"))
            wires[how[0]] = (name, thermocouple, full, unit)
        elif what == "signed":
            texts = [f"{d:.0f}" for d in float(how[0]) * np.diff(limb.duty[:, rows], axis=0)[0]]
            for wire, sign in zip(SIDES, (-1, 1), strict=True):
                wires[wire] = (name, mates[wire][0], sign * float(how[0]), mates[wire][1])
        elif what == "tag":
            texts = [f"{p:.1f}" for p in seen[:, int(how[0]), "xy".index(how[1])]]
        elif what == "temperature":
            factor, offset = UNITS[how[1]]
            texts = [f"{v:.2f}" for v in factor * limb.temperature[side][rows] + offset]
        elif what == "bend":
            scale = float(how[0])
            measures = how[1]
            zero = float(how[2])
            angle = np.rad2deg(limb.bend[rows]) * (2 if measures == "tip_tangent" else 1) / scale
            digits = 0 if abs(zero) > 10 else 2 if abs(scale) < 50 else 4
            texts = [f"{b:.{digits}f}" for b in angle + zero]
            bend = (name, scale, measures, zero)
        elif what == "about":
            texts = [f"{v:.2f}" for v in draw.normal(float(how[0]), float(how[1]), len(rows))]
        else:
            texts = list(map(str, range(len(rows)))) if what == "index" else how * len(rows)
        if "cells" in style.faults and what in ("temperature", "bend"):
            for at in draw.integers(3, len(rows), 16):
                texts[at] = str(draw.choice(["NaN", "", "-999", "ERR"]))
        if what not in ("time", "text", "index") or how[:1] == ["s"]:
            texts = [text.replace(".", style.decimal) for text in texts]
        cells.append(texts)
    body = list(zip(*cells, strict=True))
    if "duplicates" in style.faults:
        for at in sorted(draw.integers(5, len(body), 6), reverse=True):
            body.insert(at, body[at])
    if "back" in style.faults:  # a row that came late
        at = len(body) // 3
        body[at], body[at + 4] = body[at + 4], body[at]
    top = () if "nameless" in style.faults else (names, style.units)
    mark = '"' if "quotes" in style.faults else ""
    end = style.delimiter if "trailing" in style.faults else ""
    between = f"{mark}{style.delimiter}{mark}"
    written = [f"{mark}{between.join(row)}{mark}{end}" for row in (*top, *body) if row]
    text = ("\r\n" if "crlf" in style.faults else "\n").join([*style.head, *written, ""])
    content = text.encode("utf-8-sig" if "bom" in style.faults else "utf-8")
    return Log(f"{style.name}_{seed}", content, (Truth(tuple(times_in), wires, bend, arguments),))
