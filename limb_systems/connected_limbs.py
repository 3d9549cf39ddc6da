"""Limbs that are connected, such as a robot's limbs, for code that handles single limbs."""

import importlib.metadata
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, Self

from limb_systems.files.described import Described, ParameterError
from limb_systems.files.input import read_text
from limb_systems.limb_parameters import LimbParameters

ENTRY_POINTS = "soft_limb.connected_limbs"
# Fields at the top level of a description that only connected limbs have.
CONNECTED_FIELDS = {"body", "limbs", "feet", "ground"}


def connected(name: str) -> Any:
    """Return the object that an installed package registers for connected limbs.

    The group of entry points ``soft_limb.connected_limbs`` has these names. An object is imported
    when it is needed:

    - ``description``: the subclass of `ConnectedLimbs` that files are read into.
    - ``view``: its `limb_systems.views.limb_view.LimbView`, made from a Meshcat and a description.
    - ``panels``: function of a description and a motion that returns the panels of signals that
      no single limb has.
    - ``emulation``: its emulation, made like `hardware.LimbTwin`.
    - ``specimen``: its `hardware.emulation.specimen.Specimen`; its method ``limb(name)`` returns
      the specimen of one limb that is taken off.

    Raises:
        ParameterError: if no package registers the name.
    """
    for entry in importlib.metadata.entry_points(group=ENTRY_POINTS, name=name):
        return entry.load()
    raise ParameterError(
        f"These limbs are connected, but no installed package has the {name} of connected limbs; "
        "install soft-limb again."
    )


class NamedLimb(Protocol):
    """A limb of several: its name, and its parameters as a limb by itself."""

    name: str
    parameters: LimbParameters


class ConnectedLimbs(Described):
    """The description of limbs that are connected, as code for single limbs uses it.

    Code about wires, joints and bends uses `as_single_limb`, a single limb that has the segments of
    all limbs. See `connected` for the parts that an installed package adds.

    - ``limbs``: the limbs with their names; wires, bends and joints are in their order.
    """

    limbs: Sequence[NamedLimb]

    @classmethod
    def registered(cls) -> type["ConnectedLimbs"]:
        """Return the class that the installed package registers; errors as in `connected`."""
        return connected("description")

    @property
    def is_limb(self) -> bool:
        """True if there is one clamped limb, which `as_single_limb` describes completely."""
        raise NotImplementedError

    @property
    def as_single_limb(self) -> LimbParameters:
        """All limbs as a single limb: their segments in order, with the limbs' names."""
        raise NotImplementedError

    @property
    def wires_of(self) -> list[slice]:
        """The slice of each limb's wires in the wires of `as_single_limb`."""
        raise NotImplementedError

    def limb(self, name: str) -> LimbParameters:
        """Return the parameters of a limb as part of the whole.

        Raises:
            ParameterError: if there is no limb of this name.
        """
        raise NotImplementedError

    def limb_alone(self, name: str) -> LimbParameters:
        """Return the parameters of a limb that is taken off; errors as in `limb`."""
        raise NotImplementedError

    def with_limbs(self, limbs: Mapping[str, LimbParameters]) -> Self:
        """Return a copy whose limbs are replaced by limbs that were calibrated alone, by name."""
        raise NotImplementedError

    def signal_columns(self) -> dict[str, list[str]]:
        """Return the names of the columns of each signal that no single limb has."""
        raise NotImplementedError

    def pose_rows(self) -> list[tuple[str, str, float]]:
        """Return name, unit and scale from SI of each row of the body's pose."""
        raise NotImplementedError

    def surroundings(self) -> str:
        """Return a text that names the ground."""
        raise NotImplementedError

    def commands_after_fit(self, path: Path) -> list[list[str]]:
        """Return the next commands, as lists of words, after its description is in a file."""
        raise NotImplementedError


def load_description(path: str | Path | None) -> LimbParameters | ConnectedLimbs:
    """Load a YAML file that describes a limb or connected limbs.

    Args:
        path: the file; the nominal limb if None.

    Raises:
        ParameterError: with one sentence naming the file and the field.
    """
    if path is None:
        return LimbParameters()
    if not CONNECTED_FIELDS & top_level_fields(read_text(path, "parameters", ParameterError)):
        return LimbParameters.load(path)
    connected = ConnectedLimbs.registered().load(path)
    return connected.limbs[0].parameters if connected.is_limb else connected


def top_level_fields(text: str) -> set[str]:
    """Return the names of the fields at the top level of a YAML text."""
    return set(re.findall(r"^\{?(\w+):", text, re.MULTILINE))
