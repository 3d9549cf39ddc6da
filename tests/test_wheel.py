"""What a user installs: the wheel, unpacked and used away from the checkout."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from limb_systems import LimbParameters, Recording, Trajectory

from .test_imports import PACKAGES

pytestmark = pytest.mark.whole

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built without network from a copy, as building leaves files in the folder."""
    folder = tmp_path_factory.mktemp("wheel")
    unwanted = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "out")
    shutil.copytree(ROOT, folder / "checkout", ignore=unwanted)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-index", "--no-deps"]
    command += ["--no-build-isolation", "--wheel-dir", str(folder), str(folder / "checkout")]
    subprocess.run(command, check=True, capture_output=True, text=True)
    shutil.rmtree(folder / "checkout")
    (wheel,) = folder.glob("soft_limb-*-py3-none-any.whl")
    return wheel


@pytest.fixture(scope="module")
def installed(wheel) -> Path:
    folder = wheel.parent / "installed"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def run(installed, folder, module, *arguments) -> subprocess.CompletedProcess:
    """Runs a module in a folder, with the packages of the wheel."""
    environment = os.environ | {"PYTHONPATH": str(installed), "MYPYPATH": str(installed)}
    command = [sys.executable, "-m", module, *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def test_holds_the_packages_and_nothing_else(wheel):
    wanted = {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and path.suffix not in (".pyc", ".pyi")
    }
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert held == wanted
    others = {"limb_5.sdf", "limb_5.urdf", "limb_5.xml", "package.xml"}
    others = {f"urdf/{name}" for name in others} | {"hardware/firmware/README.md"}
    assert held >= others | {f"{package}/py.typed" for package in PACKAGES}


def test_packages_are_those_of_the_wheel(installed, tmp_path):
    script = "".join(f"import {name}\nprint({name}.__file__)\n" for name in PACKAGES)
    (tmp_path / "where.py").write_text(script)
    done = run(installed, tmp_path, "where")
    homes = [str(installed / name / "__init__.py") for name in PACKAGES]
    assert done.stdout.split() == homes


def test_plans_and_replays_away_from_the_checkout(installed, tmp_path):
    parameters = LimbParameters()
    parameters.temperature_limits.warm_up_time = 1000.0
    parameters.save(tmp_path / "limb.yaml")
    (tmp_path / "reference.csv").write_text("0,0\n1,0\n3,12\n4,12\n")
    planning = ("soft_limb", "plan", "reference.csv", "-l", "limb.yaml", "-o", "plan.csv")
    replaying = ("soft_limb", "replay", "plan.csv", "-o", "recording.csv")
    for command in (planning, replaying):
        done = run(installed, tmp_path, *command)
        assert (done.returncode, done.stderr) == (0, "")
    assert Trajectory.load(tmp_path / "plan.csv").duration == 4.0
    assert Recording.load(tmp_path / "recording.csv").source == "emulated limb, seed 0"
