"""What the packages show to the outside says what it is: types and docstrings."""

import ast
import dataclasses
import importlib
import inspect
import pkgutil
import re
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


def test_public_constructors_list_their_arguments():
    """Indented below "Args:", or else the API's pages run them together."""
    bare = []
    for name, value in exported():
        # Dataclasses generate theirs, and list the fields in the docstring of the class.
        if not inspect.isclass(value) or dataclasses.is_dataclass(value):
            continue
        constructor = value.__init__
        if isinstance(constructor, FunctionType) and constructor.__module__.startswith(PACKAGES):
            described = inspect.cleandoc(constructor.__doc__ or value.__doc__)
            if not re.search(r"^Args:\n    \w", described, re.MULTILINE):
                bare.append(name)
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


def test_lines_of_docstrings_are_understood_alone():
    """Noun first: "limb that was replayed", not "of the limb", whatever stands before."""
    bare = [
        f"{path.relative_to(ROOT)}, {name}: {line}"
        for folder in (*PACKAGES, "examples")
        for path in sorted((ROOT / folder).rglob("*.py"))
        for name, text in docstrings(ast.parse(path.read_text(encoding="utf-8")))
        for line in [text.splitlines()[0], *lines_on_fields(text)]
        if re.match(r"(of|by|that|those|which|for)\b", line, re.IGNORECASE)
    ]
    assert bare == []


def docstrings(tree, path=""):
    """Names and docstrings of a module or class, and of all that is public in it."""
    if text := ast.get_docstring(tree):
        yield path, text
    for node in tree.body:
        name = getattr(node, "name", "_")
        if isinstance(node, ast.ClassDef) and not name.startswith("_"):
            yield from docstrings(node, f"{path}.{name}")
        elif isinstance(node, ast.FunctionDef) and (name == "__init__" or name[0] != "_"):
            yield f"{path}.{name}", ast.get_docstring(node) or "-"


def lines_on_fields(text):
    """What is said on fields, "- ``x``: ...", and on arguments, indented below "Args:"."""
    arguments = "".join(re.findall(r"^Args:\n((?:    .*\n?)+)", text, re.MULTILINE))
    return [
        *re.findall(r"^ *- ``.+?``(?:, ``.+?``)*(?: \(.*?\))?: +(\S.*)$", text, re.MULTILINE),
        *re.findall(r"^    (?=\S)[\w, *]+: +(\S.*)$", arguments, re.MULTILINE),
    ]
