"""Boards that are none, are others' or are hung, as the host's end of the cable tells."""

import errno
import itertools
import os
import signal
import termios
import threading
import tty
from unittest import mock

import numpy as np
import pytest
import serial
from pydrake.systems.analysis import Simulator

from calibration import collect_sag
from hardware import BoardLink, HardwareError, LimbTwin, SerialLimb
from hardware.board.link import SampleAssembler, SerialPort
from hardware.board.reasons import REASONS
from hardware.emulation.emulated_board import EmulatedBoard
from hardware.firmware import guard, protocol, readings
from limb_systems import (
    ChordSensor,
    LimbError,
    LimbParameters,
    Recording,
    SegmentParameters,
    TipTangentSensor,
)
from limb_systems.heat_bounds import HeatBounds
from soft_limb.command import main

from .conftest import BOUNDS
from .virtual_time import VirtualCable


@pytest.fixture
def board(virtual_time):
    """The board's end of a cable."""
    return VirtualCable(virtual_time, "/dev/virtual")


@pytest.fixture
def pseudo_terminal():
    """The board's end of a pseudo-terminal, and its port."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)
    os.close(master)


def greeting(version, channels=2):
    return protocol.encode(protocol.INFO, version, 20, 440, b"mine0001", channels, 1, 0)


def test_a_port_without_a_board_is_named(pseudo_terminal, monkeypatch):
    _, port = pseudo_terminal
    monkeypatch.setattr("hardware.board.link.ANSWER_TIME", 0.3)
    with pytest.raises(HardwareError, match=f"The board on {port} does not answer a greeting"):
        SerialLimb(port)
    message = "does not answer after the port was opened"  # but may be opened again
    with BoardLink(port) as link, pytest.raises(HardwareError, match=message):
        link.sample()


def test_a_second_program_on_a_port_is_refused(pseudo_terminal, capsys):
    _, port = pseudo_terminal
    with BoardLink(port):
        assert main(["status", port]) == 1
    assert capsys.readouterr().err == f"error: {port} is in use by another program.\n"


def test_a_write_that_times_out_is_told_from_a_cable_that_is_gone(pseudo_terminal):
    """Nobody reads; the terminal keeps some KiB."""
    _, port = pseudo_terminal
    with SerialPort(port) as cable:
        with pytest.raises(HardwareError, match=rf"^{port} was not ready for more data within 0.2"):
            cable.send(bytes(100_000))
        assert cable.receive() == b""


def test_errors_of_line_settings_are_hardware_errors(pseudo_terminal, monkeypatch):
    """Those of termios, which are no OSErrors: when it is opened, asked and closed."""
    _, port = pseudo_terminal

    def fail(*_):
        raise termios.error(errno.EIO, "Input/output error")

    for name in ("tcsetattr", "tcflush"):
        with monkeypatch.context() as patch:
            patch.setattr(termios, name, fail)
            with pytest.raises(
                HardwareError, match=f"Cannot open {port}: Input/output error; soft"
            ):
                SerialPort(port)
    with SerialPort(port) as cable:
        monkeypatch.setattr(serial.Serial, "in_waiting", property(fail))
        with pytest.raises(
            HardwareError, match=f"^The cable to {port} is gone: Input/output error"
        ):
            cable.receive()
        monkeypatch.setattr(serial.Serial, "close", fail)
        cable.close()


def test_a_board_of_another_version_is_refused(board):
    for version, said in ((4, "flash the board with"), (6, "use a newer version of this")):
        with BoardLink(board.port) as link:
            board.write(protocol.frame(version, protocol.INFO, bytes(17)))
            with pytest.raises(HardwareError, match=f"speaks version {version} .* this .* {said}"):
                link.info()


def test_a_board_with_other_channels_is_refused(virtual_time, board):
    with BoardLink(board.port) as link:
        board.write(greeting(5, channels=4))
        assert link.info().channels == 4
    virtual_time.when(lambda: True, lambda: board.write(greeting(5, channels=4)), after=0.3)
    with pytest.raises(
        LimbError, match=r"has 2 wires and 1 bend angles, but the board on .* has 4 channels"
    ):
        SerialLimb(board.port)


def sample(number, state, reason, bend=0, acknowledged=0, time_ms=None):
    time_ms = 50 * number if time_ms is None else time_ms
    header = number, time_ms, 4711, state, reason, acknowledged, bend
    wires = protocol.encode(protocol.CHANNELS, number, 0, 2, 100, 0, 25, 100, 0, 25)
    return protocol.encode(protocol.SAMPLE, *header) + wires


def limb_with(sensor) -> LimbParameters:
    limb = LimbParameters()
    limb.segments[0].bend_sensor = sensor
    return limb


def test_the_segment_tells_what_a_reading_means(virtual_time, board):
    """The board reads 30°, in 1/64 of them."""

    def make(number):
        return greeting(4) + sample(number, guard.DISARMED, 0, bend=64 * 30)

    for sensor, degrees in ((TipTangentSensor(), 15.0), (ChordSensor(), 30.0)):
        with (
            Talking(board, virtual_time, make),
            SerialLimb(board.port, limb_with(sensor), heated=False) as limb,
        ):
            simulator = Simulator(limb)
            limb.GetInputPort("duty").FixValue(simulator.get_mutable_context(), [0.0, 0.0])
            simulator.Initialize()
            (angle,) = limb.GetOutputPort("bend_angle").Eval(simulator.get_context())
            assert limb.link.sample().tip_tangent == pytest.approx([np.deg2rad(30.0)])
        assert angle == pytest.approx(np.deg2rad(degrees))


def test_the_emulated_board_s_bytes_are_of_the_segment_s_sensor():
    """The same limb at rest, some degrees off by its rubber and sensor, read both ways."""
    said = {}
    for sensor in (TipTangentSensor(), ChordSensor()):
        board = EmulatedBoard(LimbTwin(limb_with(sensor), seed=3), lambda *_: None)
        angle = np.rad2deg(board.reading("bend_angle")[0])
        said[type(sensor)] = np.mean([readings.bends(board.read_bend()) for _ in range(50)]) / 64
    assert abs(angle) > 0.5
    assert said[TipTangentSensor] == pytest.approx(2 * angle, abs=0.05)
    assert said[ChordSensor] == pytest.approx(angle, abs=0.05)


def test_an_emulated_board_is_for_a_limb_of_eight_wires():
    limb = LimbParameters(segments=[SegmentParameters(links=1) for _ in range(5)])
    with pytest.raises(LimbError, match="this limb has 10 wires and 5 bend angles"):
        EmulatedBoard(LimbTwin(limb), lambda _: None)


def test_the_reason_for_which_a_board_is_off_is_told(virtual_time, board):
    for reason, text in REASONS.items():
        with BoardLink(board.port) as link:
            board.write(sample(1, guard.ARMED, guard.NO_REASON))
            link.command([0.0, 0.5])
            board.write(sample(2, guard.DISARMED, reason))
            assert virtual_time.wait_for(lambda: not link.sample().armed)
            with pytest.raises(HardwareError, match=f"{board.port} switched off: {text}"):
                link.command([0.0, 0.5])
            if reason >= guard.LATCHING:
                with pytest.raises(HardwareError, match=f"refuses to be armed: {text}. Mend it"):
                    link.arm(BOUNDS)
            else:
                link.clear()  # nothing is latched: asks for nothing
        sent = protocol.Parser((protocol.ARM, protocol.CLEAR)).feed(board.read())
        assert sent == []


def test_a_reason_that_is_not_known_is_a_sentence(virtual_time, board, capsys):
    with Talking(
        board, virtual_time, lambda number: greeting(4) + sample(number, guard.DISARMED, 77)
    ):
        assert main(["status", board.port]) == 0
    assert "off: for a reason that this program does not know, 77" in capsys.readouterr().out


class Talking:
    """A board that sends armed samples each 50 ms, made by a function of their number."""

    def __init__(self, cable, time, make):
        self._cable, self._time, self._make, self._number = cable, time, make, 0
        self._due = time.monotonic()

    def __enter__(self):
        self._cable.board = self

    def __exit__(self, *_):
        self._cable.board = None

    def step(self):
        if self._time.monotonic() >= self._due:
            self._due += 0.05
            self._number += 1
            self._cable.write(self._make(self._number))


def test_a_sample_counts_only_if_all_of_its_channels_came():
    """Of six wires and three angles, each frame twice; damage takes some of them."""
    quarters, bends, ticks = [100, 101, 102, 103, 104, 105], [64, -64, 32], 6 * [5000]

    def frames(sequence):
        header = sequence, 50 * sequence, 4711, guard.ARMED, 0, 9, *bends
        wires = list(zip(quarters, ticks, [25, 26, 27, 28, 29, 30], strict=True))
        return [
            (protocol.SAMPLE, header),
            (protocol.CHANNELS, (sequence, 0, 6, *itertools.chain(*wires[:4]))),
            (protocol.CHANNELS, (sequence, 4, 6, *itertools.chain(*wires[4:]))),
        ]

    one, two, three, four = (frames(sequence) for sequence in (1, 2, 3, 4))
    assembly = SampleAssembler()
    came = [
        *one, *one,  # both copies
        *two[:2], two[0], *three[:1],  # a CHANNELS was lost, twice
        *three[1:2], *three[2:], four[2], four[0], four[1], four[1],  # in another order
    ]  # fmt: skip
    samples = [s for kind, values in came if (s := assembly.take(kind, values, 0.0))]
    assert [sample.sequence for sample in samples] == [1, 1, 3, 4]
    for sample in samples:
        np.testing.assert_array_equal(sample.temperature, np.array(quarters) / 4)
        np.testing.assert_allclose(np.rad2deg(sample.tip_tangent), [1.0, -1.0, 0.5])
        np.testing.assert_array_equal(sample.duty, 6 * [0.5])
        np.testing.assert_array_equal(sample.warmest, [25, 26, 27, 28, 29, 30])
        assert (sample.armed, sample.acknowledged) == (True, 9)


def armed(number, **others):
    return sample(number, guard.ARMED, guard.NO_REASON, **others)


BAD_SAMPLES = {
    "Nothing new came from the board": lambda _: armed(7, acknowledged=100),  # repeats
    r"time of the board on .* went back": lambda n: armed(7 + n % 2, acknowledged=100),
    # Behind a buffer that grows: half of a second for each second.
    r"come 0\.\d+ s late; is this computer or the conn": lambda n: armed(
        n, acknowledged=n, time_ms=25 * n
    ),
    r"did not get a command within 0\.\d+ s; commands arrive": armed,
}


@pytest.mark.parametrize("said", BAD_SAMPLES)
def test_samples_that_repeat_are_old_or_late_or_answer_nothing(said, virtual_time, board):
    with (
        BoardLink(board.port) as link,
        Talking(board, virtual_time, BAD_SAMPLES[said]),
        pytest.raises(HardwareError, match=said),
    ):
        keep_commanding(virtual_time, link, 1.5)


def keep_commanding(time, link, seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        link.command([0.0, 0.5])
        time.sleep(0.05)


def test_a_board_whose_clock_is_slow_is_borne(board, monkeypatch):
    """By 2%, as that of an oscillator without a crystal may be, for five minutes."""
    parser = protocol.Parser(protocol.BOARD_KINDS)
    with BoardLink(board.port) as link:
        for number in range(6_000):
            passed = 0.05 * number
            monkeypatch.setattr("hardware.board.link.time.monotonic", lambda now=passed: now)
            for kind, values in parser.feed(
                sample(number, guard.DISARMED, guard.NO_REASON, time_ms=round(980 * passed))
            ):
                link._handle(kind, values)
            assert link.delay < 0.01
        monkeypatch.undo()


def test_the_sample_that_says_that_the_board_is_off_is_recorded(virtual_time, board, tmp_path):
    def make(number):
        state, reason = guard.DISARMED, guard.NO_REASON
        if number > 20:
            state = guard.ARMED
        if number > 40:
            state, reason = guard.DISARMED, guard.THERMOCOUPLE_OPEN
        bend = 64 * (7 if number > 40 else 3)
        return greeting(4) + sample(number, state, reason, bend, acknowledged=number)

    with (
        Talking(board, virtual_time, make),
        pytest.warns(UserWarning, match="recorded until then is in"),
        pytest.raises(HardwareError, match="a thermocouple is open"),
    ):
        collect_sag(SerialLimb(board.port), journal=tmp_path / "sag.csv")
    recording = Recording.load(tmp_path / "sag.unfinished.csv", unfinished=True)
    assert "a thermocouple is open" in recording.interrupted
    np.testing.assert_allclose(np.rad2deg(recording.bend_angle[0, -3:]), [1.5, 1.5, 3.5])


def test_a_board_that_another_program_has_armed_is_left_to_it(virtual_time, board):
    with (
        BoardLink(board.port) as link,
        Talking(board, virtual_time, lambda number: sample(number, guard.ARMED, guard.NO_REASON)),
        pytest.raises(HardwareError, match="is in use by another program"),
    ):
        link.arm(BOUNDS)


def test_the_bounds_of_a_limb_are_in_the_frame_that_arms(virtual_time, board):
    limb = LimbParameters()
    limb.total_duty = 0.7
    limb.wires[1].heat_bounds = HeatBounds(0.05, 0.08, 18.0, 21.5, 0.75)
    with (
        BoardLink(board.port) as link,
        Talking(board, virtual_time, lambda n: sample(n, guard.DISARMED, 0)),
        pytest.raises(HardwareError, match="does not let itself be armed: all is well"),
    ):
        link.arm(limb.heat_bounds, limb.total_duty)
    sent = protocol.Parser((protocol.BOUNDS, protocol.ARM)).feed(board.read())
    (_, left), (_, right), (_, arm) = sent[:3]
    assert left == (4711, 0, 42, 95, 1700, 2300, 500, 16)
    assert right == (4711, 1, 50, 80, 1800, 2150, 750, 0)
    assert arm[:3] == (4711, 2, 7000)


def test_a_program_that_a_signal_has_ended_heats_no_wire(virtual_time, board, monkeypatch):
    """Also where a finalizer has swallowed the exception of the handler."""
    monkeypatch.setattr("hardware.board.signals.received_signals", [signal.SIGINT])
    with BoardLink(board.port) as link:
        for heat in (lambda: link.arm(BOUNDS), lambda: link.command(np.zeros(2))):
            with pytest.raises(KeyboardInterrupt):
                heat()


def test_a_command_that_fails_is_reported_to_the_other_boards(board):
    with BoardLink(board.port) as link:
        link.when_off = mock.Mock()
        board.write(sample(1, guard.ARMED, guard.NO_REASON))
        link.sample()
        with pytest.raises(HardwareError) as error:
            link.command([0.0, np.nan])
        link.when_off.assert_called_once_with(str(error.value))


def test_a_fault_that_stays_is_not_cleared(virtual_time, board):
    latched = guard.DISARMED, guard.THERMOCOUPLE_OPEN
    with (
        BoardLink(board.port) as link,
        Talking(board, virtual_time, lambda number: sample(number, *latched)),
        pytest.raises(HardwareError, match="is still there: a thermocouple is open"),
    ):
        link.clear()


def test_a_frame_that_cannot_be_sent_is_a_failure(pseudo_terminal, monkeypatch):
    def fail(_):
        raise HardwareError("The cable is gone.")

    with BoardLink(pseudo_terminal[1]) as link:
        monkeypatch.setattr(link._cable, "send", fail)
        with pytest.raises(HardwareError, match=r"^The cable is gone\.$"):
            link.info()


def test_a_board_that_takes_no_data_is_hung(pseudo_terminal, monkeypatch):
    hung, sent = threading.Event(), []
    with BoardLink(pseudo_terminal[1]) as link:
        monkeypatch.setattr(link._cable, "send", lambda _: sent.append(hung.wait(60.0)))
        for _ in range(20):
            link.disarm()  # neither waits nor raises
        assert not sent
        with pytest.raises(HardwareError, match="takes no more data; is the board hung"):
            link.info()
        hung.set()
