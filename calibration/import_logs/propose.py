"""Propose what the columns of a log are, by their names; what names do not tell is asked for.

Names say what a column is. Numbers may confirm it, or make a question: they never override a
name. Where names say nothing, numbers decide only with a margin.
"""

import contextlib
import dataclasses
import functools
import re

import numpy as np

from calibration.import_logs.clock import DAY, is_reversed, stamps, times_of
from calibration.import_logs.evidence import (
    HEATED,
    MARGIN,
    Responses,
    Steps,
    correlation,
    forward_fill,
)
from calibration.import_logs.mapping import (
    BEND_ANGLE,
    CELSIUS,
    CHORD,
    DATE,
    FRAMES,
    OPEN,
    SECONDS,
    TIP_TANGENT,
    BendColumns,
    LogMapping,
    TimeColumn,
    WireColumns,
)
from calibration.import_logs.signals import bends_of
from calibration.import_logs.table import LogError, LogTable
from calibration.import_logs.words import (
    BEND,
    DUTY,
    FRAME,
    LEFT,
    RIGHT,
    TEMPERATURE,
    TIME,
    Dictionary,
    Name,
)
from limb_systems.model.parameters import LimbParameters

FULLS = (1.0, 100.0, 255.0, 1023.0, 4095.0, 65535.0)
PERIODS = (DAY, 2**32 / 1e6, 2**16 / 1e3)  # s, after which clocks begin anew
RATES = (0.15, 1500.0)  # Hz, of logs
LIKELY_RATES = (0.4, 201.0)  # Hz, by which units without a name are told apart
DURATIONS = (5.0, 2e5)  # s
ABSURD = 1e9  # that no number but a time's is beyond
MISSING = (-9999.0, -999.0, -127.0, 999.0, 9999.0)  # what loggers write for no reading
POWERS = {"power", "pow", "leistung", "heizleistung"}  # in W, or shares
SHARES = {"duty", "duties", "tastgrad"}
VOLTS = 24.0  # below which numbers that are no counts may be volts or watts
ROOMS = {"C": (2.0, 42.0), "F": (35.0, 110.0), "K": (275.0, 315.0)}  # of limbs that rest
COLDEST = {"C": (-10.0, 80.0), "F": (15.0, 180.0), "K": (260.0, 360.0)}  # of a log that starts warm
HOTTEST = {"C": 200.0, "F": 400.0, "K": 480.0}
COLD = 35.0  # below which a warm limb is in °C
SAME = 0.97  # correlation of two columns that show the same
FARTHEST = 60.0  # °, to which no limb is bent at rest
RADIANS = 2.2  # that no bend in degrees stays within, while wires are hot
HOT = 20.0  # °C of warming, with which a limb bends by more than that in degrees
STILL = 0.02  # movement of a point that is fixed, in shares of the tip's
FIXED_WORDS = {"clamp", "mount", "frame", "ground", "fix", "fixed", "origin", "klemme", "wall"}
FRACTIONS = {"nanosec": "ns", "nsec": "ns", "nsecs": "ns", "nanosecs": "ns", "usec": "us"}
UNIT_WORDS = {
    "ms": "ms millis msec milliseconds millisec", "us": "us micros µs microseconds usec",
    "ns": "ns nanos nanoseconds nsec nanosec", "s": "s sec seconds secs sekunden",
    "min": "min minutes minuten", "h": "h hours stunden", "d": "d days tage",
}  # fmt: skip


@dataclasses.dataclass
class Question:
    """What a log does not tell.

    - ``field``: field of the mapping that has the answer, such as "wires[0].duty".
    - ``text``: the question, which names the columns.
    - ``choices``: answers that seem possible.
    - ``is_contradiction``: whether names and numbers contradict each other, which no other log
      of the same columns settles.
    """

    field: str
    text: str
    choices: list[str] = dataclasses.field(default_factory=list)
    is_contradiction: bool = False

    @property
    def lines(self) -> list[str]:
        """The question, and a line of the mapping for each answer, ready to be edited."""
        return [f"? {self.text}", *(f"    {self.field}: {choice}" for choice in self.choices)]


@dataclasses.dataclass
class Proposal:
    """What the columns of a log are, for one limb.

    - ``name``: the limb's name, if several share the log; else empty.
    - ``mapping``: mapping of the log's columns.
    - ``notes``: what each column is taken for, and why, in lines.
    - ``questions``: what is asked.
    - ``is_heated``: whether wires are heated, so that numbers confirm the names.
    - ``columns``: names of all columns of the log.
    """

    name: str
    mapping: LogMapping
    notes: list[str]
    questions: list[Question] = dataclasses.field(default_factory=list)
    is_heated: bool = False
    columns: list[str] = dataclasses.field(default_factory=list)


class _Column:
    """A column: its name, and its numbers (K,) in rows whose time increases."""

    def __init__(self, name: Name, values: np.ndarray, steps: Steps):
        self.name = name
        self.text = name.text
        self.role = name.role
        self.values = values
        self._steps = steps

    @functools.cached_property
    def shown(self) -> np.ndarray:
        """Its numbers without those that are missing."""
        return self.values[~np.isnan(self.values)]

    @functools.cached_property
    def means(self) -> np.ndarray:
        """Its mean in each step (N,)."""
        return self._steps.means(self.values)

    @functools.cached_property
    def heat(self) -> np.ndarray:
        """The heat of a duty in each step (N,), of which 1 is that of its largest number."""
        return self._steps.heat(np.abs(self.values)) / (np.abs(self.shown).max() or 1.0)

    @functools.cached_property
    def span(self) -> float:
        """The distance from its lowest number to its highest."""
        return float(np.ptp(self.shown)) if len(self.shown) else 0.0

    @functools.cached_property
    def looks_like_heat(self) -> bool:
        """Whether it is 0 at times, stands still mostly, and is not negative."""
        if len(self.shown) < 5 or not self.span or self.shown.max() > FULLS[-1]:
            return False
        off = np.mean(self.shown == 0)
        still = np.mean(np.diff(self.shown) == 0)
        return bool(off > 0.02 and still > 0.5 and self.shown.min() >= 0)


def propose(
    table: LogTable, limb: LimbParameters | None, dictionary: Dictionary, path: str = ""
) -> Proposal:
    """Return what the columns of a log seem to be, and what has to be asked.

    Args:
        limb: description of the limb; None if the log is of the nominal limb or a part of it.
    """
    found = _Log(table, limb, dictionary).proposal()
    with contextlib.suppress(LogError):
        if is_reversed(stamps(table, found.mapping.time, found.mapping.rate)):
            return _Log(table.oldest_first(), limb, dictionary).proposal()
    return found


class _Log:
    """The columns of a log, and what they are taken for."""

    def __init__(self, table: LogTable, limb: LimbParameters | None, dictionary: Dictionary):
        self.table = table
        self.limb = limb
        self.dictionary = dictionary
        self.questions: list[Question] = []
        self.notes: dict[str, str] = {}
        names = [
            Name.of(name, unit, table.names, dictionary)
            for name, unit in zip(table.names, table.units, strict=True)
        ]
        self.time = self._time(names)
        try:
            self.times, self.kept = times_of(table, self.time, 10.0)
        except LogError:  # to see what follows what
            self.times = 0.1 * np.arange(table.num_rows)
            self.kept = np.ones(table.num_rows, bool)
        self.steps = Steps.of(self.times)
        used = (self.time.column, self.time.fraction)
        named = [(n, table.numbers(n.text)[self.kept]) for n in names if n.text not in used]
        self.missing = [
            str(value) for value in MISSING if any(_stands_out(v, value) for _, v in named)
        ]
        numbers = [float(text) for text in self.missing]
        columns = [
            _Column(n, np.where((np.abs(v) > ABSURD) | np.isin(v, numbers), np.nan, v), self.steps)
            for n, v in named
        ]
        self.columns = [column for column in columns if len(column.shown) > 5]
        self.unnamed = not table.names_line and "column_1" in table.names

    def ask(self, field: str, text: str, choices: list[str] | None = None) -> None:
        self.questions.append(Question(field, text, choices or []))

    def of_role(self, role: str) -> list[_Column]:
        return [c for c in self.columns if c.role == role and c.name.is_measured]

    def proposal(self) -> Proposal:
        """Return what was found."""
        points = self._points()
        duties = self._duties()
        temperatures = self._temperatures(duties)
        wires = self._wires(duties)
        full, inverted = self._full(duties)
        self.temperatures = temperatures
        self.shares = np.array([c.heat for c in duties]).reshape(len(duties), len(self.steps.times))
        self._pair(wires, duties, temperatures)
        bend = self._bend([*duties, *temperatures], points)
        self._leftovers(wires, duties, temperatures)
        mapping = LogMapping.of(
            self.table, self.time, wires, bend, full=full, missing=self.missing
        )
        self._sign(mapping, duties)
        lines = [f"{name}: {what}" for name, what in self.notes.items()]
        lines += [f"{c.text}: not used" for c in self.columns if c.text not in self.notes]
        heated = any(column.span > 0 for column in duties)
        return Proposal("", mapping, lines, self.questions, heated, self.table.names)

    # Time.

    def _time(self, names: list[Name]) -> TimeColumn:
        """Return the column that increases as a clock does; a question if there is none."""
        best = TimeColumn()
        most = -1.0
        for name in names:
            column, score = self._time_of(name, names)
            if score > most:
                best = column
                most = score
        if most >= 0.0:
            self.notes[best.column] = f"time, {best.unit}; it increases as a clock does"
            if best.unit == OPEN:
                self.ask(
                    "time.unit",
                    f"{best.column}: what is its unit? Its rows are too far apart, or too near, "
                    "for its name",
                    ["s", "ms", "us"],
                )
            return best
        frames = [name.text for name in names if name.role == FRAME and self._counts(name.text)]
        self.ask(
            "rate",
            "no column is a time that increases; give the rate, Hz, of "
            + (f"the frames in {frames[0]}" if frames else "the rows")
            + ", or the time's column and unit",
            ["10.0"],
        )
        return TimeColumn(frames[0], FRAMES) if frames else TimeColumn()

    def _counts(self, name: str) -> bool:
        return bool((np.diff(self.table.numbers(name)) > 0).all())

    def _time_of(self, name: Name, names: list[Name]) -> tuple[TimeColumn, float]:
        """Return how a column would be the time, and how much speaks for it; -1 if it is none."""
        none = (TimeColumn(), -1.0)
        if name.role not in (TIME, "") or (name.role == "" and name.quantity):
            return none
        values = self.table.numbers(name.text)
        unit = ""
        if np.isnan(values).mean() > 0.5:
            values = self.table.moments(name.text)
            unit = DATE
        # Seconds and their fraction in two columns, as ROS has them.
        fraction = ""
        scale = "s"
        for other in names:
            word = next((w for w in other.words if w in FRACTIONS), "")
            rest = [w for w in other.words if w != word]
            if word and rest == [w for w in name.words if w not in ("sec", "secs")] and name != other:
                fraction = other.text
                scale = FRACTIONS[word]
                unit = "s"
                values = values + self.table.numbers(fraction) * SECONDS[scale]
        shown = values[~np.isnan(values)]
        if len(shown) < 5 or len(shown) < 0.5 * len(values):
            return none
        steps = np.diff(shown)
        steps = -steps if (steps < 0).sum() > 0.9 * len(steps) else steps  # newest row first
        said = name.role == TIME
        if (steps > 0).sum() < 5 or (steps < 0).sum() > 0.002 * len(steps) + 1:
            return none
        if (steps == 1).all() and not said:
            return none  # an index
        unit = unit or _unit_of_time(name, shown)
        if not unit:
            return none
        wraps = 0.0
        for period in PERIODS if (steps < 0).any() else ():
            if np.abs(steps.min() * SECONDS.get(unit, 1.0) + period) < 0.01 * period:
                wraps = period
        score = 2.0 * said + (steps > 0).mean() - 1.5 * bool((steps == 1).all())
        score += 0.5 * bool(fraction) - (unit == OPEN)
        return TimeColumn(name.text, unit, wraps, fraction, scale if fraction else "ns"), score

    # Wires.

    def _duties(self) -> list[_Column]:
        """Return the columns of duty, one for each wire or for two that share a signed one."""
        named = self.of_role(DUTY)
        if named:
            best = min(c.name.rank for c in named)
            chosen = [c for c in named if c.name.rank == best]
        else:
            # Without a name, something has to follow the heat, for all like columns.
            warmed = [c for c in self.columns if not c.role and c.looks_like_heat and c.name.is_measured
                      and c.name.quantity in ("", "counts", "share") and self._is_followed(c)]
            stems = {c.name.stem for c in warmed}
            like = [c for c in self.columns if c.name.stem in stems and not c.role]
            chosen = [c for c in like if c in warmed or not c.span]
            if len(stems) > 1 or (len(chosen) < len(like) and not self.unnamed):
                self.ask(
                    "wires[0].duty",
                    f"which are the duty: {_list(like)}? Names do not say it",
                    [c.text for c in like],
                )
                return []
        for column in chosen:
            why = "by its name" if named else "0 and still as a duty, and others follow it"
            self.notes[column.text] = f"duty, {why}"
        return sorted(chosen, key=lambda c: _order(c.name.label))

    def _is_followed(self, duty: _Column) -> bool:
        """Whether another column clearly follows the heat of what may be a duty."""
        others = [c for c in self.columns if c is not duty and not c.looks_like_heat]
        others = [c for c in others if c.span and c.role in (TEMPERATURE, BEND, "")]
        if not others:
            return False
        found = Responses.of(self.steps.times, duty.heat[None], np.array([c.means for c in others]))
        strong = [abs(correlation(duty.heat, c.means)) > 0.5 for c in others]
        return bool((np.abs(found.votes[:, 0]) > MARGIN)[strong].any())

    def _wires(self, duties: list[_Column]) -> list[WireColumns]:
        """Return the wires with their names and duties."""
        if not duties:
            if not any(q.field.startswith("wires") for q in self.questions):
                self.ask(
                    "wires[0].duty",
                    "no column seems to be a duty, which is 0 while wires are off; give the column of "
                    "each wire, '' for one that was not heated, or join the file of the heaters",
                    [c.text for c in self.columns if c.looks_like_heat],
                )
            names = self.limb.wire_names if self.limb else [LEFT, RIGHT]
            return [WireColumns(name, OPEN) for name in names]
        signed = [c for c in duties if len(c.shown) and c.shown.min() < 0]
        if signed and not (len(duties) == 1 and not duties[0].name.label):
            pairs = [(c, sign) for c in duties for sign in (1.0, -1.0)]
            self.ask(
                "wires[0].name",
                f"{_list(signed)} are signed: name the wire that positive numbers of each heat, and "
                "the one that negative numbers heat, with sign: -1.0",
                self.limb.wire_names if self.limb else [LEFT, RIGHT],
            )
            return [WireColumns(OPEN, c.text, sign) for c, sign in pairs]
        if signed:
            self.notes[signed[0].text] = "duty of both wires: negative numbers heat the left wire"
            duties += duties
            names = [LEFT, RIGHT]
            return [WireColumns(n, signed[0].text, s) for n, s in zip(names, (-1.0, 1.0), strict=True)]
        return [
            WireColumns(name, c.text) for name, c in zip(self._wire_names(duties), duties, strict=True)
        ]

    def _wire_names(self, duties: list[_Column]) -> list[str]:
        """Return a name for each duty, as the limb's description has it."""
        labels = [c.name.label for c in duties]
        sides = [c.name.side for c in duties]
        known = self.limb.wire_names if self.limb else [LEFT, RIGHT]
        own = [Name.of(name, "", known, self.dictionary) for name in known]
        by_label = {name.label or name.text: name.text for name in own}
        if all(label in by_label for label in labels) and len(set(labels)) == len(labels):
            return [by_label[label] for label in labels]
        if len(duties) == 1 and self.limb is None:
            return [sides[0] or RIGHT]
        if len(duties) == len(known) and not any(sides) and len(set(labels)) == len(labels):
            said = ", ".join(f"{c.text} {n}" for c, n in zip(duties, known, strict=True))
            self.notes["wires"] = f"taken in their order: {said}; exchange the names if need be"
            return known
        hint = "" if self.limb else "; describe a limb of other wires than left and right with -l"
        for index, column in enumerate(duties):
            self.ask(f"wires[{index}].name", f"which wire does {column.text} heat{hint}?", known)
        return [OPEN] * len(duties)

    def _full(self, duties: list[_Column]) -> tuple[float, bool]:
        """Return the number of full duty; 0 and a question if nothing tells it."""
        values = np.concatenate([np.abs(c.shown) for c in duties]) if duties else np.zeros(1)
        most = float(values.max())
        if not most:
            return 1.0, False
        names = _list(list(dict.fromkeys(duties)))
        resting = [c for c in duties if not (c.shown == 0).any() and (c.shown == c.shown.max()).mean() > 0.05]
        cooled = [c for c in duties if c.span and self._cools(c)]
        if cooled or (len(resting) == len(duties)):
            self.ask(
                "full",
                f"{names}: the duty looks inverted, for it is at its most ({most:g}) where wires "
                "cool or rest; give full, and inverted: true if the wires are off there",
                [f"{next(f for f in FULLS if most <= 1.001 * f):g}"],
            )
            return 0.0, False
        words = {word for c in duties for word in c.name.words}
        percent = {"%", "percent", "pct", "prozent"} & (words | {c.name.unit for c in duties})
        found = [re.search(r"\b0 ?(?:-|\.\.|to) ?(\d+)\b", c.text + c.name.unit) for c in duties]
        ranges = {match[1] for match in found if match}
        is_power = any(c.name.quantity == "power" for c in duties) or not words.isdisjoint(POWERS)
        likely = _full_by_numbers(values, words)
        choices = [f"{full:g}" for full in FULLS if most <= 1.001 * full][:3]
        if len(ranges) == 1 and most <= 1.001 * float(min(ranges)):
            return float(ranges.pop()), False
        if percent:
            if 1.0 < most <= 100.1:
                return 100.0, False
            choices = ["100", "1"]
        elif likely and not is_power:
            return likely, False
        self.ask("full", f"the most in {names} is {most:g}: what is full duty?", choices)
        return 0.0, False

    def _cools(self, duty: _Column) -> bool:
        """Whether the thermocouple of a duty's own name clearly cools with its heat."""
        own = [c for c in self.of_role(TEMPERATURE) if c.name.label == duty.name.label and c.span]
        if len(own) != 1 or not duty.name.label:
            return False
        votes = Responses.of(self.steps.times, duty.heat[None], own[0].means[None]).votes
        return bool(votes[0, 0] < -MARGIN)

    # Thermocouples.

    def _temperatures(self, duties: list[_Column]) -> list[_Column]:
        """Return the columns of thermocouples."""
        found = [c for c in self.of_role(TEMPERATURE) if c.name.quantity != "counts"]
        found = [c for c in found if c not in duties]
        if not found and duties:
            warm = [c for c in self.columns if not c.role and not c.name.quantity and c not in duties
                    and c.name.is_measured and c.span and -10 < np.quantile(c.shown, 0.02) < 320
                    and c.shown.max() < 620]
            heats = np.array([c.heat for c in duties])
            for column in warm:
                votes = Responses.of(self.steps.times, heats, column.means[None]).votes[0]
                strong = max(correlation(heat, column.means) for heat in heats) > 0.6
                if strong and votes.max() > MARGIN and votes.min() > -MARGIN:
                    found.append(column)
            stems = {c.name.stem for c in found}
            like = [c for c in self.columns if c.name.stem in stems and not c.role and c not in duties]
            if len(like) > len(found) and not self.unnamed:
                self.ask("wires[0].temperature", f"which are temperatures: {_list(like)}?",
                         [c.text for c in like])
                return []
        return found

    def _pair(
        self, wires: list[WireColumns], duties: list[_Column], temperatures: list[_Column]
    ) -> None:
        """Give wires their thermocouples, by names, else by what clearly warms what."""
        if not duties or not temperatures:
            return
        heats = self._heats(wires, duties)
        found = Responses.of(self.steps.times, heats, np.array([c.means for c in temperatures]))
        by_heat = found.pairs()
        labels = [c.name.label for c in duties]
        own_labels = [c.name.label for c in temperatures]
        same_numbers = sorted(labels) == sorted(own_labels) and len(set(labels)) == len(labels)
        left = dict(enumerate(temperatures))
        open_wires = []
        for index, wire in enumerate(wires):
            label = labels[index] if wire.sign > 0 and labels.count(labels[index]) == 1 else wire.name
            side = wire.name if wire.name in (LEFT, RIGHT) and (label == wire.name) else ""
            named = [i for i, own in enumerate(own_labels) if own and own == label and (side or same_numbers)]
            evident = by_heat[index]
            if len(named) == 1 and evident not in (None, named[0]):
                self._ask_temperature(index, wire, temperatures, f"its name says {temperatures[named[0]].text}, "
                          f"but {temperatures[evident].text} warms with {wire.duty}")
                left.pop(named[0], None)
                left.pop(evident, None)
            elif len(named) == 1:
                self._set_temperature(wire, left.pop(named[0]), "by its name")
            elif len(named) > 1:
                self._ask_temperature(index, wire, [temperatures[i] for i in named], "several have its name")
                for i in named:
                    left.pop(i, None)
            elif evident is not None and evident in left and not (
                temperatures[evident].name.side and side):
                self._set_temperature(wire, left.pop(evident), f"it warms with {wire.duty}")
            else:
                open_wires.append(index)
        for index in open_wires:
            wire = wires[index]
            others = [c for c in left.values() if not (c.name.side and wire.name in (LEFT, RIGHT) and c.name.side != wire.name)]
            like = len(temperatures) == len(wires) and len({c.name.stem for c in temperatures}) == 1
            if len(others) == 1 and len(open_wires) == 1 and (like or (len(wires) == 1 and len(temperatures) == 1)) and not (
                len(wires) > 1 and heats[index].any() and not like):
                (key,) = [k for k, c in left.items() if c is others[0]]
                self._set_temperature(wire, left.pop(key), "the only one that is left")
            elif others:
                self._ask_temperature(index, wire, others, "neither names nor heat tell it with a margin")
                for key in [k for k, c in left.items() if c in others and len(open_wires) == 1]:
                    left.pop(key)
        if len(open_wires) > 1:
            left.clear()
        for column in left.values():
            self.notes[column.text] = "a temperature of no wire that is known"
            wires.append(WireColumns(OPEN, OPEN, temperature=column.text, unit=OPEN))
            self.ask(
                f"wires[{len(wires) - 1}].duty",
                f"{column.text} is a temperature, but no wire's: give the duty of its wire ('' if it "
                "was not heated) and the wire's name, or leave out this wire",
                ["''", "none"],
            )
        self._units([w for w in wires if w.temperature not in ("", OPEN)], temperatures)

    def _heats(self, wires: list[WireColumns], duties: list[_Column]) -> np.ndarray:
        """Return the heat of each wire (W, N)."""
        heats = []
        for wire, column in zip(wires, duties, strict=True):
            signed = np.clip(wire.sign * forward_fill(column.values), 0.0, None)
            heats.append(self.steps.heat(signed) / (np.abs(column.shown).max() or 1.0))
        return np.array(heats)

    def _ask_temperature(self, index: int, wire: WireColumns, choices: list[_Column], why: str) -> None:
        wire.temperature = OPEN
        wire.unit = OPEN
        for column in choices:
            self.notes[column.text] = "a temperature; see the question"
        self.ask(f"wires[{index}].temperature",
                 f"which is the thermocouple of the wire that {wire.duty} heats: {_list(choices)}? {why[0].upper()}{why[1:]}",
                 [c.text for c in choices])
        units = {c.name.temperature_unit for c in choices}
        if len(units) == 1 and "" not in units:
            wire.unit = units.pop()

    def _set_temperature(self, wire: WireColumns, column: _Column, why: str) -> None:
        wire.temperature = column.text
        self.notes[column.text] = f"temperature of the {wire.name} wire, {why}"

    def _units(self, wires: list[WireColumns], temperatures: list[_Column]) -> None:
        """Give thermocouples their unit: as names say if it can be, else one for all of them."""
        columns = {c.text: c for c in temperatures}
        unit = self._unit_of(temperatures)
        for wire in wires:
            column = columns[wire.temperature]
            said = column.name.temperature_unit
            wire.unit = said or unit
            if said and not _can_be(said, [column]) or (said and unit not in (OPEN, said) and self._rest(temperatures)):
                wire.unit = OPEN
        if asked := [w.temperature for w in wires if w.unit == OPEN]:
            lows = [np.quantile(columns[a].shown, 0.02) for a in asked]
            highs = [columns[a].shown.max() for a in asked]
            for number, wire in enumerate(wires):
                if wire.unit == OPEN:
                    self.ask(f"wires[{number}].unit",
                        f"unit of {' and '.join(asked)}: C, F or K? They read {min(lows):.3g} to "
                        f"{max(highs):.3g}, which does not tell, or contradicts their names",
                        list(CELSIUS))

    def _rest(self, temperatures: list[_Column]) -> float | None:
        """Return the reading of thermocouples that are all in a room at first; None if not."""
        first = [float(np.median(c.shown[:5])) for c in temperatures]
        low = [float(np.quantile(c.shown, 0.02)) for c in temperatures]
        alike = np.ptp(first) < 3.0 and all(f < lo + 4.0 for f, lo in zip(first, low, strict=True))
        return float(np.mean(first)) if alike else None

    def _unit_of(self, temperatures: list[_Column]) -> str:
        """Return the unit in which all thermocouples can have been in a room, or are cold."""
        same = [c for c in temperatures if c.name.temperature_unit in ("", "C")] or temperatures
        rest = self._rest(same)
        low = min(float(np.quantile(c.shown, 0.02)) for c in same)
        if rest is not None:
            return next((u for u, (cold, warm) in ROOMS.items() if cold <= rest <= warm), OPEN)
        if low > 250.0:
            return "K"
        return "C" if low < COLD else OPEN

    # The bend.

    def _points(self) -> list[tuple[_Column, _Column]]:
        """Return the columns x and y of points in a picture, in the order of numbers or the log's."""
        fits = [c for c in self.columns if c.name.quantity in ("", "counts", "length") and c.name.axis
                and c.name.is_measured]
        pairs = []
        for column in fits:
            name = column.name
            other = [c for c in fits if name.axis == "x" and c.name.axis == "y"
                     and (c.name.stem, c.name.label) == (name.stem, name.label)]
            pairs += [(column, other[0])] if len(other) == 1 else []
        return pairs if len(pairs) > 1 else []

    def _bend(self, used: list[_Column], points: list[tuple[_Column, _Column]]) -> BendColumns:
        """Return the columns of the bend."""
        in_points = [c for pair in points for c in pair]
        in_points += [c for c in self.columns if c.name.axis == "z" and c.name.stem in {p[0].name.stem for p in points}]
        rated = [c for c in self.of_role(BEND) if c not in used and c not in in_points and c.span]
        two_axes = (self.limb.segments[0].axes if self.limb else 1) == 2
        if two_axes and len(rated) == 2:
            return self._bend_in_space(rated)
        if points and not rated:
            return self._line(points)
        if not rated:
            rest = [c for c in self.columns if c not in used and c not in in_points and c.span
                    and not c.role and c.name.is_measured]
            plain = [c for c in rest if not c.name.quantity]
            rated = [c for c in plain if not c.looks_like_heat]
            if len(rated) > 1 and self.shares.any():
                rated = [c for c in rated if self._follows(c)]
            if not rated:
                hints = [c for c in rest if c.name.quantity and self._follows(c)][:3]
                hint = "; ".join(f"{c.text} is of another quantity: {c.name.quantity}" for c in hints)
                self.ask("bend.column", "no column seems to be the bend, which is an angle: give its column, "
                         "or the points of a picture, or join the camera's file" + (f". {hint}: if it shows the bend, give its "
                         "scale too" if hint else ""), [c.text for c in hints])
                return BendColumns(OPEN, scale=0.0 if hints else 1.0)
        first = min(rated, key=lambda c: c.name.rank)
        rivals = [c for c in rated if c is not first and not (
            abs(correlation(first.values, c.values)) > SAME and 0.9 < c.span / first.span < 1.1)]
        if rivals:
            hint = ""
            if not two_axes and len({c.name.stem for c in rated}) == 1:
                hint = "; describe a limb that bends about two axes with -l"
            self.ask("bend.column", f"which is the bend: {_list([first, *rivals])}? Each may be{hint}",
                     [c.text for c in [first, *rivals]])
            return BendColumns(OPEN)
        return self._bend_column(first)

    def _follows(self, column: _Column) -> bool:
        """Whether a column clearly follows the heat of any wire."""
        if not self.shares.any():
            return False
        found = Responses.of(self.steps.times, self.shares, column.means[None])
        return bool((np.abs(found.votes) > MARGIN).any())

    def _bend_in_space(self, columns: list[_Column]) -> BendColumns:
        first, second = sorted(columns, key=lambda c: (c.name.axis, c.name.label))
        own = self._bend_column(first)
        other = self._bend_column(second)
        for column in columns:
            self.notes[column.text] += "; towards " + ("E2" if column is first else "E3")
        return dataclasses.replace(own, column="", e2=first.text, e3=second.text,
                                   zero_e3=other.zero, scale_e3=other.scale if other.scale != own.scale else 0.0)

    def _line(self, points: list[tuple[_Column, _Column]]) -> BendColumns:
        """Return the line from the base to the tip; a question if it is not clear which is the base."""
        tip = points[-1]
        moves = np.array([np.hypot(*(np.nanstd(c.means) for c in pair)) for pair in points])
        still = moves < STILL * moves.max() + 1e-12
        names = [re.sub(r"[\W_]*[xX]$", "", x.text) or x.text for x, _ in points]
        fixed = [set(x.name.words) & FIXED_WORDS for x, _ in points]
        for pair, name in zip(points, names, strict=True):
            self.notes |= {c.text: f"of the point {name}" for c in pair}
        base = points[0]
        clear = still[0] and not still[1:].any() and not any(fixed)
        clear |= not self.shares.any() and not still.any() and not any(fixed)
        if not clear:
            self.ask("bend.line", f"which point is the limb's base, and which its tip: {', '.join(names)}? "
                     "Give x and y of the base, then x and y of the tip",
                     [f"[{', '.join(c.text for c in (*pair, *tip))}]" for pair in points[:-1]])
            return BendColumns(line=[OPEN, OPEN, *(c.text for c in tip)], measures=CHORD)
        zero = base_direction([[c.values for c in pair] for pair in points])
        return BendColumns(line=[c.text for c in (*base, *tip)], zero=zero, measures=CHORD)

    def _bend_column(self, column: _Column) -> BendColumns:
        """Return how the bend is read from its column; the scale is 0 if that is not known."""
        name = column.name
        values = column.shown
        measures = BEND_ANGLE
        if self.dictionary.has("tip tangent", name.words):
            measures = TIP_TANGENT
        elif "chord" in name.words:
            measures = CHORD
        elif self.dictionary.has("orientation", name.words):
            measures = OPEN
            self.ask("bend.measures", f"{column.text} is an orientation: of the tip's tangent, which is "
                     "halved, or is it the bend angle?", [TIP_TANGENT, BEND_ANGLE, CHORD])
        rest = float(np.median(values[:10]))
        warmed = max((c.span for c in self.temperatures), default=0.0)
        small = float(np.abs(values - np.median(values)).max()) < RADIANS
        hot = self.shares.any() and warmed > HOT
        units = {"rad": np.rad2deg(1.0), "mrad": np.rad2deg(1e-3), "mdeg": 1e-3}
        unit = {"rads": "rad", "radians": "rad"}.get(name.unit, name.unit)
        unit = unit or next((w for w in name.words if w in ("rad", "mrad", "mdeg")), "")
        scale = float(units.get(unit, 1.0))
        if (name.quantity not in ("", "angle")) or column.span * scale > 720.0:
            scale = 0.0
        elif unit == "rad" and column.span > 2 * np.pi:
            scale = 0.0
        elif unit not in units and small:
            if unit:
                scale = 0.0 if hot and column.span < 1.5 else 1.0
            else:
                sure = hot and name.role == BEND and name.words != ("tip",) and column.span > 0.05
                sure |= hot and not name.role and abs(rest) < 1.0 and column.span > 0.05
                scale = float(np.rad2deg(1.0)) if sure else 0.0
        zero = rest if not scale or abs(rest) * scale > FARTHEST else 0.0
        if not scale:
            self.ask("bend.scale", f"how many degrees is a unit of {column.text}? Negative if the limb bends "
                     "towards the right wire when the numbers fall", ["1.0", f"{np.rad2deg(1.0):.6g}"])
        shown = "degrees" if scale == 1.0 else f"{scale:.4g} degrees each" if scale else "in an unknown unit"
        self.notes[column.text] = f"the bend ({measures}), {shown}"
        return BendColumns(column.text, zero=zero, scale=scale, measures=measures)

    def _sign(self, mapping: LogMapping, duties: list[_Column]) -> None:
        """Turn the bend so that it grows where the right wire is heated, if all wires say so."""
        bend = mapping.bend
        if not bend.scale or OPEN in bend.columns or not duties:
            return
        wires = [w for w in mapping.wires if w.duty not in ("", OPEN)]
        full = self._full_for_doses(mapping, duties)
        doses = [float(np.trapezoid(forward_fill(np.clip(w.sign * c.values, 0, None)), self.times)) / full
                 for w, c in zip(wires, duties, strict=True)]
        heated = [i for i, dose in enumerate(doses) if dose > HEATED]
        if not heated:
            self.notes["sign"] = "no heat shows which way the limb bends; check the sign of bend.scale"
            return
        heats = self._heats(wires, duties)
        rows = bends_of(self.table, dataclasses.replace(mapping, bend=dataclasses.replace(bend, measures=BEND_ANGLE) if bend.measures == OPEN else bend))[:, self.kept]
        found = Responses.of(self.steps.times, heats, np.array([self.steps.means(row) for row in rows]))
        limb = self.limb or LimbParameters()
        levers = {wire.name: np.array(wire.lever) for wire in limb.wires}
        if any(w.name not in levers for w in wires):
            bend.scale = bend.scale if bend.e2 else 0.0
            if not bend.e2:
                self.ask("bend.scale", "the sign of the bend: negative if the limb bends towards the right wire, "
                         "or +E2, when its numbers fall", ["1.0", "-1.0"])
            return
        if bend.e2:
            for index in heated:
                lever = levers[wires[index].name]
                along = lever @ found.gains[:, index] / np.hypot(*lever)
                if along < MARGIN * float(np.max(found.errors[:, index])):
                    self.ask("bend.scale", f"{wires[index].duty} does not clearly bend the limb towards its wire "
                             f"{wires[index].name}: are names, signs and roll of the bend right?", [f"{bend.scale:g}"])
                    bend.scale = 0.0
                    return
            return
        votes = np.array([found.votes[0, i] * np.sign(levers[wires[i].name][0]) for i in heated])
        agreed = (np.abs(votes) > MARGIN).all() and abs(np.sign(votes).sum()) == len(votes)
        if agreed:
            bend.scale *= float(np.sign(votes[0]))
            self.notes["sign"] = f"the right wire bends the limb to {'+' if votes[0] > 0 else '-'}"
            return
        scale = abs(bend.scale)
        what = bend.column or "the line of points"
        self.ask("bend.scale", f"the sign of {what}: heat does not show with a margin which way the limb bends; "
                 "negative if it bends towards the right wire when numbers fall", [f"{scale:g}", f"{-scale:g}"])
        bend.scale = 0.0

    def _full_for_doses(self, mapping: LogMapping, duties: list[_Column]) -> float:
        return mapping.full or max(float(np.abs(c.shown).max()) for c in duties) or 1.0

    def _leftovers(
        self, wires: list[WireColumns], duties: list[_Column], temperatures: list[_Column]
    ) -> None:
        """Ask about what is left over and could be heat."""
        for column in self.columns:
            if column in duties or column.text in self.notes or not column.name.is_measured:
                continue
            heat_like = column.looks_like_heat or (column.role == DUTY and column.span > 0)
            bare = [i for i, wire in enumerate(wires[: len(duties)]) if not wire.temperature]
            for index in bare if column.span and not heat_like and column.role != BEND else ():
                found = Responses.of(self.steps.times, self.shares[[index]], column.means[None])
                strong = abs(correlation(self.shares[index], column.means)) > 0.6
                if strong and found.votes[0, 0] > MARGIN:
                    self._ask_temperature(index, wires[index], [column], "it warms with it")
                    break
            if not heat_like or column.role in (TIME, FRAME, TEMPERATURE):
                continue
            if duties and _is_explained(column, duties):
                continue
            if duties and column.role != DUTY and not self._is_followed(column):
                continue
            wires.append(WireColumns(OPEN, column.text))
            self.ask(f"wires[{len(wires) - 1}].name",
                     f"{column.text}{' is ' + column.name.quantity + ', but' if column.name.quantity else ''} may be "
                     "the heat of a wire: give the wire's name, or leave out this wire",
                     [*(self.limb.wire_names if self.limb else [LEFT, RIGHT]), "none"])


def _is_explained(column: _Column, duties: list[_Column]) -> bool:
    """Whether a column shows no more than the duties, as a current or a sum does."""
    factors = np.vstack([*(forward_fill(c.values) for c in duties), np.ones(len(column.values))]).T
    values = forward_fill(column.values)
    left = values - factors @ np.linalg.lstsq(factors, values, rcond=None)[0]
    return bool(left.std() < 0.3 * values.std())


def _can_be(unit: str, columns: list[_Column]) -> bool:
    """Whether thermocouples can read in a unit what they do."""
    low, high = COLDEST[unit]
    return all(
        low < np.quantile(c.shown, 0.02) < high and np.quantile(c.shown, 0.99) < HOTTEST[unit]
        for c in columns
    )


def _full_by_numbers(values: np.ndarray, words: set[str]) -> float:
    """Return the number of full duty by what numbers there are of duty; 0 if they do not tell.

    Programs set duty in hundredths: whole numbers that are all rounded hundredths of 255 are
    counts of 8 bits, and not by chance if there are some of them.
    """
    most = float(values.max())
    levels = np.unique(values[values > 0])
    if most <= 1.0:
        return 1.0
    if (values % 1 != 0).any():
        return 100.0 if VOLTS < most <= 100.1 else 0.0
    if most in FULLS:
        return most
    if most <= 100.0 and not words.isdisjoint(SHARES) and len(levels) > 3 and (levels % 5 == 0).all():
        return 100.0
    fits = []
    for full in FULLS[2:]:
        hundredths = full * np.round(levels * 100 / full) / 100
        if most <= full and (np.abs(hundredths - levels) < 0.5 + 1e-6).all():
            fits.append(full)
    enough = 2 if most > 100.0 or ("pwm" in words and (levels % 5 != 0).any()) else 8
    return fits[0] if len(fits) == 1 and len(levels) > enough else 0.0


def _order(label: str) -> tuple[int, str]:
    """Return the place of a wire among others: left, right, then by numbers or letters."""
    place = {LEFT: 0, RIGHT: 1}.get(label, 2)
    return place, label.zfill(3) if label.isdigit() else label


def _list(columns: list[_Column]) -> str:
    return " and ".join(column.text for column in columns)


def _stands_out(values: np.ndarray, value: float) -> bool:
    """Whether a number is in a column, far from all others there."""
    if value not in values:
        return False
    others = values[~np.isnan(values) & ~np.isin(values, MISSING)]
    if not len(others):
        return False
    low, high = np.quantile(others, [0.01, 0.99])
    return not low - 2 * (high - low) - 1 < value < high + 2 * (high - low) + 1


def _unit_of_time(name: Name, shown: np.ndarray) -> str:
    """Return the unit that a name says, else the first in which rate and length can be.

    It is `OPEN` if the name says a unit in which they cannot be.
    """
    steps = np.diff(shown)
    usual = float(np.median(np.abs(steps[steps != 0])))
    length = float(np.ptp(shown))

    def can_be(unit: str, rates: tuple[float, float], spare: float = 1.0) -> bool:
        rate = 1 / (usual * SECONDS[unit])
        duration = length * SECONDS[unit]
        return (
            rates[0] / spare < rate < rates[1] * spare
            and DURATIONS[0] / spare < duration < DURATIONS[1] * spare
        )

    words = {name.unit, *name.words}
    said = [unit for unit, known in UNIT_WORDS.items() if words & set(known.split())]
    if said:
        return next((unit for unit in said if can_be(unit, RATES, spare=10.0)), OPEN)
    units = ("s", "ms", "us", "ns", "min", "d")
    return next((unit for unit in units if can_be(unit, LIKELY_RATES)), "")


def base_direction(points: list[list[np.ndarray]]) -> float:
    """Return the direction of a limb's base in a picture whose y points down, °.

    It is that of its first links: the directions of links are those of the tangents at their
    middles, and the base is half a link before the first one, as for constant curvature.

    Args:
        points: x and y (K,) of two or more points, the base first.
    """
    x = np.array([point[0] for point in points])
    y = np.array([point[1] for point in points])
    shown = ~((x == 0) & (y == 0)).any(axis=0) & ~np.isnan(x + y).any(axis=0)
    if not shown.any():
        return 0.0
    links = np.arctan2(-np.diff(y[:, shown], axis=0), np.diff(x[:, shown], axis=0))
    links = np.unwrap(links, axis=0)
    base = links[0] if len(links) < 2 else 1.5 * links[0] - 0.5 * links[1]
    return round(float(np.rad2deg(np.median(base))), 2)
