"""The physical quantity of a log's column, by the words and the unit in its name."""

import re

TIME, TEMPERATURE, ANGLE, SHARE, COUNTS = "time", "temperature", "angle", "duty", "counts"
POWER = "power"
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
WORDS = {  # in names, whole or as their parts
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
