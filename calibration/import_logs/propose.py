"""Propose what the columns of a log are, by their names; what names do not tell is asked for.

Names say what a column is. Numbers confirm it, or make a question: they never override a name.
Where names say nothing, numbers decide with a margin.
"""

import dataclasses
import functools
import itertools
import re
from collections.abc import Callable, Iterable

import numpy as np

from calibration.import_logs import clock, evidence, mapping, words
from calibration.import_logs.columns import MAX_DUTY, Column, ColumnList, read_columns
from calibration.import_logs.evidence import MIN_VOTE, Steps
from calibration.import_logs.log_signals import bends_of
from calibration.import_logs.mapping import UNKNOWN, BendColumns, LogMapping, WireColumns
from calibration.import_logs.points import base_direction, is_clamped_at_first_point
from calibration.import_logs.table import LogError, LogTable
from calibration.import_logs.words import BEND, DUTY, LEFT, RIGHT, SIDES, TEMPERATURE, Name
from limb_systems.kinematics import wrap_angle
from limb_systems.limb_parameters import LimbParameters

FULL_SCALES = (1.0, 100.0, 127.0, 255.0, 1023.0, 4095.0, MAX_DUTY)
COUNTED_SCALES = FULL_SCALES[3:]  # of counters of 8 bits and more
MAX_VOLTS = 24.0  # below which numbers that are no counts may be volts or watts
MAX_DUTY_RATIO = 5.0  # between the most of two duties that may be of one unit
MIN_LEVELS = (3, 9)  # levels of duty that are hundredths of a counter not by chance, see below
ROOM_RANGE = (2.0, 42.0)  # °C, where limbs rest
MIN_COLD = 8.0  # °C, which the coldest readings are above
MAX_COLD = 80.0  # °C, which the coldest readings are below
MAX_HOT = 300.0  # °C, which the hottest readings are below
MAX_REST_RISE = 4.0  # above the coldest readings, within which a limb is at rest
LONG_LOG_TIME = 150.0  # s of a log in which all wires become as cold as a room at some time
MIN_OFFSET = 8.0  # °C between thermocouples that may be an offset
MAX_REST_BEND = 20.0  # °, beyond which a limb at rest may be straight instead
MAX_BEND_RANGE = 540.0  # ° between the least and the most of an angle
MAX_RADIANS = 2.2  # that no bend in degrees stays within, while wires are hot
MIN_RADIANS = 0.35  # of which the range of a bend in radians is more, while wires are hot
MIN_RANGE = 1.5  # ° of a bend, while wires are hot
HOT_RISE = 20.0  # °C of warming, with which a limb bends by more than that in degrees
FIXED_POINT_SHARE = 0.02  # movement of a point that is fixed, in shares of the tip's
MIN_HEATED_TIME = 1.0  # s of full duty, with which a wire counts as heated
CONTRADICTIONS = ("inverted", "mixed units", "named unit")  # questions
DEGREES_PER_UNIT = {"deg": 1.0, "rad": 57.29577951308232, "mrad": 0.05729577951308232, "mdeg": 1e-3}


@dataclasses.dataclass
class Question:
    """A question about a field of the mapping.

    - ``field``: field of the mapping that has the answer, such as "wires[0].duty".
    - ``text``: the question, which names the columns.
    - ``choices``: answers that seem possible.
    - ``is_contradiction``: whether numbers contradict names, which no other log settles.
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
    """The proposed meaning of a log's columns, for one limb.

    - ``name``: the limb's name, if several share the log; else empty.
    - ``mapping``: mapping of the log's columns.
    - ``notes``: what each column is taken for, in lines.
    - ``questions``: what is asked.
    - ``is_heated``: whether wires are heated, so that numbers confirm the names.
    - ``columns``: names of all columns of the log.
    """

    name: str
    mapping: LogMapping
    notes: list[str] = dataclasses.field(default_factory=list)
    questions: list[Question] = dataclasses.field(default_factory=list)
    is_heated: bool = False
    columns: list[str] = dataclasses.field(default_factory=list)


class Columns:
    """The columns of a log, and the signals that they are taken for: one duty, bend and so on.

    In shapes, K are rows of the log, N the `Steps` that they are reduced to, and W wires.

    Args:
        limb: description of the limb; None if the log is of the nominal limb or a part of it.
        time: the column of time; found by names and numbers if None.
    """

    def __init__(
        self,
        table: LogTable,
        limb: LimbParameters | None,
        dictionary: words.Dictionary,
        time: mapping.TimeColumn | None = None,
    ):
        self.table = table
        self.limb = limb or LimbParameters()
        self.hint = "" if limb else " Describe a limb of other wires or axes with -l"
        self.dictionary = dictionary
        self.questions: list[Question] = []
        self.notes: list[str] = []
        self.free = ColumnList()  # columns whose signal is not known yet
        self.duties = ColumnList()
        self.temperatures = ColumnList()
        self.wires: list[WireColumns] = []  # the first ones have the duties
        self.is_inverted = False  # the duty, as it seems
        # Begin with names, and the time.
        names = []
        for text, unit in zip(table.names, table.units, strict=True):
            names.append(Name(text, dictionary, unit, table.names))
        self.time = time or clock.find_time(table, names)
        if self.time.unit == UNKNOWN:
            self.ask("time unit", "time.unit", ["s", "ms", "us", "frames"], column=self.time.column)
        if not self.time.column or self.time.unit == mapping.FRAMES:
            what = f"the frames in {self.time.column}" if self.time.column else "the rows"
            self.ask("rate", "rate", ["10.0"], what=what)
        # To see what follows what, rows without a time come at any rate.
        known_time = mapping.TimeColumn() if self.time.unit == UNKNOWN else self.time
        self.times, self.rows, _ = clock.times_of(table, known_time, 10.0)
        self.steps = Steps(self.times)
        self.is_long = self.times[-1] - self.times[0] > LONG_LOG_TIME
        for name in names:
            values = table.numbers(name.text)
            is_signal = name.role in (DUTY, TEMPERATURE) and bool(self.time.column)
            if is_signal and clock.alternates(values, table.numbers(self.time.column)):
                raise LogError(
                    f"{name.text} has several rows for each time, such as a row for each wire; "
                    "give each wire columns of its own in one row, as a pivot table does."
                )
        is_time = (self.time.column, self.time.fraction).__contains__
        names = [name for name in names if not is_time(name.text)]
        self.columns, self.missing = read_columns(table, names, self.rows, self.steps)
        self.free = ColumnList(self.columns)

    @functools.cached_property
    def heats(self) -> np.ndarray:
        """The heat of each wire (W, N); 0 if no duty is known."""
        heats = np.zeros((len(self.wires), len(self.steps.times)))
        for index, duty in enumerate(self.duties):
            heats[index] = duty.heat(self.wires[index].sign)
        return heats

    def ask(
        self, kind: str, field: str, choices: Iterable["str | Column"] = (), **facts: object
    ) -> None:
        """Ask for a field of the mapping, by the dictionary's question of a kind.

        Choices are answers, or columns, that seem possible; facts are what the question says.
        """
        choices = list(choices)
        self.free = self.free.without(choices)
        texts = list(map(str, choices))
        facts = {"columns": " and ".join(texts), "hint": self.hint, **facts}
        text = words.QUESTIONS[kind].format(**facts)
        self.questions.append(Question(field, text, texts, kind in CONTRADICTIONS))

    def _is_asked(self, field: str) -> bool:
        """Return whether there is a question about a field of the mapping."""
        return any(question.field == field for question in self.questions)

    def proposal(self, name: str, log_mapping: LogMapping) -> Proposal:
        """Return a mapping with the questions, and a note on each column."""
        bend = log_mapping.bend
        notes = dict.fromkeys(bend.columns, f"the bend ({bend.measures})")
        notes[log_mapping.time.column] = f"time ({log_mapping.time.unit})"
        for wire in log_mapping.wires:
            whose = "a wire" if wire.name == UNKNOWN else f"the {wire.name} wire"
            sign = "negative " if wire.sign < 0 else ""
            duty = f"{sign}duty of {whose}"
            notes[wire.duty] = f"{notes[wire.duty]}, {duty}" if wire.duty in notes else duty
            notes[wire.temperature] = f"temperature of {whose} ({wire.unit})"
        notes = dict.fromkeys(self.table.names, "not used") | notes
        lines = [f"{column}: {notes[column]}" for column in self.table.names]
        for field in ("zero", "zero_e3"):
            if self._is_asked(f"bend.{field}"):
                setattr(bend, field, None)
        is_heated = bool(self.duties.moving)
        return Proposal(
            name, log_mapping, lines + self.notes, self.questions, is_heated, self.table.names
        )

    def _unnamed(self) -> ColumnList:
        """Return free columns that move, and whose names say no signal."""
        unnamed = self.columns.having("name.role", "").having("name.is_measured", True)
        return unnamed.moving.where(self.free.__contains__)

    def _find(self, role: str, is_likely: Callable[[Column], object]) -> ColumnList:
        """Return the columns whose names say a role; else like columns whose numbers all say it."""
        found = self.columns.having("name.role", role)
        if not found:
            unnamed = self._unnamed().having("is_number", True)
            likely = unnamed.where(is_likely)
            stems = set(likely.each("name.stem"))
            similar = unnamed.where(lambda column: column.name.stem in stems)
            if len(stems) == 1 and (len(similar) == len(likely) or not self.table.has_names):
                found = likely
        return found

    # Duty.

    def find_duties(self) -> None:
        """Find the duties, left before right, and a wire for each; two for a duty with a sign."""
        # Keep the columns whose names say it best; without names, columns that others follow.
        candidates = self._find(DUTY, lambda c: c.looks_like_heat and self._is_followed(c))
        best = min(candidates.each("name.rank"), default=0)
        self.duties = candidates.having("name.rank", best)
        self.duties.sort(key=lambda column: column.name.order)
        self.free = self.free.without(self.duties)
        if not self.duties:
            # Columns that are named alike are the duties of all wires, or of none.
            likely = self.columns.having("looks_like_heat", True)
            stems = set(likely.having("name.role", "").each("name.stem")) - {""}
            likely = self.columns.where(lambda c: c in likely or c.name.stem in stems)
            for index, wire_name in enumerate(self.limb.wire_names):
                self.wires.append(WireColumns(wire_name, UNKNOWN))
                own = likely.labelled(Name(wire_name, self.dictionary).label)
                choices = [*own, *likely.without(own)]
                self.ask("no duty", f"wires[{index}].duty", choices, wire=wire_name)
            return
        # Numbers with a sign heat two wires.
        signs = [1.0]
        if self.duties.where(lambda c: c.present.min() < 0):
            signs = [-1.0, 1.0]
            self.duties = ColumnList(sorted(self.duties * 2, key=self.duties.index))
        # Names of the limb's wires have the words of the columns.
        labels = self.duties.each("name.label")
        wire_of_label = {}
        for wire_name in self.limb.wire_names:
            wire_of_label[Name(wire_name, self.dictionary).label or wire_name] = wire_name
        is_named = len(set(labels)) == len(labels)
        for index, column in enumerate(self.duties):
            wire_name = wire_of_label.get(labels[index], UNKNOWN) if is_named else UNKNOWN
            self.wires.append(WireColumns(wire_name, column.text, signs[index % len(signs)]))

    def _is_followed(self, duty: Column) -> bool:
        """Return whether another column clearly follows the heat of what may be a duty."""
        heat = duty.heat()[None]
        for column in self.columns.moving.without([duty]):
            is_cause = column.name.role == DUTY or column.looks_like_heat
            if not is_cause and column.follows(heat):
                return True
        return False

    def find_inversion(self) -> None:
        """Invert the heat back if duties are inverted, as other columns respond to the heat.

        A duty is inverted if it is never 0 and rests at the largest number of all duties, or if a
        wire cools with it.
        """
        duties = ColumnList(dict.fromkeys(self.duties))
        if not duties.moving:
            return
        most = max(duties.each("top"))
        for column in duties:
            rests_at_top = (column.present == most).mean() > 0.05
            if (rests_at_top and column.present.min() > 0) or self._cools(column):
                self.is_inverted = True
        if self.is_inverted:
            self.heats = self.heats.max(axis=1, keepdims=True) - self.heats

    def full_duty(self) -> float:
        """Return the number in the log that means full duty, such as 1, 100 or 255.

        Return 0, and ask a question, if duties are inverted, or if neither their names nor their
        numbers determine it.
        """
        duties = ColumnList(dict.fromkeys(self.duties))
        if not duties:
            self.ask("unknown full", "full")
            return 0.0
        if not duties.moving:
            return 1.0
        # Find all sizes of duty, the largest of each column, and a scale that they fit.
        levels = np.unique(np.abs(np.concatenate(duties.moving.each("present"))))
        tops = duties.moving.each("top")
        full = _full_scale(duties, levels[levels > 0])
        # Duties have mixed units if their largest numbers are too far apart, or if one is a switch
        # of 0 and 1 and another a share.
        is_mixed = max(tops) > MAX_DUTY_RATIO * min(tops)
        for column in duties:
            is_switch = column.top == 1.0 and np.isin(column.present, [-1.0, 0.0, 1.0]).all()
            is_mixed |= bool(is_switch and min(tops) < 1.0)
        if full and not is_mixed and not self.is_inverted:
            return full
        kind = "inverted" if self.is_inverted else "mixed units" if is_mixed else "full duty"
        likely = [f"{scale:g}" for scale in FULL_SCALES if max(tops) <= 1.001 * scale][:4]
        columns = " and ".join(duties.each("text"))
        top_texts = " and ".join(f"{top:g}" for top in dict.fromkeys(tops))
        self.ask(kind, "full", likely, columns=columns, tops=top_texts)
        return 0.0

    def _cools(self, duty: Column) -> bool:
        """Return whether the thermocouple of a duty's own name clearly cools with its heat."""
        named = self.temperatures.labelled(duty.name.label)
        if len(named) != 1:
            return False
        gains, errors = self.steps.response(self.heats, named[0].means)
        index = self.duties.index(duty)
        return bool(gains[index] < -MIN_VOTE * errors[index])

    # Thermocouples.

    def find_temperatures(self) -> None:
        """Find the thermocouples; columns of one stem whose names say nothing must be warmed."""
        found = self._find(TEMPERATURE, self._is_warmed)
        self.temperatures = found.where(lambda column: column.name.quantity != "counts")
        self.free = self.free.without(self.temperatures)

    def _is_warmed(self, column: Column) -> bool:
        """Return whether a column may be a temperature, which a duty raises and none lowers."""
        votes = column.votes(self.heats)
        is_warmed = votes.max(initial=0.0) > MIN_VOTE and votes.min() > -MIN_VOTE
        return bool(is_warmed and column.low > -10.0 and column.present.max() < 620.0)

    def pair_wires_with_thermocouples(self) -> None:
        """Give wires their thermocouples, by names, else by what clearly warms what."""
        # Find the thermocouples that clearly warm with each wire.
        unpaired = ColumnList(self.temperatures)
        warming = np.zeros((len(unpaired), len(self.wires)))
        errors = np.zeros_like(warming)
        for row, column in enumerate(unpaired):
            warming[row], errors[row] = self.steps.response(self.heats, column.means)
        warmed_rows = evidence.clear_pairs(warming, errors)
        # Numbers and letters are names if duties and thermocouples have the same ones.
        labels = self.duties.each("name.label")
        labels = labels or [Name(wire.name, self.dictionary).label for wire in self.wires]
        sensor_labels = self.temperatures.each("name.label")
        are_same = len(set(labels)) == len(labels) and sorted(labels) == sorted(sensor_labels)
        # Names decide, if heat does not contradict them; else heat does.
        open_wires = []
        for index, wire in enumerate(self.wires):
            label = wire.name if wire.name in SIDES else labels[index] if are_same else ""
            named = self.temperatures.labelled(label)
            warmed_row = warmed_rows[index]
            warmed = None if warmed_row is None else self.temperatures[warmed_row]
            reason = ""
            if len(named) > 1:
                reason = f"Several have the name of {wire.name}"
            elif named and warmed not in (None, named[0]):
                reason = f"Names say {named[0].text}, but {warmed.text} warms with {wire.duty}"
            elif named and self.temperatures.index(named[0]) in warmed_rows and not warmed:
                reason = f"Names say {named[0].text}, but it warms with another wire"
            elif named:
                row = self.temperatures.index(named[0])
                gain = warming[row, index]
                error = errors[row, index]
                if (evidence.margin(warming[row], errors[row], gain, error) > MIN_VOTE).any():
                    reason = f"Names say {named[0].text}, but it warms more with another wire"
            if reason:
                self._ask_temperature(index, [*named, *filter(None, [warmed])], reason)
                unpaired = unpaired.without(named)
            elif named:
                wire.temperature = named[0].text
                unpaired.remove(named[0])
            elif warmed and warmed in unpaired and self._may_have(wire, warmed):
                wire.temperature = warmed.text
                unpaired.remove(warmed)
            else:
                open_wires.append(index)
        # Ask about wires that may have one of the thermocouples that are left.
        others = self.columns.moving.having("name.role", "").having("is_number", True)
        others = others.having("looks_like_heat", False).having("name.is_measured", True)
        for index in open_wires:
            candidates = unpaired.where(functools.partial(self._may_have, self.wires[index]))
            if self.wires[index].duty == UNKNOWN and not self.temperatures:
                candidates = others
            if candidates:
                self._ask_temperature(index, candidates)
        # Ask about thermocouples without a wire.
        asked = set(itertools.chain(*(question.choices for question in self.questions)))
        for column in unpaired:
            if column.text not in asked:
                field = f"wires[{len(self.wires)}].duty"
                wire = WireColumns(UNKNOWN, UNKNOWN, temperature=column.text, unit=UNKNOWN)
                self.wires.append(wire)
                self.ask("no wire", field, ["''", "none"], column=column.text)

    def _may_have(self, wire: WireColumns, column: Column) -> bool:
        """Return whether a thermocouple's name does not say that it is of another wire."""
        return column.name.side in ("", wire.name) or wire.name == UNKNOWN

    def _ask_temperature(self, index: int, choices: list[Column], contradiction: str = "") -> None:
        wire = self.wires[index]
        wire.temperature = UNKNOWN
        units = set(ColumnList(choices).each("name.unit"))
        is_known = len(units) == 1 and units <= set(mapping.TEMPERATURE_UNITS)
        wire.unit = units.pop() if is_known else UNKNOWN
        heated_wire = f"wire that {wire.duty} heats"
        if wire.duty == UNKNOWN:
            heated_wire = f"{wire.name} wire"
        reason = contradiction or "Neither names nor heat tell"
        field = f"wires[{index}].temperature"
        self.ask("thermocouple", field, dict.fromkeys(choices), wire=heated_wire, reason=reason)
        self.questions[-1].is_contradiction = bool(contradiction)

    def find_units(self) -> None:
        """Give thermocouples the unit in their names if it can be, else the only possible one."""
        texts = self.temperatures.each("text")
        for index, wire in enumerate(self.wires):
            if wire.temperature not in texts:
                continue
            # Like sensors have one unit.
            column = self.temperatures[texts.index(wire.temperature)]
            similar = self.temperatures.having("name.unit", column.name.unit)
            named = list({column.name.unit} & set(mapping.TEMPERATURE_UNITS))
            wire.unit = self._unit_of(similar, named)
            if wire.unit == UNKNOWN:
                kind = "named unit" if named else "unit"
                facts = {"column": column.text, "low": column.low, "high": column.present.max()}
                self.ask(kind, f"wires[{index}].unit", mapping.TEMPERATURE_UNITS, **facts)

    def _unit_of(self, sensors: ColumnList, named: list[str]) -> str:
        """Return the unit in which the readings of like sensors can be; else `UNKNOWN`."""
        firsts = np.array(sensors.each("first"))
        lows = np.array(sensors.each("low"))
        is_at_rest = (firsts - lows).max() < MAX_REST_RISE and np.ptp(firsts) < 3.0
        # In a short log, a limb that is warm in °C may seem to rest where a room is in °F.
        is_at_rest &= self.is_long or bool(named)
        possible = []
        for unit in named or mapping.TEMPERATURE_UNITS:
            # A limb at rest is in a room, and others become nearly as cold.
            factor, offset = mapping.TEMPERATURE_UNITS[unit]
            first = factor * firsts.mean() + offset
            is_possible = bool((factor * lows + offset > MIN_COLD).all())
            is_possible &= bool((factor * lows + offset < MAX_COLD).all())
            is_possible &= factor * max(sensors.each("high")) + offset < MAX_HOT
            is_possible &= not is_at_rest or ROOM_RANGE[0] < first < ROOM_RANGE[1]
            if is_possible:
                possible.append(unit)
        if len(possible) != 1 or not (named or is_at_rest or possible != ["F"]):
            return UNKNOWN
        # Without an offset, thermocouples become as cold as each other; in a long log, as a room.
        factor, offset = mapping.TEMPERATURE_UNITS[possible[0]]
        coldest = np.array(sensors.moving.each("lowest") or firsts[:1])
        is_in_room = not self.is_long or factor * coldest.max() + offset <= ROOM_RANGE[1]
        return possible[0] if is_in_room and factor * np.ptp(coldest) < MIN_OFFSET else UNKNOWN

    # The bend.

    def bend(self) -> BendColumns:
        """Return the columns of the bend: by name, else points, else what follows the heat."""
        # Take what names say: angles, or else points.
        coordinates = self._points()
        places = set(coordinates.each("name.place"))
        of_points = self.columns.where(lambda c: c.name.axis and c.name.place in places)
        candidates = self.columns.having("name.role", BEND).moving.without(of_points)
        self.free = self.free.without([*of_points, *candidates])
        if coordinates and not candidates:
            return self._line(coordinates)
        if self.limb.segments[0].axes == 2 and len(candidates) == 2:
            first, second = sorted(candidates, key=lambda c: (c.name.axis, c.name.label))
            bend = self._bend_column(first)
            bend_e3 = self._bend_column(second, "_e3")
            bend = dataclasses.replace(bend, column="", e2=first.text, e3=second.text)
            # Columns of one unit have one scale, so that an answer is for both.
            scale_e3 = 0.0 if bend_e3.scale == bend.scale else bend_e3.scale
            return dataclasses.replace(bend, zero_e3=bend_e3.zero, scale_e3=scale_e3)
        # Without names, it is a column that follows the heat; another quantity needs a scale.
        if not candidates:
            unnamed = self._unnamed().having("looks_like_heat", False)
            likely = unnamed.where(lambda column: column.follows(self.heats))
            candidates = likely.having("is_number", True)
            if not candidates:
                return self._unknown_bend("no bend", "bend.column", likely)
        if len(candidates) > 1:
            return self._unknown_bend("bend", "bend.column", candidates)
        return self._bend_column(candidates[0])

    def _points(self) -> ColumnList:
        """Return x and y of each point in a picture, in turn; none if there is one point only."""
        by_place = {}
        for column in self.columns:
            if column.name.is_measured and column.name.quantity in ("", "counts", "length"):
                by_place[column.name.place, column.name.axis] = column
        coordinates = ColumnList()
        for (place, axis), column in by_place.items():
            if axis == "x" and (place, "y") in by_place:
                coordinates += [column, by_place[place, "y"]]
        return coordinates if len(coordinates) > 2 else ColumnList()

    def _line(self, coordinates: ColumnList) -> BendColumns:
        """Return the line from the base to the tip; ask if it is not clear which they are."""
        texts = coordinates.each("text")
        tip = texts[-2:]
        says_fixed = "fixed" in set().union(*coordinates.each("name.says"))
        says_base = "base" in coordinates[0].name.says
        # The base is the only point that does not move, and the first.
        means = np.array(coordinates.each("means"))
        spreads = np.nanstd(means, axis=1)
        moves = np.hypot(spreads[::2], spreads[1::2])
        is_still = moves <= FIXED_POINT_SHARE * moves.max()
        is_clear = is_still[0] and not is_still[1:].any()
        is_clear &= says_base or is_clamped_at_first_point(means[::2], means[1::2])
        if not says_fixed and (is_clear or not self.heats.any()):
            zero = base_direction(coordinates.each("values"))
            # In the picture, the limb's right is clockwise.
            return BendColumns(line=texts[:2] + tip, zero=zero, scale=-1.0, measures=mapping.CHORD)
        starts = range(0, len(texts) - 2, 2)
        choices = [f"[{', '.join(texts[start : start + 2] + tip)}]" for start in starts]
        bend = self._unknown_bend("base", "bend.line", choices)
        return dataclasses.replace(bend, column="", line=[UNKNOWN, UNKNOWN, *tip])

    def _unknown_bend(self, kind: str, field: str, choices: Iterable[str | Column]) -> BendColumns:
        """Ask for the column or the line of the bend, and how its numbers become the bend."""
        self.ask(kind, field, choices)
        self.ask("scale", "bend.scale", ["1.0", "-1.0", "57.29578", "-57.29578"], column="the bend")
        self.ask("zero", "bend.zero", ["0.0"], columns="the bend")
        measures = mapping.CHORD if field == "bend.line" else mapping.BEND_ANGLE
        return BendColumns(UNKNOWN, scale=0.0, measures=measures)

    def _bend_column(self, column: Column, axis: str = "") -> BendColumns:
        """Return how the bend is read from its column; the scale is 0 if that is not known.

        ``axis`` is the end of the mapping's fields for the column: "_e3" for a second bend.
        """
        self.free = self.free.without([column])
        # Names say what the angle is of.
        name = column.name
        measures = mapping.CHORD if "chord" in name.words else mapping.BEND_ANGLE
        if "tip tangent" in name.says:
            measures = mapping.TIP_TANGENT
        elif "orientation" in name.says:
            measures = UNKNOWN
            self.ask("orientation", "bend.measures", mapping.MEASURES, column=column.text)
        # The limb is straight at 0, or in the first rows.
        scale = self._degrees_per_unit(column)
        rest = float(np.median(column.present[:10]))
        if not scale:
            self.ask("scale", f"bend.scale{axis}", ["1.0", "57.29578"], column=column.text)
            self.notes.append(f"bend.zero{axis}: the first number of {column.text}, {rest:.4g}")
        elif abs(wrap_angle(rest * scale, 360.0)) > MAX_REST_BEND:
            self.ask("zero", f"bend.zero{axis}", [f"{rest:g}", "0.0"], columns=column.text)
        else:
            rest = 0.0
        return BendColumns(column.text, zero=rest, scale=scale, measures=measures)

    def _degrees_per_unit(self, column: Column) -> float:
        """Return the degrees of a unit of an angle; 0 if neither names nor numbers tell it."""
        name = column.name
        scale = DEGREES_PER_UNIT.get(name.unit, 1.0)
        says_angle = BEND in {name.role, *name.says} or not self.table.has_names
        says_angle &= bool(name.unit) or name.words != ["tip"]
        is_angle = says_angle and name.quantity in ("", "angle")
        if not is_angle or column.span * scale > MAX_BEND_RANGE:
            return 0.0
        # Numbers that stay small while wires are hot are radians, and whole numbers may be counts.
        is_small = float(np.abs(column.present - np.median(column.present)).max()) < MAX_RADIANS
        is_hot = max(self.temperatures.each("span"), default=0.0) > HOT_RISE
        is_hot &= bool(self.heats.any())
        if name.unit:
            return 0.0 if is_hot and column.span * scale < MIN_RANGE else scale
        if is_small:
            return DEGREES_PER_UNIT["rad"] if is_hot and column.span > MIN_RADIANS else 0.0
        return 0.0 if bool((column.present % 1 == 0).all()) else scale

    # Sides.

    def find_sides(self, log_mapping: LogMapping) -> None:
        """Turn the bend so that it grows where the right wire is heated, if all wires say so.

        If no name has a side, the bend keeps its sign and names the wires: the right wire is the
        wire that bends the limb to positive angles.
        """
        bend = log_mapping.bend
        wires = log_mapping.wires[: len(self.duties)]
        if not wires:
            self._ask_sign(bend)
            return
        # Heat in seconds of full duty shows which wires bend the limb.
        tops = np.array(self.duties.each("top"))
        full = log_mapping.full or max(tops)
        doses = self.heats.sum(axis=1) * self.steps.step * tops / full
        is_heated = doses > (MIN_HEATED_TIME if max(doses) > MIN_HEATED_TIME else 0.0)
        # Wires without a side have the side of their thermocouples' names. If these have none,
        # begin with left and right; the bend tells whether they have to be exchanged.
        has_sides = self.limb.wire_names == [LEFT, RIGHT]
        is_unnamed = has_sides and all(wire.name == UNKNOWN for wire in wires)
        sides = []
        for wire in wires:
            sides += self.temperatures.having("text", wire.temperature).each("name.side")
        is_nameless = is_unnamed and not any(sides) and len(wires) < 3
        if is_nameless:
            sides = list(SIDES[: len(wires)])
        if is_unnamed and all(sides) and len(set(sides)) == len(wires):
            for wire, side in zip(wires, sides, strict=True):
                wire.name = side
        is_clear = True
        if not is_heated.any():
            self.notes.append("sign: no heat shows which way the limb bends; check bend.scale")
        elif not bend.scale or self._is_asked("bend.scale_e3"):
            is_clear = False
        else:
            votes = self._bend_votes(log_mapping)[is_heated]
            sign = float(np.sign(votes.sum()))
            is_clear = bool((sign * votes > MIN_VOTE).all()) and not self.is_inverted
            if not is_clear:
                self._ask_sign(bend)
            elif not is_nameless:
                bend.scale *= sign
                bend.scale_e3 *= sign
            elif sign < 0:
                for wire in wires:
                    wire.name = LEFT if wire.name == RIGHT else RIGHT
        # Ask for names that nothing tells.
        is_signed = len(set(self.duties)) < len(wires)
        for index, wire in enumerate(wires):
            if wire.name == UNKNOWN or (is_nameless and not is_clear):
                wire.name = UNKNOWN
                sign_text = "positive numbers of " if wire.sign > 0 else "negative numbers of "
                duty = f"{sign_text if is_signed else ''}{wire.duty}"
                choices = [*self.limb.wire_names, "none"]
                self.ask("wire", f"wires[{index}].name", choices, duty=duty)

    def _ask_sign(self, bend: BendColumns) -> None:
        """Ask for the sign of a bend, unless its scale is asked for already."""
        for field in ("scale", "scale_e3"):
            if scale := getattr(bend, field):
                choices = [f"{scale:g}", f"{-scale:g}"]
                self.ask("sign", f"bend.{field}", choices, columns=" and ".join(bend.columns))
                setattr(bend, field, 0.0)

    def _bend_votes(self, log_mapping: LogMapping) -> np.ndarray:
        """Return how clearly each wire bends the limb to its side (W,), in standard errors."""
        plain = dataclasses.replace(log_mapping.bend, measures=mapping.BEND_ANGLE)
        plain_mapping = dataclasses.replace(log_mapping, bend=plain)
        rows = bends_of(self.table, plain_mapping)[:, self.rows]
        bends = np.array(list(map(self.steps.means, rows)))
        lever_of_wire = {wire.name: wire.lever for wire in self.limb.wires}
        levers = np.ones((len(rows), len(self.heats)))
        warmth = self.heats.copy()
        for index, wire in enumerate(log_mapping.wires[: len(self.heats)]):
            if wire.name in lever_of_wire:
                levers[:, index] = lever_of_wire[wire.name][: len(rows)]
            for sensor in self.temperatures.moving.having("text", wire.temperature):
                warmth[index] = sensor.means
        return evidence.clear_votes(self.steps, [self.heats, warmth], bends, levers)

    # What is left over.

    def ask_about_the_rest(self) -> None:
        """Ask about what is left over and could be heat, or a wire's temperature."""
        # Wires without a thermocouple may have what warms with them.
        bare = [i for i in range(len(self.duties)) if not self.wires[i].temperature]
        for column in self.free.moving:
            name = column.name
            if not name.is_measured or name.role in (words.TIME, words.FRAME):
                continue
            # Heat that duties do not explain is of another wire.
            is_duty = name.role == DUTY
            if column.looks_like_heat or is_duty:
                if is_duty or self._is_followed(column):
                    what = f" is a {name.quantity}, but" if name.quantity else ""
                    field = f"wires[{len(self.wires)}].name"
                    choices = [*self.limb.wire_names, "none"]
                    self.wires.append(WireColumns(UNKNOWN, column.text))
                    self.ask("heat", field, choices, column=column.text, what=what)
            elif bare and name.role in ("", TEMPERATURE):
                votes = column.votes(self.heats[bare])
                index = bare[int(votes.argmax())]
                if votes.max() > MIN_VOTE:
                    self._ask_temperature(index, [column])


def propose(table: LogTable, limb: LimbParameters | None, dictionary: words.Dictionary) -> Proposal:
    """Return what the columns of a log of a limb, or of the nominal limb, seem to be."""
    columns = Columns(table, limb, dictionary)
    columns.find_duties()
    columns.find_temperatures()
    columns.find_inversion()
    full = columns.full_duty()
    columns.pair_wires_with_thermocouples()
    columns.find_units()
    bend = columns.bend()
    columns.ask_about_the_rest()
    missing = list(map(str, columns.missing))
    log_mapping = LogMapping(columns.time, columns.wires, bend, full, missing=missing)
    columns.find_sides(log_mapping)
    return columns.proposal("", log_mapping)


def _full_scale(duties: list[Column], levels: np.ndarray) -> float:
    """Return the number of full duty; 0 if neither names nor numbers tell it.

    Programs set duty in hundredths. Whole numbers that are all rounded hundredths of a counter are
    counts of it: of 255, two of five numbers are hundredths, and of 1023 one of ten. ``levels`` are
    the numbers in the duties but 0, without a sign.
    """
    # Names may have a range, such as 0..255, or a unit.
    most = float(levels.max())
    says = set()
    ranges = set()
    for column in duties:
        says |= {*column.name.says, column.name.unit}
        ranges |= set(re.findall(r"\b0 ?(?:-|\.\.|to) ?(\d+)\b", column.text))
    if len(ranges) == 1:
        full = float(min(ranges))
        return full if most <= 1.001 * full else 0.0
    if says & {"per cent", "%"}:
        return 100.0 if 1.0 < most <= 100.1 else 0.0
    if says & {"power duty", "power", "W"}:
        return 0.0
    # Shares of 1 or 100, or the most that a counter has, tell it themselves.
    is_whole = bool((levels % 1 == 0).all())
    is_pwm = any("pwm" in column.name.words for column in duties)
    if most <= 1.0:
        return 1.0
    if not is_whole:
        return 100.0 if MAX_VOLTS < most <= 100.1 else 0.0
    if most in COUNTED_SCALES or (most == 100.0 and "share" in says):
        return most
    # Else all numbers are hundredths of one counter alone; a "pwm" has 8 bits if 7 are too few.
    fits = []
    for scale in COUNTED_SCALES:
        hundredths = scale * np.round(levels * 100 / scale) / 100
        if most <= scale and (np.abs(hundredths - levels) < 0.5 + 1e-6).all():
            fits.append(scale)
    is_in_fives = bool((levels % 5 == 0).all())
    may_be_few = (is_pwm or most > 100.0) and not is_in_fives
    if len(fits) == 1 and len(levels) >= (MIN_LEVELS[0] if may_be_few else MIN_LEVELS[1]):
        return fits[0]
    return 255.0 if is_pwm and 127.0 < most <= 255.0 else 0.0
