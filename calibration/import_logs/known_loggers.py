"""Known loggers: `ezloophw-py`, of limbs with two wires each, and its pneumatic successor."""

import itertools
import operator
import re

from calibration.import_logs import mapping
from calibration.import_logs.clock import DAY
from calibration.import_logs.mapping import BendColumns, LogMapping, TimeColumn, WireColumns
from calibration.import_logs.points import base_direction
from calibration.import_logs.propose import Columns, Proposal
from calibration.import_logs.table import LogError, LogTable
from calibration.import_logs.words import Dictionary

TIMESTAMP = "Timestamp (millisec since midnight today)"
WIRE_BY_SIDE = {"left": "rev", "right": "fwd"}  # which of both is on which side is ours
USUAL_SENSORS = {
    (0, "left"): "MCPtemp_0",
    (0, "right"): "MCPtemp_1",
    (1, "left"): "MCPtemp_3",
    (1, "right"): "MCPtemp_2",
}  # of limb and wire


def known_logger(table: LogTable) -> list[Proposal]:
    """Return the limbs in a log of a known logger; none if the logger is not known."""
    limbs = sorted(set(map(int, _numbers_after("pwm_duty_limb", table, r"_\w+"))))
    if limbs:
        proposals = [_shape_memory_limb(table, limbs, limb) for limb in limbs]
        return list(filter(operator.attrgetter("is_heated"), proposals)) or proposals
    if TIMESTAMP in table.names and _numbers_after("MPRpressure_", table):
        return _pneumatic_limbs(table)
    return []


def _numbers_after(start: str, table: LogTable, end: str = "") -> list[str]:
    """Return the numbers in the names of columns that begin and end so, in their order."""
    numbers = []
    for name in table.names:
        if match := re.fullmatch(rf"{start}(\d+){end}", name):
            numbers.append(match[1])
    return numbers


def _shape_memory_limb(table: LogTable, limbs: list[int], limb: int) -> Proposal:
    """Return the columns of a limb with two shape-memory wires; the log may have more limbs.

    All limbs of the log are in series, with the numbers ``limbs``.
    """
    time = TimeColumn("Test time", "s")
    if TIMESTAMP in table.names:
        time = TimeColumn(TIMESTAMP, "ms", wraps_after=DAY)  # it begins anew at midnight
    columns = Columns(table, limb=None, dictionary=Dictionary(), time=time)
    # Ignore the numbers in the columns' names: they do not say which wire has which thermocouple.
    for column in columns.columns:
        column.name.label = ""
    # A thermocouple whose readings never change is not connected.
    sensors = columns.columns.moving.where(lambda column: column.text.startswith("MCPtemp_"))
    columns.temperatures = sensors
    # Pair the wires of all limbs, this limb's first, with the thermocouples that they warm.
    for number in sorted(limbs, key=lambda number: number != limb):
        for side, wire_in_log in WIRE_BY_SIDE.items():
            duty = f"pwm_duty_limb{number}_{wire_in_log}"
            columns.wires.append(WireColumns(side, duty))
            columns.duties += columns.columns.having("text", duty)
            if len(columns.duties) < len(columns.wires):
                raise LogError(f"no column {duty!r} with numbers, which this logger writes.")
    columns.pair_wires_with_thermocouples()
    # Keep this limb's two wires; the others were there to claim their own thermocouples.
    del columns.duties[2:]
    del columns.wires[2:]
    del columns.heats
    # A wire that was not heated warms none: it gets its usual thermocouple, if that is free.
    taken = [wire.temperature for wire in columns.wires]
    fields = []
    for index, wire in enumerate(columns.wires):
        usual = USUAL_SENSORS.get((limb, wire.name), "")
        if columns.duties[index].span:
            fields.append(f"wires[{index}].temperature")
        elif wire.temperature in ("", mapping.UNKNOWN):
            is_free = usual in sensors.each("text") and usual not in taken
            wire.temperature = usual if is_free else ""
        if wire.unit == mapping.UNKNOWN and wire.temperature != mapping.UNKNOWN:
            wire.unit = "C"
    columns.questions = [question for question in columns.questions if question.field in fields]
    # Add the bend, and turn its sign so that each wire bends the limb to its own side.
    bend, note = _bend_of_limb(table, limb, limbs)
    log_mapping = LogMapping(time, columns.wires, bend)
    columns.find_sides(log_mapping)
    columns.notes += [
        f"limb {limb} of a logger of limbs with shape-memory alloy",
        f"bend: {note}",
        "the left wire is rev, and the right wire fwd; exchange the names if they are not",
    ]
    return columns.proposal(f"limb_{limb}" if len(limbs) > 1 else "", log_mapping)


def _bend_of_limb(table: LogTable, limb: int, limbs: list[int]) -> tuple[BendColumns, str]:
    """Return the bend of a limb among others, and a line that says how it is measured."""
    sensor = f"Bendlabs_{limb}"
    if sensor in table.names and table.numbers(sensor).any():
        note = f"{sensor}, the angle of the tip's tangent in degrees, halved (8)"
        return BendColumns(sensor, measures=mapping.TIP_TANGENT), note
    # Else take the chord of its tags; limbs in series share the tags between them.
    tags = sorted(_numbers_after("tagid_x_", table), key=int)
    points = [[f"tagid_x_{tag}", f"tagid_y_{tag}"] for tag in tags]
    share = (len(points) - 1) // len(limbs)
    first = share * limbs.index(limb)
    limb_points = points[first : first + share + 1]
    if share < 1:
        return BendColumns(sensor), "no sensor, and too few tags; give its column"
    base = limb_points[0]
    tip = limb_points[-1]
    bend = BendColumns(line=[*base, *tip], measures=mapping.CHORD)
    note = f"of the chord from the tag of {base[0]} to the tag of {tip[0]}, from the "
    # Measure from the direction of the limb before it, or of the base in the picture.
    if first:
        for point in points[max(0, first - 2) : first + 1]:
            bend.base_line += point
        return bend, f"{note}direction of the limb before it"
    bend.zero = base_direction(list(map(table.numbers, itertools.chain(*limb_points))))
    return bend, f"{note}direction of the base in the picture, bend.zero"


def _pneumatic_limbs(table: LogTable) -> list[Proposal]:
    """Return the pneumatic limbs: no heat, but the half angles of the limbs' tips, in degrees."""
    proposals = []
    numbers = _numbers_after("theta_", table)
    tags = _numbers_after("tagid_x_", table)
    for number in numbers:
        wires = [WireColumns(name, "") for name in WIRE_BY_SIDE]
        # The angle is 0 while the camera does not see the tags.
        bend = BendColumns(f"theta_{number}", seen=f"tagid_x_{tags[-1]}" if tags else "")
        time = TimeColumn(TIMESTAMP, "ms", wraps_after=DAY)
        log_mapping = LogMapping(time, wires, bend)
        notes = [
            f"limb {number} of a logger of pneumatic limbs: nothing in it heats a wire, so that "
            "calibration cannot use it",
            f"bend: theta_{number}, half of the tip's angle in degrees",
            "soft-limb plan takes the recording as a reference",
        ]
        name = f"limb_{number}" if len(numbers) > 1 else ""
        proposals.append(Proposal(name, log_mapping, notes, columns=table.names))
    return proposals
