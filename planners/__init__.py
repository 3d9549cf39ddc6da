"""Feasible trajectories from references, by direct collocation (Sec. VI)."""

import importlib
from typing import Any

import lazy_loader

import limb_systems  # noqa: F401 - it reports modules that hide a package, before their import

# The names of `__init__.pyi`, each imported when it is first used: some take a second.
_lazy_name, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Return a public name; `plan_gait` is in `walking`."""
    if name == "plan_gait":
        return getattr(importlib.import_module("walking"), name)
    return _lazy_name(name)
