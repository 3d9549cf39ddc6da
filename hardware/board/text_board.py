"""Boards that speak lines of text, each described by a YAML file."""

import dataclasses
import functools
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hardware.board import port_keeper
from hardware.firmware import guard
from limb_systems import LimbError, LimbParameters, Trajectory
from limb_systems.bend_sensor import ChordSensor, TipTangentSensor
from limb_systems.files.input import read_text
from limb_systems.files.schema import SchemaError, Strict, load_typed, quantity, validate

UNUSED, BEND = "unused", "bend"
SENSORS = {"tip_tangent": TipTangentSensor, "chord": ChordSensor}
UNITS = {"deg": float(np.deg2rad(1.0)), "rad": 1.0}
_NUMBER = r"([-+]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|(?i:nan|inf)))"
DUTY = "duty_"  # before a wire's name, for the number that was last sent for it


class TextBoardError(LimbError):
    """The description of a text board is wrong, or does not go with a limb or a plan."""


@dataclasses.dataclass
class DutyLine(Strict):
    """The line that is sent, with a number for each channel.

    - ``prefix``, ``separator``, ``suffix``: texts before, between and after the numbers.
    - ``full``: number for duty 1, such as 1, 100 or 255.
    - ``decimals``: number of digits after the point.
    - ``on_off``: whether a channel can only be on or off: its number is then 0 or ``full`` in
      each line, so that the mean over lines is the duty.
    - ``end``: LF, CR, CRLF or none.
    - ``zero``: line in place of that with all duties zero, such as "stop"; None if it has none.
    """

    prefix: str = ""
    separator: str = " "
    suffix: str = ""
    full: float = quantity(1.0, "", 1e-3, 1e6)
    decimals: int = quantity(4, "", 0, 6)
    on_off: bool = False
    end: str = "LF"
    zero: str | None = None


@dataclasses.dataclass
class AnswerLine(Strict):
    """The line that the board sends: which of its numbers are what.

    - ``order``: name of each number in it, whatever text is before the first of them: a wire's
      name for its temperature, "bend", "duty_" and a wire's name for the number that the
      board last took for it, in the units of the line that is sent, or "unused".
    - ``pattern``: regular expression of all of the line, in place of an order, with groups of
      these names.
    - ``temperature_scale``, ``temperature_offset``: °C = scale · number + offset.
    - ``bend_unit``: deg or rad; the angle in it is ``bend_scale`` · number + ``bend_offset``. It
      is positive towards the right wire.
    - ``bend_of``: tip_tangent or chord, what the angle is of.
    """

    order: list[str] = dataclasses.field(default_factory=list)
    pattern: str | None = None
    temperature_scale: float = quantity(1.0, "°C", -1e6, 1e6)
    temperature_offset: float = quantity(0.0, "°C", -1e6, 1e6)
    bend_unit: str = "deg"
    bend_scale: float = quantity(1.0, "", -1e6, 1e6)
    bend_offset: float = quantity(0.0, "of bend_unit", -1e6, 1e6)
    bend_of: str = "tip_tangent"

    @functools.cached_property
    def expression(self) -> re.Pattern:
        """The regular expression of all of the line."""
        if self.pattern is not None:
            return re.compile(self.pattern)
        numbers = [
            r"\S+?" if name == UNUSED else _NUMBER.replace("(", f"(?P<{name}>", 1)
            for name in self.order
        ]
        return re.compile(r"[^\d.+-]*?" + r"[\s,;]+".join(numbers) + r"\s*")

    def read(self, line: str) -> dict[str, float] | None:
        """Return the readings in a line, or None if it is another line.

        Temperatures in °C have the wires' names, "bend" is in rad, and numbers of duty are as in
        the line.
        """
        if not (match := self.expression.fullmatch(line)):
            return None
        try:
            values = {name: float(text) for name, text in match.groupdict().items()}
        except (TypeError, ValueError):
            return None
        for name, value in values.items():
            if name == BEND:
                values[name] = UNITS[self.bend_unit] * (self.bend_scale * value + self.bend_offset)
            elif not name.startswith(DUTY):
                values[name] = self.temperature_scale * value + self.temperature_offset
        return values


@dataclasses.dataclass
class TextBoard(Strict):
    """A board that takes lines with duties, and may answer with lines of readings.

    Such a board has no watchdog that this package knows of. So it is said what may be asked of
    it, and what it does when nothing comes any more: these have no defaults.

    - ``name``: name of the limb on it, in recordings and plans.
    - ``channels``: wire's name at each channel of the line, or "unused".
    - ``most_duty``: largest duty of a wire.
    - ``longest``: longest time from arming, s.
    - ``timeout``: time after which the sketch switches off when no line comes, s; None (null)
      if it holds its last duty for ever.
    - ``line``: `DutyLine` that is sent.
    - ``answer``: `AnswerLine` that comes back; None if the board answers nothing.
    - ``baud_rate``: bit/s.
    - ``rate``: lines in a second, and so the shortest time that an on/off channel is on.
    - ``start_up``: time from opening the port until the sketch listens, s; many boards restart.
    - ``temperature_limit``: reading at which the wires are switched off, °C.
    """

    name: str
    channels: list[str]
    most_duty: float = quantity(dataclasses.MISSING, "of full duty", 0.0, 1.0)
    longest: float = quantity(dataclasses.MISSING, "s", 0.0, 1e5)
    timeout: float | None = quantity(dataclasses.MISSING, "s", 0.01, 3600.0)
    line: DutyLine = dataclasses.field(default_factory=DutyLine)
    answer: AnswerLine | None = None
    baud_rate: int = quantity(115200, "bit/s", 300, 4_000_000)
    rate: float = quantity(20.0, "Hz", 1.0, 200.0)
    start_up: float = quantity(2.0, "s", 0.0, 60.0)
    temperature_limit: float = quantity(guard.TEMPERATURE_LIMIT, "°C", 0.0, 200.0)

    @classmethod
    def of(cls, board: "TextBoard | str | Path") -> "TextBoard":
        """The description itself, once checked, or that in a YAML file.

        Raises:
            TextBoardError: with one sentence that names the field, and the file if there is one.
        """
        where = ""
        try:
            if not isinstance(board, TextBoard):
                where = f"{board}: "
                board = load_typed(cls, read_text(board, "text board", TextBoardError))
            return board._checked()
        except SchemaError as error:
            raise TextBoardError(f"{where}{error}") from error

    def _checked(self) -> "TextBoard":
        validate(self)
        for name, value, choices in (
            ("line.end", self.line.end, port_keeper.ENDS),
            ("answer.bend_unit", self.answer and self.answer.bend_unit, UNITS),
            ("answer.bend_of", self.answer and self.answer.bend_of, SENSORS),
        ):
            if value is not None and value not in choices:
                raise SchemaError(f"{name} is {value!r}; it must be one of {', '.join(choices)}.")
        if not re.fullmatch(r"\w+", self.name):
            raise SchemaError(f"name is {self.name!r}; it must be letters, digits and underscores.")
        if len(set(self.wires)) < len(self.wires):
            raise SchemaError(f"channels names a wire twice: {', '.join(self.channels)}.")
        if self.timeout is not None and self.timeout < 1.5 / self.rate:
            raise SchemaError(
                f"timeout is {self.timeout:g} s, but at a rate of {self.rate:g} Hz lines are "
                f"{1 / self.rate:g} s apart: the sketch would switch off between them."
            )
        if self.answer:
            self._check_answer(self.answer)
        return self

    def _check_answer(self, answer: AnswerLine) -> None:
        if bool(answer.order) == (answer.pattern is not None):
            raise SchemaError("answer must have either an order or a pattern.")
        try:
            names = list(answer.expression.groupindex)
        except re.error as error:
            where = "order" if answer.pattern is None else "pattern"
            raise SchemaError(f"answer.{where} cannot be read: {error}.") from error
        known = [*self.wires, BEND, *(DUTY + wire for wire in self.wires)]
        if not names or (unknown := set(names) - {*known}):
            raise SchemaError(
                f"answer names {', '.join(sorted(unknown)) if names else 'nothing'}; it must name "
                f"some of {', '.join(known)}."
            )
        if self.line.on_off and any(name.startswith(DUTY) for name in names):
            raise SchemaError(
                "answer names a duty, but line is on_off: what is on changes with each line, and "
                "says nothing; name that number unused."
            )

    @property
    def wires(self) -> list[str]:
        """Names of the wires at its channels."""
        return [name for name in self.channels if name != UNUSED]

    @property
    def answered(self) -> set[str]:
        """Names in its answers: of wires for their temperatures, "bend", "duty_" and a wire."""
        return set(self.answer.expression.groupindex) if self.answer else set()

    @property
    def unmeasured(self) -> list[str]:
        """The ports of a limb of which the board does not measure all."""
        ports = {"measured_temperature": self.wires, "bend_angle": [BEND]}
        return [port for port, parts in ports.items() if not self.answered.issuperset(parts)]

    @property
    def fate(self) -> str:
        """What the board does when no line arrives any more."""
        if self.timeout is None:
            return "the board holds its last duty for ever: switch off the wires' supply"
        return f"the board switches off by itself {self.timeout:g} s after the last line"

    def bytes_of(self, duty: Sequence[float]) -> bytes:
        """The line with the duty of each channel, in [0, 1]."""
        return port_keeper.encode(dataclasses.asdict(self.line), duty)

    def check_limb(self, limb: LimbParameters) -> None:
        """Raises TextBoardError unless the board has all wires of a limb, and reads its sensor."""
        if sorted(self.wires) != sorted(limb.wire_names):
            raise TextBoardError(
                f"The channels of the text board {self.name} are for {', '.join(self.wires)}, but "
                f"the limb's wires are {', '.join(limb.wire_names)}."
            )
        if not self.answer or BEND not in self.answered:
            return
        sensor, other = limb.segments[0].bend_sensor, SENSORS[self.answer.bend_of]
        if isinstance(sensor, tuple(SENSORS.values())) and not isinstance(sensor, other):
            raise TextBoardError(
                f"The text board {self.name} reads the bend as {self.answer.bend_of}, but the "
                f"limb's bend_sensor is a {type(sensor).__name__}; make it !{other.__name__}."
            )

    def check_plan(self, plan: Trajectory) -> None:
        """Raises TextBoardError if a plan asks for more duty or time than may be."""
        if (most := plan.duty.max()) > self.most_duty + 1e-6:
            raise TextBoardError(
                f"This trajectory has a duty of {most:.2f}, but most_duty of the text board "
                f"{self.name} is {self.most_duty:g}; plan another motion, or raise it if limb and "
                "supply are made for that."
            )
        if plan.duration > self.longest:
            raise TextBoardError(
                f"This trajectory takes {plan.duration:g} s, but longest of the text board "
                f"{self.name} is {self.longest:g} s; plan a shorter one, or raise it if somebody "
                "is there for so long."
            )

    def check_measures(self, ports: Sequence[str], who: str) -> None:
        """Raises TextBoardError if a port is needed of which the board does not measure all.

        Args:
            ports: names of output ports of a limb.
            who: name of what needs them.
        """
        words = {"measured_temperature": "temperatures of all wires", "bend_angle": "bend"}
        if missing := [words[port] for port in self.unmeasured if port in ports]:
            raise TextBoardError(
                f"{who} needs the {' and the '.join(missing)}, which the text board {self.name} "
                "does not answer with; with it only replay open loop works."
            )
