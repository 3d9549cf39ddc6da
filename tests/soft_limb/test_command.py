"""Commands end with a sentence and the exit status that their help promises."""

import importlib
import os
import re
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from limb_systems import LimbError, LimbParameters
from limb_systems.signals import heed_signals
from soft_limb.command import COMMANDS, main, run_command

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


def test_a_warning_is_one_sentence(capsys):
    assert run_command(lambda: warnings.warn("these are radians", stacklevel=1) or 0, "") == 0
    assert capsys.readouterr().err == "warning: these are radians\n"


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

    assert run_command(command, "stopped; wires are off") == 128 + number
    assert freed
    assert capsys.readouterr().err == "stopped; wires are off\n"


class _Finalized:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("then", [lambda: 0, fail_with(RuntimeError("in consequence"))])
def test_a_signal_whose_exception_is_lost_still_ends_it(then, capfd):
    def command():
        _Finalized()
        with pytest.raises(KeyboardInterrupt):
            heed_signals()
        return then()

    assert run_command(command, "stopped") == 130
    assert capfd.readouterr().err.endswith("stopped\n")
    heed_signals()  # what runs next is not stopped


def test_what_cannot_heed_signals_is_ended_at_once():
    process = subprocess.run(
        [sys.executable, "-c", AT_ONCE], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (process.returncode, process.stdout, process.stderr) == (-signal.SIGTERM, "", "")


AT_ONCE = """
import os, signal
from limb_systems.signals import ended_at_once
from soft_limb.command import run_command
def command():
    with ended_at_once():
        os.kill(os.getpid(), signal.SIGTERM)
    print("it went on")
run_command(command, "stopped")
"""


@pytest.mark.parametrize("module", ["planners", "calibration", "hardware", "soft_limb"])
def test_ctrl_c_while_a_command_is_imported_is_quiet(module):
    """At its first import of pydrake, where it would have become a traceback."""
    script = (
        "import os, runpy, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'pydrake':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        f"sys.orig_argv = ['python', '-m', '{module}']\n"
        f"runpy.run_module('{module}', run_name='__main__')"
    )
    process = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (process.returncode, process.stdout, process.stderr) == (130, "", "")


def test_nohup_is_respected():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    assert run_command(lambda: os.kill(os.getpid(), signal.SIGHUP) or 0, "stopped") == 0


def test_a_reader_that_went_away_gets_no_traceback():
    script = (
        "from soft_limb.command import COMMANDS, main, run_command\n"
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


def test_soft_limb_lists_all_commands_with_a_line_each(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    for name, (_, what) in COMMANDS.items():
        assert any(line.split(maxsplit=1) == [name, what] for line in lines)


@pytest.mark.parametrize("name", COMMANDS)
def test_soft_limb_runs_the_commands_of_the_packages(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: soft-limb {name} ")


def test_soft_limb_has_every_command_of_every_package(capsys):
    for package in ("results", "calibration", "hardware"):
        with pytest.raises(SystemExit):
            importlib.import_module(f"soft_limb.commands.{package}").main(["--help"])
        listed = re.search(r"{(.*?)}", capsys.readouterr().out, re.DOTALL)[1].split(",")
        assert set(listed) == {name for name, (home, _) in COMMANDS.items() if home == package}


def test_soft_limb_says_its_version_and_refuses_what_it_does_not_know(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    assert re.fullmatch(r"soft-limb \d+\.\d+\.\d+\n", capsys.readouterr().out)
    with pytest.raises(SystemExit) as ended:
        main(["pla"])
    assert ended.value.code == 2
    assert main([]) == 2
    assert "plan the feasible trajectory" in capsys.readouterr().err
    assert main(["plan", "nowhere.csv", "-o", "nowhere/plan.csv"]) == 1
    assert "nowhere.csv" in capsys.readouterr().err


MY_LAW = """
import dataclasses

from limb_systems import LinearLaw


@dataclasses.dataclass
class MyOwnLaw(LinearLaw):
    pass
"""


def test_a_law_of_ones_own_is_imported_for_a_command(tmp_path):
    """From a module in the folder of the command, as a lab has it; no file of YAML imports one."""
    (tmp_path / "my_law.py").write_text(MY_LAW)
    text = LimbParameters().to_yaml().replace("!LinearLaw", "!MyOwnLaw")
    (tmp_path / "limb.yaml").write_text(text)
    (tmp_path / "broken.py").write_text("1 +")
    run = "import sys; from soft_limb.command import main; sys.path[:] = sys.path[1:]; main()"

    def soft_limb(*arguments):
        command = [sys.executable, "-c", run, *arguments]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)

    plan = ["plan", "fig5", "-l", "limb.yaml", "-o", "plan.csv", "--knot-rate", "1"]
    refused = soft_limb(*plan).stderr
    assert "!MyOwnLaw, which is not known" in refused
    assert "soft-limb --import MODULE" in refused
    assert "!_" not in refused
    for module, why in {"no_law": "No module named 'no_law'", "broken": "SyntaxError"}.items():
        failed = soft_limb("--import", module, *plan).stderr
        assert f"{module} could not be imported: " in failed
        assert why in failed
    done = soft_limb("--import", "my_law", *plan, "--tolerance", "5")
    assert done.returncode == 0, done.stderr
    assert "law: !MyOwnLaw" in (tmp_path / "plan.csv").read_text()
