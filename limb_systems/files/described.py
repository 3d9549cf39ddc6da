"""Descriptions that have a YAML file of their own, and the checks that all of them share."""

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
from limb_systems.files.schema import Strict, dump_typed, field_names, load_typed

MAX_DENSITY = 20.0  # relative to water; iridium has 22


class ParameterError(LimbError):
    """A limb description is missing, malformed or outside its range."""


class Described(Strict):
    """A description with a YAML file of its own: of a limb, or of a robot."""

    @classmethod
    def of(cls, described: Self | str | Path | None) -> Self:
        """Return a valid copy of parameters, of a YAML file, or of the default parameters for None.

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
        # Copy, so that later changes do not reach the caller's object.
        parameters = copy.deepcopy(described) if described is not None else cls()
        parameters.validate()
        return parameters

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read and validate a YAML file, with warnings for implausible values.

        Raises:
            ParameterError: with one sentence naming the file and the field.
        """
        text = read_text(path, "parameters", ParameterError)
        # Tables of the package have their kind in the first line; robots alone have limbs.
        line = first_line(text)
        kind = line.kind if line else ""
        fields = field_names(cls)  # type: ignore[arg-type]
        if "limbs" not in fields and re.search("^limbs:", text, re.MULTILINE):
            kind = "robot of several limbs"
        if kind:
            raise ParameterError(
                f"{path} is a {kind}; a limb is described by a YAML file, such as soft-limb "
                "fit or LimbParameters.save writes."
            )
        with reraise_as(ParameterError, f"{path}: "):
            parameters = cls.from_yaml(text)
        for warning in parameters.plausibility_warnings():
            warnings.warn(f"{path}: {warning}", stacklevel=2)
        return parameters

    @classmethod
    def from_yaml(cls, text: str) -> Self:
        """Parse YAML text; missing fields have their defaults, unknown fields are refused.

        Raises:
            ParameterError: with one sentence naming the field.
        """
        with reraise_as(ParameterError):
            parameters = load_typed(cls, text)
        parameters.validate()
        return parameters

    def save(self, path: str | Path) -> None:
        """Validate the description, then write a YAML file whole or not at all."""
        write_atomically(path, self.to_yaml())

    def to_yaml(self) -> str:
        """Return the YAML text of these parameters, every float exact."""
        self.validate()
        return dump_typed(self)

    @property
    def digest(self) -> str:
        """The first 12 hex digits of the SHA-256 of the YAML text, without provenance."""
        text = self.without_provenance().to_yaml()
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    def validate(self) -> None:
        """Raise ParameterError for the first field that is out of its range."""
        raise NotImplementedError

    def plausibility_warnings(self, where: str = "") -> list[str]:
        """Return sentences on values that are possible but rare.

        Args:
            where: text before the names of fields.
        """
        raise NotImplementedError

    def without_provenance(self) -> Self:
        """Return these parameters without provenance, for comparisons."""
        raise NotImplementedError


def check_density(mass: float, sizes: dict[str, float], where: str) -> None:
    """Raise ParameterError if a mass, kg, is too much for a box of named sizes, m."""
    density = mass / (1000.0 * math.prod(sizes.values()))  # relative to water
    if density > MAX_DENSITY:
        *names, last = sizes
        raise ParameterError(
            f"{where}.mass is {mass:g} kg, {density:.0f} times the water that its "
            f"{', '.join(names)} and {last} hold; is it in grams, or are they not in m?"
        )


def check_name(names: list[str], index: int, where: str, thing: str, taken: str = "") -> None:
    """Raise ParameterError if a name is malformed, or not unique among the names before it.

    Args:
        names: the names of all things of one kind.
        index: index of the name to check.
        where: place of the thing in the description, for the message.
        thing: kind of the thing, for the message.
        taken: a name that is reserved; empty if there is none.
    """
    name = names[index]
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) or name == taken:
        exception = f" other than {taken!r}" if taken else ""
        raise ParameterError(
            f"{where}.name is {name!r}; it must be of letters, digits and underscores{exception}, "
            "as it names columns in files."
        )
    if name in names[:index]:
        raise ParameterError(
            f"{where}.name is {name!r}, but another {thing} has this name; give each {thing} its "
            "own."
        )
