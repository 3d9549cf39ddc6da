"""The limb as one object: its description, and all that follows from it, built once."""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.dynamics import Dynamics
from limb_systems.layout import Layout
from limb_systems.limb_mechanics import LimbMechanics
from limb_systems.limb_parameters import LimbParameters
from limb_systems.smooth_function import build_once
from limb_systems.static_equilibria import StaticEquilibria
from limb_systems.wires import Wires

T = TypeVar("T")


class LimbModel:
    """A limb and all that follows from its description.

    Each part is built when it is first used. Models of equal limbs share the parts that take
    long to build: wires, dynamics and statics. The description must not change while the model is
    in use.

    Args:
        parameters: description of the limb.
    """

    def __init__(self, parameters: LimbParameters):
        self.parameters = parameters

    @classmethod
    def of(cls, limb: "LimbModel | LimbParameters") -> "LimbModel":
        """Return the model of a limb: a model itself, or the model of a description."""
        return limb if isinstance(limb, LimbModel) else cls(limb)

    @classmethod
    def validated(cls, limb: "LimbModel | LimbParameters | str | Path | None") -> "LimbModel":
        """Return the model of a valid copy of a description.

        Args:
            limb: a description, or its YAML file; the nominal limb if None. A model is returned
                itself.

        Raises:
            ParameterError: if the description is invalid.
        """
        return limb if isinstance(limb, LimbModel) else cls(LimbParameters.of(limb))

    def __reduce__(self):
        """Copy and pickle the description alone; what follows from it is built again."""
        return LimbModel, (self.parameters,)

    @functools.cached_property
    def layout(self) -> Layout:
        """Indices of the wires, joints and bends."""
        return Layout(self.parameters)

    @functools.cached_property
    def mechanics(self) -> LimbMechanics:
        """Joints, springs and bodies."""
        return LimbMechanics(self.parameters, self.layout)

    @functools.cached_property
    def wires(self) -> Wires:
        """Heat and forces of the wires in their rubber."""
        return self.once("wires", lambda: Wires(self.parameters, self.mechanics))

    @functools.cached_property
    def dynamics(self) -> Dynamics:
        """The equation of motion."""
        return self.once("dynamics", lambda: Dynamics(self.mechanics, self.wires))

    @functools.cached_property
    def statics(self) -> StaticEquilibria:
        """The angles and bends in static equilibrium; the bends are angles of chords."""
        return self.once("statics", lambda: StaticEquilibria(self.dynamics))

    @functools.cached_property
    def mean_angle_statics(self) -> StaticEquilibria:
        """``statics`` with bends by (11) from the mean of the joints' angles."""
        return self.once(
            "mean angles", lambda: StaticEquilibria(self.dynamics, of_equal_angles=True)
        )

    def once(self, name: str, build: Callable[[], T]) -> T:
        """Return a part of the model; equal limbs share it, so that it is built once.

        Args:
            name: name of the part.
            build: function that builds it.
        """
        return build_once((name, *self._key), build)

    @functools.cached_property
    def _key(self) -> tuple:
        """All that the equations depend on; limbs of equal keys share their parts."""
        plain = dataclasses.replace(self.parameters, calibration=None)
        # Laws of a lab's own may have equal texts.
        laws = [type(wire.law) for wire in plain.wires]
        return repr(plain), *laws


def split_state(
    limb: LimbParameters | LimbModel, state: ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return θ (n), θ̇ (n), x (N) and V (W) of a state of `Limb`, each (.., K).

    The states x of the wires begin with T (W).
    """
    layout = LimbModel.of(limb).layout
    n = layout.num_joints
    ends = [n, 2 * n, -layout.num_wires]
    angles, rates, wire, measured = np.split(np.asarray(state, float), ends)
    return angles, rates, wire, measured
