"""A board on the bench: raw frames to and from it, for checks of any board's firmware.

Unlike `BoardLink`, it also says what no host should say.
"""

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, Protocol

import serial

from hardware.firmware import guard, protocol
from hardware.robot.link import HardwareError, open_port
from hardware.robot.reasons import REASONS
from limb_systems.signals import heed_signals

POLL = 0.01  # s, between two looks at what came
EFFECT_TIME = 0.15  # s, within which a SAMPLE shows what a frame did
ARMING_TIME = 1.0  # s, in which a board is asked again and again to arm
HEARTBEAT_END = 0.8  # s, within which a board that nobody commands is off
HOTTEST = 90.0  # °C, of a reading at which the checks stop
CLEARING_TIME = 40.0  # s, within which a fault that a check made is gone

# Bounds that suit any wire: (a1 slowest, fastest, a2 least, most, a3 slowest).
WIDE = (0.03, 0.5, 4.0, 40.0, 0.1)

Bounds = Sequence[float]
Ask = Callable[[str, str | None], bool]


class HostEnd(Protocol):
    """The host's end of a cable, in real or in simulated time."""

    def send(self, data: bytes) -> None:
        """Sends bytes to the board."""

    def receive(self) -> bytes:
        """The bytes that came from the board since the last call, possibly none."""

    def now(self) -> float:
        """The time, s."""

    def wait(self, seconds: float) -> None:
        """Lets time pass."""


class SerialEnd:
    """A `HostEnd` at a serial port, in real time. Use it as a context manager."""

    def __init__(self, port: str):
        """
        Args:
            port: name of a serial port, or any URL of pyserial's.

        Raises:
            HardwareError: if it cannot be opened, or another program has it.
        """
        self.port = port
        self._serial = open_port(port)

    def __enter__(self) -> "SerialEnd":
        return self

    def __exit__(self, *_) -> None:
        with contextlib.suppress(serial.SerialException, OSError):
            self._serial.close()

    def send(self, data: bytes) -> None:
        self._do(lambda: self._serial.write(data))

    def receive(self) -> bytes:
        return self._do(lambda: self._serial.read(self._serial.in_waiting))

    def now(self) -> float:
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        time.sleep(seconds)

    def _do(self, action):
        try:
            return action()
        except (serial.SerialException, OSError, TypeError) as error:
            number = getattr(error, "errno", None)
            reason = os.strerror(number) if number else str(error)
            raise HardwareError(f"The cable to {self.port} is gone: {reason}.") from error


class RawSample(NamedTuple):
    """The numbers of a SAMPLE, as docs/protocol.md lists them."""

    sequence: int
    time: int
    challenge: int
    state: int
    reason: int
    acknowledged: int
    left: int
    right: int
    bend: int
    duty_left: int
    duty_right: int
    warmest_left: int
    warmest_right: int

    @property
    def armed(self) -> bool:
        return self.state == guard.ARMED

    @property
    def duty(self) -> tuple[int, int]:
        """Applied, in 1/10000."""
        return self.duty_left, self.duty_right

    @property
    def temperature(self) -> tuple[float, float]:
        """V, °C."""
        return self.left / 4, self.right / 4

    @property
    def warmest(self) -> tuple[int, int]:
        """°C."""
        return self.warmest_left, self.warmest_right

    @property
    def latched(self) -> bool:
        return self.reason >= guard.LATCHING

    @property
    def why(self) -> str:
        """State and reason, for a message."""
        if self.armed:
            return "it is armed"
        return f"it is off for reason {self.reason}, {REASONS.get(self.reason, 'unknown')}"


class CheckFailedError(Exception):
    """The board breaks a rule."""


class StaysOnError(Exception):
    """The board heats when it must not."""


class NotRunError(Exception):
    """A check could not be made."""


def expect(good: bool, what: str) -> None:
    """Raises `CheckFailedError` with a sentence unless it is good."""
    if not good:
        raise CheckFailedError(what)


class Bench:
    """A board on the bench.

    - ``samples``: all that came, each once.
    - ``copies``: for each of them how often it came.
    - ``arrivals``: when, s.
    - ``infos``: values of each INFO.
    - ``received``: all bytes.
    """

    def __init__(self, end: HostEnd, ask: Ask | None = None):
        """
        Args:
            end: of the cable to the board.
            ask: has something done at the robot: takes an order to an emulated board, and a
                sentence to a person or None; whether it was done.
        """
        self._end, self._ask = end, ask
        self.samples: list[RawSample] = []
        self.copies: list[int] = []
        self.arrivals: list[float] = []
        self.infos: list[tuple] = []
        self.session, self.sequence = 0, 0
        self._rest: RawSample | None = None
        self._new_parser()

    def _new_parser(self) -> None:
        self.parser = protocol.Parser((protocol.INFO, protocol.SAMPLE))
        self.received = bytearray()

    # Bytes and frames.

    def send(self, kind: int, *values: int) -> None:
        """Sends a frame."""
        self.send_bytes(protocol.encode(kind, *values))

    def send_bytes(self, data: bytes) -> None:
        self._end.send(data)

    @property
    def now(self) -> float:
        """s."""
        return self._end.now()

    def steps(self, seconds: float) -> Iterator[bool]:
        """Lets time pass; yields after each look at what came whether a new SAMPLE did."""
        end = self.now + seconds - POLL / 2
        while self.now < end:
            self._end.wait(POLL)
            yield self._take(self._end.receive())

    def wait(self, seconds: float) -> None:
        for _ in self.steps(seconds):
            pass

    def _take(self, data: bytes) -> bool:
        self.received += data
        count = len(self.samples)
        for kind, values in self.parser.feed(data):
            if kind == protocol.INFO:
                self.infos.append(values)
                continue
            sample = RawSample(*values)
            if self.samples and self.samples[-1] == sample:
                self.copies[-1] += 1
                continue
            self.samples.append(sample)
            self._rest = self._rest or sample
            self.copies.append(1)
            self.arrivals.append(self.now)
        return len(self.samples) > count

    @property
    def rest(self) -> RawSample:
        """The first SAMPLE of all, when the wires were cold."""
        assert self._rest
        return self._rest

    @property
    def last(self) -> RawSample:
        """The newest SAMPLE."""
        return self.samples[-1]

    def fresh(self) -> RawSample:
        """The next SAMPLE.

        Raises:
            CheckFailedError: if none comes.
        """
        for came in self.steps(1.0):
            if came:
                return self.last
        raise CheckFailedError("no SAMPLE came for 1 s")

    def settled(self, seconds: float = EFFECT_TIME) -> RawSample:
        """The SAMPLE that shows what the frames before did."""
        self.wait(seconds)
        return self.fresh()

    def sees(self, shows: Callable[[RawSample], bool], seconds: float = 0.3) -> bool:
        """Waits for a SAMPLE that shows something; whether one came."""
        return any(came and shows(self.last) for came in self.steps(seconds))

    # What a host says.

    def switch_off(self) -> None:
        """Says DISARM, three times, as one may get lost. Never raises."""
        with contextlib.suppress(HardwareError):
            self.send_bytes(3 * protocol.encode(protocol.DISARM))

    def off(self) -> RawSample:
        """Switches off; the SAMPLE that shows it.

        Raises:
            NotRunError: if it stays armed.
        """
        self.switch_off()
        if self.settled().armed:
            self.wait(HEARTBEAT_END)
        if self.last.armed:
            raise NotRunError("the board does not switch off")
        return self.last

    def begin(self) -> None:
        """Makes sure that the board is off, and has no fault.

        Raises:
            StaysOnError: if it does not switch off.
            CheckFailedError: if no SAMPLE comes.
            NotRunError: if it has a fault.
        """
        self.switch_off()
        self.settled(0.05)
        if self.last.armed:
            self.wait(HEARTBEAT_END)
        if self.fresh().armed or self.last.duty != (0, 0):
            raise StaysOnError("it does not switch off; disconnect the supply of its wires now")
        if self.last.latched:
            raise NotRunError(f"the board cannot be armed: {self.last.why}")

    def end(self) -> None:
        """Switches off, and clears the fault that a check made, when it is gone."""
        self.switch_off()
        if self.samples and self.last.latched:
            with contextlib.suppress(CheckFailedError):
                self.clear()

    def clear(self) -> None:
        """Clears a latched fault as soon as it is gone for good.

        Raises:
            CheckFailedError: if it is still there after 40 s.
        """
        end = self.now + CLEARING_TIME
        while self.now < end:
            self.send(protocol.CLEAR, self.last.challenge)
            self.settled(0.5)
            if not self.last.latched:
                return
        raise CheckFailedError(f"CLEAR did not clear the fault within 40 s: {self.last.why}")

    def send_arm(
        self, challenge: int, bounds: Bounds = WIDE, total: float = 1.5, right: Bounds | None = None
    ) -> None:
        """Sends an ARM once; ``right``: bounds of the right wire if they are others."""
        heed_signals()
        wires = (bounds, right or bounds)
        self.send(protocol.ARM, *protocol.arm_values(challenge, wires, total))

    def arm(self, bounds: Bounds = WIDE, total: float = 1.5) -> None:
        """Arms the board.

        Raises:
            NotRunError: if it does not let itself be armed.
        """
        if not self.try_to_arm(bounds, total):
            raise NotRunError(f"the board did not arm: {self.last.why}")

    def try_to_arm(
        self, bounds: Bounds = WIDE, total: float = 1.5, seconds: float = ARMING_TIME
    ) -> bool:
        """Asks the board to arm until it is; whether it is."""
        self.fresh()
        end = self.now + seconds
        while self.now < end:
            self.session, self.sequence = self.last.challenge, 0
            self.send_arm(self.session, bounds, total)
            for came in self.steps(0.12):
                if came and self.last.armed:
                    return True
        return False

    def command(
        self,
        duty: tuple[float, float],
        sequence: int | None = None,
        session: int | None = None,
        heard: int | None = None,
    ) -> None:
        """Sends a COMMAND twice, by default the next one, in answer to the newest SAMPLE.

        Args:
            duty: of left and right; in a frame it may be as large as 6.5.
            heard: time of the SAMPLE that it answers, ms.
        """
        if sequence is None:
            self.sequence += 1
            sequence = self.sequence
        session = self.session if session is None else session
        heard = (self.last.time if heard is None else heard) & 0xFFFFFFFF
        ticks = [round(protocol.FULL_DUTY * share) for share in duty]
        self.send_bytes(2 * protocol.encode(protocol.COMMAND, session, sequence, heard, *ticks))

    def drive(
        self,
        duty: tuple[float, float],
        seconds: float,
        until: Callable[[RawSample], bool] = lambda _: False,
        hottest: float = HOTTEST,
    ) -> bool:
        """Commands a duty in answer to each SAMPLE; whether it ended because of ``until``.

        Raises:
            StaysOnError: if a wire is read above ``hottest``, °C.
            NotRunError: if commands come too late to keep the board armed.
        """
        self.command(duty)
        for came in self.steps(seconds):
            if not came:
                continue
            if max(self.last.temperature) > hottest and max(self.last.duty) > 0:
                self.switch_off()
                raise StaysOnError(
                    f"a wire is read at {max(self.last.temperature):.0f} °C, hotter than any "
                    "check makes it; look at wires and supply"
                )
            if not self.last.armed and self.last.reason in (guard.NO_COMMAND, guard.LATE_COMMANDS):
                raise NotRunError(
                    "commands did not come in time; is this computer or the connection too busy?"
                )
            if until(self.last):
                return True
            self.command(duty)
        return False

    # What happens at the robot.

    def do(self, order: str, by_hand: str | None) -> None:
        """Switches off, and has something done at the robot, by an order or by hand.

        Raises:
            NotRunError: if it was not done.
        """
        self.switch_off()
        if self._ask is None or not self._ask(order, by_hand):
            raise NotRunError("what it needs at the robot was not done")
        self._end.receive()  # what came while it was done may have gaps
        self._new_parser()
        self.samples.clear()
        self.copies.clear()
        self.arrivals.clear()
        self.settled(0.1)
