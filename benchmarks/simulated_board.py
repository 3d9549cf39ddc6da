"""An emulated board with a host at its cable, in simulated time, for faults that take long."""

import copy
import dataclasses
import types
from collections.abc import Sequence
from typing import Any

import numpy as np

from hardware.board.link import Sample, SampleAssembler, pulls_of
from hardware.board.reasons import REASONS
from hardware.emulation.emulated_board import RunningTwin
from hardware.emulation.emulator import Emulation
from hardware.emulation.twin import LimbTwin
from hardware.firmware import from_host, protocol
from limb_systems import LimbError, LimbParameters
from walking.robot_twin import RobotTwin

COMMAND_PERIOD = 50  # ms


class SimulatedBoard:
    """An emulated board, and a host that commands it whatever the board says.

    It is the board's `Cable`, too. Faults are given to ``emulation.inject_fault``.

    - ``duties``: time, s, and duty of each wire, of each change at the pins.
    - ``samples``: each `Sample` that came, once.
    """

    def __init__(
        self,
        twin: LimbTwin | RobotTwin | RunningTwin | None = None,
        parameters: LimbParameters | None = None,
        step: int = 1,
        limb: str = "",
    ):
        """
        Args:
            twin: the limb; a nominal one of the seed 0 if None.
            parameters: those that the host arms the board with; the twin's if None.
            step: ms, between two passes of the firmware's loop.
            limb: as for `Emulation`.
        """
        self.milliseconds = 0
        self._step = step
        self.duties: list[tuple[float, ...]] = []
        self.samples: list[Sample] = []
        self._assembly = SampleAssembler()
        self._to_board = b""
        self._sequence = 0
        self._session = 0
        self._parser = protocol.Parser(protocol.BOARD_KINDS)
        self.emulation = Emulation(twin or LimbTwin(), self, self._note, lambda: self.now, limb)
        self.use(parameters or self.emulation.board.parameters)

    @property
    def now(self) -> float:
        """The time since it was switched on, s."""
        return self.milliseconds / 1000

    @property
    def newest(self) -> Sample:
        """The sample that came last."""
        return self.samples[-1]

    def _note(self, event, time, **duty):
        if event == "duty":
            self.duties.append((time, *duty.values()))

    # The board's end of the cable.

    def read(self) -> bytes:
        data = self._to_board
        self._to_board = b""
        return data

    def write(self, data: bytes) -> None:
        for kind, values in self._parser.feed(data):
            sample = kind != protocol.INFO and self._assembly.take(kind, values, self.now)
            if sample and (not self.samples or self.newest.sequence != sample.sequence):
                self.samples.append(sample)  # they come twice

    def unplug(self) -> None:
        pass

    # The host's.

    def send(self, *frame: Any) -> None:
        """Send a frame of a kind with values."""
        self._to_board += protocol.encode(*frame)

    def command(self, duty: Sequence[float]) -> None:
        """Send a duty (W), in answer to the newest sample."""
        self._sequence += 1
        sample_time = round(1000 * self.newest.board_time)
        frame = from_host.encode_command(self._session, self._sequence, sample_time, duty)
        self._to_board += 2 * frame  # as `BoardLink` does

    def use(self, parameters: LimbParameters) -> None:
        """Arm the board with other parameters from now on."""
        self.parameters = parameters
        self._bounds = [dataclasses.astuple(bounds) for bounds in parameters.heat_bounds]
        self._total = parameters.total_duty
        self._pulls = pulls_of(parameters)

    def arm(self) -> bool:
        """Arm the board; return whether it let itself be armed."""
        self._session = self.newest.challenge
        self._sequence = 0
        arming = self._session, self._bounds, self._total, self._pulls
        self._to_board += b"".join(from_host.encode_arming(*arming))
        self.run(0.06)
        return self.newest.armed

    def clear(self) -> None:
        """Clear a latched fault."""
        self.send(protocol.CLEAR, self.newest.challenge)
        self.run(0.06)

    def run(self, seconds: float, duty: Sequence[float] | None = None) -> None:
        """Run on, and command a duty (W) every 50 ms if there is one."""
        end = self.milliseconds + round(1000 * seconds)
        while self.milliseconds < end:
            self.milliseconds += self._step
            if duty is not None and self.milliseconds % COMMAND_PERIOD == 0:
                self.command(duty)
            self.emulation.step()

    @property
    def duty(self) -> tuple[float, ...]:
        """The duty at the pins (W)."""
        return self.duties[-1][1:]

    @property
    def reason(self) -> int:
        """The board's reason for being off."""
        return self.newest.reason

    @property
    def temperature(self) -> list[float]:
        """V (W), as the board sends it, °C."""
        return self.newest.temperature.tolist()


class SimulatedLink:
    """The part of a `BoardLink` that `check_wires` needs, at a `SimulatedBoard`."""

    port = "simulated"

    def __init__(self, board: SimulatedBoard):
        self._board = board
        self.hottest = -np.inf

    def info(self):
        channels = self._board.duty
        angles = self._board.samples[-1].tip_tangent
        return types.SimpleNamespace(
            serial_number="simulated",
            firmware_version="",
            channels=len(channels),
            angles=len(angles),
        )

    def next_sample(self) -> Sample:
        count = len(self._board.samples)
        while len(self._board.samples) == count:
            self._board.run(0.025)
        self.hottest = max(self.hottest, *self._board.emulation.board.wire_temperature())
        return self._board.samples[-1]

    def arm(self, bounds, total_duty: float = 1.5) -> None:
        parameters = copy.deepcopy(self._board.parameters)
        parameters.total_duty = total_duty
        for wire, bound in zip(parameters.wires, bounds, strict=True):
            wire.heat_bounds = bound
        self._board.use(parameters)
        if not self._board.arm():
            raise LimbError(f"not armed: {REASONS[self._board.reason]}")

    def command(self, duty) -> None:
        if not self._board.newest.armed:
            raise LimbError(f"switched off: {REASONS[self._board.reason]}")
        self._board.command(duty)

    def disarm(self) -> None:
        self._board.send(protocol.DISARM)
        self._board.run(0.06)
