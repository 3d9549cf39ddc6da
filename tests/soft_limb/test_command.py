"""Commands end with one sentence and the exit status that their help documents."""

import gc
import importlib
import os
import re
import shlex
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from hardware.board.signals import raise_if_interrupted, stop
from limb_systems import Limb, LimbError, LimbParameters, simulate
from soft_limb.command import all_commands, main, run_command

ROOT = Path(__file__).parents[2]
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture(autouse=True)
def handlers():
    """Restore the handlers of the signals."""
    kept = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)


def fail_with(error):
    def command():
        raise error

    return command


def test_an_error_and_a_warning_are_a_sentence_each(capsys):
    assert run_command(lambda: 3, "stopped") == 3
    for error in (LimbError("no limb"), OSError("no limb"), MemoryError("no limb")):
        assert run_command(fail_with(error), "stopped") == 1
        assert capsys.readouterr().err == "error: no limb\n"
    assert run_command(lambda: warnings.warn("these are radians", stacklevel=1) or 0, "") == 0
    assert capsys.readouterr().err == "warning: these are radians\n"


def test_help_of_every_command_has_valid_examples(capsys):
    for name, (home, _) in all_commands().items():
        with pytest.raises(SystemExit) as ended:
            main([name, "--help"])
        said = capsys.readouterr().out
        assert ended.value.code == 0
        assert said.startswith(f"usage: soft-limb {name} ")
        assert "exit status: 0 done" in said
        command = importlib.import_module(home).COMMANDS[name]
        assert command.examples
        for line in command.examples:
            program, given, *words = shlex.split(line)
            assert (program, given) == ("soft-limb", name)
            command.parser(name).parse_args(words)
            assert f"\n  {line}\n" in said


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
            raise_if_interrupted()
        return then()

    assert run_command(command, "stopped") == 130
    assert capfd.readouterr().err.endswith("stopped\n")
    raise_if_interrupted()  # what runs next is not stopped


def run_script(text):
    """Return exit status, output and errors of a script in its own process."""
    done = subprocess.run(
        [sys.executable, "-c", text], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout, done.stderr


def test_a_second_ctrl_c_at_the_end_prints_no_traceback(monkeypatch, capsys):
    set_handler = signal.signal
    left = [signal.SIGINT] * 9

    def interrupted(number, handler):
        if signal.getsignal(number) is not handler and signal.getsignal(number) is stop and left:
            os.kill(os.getpid(), left.pop())
        return set_handler(number, handler)

    def command():
        monkeypatch.setattr(signal, "signal", interrupted)
        raise KeyboardInterrupt

    assert run_command(command, "stopped") == 130
    assert capsys.readouterr().err == "stopped\n"
    assert len(left) < 9


def test_signals_end_code_that_cannot_handle_them():
    script = """
import os, signal
from hardware.board.signals import default_signal_handlers
from soft_limb.command import run_command
def command():
    with default_signal_handlers():
        os.kill(os.getpid(), signal.SIGTERM)
    print("it went on")
run_command(command, "stopped")
"""
    assert run_script(script) == (-signal.SIGTERM, "", "")


def test_ctrl_c_while_a_command_is_imported_is_a_sentence():
    """While the program is imported, where it would have become a traceback."""
    script = """
import os, runpy, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == 'limb_systems.errors':
            os.kill(os.getpid(), signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Finder())
sys.orig_argv = ['python', '-m', 'soft_limb']
runpy.run_module('soft_limb', run_name='__main__')
"""
    said = "stopped before it began; nothing was written\n"
    assert run_script(script) == (130, "", said)


def test_ctrl_c_after_a_command_does_not_say_that_nothing_was_written():
    script = """
import os, signal
from soft_limb.command import run_command
from soft_limb import exit_before_start
signal.signal(signal.SIGINT, exit_before_start)
run_command(lambda: 0, "stopped")
os.kill(os.getpid(), signal.SIGINT)
"""
    assert run_script(script) == (-signal.SIGINT, "", "")


def test_nohup_is_respected():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    assert run_command(lambda: os.kill(os.getpid(), signal.SIGHUP) or 0, "stopped") == 0


def test_a_reader_that_went_away_gets_no_traceback():
    script = (
        "from soft_limb.command import run_command\n"
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


def test_version_is_printed_and_unknown_commands_are_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)  # where there are no results
    with pytest.raises(SystemExit):
        main(["--version"])
    assert re.fullmatch(r"soft-limb \d+\.\d+\.\d+\n", capsys.readouterr().out)
    for words in (["pla"], ["plan"]):
        with pytest.raises(SystemExit) as ended:
            main(words)
        assert ended.value.code == 2
    # A copy that was never installed has no version, but all commands.
    monkeypatch.setattr("importlib.metadata.Distribution.discover", lambda **_: iter(()))
    assert main([]) == 2
    assert "plan the feasible trajectory" in capsys.readouterr().err
    assert main(["plan", "nowhere.csv", "-o", "nowhere/plan.csv"]) == 1
    assert "nowhere.csv" in capsys.readouterr().err


def test_a_users_law_is_imported_for_a_command(tmp_path, monkeypatch, capsys):
    """The module is in the folder of the command; a YAML file imports no module."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr("soft_limb.runs.jobs._module_folders", {})
    law = "import dataclasses, limb_systems\n@dataclasses.dataclass\n"
    law += "class MyOwnLaw(limb_systems.LinearLaw): pass\n"
    (tmp_path / "my_law_of_a_test.py").write_text(law)
    text = LimbParameters().to_yaml().replace("!LinearLaw", "!MyOwnLaw")
    (tmp_path / "limb.yaml").write_text(text)
    (tmp_path / "broken_law.py").write_text("1 +")
    plan = ["plan", "fig5", "-l", "limb.yaml", "-o", "plan.csv", "--knot-rate", "1"]
    assert main(plan) == 1
    refused = capsys.readouterr().err
    assert "!MyOwnLaw, which is not known" in refused
    assert "soft-limb --import MODULE" in refused
    for module, why in {"no_law": "No module named 'no_law'", "broken_law": "SyntaxError"}.items():
        with pytest.raises(SystemExit) as ended:
            main(["--import", module, *plan])
        assert ended.value.code == 2
        failed = capsys.readouterr().err
        assert f"{module} could not be imported: " in failed
        assert why in failed
    words = ["plan", "--import", "my_law_of_a_test", *plan[1:], "--tolerance", "5"]
    assert main(words) == 0
    assert "law: !MyOwnLaw" in (tmp_path / "plan.csv").read_text()
    del sys.modules["my_law_of_a_test"]
    gc.collect()  # no other test knows the law


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("walk empty.csv -o out.csv", "this is not a limb gait: .* soft-limb gait writes"),
        ("plan taught.csv --smooth nan -o out.csv", "smoothing_time is nan s; it must be from 0"),
        ("plan mine.csv --knot-rate 1e308 -o out.csv", "ask for fewer knots per second"),
        ("teach --emulated 1 -t nan -o out.csv", "--time is nan s; it must be above 0 and at most"),
        ("plan path.csv --tip -o out.csv", "two coordinates of the tip, .* write axes: 2 into"),
        (
            f"plan ramps --task {'t' * 300} -o out.csv",
            "error: Cannot use t{300}: File name too long.",
        ),
        (
            "plan mine.csv -l robot.yaml -o out.csv",
            "robot.yaml is a robot of several limbs",
        ),
        ("plan mine.csv -l empty.csv -o out.csv", "empty.csv: the document must .*, but is empty."),
        ("plan mine.csv --start 1e9 -o out.csv", "above T_max = .*; let it cool first."),
        (
            "collect -p rear=none -o out.csv",
            "given for rear, but this is a single limb; give --port",
        ),
        ("fit none -o out.yaml", "no recordings in none; soft-limb collect"),
        ("emulate --one-board", "--one-board is for a robot; give its description"),
    ],
)
def test_invalid_input_gives_one_sentence(line, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.csv").touch()
    (tmp_path / "none").mkdir()
    (tmp_path / "robot.yaml").write_text("limbs: []\n")
    (tmp_path / "mine.csv").write_text("0,0\n3,5\n")
    (tmp_path / "path.csv").write_text("0,0,0\n3,5,5\n")
    simulate(Limb(), [0.0, 0.0], 1.0).save("taught.csv")
    assert main(shlex.split(line)) == 1
    (error,) = capsys.readouterr().err.splitlines()
    assert re.search(said, error), error
    assert not (tmp_path / "out.csv").exists()
