"""What the columns of any other log may be: by names, units, ranges and what follows the heat.

A column whose name or unit is of another physical quantity than a signal is never taken for that
signal. What is then missing, or may be read in two ways, is `OPEN` in the mapping, or 0 for a
number, and asked for.
"""

import contextlib
import dataclasses
import itertools
import re
from pathlib import Path

import numpy as np

from limb_systems.logs.evidence import (
    bending,
    correlation,
    following,
    heat_of,
    held,
    pairing,
    side_of,
)
from limb_systems.logs.formats import (
    LimbInLog,
    base_direction,
    known_format,
    points,
    turned,
)
from limb_systems.logs.mapping import (
    BEND_ANGLE,
    CHORD,
    OPEN,
    SECONDS,
    TIP_TANGENT,
    BendColumns,
    LogMapping,
    TimeColumn,
    WireColumns,
)
from limb_systems.logs.quantities import (
    ANGLE,
    COUNTS,
    POWER,
    SHARE,
    TEMPERATURE,
    TIME,
    has,
    quantities_of,
    words_of,
)
from limb_systems.logs.reading import DAY, is_reversed, stamps, times_of
from limb_systems.logs.table import LogError, LogTable, read_table
from limb_systems.progress import Progress

DUTY, BEND = "duty", "bend"
ASKS = "? "  # beginning of a note that asks for something
ADMITTED = {  # quantities of each signal
    TIME: {TIME},
    DUTY: {SHARE, COUNTS},
    TEMPERATURE: {TEMPERATURE},
    BEND: {ANGLE},
}
WORDS = {  # in names of columns, whole or as their parts: of a signal, whatever its quantity
    TIME: "time timestamp zeit uhrzeit datetime date ms millis msec sec seconds s elapsed us "
    "micros",
    DUTY: "pwm duty heat heater heating power pow u cmd command out output ctrl gate mosfet sma "
    "input duties heiz",
    TEMPERATURE: "temp temperature tc thermo thermocouple max31855 mcp celsius kelvin fahrenheit "
    "degc degf temperatur t tmp",
    BEND: "bend bending angle flex phi theta winkel biegung curvature alpha tip tangent tilt chord "
    "deflection deg degrees rad biege pose courbure",
}
NOT_MEASURED = (
    "setpoint target ref reference desired limit max min goal error unconstrained soll cjc "
    "std stddev variance ambient room umgebung status state"
)
SCALED = {COUNTS, "voltage", "resistance", "length", "curvature"}  # from which bends are counted
IN_PICTURES = {COUNTS, "length"}
DEGREES = {"C": "°C", "F": "°F", "K": "K", OPEN: OPEN}
FULLS = (1.0, 100.0, 255.0, 1023.0, 4095.0, 65535.0)
PERIODS = (DAY, 2**32 / 1e6, 2**16 / 1e3)  # s, after which clocks begin anew
RATES, DURATIONS = (0.15, 1500.0), (5.0, 2e5)  # Hz and s, of logs
MOST_WIRES = 2
ABSURD = 1e9  # that no number but a time's is beyond
ROOM = 5.0  # °C, below which a reading that never moves is of nothing
FIRST = 10  # rows, in which a limb rests
MISSING = (-9999.0, -999.0, -127.0, 999.0, 9999.0)  # what loggers write for no reading
VOLTS = 24.0  # below which a number that is no count may be volts or watts
WARM_ROOM, TOO_HOT = 48.0, 150.0  # °C: no room is so warm, and no limb so hot
FOLLOWED, SAME, CLEARLY = 0.5, 0.97, 0.3  # correlations, and what is between two scores
FARTHEST = 60.0  # °, to which no limb is bent at rest
RADIANS = 2.2  # that no bend in degrees stays within, while wires are heated


@dataclasses.dataclass(frozen=True, eq=False)
class Column:
    """A column of a log.

    - ``name``, ``words``: its name, and the words in its name and unit.
    - ``quantities``: physical quantities that its name or unit says; none if they say nothing.
    - ``said_by``: what says them.
    - ``values``: its numbers (K,).
    """

    name: str
    words: list[str]
    quantities: set[str]
    said_by: str
    values: np.ndarray

    def said(self, role: str) -> bool:
        """Whether the name has a word of a role; a "t" with a number is no time."""
        if role == TIME and self.name.lower() == "t":
            return True
        return _has(self.words, WORDS[role])

    def contradicts(self, role: str) -> bool:
        """Whether its name or unit is of a quantity that a signal is not."""
        return bool(self.quantities) and not self.quantities & ADMITTED[role]

    @property
    def other_quantity(self) -> str:
        """What it is by its name or unit, in words; empty if these say nothing."""
        named = [q if q == COUNTS else f"a{'n' * (q[0] in 'aei')} {q}" for q in self.quantities]
        return f"{' or '.join(sorted(named))}, by {self.said_by}" if named else ""

    @property
    def shown(self) -> np.ndarray:
        """Its numbers without those that are missing."""
        return self.values[~np.isnan(self.values)]


def _has(words: list[str], known: str) -> bool:
    return has(words, known, substring=4)


def limbs_in_log(path: str | Path, table: LogTable | None = None) -> list[LimbInLog]:
    """The limbs in a log, with mappings: of a known format, or as its columns suggest.

    Args:
        table: the log's rows; they are read if None.

    Raises:
        LogError: if it is no table of text with rows of numbers, or lacks columns of its format.
    """
    table = table or read_table(path)
    try:
        limbs = known_format(table)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    if limbs:
        return limbs
    limb = guessed(table)
    with contextlib.suppress(LogError):
        if is_reversed(stamps(table, limb.mapping.time)):
            return [guessed(table.oldest_first())]
    return [limb]


def guessed(table: LogTable) -> LimbInLog:
    """The limb in a log, by a mapping that seems likely.

    What is not found, or could be either of two, is `OPEN` in the mapping, or 0 for a number.
    """
    columns = [
        Column(name, words_of(f"{name} {unit}"), *quantities_of(name, unit), table.numbers(name))
        for name, unit in zip(table.names, table.units, strict=True)
    ]
    notes = {c.name: ("not used", c.other_quantity or "no signal fits it") for c in columns}
    asked: list[str] = []
    time = _time(table, columns, notes, asked)
    times, kept = _times(table, time)
    columns = [c for c in columns if c.name != time.column and (~np.isnan(c.values)).sum() > 5]
    missing = sorted({v for c in columns for v in MISSING if _stands_out(c, v)})
    columns = [dataclasses.replace(c, values=_cleaned(c.values, missing, kept)) for c in columns]
    columns = [column for column in columns if len(column.shown) > 5]
    duties, signs = _duties(columns, times, notes)
    other_duty = _other_duty(duties, columns, times)
    full = _full(duties, asked)
    heats = heat_of(times, _shares(duties, signs, full, len(times)))
    rest = [column for column in columns if column not in duties]
    temperatures = _temperatures(rest, heats, notes)
    bend = _bend([c for c in rest if c not in temperatures], table, times, heats, notes, asked)
    wires, agreement = _wires(duties, signs, temperatures, heats, notes, asked)
    mapping = LogMapping(
        time, wires, bend, full, missing=missing, delimiter=table.delimiter, decimal=table.decimal,
        names_line=table.names_line,
    )  # fmt: skip
    said = []
    if not duties:
        asked.append("duty: no column seems to be a duty, which is 0 while wires are off")
    elif bend.scale and bend.column != OPEN:
        mapping, showed = turned(mapping, table, kept, heats)
        said.append(showed)
    if full:
        said.append(_said_of_full(duties, full))
    if bend.scale and bend.column and bend.column != OPEN and bend.measures == BEND_ANGLE:
        said.append(
            f"{bend.column} is taken for the bend angle φ: if it is the angle of the tip, α, "
            "correct measures to tip_tangent"
        )
    elif not bend.scale and bend.column != OPEN:
        asked.append(_asked_of_scale(mapping, columns, heats))
    if duties and not any(_side(duty) for duty in duties):
        said.append("names do not say which wire is on which side: correct them if need be")
    if other_duty:
        side = "left" if wires[0].name == "right" else "right"
        mapping.wires.append(WireColumns(side, OPEN))
        agreement.append(0.0)
        asked.append(
            f"duty: {other_duty.name} is {other_duty.other_quantity}, but 0 and still as a duty "
            f"is: give the duty of the {side} wire, or leave out that wire"
        )
    lines = _lines_of(notes) + list(filter(None, said)) + [f"{ASKS}{one}" for one in asked]
    return LimbInLog("", mapping, lines, agreement)


def _lines_of(notes: dict[str, tuple[str, str]]) -> list[str]:
    """A line for each column: its name, what it is taken for, and why."""
    widths = [min(40, max(map(len, texts))) for texts in (notes, (n[0] for n in notes.values()))]
    return [
        f"{name:<{widths[0]}}  {what:<{widths[1]}}  {why}".rstrip()
        for name, (what, why) in notes.items()
    ]


def _cleaned(values: np.ndarray, missing: list[float], kept: np.ndarray) -> np.ndarray:
    """The numbers of rows that are kept, nan where they stand for no reading or are absurd."""
    values = values if kept.all() else values[kept]
    left_out = np.abs(values) > ABSURD
    if missing:
        left_out |= np.isin(values, missing)
    return np.where(left_out, np.nan, values) if left_out.any() else values


def _shares(duties: list[Column], signs: list[float], full: float, count: int) -> np.ndarray:
    """Duty of each wire (W, K), in [0, 1]."""
    shares = np.zeros((len(duties), count))
    full = full or max((float(np.abs(duty.shown).max()) for duty in duties), default=1.0)
    for share, duty, sign in zip(shares, duties, signs, strict=True):
        share[:] = np.clip(sign * held(duty.values) / full, 0.0, 1.0)
    return shares


def _wires(
    duties: list[Column],
    signs: list[float],
    temperatures: list[Column],
    heats: np.ndarray,
    notes: dict[str, tuple[str, str]],
    asked: list[str],
) -> tuple[list[WireColumns], list[float]]:
    """The wires with their thermocouples, and how well each of these follows its wire's heat."""
    if not duties:
        return [WireColumns(name, OPEN) for name in ("left", "right")], [0.0, 0.0]
    sides = ["left", "right"]
    if len(duties) < 2:
        sides = [_side(duty) or "right" for duty in duties]
    pairs = pairing(heats, np.array([column.values for column in temperatures]))
    left = [i for i in range(len(temperatures)) if i not in [reading for reading, _ in pairs]]
    wires = []
    for name, duty, sign, (reading, agreement) in zip(sides, duties, signs, pairs, strict=True):
        named = duty.said(DUTY) or SHARE in duty.quantities
        why = "its name" if named else "it is 0 and still as a duty is, and others follow it"
        notes[duty.name] = f"duty of the {name} wire", why
        if len(set(duties)) < len(duties):
            notes[duty.name] = "duty of both wires", "its sign: negative numbers heat the left wire"
        if reading is None and left:  # no heat shows it
            same = [i for i in left if _side(temperatures[i]) == name]
            if same or len(left) == len(temperatures) - 1 or len(left) == len(duties):
                reading = same[0] if same else left[0]
                left.remove(reading)
        wires.append(WireColumns(name, duty.name, sign))
        if reading is not None:
            sensor, unit = temperatures[reading], _unit(temperatures[reading])
            wires[-1].temperature, wires[-1].unit = sensor.name, unit
            why = f"it follows that wire's heat (r = {agreement:.2f})" if agreement else "its name"
            notes[sensor.name] = f"temperature of the {name} wire, {DEGREES[unit]}", why
            if unit == OPEN:
                low, high = np.quantile(sensor.shown, [0.02, 1.0])
                asked.append(
                    f"unit of {sensor.name}: C, F or K? It reads {low:.3g} to {high:.3g}, which "
                    "does not tell, or contradicts its name"
                )
    return wires, [agreement for _, agreement in pairs]


def _asked_of_scale(mapping: LogMapping, columns: list[Column], heats: np.ndarray) -> str:
    """The question what a unit of the bend's column is, with the sign if heat shows it."""
    bend = mapping.bend
    (counts,) = (column for column in columns if column.name == bend.column)
    directions = np.array([-1.0 if wire.name == "left" else 1.0 for wire in mapping.wires])
    sign = side_of(bending(heats, counts.values), directions) if len(heats) else 0.0
    how = {1.0: "", -1.0: ", as a negative number, for it falls where the right wire is heated"}
    return (
        f"bend.scale is 0: give the degrees of a unit of {bend.column}"
        f"{how.get(sign, ', and its sign')}; bend.zero is what it reads at the beginning"
    )


def _times(table: LogTable, time: TimeColumn) -> tuple[np.ndarray, np.ndarray]:
    with contextlib.suppress(LogError):
        return times_of(table, time)
    # To see what follows what; the reading will tell.
    return 0.1 * np.arange(table.num_rows), np.ones(table.num_rows, bool)


def _stands_out(column: Column, value: float) -> bool:
    """Whether a number is in a column, far from all others there."""
    if value not in column.values:
        return False
    others = column.shown[~np.isin(column.shown, MISSING)]
    if not len(others):
        return False
    low, high = np.quantile(others, [0.01, 0.99])
    return not low - 2 * (high - low) - 1 < value < high + 2 * (high - low) + 1


def _time(
    table: LogTable,
    columns: list[Column],
    notes: dict[str, tuple[str, str]],
    asked: list[str],
) -> TimeColumn:
    """The column that increases, in a unit in which its rate and its length are those of logs."""
    best: tuple[float, TimeColumn] | None = None
    standing = ""
    for column in columns:
        if column.contradicts(TIME):
            continue
        values, unit = column.values, ""
        if np.isnan(values).mean() > 0.5:
            values, unit = table.moments(column.name), "date"
        shown = values[~np.isnan(values)]
        if len(shown) < 0.5 * len(values) or len(shown) < 5:
            continue
        steps = np.diff(shown)
        steps = -steps if (steps < 0).sum() > 0.9 * len(steps) else steps  # newest row first
        if (steps > 0).sum() < 5 or (steps < 0).sum() > 0.002 * len(steps) + 1:
            standing = column.name if column.said(TIME) and len(column.words) == 1 else standing
            continue
        if (steps == 1).all() and not column.said(TIME):
            continue  # an index
        unit = unit or _unit_of_time(column, shown)
        if not unit:
            continue
        scale, wraps = SECONDS.get(unit, 1.0), 0.0
        for period in PERIODS if (steps < 0).any() else ():
            if np.abs(steps.min() * scale + period) < 0.01 * period:
                wraps = period
        # A column of time says so, has a value of its own in most rows, and is no index.
        score = 2.0 * column.said(TIME) + (steps > 0).mean() - 1.5 * bool((steps == 1).all())
        score -= 2.0 * (column.said(TEMPERATURE) and not column.said(TIME)) + (unit == OPEN)
        if best is None or score > best[0]:
            best = score, TimeColumn(column.name, unit, wraps)
    if standing and (best is None or best[0] < 2.0):
        return TimeColumn(standing)  # which reading refuses
    if best is None:
        asked.append("time: no column is a time that increases, by its name, unit and numbers")
        return TimeColumn(OPEN)
    time = best[1]
    notes[time.column] = f"time, {time.unit}", "it increases as a clock does"
    if time.unit == OPEN:
        asked.append(
            f"unit of {time.column}: its rows are too far apart, or too near, for its name"
        )
    return time


def _unit_of_time(column: Column, shown: np.ndarray) -> str:
    """The unit that the name says, else the first in which rate and length can be; `OPEN` if the
    name says one in which they cannot be.
    """
    names = {"ms": "ms millis msec milliseconds millisec", "us": "us micros µs microseconds usec",
             "ns": "ns nanos nanoseconds nsec", "s": "s sec seconds secs sekunden",
             "min": "min minutes minuten", "d": "d days", "h": "h hours"}  # fmt: skip
    steps = np.diff(shown)
    usual, length = float(np.median(np.abs(steps[steps != 0]))), float(np.ptp(shown))

    def can_be(unit: str, spare: float = 1.0) -> bool:
        rate, duration = 1 / (usual * SECONDS[unit]), length * SECONDS[unit]
        return (
            RATES[0] / spare < rate < RATES[1] * spare
            and DURATIONS[0] / spare < duration < DURATIONS[1] * spare
        )

    said = [unit for unit, words in names.items() if set(column.words) & set(words.split())]
    if said:
        return next((unit for unit in said if can_be(unit, spare=10.0)), OPEN)
    likely = ("s", "ms", "us", "ns", "min", "d")
    return next((unit for unit in likely if can_be(unit) and _usual(usual, unit)), "")


def _usual(step: float, unit: str) -> bool:
    """Whether a step is of 0.4 to 200 Hz, so that ms are not taken for s."""
    return 0.4 < 1 / (step * SECONDS[unit]) < 201


def _duties(
    columns: list[Column], times: np.ndarray, notes: dict[str, tuple[str, str]]
) -> tuple[list[Column], list[float]]:
    """The columns of duty, and the sign that heats; a signed one counts for both wires."""
    rated = []
    for column in columns:
        if (column.contradicts(DUTY) and column.quantities != {POWER}) or _has(
            column.words, NOT_MEASURED
        ):
            continue
        values, named = column.shown, column.said(DUTY) or SHARE in column.quantities
        still = np.mean(np.diff(values) == 0)
        off = np.mean(values == 0)
        if not named and (off < 0.05 or still < 0.5 or np.ptp(values) == 0):
            continue
        if np.abs(values).max() > FULLS[-1]:
            continue
        score = 2.0 * named + off + still - (column.said(TEMPERATURE) or column.said(BEND))
        if score > 0.8:
            rated.append((score, column))
    named_ones = [pair for pair in rated if pair[0] > 2.0 and np.ptp(pair[1].shown) > 0]
    # Without a name that says so, something has to follow its heat.
    rated = (named_ones and [pair for pair in rated if pair[0] > 2.0]) or [
        (score, c) for score, c in rated if score > 2.0 or _is_followed(c, columns, times)
    ]
    heated = [pair for pair in rated if np.ptp(pair[1].shown) > 0] or rated
    if not heated:
        return [], []
    signed = [column for _, column in heated if column.shown.min() < 0 < column.shown.max()]
    if signed and len(signed) == len(heated):
        return [signed[0], signed[0]], [-1.0, 1.0]
    unsigned = [pair for pair in rated if pair[1].shown.min() >= 0]
    chosen = _best_pair(unsigned, columns, times)
    for _, column in unsigned:
        if column not in chosen:
            notes[column.name] = "not used", "it may be a duty, but less follows its heat"
    sides = [_side(column) for column in chosen]
    if sides == ["right", "left"]:
        chosen.reverse()
    return chosen, [1.0] * len(chosen)


def _other_duty(duties: list[Column], columns: list[Column], times: np.ndarray) -> Column | None:
    """A column that would be another wire's duty, were it not of another quantity."""
    if len(duties) != 1:
        return None
    for column in columns:
        values = column.shown
        still, off = np.mean(np.diff(values) == 0), np.mean(values == 0)
        if (
            column.contradicts(DUTY)
            and not _has(column.words, NOT_MEASURED)
            and min(off, np.ptp(values)) > 0.05
            and still > 0.5
            and abs(correlation(column.values, duties[0].values)) < SAME
            and _is_followed(column, [c for c in columns if c not in duties], times)
        ):
            return column
    return None


def _is_followed(duty: Column, columns: list[Column], times: np.ndarray) -> bool:
    """Whether a column follows the heat of what may be a duty."""
    heat = heat_of(times, held(duty.values))
    return any(
        abs(correlation(heat, column.values)) > FOLLOWED for column in columns if column != duty
    )


def _best_pair(
    rated: list[tuple[float, Column]], columns: list[Column], times: np.ndarray
) -> list[Column]:
    """The columns of duty among those that may be: a pair that warms as many thermocouples.

    Args:
        rated: those that may be, with how much speaks for each.
    """
    others = [c for c in columns if c not in [column for _, column in rated] and _warm(c)]
    readings = np.array([column.values for column in others])
    best, most = [column for _, column in rated], -np.inf
    if len(rated) <= MOST_WIRES:
        return best
    heats = heat_of(times, np.array([held(column.values) for _, column in rated]))
    for pair in itertools.combinations(range(len(rated)), MOST_WIRES):
        agreement = sum(found for _, found in pairing(heats[list(pair)], readings))
        if (score := agreement + 0.2 * sum(rated[i][0] for i in pair)) > most:
            best, most = [rated[i][1] for i in pair], score
    return best


def _full(duties: list[Column], asked: list[str]) -> float:
    """The number that means full duty; 0 if the names, the units and the numbers do not tell."""
    values = np.abs(np.concatenate([duty.shown for duty in duties] or [np.zeros(1)]))
    most = float(values.max())
    if not most:
        return 1.0
    words = {word for duty in duties for word in duty.words}
    ranges = {m[1] for d in duties if (m := re.search(r"\b0 ?(?:-|\.\.|to) ?(\d+)\b", d.name))}
    full = next(full for full in FULLS if most <= full * 1.001)
    whole, in_fives = (values % 1 == 0).all(), (values % 5 == 0).all()
    if POWER in _quantities(duties):
        sure, likely = False, "the power of a wire that is heated all the time"
    elif len(ranges) == 1:
        full, likely = float(ranges.pop()), ""
        sure = most <= 1.001 * full
    elif words & {"%", "percent", "pct"}:
        full, likely = 100.0, "100 if it is per cent, as its name says, 1 if it is a share"
        sure = 1.0 < most <= 100.1
    elif full == 100.0 and not (whole and (most == 100.0 or (in_fives and "pwm" not in words))):
        counted = whole and not in_fives and ("pwm" in words or COUNTS in _quantities(duties))
        full, sure = 255.0 if counted else 100.0, counted or (not whole and most > VOLTS)
        likely = "100 if it is per cent, 255 if it is counts of 8 bits"
    else:
        sure, likely = True, ""
    if sure:
        return full
    names = " and ".join(dict.fromkeys(duty.name for duty in duties))
    asked.append(f"full: the most in {names} is {most:g}: what is full duty? {likely}".rstrip())
    return 0.0


def _quantities(columns: list[Column]) -> set[str]:
    return {quantity for column in columns for quantity in column.quantities}


def _said_of_full(duties: list[Column], full: float) -> str:
    most = max((float(np.abs(duty.shown).max()) for duty in duties), default=0.0)
    names = " and ".join(dict.fromkeys(duty.name for duty in duties))
    if most in (0.0, full) or "%" in {word for duty in duties for word in duty.words}:
        return f"full duty is {full:g} in {names}" if most else ""
    return f"the most in {names} is {most:g}: correct full if full duty is not {full:g}"


def _side(column: Column) -> str:
    words = set(column.words) | set(
        re.findall(r"[lr](?=$|\d|_)", column.name.lower().replace("ctrl", ""))
    )
    if words & {"l", "left", "links", "lt", "li", "rev"} or "left" in column.name.lower():
        return "left"
    if words & {"r", "right", "rechts", "rt", "re", "fwd"} or "right" in column.name.lower():
        return "right"
    return ""


def _temperatures(
    columns: list[Column], heats: np.ndarray, notes: dict[str, tuple[str, str]]
) -> list[Column]:
    """The columns of thermocouples: of their names, of a room's warmth at least, after heat."""
    found = []
    for column in columns:
        values = column.shown
        if column.contradicts(TEMPERATURE) or COUNTS in column.quantities:
            continue
        named = column.said(TEMPERATURE) or TEMPERATURE in column.quantities
        if _has(column.words, NOT_MEASURED) or not (np.ptp(values) or (named and values[0] > ROOM)):
            continue
        low = np.quantile(values, 0.02)
        follows = max((correlation(heat, column.values) for heat in heats), default=0.0)
        dips = low < values[: max(5, len(values) // 50)].mean() - 5.0
        if not _warm(column) or (column.said(BEND) and TEMPERATURE not in column.quantities):
            continue
        if named or (follows > FOLLOWED and low > 10.0 and not dips):
            found.append(column)
    for column in found:
        notes[column.name] = "not used", "a temperature, but no wire's heat shows whose"
    return found


def _warm(column: Column) -> bool:
    """Whether numbers can be of a thermocouple, in °C, °F or K."""
    low, high = np.quantile(column.shown, [0.02, 1.0])
    return bool(-10.0 < low < 320.0 and high < 620.0)


def _unit(column: Column) -> str:
    """The unit of a thermocouple: as its name says if it can be, or in which it was in a room."""
    low, high = np.quantile(column.shown, [0.02, 1.0])
    first = float(np.median(column.shown[: max(5, len(column.shown) // 100)]))
    words = set(column.words)
    kelvin = 250.0 < low < 400.0
    if words & {"k", "kelvin"} and TEMPERATURE in column.quantities:
        return "K" if kelvin else OPEN
    if words & {"f", "degf", "fahrenheit"}:
        return "F" if 30.0 < low < 250.0 else OPEN
    if words & {"c", "degc", "celsius"} and TEMPERATURE in column.quantities:
        return "C" if low < 120.0 else OPEN
    if kelvin:
        return "K"
    if low < WARM_ROOM:
        return "C"
    # A log in °C that starts warm and never cools looks as one in °F.
    return "F" if high > TOO_HOT or first < low + 5.0 else OPEN


def _bend(
    columns: list[Column],
    table: LogTable,
    times: np.ndarray,
    heats: np.ndarray,
    notes: dict[str, tuple[str, str]],
    asked: list[str],
) -> BendColumns:
    """The column of the bend, or the points of a picture."""
    pairs = points(
        [
            name
            for name, unit in zip(table.names, table.units, strict=True)
            if quantities_of(name, unit)[0] <= IN_PICTURES and not has(words_of(name), NOT_MEASURED)
        ]
    )
    taken = {name for pair in pairs for name in pair}
    rated: list[tuple[float, Column]] = []
    others: list[tuple[float, Column]] = []  # of another quantity
    with Progress("comparing with the heat", len(columns), "columns") as progress:
        for number, column in enumerate(columns):
            progress.update(number, column.name)
            named = column.said(BEND) or ANGLE in column.quantities
            if np.ptp(column.shown) == 0 or column.name in taken:
                continue
            if _has(column.words, NOT_MEASURED):
                continue
            follows = following(times, heats, column.values)
            score = 1.5 * named + follows - 0.5 * column.said(DUTY)
            scaled = column.quantities == {COUNTS} or (named and column.quantities <= SCALED)
            fits = not column.contradicts(BEND) or scaled
            (rated if fits else others).append((score, column))
    rated.sort(key=lambda pair: -pair[0])
    best = rated[0][1] if rated and rated[0][0] > 0.5 else None
    if best is None and len(rated) == 1 and not others and not heats.any() and not taken:
        best = rated[0][1]  # which nothing can follow
    if len(pairs) > 1 and not (best and best.said(BEND)):
        line = [pairs[0], pairs[-1]]
        notes |= dict.fromkeys(taken, ("a point of the limb", "x and y in a picture"))
        zero = base_direction(table, pairs)
        return BendColumns(line=[*line[0], *line[1]], zero=zero, measures=CHORD)
    if best is None:
        moving = [c for score, c in sorted(others, key=lambda pair: -pair[0]) if score > 0.5]
        hint = "; ".join(f"{c.name} is {c.other_quantity}" for c in moving[:3])
        asked.append(
            "bend: no column seems to be the bend, which is an angle: give its column, or points "
            "of a picture" + (f". {hint}: if it shows the bend, give its scale too" if hint else "")
        )
        return BendColumns(OPEN, scale=0.0 if hint else 1.0)
    for score, rival in rated[1:]:
        alike = abs(correlation(best.values, rival.values)) > SAME
        if score > max(0.5, rated[0][0] - CLEARLY) and not alike:
            asked.append(f"bend: {best.name} or {rival.name}? Both may be; give bend.column")
            return BendColumns(OPEN)
    return _bend_column(best, heats, notes)


def _bend_column(
    column: Column, heats: np.ndarray, notes: dict[str, tuple[str, str]]
) -> BendColumns:
    """How the bend is read from its column; with the scale 0 if that is not known."""
    words, values = set(column.words), column.shown
    measures = BEND_ANGLE
    if {"tip", "tangent", "alpha", "bendlabs"} & words:
        measures = TIP_TANGENT
    elif "chord" in words:
        measures = CHORD
    rest = float(np.median(values[:FIRST]))
    small = np.abs(values - np.median(values)).max() < RADIANS and len(heats) and heats.any()
    angle = ANGLE in column.quantities or bool(words & {"bend", "bending", "biegung"})
    scale, unit, zero = 1.0, "degrees", 0.0
    if "mdeg" in words:
        scale, unit = 1e-3, "thousandths of degrees"
    elif "mrad" in words:
        scale, unit = float(np.rad2deg(1e-3)), "thousandths of radians"
    elif column.contradicts(BEND) or COUNTS in column.quantities or np.ptp(values) > 360.0:
        scale = 0.0
    elif words & {"rad", "rads", "radians"}:
        scale, unit = float(np.rad2deg(1.0)), "radians"
        if np.ptp(values) > 2 * np.pi:
            scale = 0.0  # its numbers contradict its name
    elif small and not words & {"deg", "degree", "degrees", "°", "grad"}:
        scale, unit = float(np.rad2deg(1.0)), "radians"
        # Small numbers of a sensor may be volts or metres as well.
        if abs(rest) * scale > FARTHEST or (column.said(BEND) and not angle):
            scale = 0.0
    if not scale or abs(rest) * scale > FARTHEST:
        zero = rest  # of a limb that is taken to rest straight
    unit = unit if scale else "in an unknown unit"
    why = column.said_by if ANGLE in column.quantities else ""
    why = why or ("its name" if column.said(BEND) else "it follows the heat")
    notes[column.name] = f"the bend ({measures}), {unit}", why
    return BendColumns(column.name, zero=zero, scale=scale, measures=measures)
