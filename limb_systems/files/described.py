"""Descriptions that have a YAML file of their own, and what is checked of all of them."""

import copy
import hashlib
import math
import re
import warnings
from pathlib import Path
from typing import Self

from limb_systems.errors import LimbError, reraise_as
from limb_systems.files.input import first_line, read_text
from limb_systems.files.output import write_atomically
from limb_systems.files.schema import Strict, dump_typed, load_typed

MAX_DENSITY = 20.0  # density over that of water; iridium has 22


class ParameterError(LimbError):
    """A limb description is missing, malformed or outside its range."""


class Described(Strict):
    """A description with a YAML file of its own: of a limb, or of a robot."""

    @classmethod
    def of(cls, described: Self | str | Path | None) -> Self:
        """A copy of parameters, those in a YAML file, or the default ones for None.

        Raises:
            ParameterError: if it is none of these, or out of its range.
        """
        if isinstance(described, str | Path):
            return cls.load(described)
        if not isinstance(described, cls | None):
            raise ParameterError(
                f"{cls.__name__} or the path of their YAML file are needed, but this is a "
                f"{type(described).__name__}."
            )
        parameters = copy.deepcopy(described) if described is not None else cls()
        parameters.validate()
        return parameters

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Reads and validates a YAML file, with a warning for what is possible, but odd.

        Raises:
            ParameterError: with one sentence naming the file and the field.
        """
        text = read_text(path, "parameters", ParameterError)
        if ours := first_line(text):
            raise ParameterError(
                f"{path} is a {ours.kind}; what describes a limb is a YAML file, such as soft-limb "
                "fit or LimbParameters.save writes."
            )
        with reraise_as(ParameterError, f"{path}: "):
            parameters = cls.from_yaml(text)
        for oddity in parameters.plausibility_warnings():
            warnings.warn(f"{path}: {oddity}", stacklevel=2)
        return parameters

    @classmethod
    def from_yaml(cls, text: str) -> Self:
        """Parses YAML text; fields that are left out have their defaults, unknown ones are refused.

        Raises:
            ParameterError: with one sentence naming the field.
        """
        with reraise_as(ParameterError):
            parameters = load_typed(cls, text)
        parameters.validate()
        return parameters

    def save(self, path: str | Path) -> None:
        """Validates, then writes a YAML file whole or not at all."""
        write_atomically(path, self.to_yaml())

    def to_yaml(self) -> str:
        """The YAML text of these parameters, every float exact."""
        self.validate()
        return dump_typed(self)

    @property
    def digest(self) -> str:
        """The first 12 hex digits of the SHA-256 of their YAML, without what made them."""
        text = self.without_provenance().to_yaml()
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    def validate(self) -> None:
        """Raises ParameterError for the first field that is out of its range."""
        raise NotImplementedError

    def plausibility_warnings(self, where: str = "") -> list[str]:
        """Sentences on what limbs can be, but rarely are, with this before the names of fields."""
        raise NotImplementedError

    def without_provenance(self) -> Self:
        """These parameters without what made them, for comparisons."""
        raise NotImplementedError


def check_density(mass: float, sizes: dict[str, float], where: str) -> None:
    """Raises ParameterError if a mass, kg, is too much for a box of named sizes, m."""
    times_water = mass / (1000.0 * math.prod(sizes.values()))
    if times_water > MAX_DENSITY:
        *names, last = sizes
        raise ParameterError(
            f"{where}.mass is {mass:g} kg, {times_water:.0f} times the water that its "
            f"{', '.join(names)} and {last} hold; is it in grams, or are they not in m?"
        )


def check_name(names: list[str], index: int, where: str, thing: str, taken: str = "") -> None:
    """Raises ParameterError if a name among those of things of one kind is not its own."""
    name = names[index]
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) or name == taken:
        other_than = f" other than {taken!r}" if taken else ""
        raise ParameterError(
            f"{where}.name is {name!r}; it must be of letters, digits and underscores{other_than}, "
            "as it names columns in files."
        )
    if name in names[:index]:
        raise ParameterError(
            f"{where}.name is {name!r}, but another {thing} has this name; give each {thing} its "
            "own."
        )
