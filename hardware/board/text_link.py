"""The host's end of a cable to a text board, with what `SerialLimb` asks of a `BoardLink`."""

import contextlib
import dataclasses
import json
import os
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from hardware.board import port_keeper
from hardware.board.link import (
    ANSWER_TIME,
    BoardInfo,
    BoardLink,
    Closed,
    HardwareError,
    Sample,
    SerialPort,
    checked_duty,
)
from hardware.board.several_boards import SeveralBoards
from hardware.board.signals import heed_signals
from hardware.board.text_answers import AnswerCheck
from hardware.board.text_board import BEND, UNUSED, TextBoard, TextBoardError
from hardware.firmware import guard
from limb_systems import LimbParameters
from limb_systems.heat_bounds import HeatBounds

SILENCE = 0.5  # s, after which a board that should answer is given up
LONGEST_LINE = 1000  # bytes
CLOSING_TIME = 2.0  # s
Ports = str | Mapping[str, str]  # of a board, or of those of a robot's limbs by name


class TextBoardWarning(UserWarning):
    """What is not safe about a text board that is armed."""


def open_link(
    port: Ports, limb: LimbParameters, board: TextBoard | str | Path | None = None
) -> "Link":
    """A link to the board of a limb, which speaks the protocol unless it is described.

    Raises:
        HardwareError: if a port cannot be opened.
        LimbError: if there are several ports, but not for all limbs.
        TextBoardError: if the description is wrong, or of another limb, or there are several ports.
    """
    if not isinstance(port, str):
        if board is not None:
            raise TextBoardError(
                "Several boards are switched off together only if all of them speak the protocol; "
                "give one port, or no description of a board."
            )
        return SeveralBoards(port, limb)
    if board is None:
        return BoardLink(port, limb)
    board = TextBoard.of(board)
    board.check_limb(limb)
    return TextLink(port, board, limb.wire_names)


class TextLink(Closed):
    """A connection to a text board, with the methods of `BoardLink` that a limb needs.

    The port is kept by a process of its own, `hardware.board.port_keeper`, which sends zero
    whenever this one does not command, has ended or hangs. If that process dies, this one sends
    zero. Use it as a context manager, or `close` it.

    - ``lost_samples``: number of lines that did not match, after the first that did.
    """

    def __init__(self, port: str, board: TextBoard, wire_names: Sequence[str]):
        """
        Args:
            port: name of a serial port.
            board: description of the board, as of `TextBoard.of`.
            wire_names: names of the limb's wires, in its order.

        Raises:
            HardwareError: if it cannot be opened, or another program has it.
        """
        self.port, self.board, self.lost_samples = port, board, 0
        self._wires = list(wire_names)
        self._cable = SerialPort(port, board.baud_rate)
        self._opened = time.monotonic()
        self._armed: float | None = None
        self._total, self._sent = 0.0, np.zeros(len(self._wires))
        self._failure, self._closing, self._count = "", False, 0
        self._read_last: tuple[float, dict[str, float]] | None = None
        self._answers = AnswerCheck(board, self._wires)
        self._told, self._deaf = False, False  # that it failed; that no lines are taken any more
        self._arrived = threading.Condition()
        handle = self._cable.handle()
        settings = {
            "port": handle,
            "line": dataclasses.asdict(board.line),
            "channels": len(board.channels),
            "rate": board.rate,
        }
        self._keeper = cast(Any, subprocess.Popen)(
            [sys.executable, "-I", port_keeper.__file__, json.dumps(settings)],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=[handle],
            start_new_session=True,  # out of reach of the terminal's signals
        )
        os.set_blocking(self._keeper.stdin.fileno(), False)
        self._thread = threading.Thread(target=self._read, name=f"{port} read", daemon=True)
        self._thread.start()

    def info(self) -> BoardInfo:
        """What the description says of the board; its cause of a reset is not known."""
        board, channels = self.board, len(self.board.wires)
        return BoardInfo(
            0, 1 / board.rate, board.temperature_limit, board.name, channels, "unknown"
        )

    def sample(self, oldest: float = SILENCE) -> Sample:
        """The newest readings, nan where there are none; ``duty`` is what was sent last.

        Args:
            oldest: age at which they must not be used, s. Whoever heats leaves it as it is.

        Raises:
            HardwareError: if no line that matches came for so long, or the cable is gone.
        """
        received, values = time.monotonic(), dict[str, float]()
        if self.board.answer:
            self._wait_until(self._opened + self.board.start_up + ANSWER_TIME, for_answer=True)
            received, values = self._read_last or (-np.inf, {})
            if time.monotonic() - received > oldest:
                raise self._error(f"No line that matches came from {self.port} for {oldest:g} s")
        self._check()
        return Sample(
            received=received,
            sequence=self._count & 0xFFFF,
            board_time=received - self._opened,
            challenge=0,
            armed=self._armed is not None,
            reason=guard.NONE if self._armed else guard.HOST,
            acknowledged=0,
            temperature=np.array([values.get(name, np.nan) for name in self._wires]),
            tip_tangent=np.array([values.get(BEND, np.nan)]),
            duty=self._sent,
            warmest=np.full(len(self._wires), np.nan),
        )

    def arm(self, bounds: Sequence[HeatBounds] = (), total_duty: float = 1.5) -> None:
        """Lets commands heat from now on, with a warning of what such a board cannot do.

        Args:
            bounds: bounds of the wires; they are widened to those of any wire, and where a
                temperature is answered with, heat must show by them.
            total_duty: largest sum of all duties; commands are reduced to it.

        Raises:
            HardwareError: if readings are missing, too high, or what no sensor reads.
            KeyboardInterrupt: if a signal has ended the command that runs.
        """
        heed_signals()
        self._wait_until(self._opened + self.board.start_up)
        self._check_readings()
        measured = self.board.answered.issuperset(self._wires)
        self._answers.arm(self.sample().temperature, bounds if measured else ())
        self._total = total_duty
        with warnings.catch_warnings():
            warnings.simplefilter("always", TextBoardWarning)  # not only the first time
            warnings.warn(
                f"{self.board.name} is a text board, without the checks of the protocol: this "
                "program and a second process send zero on every way out, but nothing confirms "
                "that it arrives. If the cable, the computer or both processes fail, "
                f"{self.board.fate}. Stay with it.",
                TextBoardWarning,
                stacklevel=3,
            )
        self._armed = time.monotonic()

    def command(self, duty: np.ndarray) -> None:
        """Sends a duty (W), in [0, 1]; it holds for 250 ms.

        More than ``most_duty`` and ``total_duty`` is reduced to them, as a board does it.

        Raises:
            HardwareError: if it is out of range or not a number, if readings are missing, too
                high or what no sensor reads, if they show that the board takes no lines any more,
                or if it was armed for too long.
            KeyboardInterrupt: if a signal has ended the command that runs.
        """
        heed_signals()
        duty = np.minimum(checked_duty(duty, len(self._wires)), self.board.most_duty)
        duty = duty * min(1.0, self._total / max(duty.sum(), 1e-9))
        if self._armed is None:
            raise self._error(f"The board on {self.port} is not armed")
        if time.monotonic() - self._armed > self.board.longest + SILENCE:
            raise self._error(
                f"{self.board.name} was armed for {self.board.longest:g} s, its longest"
            )
        self._check_readings()
        self._check_answers()
        self._sent = duty
        by_name = dict(zip(self._wires, duty.tolist(), strict=True)) | {UNUSED: 0.0}
        self._tell(" ".join(f"{by_name[name]:.6f}" for name in self.board.channels))

    def disarm(self) -> None:
        """Sends zero. Does not wait, and never raises."""
        self._armed, self._sent = None, np.zeros(len(self._wires))
        with contextlib.suppress(HardwareError):
            self._tell("")

    def close(self) -> None:
        """Sends zero and closes the port; a second call does nothing.

        If wires were heated and are measured, it waits until readings show that they cool, mostly
        for some seconds.

        Raises:
            HardwareError: if they show that the board takes no lines any more, or do not come.
        """
        if self._closing:
            return
        self.disarm()
        told = self._told
        try:
            while self._answers.waiting and not self._deaf:
                time.sleep(1 / self.board.rate)
                self._check_answers()
        except HardwareError:
            if self._deaf or not told:  # else it would say the same again
                raise
        finally:
            self._closing = True
            self._keeper.stdin.close()
            try:
                self._keeper.wait(CLOSING_TIME)
            except subprocess.TimeoutExpired:
                self._keeper.kill()
            self._thread.join(CLOSING_TIME)
            self._cable.close()

    def _check_readings(self) -> None:
        """Raises HardwareError if a reading is missing, too high, or what no sensor reads."""
        sample = self.sample()
        if fault := self._answers.implausible(self._values()):
            raise self._error(fault)
        for name, temperature in zip(self._wires, sample.temperature, strict=True):
            if temperature >= self.board.temperature_limit:
                raise self._error(
                    f"The {name} wire is read at {temperature:.1f} °C, and temperature_limit is "
                    f"{self.board.temperature_limit:g} °C"
                )

    def _check_answers(self) -> None:
        """Raises HardwareError if answers show that the board takes no lines any more."""
        self.sample()
        if fault := self._answers.implausible(self._values()):
            raise self._error(fault)
        if sign := self._answers.deaf(time.monotonic(), self._sent, self._values()):
            self.disarm()
            self._deaf = True
            raise HardwareError(
                f"{sign}: the sketch of {self.board.name} seems to take no lines any more, so "
                "switch the wires' supply off now."
            )

    def _values(self) -> dict[str, float]:
        """The newest readings by their names."""
        return self._read_last[1] if self._read_last else {}

    def _error(self, what: str) -> HardwareError:
        """An error in words, after which nothing is heated until it is armed again."""
        self._told = True
        if self._armed is not None:
            self.disarm()
        return HardwareError(self._with_fate(f"{what}; zero is sent"))

    def _with_fate(self, what: str) -> str:
        return f"{what}. Where zero does not arrive, {self.board.fate}."

    def _check(self) -> None:
        if self._failure:
            self._told = True
            raise HardwareError(self._failure)

    def _wait_until(self, end: float, *, for_answer: bool = False) -> None:
        """Waits until a time, or for a first answer; HardwareError if the cable is gone."""
        with self._arrived:
            self._arrived.wait_for(
                lambda: self._failure or (for_answer and self._read_last),
                max(0.0, end - time.monotonic()),
            )
        self._check()

    def _tell(self, line: str) -> None:
        try:
            if self._keeper.stdin.write(line.encode() + b"\n") is None:
                raise self._error(f"{self.port} takes no more data")
        except (OSError, ValueError) as error:
            self._thread.join(ANSWER_TIME)  # it says why
            self._check()
            raise self._error(f"The connection to {self.port} is closed") from error

    def _read(self) -> None:
        """What the thread does: takes lines until the keeper ends, and says why it did."""
        unread = b""
        while data := self._keeper.stdout.read(4096):
            *lines, unread = (unread + data).replace(b"\r", b"\n").split(b"\n")
            unread = unread[-LONGEST_LINE:]
            for line in filter(None, lines):
                self._take(line.decode(errors="replace").strip())
        why = self._keeper.stderr.read().decode().strip()
        if self._keeper.wait() < 0:
            why = "the process that keeps it was killed; zero is sent"
            for _ in range(port_keeper.LAST_LINES):
                with contextlib.suppress(HardwareError):
                    self._cable.send(self.board.bytes_of([0.0] * len(self.board.channels)))
                time.sleep(port_keeper.LONGEST_PAUSE / 2)
        if not self._closing:
            with self._arrived:
                self._failure = self._with_fate(f"The connection to {self.port} ended: {why}")
                self._arrived.notify_all()

    def _take(self, line: str) -> None:
        values = self.board.answer.read(line) if self.board.answer else None
        if values is None:
            self.lost_samples += self._read_last is not None
            return
        with self._arrived:
            self._count += 1
            self._read_last = time.monotonic(), values
            self._arrived.notify_all()


Link = BoardLink | TextLink | SeveralBoards
