"""The dictionary: what the words and units in a column's name say."""

import dataclasses
import functools
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import yaml

from limb_systems.errors import LimbError
from limb_systems.files.input import read_text

DUTY, TEMPERATURE, BEND, TIME, FRAME = "duty", "temperature", "bend", "time", "frame"
LEFT, RIGHT = "left", "right"
# Whole words, in small letters. The first words of a role say it best.
WORDS: dict[str, str] = {
    TIME: "time timestamp zeit uhrzeit datetime date datum zeitstempel stamp elapsed ms millis "
    "msec us micros sec secs seconds sekunden 時間",
    FRAME: "frame frames index idx sample samples bild coords seq counter row nr",
    DUTY: "pwm duty duties tastgrad tastverhältnis heat heater heaters heating heizung heiz "
    "heizer heizleistung ssr mosfet gate power pow leistung cmd cmds command commands control ctrl "
    "steuerung stellgrad stellgröße stellwert output outputs out u drive",
    TEMPERATURE: "temp temps tmp temperature temperatures temperatur tc thermocouple thermocouples "
    "thermo thermoelement thermistor ntc rtd mcp celsius kelvin fahrenheit degc degf probe "
    "sonde fühler 温度",
    BEND: "bend bends bending biegung biege biegewinkel angle angles winkel theta phi alpha flex "
    "tilt neigung yaw pitch roll imu orientation curvature krümmung courbure chord tangent "
    "bendlabs 角度 tip",
    "orientation": "yaw pitch roll imu orientation tilt neigung encoder",
    "tip tangent": "tip tangent alpha bendlabs",
    "thing": "wire wires draht coil coils spule sma muscle muskel actuator aktor channel kanal ch",
    "not measured": "setpoint set target ref reference desired limit max min goal error err "
    "unconstrained soll sollwert vorgabe cjc junction std stddev variance ambient room umgebung "
    "raum status state board cpu likelihood confidence",
    LEFT: "left l links linke linker linkes li 左",
    RIGHT: "right r rechts rechte rechter rechtes re 右",
    "1": "agonist ag",
    "2": "antagonist ant",
    "voltage": "voltage volt volts spannung tension vbat vin vcc vout battery supply mv vflex",
    "current": "current strom amps ampere ma",
    "power": "watt watts",
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
    "counts": "adc count counts raw",
}
QUANTITIES = tuple(list(WORDS)[-13:])
UNITS = {  # of each quantity, in small letters
    TIME: "s ms us µs ns min h sec secs msec usec seconds sekunden millis micros",
    TEMPERATURE: "°c c degc deg_c deg°c °f f degf deg_f °k k kelvin celsius fahrenheit",
    "angle": "° deg degs degree degrees rad rads radians mrad mdeg grad",
    "share": "% percent pct prozent %pwm 0-1 0..1 0-100 0..100 0-255 0..255",
    "counts": "count counts cts adc raw lsb bit bits ticks",
    "voltage": "v mv uv µv kv volt volts",
    "current": "a ma ua µa amp amps",
    "power": "w mw kw watt watts",
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
}
TEMPERATURE_UNITS = {
    "C": {"°c", "c", "degc", "deg_c", "deg°c", "celsius"},
    "F": {"°f", "f", "degf", "deg_f", "fahrenheit"},
    "K": {"°k", "k", "kelvin"},
}
_WORDS_AS_UNITS = ("in", "min", "rh", "a", "g", "s", "m", "h", "n", "j")  # rather words in names
_PER_SECOND = re.compile(r"(?<![a-z])(deg|rad|°|mm|m|c|k)[_ ]?(per|p|/|_)_?s(ec)?\b")
_PARTS = re.compile(r"[A-ZÄÖÜ]?[a-zäöüßéèê]+|[A-ZÄÖÜ]+(?![a-zäöüé])|\d+|%|[^\x00-ɏ]+")
_CAPITALS = re.compile(r"[A-Z]{2,}")
LABEL_LETTERS = "abcdegh"  # of wires, as in "PWM A"


class Dictionary:
    """Words by what they say.

    Args:
        own: further words of a lab, by the keys of `WORDS`, such as ``{"duty": ["Brenner"]}``.
    """

    def __init__(self, own: Mapping[str, Iterable[str]] | None = None):
        self.words = {key: known.split() for key, known in WORDS.items()}
        for key, more in (own or {}).items():
            if key not in self.words:
                raise LimbError(f"the dictionary has no {key!r}; it has {', '.join(self.words)}.")
            self.words[key] += [str(word).lower() for word in more]
        self.known = {word for words in self.words.values() for word in words} | {"t"}

    @classmethod
    def load(cls, path: str | Path) -> "Dictionary":
        """Read a lab's own words: a YAML file such as ``duty: [brenner]``.

        Raises:
            LimbError: with one sentence, if it is of another form.
        """
        try:
            own = yaml.safe_load(read_text(path, "dictionary", LimbError))
        except yaml.YAMLError as error:
            raise LimbError(f"{path}: not valid YAML: {' '.join(str(error).split())}.") from error
        lists = isinstance(own, dict) and all(isinstance(words, list) for words in own.values())
        if not lists:
            raise LimbError(f"{path} must have lists of words, such as 'duty: [brenner]'.")
        return cls(own)

    def has(self, key: str, words: Iterable[str]) -> bool:
        """Whether one of some words says this."""
        return not set(words).isdisjoint(self.words[key])

    def rank(self, role: str, words: Iterable[str]) -> int:
        """Return how well words say a role: 0 is best."""
        return min(self.words[role].index(word) for word in words if word in self.words[role])

    def split(self, name: str) -> list[str]:
        """Return the words and numbers of a name, in small letters."""
        found: list[str] = []
        plain = re.sub(r"(?i)max(6675|318\d\d)", " thermocouple ", name)  # chips
        for part in _PARTS.findall(re.sub("([左右])", r" \1 ", plain)):
            found += self._pieces(part)
        return found

    def _pieces(self, part: str) -> list[str]:
        """Return the known words that a word is made of, or the word: "leftpwm", "tempL", "TL"."""
        word = part.lower()
        if word in self.known:
            return [word]
        for cut in range(len(word) - 1, 0, -1):
            first, last = word[:cut], word[cut:]
            if first not in self.known:
                continue
            sides = last in "lr" and (cut > 2 or bool(_CAPITALS.fullmatch(part)))
            if sides or (last in self.known and (min(cut, len(last)) > 2 or not word.isascii())):
                return [first, last]
        return [word]


def place_of_label(label: str) -> tuple[int, str]:
    """Return the place of a wire among others: left, right, then by numbers or letters."""
    place = {LEFT: 0, RIGHT: 1}.get(label, 2)
    return place, label.zfill(3) if label.isdigit() else label


def plain_unit(text: str) -> str:
    """Return a unit in small letters, without brackets."""
    unit = re.sub(r"^deg(rees?)? ?(?=[cf]$)", "deg", text.strip(" []()").lower())
    return unit.replace("μ", "µ").replace("º", "°").replace("\u2103", "°c")


@functools.lru_cache(maxsize=4096)
def unit_quantity(text: str) -> str:
    """Return the quantity that a unit is of; empty if the unit is not known."""
    unit = plain_unit(text)
    return next((quantity for quantity, units in UNITS.items() if unit in units.split()), "")


def is_unit(text: str) -> bool:
    """Whether a cell is one of a row of units: a unit, or nothing in its place."""
    return text.strip(" []()") in ("", "-", "1", "--") or bool(unit_quantity(text))


@dataclasses.dataclass(frozen=True)
class Name:
    """What the name of a column says.

    - ``text``: the name.
    - ``words``: its words in small letters, without numbers.
    - ``stem``: its words without side, number and unit: like columns have one stem.
    - ``label``: "left" or "right", else the number or letter of the wire, if any.
    - ``axis``: "x", "y" or "z"; empty if it has none.
    - ``unit``: its unit, as `plain_unit`; empty if it has none.
    - ``quantity``: physical quantity by its unit, else by its words; empty if they say none.
    - ``role``: `DUTY`, `TEMPERATURE`, `BEND`, `TIME` or `FRAME`; empty if its words say none.
    - ``rank``: how well the words say the role: 0 is best.
    - ``is_measured``: False for setpoints, limits and the temperature of a room.
    """

    text: str
    words: tuple[str, ...]
    stem: tuple[str, ...]
    label: str
    axis: str
    unit: str
    quantity: str
    role: str
    rank: int
    is_measured: bool

    @classmethod
    def of(cls, text: str, unit: str, others: Iterable[str], known: Dictionary) -> "Name":
        """Return what a name says.

        Args:
            unit: unit in a row of units or in the cells; empty if there is none.
            others: names of all columns, which show whether a last letter is a unit or a wire's.
        """
        bare, own_unit = _without_unit(text, others)
        unit = plain_unit(unit or own_unit)
        tokens = known.split(bare)
        # Of several numbers, the last is the wire's; long ones are of chips, such as max31855.
        numbers = [token for token in tokens if token.isdigit() and len(token) < 3]
        words = [token for token in tokens if not token.isdigit()]
        label = numbers[-1].lstrip("0") or "0" if numbers else ""
        used = [numbers[-1]] if numbers else []
        for side in (LEFT, RIGHT, "1", "2"):
            own = [word for word in words if word in known.words[side]]
            only_letter = words in (["l"], ["r"]) and bool(numbers)
            if own and not only_letter:
                label = side
                used += own
        letters = [word for word in words if word in LABEL_LETTERS and len(word) == 1]
        if not label and letters and len(tokens) > 1:
            label = letters[-1]
            used.append(label)
        axes = [word for word in words if word in ("x", "y", "z")]
        stem = [token for token in tokens if token not in used and token not in axes[-1:]]
        quantity = _quantity(text, unit, words, known)
        measured = not known.has("not measured", words)
        role = _role(bare, words, quantity, known) if measured else ""
        rank = known.rank(role, words) if role and known.has(role, words) else 99
        return cls(
            text, tuple(words), tuple(stem), label, axes[-1] if axes else "", unit, quantity,
            role, rank, measured,
        )  # fmt: skip

    @property
    def side(self) -> str:
        """The side that the name says, "left" or "right"; empty if it says none."""
        return self.label if self.label in (LEFT, RIGHT) else ""

    @property
    def temperature_unit(self) -> str:
        """The unit of temperature that the name says, "C", "F" or "K"; empty if it says none."""
        words = {self.unit, *(set(self.words) & {"celsius", "fahrenheit", "kelvin"})}
        return next((unit for unit, known in TEMPERATURE_UNITS.items() if words & known), "")


def _without_unit(text: str, others: Iterable[str]) -> tuple[str, str]:
    """Return a name without the unit in it, and the unit; empty if it has none."""
    for match in re.finditer(r"[\[(]([^\])]*)[\])]", text):
        if unit_quantity(match[1]):
            return text.replace(match[0], " "), match[1]
    if _PER_SECOND.search(text.lower()):
        return text, "deg/s"
    start, mark, last = text.rpartition("_") if "_" in text else text.rpartition(" ")
    is_word = last.lower() in _WORDS_AS_UNITS and last.lower() not in ("s", "m")
    siblings = {other.lower() for other in others}
    lettered = bool({f"{start}{mark}{letter}".lower() for letter in "ab"} & siblings)
    if not mark or is_word or not unit_quantity(last) or (len(last) == 1 and lettered):
        return text, ""
    return start, last


def _quantity(text: str, unit: str, words: list[str], known: Dictionary) -> str:
    if quantity := unit_quantity(unit):
        return quantity
    if (symbol := text.strip("0123456789_ ")) in ("V", "I"):
        return "voltage" if symbol == "V" else "current"
    if known.has("rate", words):
        return "rate"
    return next((one for one in QUANTITIES if known.has(one, words)), "")


def _role(text: str, words: list[str], quantity: str, known: Dictionary) -> str:
    """Return the signal that a name is of; empty if its words and unit say none, or two."""
    if text.strip().lower() == "x_value":  # LabVIEW's name for the time
        return TIME
    by_unit = {TIME: TIME, TEMPERATURE: TEMPERATURE, "angle": BEND}.get(quantity, "")
    roles = [role for role in (TEMPERATURE, DUTY, BEND, TIME, FRAME) if known.has(role, words)]
    if by_unit:
        return by_unit
    # "heater temperature" is a temperature, and "bend angle tip" a bend.
    if TEMPERATURE in roles:
        return TEMPERATURE if quantity in ("", "counts") else ""
    if text.strip() in ("t", "s"):
        return TIME
    if not roles and "t" in words and not quantity:
        return TEMPERATURE
    if roles == [BEND]:
        return BEND if quantity != "rate" else ""
    if roles and roles[0] == DUTY and BEND not in roles:
        return DUTY if quantity in ("", "share", "counts", "power") else ""
    if quantity == "share" and not roles:
        return DUTY
    return roles[0] if len(roles) == 1 and roles[0] in (TIME, FRAME) and not quantity else ""
