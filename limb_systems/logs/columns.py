"""What a column of a log may be: its physical quantity by name and unit, and its numbers."""

import dataclasses
import functools
import re

import numpy as np

TIME, TEMPERATURE, ANGLE, SHARE, COUNTS = "time", "temperature", "angle", "duty", "counts"
POWER = "power"
DUTY, BEND = "duty", "bend"  # signals of no quantity of that name
ADMITTED = {  # quantities of each signal, that which says the signal first
    TIME: (TIME,),
    DUTY: (SHARE, COUNTS),
    TEMPERATURE: (TEMPERATURE,),
    BEND: (ANGLE,),
}
SIGNAL_WORDS = {  # in names, whole or as their parts: of a signal, whatever its quantity
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
SUBSTRING = 5  # characters from which on a word is found within another: "heizstrom"
UNITS = {  # of each quantity, in small letters
    TIME: "s ms us µs ns min h sec secs msec usec seconds sekunden millis micros",
    TEMPERATURE: "°c c degc °f f degf °k k kelvin celsius fahrenheit",
    ANGLE: "° deg degs degree degrees rad rads mrad mdeg grad",
    SHARE: "% percent pct %pwm 0-1 0..1 0-100 0..100 0-255 0..255",
    COUNTS: "count counts cts adc raw lsb bit bits ticks",
    "voltage": "v mv uv µv kv volt volts",
    "current": "a ma ua µa amp amps",
    POWER: "w mw kw watt watts",
    "energy": "j kj wh",
    "resistance": "ohm ohms ω kohm kω",
    "length": "m mm cm um µm in inch px pixel pixels",
    "curvature": "1/m m^-1 1/mm 1/cm",
    "pressure": "pa hpa kpa mpa bar mbar psi",
    "force": "n mn kn gf kgf",
    "torque": "nm n·m n*m mnm",
    "mass": "g kg",
    "rate": "deg/s °/s rad/s mm/s m/s °c/s c/s k/s dps rpm hz khz 1/s",
    "acceleration": "m/s² m/s^2 m/s2",
    "humidity": "%rh rh",
}  # fmt: skip
WORDS = {  # of each quantity, in names, whole or as their parts
    TIME: "time timestamp zeit uhrzeit datetime date elapsed ms us msec usec millis micros",
    TEMPERATURE: "temp temps tmp temperature temperatur celsius kelvin fahrenheit degc degf 温度",
    ANGLE: "angle winkel phi theta alpha tilt yaw pitch roll deg degrees rad radians mrad mdeg "
    "biegewinkel 角度",
    SHARE: "pwm duty duties",
    COUNTS: "adc count counts raw",
    "voltage": "voltage volt volts spannung tension vbat vin vcc vout battery supply mv",
    "current": "current strom amps ampere ma",
    POWER: "watt watts",
    "resistance": "resistance resistor widerstand ohm ohms kohm",
    "length": "position pos displacement distance deflection auslenkung abstand weg length mm cm "
    "px pixel meter meters metres",
    "curvature": "curvature courbure krümmung",
    "pressure": "pressure druck kpa psi mbar",
    "force": "force kraft load newton weight",
    "torque": "torque drehmoment",
    "rate": "rate speed velocity omega gyro dot dps rpm hz freq frequency geschwindigkeit",
    "acceleration": "acceleration accel acc",
    "humidity": "humidity feuchte rh",
    "index": "index idx sample frame seq counter row nr",
}
_LETTERS = {"v": "voltage", "m": "length"}  # units as the last part of a name, such as "tip_m"
_WORDS_AS_UNITS = ("in", "min", "rh")  # input, minimum, right heater
_PER_SECOND = re.compile(r"(deg|rad|°|mm|m|c|k)[_ ]?(per|p|/|_)_?s(ec)?\b")


def words_of(name: str) -> list[str]:
    """The parts of a name in small letters, without digits: "pwmLeft_2 (%)" has pwm, left and %."""
    parts = re.findall(r"[A-ZÄÖÜ]?[a-zäöü]+|[A-ZÄÖÜ]+(?![a-zäöü])|[°%]|max31855|[^\x00-ɏ]+", name)
    return [part.lower() for part in parts]


def has(words: list[str], known: str, substring: int = SUBSTRING) -> bool:
    """Whether a word is among those that are known, or has one of them in it."""
    return any(
        word == one or (len(one) >= substring and one in word)
        for word in words
        for one in known.split()
    )


def unit_quantity(text: str) -> str:
    """The quantity that a unit is of; empty if it is no unit that is known."""
    unit = text.strip(" []()").lower().replace("μ", "µ").replace("º", "°").replace("\u2103", "°c")
    return next((quantity for quantity, units in UNITS.items() if unit in units.split()), "")


def is_unit(text: str) -> bool:
    """Whether a cell is one of a row of units: a unit, or nothing in its place."""
    return text.strip(" []()") in ("", "-", "1", "--") or bool(unit_quantity(text))


def quantities_of(name: str, unit: str = "") -> tuple[set[str], str]:
    """The quantities that a column may be of, and what says so; none if nothing does.

    A unit says more than a name: "heater current [%]" is a share of something.

    Args:
        unit: unit in a row under the names; empty if there is no such row.
    """
    within = re.findall(r"[\[(]([^\])]*)[\])]", name)
    for text in [unit, *within]:
        if quantity := unit_quantity(text):
            return {quantity}, f"its unit {text.strip(' []()')}"
    if _PER_SECOND.search(name.lower()):
        return {"rate"}, "its name"
    last = re.split(r"[_ ]", name)[-1]
    is_word = last.lower() in _WORDS_AS_UNITS or (len(last) == 1 and last.isalpha())
    if not is_word and (quantity := unit_quantity(last)):
        return {quantity}, f"its unit {last}"
    words = words_of(name)
    found = {quantity for quantity, known in WORDS.items() if has(words, known)}
    if len(name) > 1 and name[-2] in "_ " and (letter := _LETTERS.get(last.lower())):
        found = {letter}
    if (symbol := name.strip("0123456789_ ")) in ("V", "I"):
        found = {"voltage" if symbol == "V" else "current"}
    found = {"rate"} if "rate" in found else found
    return found, "its name" if found else ""


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

    @classmethod
    def of(cls, name: str, unit: str, values: np.ndarray) -> "Column":
        """A column by its name and the unit under it, which may be empty."""
        return cls(name, words_of(f"{name} {unit}"), *quantities_of(name, unit), values)

    def said(self, role: str) -> bool:
        """Whether the name has a word of a role; a "t" with a number is no time."""
        if role == TIME and self.name.lower() == "t":
            return True
        return has(self.words, SIGNAL_WORDS[role], substring=4)

    def named(self, role: str) -> bool:
        """Whether the name has a word of a role, or its quantity is that which says the role."""
        return self.said(role) or ADMITTED[role][0] in self.quantities

    def contradicts(self, role: str) -> bool:
        """Whether its name or unit is of a quantity that a signal is not."""
        return bool(self.quantities) and not self.quantities.intersection(ADMITTED[role])

    @functools.cached_property
    def is_measured(self) -> bool:
        """Whether its name does not say that it is asked for, or of something else."""
        return not has(self.words, NOT_MEASURED, substring=4)

    @property
    def other_quantity(self) -> str:
        """What it is by its name or unit, in words; empty if these say nothing."""
        named = [q if q == COUNTS else f"a{'n' * (q[0] in 'aei')} {q}" for q in self.quantities]
        return f"{' or '.join(sorted(named))}, by {self.said_by}" if named else ""

    @functools.cached_property
    def shown(self) -> np.ndarray:
        """Its numbers without those that are missing."""
        return self.values[~np.isnan(self.values)]

    @functools.cached_property
    def span(self) -> float:
        """The distance from its lowest number to its highest."""
        return float(np.ptp(self.shown))

    @functools.cached_property
    def still(self) -> float:
        """The share of its numbers that are as the number before."""
        return float(np.mean(np.diff(self.shown) == 0))

    @functools.cached_property
    def off(self) -> float:
        """The share of its numbers that are 0."""
        return float(np.mean(self.shown == 0))

    @functools.cached_property
    def low_and_high(self) -> tuple[float, float]:
        """The number that 2% of its numbers are below, and the highest."""
        low, high = np.quantile(self.shown, [0.02, 1.0]).tolist()
        return low, high

    @property
    def is_warm(self) -> bool:
        """Whether its numbers can be of a thermocouple, in °C, °F or K."""
        low, high = self.low_and_high
        return -10.0 < low < 320.0 and high < 620.0

    @property
    def side(self) -> str:
        """The wire that its name says, "left" or "right"; empty if it says none."""
        name = self.name.lower()
        words = {*self.words, *re.findall(r"[lr](?=$|\d|_)", name.replace("ctrl", ""))}
        if words & {"l", "left", "links", "lt", "li", "rev"} or "left" in name:
            return "left"
        if words & {"r", "right", "rechts", "rt", "re", "fwd"} or "right" in name:
            return "right"
        return ""
