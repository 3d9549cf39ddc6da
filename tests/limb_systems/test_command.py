"""Commands end with a sentence and the exit status that their help promises."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from limb_systems import LimbError
from limb_systems.command import run_command

ROOT = Path(__file__).parents[2]
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture(autouse=True)
def handlers():
    """Puts the signals' handlers back."""
    kept = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)


def fail_with(error):
    def command():
        raise error

    return command


def test_status_is_the_commands_own():
    assert run_command(lambda: 0, "stopped") == 0
    assert run_command(lambda: 1, "stopped") == 1


@pytest.mark.parametrize(
    "error", [LimbError("no limb"), OSError("no limb"), MemoryError("no limb")]
)
def test_what_cannot_be_done_is_one_sentence(error, capsys):
    assert run_command(fail_with(error), "stopped") == 1
    assert capsys.readouterr().err == "error: no limb\n"


def test_mistakes_of_the_program_are_not_hidden():
    with pytest.raises(ValueError, match="a mistake"):
        run_command(fail_with(ValueError("a mistake")), "stopped")


@pytest.mark.parametrize("number", SIGNALS)
def test_signals_end_it_as_ctrl_c_does(number, capsys):
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell does in the background
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    freed = []

    def command():
        try:
            os.kill(os.getpid(), number)
            signal.pause()
        finally:
            freed.append(True)

    assert run_command(command, "stopped; wires are off") == 130
    assert freed
    assert capsys.readouterr().err == "stopped; wires are off\n"


def test_nohup_is_respected():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    assert run_command(lambda: os.kill(os.getpid(), signal.SIGHUP) or 0, "stopped") == 0


def test_a_reader_that_went_away_gets_no_traceback():
    script = (
        "from limb_systems.command import run_command\n"
        "run = lambda: [print('x' * 1000) for _ in range(1000)] and 0\n"
        "raise SystemExit(run_command(run, 'stopped'))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait() == 1
