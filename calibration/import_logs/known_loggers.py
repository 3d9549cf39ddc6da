"""Known loggers: `ezloophw-py`, of limbs with two wires each, and its pneumatic successor."""

import dataclasses
import re

from calibration.import_logs.clock import DAY
from calibration.import_logs.mapping import (
    BEND_ANGLE,
    CHORD,
    TIP_TANGENT,
    UNKNOWN,
    BendColumns,
    LogMapping,
    TimeColumn,
    WireColumns,
)
from calibration.import_logs.propose import Columns, Proposal, base_direction
from calibration.import_logs.table import LogTable
from calibration.import_logs.words import Dictionary

TIMESTAMP = "Timestamp (millisec since midnight today)"
WIRE_BY_SIDE = {"left": "rev", "right": "fwd"}  # which of both is on which side is ours
USUAL_SENSORS = {
    (0, "rev"): 0,
    (0, "fwd"): 1,
    (1, "rev"): 3,
    (1, "fwd"): 2,
}  # MCPtemp of limb and wire


def known_logger(table: LogTable) -> list[Proposal]:
    """Return the limbs in a log of a known logger; none if the logger is not known."""
    matches = [re.match(r"pwm_duty_limb(\d)_", name) for name in table.names]
    limbs = sorted({int(match[1]) for match in matches if match})
    if limbs:
        proposals = [_shape_memory_limb(table, limbs, limb) for limb in limbs]
        heated = [proposal for proposal in proposals if proposal.is_heated]
        return heated or proposals
    if TIMESTAMP in table.names and any(n.startswith("MPRpressure_") for n in table.names):
        return _pneumatic_limbs(table)
    return []


def _shape_memory_limb(table: LogTable, limbs: list[int], limb: int) -> Proposal:
    """Return the columns of a limb with two shape-memory wires; the log may have more limbs.

    All limbs of the log are in series, with the numbers ``limbs``.
    """
    time = TimeColumn("Test time", "s")
    if TIMESTAMP in table.names:
        time = TimeColumn(TIMESTAMP, "ms", wraps_after=DAY)  # it begins anew at midnight
    # Without a description (None) the limb is the nominal one, with a left and a right wire.
    columns = Columns(table, limb=None, dictionary=Dictionary(), time=time)
    # Ignore the numbers in the columns' names: they do not say which wire has which thermocouple.
    for column in columns.columns:
        column.name = dataclasses.replace(column.name, label="")
    by_name = {column.text: column for column in columns.columns}
    # A thermocouple whose readings never change (span 0) is not connected.
    sensors = [name for name in by_name if name.startswith("MCPtemp_") and by_name[name].span]
    columns.temperatures = [by_name[name] for name in sensors]
    # Pair the wires of all limbs, this limb's first, with the thermocouples that they warm.
    this_limb_first = [limb, *(other for other in limbs if other != limb)]
    limbs_and_sides = [(number, side) for number in this_limb_first for side in WIRE_BY_SIDE]
    for number, side in limbs_and_sides:
        duty = f"pwm_duty_limb{number}_{WIRE_BY_SIDE[side]}"
        table.numbers(duty)  # raises an error that names the column if it is missing
        columns.duties.append(by_name[duty])
        columns.wires.append(WireColumns(side, duty))
    columns.pair_wires_with_thermocouples()
    # Keep this limb's two wires; the others were there to claim their own thermocouples.
    columns.duties = columns.duties[:2]
    columns.wires = columns.wires[:2]
    taken = [wire.temperature for wire in columns.wires]
    fields = [f"wires[{index}].temperature" for index in (0, 1)]
    # A wire that was not heated warms none: it gets its usual thermocouple, or "", which is none.
    for index, wire in enumerate(columns.wires):
        usual = f"MCPtemp_{USUAL_SENSORS.get((limb, WIRE_BY_SIDE[wire.name]))}"
        if not columns.duties[index].span:
            if wire.temperature in ("", UNKNOWN):  # UNKNOWN if pairing asks the user
                wire.temperature = usual if usual in sensors and usual not in taken else ""
            wire.unit = "C"
            fields.remove(f"wires[{index}].temperature")
    columns.questions = [question for question in columns.questions if question.field in fields]
    # Add the bend, and turn its sign so that each wire bends the limb to its own side.
    bend, note = _bend_of_limb(table, limb, limbs)
    mapping = LogMapping.of(table, time, columns.wires, bend)
    columns.set_bend_sign(mapping)
    columns.notes |= {
        f"limb {limb}": "of a logger of limbs with shape-memory alloy",
        "bend": note,
        "left": "its wire rev, and right is fwd; exchange the names if they are not",
    }
    return columns.proposal(f"limb_{limb}" if len(limbs) > 1 else "", mapping)


def _bend_of_limb(table: LogTable, limb: int, limbs: list[int]) -> tuple[BendColumns, str]:
    """Return the bend of a limb among others, and what it is of, in a line."""
    sensor = f"Bendlabs_{limb}"
    if sensor in table.names and table.numbers(sensor).any():
        said = f"{sensor}, the angle of the tip's tangent in degrees, halved (8)"
        return BendColumns(sensor, measures=TIP_TANGENT), said
    tags = sorted(int(name[8:]) for name in table.names if re.fullmatch(r"tagid_x_\d+", name))
    points = [[f"tagid_x_{tag}", f"tagid_y_{tag}"] for tag in tags]
    share = (len(points) - 1) // len(limbs)
    first = share * limbs.index(limb)
    own = points[first : first + share + 1]
    if share < 1:
        return BendColumns(sensor), "no sensor, and too few tags; give its column"
    bend = BendColumns(line=[*own[0], *own[-1]], measures=CHORD)
    said = (
        f"of the chord from the tag of {own[0][0]} to the tag of {own[-1][0]}, from the direction"
    )
    if first:
        before = points[max(0, first - 2) : first + 1]
        bend.base_line = [axis for point in before for axis in point]
        return bend, f"{said} of the limb before it"
    bend.zero = base_direction([[table.numbers(axis) for axis in point] for point in own])
    return bend, f"{said} of the base in the picture, bend.zero"


def _pneumatic_limbs(table: LogTable) -> list[Proposal]:
    """Return the pneumatic limbs: no heat, but the half angles of the limbs' tips, in degrees."""
    angles = [name for name in table.names if re.fullmatch(r"theta_\d", name)]
    tags = [name for name in table.names if re.fullmatch(r"tagid_x_\d+", name)]
    proposals = []
    for angle in angles:
        wires = [WireColumns(name, "") for name in WIRE_BY_SIDE]
        # The angle is 0 while the camera does not see the tags.
        bend = BendColumns(angle, measures=BEND_ANGLE, seen=tags[-1] if tags else "")
        mapping = LogMapping.of(table, TimeColumn(TIMESTAMP, "ms", wraps_after=DAY), wires, bend)
        lines = [
            f"limb {angle[-1]} of a logger of pneumatic limbs: nothing in it heats a wire, so that "
            "calibration cannot use it",
            f"bend: {angle}, half of the tip's angle in degrees",
            "soft-limb plan takes the recording as a reference",
        ]
        name = f"limb_{angle[-1]}" if len(angles) > 1 else ""
        proposals.append(Proposal(name, mapping, lines, columns=table.names))
    return proposals
