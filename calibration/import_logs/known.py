"""Known loggers: `ezloophw-py`, of limbs with two wires each, and its pneumatic successor."""

import re

import numpy as np

from calibration.import_logs.clock import DAY, times_of
from calibration.import_logs.evidence import MARGIN, Responses, Steps, bend_votes
from calibration.import_logs.log_signals import bends_of
from calibration.import_logs.mapping import (
    BEND_ANGLE,
    CHORD,
    OPEN,
    TIP_TANGENT,
    BendColumns,
    LogMapping,
    TimeColumn,
    WireColumns,
)
from calibration.import_logs.propose import Proposal, Question, base_direction
from calibration.import_logs.table import LogTable

TIMESTAMP = "Timestamp (millisec since midnight today)"
SIDES = {"left": "rev", "right": "fwd"}  # which of both is on which side is ours
USUAL = {(0, "rev"): 0, (0, "fwd"): 1, (1, "rev"): 3, (1, "fwd"): 2}  # MCPtemp of limb and wire


def known_logger(table: LogTable) -> list[Proposal]:
    """Return the limbs in a log of a known logger; none if the logger is not known."""
    found = [re.match(r"pwm_duty_limb(\d)_", name) for name in table.names]
    limbs = sorted({int(match[1]) for match in found if match})
    if limbs:
        return _shape_memory(table, limbs)
    if TIMESTAMP in table.names and any(n.startswith("MPRpressure_") for n in table.names):
        return _pneumatic(table)
    return []


def _shape_memory(table: LogTable, limbs: list[int]) -> list[Proposal]:
    """Return the limbs with two shape-memory wires each."""
    time = TimeColumn("Test time", "s")
    if TIMESTAMP in table.names:
        time = TimeColumn(TIMESTAMP, "ms", DAY)
    times, kept = times_of(table, time)
    steps = Steps.of(times)
    # See which thermocouple each wire warms.
    wires = [(limb, which) for limb in limbs for which in SIDES.values()]
    duties = [f"pwm_duty_limb{limb}_{which}" for limb, which in wires]
    heats = np.array([steps.heat(np.nan_to_num(table.numbers(duty)[kept])) for duty in duties])
    sensors = [name for name in table.names if name.startswith("MCPtemp_")]
    sensors = [name for name in sensors if np.ptp(np.nan_to_num(table.numbers(name))) > 0]
    readings = np.array([steps.means(table.numbers(name)[kept]) for name in sensors])
    warmed = Responses.of(times=steps.times, heats=heats, signals=readings)
    evident = warmed.pairs()
    pairs = [OPEN if sensors else ""] * len(wires)
    notes = []
    for index, sensor in enumerate(evident):
        if sensor is not None:
            pairs[index] = sensors[sensor]
            notes.append(f"MCPtemp of {duties[index]}: {sensors[sensor]}, which warms with it")
    for index, wire in enumerate(wires):
        usual = f"MCPtemp_{USUAL.get(wire)}"
        if pairs[index] == OPEN and not heats[index].any():
            pairs[index] = usual if usual in sensors and usual not in pairs else ""
            notes += [f"MCPtemp of {duties[index]}: {usual}, as is usual; it was not heated"]
    # Give each limb that was heated its mapping.
    heated = [limb for limb in limbs if heats[[wire[0] == limb for wire in wires]].any()]
    found = []
    for limb in heated or limbs:
        own = [index for index, wire in enumerate(wires) if wire[0] == limb]
        columns = [
            WireColumns(name, duties[index], temperature=pairs[index])
            for name, index in zip(SIDES, own, strict=True)
        ]
        bend, note = _bend_of_limb(table, limb, limbs)
        mapping = LogMapping.of(table, time, columns, bend)
        questions = [
            Question(
                f"wires[{number}].temperature",
                f"which MCPtemp is on the wire of {wire.duty}? Heat does not tell with a margin",
                sensors,
            )
            for number, wire in enumerate(columns)
            if wire.temperature == OPEN
        ]
        bends = np.array([steps.means(bends_of(table, mapping)[0][kept])])
        read = dict(zip(sensors, readings, strict=True))
        warmth = np.array([read.get(pairs[index], heats[index]) for index in own])
        votes = bend_votes(steps, heats[own], warmth, bends, np.array([[-1.0], [1.0]]))
        votes = votes[np.ptp(heats[own], axis=1) > 0]
        sign = float(np.sign(votes.sum()))
        said = f"the sign of the bend: the right wire bends to {'+' if sign > 0 else '-'}"
        if len(votes) and (sign * votes > MARGIN).all():
            bend.scale *= sign
        elif len(votes):
            text = "the sign of the bend: heat does not tell with a margin which way the limb bends"
            questions.append(Question("bend.scale", text, ["1.0", "-1.0"]))
            bend.scale = 0.0
            said = text
        else:
            said = "no heat shows which way the limb bends: check the sign of bend.scale"
        lines = [f"limb {limb} of a logger of limbs with shape-memory alloy", *notes, note, said]
        left_out = [other for other in limbs if heated and other not in heated]
        lines += [f"limb {other} was not heated, and is left out" for other in left_out]
        lines.append("left is its wire rev, right is fwd; exchange the names if they are not")
        name = f"limb_{limb}" if len(limbs) > 1 else ""
        found.append(Proposal(name, mapping, lines, questions, bool(len(votes)), table.names))
    return found


def _bend_of_limb(table: LogTable, limb: int, limbs: list[int]) -> tuple[BendColumns, str]:
    """Return the bend of a limb among others, and what it is of, in a line."""
    sensor = f"Bendlabs_{limb}"
    if sensor in table.names and np.nan_to_num(table.numbers(sensor)).any():
        said = f"bend: {sensor}, the angle of the tip's tangent in degrees, halved (8)"
        return BendColumns(sensor, measures=TIP_TANGENT), said
    tags = sorted(int(name[8:]) for name in table.names if re.fullmatch(r"tagid_x_\d+", name))
    points = [(f"tagid_x_{tag}", f"tagid_y_{tag}") for tag in tags]
    share = (len(points) - 1) // len(limbs)
    first = share * limbs.index(limb)
    own = points[first : first + share + 1]
    if share < 1:
        return BendColumns(sensor), "bend: no sensor, and too few tags; give its column"
    bend = BendColumns(line=[*own[0], *own[-1]], measures=CHORD)
    said = f"bend: of the chord from the tag of {own[0][0]} to that of {own[-1][0]}, "
    if first:
        before = points[max(0, first - 2) : first + 1]
        bend.base_line = [axis for point in before for axis in point]
        return bend, said + "from the direction of the limb before it"
    bend.zero = base_direction([[table.numbers(axis) for axis in point] for point in own])
    return bend, said + "from where the base points to in the picture, bend.zero"


def _pneumatic(table: LogTable) -> list[Proposal]:
    """Return the pneumatic limbs: no heat, but the half angles of the limbs' tips, in degrees."""
    angles = [name for name in table.names if re.fullmatch(r"theta_\d", name)]
    tags = [name for name in table.names if re.fullmatch(r"tagid_x_\d+", name)]
    found = []
    for angle in angles:
        wires = [WireColumns(name, "") for name in SIDES]
        # The angle is 0 while the camera does not see the tags.
        bend = BendColumns(angle, measures=BEND_ANGLE, seen=tags[-1] if tags else "")
        mapping = LogMapping.of(table, TimeColumn(TIMESTAMP, "ms", DAY), wires, bend)
        lines = [
            f"limb {angle[-1]} of a logger of pneumatic limbs: nothing in it heats a wire, so that "
            "calibration cannot use it",
            f"bend: {angle}, half of the tip's angle in degrees",
            "soft-limb plan takes the recording as a reference",
        ]
        name = f"limb_{angle[-1]}" if len(angles) > 1 else ""
        found.append(Proposal(name, mapping, lines, columns=table.names))
    return found
