"""A soft limb bent by shape-memory-alloy wires, as Drake systems."""

import importlib
from typing import Any

import lazy_loader

from limb_systems.shadows import check_shadows

check_shadows()

# What `__init__.pyi` imports, each name when it is first used: some take a second.
_own_name, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Return a public name; `Robot` and `RobotParameters` are in `walking`."""
    if name in ("Robot", "RobotParameters"):
        return getattr(importlib.import_module("walking"), name)
    return _own_name(name)
