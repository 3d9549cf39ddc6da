"""Logs of a known limb in any names, units, order, delimiter and encoding, drawn by a seed."""

import dataclasses
import datetime

import numpy as np

from calibration.import_logs.words import BEND, DUTY, TEMPERATURE, TIME, WORDS
from limb_systems import Recording

LABELS = (  # of the left and the right wire
    ("left", "right"), ("l", "r"), ("L", "R"), ("links", "rechts"), ("1", "2"), ("0", "1"),
    ("a", "b"), ("A", "B"),
)  # fmt: skip
SIDES = LABELS[:4]
WITH_UNIT = """s sec secs seconds sekunden ms us msec millis micros stamp celsius kelvin fahrenheit
degc degf power pow leistung heizleistung yaw pitch roll imu orientation tilt neigung curvature
krümmung courbure tip tangent alpha bendlabs chord"""
DIGITS = {"C": (1.0, 0.0), "F": (1.8, 32.0), "K": (1.0, 273.15)}
MOMENTS = ("%Y-%m-%d %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f", "%H:%M:%S.%f", "%d-%b-%Y %H:%M:%S.%f")


@dataclasses.dataclass
class AnyLog:
    """A log as a file, and the truth about it.

    - ``content``: the file.
    - ``dropped``: the column that it lacks: "time", "duty_left" and so on; empty if it lacks none.
    - ``has_sides``: whether names say which wire is left.
    - ``names``: names of the columns by what they are.
    """

    content: bytes
    dropped: str
    has_sides: bool
    names: dict[str, str]


def any_log(recording: Recording, seed: int) -> AnyLog:
    """Return a log of a recording with two wires, left and right."""
    draw = np.random.default_rng([57, seed])

    def pick(choices):
        return choices[int(draw.integers(len(choices)))]

    def name(role: str, label: str, unit: str) -> str:
        words = [w for w in WORDS[role] if w.isascii() and w not in WITH_UNIT.split()]
        word = pick(words)
        mark = pick(["_", " ", "."])
        parts = [word, label] if draw.uniform() < 0.7 else [label, word]
        bare = mark.join(filter(None, parts))
        bare = bare.title() if draw.uniform() < 0.2 else bare
        form = pick([f"{bare} [{unit}]", f"{bare} ({unit})", f"{bare}_{unit}"]) if unit else bare
        return form

    # Times.
    times = recording.time - recording.time[0]
    unit = pick(["s", "s", "ms", "us", "min", "date", "date"])
    columns = {}
    names = {}
    if unit == "date":
        start = datetime.datetime(2026, 3, 4, 23, 58, 30)
        form = pick(MOMENTS)
        moments = [start + datetime.timedelta(seconds=round(float(t), 3)) for t in times]
        columns["time"] = [moment.strftime(form) for moment in moments]
        names["time"] = pick(["Time", "Zeit", "timestamp", "Datum"])
    else:
        scale = {"s": 1.0, "ms": 1e3, "us": 1e6, "min": 1 / 60}[unit]
        columns["time"] = [f"{scale * t:.{6 if unit == 'min' else 3}f}" for t in times]
        names["time"] = name(TIME, "", unit)
    # Wires: one word for all of a role, and a label for each.
    labels = pick(LABELS)
    own_labels = labels if draw.uniform() < 0.6 else pick(LABELS)
    own_labels = (
        own_labels[::-1] if own_labels not in SIDES and draw.uniform() < 0.3 else own_labels
    )
    if labels not in SIDES and own_labels not in SIDES and labels != own_labels[::-1]:
        own_labels = pick([own_labels, labels])
    full = pick([1.0, 100.0, 255.0, 1023.0, 4095.0])
    unit = pick(["", "%"]) if full == 100.0 else ""
    pattern = name(DUTY, "@", unit)
    while full > 255 and "pwm" in pattern.lower():  # which says that it is of 8 bits
        pattern = name(DUTY, "@", unit)
    digits = 3 if full == 1.0 else int(draw.integers(3)) if full == 100.0 else 0
    for side, label, duty in zip(("left", "right"), labels, recording.duty, strict=True):
        columns[f"duty_{side}"] = [f"{full * d:.{digits}f}" for d in duty]
        names[f"duty_{side}"] = pattern.replace("@", label)
    of_temperature = pick("CCFK")
    unit = pick(["", of_temperature, f"°{of_temperature}"])
    pattern = name(TEMPERATURE, "@", unit)
    factor, offset = DIGITS[of_temperature]
    for side, label, readings in zip(
        ("left", "right"), own_labels, recording.measured_temperature, strict=True
    ):
        columns[f"temperature_{side}"] = [f"{factor * v + offset:.2f}" for v in readings]
        names[f"temperature_{side}"] = pattern.replace("@", label)
    # The bend, of either sign.
    unit = pick(["deg", "rad"])
    scale = pick([1.0, -1.0]) * (np.rad2deg(1.0) if unit == "deg" else 1.0)
    columns["bend"] = [f"{scale * b:.4f}" for b in recording.bend_angle[0]]
    names["bend"] = name(BEND, "", pick(["", unit]))
    # Columns of other things.
    count = len(times)
    others = {
        "supply_V": [f"{v:.2f}" for v in 12 + 0.01 * draw.normal(size=count)],
        "sample": [str(number) for number in range(count)],
        "angle_setpoint": [f"{v:.1f}" for v in 20 * np.sin(times / 9)],
        "room_temp": [f"{v:.2f}" for v in 22 + 0.02 * draw.normal(size=count)],
        "note": ["ok"] * count,
    }
    for other in [key for key in others if draw.uniform() < 0.25]:
        columns[other] = others[other]
        names[other] = other
    dropped = pick(list(columns)[:6]) if draw.uniform() < 0.3 else ""
    columns.pop(dropped, None)
    # The file.
    order = list(draw.permutation(list(columns)))
    delimiter = pick([",", ";", "\t", "|"])
    decimal = "," if delimiter != "," and draw.uniform() < 0.3 else "."
    lines = [delimiter.join(names[key] for key in order)]
    for row in zip(*(columns[key] for key in order), strict=True):
        cells = [cell.replace(".", decimal) if _is_number(cell) else cell for cell in row]
        lines.append(delimiter.join(cells))
    encoding = pick(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252"])
    content = "\n".join([*lines, ""]).encode(encoding)
    has_sides = labels in SIDES or (own_labels in SIDES)
    return AnyLog(content, dropped, has_sides, {key: names[key] for key in columns})


def _is_number(cell: str) -> bool:
    return cell.replace(".", "", 1).replace("-", "", 1).isdigit()


def faults(recordings: list[Recording], truth: Recording, log: AnyLog) -> list[str]:
    """Return what is wrong in recordings that were read without a question."""
    if len(recordings) != 1:
        return [f"{len(recordings)} recordings"]
    (read,) = recordings
    ways = [_faults(read, truth, log, mirror) for mirror in (False, True)[: 2 - log.has_sides]]
    return min(ways, key=len)


def _faults(read: Recording, truth: Recording, log: AnyLog, mirror: bool) -> list[str]:
    found = []
    if abs(read.time[-1] / (truth.time[-1] - truth.time[0]) - 1) > 0.01:
        found.append(f"lasts {read.time[-1]:g} s")
    taken = np.clip(read.time - read.sample_age, 0.0, None) + truth.time[0] + 1e-4
    index = np.clip(np.searchsorted(truth.time, taken, side="right") - 1, 0, None)
    sides = ["left", "right"]
    for row, side in enumerate(sides):
        own = sides[1 - row] if mirror else side
        if own not in read.parameters.wire_names:
            found.append(f"no {side} wire")
            continue
        wire = read.parameters.wire_names.index(own)
        dose = read.duty[wire].mean()
        if abs(dose - truth.duty[row].mean()) > 0.01 + 0.05 * truth.duty[row].mean():
            found.append(f"duty of {side}")
        if log.dropped == f"temperature_{side}":
            right = np.isnan(read.measured_temperature[wire]).all()
        else:
            apart = np.abs(read.measured_temperature[wire] - truth.measured_temperature[row][index])
            right = np.quantile(apart, 0.98) < 1.0
        if not right:
            found.append(f"temperature of {side}")
    sign = -1.0 if mirror else 1.0
    apart = np.rad2deg(np.abs(read.bend_angle[0] - sign * truth.bend_angle[0][index]))
    if not np.quantile(apart, 0.98) < 1.5:
        found.append(f"bend, by {np.nanmedian(apart):.1f}°")
    return found
