"""Who imports whom: packages only what is below them, and no modules in a circle."""

import ast
import graphlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# From the ground up: a package imports itself and those before it, and nothing imports the last.
PACKAGES = (
    "urdf",
    "limb_systems",
    "planners",
    "controllers",
    "hardware",
    "calibration",
    "walking",
    "soft_limb",
)
# `Robot`, `RobotParameters` and `plan_gait` of `walking` are names of these, too.
SHOW_WALKING = ("limb_systems", "planners")
# Commands on robots are plug-ins of the command line, which finds them by entry points.
WALKING_COMMANDS = "walking.commands"
# What a room imports beside itself; the robot, the emulation and the board know nothing of each
# other but what the board and its host both need to speak.
CLOSED_ROOMS = {
    "hardware.board": ("limb_systems", "hardware.firmware"),
    "hardware.emulation": ("limb_systems", "hardware.firmware"),
    "hardware.firmware": (),
}


def module_files() -> dict[str, Path]:
    """All modules of the packages, by their names with dots."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


FILES = module_files()


def is_within(name: str, room: str) -> bool:
    return f"{name}.".startswith(f"{room}.")


def named_imports(name: str, tree: ast.AST) -> Iterator[str]:
    """Names with dots that a module imports anywhere, also in functions and by `importlib`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            home = name.split(".") if FILES[name].stem == "__init__" else name.split(".")[:-1]
            above = home[: len(home) - node.level + 1] if node.level else []
            source = ".".join([*above, *filter(None, [node.module])])
            yield from (f"{source}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and called(node) in ("import_module", "__import__"):
            argument = node.args[0]
            if isinstance(argument, ast.Constant):
                yield argument.value
            else:  # one of the names that are written in the module
                texts = (str(n.value) for n in ast.walk(tree) if isinstance(n, ast.Constant))
                yield from (text for text in texts if re.fullmatch(r"\w+(\.\w+)+", text))


def called(node: ast.Call) -> str:
    return getattr(node.func, "attr", getattr(node.func, "id", ""))


def imports_of(name: str, tree: ast.AST) -> set[str]:
    """The project's modules that a module imports."""
    found = set()
    for target in named_imports(name, tree):
        while target and target not in FILES:  # a name in a module, or nothing of the project
            target = target.rpartition(".")[0]
        found |= {target} - {"", name}
    return found


# `Recording.from_log` leads up to the import of logs, when it is called and not before.
UPWARD = {"limb_systems.files.recording": {"calibration.import_logs.importing"}}


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    """By module, the project's modules that it imports."""
    found = {}
    for name, path in FILES.items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        found[name] = imports_of(name, tree) - UPWARD.get(name, set())
    return found


def test_imports_go_one_way(imports):
    wrong = []
    for name, imported in imports.items():
        package = name.partition(".")[0]
        below = PACKAGES[: PACKAGES.index(package) + 1]
        if package == "soft_limb":
            below = tuple(other for other in below if other != "walking")
        allowed = PACKAGES if is_within(name, WALKING_COMMANDS) else below
        for room, beside in CLOSED_ROOMS.items():
            if is_within(name, room):
                allowed = (room, *beside)
        if name in SHOW_WALKING:
            allowed += ("walking",)
        wrong += [
            f"{name} imports {other}"
            for other in sorted(imported)
            if not any(is_within(other, room) for room in allowed)
        ]
    assert wrong == []


def test_no_modules_import_each_other_in_a_circle(imports):
    # `walking` imports its modules when their names are asked for.
    eager = {name: imported - {"walking"} for name, imported in imports.items()}
    try:
        graphlib.TopologicalSorter(eager).prepare()
    except graphlib.CycleError as error:
        raise AssertionError(" <- ".join(error.args[1])) from None


def test_no_two_modules_have_one_name():
    names = [path.name for path in FILES.values() if path.stem not in ("__init__", "__main__")]
    assert [name for name in set(names) if names.count(name) > 1] == []
