"""Read what the words and units in a column's name say, by the dictionary in `dictionary.yaml`."""

import dataclasses
import functools
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import yaml

from limb_systems.errors import LimbError
from limb_systems.files.input import read_text

DUTY = "duty"
TEMPERATURE = "temperature"
BEND = "bend"
TIME = "time"
FRAME = "frame"
LEFT = "left"
RIGHT = "right"
LABEL_LETTERS = "abcdegh"  # of wires, as in "PWM A"
_DATA = yaml.safe_load(Path(__file__).with_name("dictionary.yaml").read_text(encoding="utf-8"))
WORDS: dict[str, list[str]] = {
    key: words.split() for key, words in (_DATA["words"] | _DATA["quantities"]).items()
}
_NAME_WORDS = ("in", "min", "rh", "a", "g", "s", "m", "h", "d", "n", "j")
_PER_SECOND = re.compile(r"(?<![a-z])(deg|rad|°|mm|m|c|k)[_ ]?(per|p|/|_)_?s(ec)?\b")
_PARTS = re.compile(r"[A-ZÄÖÜ]?[a-zäöüßéèê]+|[A-ZÄÖÜ]+(?![a-zäöüé])|\d+|%|[^\x00-ɏ]+")


class Dictionary:
    """Words by what they say.

    Args:
        own: further words of a lab, by the keys of `WORDS`, such as ``{"duty": ["Brenner"]}``.
    """

    def __init__(self, lab_words: Mapping[str, Iterable[str]] | None = None):
        self.words = {key: list(words) for key, words in WORDS.items()}
        for key, further in (lab_words or {}).items():
            if key not in self.words:
                raise LimbError(f"the dictionary has no {key!r}; it has {', '.join(self.words)}.")
            self.words[key] += [str(word).lower() for word in further]
        self.known = {word for words in self.words.values() for word in words} | {"t"}

    @classmethod
    def load(cls, path: str | Path) -> "Dictionary":
        """Read a lab's own words: a YAML file such as ``duty: [brenner]``.

        Raises:
            LimbError: with one sentence, if it is of another form.
        """
        try:
            lab_words = yaml.safe_load(read_text(path, "dictionary", LimbError))
        except yaml.YAMLError as error:
            raise LimbError(f"{path}: not valid YAML: {' '.join(str(error).split())}.") from error
        if not isinstance(lab_words, dict) or not all(
            isinstance(words, list) for words in lab_words.values()
        ):
            raise LimbError(f"{path} must have lists of words, such as 'duty: [brenner]'.")
        return cls(lab_words)

    def has(self, key: str, words: Iterable[str]) -> bool:
        """Return whether one of some words says this."""
        return not set(words).isdisjoint(self.words[key])

    def split(self, name: str) -> list[str]:
        """Return the words and numbers of a name, in small letters."""
        plain = re.sub(r"(?i)max(6675|318\d\d)", " thermocouple ", name)  # chips
        pieces: list[str] = []
        for part in _PARTS.findall(re.sub("([左右])", r" \1 ", plain)):
            pieces += self._pieces(part)
        return pieces

    def _pieces(self, part: str) -> list[str]:
        """Return the known words that a word is made of, or the word: "leftpwm", "tempL", "TL"."""
        word = part.lower()
        if word in self.known:
            return [word]
        for cut in range(len(word) - 1, 0, -1):
            first = word[:cut]
            last = word[cut:]
            is_side = last in ("l", "r") and (cut > 2 or (part.isupper() and part.isascii()))
            is_word = last in self.known and (min(cut, len(last)) > 2 or not word.isascii())
            if first in self.known and (is_side or is_word):
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
def parse_unit(text: str) -> tuple[str, str]:
    """Return the quantity of a unit, and the unit as mappings have it; empty if not known."""
    plain = plain_unit(text)
    for quantity, units in _DATA["units"].items():
        for unit, written in units.items():
            if plain in written.split():
                return quantity, unit
    return "", ""


@dataclasses.dataclass(frozen=True)
class Name:
    """The meaning of a column's name.

    - ``text``: the name.
    - ``words``: its words in small letters, without numbers.
    - ``stem``: its words without side, number and unit: like columns have one stem.
    - ``label``: "left" or "right", else the number or letter of the wire, if any.
    - ``axis``: "x", "y" or "z"; empty if it has none.
    - ``unit``: its unit as mappings have it; empty if it has none.
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
    def of(
        cls, text: str, unit: str, column_names: Iterable[str], dictionary: Dictionary
    ) -> "Name":
        """Return what a name says.

        Args:
            unit: unit in a row of units or in the cells; empty if there is none.
            column_names: all columns' names; they tell whether a last letter is a unit or a wire.
        """
        bare, own_unit = _without_unit(text, column_names)
        quantity, unit = parse_unit(unit or own_unit)
        tokens = dictionary.split(bare)
        words = [token for token in tokens if not token.isdigit()]
        # Find the wire's label: a side, the last number, or a letter; long numbers are of chips.
        numbers = [token for token in tokens if token.isdigit() and len(token) < 3]
        letters = [word for word in words if word in LABEL_LETTERS and len(tokens) > 1]
        label_words = numbers[-1:] or letters[-1:]
        label = (numbers[-1].lstrip("0") or "0") if numbers else "".join(label_words)
        for side in (LEFT, RIGHT, "1", "2"):
            side_words = [word for word in words if word in dictionary.words[side]]
            if side_words and not (numbers and words in (["l"], ["r"])):
                label = side
                label_words = [*numbers[-1:], *side_words]
        axes = [word for word in words if word in ("x", "y", "z")][-1:]
        stem = [token for token in tokens if token not in (*label_words, *axes)]
        # Find what the column is.
        quantity = quantity or _quantity_of_name(text, words, dictionary)
        measured = not dictionary.has("not measured", words)
        role = _role_of_name(bare, words, quantity, dictionary) if measured else ""
        ranks = (
            [dictionary.words[role].index(w) for w in words if w in dictionary.words[role]]
            if role
            else []
        )
        if not unit:  # words may say the unit of the time or of temperatures
            by_words = [parse_unit(w) for w in words if len(w) > 1 or len(words) == 1]
            quantity_wanted = {BEND: "angle", TEMPERATURE: TEMPERATURE}.get(role, TIME)
            unit = next((side_words for of, side_words in by_words if of == quantity_wanted), "")
        axis = "".join(axes)
        rank = min(ranks, default=99)
        return cls(
            text, tuple(words), tuple(stem), label, axis, unit, quantity, role, rank, measured
        )

    @property
    def side(self) -> str:
        """The side that the name says, "left" or "right"; empty if it says none."""
        return self.label if self.label in (LEFT, RIGHT) else ""


def _without_unit(text: str, column_names: Iterable[str]) -> tuple[str, str]:
    """Return a name without the unit in it, and the unit; empty if it has none."""
    for match in re.finditer(r"[\[(]([^\])]*)[\])]", text):
        if parse_unit(match[1])[0]:
            return text.replace(match[0], " "), match[1]
    if _PER_SECOND.search(text.lower()):
        return text, "deg/s"
    start, mark, last = text.rpartition("_" if "_" in text else " ")
    # A last letter is a wire's if other columns end in "a" or "b".
    siblings = {column_name.lower() for column_name in column_names}
    is_lettered = len(last) == 1 and bool({f"{start}{mark}{x}".lower() for x in "ab"} & siblings)
    is_word = last.lower() in _NAME_WORDS and last.lower() not in ("s", "m")
    if not mark or is_word or is_lettered or not parse_unit(last)[0]:
        return text, ""
    return start, last


def _quantity_of_name(text: str, words: list[str], dictionary: Dictionary) -> str:
    """Return the quantity that the words of a name say; empty if they say none."""
    symbol = text.strip("0123456789_ ")
    if symbol in ("V", "I"):
        return "voltage" if symbol == "V" else "current"
    if dictionary.has("rate", words):
        return "rate"
    return next(
        (quantity for quantity in _DATA["quantities"] if dictionary.has(quantity, words)), ""
    )


def _role_of_name(text: str, words: list[str], quantity: str, dictionary: Dictionary) -> str:
    """Return the signal that a name is of; empty if its words and unit say none, or two."""
    roles = [role for role in (TEMPERATURE, DUTY, BEND, TIME, FRAME) if dictionary.has(role, words)]
    if text.strip().lower() == "x_value":  # LabVIEW's name for the time
        return TIME
    if by_unit := {TIME: TIME, TEMPERATURE: TEMPERATURE, "angle": BEND}.get(quantity):
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
    if DUTY in roles and BEND not in roles:
        return DUTY if quantity in ("", "share", "counts", "power") else ""
    if quantity == "share" and not roles:
        return DUTY
    return roles[0] if roles in ([TIME], [FRAME]) and not quantity else ""
