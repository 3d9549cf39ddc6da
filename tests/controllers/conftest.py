"""The limbs that tests of controllers share."""

from collections.abc import Callable

from limb_systems import LimbParameters, WireLaw


def limb_of(law: Callable[[], WireLaw] | None = None, links=2, **segment) -> LimbParameters:
    """Return the nominal limb with few links, other wires and other properties of its segment."""
    parameters = LimbParameters()
    for name, value in {"links": links, **segment}.items():
        setattr(parameters.segments[0], name, value)
    for wire in parameters.wires:
        wire.law = law() if law else wire.law
    return parameters
