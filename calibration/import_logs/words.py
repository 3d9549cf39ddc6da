"""Read what the words and units in a column's name say, by the dictionary in `dictionary.yaml`."""

import copy
import functools
import itertools
import re
from collections.abc import Collection, Iterable, Mapping
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
SIDES = (LEFT, RIGHT)
ROLE_OF_QUANTITY = {TIME: TIME, TEMPERATURE: TEMPERATURE, "angle": BEND}
LABEL_LETTERS = tuple("abcdegh")  # of wires, as in "PWM A"
AXES = ("x", "y", "z")
_DATA = yaml.safe_load(Path(__file__).with_name("dictionary.yaml").read_text(encoding="utf-8"))
WORDS: dict[str, list[str]] = {
    key: words.split() for key, words in (_DATA["words"] | _DATA["quantities"]).items()
}
QUESTIONS: dict[str, str] = _DATA["questions"]
_NAME_WORDS = ("in", "min", "rh", "a", "g", "h", "d", "n", "j")  # units that names end in as words
_PER_SECOND = re.compile(r"(?<![a-z])(deg|rad|°|mm|m|c|k)[_ ]?(per|p|/|_)_?s(ec)?\b")
_CHUNKS = re.compile(r"[^\W\d_]+|\d+|%")
_CAMEL_PARTS = re.compile(r"[A-ZÄÖÜ]?[a-zäöüßéèê]+|[A-ZÄÖÜ]+(?![a-zäöüé])|[^\x00-ɏ]+")


class Dictionary:
    """Words by what they say.

    Args:
        lab_words: further words, by the keys of `WORDS`, such as ``{"duty": ["Brenner"]}``.
    """

    def __init__(self, lab_words: Mapping[str, Iterable[str]] | None = None):
        self.words = copy.deepcopy(WORDS)
        for key, further in (lab_words or {}).items():
            if key not in self.words:
                raise LimbError(f"the dictionary has no {key!r}; it has {', '.join(self.words)}.")
            self.words[key] += map(str.lower, map(str, further))
        self.all_words = {"t"}.union(*self.words.values())

    @classmethod
    def load(cls, path: str | Path) -> "Dictionary":
        """Read a lab's own words, such as ``duty: [brenner]`` in YAML; LimbError if it cannot."""
        try:
            data = yaml.safe_load(read_text(path, "dictionary", LimbError))
        except yaml.YAMLError as error:
            raise LimbError(f"{path}: not valid YAML: {' '.join(str(error).split())}.") from error
        is_dict = isinstance(data, dict)
        if not is_dict or not all(isinstance(words, list) for words in data.values()):
            raise LimbError(f"{path} must have lists of words, such as 'duty: [brenner]'.")
        return cls(data)

    def keys(self, words: Iterable[str]) -> set[str]:
        """Return what some words say, as keys of `WORDS`."""
        said = set(words)
        return {key for key, known in self.words.items() if not said.isdisjoint(known)}

    def split(self, name: str) -> list[str]:
        """Return the words and numbers of a name, in small letters."""
        plain = re.sub(r"(?i)max(6675|318\d\d)", " thermocouple ", name)  # chips
        tokens: list[str] = []
        for chunk in _CHUNKS.findall(re.sub("([左右])", r" \1 ", plain)):
            pieces = self._pieces(chunk)
            is_in_dictionary = len(pieces) > 1 or pieces[0] in self.all_words
            parts = [] if is_in_dictionary else _CAMEL_PARTS.findall(chunk)
            for part in parts or [chunk]:
                tokens += self._pieces(part)
        return tokens

    def _pieces(self, part: str) -> list[str]:
        """Return the known words that a word is made of, or the word: "leftpwm", "tempL", "TL"."""
        word = part.lower()
        if word in self.all_words:
            return [word]
        for cut in range(len(word) - 1, 0, -1):
            first = word[:cut]
            last = word[cut:]
            is_side = last in ("l", "r") and (cut > 2 or (part.isupper() and part.isascii()))
            is_word = last in self.all_words and (min(cut, len(last)) > 2 or not word.isascii())
            is_after_side = part[:cut] in ("L", "R") and last in self.all_words and len(last) > 2
            if first in self.all_words and (is_side or is_word or is_after_side):
                return [first, last]
        return [word]


@functools.lru_cache(maxsize=4096)
def parse_unit(text: str) -> tuple[str, str]:
    """Return the quantity of a unit, and the unit as mappings have it; empty if not known."""
    plain = re.sub(r"^deg(rees?)? ?(?=[cf]$)", "deg", text.strip(" []()").lower())
    plain = plain.replace("μ", "µ").replace("º", "°").replace("\u2103", "°c")
    for quantity, units in _DATA["units"].items():
        for unit, spellings in units.items():
            if plain in spellings.split():
                return quantity, unit
    return "", ""


def is_unit(text: str) -> bool:
    """Return whether a text is a unit."""
    return bool(parse_unit(text)[0])


class Name:
    """The meaning of a column's name.

    - ``text``: the name.
    - ``words``: its words in small letters, without numbers.
    - ``says``: what its words say, as keys of `WORDS`.
    - ``stem``: its words without side, number and unit: like columns have one stem.
    - ``label``: "left" or "right", else the number or letter of the wire, if any.
    - ``side``: the label if it is "left" or "right"; else empty.
    - ``order``: place of its wire among others: left, right, then by numbers or letters.
    - ``axis``: "x", "y" or "z"; empty if it has none.
    - ``place``: the point that it is a coordinate of.
    - ``unit``: its unit as mappings have it; empty if it has none.
    - ``quantity``: physical quantity by its unit, else by its words; empty if they say none.
    - ``role``: `DUTY`, `TEMPERATURE`, `BEND`, `TIME` or `FRAME`; empty if its words say none.
    - ``rank``: how well the words say the role: 0 is best.
    - ``is_measured``: False for setpoints, limits and the temperature of a room.
    """

    def __init__(
        self, text: str, dictionary: Dictionary, unit: str = "", column_names: Collection[str] = ()
    ):
        """Read a name; its unit may also be in a row of units or in the cells.

        All columns' names tell whether a last letter is a unit or a wire.
        """
        self.text = text
        bare, unit_in_name = _without_unit(text, column_names)
        unit_quantity, self.unit = parse_unit(unit or unit_in_name)
        tokens = dictionary.split(bare)
        numbers = list(filter(str.isdigit, tokens))
        self.words = list(itertools.filterfalse(str.isdigit, tokens))
        self.says = dictionary.keys(self.words)
        # Find the wire's label: a side, the last number, or a letter; long numbers are of chips.
        numbers = [number for number in numbers if len(number) < 3][-1:]
        letters = list(filter(LABEL_LETTERS.__contains__, self.words))[-1:]
        label_words = numbers or (letters if len(tokens) > 1 else [])
        self.label = "".join(label_words).lstrip("0") or "0" * len(numbers)
        for side in (*SIDES, "1", "2"):
            if side in self.says and not (numbers and self.words in (["l"], ["r"])):
                self.label = side
                label_words = [*numbers, *dictionary.words[side]]
        self.side = self.label if self.label in SIDES else ""
        self.order = (not self.side, self.label.zfill(3) if self.label.isdigit() else self.label)
        # What is left is the stem.
        axes = list(filter(AXES.__contains__, self.words))[-1:]
        self.axis = "".join(axes)
        self.stem = tuple(itertools.filterfalse([*label_words, *axes].__contains__, tokens))
        self.place = (self.stem, self.label)
        # Find what the column is.
        self.quantity = unit_quantity or self._quantity_of_words()
        self.is_measured = "not measured" not in self.says
        self.role = self._role() if self.is_measured else ""
        role_words = dictionary.words.get(self.role, [])
        known_words = filter(role_words.__contains__, self.words)
        self.rank = min(map(role_words.index, known_words), default=99)
        # Words may say the unit of the time or of temperatures.
        quantity_wanted = {BEND: "angle", TEMPERATURE: TEMPERATURE}.get(self.role, TIME)
        for word in self.words if not self.unit else ():
            word_quantity, word_unit = parse_unit(word)
            if word_quantity == quantity_wanted and (len(word) > 1 or len(self.words) == 1):
                self.unit = self.unit or word_unit

    def _quantity_of_words(self) -> str:
        """Return the quantity that the words of the name say; empty if they say none."""
        symbol = self.text.rstrip("0123456789_ ") if self.text[:1].isupper() else self.text
        if symbol in _DATA["symbols"]:
            return _DATA["symbols"][symbol]
        quantities = ("rate", *_DATA["quantities"])
        return next(filter(self.says.__contains__, quantities), "")

    def _role(self) -> str:
        """Return the signal that the name is of; empty if its words and unit say none, or two."""
        quantity = self.quantity
        if quantity in ROLE_OF_QUANTITY:
            return ROLE_OF_QUANTITY[quantity]
        roles = self.says & {TEMPERATURE, DUTY, BEND, TIME, FRAME}
        # "heater temperature" is a temperature, and "bend angle tip" a bend.
        if TEMPERATURE in roles or (not roles and "t" in self.words and not quantity):
            return TEMPERATURE if quantity in ("", "counts") else ""
        if roles == {BEND}:
            return BEND if quantity != "rate" else ""
        if BEND not in roles and (DUTY in roles or (quantity == "share" and not roles)):
            return DUTY if quantity in ("", "share", "counts", "power") else ""
        return roles.pop() if roles in ({TIME}, {FRAME}) and not quantity else ""


def _without_unit(text: str, column_names: Collection[str]) -> tuple[str, str]:
    """Return a name without the unit in it, and the unit; empty if it has none."""
    for match in re.finditer(r"[\[(]([^\])]*)[\])]", text):
        if is_unit(match[1]):
            return text.replace(match[0], " "), match[1]
    if _PER_SECOND.search(text.lower()):
        return text, "deg/s"
    start, mark, last = text.rpartition("_" if "_" in text else " ")
    # A last letter is a wire's if other columns end in "a" or "b".
    siblings = {f"{start}{mark}a".lower(), f"{start}{mark}b".lower()}
    is_lettered = len(last) == 1 and not siblings.isdisjoint(map(str.lower, column_names))
    if not mark or last.lower() in _NAME_WORDS or is_lettered or not is_unit(last):
        return text, ""
    return start, last
