"""Formats of known loggers: which column is what, and what the numbers have to tell."""

import dataclasses
import re

import numpy as np

from limb_systems.logs.evidence import bending, heat_of, pairing
from limb_systems.logs.mapping import (
    BEND_ANGLE,
    CHORD,
    TIP_TANGENT,
    BendColumns,
    LogMapping,
    TimeColumn,
    WireColumns,
)
from limb_systems.logs.reading import DAY, bend_of, times_of
from limb_systems.logs.table import LogTable

TIMESTAMP = "Timestamp (millisec since midnight today)"
SIDES = {"left": "rev", "right": "fwd"}  # which of both is on which side is ours
USUAL = {(0, "rev"): 0, (0, "fwd"): 1, (1, "rev"): 3, (1, "fwd"): 2}  # MCPtemp of limb and wire


@dataclasses.dataclass(frozen=True)
class LimbInLog:
    """A limb of a log.

    - ``name``: its name among those in the log; empty if it is alone.
    - ``mapping``: mapping of the log's columns.
    - ``notes``: what the columns are taken for, and why, in lines.
    - ``agreement``: correlation of each wire's thermocouple with its heat; 0 where none shows
      that it is this wire's.
    """

    name: str
    mapping: LogMapping
    notes: list[str]
    agreement: list[float]

    @property
    def heated(self) -> bool:
        """Whether heat shows how columns belong together, and which way the bend is counted."""
        return any(self.agreement)


def known_format(table: LogTable) -> list[LimbInLog]:
    """The limbs in a log of a known format; none if the format is not known."""
    limbs = sorted({int(m[1]) for n in table.names if (m := re.match(r"pwm_duty_limb(\d)_", n))})
    if limbs:
        return _sma(table, limbs)
    if TIMESTAMP in table.names and any(n.startswith("MPRpressure_") for n in table.names):
        return _pneumatic(table)
    return []


def _sma(table: LogTable, limbs: list[int]) -> list[LimbInLog]:
    """The logger of limbs with two shape-memory-alloy wires each."""
    time = TimeColumn("Test time", "s")
    if TIMESTAMP in table.names:
        time = TimeColumn(TIMESTAMP, "ms", DAY)
    times, kept = times_of(table, time)
    wires = [(limb, which) for limb in limbs for which in SIDES.values()]
    columns = [f"pwm_duty_limb{limb}_{which}" for limb, which in wires]
    duties = np.array([np.nan_to_num(table.numbers(column)[kept]) for column in columns])
    heats = heat_of(times, duties)
    sensors = [name for name in table.names if name.startswith("MCPtemp_")]
    sensors = [name for name in sensors if np.ptp(np.nan_to_num(table.numbers(name))) > 0]
    readings = np.array([table.numbers(name)[kept] for name in sensors])
    found_pairs = pairing(heats, readings)
    pairs = [sensors[found] if found is not None else "" for found, _ in found_pairs]
    notes = [f"MCPtemp of {c}: {p}, which warms with it" for c, p in zip(columns, pairs) if p]  # noqa: B905
    for index, wire in enumerate(wires):
        usual = f"MCPtemp_{USUAL.get(wire)}"
        if not pairs[index] and usual in sensors and usual not in pairs:
            pairs[index] = usual
            notes.append(f"MCPtemp of {columns[index]}: {usual}, as is usual; it was not heated")
    heated = [limb for limb in limbs if duties[[w[0] == limb for w in wires]].any()]
    found = []
    for limb in heated or limbs:
        own = [index for index, wire in enumerate(wires) if wire[0] == limb]
        named = [
            WireColumns(name, columns[i], temperature=pairs[i])
            for name, i in zip(SIDES, own, strict=True)
        ]
        bend, note = _bend_of_limb(table, limb, limbs)
        mapping = LogMapping.of(table, time, named, bend)
        mapping, sign = turned(mapping, table, kept, heats[own])
        lines = [f"limb {limb} of a logger of limbs with shape-memory alloy", *notes, note, sign]
        lines += [
            f"limb {other} was not heated, and is left out"
            for other in limbs
            if other not in heated and heated
        ]
        lines.append("left is its wire rev, right is fwd; exchange the names if they are not")
        name = f"limb_{limb}" if len(limbs) > 1 else ""
        found.append(LimbInLog(name, mapping, lines, [found_pairs[i][1] for i in own]))
    return found


def turned(
    mapping: LogMapping, table: LogTable, kept: np.ndarray, heats: np.ndarray
) -> tuple[LogMapping, str]:
    """A mapping whose bend grows where the right wire is heated, and what showed it.

    Args:
        heats: heat of the mapping's wires (W, K), as `heat_of` gives it.
    """
    sign = sign_by_heat(mapping.wires, heats, bend_of(table, mapping)[kept])
    if not sign:
        return mapping, "no heat shows which way the limb bends: check the sign of bend.scale"
    mapping.bend.scale *= sign
    return mapping, f"the sign of the bend: the right wire bends to {'+' if sign > 0 else '-'}"


def sign_by_heat(wires: list[WireColumns], heats: np.ndarray, bend: np.ndarray) -> float:
    """Sign of a bend (K,) that grows where the right wire is heated; 0 if no heat shows it."""
    if not len(heats):
        return 0.0
    directions = [1.0 if wire.name == "right" else -1.0 for wire in wires]
    return float(np.sign(np.dot(bending(heats, bend), directions)))


def _bend_of_limb(table: LogTable, limb: int, limbs: list[int]) -> tuple[BendColumns, str]:
    sensor = f"Bendlabs_{limb}"
    if sensor in table.names and np.nan_to_num(table.numbers(sensor)).any():
        said = f"bend: {sensor}, the angle of the tip's tangent in degrees, halved (8)"
        return BendColumns(sensor, measures=TIP_TANGENT), said
    tags = points(table.names)
    share = (len(tags) - 1) // len(limbs)
    first = share * limbs.index(limb)
    own = tags[first : first + share + 1]
    if share < 1:
        return BendColumns(sensor), "bend: no sensor, and too few tags; give its column"
    bend = BendColumns(line=[*own[0], *own[-1]], measures=CHORD)
    said = f"bend: of the chord from the tag of {own[0][0]} to that of {own[-1][0]}, "
    if first:
        bend.base_line = [axis for tag in tags[max(0, first - 2) : first + 1] for axis in tag]
        return bend, said + "from the direction of the limb before it"
    bend.zero = base_direction(table, own)
    return bend, said + "from where the base points to in the picture, bend.zero"


def points(names: list[str]) -> list[tuple[str, str]]:
    """Columns of points in a picture, x and y, in the order of their numbers or in the log's."""
    found = []
    for name in names:
        for match in re.finditer(r"(?<![a-z])x(?![a-z])", name, re.IGNORECASE):
            y = "Y" if match[0] == "X" else "y"
            other = name[: match.start()] + y + name[match.end() :]
            if other in names:
                found.append((name, other))
    return sorted(found, key=lambda pair: [int(n[:9]) for n in re.findall(r"\d+", pair[0])])


def base_direction(table: LogTable, line: list[tuple[str, str]]) -> float:
    """Direction of a limb's base in a picture whose y points down, °: that of its first links.

    The directions of links are those of the tangents at their middles, and the base is half a
    link before the first one, as for constant curvature.
    """
    x, y = (np.array([table.numbers(point[axis]) for point in line]) for axis in (0, 1))
    shown = ~((x == 0) & (y == 0)).any(axis=0) & ~np.isnan(x + y).any(axis=0)
    if not shown.any():
        return 0.0
    links = np.unwrap(
        np.arctan2(-np.diff(y[:, shown], axis=0), np.diff(x[:, shown], axis=0)), axis=0
    )
    base = links[0] if len(links) < 2 else 1.5 * links[0] - 0.5 * links[1]
    return round(float(np.rad2deg(np.median(base))), 2)


def _pneumatic(table: LogTable) -> list[LimbInLog]:
    """The pneumatic successor: no heat, but the half angles of the limbs' tips, in degrees."""
    angles = [name for name in table.names if re.fullmatch(r"theta_\d", name)]
    found = []
    for angle in angles:
        wires = [WireColumns(name, "") for name in SIDES]
        bend = BendColumns(angle, measures=BEND_ANGLE)
        mapping = LogMapping.of(table, TimeColumn(TIMESTAMP, "ms", DAY), wires, bend)
        lines = [
            f"limb {angle[-1]} of a logger of pneumatic limbs: nothing in it heats a wire, so that "
            "calibration cannot use it",
            f"bend: {angle}, half of the tip's angle in degrees",
            "soft-limb plan takes the recording as a reference",
        ]
        found.append(
            LimbInLog(f"limb_{angle[-1]}" if len(angles) > 1 else "", mapping, lines, [0.0, 0.0])
        )
    return found
