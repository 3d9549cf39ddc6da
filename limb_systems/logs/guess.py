"""What the columns of any other log may be: by names, ranges and what follows the heat."""

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
from limb_systems.logs.reading import DAY, is_reversed, stamps, times_of
from limb_systems.logs.table import LogError, LogTable, read_table

TIME, DUTY, TEMPERATURE, BEND = "time", "duty", "temperature", "bend"
WORDS = {  # in names of columns, whole or as their parts
    TIME: "time timestamp zeit uhrzeit datetime date ms millis msec sec seconds s elapsed us "
    "micros",
    DUTY: "pwm duty heat heater heating power pow u cmd command out output ctrl gate mosfet sma "
    "input duties heiz",
    TEMPERATURE: "temp temperature tc thermo thermocouple max31855 mcp celsius kelvin fahrenheit "
    "degc degf temperatur t tmp",
    BEND: "bend bending angle flex phi theta winkel biegung curvature alpha tip tangent tilt chord "
    "deflection deg degrees rad biege pose",
}
NOT_MEASURED = (
    "setpoint target ref reference desired limit max min goal error unconstrained soll cjc"
)
UNITS = {"C": "°C", "F": "°F", "K": "K"}
FULLS = (1.0, 100.0, 255.0, 1023.0, 4095.0, 65535.0)
PERIODS = (DAY, 2**32 / 1e6, 2**16 / 1e3)  # s, after which clocks begin anew
RATES, DURATIONS = (0.15, 1500.0), (5.0, 2e5)  # Hz and s, of logs
MOST_WIRES = 2
ROOM = 5.0  # °C, below which a reading that never moves is of nothing
FIRST = 10  # rows, in which a limb rests
MISSING = (-9999.0, -999.0, -127.0, 999.0, 9999.0)  # what loggers write for no reading
NO_ANGLES = {"adc", "counts", "count", "v", "volt", "volts", "mv", "mm", "px", "ohm", "ohms", "m"}
FARTHEST = 60.0  # °, to which no limb is bent at rest
RADIANS = 2.2  # that no bend in degrees stays within, while wires are heated


@dataclasses.dataclass(frozen=True, eq=False)
class Column:
    """A column of a log: its name, its words, its numbers (K,)."""

    name: str
    words: list[str]
    values: np.ndarray

    def said(self, role: str) -> bool:
        """Whether the name has a word of a role; a "t" with a number is no time."""
        if role == TIME and self.name.lower() == "t":
            return True
        return _has(self.words, WORDS[role])

    @property
    def shown(self) -> np.ndarray:
        """Its numbers without those that are missing."""
        return self.values[~np.isnan(self.values)]


def _has(words: list[str], known: str) -> bool:
    return any(
        word == one or (len(one) > 3 and one in word) for word in words for one in known.split()
    )


def words_of(name: str) -> list[str]:
    """The parts of a name in small letters, without digits: "pwmLeft_2 (%)" has pwm, left and %."""
    parts = re.findall(r"[A-ZÄÖÜ]?[a-zäöü]+|[A-ZÄÖÜ]+(?![a-zäöü])|[°%]|max31855", name)
    return [part.lower() for part in parts]


def limbs_in_log(path: str | Path) -> list[LimbInLog]:
    """The limbs in a log, with mappings: of a known format, or as its columns suggest.

    Raises:
        LogError: if it is no table of text with rows of numbers, or lacks columns of its format.
    """
    table = read_table(path)
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

    Columns that are not found are `OPEN` in the mapping.
    """
    columns = [
        Column(name, words_of(f"{name} {unit}"), table.numbers(name))
        for name, unit in zip(table.names, table.units, strict=True)
    ]
    notes: dict[str, str] = {}
    time = _time(table, columns, notes)
    times, kept = _times(table, time)
    columns = [column for column in columns if column.name != time.column]
    missing = sorted({v for c in columns for v in MISSING if _stands_out(c, v)})
    columns = [
        Column(c.name, c.words, np.where(np.isin(c.values, missing), np.nan, c.values)[kept])
        for c in columns
    ]
    columns = [column for column in columns if len(column.shown) > 5]
    duties, signs = _duties(columns, times, notes)
    full = _full(duties)
    heats = heat_of(times, _shares(duties, signs, full, len(times)))
    rest = [column for column in columns if column not in duties]
    temperatures = _temperatures(rest, heats, notes)
    bend = _bend(table, [c for c in rest if c not in temperatures], times, heats, notes)
    wires, agreement = _wires(duties, signs, temperatures, heats, notes)
    mapping = LogMapping(
        time, wires, bend, full, missing=missing, delimiter=table.delimiter, decimal=table.decimal,
        names_line=table.names_line,
    )  # fmt: skip
    questions = [_question(duties, full)]
    if not duties:
        questions.append("no column seems to be a duty, which is 0 while wires are off")
    elif bend.scale and bend.column != OPEN:
        mapping, showed = turned(mapping, table, kept, heats)
        questions.append(showed)
    questions.append(_question_on_bend(mapping, columns, heats))
    if len(duties) > 1 and not any(_side(duty) for duty in duties):
        questions.append("names do not say which wire is on which side: exchange them if need be")
    said = [f"{name}: {notes.get(name, 'not used')}" for name in table.names]
    return LimbInLog("", mapping, [*said, *filter(None, questions)], agreement)


def _shares(duties: list[Column], signs: list[float], full: float, count: int) -> np.ndarray:
    """Duty of each wire (W, K), in [0, 1]."""
    shares = np.zeros((len(duties), count))
    for share, duty, sign in zip(shares, duties, signs, strict=True):
        share[:] = np.clip(sign * held(duty.values) / full, 0.0, 1.0)
    return shares


def _wires(
    duties: list[Column],
    signs: list[float],
    temperatures: list[Column],
    heats: np.ndarray,
    notes: dict[str, str],
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
        notes[duty.name] = f"duty of the {name} wire"
        if reading is None and left:  # no heat shows it
            same = [i for i in left if _side(temperatures[i]) == name]
            if same or len(left) == len(temperatures) - 1 or len(left) == len(duties):
                reading = same[0] if same else left[0]
                left.remove(reading)
        wires.append(WireColumns(name, duty.name, sign))
        if reading is not None:
            sensor, unit = temperatures[reading], _unit(temperatures[reading])
            wires[-1].temperature, wires[-1].unit = sensor.name, unit
            why = f"follows its heat by {agreement:.2f}" if agreement else "no heat shows it"
            notes[sensor.name] = f"temperature of the {name} wire, {UNITS[unit]}: {why}"
    return wires, [agreement for _, agreement in pairs]


def _question_on_bend(mapping: LogMapping, columns: list[Column], heats: np.ndarray) -> str:
    """What has to be known of the bend, and the log does not say."""
    bend = mapping.bend
    if bend.column == OPEN:
        return "no column seems to be a bend: give an angle, or points of a picture"
    if bend.measures == BEND_ANGLE and bend.scale:
        return (
            f"{bend.column} is taken for the bend angle φ: if it is the angle of the tip, α, "
            "correct measures to tip_tangent"
        )
    if bend.scale:
        return ""
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
    return 0.1 * np.arange(len(table.cells)), np.ones(len(table.cells), bool)


def _stands_out(column: Column, value: float) -> bool:
    """Whether a number is in a column, far from all others there."""
    others = column.shown[~np.isin(column.shown, MISSING)]
    if value not in column.shown or not len(others):
        return False
    low, high = np.quantile(others, [0.01, 0.99])
    return not low - 2 * (high - low) - 1 < value < high + 2 * (high - low) + 1


def _time(table: LogTable, columns: list[Column], notes: dict[str, str]) -> TimeColumn:
    """The column that increases, in a unit in which its rate and its length are those of logs."""
    best: tuple[float, TimeColumn] | None = None
    standing = ""
    for column in columns:
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
        unit = unit or _unit_of_time(column, shown)
        if not unit:
            continue
        scale, wraps = SECONDS[unit], 0.0
        for period in PERIODS if (steps < 0).any() else ():
            if np.abs(steps.min() * scale + period) < 0.01 * period:
                wraps = period
        # A column of time says so, has a value of its own in most rows, and is no index.
        score = 2.0 * column.said(TIME) + (steps > 0).mean() - 1.5 * bool((steps == 1).all())
        score -= 2.0 * (column.said(TEMPERATURE) and not column.said(TIME))
        if best is None or score > best[0]:
            best = score, TimeColumn(column.name, unit, wraps)
    if standing and (best is None or best[0] < 2.0):
        return TimeColumn(standing)  # which reading refuses
    if best is None:
        return TimeColumn(OPEN)
    notes[best[1].column] = f"time, in {best[1].unit}"
    return best[1]


def _unit_of_time(column: Column, shown: np.ndarray) -> str:
    """The unit that the name says if it can be, else the first in which rate and length can be."""
    names = {"ms": "ms millis msec milliseconds millisec", "us": "us micros µs microseconds usec",
             "ns": "ns nanos nanoseconds nsec", "s": "s sec seconds secs sekunden",
             "min": "min minutes minuten", "d": "d days", "h": "h hours"}  # fmt: skip
    steps = np.diff(shown)
    usual, length = float(np.median(np.abs(steps[steps != 0]))), float(np.ptp(shown))

    def can_be(unit: str) -> bool:
        seconds = SECONDS[unit]
        rate = 1 / (usual * seconds)
        return RATES[0] < rate < RATES[1] and DURATIONS[0] < length * seconds < DURATIONS[1]

    said = [unit for unit, words in names.items() if set(column.words) & set(words.split())]
    likely = [
        unit for unit in ("s", "ms", "us", "ns", "min", "d") if can_be(unit) and _usual(usual, unit)
    ]
    return next(iter([u for u in said if can_be(u)] + likely), said[0] if said else "")


def _usual(step: float, unit: str) -> bool:
    """Whether a step is of 0.4 to 200 Hz, so that ms are not taken for s."""
    return 0.4 < 1 / (step * SECONDS[unit]) < 201


def _duties(
    columns: list[Column], times: np.ndarray, notes: dict[str, str]
) -> tuple[list[Column], list[float]]:
    """The columns of duty, and the sign that heats; a signed one counts for both wires."""
    rated = []
    for column in columns:
        values = column.shown
        held = np.mean(np.diff(values) == 0)
        off = np.mean(values == 0)
        if not column.said(DUTY) and (off < 0.05 or held < 0.5 or np.ptp(values) == 0):
            continue
        if _has(column.words, NOT_MEASURED) or np.abs(values).max() > FULLS[-1]:
            continue
        score = (
            2.0 * column.said(DUTY) + off + held - (column.said(TEMPERATURE) or column.said(BEND))
        )
        if score > 0.8:
            rated.append((score, column))
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
            notes[column.name] = "perhaps a duty; not used"
    sides = [_side(column) for column in chosen]
    if sides == ["right", "left"]:
        chosen.reverse()
    return chosen, [1.0] * len(chosen)


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


def _full(duties: list[Column]) -> float:
    """The number that means full duty: the least that is possible for all, unless it is a count."""
    if not duties:
        return 1.0
    values = np.abs(np.concatenate([duty.shown for duty in duties]))
    words = {word for duty in duties for word in duty.words}
    full = next(full for full in FULLS if values.max() <= full * 1.001)
    if full <= 100.0 and words & {"%", "percent", "pct"}:
        return 100.0
    counted = "pwm" in words or (values % 5 != 0).any()  # per cent are mostly set in fives
    if full == 100.0 and counted and (values % 1 == 0).all():
        return 255.0
    return full


def _question(duties: list[Column], full: float) -> str:
    most = max((float(np.abs(duty.shown).max()) for duty in duties), default=0.0)
    names = " and ".join(dict.fromkeys(duty.name for duty in duties))
    if most in (0.0, full):
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


def _temperatures(columns: list[Column], heats: np.ndarray, notes: dict[str, str]) -> list[Column]:
    """The columns of thermocouples: of their names, of a room's warmth at least, after heat."""
    found = []
    for column in columns:
        values = column.shown
        if _has(column.words, NOT_MEASURED) or not (
            np.ptp(values) or (column.said(TEMPERATURE) and values[0] > ROOM)
        ):
            continue
        low = np.quantile(values, 0.02)
        follows = max((correlation(heat, column.values) for heat in heats), default=0.0)
        dips = np.quantile(values, 0.02) < values[: max(5, len(values) // 50)].mean() - 5.0
        if not _warm(column) or (
            column.said(BEND) and not _has(column.words, "temp temperature tc thermo")
        ):
            continue
        if column.said(TEMPERATURE) or (follows > 0.5 and low > 10.0 and not dips):
            found.append(column)
    for column in found:
        notes[column.name] = "a temperature; not used"
    return found


def _warm(column: Column) -> bool:
    """Whether numbers can be of a thermocouple, in °C, °F or K."""
    low, high = np.quantile(column.shown, [0.02, 1.0])
    return bool(-10.0 < low < 320.0 and high < 620.0)


def _unit(column: Column) -> str:
    first = float(np.median(column.shown[: max(5, len(column.shown) // 100)]))
    first = min(first, float(np.quantile(column.shown, 0.1)))
    if first > 200.0:
        return "K"
    return "F" if first > 50.0 or set(column.words) & {"f", "degf", "fahrenheit"} else "C"


def _bend(
    table: LogTable,
    columns: list[Column],
    times: np.ndarray,
    heats: np.ndarray,
    notes: dict[str, str],
) -> BendColumns:
    """The column of the bend, or the points of a picture."""
    best: tuple[float, Column] | None = None
    left: list[Column] = []
    pairs = points(table.names)
    taken = {name for pair in pairs for name in pair}
    for column in columns:
        values = column.shown
        if np.ptp(values) == 0 or (column.name in taken and not column.said(BEND)):
            continue
        if _has(column.words, NOT_MEASURED):
            continue
        follows = following(times, heats, column.values)
        score = 1.5 * column.said(BEND) + follows - 0.5 * column.said(DUTY)
        left.append(column)
        if score > 0.5 and (best is None or score > best[0]):
            best = score, column
    if best is None and len(left) == 1 and not taken:
        best = 0.0, left[0]
    if best is None or (len(pairs) > 1 and not best[1].said(BEND)):
        if len(pairs) < 2:
            return BendColumns(OPEN)
        line = [pairs[0], pairs[-1]]
        notes |= dict.fromkeys(taken, "a point of the limb, in a picture")
        zero = base_direction(table, pairs)
        return BendColumns(line=[*line[0], *line[1]], zero=zero, measures=CHORD)
    column = best[1]
    measures = BEND_ANGLE
    if {"tip", "tangent", "alpha", "bendlabs"} & set(column.words):
        measures = TIP_TANGENT
    elif "chord" in column.words:
        measures = CHORD
    words, values = set(column.words), column.shown
    rest = float(np.median(values[:FIRST]))
    whole = np.mean(values == np.round(values)) > 0.99
    small = np.abs(values - np.median(values)).max() < RADIANS and len(heats) and heats.any()
    scale, unit, zero = 1.0, "degrees", 0.0
    if "mdeg" in words:
        scale, unit = 1e-3, "thousandths of degrees"
    elif words & NO_ANGLES or np.ptp(values) > 360.0 or (whole and "raw" in words):
        scale, unit = 0.0, "something whose scale the log does not have"
    elif "rad" in words or (small and not words & {"deg", "°"}):
        scale, unit = float(np.rad2deg(1.0)), "radians"
        if abs(rest) * scale > FARTHEST and "rad" not in words:
            scale, unit = 0.0, "something whose scale the log does not have"
    if not scale or abs(rest) * scale > FARTHEST:
        zero = rest  # of a limb that is taken to rest straight
    notes[column.name] = f"the bend ({measures}), in {unit}"
    return BendColumns(column.name, zero=zero, scale=scale, measures=measures)
