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

from limb_systems.errors import raised_as
from limb_systems.logs.columns import (
    ANGLE,
    BEND,
    COUNTS,
    DUTY,
    NOT_MEASURED,
    POWER,
    TEMPERATURE,
    TIME,
    Column,
    has,
    quantities_of,
    words_of,
)
from limb_systems.logs.evidence import correlation, following, heat_of, held, pairing
from limb_systems.logs.formats import (
    LimbInLog,
    base_direction,
    known_format,
    points,
    sign_by_heat,
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
from limb_systems.progress import Progress

ASKS = "? "  # beginning of a note that asks for something
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


def limbs_in_log(path: str | Path, table: LogTable | None = None) -> list[LimbInLog]:
    """The limbs in a log, with mappings: of a known format, or as its columns suggest.

    Args:
        table: the log's rows; they are read if None.

    Raises:
        LogError: if it is no table of text with rows of numbers, or lacks columns of its format.
    """
    table = table or read_table(path)
    with raised_as(LogError, f"{path}: "):
        limbs = known_format(table)
    if limbs:
        return limbs
    limb = _Guess(table).limb()
    with contextlib.suppress(LogError):
        if is_reversed(stamps(table, limb.mapping.time)):
            return [_Guess(table.oldest_first()).limb()]
    return [limb]


class _Guess:
    """The limb in a log, by a mapping that seems likely.

    What is not found, or could be either of two, is `OPEN` in the mapping, or 0 for a number.

    - ``notes``: for each column what it is taken for, and why.
    - ``asked``: what the log does not tell.
    - ``columns``: those that may be signals, of the rows whose times (K,), s, increase.
    - ``duties``, ``signs``: the columns of duty, and the sign that heats.
    - ``heats``: heat of the wires (W, K), as `heat_of` gives it.
    """

    def __init__(self, table: LogTable):
        self.table, self.asked = table, list[str]()
        columns = [
            Column.of(name, unit, table.numbers(name))
            for name, unit in zip(table.names, table.units, strict=True)
        ]
        self.notes = {
            c.name: ("not used", c.other_quantity or "no signal fits it") for c in columns
        }
        self.time = self._time(columns)
        try:
            self.times, self.kept = times_of(table, self.time)
        except LogError:  # to see what follows what; the reading will tell
            self.times = 0.1 * np.arange(table.num_rows)
            self.kept = np.ones(table.num_rows, bool)
        columns = [c for c in columns if c.name != self.time.column and len(c.shown) > 5]
        self.missing = sorted({v for c in columns for v in MISSING if _stands_out(c, v)})
        columns = [dataclasses.replace(c, values=self._cleaned(c.values)) for c in columns]
        self.columns = [column for column in columns if len(column.shown) > 5]
        self.duties, self.signs = self._duties()
        self.full = self._full()
        self.heats = heat_of(self.times, self._shares())

    def limb(self) -> LimbInLog:
        """The limb, with what was found and what is asked."""
        duties, asked = self.duties, self.asked
        other_duty = self._other_duty()
        temperatures = self._temperatures()
        bend = self._bend([c for c in self.columns if c not in [*duties, *temperatures]])
        wires, agreement = self._wires(temperatures)
        mapping = LogMapping.of(
            self.table, self.time, wires, bend, full=self.full, missing=self.missing
        )
        said = []
        if not duties:
            asked.append("duty: no column seems to be a duty, which is 0 while wires are off")
        elif bend.scale and bend.column != OPEN:
            mapping, showed = turned(mapping, self.table, self.kept, self.heats)
            said.append(showed)
        if self.full:
            said.append(self._said_of_full())
        if bend.scale and bend.column not in ("", OPEN) and bend.measures == BEND_ANGLE:
            said.append(
                f"{bend.column} is taken for the bend angle φ: if it is the angle of the tip, α, "
                "correct measures to tip_tangent"
            )
        elif not bend.scale and bend.column != OPEN:
            (counts,) = (c for c in self.columns if c.name == bend.column)
            sign = sign_by_heat(wires, self.heats, counts.values)
            falls = ", as a negative number, for it falls where the right wire is heated"
            how = {1.0: "", -1.0: falls}.get(sign, ", and its sign")
            asked.append(
                f"bend.scale is 0: give the degrees of a unit of {bend.column}{how}; bend.zero is "
                "what it reads at the beginning"
            )
        if duties and not any(duty.side for duty in duties):
            said.append("names do not say which wire is on which side: correct them if need be")
        if other_duty:
            side = "left" if wires[0].name == "right" else "right"
            mapping.wires.append(WireColumns(side, OPEN))
            agreement.append(0.0)
            asked.append(
                f"duty: {other_duty.name} is {other_duty.other_quantity}, but 0 and still as a "
                f"duty is: give the duty of the {side} wire, or leave out that wire"
            )
        lines = [*self._lines(), *filter(None, said), *(f"{ASKS}{one}" for one in asked)]
        return LimbInLog("", mapping, lines, agreement)

    def _lines(self) -> list[str]:
        """A line for each column: its name, what it is taken for, and why."""
        notes = self.notes
        widths = [
            min(40, max(map(len, texts))) for texts in (notes, (n[0] for n in notes.values()))
        ]
        return [
            f"{name:<{widths[0]}}  {what:<{widths[1]}}  {why}".rstrip()
            for name, (what, why) in notes.items()
        ]

    def _cleaned(self, values: np.ndarray) -> np.ndarray:
        """The numbers of rows that are kept, nan where they are no reading or are absurd."""
        values = values if self.kept.all() else values[self.kept]
        left_out = (np.abs(values) > ABSURD) | np.isin(values, self.missing)
        return np.where(left_out, np.nan, values) if left_out.any() else values

    def _shares(self) -> np.ndarray:
        """Duty of each wire (W, K), in [0, 1]."""
        full = self.full or self._most_duty
        signed = zip(self.signs, self.duties, strict=True)
        shares = [np.clip(sign * held(duty.values) / full, 0.0, 1.0) for sign, duty in signed]
        return np.array(shares).reshape(-1, len(self.times))

    def _wires(self, temperatures: list[Column]) -> tuple[list[WireColumns], list[float]]:
        """The wires with their thermocouples, and how well these follow their wires' heat."""
        duties, notes = self.duties, self.notes
        if not duties:
            return [WireColumns(name, OPEN) for name in ("left", "right")], [0.0, 0.0]
        sides = ["left", "right"]
        if len(duties) < 2:
            sides = [duty.side or "right" for duty in duties]
        pairs = pairing(self.heats, np.array([column.values for column in temperatures]))
        left = [i for i in range(len(temperatures)) if i not in [reading for reading, _ in pairs]]
        wires = []
        for name, duty, sign, (reading, agreement) in zip(
            sides, duties, self.signs, pairs, strict=True
        ):
            why = "it is 0 and still as a duty is, and others follow it"
            notes[duty.name] = f"duty of the {name} wire", "its name" if duty.named(DUTY) else why
            if len(set(duties)) < len(duties):
                why = "its sign: negative numbers heat the left wire"
                notes[duty.name] = "duty of both wires", why
            if reading is None and left:  # no heat shows it
                same = [i for i in left if temperatures[i].side == name]
                if same or len(left) == len(temperatures) - 1 or len(left) == len(duties):
                    reading = same[0] if same else left[0]
                    left.remove(reading)
            wires.append(WireColumns(name, duty.name, sign))
            if reading is not None:
                sensor, unit = temperatures[reading], _unit(temperatures[reading])
                wires[-1].temperature, wires[-1].unit = sensor.name, unit
                why = f"it follows that wire's heat (r = {agreement:.2f})"
                why = why if agreement else "its name"
                notes[sensor.name] = f"temperature of the {name} wire, {DEGREES[unit]}", why
                if unit == OPEN:
                    low, high = sensor.low_and_high
                    self.asked.append(
                        f"unit of {sensor.name}: C, F or K? It reads {low:.3g} to {high:.3g}, "
                        "which does not tell, or contradicts its name"
                    )
        return wires, [agreement for _, agreement in pairs]

    def _time(self, columns: list[Column]) -> TimeColumn:
        """The column that increases, in a unit in which its rate and its length are of logs."""
        best: tuple[float, TimeColumn] | None = None
        standing = ""
        for column in columns:
            if column.contradicts(TIME):
                continue
            values, unit = column.values, ""
            if np.isnan(values).mean() > 0.5:
                values, unit = self.table.moments(column.name), "date"
            shown = values[~np.isnan(values)]
            if len(shown) < 0.5 * len(values) or len(shown) < 5:
                continue
            steps, said = np.diff(shown), column.said(TIME)
            steps = -steps if (steps < 0).sum() > 0.9 * len(steps) else steps  # newest row first
            if (steps > 0).sum() < 5 or (steps < 0).sum() > 0.002 * len(steps) + 1:
                standing = column.name if said and len(column.words) == 1 else standing
                continue
            if (steps == 1).all() and not said:
                continue  # an index
            unit = unit or _unit_of_time(column, shown)
            if not unit:
                continue
            scale, wraps = SECONDS.get(unit, 1.0), 0.0
            for period in PERIODS if (steps < 0).any() else ():
                if np.abs(steps.min() * scale + period) < 0.01 * period:
                    wraps = period
            # A column of time says so, has a value of its own in most rows, and is no index.
            score = 2.0 * said + (steps > 0).mean() - 1.5 * bool((steps == 1).all())
            score -= 2.0 * (column.said(TEMPERATURE) and not said) + (unit == OPEN)
            if best is None or score > best[0]:
                best = score, TimeColumn(column.name, unit, wraps)
        if standing and (best is None or best[0] < 2.0):
            return TimeColumn(standing)  # which reading refuses
        if best is None:
            self.asked.append(
                "time: no column is a time that increases, by its name, unit and numbers"
            )
            return TimeColumn(OPEN)
        time = best[1]
        self.notes[time.column] = f"time, {time.unit}", "it increases as a clock does"
        if time.unit == OPEN:
            self.asked.append(
                f"unit of {time.column}: its rows are too far apart, or too near, for its name"
            )
        return time

    def _duties(self) -> tuple[list[Column], list[float]]:
        """The columns of duty, and the sign that heats; a signed one counts for both wires."""
        rated = []
        for column in self.columns:
            if column.contradicts(DUTY) and column.quantities != {POWER}:
                continue
            if not column.is_measured or np.abs(column.shown).max() > FULLS[-1]:
                continue
            named = column.named(DUTY)
            if not named and (column.off < 0.05 or column.still < 0.5 or column.span == 0):
                continue
            score = 2.0 * named + column.off + column.still
            score -= column.said(TEMPERATURE) or column.said(BEND)
            if score > 0.8:
                rated.append((score, column))
        named_ones = [pair for pair in rated if pair[0] > 2.0 and pair[1].span > 0]
        # Without a name that says so, something has to follow its heat.
        rated = (named_ones and [pair for pair in rated if pair[0] > 2.0]) or [
            (score, c) for score, c in rated if score > 2.0 or self._is_followed(c, self.columns)
        ]
        heated = [pair for pair in rated if pair[1].span > 0] or rated
        if not heated:
            return [], []
        signed = [column for _, column in heated if column.shown.min() < 0 < column.shown.max()]
        if signed and len(signed) == len(heated):
            return [signed[0], signed[0]], [-1.0, 1.0]
        unsigned = [pair for pair in rated if pair[1].shown.min() >= 0]
        chosen = self._best_pair(unsigned)
        for _, column in unsigned:
            if column not in chosen:
                self.notes[column.name] = (
                    "not used",
                    "it may be a duty, but less follows its heat",
                )
        if [column.side for column in chosen] == ["right", "left"]:
            chosen.reverse()
        return chosen, [1.0] * len(chosen)

    def _other_duty(self) -> Column | None:
        """A column that would be another wire's duty, were it not of another quantity."""
        if len(self.duties) != 1:
            return None
        (duty,) = self.duties
        others = [column for column in self.columns if column != duty]
        for column in self.columns:
            if (
                column.contradicts(DUTY)
                and column.is_measured
                and min(column.off, column.span) > 0.05
                and column.still > 0.5
                and abs(correlation(column.values, duty.values)) < SAME
                and self._is_followed(column, others)
            ):
                return column
        return None

    def _is_followed(self, duty: Column, columns: list[Column]) -> bool:
        """Whether a column follows the heat of what may be a duty."""
        heat = heat_of(self.times, held(duty.values))
        return any(
            abs(correlation(heat, column.values)) > FOLLOWED for column in columns if column != duty
        )

    def _best_pair(self, rated: list[tuple[float, Column]]) -> list[Column]:
        """The columns of duty among those that may be: a pair that warms as many thermocouples.

        Args:
            rated: those that may be, with how much speaks for each.
        """
        best, most = [column for _, column in rated], -np.inf
        if len(rated) <= MOST_WIRES:
            return best
        others = [column for column in self.columns if column not in best and column.is_warm]
        readings = np.array([column.values for column in others])
        heats = heat_of(self.times, np.array([held(column.values) for column in best]))
        for pair in itertools.combinations(range(len(rated)), MOST_WIRES):
            agreement = sum(found for _, found in pairing(heats[list(pair)], readings))
            if (score := agreement + 0.2 * sum(rated[i][0] for i in pair)) > most:
                best, most = [rated[i][1] for i in pair], score
        return best

    def _full(self) -> float:
        """The number of full duty; 0 if the names, the units and the numbers do not tell."""
        if not (most := self._most_duty):
            return 1.0
        values = np.abs(np.concatenate([duty.shown for duty in self.duties]))
        words = {word for duty in self.duties for word in duty.words}
        quantities = {quantity for duty in self.duties for quantity in duty.quantities}
        written = (re.search(r"\b0 ?(?:-|\.\.|to) ?(\d+)\b", duty.name) for duty in self.duties)
        ranges = {found[1] for found in written if found}
        full = next(full for full in FULLS if most <= full * 1.001)
        whole, in_fives = (values % 1 == 0).all(), (values % 5 == 0).all()
        sure, likely = True, ""
        if POWER in quantities:
            sure, likely = False, " the power of a wire that is heated all the time"
        elif len(ranges) == 1:
            full = float(ranges.pop())
            sure = most <= 1.001 * full
        elif words & {"%", "percent", "pct"}:
            full, likely = 100.0, " 100 if it is per cent, as its name says, 1 if it is a share"
            sure = 1.0 < most <= 100.1
        elif full == 100.0 and not (whole and (most == 100.0 or (in_fives and "pwm" not in words))):
            counted = whole and not in_fives and ("pwm" in words or COUNTS in quantities)
            full, sure = 255.0 if counted else 100.0, counted or (not whole and most > VOLTS)
            likely = " 100 if it is per cent, 255 if it is counts of 8 bits"
        if sure:
            return full
        self.asked.append(
            f"full: the most in {self._names_of_duties()} is {most:g}: what is full duty?{likely}"
        )
        return 0.0

    @property
    def _most_duty(self) -> float:
        """The largest number of duty, whatever its sign; 0 if there is none."""
        return max((float(np.abs(duty.shown).max()) for duty in self.duties), default=0.0)

    def _names_of_duties(self) -> str:
        return " and ".join(dict.fromkeys(duty.name for duty in self.duties))

    def _said_of_full(self) -> str:
        most, names = self._most_duty, self._names_of_duties()
        if most in (0.0, self.full) or "%" in {w for duty in self.duties for w in duty.words}:
            return f"full duty is {self.full:g} in {names}" if most else ""
        return f"the most in {names} is {most:g}: correct full if full duty is not {self.full:g}"

    def _temperatures(self) -> list[Column]:
        """The columns of thermocouples: of their names, of a room's warmth at least, after heat."""
        found = []
        for column in self.columns:
            if column in self.duties or column.contradicts(TEMPERATURE):
                continue
            if COUNTS in column.quantities or not (column.is_measured and column.is_warm):
                continue
            values, named = column.shown, column.named(TEMPERATURE)
            if not (column.span or (named and values[0] > ROOM)):
                continue
            if column.said(BEND) and TEMPERATURE not in column.quantities:
                continue
            low, _ = column.low_and_high
            dips = low < values[: max(5, len(values) // 50)].mean() - 5.0
            follows = max((correlation(heat, column.values) for heat in self.heats), default=0.0)
            if named or (follows > FOLLOWED and low > 10.0 and not dips):
                found.append(column)
                why = "a temperature, but no wire's heat shows whose"
                self.notes[column.name] = "not used", why
        return found

    def _bend(self, columns: list[Column]) -> BendColumns:
        """The column of the bend among some, or the points of a picture."""
        named = zip(self.table.names, self.table.units, strict=True)
        pairs = points(
            [
                name
                for name, unit in named
                if quantities_of(name, unit)[0] <= IN_PICTURES
                and not has(words_of(name), NOT_MEASURED)
            ]
        )
        taken = {name for pair in pairs for name in pair}
        rated: list[tuple[float, Column]] = []
        others: list[tuple[float, Column]] = []  # of another quantity
        with Progress("comparing with the heat", len(columns), "columns") as progress:
            for number, column in enumerate(columns):
                progress.update(number, column.name)
                if column.span == 0 or column.name in taken or not column.is_measured:
                    continue
                follows = following(self.times, self.heats, column.values)
                score = 1.5 * column.named(BEND) + follows - 0.5 * column.said(DUTY)
                scaled = column.named(BEND) and column.quantities <= SCALED
                scaled |= column.quantities == {COUNTS}
                fits = not column.contradicts(BEND) or scaled
                (rated if fits else others).append((score, column))
        rated.sort(key=lambda pair: -pair[0])
        best = rated[0][1] if rated and rated[0][0] > 0.5 else None
        if best is None and len(rated) == 1 and not (others or self.heats.any() or taken):
            best = rated[0][1]  # which nothing can follow
        if len(pairs) > 1 and not (best and best.said(BEND)):
            self.notes |= dict.fromkeys(taken, ("a point of the limb", "x and y in a picture"))
            zero = base_direction(self.table, pairs)
            return BendColumns(line=[*pairs[0], *pairs[-1]], zero=zero, measures=CHORD)
        if best is None:
            moving = [c for score, c in sorted(others, key=lambda pair: -pair[0]) if score > 0.5]
            hint = "; ".join(f"{c.name} is {c.other_quantity}" for c in moving[:3])
            self.asked.append(
                "bend: no column seems to be the bend, which is an angle: give its column, or "
                "points of a picture"
                + (f". {hint}: if it shows the bend, give its scale too" if hint else "")
            )
            return BendColumns(OPEN, scale=0.0 if hint else 1.0)
        for score, rival in rated[1:]:
            alike = abs(correlation(best.values, rival.values)) > SAME
            if score > max(0.5, rated[0][0] - CLEARLY) and not alike:
                self.asked.append(
                    f"bend: {best.name} or {rival.name}? Both may be; give bend.column"
                )
                return BendColumns(OPEN)
        return self._bend_column(best)

    def _bend_column(self, column: Column) -> BendColumns:
        """How the bend is read from its column; with the scale 0 if that is not known."""
        words, values = set(column.words), column.shown
        measures = BEND_ANGLE
        if {"tip", "tangent", "alpha", "bendlabs"} & words:
            measures = TIP_TANGENT
        elif "chord" in words:
            measures = CHORD
        rest = float(np.median(values[:FIRST]))
        small = np.abs(values - np.median(values)).max() < RADIANS and self.heats.any()
        angle = ANGLE in column.quantities or bool(words & {"bend", "bending", "biegung"})
        scale, unit, zero = 1.0, "degrees", 0.0
        if "mdeg" in words:
            scale, unit = 1e-3, "thousandths of degrees"
        elif "mrad" in words:
            scale, unit = float(np.rad2deg(1e-3)), "thousandths of radians"
        elif column.contradicts(BEND) or COUNTS in column.quantities or column.span > 360.0:
            scale = 0.0
        elif words & {"rad", "rads", "radians"}:
            scale, unit = float(np.rad2deg(1.0)), "radians"
            if column.span > 2 * np.pi:
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
        self.notes[column.name] = f"the bend ({measures}), {unit}", why
        return BendColumns(column.name, zero=zero, scale=scale, measures=measures)


def _stands_out(column: Column, value: float) -> bool:
    """Whether a number is in a column, far from all others there."""
    if value not in column.values:
        return False
    others = column.shown[~np.isin(column.shown, MISSING)]
    if not len(others):
        return False
    low, high = np.quantile(others, [0.01, 0.99])
    return not low - 2 * (high - low) - 1 < value < high + 2 * (high - low) + 1


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
    units = ("s", "ms", "us", "ns", "min", "d")
    # Of 0.4 to 200 Hz, so that ms are not taken for s.
    likely = [unit for unit in units if 0.4 < 1 / (usual * SECONDS[unit]) < 201]
    return next(filter(can_be, likely), "")


def _unit(column: Column) -> str:
    """The unit of a thermocouple: as its name says if it can be, or in which it was in a room."""
    low, high = column.low_and_high
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
