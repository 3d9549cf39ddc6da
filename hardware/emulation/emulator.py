"""The emulator: the firmware on an emulated board, at the end of a cable.

Orders inject faults into board, sensors and cable.
"""

import contextlib
import functools
import json
import os
import random
import select
import subprocess
import sys
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from hardware.emulation.emulated_board import EmulatedBoard, RunningTwin
from hardware.emulation.twin import EmulatedSystem
from hardware.firmware.firmware import PIN_RESET, POWER_ON, WATCHDOG_RESET, Firmware
from limb_systems import LimbError
from limb_systems.files.output import raising_output_error

LOOP_PAUSE = 0.001  # s, between two passes of the firmware's loop
MAX_PASS_TIME = 0.05  # s, largest step of the board's clock in a pass
MAX_DELAY = 3.0  # s, of a full buffer
WATCHDOG_MS = 200  # ms of the board's one clock, see board_nrf52dk.py
# Faults of a thermocouple or its amplifier, which sends a reserved bit if garbled.
THERMOCOUPLE_FAULTS: dict[str, dict[str, Any]] = {
    "open": {"faults": 1},
    "ground": {"faults": 2},
    "supply": {"faults": 4},
    "dead": {"word": 0},
    "garbled": {"word": 8},
    "detach": {"share": 0.0},
    "reverse": {"share": -1.0},
    "hot": {"frozen": 115.0},
}


class Cable(Protocol):
    """The board's end of a connection to a host."""

    def read(self) -> bytes:
        """Return the bytes from the host since the last call, possibly none."""

    def write(self, data: bytes) -> None:
        """Send bytes to the host; they may get lost."""

    def unplug(self) -> None:
        """End the connection for good."""


class BadLine:
    """A line that loses, corrupts, doubles, delays and reorders bytes."""

    def __init__(self, clock: Callable[[], float]):
        self._clock = clock
        self._waiting: list[tuple[float, bytes]] = []
        self.mend()

    def mend(self) -> None:
        """Remove all faults; delayed bytes arrive at once."""
        self.rates = dict.fromkeys(("drop", "corrupt", "duplicate", "reorder"), 0.0)
        self.delay = self.creep = 0.0  # s, and rate at which the delay grows, s/s
        self._creeping_since = self._clock()
        self._waiting = [(self._clock(), data) for _, data in self._waiting]

    def start_to_creep(self, rate: float) -> None:
        """Let the delay grow from now on, like the delay of a buffer that fills up."""
        self.creep = rate
        self._creeping_since = self._clock()

    def pass_on(self, data: bytes) -> bytes:
        """Send ``data`` into one end, and return the bytes that arrive at the other end now."""
        # Damage bytes at random.
        damaged = bytearray() if any(self.rates.values()) else bytearray(data)
        for byte in data if not damaged else b"":
            if random.random() < self.rates["drop"]:
                continue
            if random.random() < self.rates["corrupt"]:
                byte = random.getrandbits(8)
            damaged.append(byte)
            if random.random() < self.rates["duplicate"]:
                damaged.append(byte)
            if len(damaged) > 1 and random.random() < self.rates["reorder"]:
                damaged[-2:] = damaged[-1:-3:-1]
        # Delay them, and return bytes whose delay is over.
        now = self._clock()
        if damaged:
            crept = min(self.creep * (now - self._creeping_since), MAX_DELAY)
            self._waiting.append((now + self.delay + crept, bytes(damaged)))
        arrived = b""
        while self._waiting and self._waiting[0][0] <= now:
            _, data = self._waiting.pop(0)
            arrived += data
        return arrived


class PseudoTerminal:
    """A `Cable` whose other end is a serial port of this computer, named ``port``."""

    def __init__(self):
        self._master, self._slave = os.openpty()
        os.set_blocking(self._master, False)
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)

    def read(self) -> bytes:
        try:
            return os.read(self._master, 4096)
        except OSError:  # also if there is nothing to read
            return b""

    def write(self, data: bytes) -> None:
        with contextlib.suppress(OSError):  # without a reader, a serial port drops bytes
            os.write(self._master, data)

    def unplug(self) -> None:
        os.close(self._slave)
        os.close(self._master)


class BoardClock:
    """A clock for the board, which goes on by 50 ms at most in a pass of its loop.

    If the computer is too busy for this process for a while, the board catches up afterwards in
    short passes. Heartbeat and relay then end heat in time, and the limb is never simulated for
    long with the same duty.
    """

    def __init__(self, clock: Callable[[], float]):
        self._clock = clock
        self._now = clock()

    def __call__(self) -> float:
        return self._now

    def go_on(self) -> None:
        """Begin a pass."""
        self._now = min(self._clock(), self._now + MAX_PASS_TIME)


class Emulation:
    """The firmware on an emulated board at the end of a cable."""

    def __init__(
        self,
        twin: EmulatedSystem | RunningTwin,
        cable: Cable,
        on_event: Callable[..., None] = lambda **_: None,
        clock: Callable[[], float] = time.monotonic,
        limb: str = "",
    ):
        """
        Args:
            twin: the limb, or the robot with all its limbs on the board.
            cable: board's end of the cable to the host.
            on_event: called for each event with keyword arguments: ``event``, ``time`` (s, of the
                clock) and more.
            clock: returns the time, s. A test may have a clock that is faster than the computer's.
            limb: name of the robot's limb on the board; all limbs if empty.
        """
        self._cable = cable
        self._on_event = on_event
        self._time = clock
        self._clock = BoardClock(clock)
        self.board = EmulatedBoard(twin, self._report_duty, self._clock, limb)
        self._wire_names = self.board.parameters.wire_names
        self._lines = BadLine(self._clock), BadLine(self._clock)  # from and to the host
        self._plugged = True
        self._stalled_until = self._clock()
        self._recorded = b""  # newest bytes from the host, for the fault "replay"
        self.firmware = Firmware(self.board)

    def step(self) -> None:
        """Run one pass of the loop: limb, received bytes, firmware, sent bytes."""
        self._clock.go_on()
        self.board.advance()
        inwards, outwards = self._lines
        if self._plugged:
            self.board.from_host += inwards.pass_on(self._read())
        # The firmware runs unless it is stalled, which its watchdog ends.
        if self._clock() >= self._stalled_until:
            self.firmware.step()
        if self.board.ticks() - self.board.fed > WATCHDOG_MS:
            self._reset(WATCHDOG_RESET)
        data = bytes(self.board.to_host)
        self.board.to_host.clear()
        if self._plugged and (data := outwards.pass_on(data)):
            self._cable.write(data)

    def inject_fault(self, order: str) -> None:
        """Carry out an order such as "corrupt 0.01" or "open right".

        Raises:
            LimbError: if the order is not understood.
        """
        try:
            self._carry_out(order.split())
        except ValueError as error:
            raise LimbError(f"'{order}' is not understood; orders are: {ORDERS}") from error
        self._on_event(event="order", order=order.strip(), time=self._time())

    def _carry_out(self, words: list[str]) -> None:
        board = self.board
        wire = self._wire_names.index
        match words:
            # Cable.
            case ["drop" | "corrupt" | "duplicate" | "reorder" as damage, rate]:
                for line in self._lines:
                    line.rates[damage] = float(rate)
            case ["delay", seconds]:
                for line in self._lines:
                    line.delay = float(seconds)
            case ["creep", rate]:
                for line in self._lines:
                    line.start_to_creep(float(rate))
            case ["noise", count]:
                board.from_host += random.randbytes(int(count))
            case ["replay"]:
                board.from_host += self._recorded
            case ["unplug"]:
                self._plugged = False
                self._cable.unplug()
            # Sensors.
            case ["freeze", "bend"]:
                board.frozen_bend = board.read_bend()
            case ["stick", "bend", *degrees]:
                present = np.rad2deg(board.reading("bend_angle")).tolist()
                board.stuck_bend = [float(degrees[0])] * len(present) if degrees else present
            case ["silence"]:
                board.bend_is_silent = True
            case ["freeze", name]:
                present = board.reading("measured_temperature")[wire(name)]
                board.fail(wire(name), frozen=present)
            case [fault, name] if fault in THERMOCOUPLE_FAULTS:
                board.fail(wire(name), **THERMOCOUPLE_FAULTS[fault])
            case ["share" | "offset" | "drift" as field, name, value]:
                board.fail(wire(name), **{field: float(value)})
            case ["glitch", name, count]:
                board.fail(wire(name), bad_frames=int(count))
            case ["jitter", name, value]:
                board.fail(wire(name), noise=float(value))
            case ["chill", value]:
                board.chill = float(value)
            # Supply, MOSFETs and board.
            case ["weaken", share]:
                board.heat_share = float(share)
            case ["short", name]:
                board.shorted[wire(name)] = True
            case ["stop", "clock"]:
                board.stop_clock()
            case ["stall", seconds]:
                self._stalled_until = self._clock() + float(seconds)
            case ["reset"]:
                self._reset(PIN_RESET)
            case ["restart"]:
                self._reset(POWER_ON)
            case ["cool"]:
                board.cool()
            case ["mend"]:
                for part in (board, *self._lines):
                    part.mend()
                self._stalled_until = self._clock()
            case _:
                raise ValueError

    def _reset(self, cause: int) -> None:
        self.board.reset(cause)
        self._stalled_until = self._clock()
        self.firmware = Firmware(self.board)

    def _read(self) -> bytes:
        data = self._cable.read()
        self._recorded = (self._recorded + data)[-4096:]
        return data

    def _report_duty(self, duty: Sequence[float]) -> None:
        by_name = dict(zip(self._wire_names, duty, strict=True))
        self._on_event(event="duty", **by_name, time=self._time())


ORDERS = (
    "drop RATE, corrupt RATE, duplicate RATE, reorder RATE, delay SECONDS, "
    "creep SECONDS_PER_S, noise BYTES (cable); "
    "open WIRE, ground WIRE, supply WIRE, dead WIRE, garbled WIRE, hot WIRE, freeze WIRE, "
    "detach WIRE, reverse WIRE, share WIRE SHARE, offset WIRE CELSIUS, "
    "drift WIRE CELSIUS_PER_S, jitter WIRE CELSIUS, glitch WIRE FRAMES, chill CELSIUS "
    "(thermocouples and amplifiers); "
    "freeze bend, stick bend [DEGREES], silence (bend sensor); weaken SHARE, short WIRE "
    "(supply and MOSFETs); stall SECONDS, stop clock, reset, restart (board); unplug, replay, "
    "mend, cool; WIRE is a wire's name, such as left"
)


def emulate(
    twin: EmulatedSystem,
    orders: list[str],
    log: Path | None = None,
    *,
    limbs: Sequence[str] = (),
) -> None:
    """Run the firmware on an emulated board until the process is stopped.

    It prints the port to connect to, and a command that checks whether the board answers there;
    then it carries out orders from standard input. With a board for each limb of a robot it prints
    NAME=PORT for each. An order that begins with a limb's name is for its board alone, any other
    order for all boards.

    Args:
        twin: the limb on the board, or the robot.
        orders: orders to carry out at the start, see `Emulation.inject_fault`.
        log: file with a line of JSON for each change of duty and each order.
        limbs: names of a robot's limbs that have a board each; one board for all if empty.

    Raises:
        LimbError: if an order at the start is not understood.
    """
    with open(log or os.devnull, "w", encoding="utf-8") as file:

        def note(**event) -> None:
            with raising_output_error(log or os.devnull):
                file.write(json.dumps(event) + "\n")
                file.flush()

        # Make a board at a port, or one for each limb of a robot that all boards share.
        cables = {limb: PseudoTerminal() for limb in limbs or [""]}
        if limbs:
            running = RunningTwin(twin)
            boards = {
                limb: Emulation(running, cable, functools.partial(note, limb=limb), limb=limb)
                for limb, cable in cables.items()
            }
        else:
            boards = {"": Emulation(twin, cables[""], note)}

        def carry_out(order: str) -> None:
            name, _, order_of_board = order.strip().partition(" ")
            if name in boards:
                boards[name].inject_fault(order_of_board)
                return
            for board in boards.values():
                board.inject_fault(order)

        for order in orders:
            carry_out(order)
        for limb, cable in cables.items():
            print(f"{limb}={cable.port}" if limb else cable.port, flush=True)
        for cable in cables.values():
            print(f"next        soft-limb status {cable.port}", flush=True)
        # Run all boards, and read orders without a buffer, in which `select` would not see lines.
        source = open(sys.stdin.fileno(), "rb", buffering=0, closefd=False)  # noqa: SIM115
        listening = True
        while True:
            for board in boards.values():
                board.step()
            if listening and select.select([source], [], [], 0)[0]:
                line = source.readline().decode(errors="replace")
                listening = bool(line)
                try:
                    if line.strip():
                        carry_out(line)
                except LimbError as error:
                    print(f"error: {error}", file=sys.stderr)
            time.sleep(LOOP_PAUSE)


@contextlib.contextmanager
def emulated_port(seed: int = 0) -> Iterator[str]:
    """Return a context with the port of an emulated board and limb in a separate process.

    Args:
        seed: seed of the limb.
    """
    program = (
        f"from hardware import LimbTwin; from {__name__} import emulate; "
        f"emulate(LimbTwin(seed={seed}), [])"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as board:
        assert board.stdout  # it is a pipe
        try:
            yield board.stdout.readline().decode().strip()
        finally:
            board.kill()
