"""The host's end of the cable: sends and receives frames, in separate threads."""

import contextlib
import dataclasses
import os
import queue
import threading
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np
import serial

from hardware.firmware import guard, protocol
from limb_systems import LimbError

FIRMWARE_VERSIONS = (2,)
BAUD_RATE = 115200
STALE = 0.25  # s, age after which a sample must not be used
ANSWER_TIME = 1.0  # s, within which a board answers
WAITING_FRAMES = 8

Answer = TypeVar("Answer")


class HardwareError(LimbError):
    """The board, its cable or its sensors failed; the wires are off."""


@dataclasses.dataclass(frozen=True)
class Sample:
    """What the board measured.

    - ``received``: time of arrival by this computer's monotonic clock, s.
    - ``sequence``: number of the sample, modulo 65536.
    - ``board_time``: time since the board was started, s.
    - ``challenge``: number that the next arming must repeat.
    - ``armed``: whether the wires may be heated.
    - ``reason``: why they may not, one of the reasons of `hardware.firmware.guard`.
    - ``acknowledged``: sequence of the last command, modulo 65536.
    - ``temperature``: V (2), °C.
    - ``tip_tangent``: α, as the bend sensor reads it, rad.
    - ``duty``: applied (2).
    """

    received: float
    sequence: int
    board_time: float
    challenge: int
    armed: bool
    reason: int
    acknowledged: int
    temperature: np.ndarray
    tip_tangent: float
    duty: np.ndarray

    @property
    def age(self) -> float:
        """Time since it was received, s."""
        return time.monotonic() - self.received


@dataclasses.dataclass(frozen=True)
class BoardInfo:
    """A board's description of itself.

    - ``firmware_version``.
    - ``sample_period``: s.
    - ``temperature_limit``: °C, measured, at which it switches off.
    - ``serial_number``.
    - ``channels``: number of wires that it drives.
    """

    firmware_version: int
    sample_period: float
    temperature_limit: float
    serial_number: str
    channels: int


class BoardLink:
    """A connection to a board. It arms the board only in `arm`.

    Threads read and write. Only `info`, `arm` and `clear` wait for the cable: for
    an answer, and at most a second. Use it as a context manager, or `close` it:
    both disarm the board.
    """

    def __init__(self, port: str):
        """
        Args:
            port: name of a serial port, or any URL of pyserial's.

        Raises:
            HardwareError: if it cannot be opened, or another program has it.
        """
        self.port = port
        try:
            self._serial = serial.serial_for_url(
                port, BAUD_RATE, timeout=0.01, write_timeout=0.2, do_not_open=True
            )
            with contextlib.suppress(AttributeError, ValueError):
                self._serial.exclusive = True  # only for ports, not for URLs of sockets
            self._serial.open()
        except (serial.SerialException, ValueError, OSError) as error:
            if "exclusively lock" in str(error):
                raise HardwareError(f"{port} is in use by another program.") from error
            number = getattr(error, "errno", None)
            reason = os.strerror(number) if number else str(error)
            raise HardwareError(f"Cannot open {port}: {reason}.") from error
        self.parser = protocol.Parser((protocol.INFO, protocol.SAMPLE))
        self.lost_samples = 0
        self._sample: Sample | None = None
        self._info: BoardInfo | None = None
        self._session, self._sequence = 0, 0
        self._failure: str | None = None
        self._arrived = threading.Condition()
        self._outgoing: queue.Queue[bytes | None] = queue.Queue(WAITING_FRAMES)
        self._closing = False
        self._threads = [
            threading.Thread(target=work, name=f"{port} {work.__name__}", daemon=True)
            for work in (self._read, self._write)
        ]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> "BoardLink":
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def info(self) -> BoardInfo:
        """Asks the board for its description.

        Raises:
            HardwareError: if it does not answer, or speaks another protocol.
        """
        info = self._ask(protocol.encode(protocol.HELLO), lambda: self._info, "a greeting")
        if info.firmware_version not in FIRMWARE_VERSIONS:
            raise HardwareError(
                f"The board on {self.port} has firmware {info.firmware_version}; this "
                f"program needs {' or '.join(map(str, FIRMWARE_VERSIONS))}."
            )
        return info

    def sample(self) -> Sample:
        """The newest sample.

        Raises:
            HardwareError: if it is older than 0.25 s, or the cable is gone.
        """
        self._check()
        sample = self._sample or self._wait(lambda: self._sample, "after the port was opened")
        if sample.age > STALE:
            raise HardwareError(
                f"Nothing came from the board on {self.port} for {sample.age:.2f} s."
            )
        return sample

    def arm(self) -> None:
        """Arms the board: commands heat from now on.

        Raises:
            HardwareError: if it does not let itself be armed, with its reason.
        """
        sample = self.sample()
        if sample.reason >= guard.LATCHING:
            raise HardwareError(
                f"The board on {self.port} refuses to be armed: {guard.TEXTS[sample.reason]}. "
                "Mend it, then clear the fault: python -m hardware status PORT --clear."
            )
        self._session, self._sequence = sample.challenge, 0
        self._ask(
            protocol.encode(protocol.ARM, sample.challenge),
            lambda: self._sample and self._sample.armed,
            "arming",
        )

    def command(self, duty: np.ndarray) -> None:
        """Sends a duty (2), in [0, 1]; it holds for 250 ms.

        Raises:
            HardwareError: if it is out of range or not a number, if the board
                is not armed, or if samples no longer come.
        """
        duty = np.asarray(duty, float)
        if duty.shape != (2,) or not ((duty >= 0) & (duty <= 1)).all():  # NaN is not
            raise HardwareError(f"duty is {duty.tolist()}; it must be two numbers from 0 to 1.")
        sample = self.sample()
        if not sample.armed:
            raise HardwareError(
                f"The board on {self.port} switched off: {guard.TEXTS[sample.reason]}."
            )
        self._sequence += 1
        ticks = np.round(protocol.FULL_DUTY * duty).astype(int).tolist()
        self._send(protocol.encode(protocol.COMMAND, self._session, self._sequence, *ticks))

    def disarm(self) -> None:
        """Switches the wires off. Does not wait, and never raises."""
        with contextlib.suppress(HardwareError):
            self._send(protocol.encode(protocol.DISARM))

    def clear(self) -> None:
        """Clears a latched fault; the board stays off until it is armed.

        Raises:
            HardwareError: if the fault is still there.
        """
        sample = self.sample()
        if sample.reason < guard.LATCHING:
            return
        self._ask(
            protocol.encode(protocol.CLEAR, sample.challenge),
            lambda: self._sample and self._sample.reason < guard.LATCHING,
            f"clearing, as {guard.TEXTS[sample.reason]}",
        )

    def close(self) -> None:
        """Disarms the board and closes the port; a second call does nothing."""
        if self._closing:
            return
        for _ in range(3):  # a frame may get lost
            self.disarm()
        with contextlib.suppress(queue.Full):
            self._outgoing.put(None, timeout=0.2)
        self._threads[1].join(1.0)
        self._closing = True
        self._threads[0].join(1.0)
        with contextlib.suppress(serial.SerialException, OSError):
            self._serial.close()

    def _ask(self, frame: bytes, answer: Callable[[], Answer | None], what: str) -> Answer:
        """Sends a frame until it is answered, because frames may get lost."""
        end = time.monotonic() + ANSWER_TIME
        while time.monotonic() < end:
            self._send(frame)
            with self._arrived:
                if self._arrived.wait_for(lambda: answer() or self._failure, 0.1):
                    break
        return self._answer(answer, what)

    def _wait(self, answer: Callable[[], Answer | None], what: str) -> Answer:
        with self._arrived:
            self._arrived.wait_for(lambda: answer() or self._failure, ANSWER_TIME)
        return self._answer(answer, what)

    def _answer(self, answer: Callable[[], Answer | None], what: str) -> Answer:
        self._check()
        if found := answer():
            return found
        if self.parser.other_version is not None:
            raise HardwareError(
                f"The board on {self.port} speaks version {self.parser.other_version} of the "
                f"protocol, but this program version {protocol.VERSION}; flash the board with the "
                "firmware that came with this program."
            )
        raise HardwareError(f"The board on {self.port} does not answer {what}.")

    def _check(self) -> None:
        if self._failure:
            raise HardwareError(self._failure)

    def _send(self, frame: bytes) -> None:
        try:
            self._outgoing.put_nowait(frame)
        except queue.Full as error:
            raise HardwareError(f"{self.port} takes no more data; is the board hung?") from error

    def _fail(self, error: Exception) -> None:
        with self._arrived:
            self._failure = self._failure or f"The cable to {self.port} is gone: {error}."
            self._arrived.notify_all()

    def _write(self) -> None:
        while (frame := self._outgoing.get()) is not None:
            try:
                self._serial.write(frame)
            except (serial.SerialException, OSError) as error:
                self._fail(error)

    def _read(self) -> None:
        while not self._closing:
            try:
                data = self._serial.read(max(1, self._serial.in_waiting))
            except (serial.SerialException, OSError, TypeError) as error:
                self._fail(error)
                return
            for kind, values in self.parser.feed(data):
                with self._arrived:
                    self._take(kind, values)
                    self._arrived.notify_all()

    def _take(self, kind: int, values: tuple) -> None:
        if kind == protocol.INFO:
            version, period, limit, number, channels = values
            text = number.rstrip(b"\0")
            name = text.decode() if text.isalnum() else number.hex()
            self._info = BoardInfo(version, period / 1000, limit / 4, name, channels)
            return
        sequence, ticks, challenge, state, reason, acknowledged, left, right, bend, *duty = values
        if self._sample is not None:
            self.lost_samples += (sequence - self._sample.sequence - 1) & 0xFFFF
        self._sample = Sample(
            received=time.monotonic(),
            sequence=sequence,
            board_time=ticks / 1000,
            challenge=challenge,
            armed=state == guard.ARMED,
            reason=reason,
            acknowledged=acknowledged,
            temperature=np.array([left, right]) / 4,
            tip_tangent=float(np.deg2rad(bend / 64)),
            duty=np.array(duty) / protocol.FULL_DUTY,
        )
