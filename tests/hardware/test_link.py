"""Boards that are none, are others' or are hung, as the host's end of the cable tells."""

import dataclasses
import os
import threading
import time
import tty

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from hardware import BoardLink, HardwareError, LimbTwin, SerialLimb
from hardware.emulation.emulated_board import EmulatedBoard
from hardware.firmware import guard, protocol, readings
from limb_systems import BendSensor, LimbError, LimbParameters, TipTangentSensor

from .conftest import BOUNDS, wait_for


@pytest.fixture
def board():
    """The board's end of a pseudo-terminal, and its port."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)
    os.close(master)


def greeting(version, channels=2):
    return protocol.encode(protocol.INFO, version, 20, 440, b"mine0001", channels)


def test_a_port_without_a_board_is_named(board):
    with pytest.raises(HardwareError, match=f"The board on {board[1]} does not answer a greeting"):
        SerialLimb(board[1])
    message = "does not answer after the port was opened"  # but may be opened again
    with BoardLink(board[1]) as link, pytest.raises(HardwareError, match=message):
        link.sample()


def test_a_board_with_other_firmware_is_refused(board):
    with BoardLink(board[1]) as link:
        os.write(board[0], greeting(7))
        with pytest.raises(HardwareError, match="has firmware 7; this program needs 2"):
            link.info()


def test_a_board_with_another_protocol_is_refused(board, monkeypatch):
    with monkeypatch.context() as other:
        other.setattr(protocol, "VERSION", 1)
        frame = greeting(2)
    with BoardLink(board[1]) as link:
        os.write(board[0], frame)
        with pytest.raises(
            HardwareError,
            match="speaks version 1 of the protocol, but this program version 2; flash",
        ):
            link.info()


def test_a_board_of_the_first_version_is_told_from_noise(board):
    """An INFO as boards sent it before they told their channels."""
    info = "7e 01 81 01 00 32 00 b8 01 6d 69 6e 65 30 30 30 31 47 66 dc 36 7e"
    with BoardLink(board[1]) as link:
        os.write(board[0], bytes.fromhex(info))
        with pytest.raises(HardwareError, match="speaks version 1 of the protocol"):
            link.info()


def test_a_board_with_other_channels_is_refused(board):
    with BoardLink(board[1]) as link:
        os.write(board[0], greeting(2, channels=4))
        assert link.info().channels == 4
    threading.Timer(0.3, os.write, (board[0], greeting(2, channels=4))).start()
    with pytest.raises(LimbError, match=r"has 2 wires, but the board on .* has 4 channels"):
        SerialLimb(board[1])


def sample(number, state, reason, bend=0):
    return protocol.encode(
        protocol.SAMPLE, number, 50 * number, 4711, state, reason, 0, 100, 100, bend, 0, 0
    )


@dataclasses.dataclass
class ChordSensor(BendSensor):
    """One that reads the bend angle itself."""

    def bend_angle(self, reading):
        return np.asarray(reading, float)

    def reading(self, bend_angle):
        return np.asarray(bend_angle, float)


def limb_with(sensor) -> LimbParameters:
    limb = LimbParameters()
    limb.segments[0].bend_sensor = sensor
    return limb


@pytest.mark.parametrize(("sensor", "degrees"), [(TipTangentSensor(), 15.0), (ChordSensor(), 30.0)])
def test_the_segment_tells_what_a_reading_means(board, sensor, degrees):
    """The board reads 30°, in 1/64 of them."""
    stop = threading.Event()

    def send():
        while not stop.wait(0.02):
            os.write(board[0], greeting(2) + sample(1, guard.DISARMED, 0, bend=64 * 30))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        with SerialLimb(board[1], limb_with(sensor), heated=False) as limb:
            simulator = Simulator(limb)
            limb.GetInputPort("duty").FixValue(simulator.get_mutable_context(), [0.0, 0.0])
            simulator.Initialize()
            (angle,) = limb.GetOutputPort("bend_angle").Eval(simulator.get_context())
            assert limb.link.sample().tip_tangent == pytest.approx(np.deg2rad(30.0))
    finally:
        stop.set()
        thread.join()
    assert angle == pytest.approx(np.deg2rad(degrees))


def test_the_emulated_board_s_bytes_are_of_the_segment_s_sensor():
    """The same limb at rest, some degrees off by its rubber and sensor, read both ways."""
    said = {}
    for sensor in (TipTangentSensor(), ChordSensor()):
        board = EmulatedBoard(LimbTwin(limb_with(sensor), seed=3), lambda *_: None)
        angle = np.rad2deg(board.reading("bend_angle")[0])
        said[type(sensor)] = np.mean([readings.bend(board.read_bend()) / 64 for _ in range(50)])
    assert abs(angle) > 0.5
    assert said[TipTangentSensor] == pytest.approx(2 * angle, abs=0.05)
    assert said[ChordSensor] == pytest.approx(angle, abs=0.05)


def test_an_emulated_board_is_for_a_limb_of_two_wires(two_segments):
    with pytest.raises(LimbError, match="this limb has 4 wires in 2 segments"):
        EmulatedBoard(LimbTwin(two_segments), lambda *_: None)


@pytest.mark.parametrize("reason", guard.TEXTS)
def test_the_reason_for_which_a_board_is_off_is_told(board, reason):
    text = guard.TEXTS[reason]
    with BoardLink(board[1]) as link:
        os.write(board[0], sample(1, guard.ARMED, guard.NONE))
        link.command([0.0, 0.5])
        os.write(board[0], sample(2, guard.DISARMED, reason))
        assert wait_for(lambda: not link.sample().armed)
        with pytest.raises(HardwareError, match=f"{board[1]} switched off: {text}"):
            link.command([0.0, 0.5])
        if reason >= guard.LATCHING:
            with pytest.raises(HardwareError, match=f"refuses to be armed: {text}. Mend it"):
                link.arm(BOUNDS)
        else:
            link.clear()  # nothing is latched: asks for nothing
    sent = protocol.Parser((protocol.ARM, protocol.CLEAR)).feed(os.read(board[0], 4096))
    assert sent == []


def test_a_board_that_takes_no_data_is_hung(board, monkeypatch):
    hung = threading.Event()
    with BoardLink(board[1]) as link:
        monkeypatch.setattr(link._serial, "write", lambda _: hung.wait(5.0))
        start = time.monotonic()
        for _ in range(20):
            link.disarm()  # neither waits nor raises
        assert time.monotonic() - start < 1.0
        with pytest.raises(HardwareError, match="takes no more data; is the board hung"):
            link.info()
        hung.set()
