"""The firmware's own tests, under CPython, and under MicroPython where it is installed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
FIRMWARE = HERE.parents[1] / "hardware" / "firmware"
PORTABLE = ["protocol.py", "readings.py", "guard.py", "firmware.py"]

sys.path.insert(0, str(HERE))
import firmware_checks  # noqa: E402

TESTS = {name: test for name, test in vars(firmware_checks).items() if name.startswith("test_")}


@pytest.mark.parametrize("name", TESTS)
def test_under_cpython(name):
    TESTS[name]()


def test_under_micropython():
    """`make micropython` installs it and sets MICROPYTHON to its micropython.mjs."""
    interpreter = os.environ.get("MICROPYTHON")
    if not interpreter or not shutil.which("node"):
        pytest.skip("MicroPython is not installed; see `make micropython`")
    files = [FIRMWARE / name for name in PORTABLE] + [HERE / "firmware_checks.py"]
    done = subprocess.run(
        ["node", HERE / "run_micropython.mjs", interpreter, *files],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("micropython")
    assert f"{len(TESTS)} passed" in done.stdout


def test_board_file_has_the_methods_that_the_firmware_calls():
    """It cannot run here; at least it parses and is complete."""
    import ast

    tree = ast.parse((FIRMWARE / "board_nrf52dk.py").read_text(encoding="utf-8"))
    (board,) = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    methods = {node.name for node in board.body if isinstance(node, ast.FunctionDef)}
    paper = {name for name in vars(firmware_checks.PaperBoard) if not name.startswith("_")}
    assert paper <= methods
