"""Sketches of other labs on an emulated board with an emulated limb, which speak lines of text.

They are written after what such sketches do, and know nothing of how the host describes them.
"""

import re
import time
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from hardware.emulation.emulated_board import EmulatedBoard
from hardware.emulation.twin import LimbTwin
from limb_systems import LimbError

KINDS = ("brackets", "two-floats", "on-off")
REPORT_PERIOD = 0.1  # s
ORDERS = "timeout SECONDS, say [LINE], deafen, unplug, cool"


class Cable(Protocol):
    """The board's end of a connection to a host."""

    def read(self) -> bytes:
        """The bytes from the host since the last call, possibly none."""

    def write(self, data: bytes) -> None:
        """Sends to the host; it may get lost."""

    def unplug(self) -> None:
        """Ends the connection for good."""


class EmulatedSketch:
    """A sketch's loop. Each holds its last duty for ever, unless it is given a timeout.

    - brackets: takes ``<p1,p2,p3,p4>``, 0 to 255 for the right and the left wire and two pins
      that nothing is on; sends ``[MPR]: right left bend 0`` at 10 Hz, °C and degrees of the tip's
      tangent.
    - two-floats: takes ``left right``, each from 0 to 1, and sends nothing.
    - on-off: takes ``1100``, on or off for left, right and two pins that nothing is on.
    """

    def __init__(
        self,
        kind: str,
        twin: LimbTwin,
        cable: Cable,
        on_event: Callable[..., None] = lambda **_: None,
        clock: Callable[[], float] = time.monotonic,
    ):
        """
        Args:
            kind: one of `KINDS`.
            twin, cable, on_event, clock: as for `Emulation`; the event "line" has each
                ``text`` that came in.

        Raises:
            LimbError: if the limb has another number of wires than two.
        """
        if (wires := len(twin.parameters.wires)) != 2:
            raise LimbError(f"An emulated sketch is for two wires; this limb has {wires}.")
        self._kind, self._cable, self._on_event, self._clock = kind, cable, on_event, clock
        self.board = EmulatedBoard(twin, self._report_duty, clock)
        self._sensor = twin.parameters.segments[0].bend_sensor
        self._duty, self._said, self._unread = [0.0, 0.0], "", b""
        self._heard = self._reported = clock()
        self._timeout, self._silent, self._plugged = np.inf, kind != "brackets", True
        self._deaf = False

    def step(self) -> None:
        """One pass of the loop."""
        self.board.keep_supply()  # there is no relay
        self.board.advance()
        if not self._plugged:
            return
        *lines, self._unread = (self._unread + self._cable.read()).split(b"\n")
        for line in [] if self._deaf else lines:
            self._take(line.decode(errors="replace").strip())
        now = self._clock()
        if now - self._heard > self._timeout:
            self._set(0.0, 0.0)
        if not self._silent and now - self._reported > REPORT_PERIOD:
            self._reported = now
            self._report()

    def misbehave(self, order: str) -> None:
        """Carries out one of `ORDERS`.

        Raises:
            LimbError: if it is not understood.
        """
        match order.split():
            case ["timeout", seconds] if re.fullmatch(r"\d*\.?\d+", seconds):
                self._timeout = float(seconds)
            case ["say", *words]:  # in place of the readings; nothing if there is no line
                self._said, self._silent = " ".join(words), not words
            case ["deafen"]:  # it goes on answering, and takes no lines any more
                self._deaf = True
            case ["unplug"]:
                self._plugged = False
                self._cable.unplug()
            case ["cool"]:
                self.board.cool()
            case _:
                raise LimbError(f"'{order}' is not understood; orders of sketches are: {ORDERS}")
        self._on_event(event="order", order=order.strip(), time=self._clock())

    def _take(self, line: str) -> None:
        self._on_event(event="line", text=line, time=self._clock())
        if self._kind == "brackets" and (inside := re.fullmatch(r"<(\d+),(\d+),\d+,\d+>", line)):
            right, left = (int(count) / 255 for count in inside.groups())
        elif self._kind == "two-floats" and re.fullmatch(r"[\d.]+ [\d.]+", line):
            left, right = map(float, line.split())
        elif self._kind == "on-off" and re.fullmatch(r"[01]{4}", line):
            left, right = float(line[0]), float(line[1])
        else:
            return
        self._heard = self._clock()
        self._set(left, right)

    def _set(self, *duty: float) -> None:
        for wire, share in enumerate(duty):
            if self._duty[wire] != share:
                self._duty[wire] = share
                self.board.set_duty(wire, share)

    def _report(self) -> None:
        left, right = self.board.reading("measured_temperature")
        bend = np.rad2deg(self._sensor.reading(self.board.reading("bend_angle")[0]))
        said = self._said or f"[MPR]: {right:.2f} {left:.2f} {bend:.2f} 0"
        self._cable.write(f"{said}\r\n".encode())

    def _report_duty(self, duty: Sequence[float]) -> None:
        left, right = duty
        self._on_event(event="duty", left=left, right=right, time=self._clock())
