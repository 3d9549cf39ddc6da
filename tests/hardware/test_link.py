"""Boards that are none, are others' or are hung, as the host's end of the cable tells."""

import os
import threading
import time
import tty

import pytest

from hardware import BoardLink, HardwareError, SerialLimb
from hardware.firmware import guard, protocol
from limb_systems import LimbError

from .conftest import wait_for


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


def sample(number, state, reason):
    return protocol.encode(
        protocol.SAMPLE, number, 50 * number, 4711, state, reason, 0, 100, 100, 0, 0, 0
    )


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
                link.arm()
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
