"""What the packages show to the outside says what it is: types and docstrings."""

import importlib
import inspect
import pkgutil
from pathlib import Path
from types import FunctionType

from .test_imports import PACKAGES

ROOT = Path(__file__).parents[1]


def test_public_names_have_docstrings():
    bare = [
        name
        for owner, value in exported()
        for name, part in [(owner, value), *public_parts(value, owner)]
        if not has_docstring(part)
    ]
    assert bare == []


def exported():
    """Names and values of all that packages export; the application is for its commands alone."""
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in getattr(module, "__all__", ()):
            yield f"{package}.{name}", getattr(module, name)


def test_public_functions_have_types():
    """In all modules; mypy sees to it that the types are right."""
    untyped = [
        name
        for package in PACKAGES
        for module in modules_of(package)
        for name, function in public_parts(module, module.__name__)
        if isinstance(function, FunctionType) and not is_typed(function)
    ]
    assert untyped == []


def modules_of(package):
    """All of a package's modules, those in its folders too, but the command and the board's."""
    root = importlib.import_module(package)
    yield root
    for info in pkgutil.walk_packages(root.__path__, f"{package}."):
        if not info.name.endswith(".__main__") and ".firmware" not in info.name:
            yield importlib.import_module(info.name)  # MicroPython has no annotations


def public_parts(owner, path):
    """Names and values of what a module or class defines, and of what classes in it do."""
    if not inspect.ismodule(owner) and not inspect.isclass(owner):
        return
    home = owner.__name__ if inspect.ismodule(owner) else owner.__module__
    for name, value in vars(owner).items():
        value = getattr(value, "fget", getattr(value, "__func__", value))
        if name.startswith("_") or getattr(value, "__module__", None) != home:
            continue
        if isinstance(value, FunctionType) or inspect.isclass(value):
            yield f"{path}.{name}", value
            yield from public_parts(value, f"{path}.{name}")


def has_docstring(part):
    written = part.__doc__ or ""
    return bool(written) and not written.startswith(f"{part.__name__}(")  # what dataclasses write


def is_typed(function):
    signature = inspect.signature(function)
    annotations = [
        p.annotation for name, p in signature.parameters.items() if name not in ("self", "cls")
    ]
    return signature.empty not in (*annotations, signature.return_annotation)
