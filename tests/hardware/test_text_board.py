"""Boards that speak text: replay on emulated sketches over a pseudo-terminal, and ways out."""

import copy
import dataclasses
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import continuum  # noqa: F401 (its physics)
import numpy as np
import pytest
from pydrake import trajectories

from controllers import PlanFeedback
from hardware import (
    AnswerLine,
    DutyLine,
    HardwareError,
    LimbTwin,
    SerialLimb,
    TextBoard,
    replay,
)
from hardware.board.port_keeper import OnOff
from hardware.board.text_answers import AnswerCheck
from hardware.board.text_board import TextBoardError
from hardware.board.text_link import TextBoardWarning, TextLink
from hardware.emulation.emulator import PseudoTerminal
from hardware.emulation.sketches import EmulatedSketch
from limb_systems import ChordSensor, LimbError, LimbParameters, Recording, simulate
from planners import plan, references
from soft_limb.command import main

from .conftest import MOST_STARTS, is_late, wait_for

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "hardware.md").read_text(encoding="utf-8")
WIRES = ["left", "right"]
LIMITS = {"name": "my_limb", "most_duty": 0.6, "longest": 30.0, "start_up": 0.0}
BOARDS = {
    "brackets": TextBoard(
        channels=["right", "left", "unused", "unused"],
        line=DutyLine(prefix="<", separator=",", suffix=">", full=255, decimals=0),
        answer=AnswerLine(order=["right", "left", "bend", "unused"]),
        timeout=None,
        **LIMITS,
    ),
    "two-floats": TextBoard(channels=WIRES, timeout=None, **LIMITS),
    "on-off": TextBoard(
        channels=[*WIRES, "unused", "unused"],
        line=DutyLine(separator="", decimals=0, on_off=True),
        rate=50.0,
        timeout=1.0,
        **LIMITS,
    ),
}
FOR_EVER = "the board holds its last duty for ever: switch off the wires' supply"


class Sketch(threading.Thread):
    """An emulated sketch that runs in a thread, with what happened to it."""

    def __init__(self, kind):
        super().__init__(daemon=True)
        self.happened, self._orders, self._ended = [], [], False
        self.cable = PseudoTerminal()
        self.port = self.cable.port
        note = lambda **event: self.happened.append(event)  # noqa: E731
        self._sketch = EmulatedSketch(kind, LimbTwin(), self.cable, note)
        self.start()

    def run(self):
        while not self._ended:
            while self._orders:
                self._sketch.misbehave(self._orders.pop())
            self._sketch.step()
            time.sleep(0.002)

    def order(self, text):
        self._orders.append(text)

    def duties(self):
        """Times, s, and duties (2, K) that the pins had from then on."""
        events = [e for e in self.happened if e["event"] == "duty"] or [
            {"time": 0, "left": 0, "right": 0}
        ]
        return np.array([e["time"] for e in events]), np.array(
            [[e[w] for e in events] for w in WIRES]
        )

    def duty(self):
        return self.duties()[1][:, -1].tolist()

    def stop(self):
        self._ended = True
        self.join()


@pytest.fixture
def sketches():
    """Starts emulated sketches, which end with the test."""
    running = []

    def start(kind):
        running.append(Sketch(kind))
        return running[-1]

    yield start
    for sketch in running:
        sketch.stop()


@pytest.fixture(scope="module")
def short_plan():
    reference = references.from_samples([0.0, 1.2], [0.0, 0.1])
    return plan(LimbParameters(), reference, knot_rate=10.0)


def heat(link, sketch, then=lambda: None):
    """Heats the right wire, does something once it is hot, and returns what the link fails with."""
    # pytest.warns would hide why a host that came too late could not arm.
    with warnings.catch_warnings(record=True, action="always") as told:
        link.arm()
    assert any(issubclass(warning.category, TextBoardWarning) for warning in told)
    done = False
    while True:
        try:
            link.command(np.array([0.0, 0.5]))
        except HardwareError as error:
            return str(error)
        time.sleep(0.05)
        if not done and sketch.duty()[1] > 0.0:
            then()
            done = True


def in_time(run):
    """What a run returns that this computer was not too busy for; a late one may return None."""
    for _ in range(MOST_STARTS):
        try:
            said = run()
        except HardwareError as error:
            said = str(error)  # or the emulated sketch was not given its time
            assert is_late(said) or said.startswith("No line that matches came"), said
            continue
        if not (said is None or (isinstance(said, str) and is_late(said))):
            return said
    raise AssertionError(said)


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=pytest.mark.whole) if kind == "brackets" else kind
        for kind in BOARDS
    ],
)
def test_a_sketch_applies_the_duty_of_the_plan(kind, sketches, short_plan, tmp_path):
    def run():
        sketch = sketches(kind)
        limb = SerialLimb(sketch.port, short_plan.parameters, board=BOARDS[kind])
        with pytest.warns(TextBoardWarning, match="nothing confirms that it arrives. If the cable"):
            recording = replay(short_plan, limb, journal=tmp_path / "recording.csv")
        assert wait_for(lambda: sketch.duty() == [0.0, 0.0])
        times, applied = sketch.duties()
        planned = short_plan.duty_trajectory().vector_values(recording.time)
        # What the wires got in all; on a computer that is too busy lines come late.
        got, asked = applied[:, :-1] @ np.diff(times), np.trapezoid(planned, recording.time)
        is_in_time = np.allclose(got, asked, atol=0.12)
        return (recording, applied, planned) if is_in_time else None

    recording, applied, planned = in_time(run)
    np.testing.assert_allclose(recording.duty, planned, atol=1e-9)
    assert planned[1].max() > 0.2
    if kind == "on-off":
        assert set(applied.ravel()) == {0.0, 1.0}
    else:  # each was asked for, in steps of the line's digits
        assert np.abs(applied[1][:, None] - np.append(planned[1], 0.0)).min(axis=1).max() < 3e-3
    if kind == "brackets":
        assert recording.measured_temperature[1, -1] > recording.measured_temperature[0, -1] + 0.7
        assert np.rad2deg(np.abs(recording.bend_angle)).max() < 15.0
        assert not recording.missing.any()
    else:
        assert recording.missing.all()
        assert Recording.load(tmp_path / "recording.csv").missing.all()


HOST = """
import sys, numpy as np
from hardware import SerialLimb
from hardware.board.text_board import TextBoard
from limb_systems import simulate
simulate(SerialLimb(sys.argv[1], board=sys.argv[2]), [0.0, 0.5], 20.0)
"""
YAML = """
name: my_limb
channels: [left, right]
most_duty: 0.6
longest: 30
timeout: null
start_up: 0
"""


def test_a_host_that_is_killed_and_one_that_hangs(sketches, start_host, tmp_path):
    (tmp_path / "board.yaml").write_text(YAML)
    for number in (signal.SIGKILL, signal.SIGSTOP):

        def start():
            sketch = sketches("two-floats")
            command = [sys.executable, "-c", HOST, sketch.port, str(tmp_path / "board.yaml")]
            host = start_host(command)
            assert wait_for(lambda: sketch.duty() == [0.0, 0.5] or host.poll() is not None)
            return (sketch, host) if host.poll() is None else host.communicate()[1]

        sketch, host = in_time(start)
        sent = time.monotonic()
        host.send_signal(number)
        assert wait_for(lambda: sketch.duty() == [0.0, 0.0])
        assert sketch.duties()[0][-1] - sent < 10.0  # 0.25 s where a computer is not too busy
        time.sleep(0.5)
        assert sketch.duty() == [0.0, 0.0]
    host.send_signal(signal.SIGCONT)  # it goes on, but nothing is heated again
    assert FOR_EVER in host.communicate()[1]
    assert sketch.duty() == [0.0, 0.0]


def test_a_host_that_is_told_to_stop(sketches, short_plan, tmp_path, capsys):
    sketch = sketches("two-floats")
    (tmp_path / "board.yaml").write_text(YAML)
    short_plan.save(tmp_path / "plan.csv")
    command = ["replay", str(tmp_path / "plan.csv"), "-o", str(tmp_path / "out.csv"), "--force"]
    command += ["-p", sketch.port, "--board", str(tmp_path / "board.yaml")]

    def run(status):
        """What a replay says that ends with a status, or that the computer is too busy for."""
        ended, said = main(command), capsys.readouterr()
        assert ended == status or is_late(said.err), said.err
        return said.err if ended != status else said

    def stopped():
        is_over = threading.Event()

        def tell():
            wait_for(lambda: sketch.duty()[1] > 0.1 or is_over.is_set())
            if not is_over.is_set():
                os.kill(os.getpid(), signal.SIGINT)

        thread = threading.Thread(target=tell)
        thread.start()
        said = run(130)
        is_over.set()
        thread.join()
        return said

    said = in_time(stopped).err
    assert wait_for(lambda: sketch.duty() == [0.0, 0.0])
    assert "stopped" in said
    assert FOR_EVER in said  # when it was armed
    sketch.order("cool")
    assert "as no bend was measured" in in_time(lambda: run(0)).out


@pytest.mark.parametrize(
    ("order", "message"),
    [
        ("say ?", r"No line that matches came from .* for 0.5 s; zero is sent\. Where zero"),
        (
            "say [MPR]: 111 25 0 0",
            "The right wire is read at 111.0 °C, and temperature_limit is 110 °C",
        ),
        (
            "unplug",
            r"The connection to .* ended: Input/output error; zero could not be sent\. Where",
        ),
    ],
)
def test_what_ends_heat(order, message, sketches):
    def run():
        sketch = sketches("brackets")
        with TextLink(sketch.port, BOARDS["brackets"], WIRES) as link:
            said = heat(link, sketch, lambda: sketch.order(order))
            if re.match("The right wire is read at 111", said):  # which may be true
                with pytest.raises(HardwareError, match="read at 111 °C, and does not cool"):
                    link.close()
        return said if is_late(said) else (said, sketch)

    said, sketch = in_time(run)
    assert re.match(message, said), said
    assert said.endswith(f"{FOR_EVER}.")
    if order == "unplug":  # what no host can help, and the sketch was said to do
        assert sketch.duty() == pytest.approx([0.0, 0.5], abs=1 / 255)
    else:
        assert sketch.duties()[1].max() > 0.4
        assert wait_for(lambda: sketch.duty() == [0.0, 0.0])


def test_a_sketch_that_takes_no_lines_any_more_ends_a_run(
    sketches, short_plan, tmp_path, monkeypatch
):
    monkeypatch.setattr("hardware.board.text_answers.STILL", 2.0)  # in place of 15 s
    sketch = sketches("brackets")
    tell = lambda: wait_for(lambda: sketch.duty()[1] > 0.2) and sketch.order("deafen")  # noqa: E731
    threading.Thread(target=tell).start()
    limb = SerialLimb(sketch.port, short_plan.parameters, board=BOARDS["brackets"])
    with (
        pytest.raises(HardwareError, match=r"does not cool although .* switch the wires' supply"),
        pytest.warns(TextBoardWarning),
    ):
        replay(short_plan, limb, journal=tmp_path / "recording.csv")
    assert sketch.duty()[1] > 0.2
    recording = Recording.load(tmp_path / "recording.unfinished.csv", unfinished=True)
    assert "take no lines any more" in recording.interrupted


def test_readings_that_no_sensor_has_are_named():
    board = BOARDS["brackets"]
    for line, said in (
        ("25 NaN 0 0", "The thermocouple of the left wire reads nan °C, outside of -60 to 600 °C"),
        ("-1e30 25 0 0", "The thermocouple of the right wire reads -1e+30 °C, outside of -60 to"),
        (
            "25 25 1e5 0",
            "The bend sensor reads a tip tangent of 1e+05°, a bend outside of -180° to",
        ),
        ("25 25 90 0", ""),
    ):
        found = AnswerCheck(board, WIRES).implausible(board.answer.read(line))
        assert found.startswith(said)
        assert bool(found) == bool(said)


# What was sent, and what the sketch did, from when on, s: right wire, first and last limb.
STEPS = [0.0, 8.0, 20.0], [0.1, 0.25, 0.0]
ANSWERS = [
    ("lumped", 0, STEPS, 60.0, None),
    ("continuum", 3, STEPS, 60.0, None),
    ("continuum", 0, STEPS, 1.0, "does not cool although zero was sent for"),  # from then on deaf
    ("lumped", 0, ([0.0, 10.0], [0.1, 0.0]), 9.0, "does not cool although zero was sent for 15 s"),
    ("lumped", 3, ([0.0], [0.4]), 0.0, "and by what was sent it must have"),
]


@pytest.mark.parametrize(("physics", "seed", "steps", "deaf_from", "sign"), ANSWERS)
def test_what_answers_show_of_lines(physics, seed, steps, deaf_from, sign):
    times = np.arange(0.0, 60.0, 0.1)
    at = lambda t: steps[1][np.searchsorted(steps[0], t, side="right") - 1]  # noqa: E731
    sent = np.array([[0.0, at(t)] for t in times])
    applied = np.array([sent[int(10 * min(t, deaf_from))] for t in times])
    applied *= deaf_from > 0
    limb = LimbTwin(seed=seed, physics=physics)
    held = trajectories.PiecewisePolynomial.ZeroOrderHold(times, applied.T)
    read = simulate(limb, held, times[-1], sample_rate=10.0).measured_temperature.T
    check, said = AnswerCheck(BOARDS["brackets"], WIRES), ""
    check.arm(read[0], limb.parameters.heat_bounds)
    for t, duty, V in zip(times[1:], sent[:-1], read[1:], strict=True):
        values = dict(zip(WIRES, V, strict=True))
        if said := check.deaf(t, duty, values):
            break
        if t > steps[0][-1] and not check.waiting and not sign:
            break
    assert re.search(sign, said) if sign else not said, said
    assert sign or not check.waiting


def test_a_duty_in_the_answers_must_be_one_that_was_sent():
    order = ["right", "left", "bend", "duty_right"]
    board = dataclasses.replace(BOARDS["brackets"], answer=AnswerLine(order=order))
    check, half = AnswerCheck(board, WIRES), np.array([0.0, 0.5])
    said = [
        check.deaf(0.1 * n, half if n < 50 else 0 * half, board.answer.read(f"25 25 0 {number}"))
        for n, number in enumerate([0] * 8 + [128] * 50 + [0] * 20 + [20] * 20)
    ]
    assert not any(said[:78])
    assert "The board says that the right wire has a duty of 0.08, and 0.00 was sent" in said[-1]
    assert re.search("a duty of 0.50, and 0.00", check.deaf(9.0, 0 * half, {"duty_right": 128.0}))


def test_a_keeper_that_is_killed_is_stood_in_for(sketches):
    def run():
        sketch = sketches("two-floats")
        with TextLink(sketch.port, BOARDS["two-floats"], WIRES) as link:
            said = heat(link, sketch, lambda: os.kill(link._keeper.pid, signal.SIGKILL))
            assert wait_for(lambda: sketch.duty() == [0.0, 0.0])
        return said if is_late(said) else (said, sketch)

    said, sketch = in_time(run)
    assert "the process that keeps it was killed; zero is sent" in said
    assert sketch.duties()[1].max() == 0.5


def test_more_duty_and_time_than_stated_are_refused(sketches, short_plan):
    sketch, board = sketches("two-floats"), copy.deepcopy(BOARDS["two-floats"])
    board.most_duty, board.longest, board.rate = 0.1, 0.2, 100.0
    with pytest.raises(TextBoardError, match=r"duty of 0\.\d\d, but most_duty .* my_limb is 0\.1"):
        replay(short_plan, SerialLimb(sketch.port, board=board))
    board.most_duty = 0.4
    with pytest.raises(TextBoardError, match=r"takes 1.2 s, but longest of .* my_limb is 0\.2 s"):
        replay(short_plan, SerialLimb(sketch.port, board=board))
    with pytest.raises(LimbError, match="PlanFeedback needs the temperatures of all wires and the"):
        replay(
            short_plan,
            SerialLimb(sketch.port, board=BOARDS["two-floats"]),
            controller=PlanFeedback(short_plan),
        )
    assert sketch.duties()[1].max() == 0.0  # nothing was armed

    def run():
        with TextLink(sketch.port, board, WIRES) as link:
            with pytest.raises(HardwareError, match="is not armed"):
                link.command(np.array([0.1, 0.1]))
            with pytest.warns(TextBoardWarning):
                link.arm(total_duty=0.5)
            link.command(np.array([0.2, 1.0]))  # what a controller asks for is reduced
            assert wait_for(lambda: any(sketch.duty()))
            reduced = [0.2 * 5 / 6, 0.4 * 5 / 6]
            assert sketch.duties()[1].max(axis=1) == pytest.approx(reduced, abs=1e-4)
            said = heat(link, sketch)
            with pytest.raises(HardwareError, match="is not armed"):
                link.command(np.array([0.1, 0.1]))
        return said

    assert "my_limb was armed for 0.2 s, its longest" in in_time(run)
    assert wait_for(lambda: sketch.duty() == [0.0, 0.0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("most_duty: 0.6\n", ""), "board.yaml: most_duty is missing."),
        (("timeout: null", "timeout: 0.05"), "lines are 0.05 s apart: the sketch would switch off"),
        (("[left, right]", "[left, left]"), "channels names a wire twice: left, left"),
        (("start_up: 0", "answer: {bend_of: chord}"), "either an order or a pattern"),
        (("start_up: 0", "line: {on_off: true}\nanswer: {order: [duty_left]}"), "line is on_o"),
        (("[left, right]", "[left, top]"), "are for left, top, but the limb's wires are left, r"),
    ],
)
def test_mistakes_in_a_description_are_named(change, message, tmp_path, capsys):
    (tmp_path / "board.yaml").write_text(YAML.replace(*change))
    with pytest.raises(TextBoardError, match=message):
        SerialLimb("/dev/null", board=tmp_path / "board.yaml")


def test_a_description_goes_with_its_limb_and_port(tmp_path, capsys):
    chord = LimbParameters()
    chord.segments[0].bend_sensor = ChordSensor()
    with pytest.raises(TextBoardError, match="as tip_tangent, but the limb's bend_sensor is a Cho"):
        SerialLimb("/dev/null", chord, board=BOARDS["brackets"])
    with pytest.raises(HardwareError, match="Cannot open /dev/null: it is no serial port"):
        SerialLimb("/dev/null", board=BOARDS["brackets"])
    with pytest.raises(HardwareError, match="loop:// is no serial port of this computer"):
        SerialLimb("loop://", board=BOARDS["brackets"])
    (tmp_path / "board.yaml").write_text(YAML)
    for command, message in (
        (["teach", "x", "-o", "y.csv"], "Teaching needs the bend, which the text board my_limb"),
        (["collect", "-o", "y"], "--board describes the board on a port; give that, too"),
        (["collect", "-o", "y", "-p", "x"], "Calibration needs the temperatures of all wires"),
    ):
        assert main([*command, "--board", str(tmp_path / "board.yaml")]) == 1
        assert message in capsys.readouterr().err


def test_lines_are_those_of_the_sketches():
    assert BOARDS["brackets"].bytes_of([0.5, 0.0, 0.0, 0.0]) == b"<128,0,0,0>\n"
    assert BOARDS["two-floats"].bytes_of([0.25, 1.0]) == b"0.2500 1.0000\n"
    assert BOARDS["on-off"].bytes_of([1.0, 1.0, 0.0, 0.0]) == b"1100\n"
    board = copy.deepcopy(BOARDS["two-floats"])
    board.line.zero, board.line.end = "stop", "CRLF"
    assert board.bytes_of([0.0, 0.0]) == b"stop\r\n"
    duty, on_off = np.array([0.03, 0.5, 0.87, 0.0]), OnOff(4)
    lines = np.array([on_off.next(duty) for _ in range(400)])
    assert set(lines.ravel()) == {0.0, 1.0}
    np.testing.assert_allclose(lines.mean(axis=0), duty, atol=1 / 400)
    late = OnOff(1)
    assert [late.next([0.4])[0] for _ in range(2)] == [0.0, 1.0]
    assert [late.next([0.4], 3.0)[0] for _ in range(4)] == [0.0, 0.0, 1.0, 0.0]  # lines held long
    assert late.next([0.0], 9.0) == [0.0]  # whatever is owed


def test_descriptions_in_the_documentation_are_those_of_these_sketches(tmp_path):
    example = TextBoard.of(ROOT / "examples" / "text_board.yaml")
    assert example == dataclasses.replace(BOARDS["brackets"], longest=120.0, start_up=2.0)
    lines = []
    for text in re.findall(r"^```yaml\n(name.*?)^```$", PAGE, re.DOTALL | re.MULTILINE):
        (tmp_path / "board.yaml").write_text(text)
        board = TextBoard.of(tmp_path / "board.yaml")
        lines.append(board.bytes_of([1.0] + [0.0] * (len(board.channels) - 1)))
    assert lines == [b"1.0000 0.0000\n", b"1000\n"]


HARNESS = """
#include <stdint.h>
#include <stdio.h>
static uint32_t now = 4294967000u; /* ms, just before the clock begins again at 0 */
static int pins[10];
static uint32_t millis(void) { return now; }
static void analogWrite(int pin, int value) { pins[pin] = value; }
%s
int main(void)
{
    for (int turn = 0; turn < 12; turn++, now += 100) {
        if (turn < 3) {
            for (int i = 0; i < 4; i++)
                analogWrite(PINS[i], 200);
            line_understood();
        }
        check_timeout();
        printf("%%d %%d ", pins[3], pins[9]);
    }
    return 0;
}
"""


def test_the_lines_of_c_switch_off_when_no_line_comes(tmp_path):
    compiler = shutil.which("cc") or shutil.which("gcc")
    if not compiler:
        pytest.skip("there is no C compiler here")
    (lines,) = re.findall(r"^```c\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    (tmp_path / "sketch.c").write_text(HARNESS % lines)
    options = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-o", "sketch"]
    subprocess.run([compiler, *options, "sketch.c"], cwd=tmp_path, check=True)
    said = subprocess.run([tmp_path / "sketch"], capture_output=True, text=True, check=True).stdout
    # The last line came in the third turn; half a second later they are still on.
    assert said.split() == ["200"] * 2 * 8 + ["0"] * 2 * 4


def test_answers_are_read_by_order_or_pattern():
    line = "[MPR]: 77 -1.5e1 nan x"
    answer = AnswerLine(order=["right", "bend", "left", "unused"])
    assert answer.read(line) == pytest.approx(
        {"right": 77.0, "bend": np.deg2rad(-15.0), "left": np.nan}, nan_ok=True
    )
    for other in ("[MPR]: 77 -1.5e1", "[MPR]: 77 -1.5e1 nan x y", "7", "", "[MPR]: a b c d"):
        assert answer.read(other) is None
    counts = AnswerLine(
        pattern=r"b(?P<bend>[-\d.]+);T(?P<left>\d+).*",
        temperature_scale=5 / 9,
        temperature_offset=-160 / 9,
        bend_unit="rad",
        bend_scale=-0.5,
        bend_offset=0.1,
    )
    assert counts.read("b-0.4;T212 and more") == pytest.approx({"bend": 0.3, "left": 100.0})
    board = TextBoard(channels=WIRES, timeout=None, answer=counts, **LIMITS)
    assert board.unmeasured == ["measured_temperature"]
