"""Limbs that are connected, such as those of a robot, for code that handles single limbs."""

import importlib.metadata
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, Self

from limb_systems.files.described import Described, ParameterError
from limb_systems.files.input import read_text
from limb_systems.limb_parameters import LimbParameters

ENTRY_POINTS = "soft_limb.connected_limbs"
# Fields at the top level that a description of connected limbs has, and that of a limb has not.
FIELDS = {"body", "limbs", "feet", "ground"}


def connected(name: str) -> Any:
    """Return what an installed package has for connected limbs, by the name of its entry point.

    The group ``soft_limb.connected_limbs`` has these, which are imported when they are needed:

    - ``description``: the subclass of `ConnectedLimbs` that files are read into.
    - ``view``: its `limb_systems.views.limb_view.LimbView`, made from a description and a root.
    - ``panels``: function of a description and a motion that returns the panels of what no single
      limb has.
    - ``emulation``: its emulation, made like `hardware.LimbTwin`.
    - ``specimen``: its `hardware.emulation.specimen.Specimen`, whose ``limb(name)`` is that of a
      limb which is taken off.

    Raises:
        ParameterError: if no package has it.
    """
    for entry in importlib.metadata.entry_points(group=ENTRY_POINTS, name=name):
        return entry.load()
    raise ParameterError(
        f"These limbs are connected, but no installed package has the {name} of such; install "
        "soft-limb again."
    )


class NamedLimb(Protocol):
    """A limb among others: its name, and its parameters as those of a limb alone."""

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
        """Return the class of the installed package; errors as of `connected`."""
        return connected("description")

    @property
    def is_limb(self) -> bool:
        """Whether this is one limb that is held, and `as_single_limb` describes all of it."""
        raise NotImplementedError

    @property
    def as_single_limb(self) -> LimbParameters:
        """All limbs as a single one: their segments in order, with the limbs' names."""
        raise NotImplementedError

    @property
    def wires_of(self) -> list[slice]:
        """Places of each limb's wires among those of all."""
        raise NotImplementedError

    def limb(self, name: str) -> LimbParameters:
        """Return the parameters of a limb as part of the whole; ParameterError for no such name."""
        raise NotImplementedError

    def limb_alone(self, name: str) -> LimbParameters:
        """Return the parameters of a limb that is taken off; ParameterError for no such name."""
        raise NotImplementedError

    def with_limbs(self, limbs: Mapping[str, LimbParameters]) -> Self:
        """Return the same with limbs that were calibrated alone, by name."""
        raise NotImplementedError

    def signal_columns(self) -> dict[str, list[str]]:
        """Return the names of the columns of each signal that no single limb has."""
        raise NotImplementedError

    def pose_rows(self) -> list[tuple[str, str, float]]:
        """Return name, unit and scale from SI of each row of the body's pose."""
        raise NotImplementedError

    def surroundings(self) -> str:
        """Return what it stands on, in words."""
        raise NotImplementedError

    def commands_after_fit(self, path: Path) -> list[list[str]]:
        """Return the words of commands that go on with its description in a file."""
        raise NotImplementedError


def load_description(path: str | Path | None) -> LimbParameters | ConnectedLimbs:
    """Return what a YAML file describes: a limb, or limbs that are connected.

    Args:
        path: the file; the nominal limb if None.

    Raises:
        ParameterError: with one sentence naming the file and the field.
    """
    if path is None:
        return LimbParameters()
    if not describes_connected(read_text(path, "parameters", ParameterError)):
        return LimbParameters.load(path)
    connected = ConnectedLimbs.registered().load(path)
    return connected.limbs[0].parameters if connected.is_limb else connected


def describes_connected(text: str) -> bool:
    """Return whether the YAML text of a description is that of limbs that are connected."""
    return bool(FIELDS & set(re.findall(r"^\{?(\w+):", text, re.MULTILINE)))
