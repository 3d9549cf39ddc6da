"""A board on the bench: raw frames to and from it, for the rules of `conformance`.

Unlike `BoardLink`, it also says what no host should say.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from hardware.firmware import from_host, guard, protocol
from hardware.robot.link import Assembly, HardwareError, Sample, SerialPort, pulls_of, shares_of
from limb_systems import LimbParameters
from limb_systems.signals import heed_signals

POLL = 0.01  # s, between two looks at what came
HOTTEST = 90.0  # °C, of a reading at which the checks stop
CLEARING_TIME = 40.0  # s, within which a fault that a check made is gone
RESET_TIME = 20.0  # s, in which a person presses the button
UNDO = "Undo what you did, and wait until all is as cold and as straight as before"

# Bounds that suit any wire: (a1 slowest, fastest, a2 least, most, a3 slowest).
WIDE = (0.03, 0.5, 4.0, 40.0, 0.1)

Bounds = Sequence[float]
Duty = Sequence[float] | np.ndarray
Ask = Callable[[str, str], bool]


class RuleBrokenError(Exception):
    """The board breaks a rule."""


class StaysOnError(Exception):
    """The board heats when it must not."""


class NotRunError(Exception):
    """A rule could not be checked."""


def expect(good: object, what: str) -> None:
    """Raises `RuleBrokenError` with a sentence unless it is good."""
    if not good:
        raise RuleBrokenError(what)


def state_of(sample: Sample) -> str:
    """State and reason of a board in words."""
    off = f"it is off for reason {sample.reason}, {sample.reason_text}"
    return "it is armed" if sample.armed else off


class Bench:
    """A board on the bench.

    - ``samples``: each that came, once.
    - ``copies``: how often each of them came.
    - ``infos``: values of each INFO.
    - ``received``: all bytes.
    - ``rest``: first sample of all, when the wires were cold.
    - ``names``, ``shares``: names of the limb's wires, and their `shares_of` it.
    """

    def __init__(
        self, cable: SerialPort, ask: Ask | None = None, limb: LimbParameters | None = None
    ):
        """
        Args:
            cable: the host's end of the cable to the board; in simulated time anything that can
                ``send``, ``receive``, ``wait`` and tell the time, ``now``, as a port can.
            ask: has something done at the robot: takes an order to an emulated board, and what
                to tell a person; whether it was done.
            limb: the limb on the board; the nominal one if None.
        """
        limb = limb or LimbParameters()
        self._cable, self._ask = cable, ask
        self.names, self.shares, self._pulls = limb.wire_names, shares_of(limb), pulls_of(limb)
        self.samples: list[Sample] = []
        self.copies: list[int] = []
        self.infos: list[tuple] = []
        self.session, self.sequence = 0, 0
        self.rest: Sample | None = None
        self._forget()

    def _forget(self) -> None:
        self.parser, self._assembly = (
            protocol.Parser(from_host.KINDS, from_host.FORMATS),
            Assembly(),
        )
        self.received = bytearray()
        self.samples.clear()
        self.copies.clear()

    def send(self, data: bytes) -> None:
        """Sends bytes, which need not be a frame."""
        self._cable.send(data)

    @property
    def now(self) -> float:
        """Time, s."""
        return self._cable.now()

    def steps(self, seconds: float) -> Iterator[bool]:
        """Lets time pass; yields after each look at what came whether a new SAMPLE did."""
        end = self.now + seconds - POLL / 2
        while self.now < end:
            self._cable.wait(POLL)
            yield self._take(self._cable.receive())

    def wait(self, seconds: float) -> None:
        """Lets time pass, and takes what comes."""
        for _ in self.steps(seconds):
            pass

    def _take(self, data: bytes) -> bool:
        self.received += data
        count = len(self.samples)
        for kind, values in self.parser.feed(data):
            if kind == protocol.INFO:
                self.infos.append(values)
                continue
            if not (sample := self._assembly.take(kind, values, self.now)):
                continue
            if self.samples and sample.board_time == self.last.board_time:
                self.copies[-1] += 1
                continue
            self.samples.append(sample)
            self.copies.append(1)
            self.rest = self.rest or sample
        return len(self.samples) > count

    @property
    def last(self) -> Sample:
        """The newest SAMPLE."""
        return self.samples[-1]

    def sees(self, shows: Callable[[Sample], object], seconds: float) -> bool:
        """Waits for a SAMPLE that shows something; whether one came."""
        return any(came and shows(self.last) for came in self.steps(seconds))

    def fresh(self, after: float = 0.0) -> Sample:
        """The next SAMPLE after a time, s; RuleBrokenError if none comes."""
        self.wait(after)
        expect(self.sees(lambda _: True, 1.0), "no SAMPLE came for 1 s")
        return self.last

    def next_samples(self, seconds: float) -> list[Sample]:
        """The samples that come from now on."""
        self.fresh()
        count = len(self.samples) - 1
        self.wait(seconds)
        return self.samples[count:]

    # What a host says.

    def every(self, share: float) -> list[float]:
        """The same duty for each wire."""
        return [share] * len(self.names)

    def only(self, wire: int, share: float) -> list[float]:
        """A duty for one wire, and none for the others."""
        return [share * (number == wire % len(self.names)) for number in range(len(self.names))]

    def encode(self, kind: int, *values: int) -> bytes:
        """A frame of the version that the board speaks."""
        return from_host.encode(self.parser.version, kind, *values)

    def switch_off(self) -> None:
        """Says DISARM, three times, as one may get lost. Never raises."""
        with contextlib.suppress(HardwareError):
            self.send(3 * self.encode(protocol.DISARM))

    def off(self) -> Sample:
        """Switches off; the SAMPLE that shows it. StaysOnError if it stays armed."""
        self.switch_off()
        for after in (0.1, 0.8):  # by then its heartbeat has ended
            sample = self.fresh(after)
            if not sample.armed and not sample.duty.any():
                return sample
        raise StaysOnError("it does not switch off; disconnect the supply of its wires now")

    def clear(self) -> None:
        """Clears a latched fault when it is gone for good; RuleBrokenError if that takes 40 s."""
        end = self.now + CLEARING_TIME
        while self.last.latched:
            expect(self.now < end, f"CLEAR did not clear within 40 s: {state_of(self.last)}")
            self.send(self.encode(protocol.CLEAR, self.last.challenge))
            self.fresh(0.5)

    def send_arm(
        self,
        bounds: Bounds = WIDE,
        total: float = 1.5,
        *,
        each: Sequence[Bounds] = (),
        challenge: int | None = None,
        lost: int | None = None,
    ) -> None:
        """Sends an ARM once, and what it needs, by default with the newest challenge.

        Args:
            bounds: bounds of all wires.
            total: the largest sum of all duties; in a frame it may be as large as 6.5.
            each: bounds of each wire, if they are unlike.
            challenge: challenge that it repeats.
            lost: wire whose BOUNDS is not sent.
        """
        heed_signals()
        self.session = self.last.challenge if challenge is None else challenge
        self.sequence = 0
        bounds_of_wires = each or [bounds] * len(self.names)
        if self.parser.version == protocol.VERSION:
            values = from_host.arm_values(self.session, bounds_of_wires, 1.0)
            values[-1] = round(protocol.FULL_DUTY * total)
            self.send(self.encode(protocol.ARM, *values))
            return
        arming = self.session, bounds_of_wires, total, self._pulls
        for number, frame in enumerate(from_host.encode_arming(self.parser.version, *arming)):
            self.send(frame if number != lost else b"")
            self.wait(POLL)

    def arm(self, bounds: Bounds = WIDE, total: float = 1.5) -> None:
        """Asks the board to arm until it is; NotRunError if that takes more than 1 s."""
        self.fresh()
        for _ in range(8):
            self.send_arm(bounds, total)
            if self.sees(lambda sample: sample.armed, 0.12):
                return
        raise NotRunError(f"the board did not arm: {state_of(self.last)}")

    def command(
        self,
        duty: Duty,
        *,
        sequence: int | None = None,
        session: int | None = None,
        age: float = 0.0,
    ) -> None:
        """Sends a COMMAND twice, by default the next one, in answer to the newest SAMPLE.

        Args:
            duty: duty of each wire; in a frame it may be as large as 6.5.
            sequence: number of the COMMAND.
            session: challenge that armed the board.
            age: time by which the SAMPLE that it answers is older than the newest one, s.
        """
        if sequence is None:
            self.sequence += 1
            sequence = self.sequence
        session = self.session if session is None else session
        heard = round(1000 * (self.last.board_time - age)) & 0xFFFFFFFF
        ticks = [round(protocol.FULL_DUTY * share) for share in duty]
        version = self.parser.version
        self.send(2 * from_host.encode_command(version, session, sequence, heard, ticks))

    def hold(
        self,
        duty: Duty,
        seconds: float,
        until: Callable[[Sample], bool] = lambda _: False,
        hottest: float = HOTTEST,
    ) -> bool:
        """Commands duties in answer to each SAMPLE; whether it ended because of ``until``.

        Raises:
            StaysOnError: if a wire is read above ``hottest``, °C.
            NotRunError: if commands come too late to keep the board armed.
        """
        self.command(duty)
        for came in self.steps(seconds):
            if not came:
                continue
            if self.last.temperature.max() > hottest and self.last.duty.any():
                raise StaysOnError(
                    f"a wire is read at {self.last.temperature.max():.0f} °C, hotter than any "
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

    def do(self, order: str, by_hand: str) -> None:
        """Switches off, and has something done by an order or by hand; NotRunError if it is not.

        Both may have {0} for the name of the first wire, and {1} for that of the last.
        """
        order, by_hand = (text.format(self.names[0], self.names[-1]) for text in (order, by_hand))
        self.switch_off()
        if self._ask is None or not self._ask(order, by_hand):
            raise NotRunError("what it needs at the robot was not done")
        self._cable.receive()  # what came while it was done may have gaps
        self._forget()
        self.fresh(0.1)

    @contextlib.contextmanager
    def fault(self, order: str, by_hand: str) -> Iterator[None]:
        """A context with a fault, which is mended at the end, unless something worse happens."""
        self.do(order, by_hand)
        try:
            yield
        except (RuleBrokenError, NotRunError):
            self.do("mend", UNDO)
            raise
        self.do("mend", UNDO)

    def reset(self) -> None:
        """Has the board reset, and waits until it is; NotRunError if it was not."""
        before, end = self.fresh().sequence, self.now + RESET_TIME
        self.do("reset", "Be ready to press the board's reset button within 20 s")
        while self.last.sequence >= before:
            if self.now > end:
                raise NotRunError("the board was not reset within 20 s")
            with contextlib.suppress(RuleBrokenError):
                self.fresh()

    def cool(self, which: Callable[[np.ndarray], float], limit: float = 60.0) -> None:
        """Waits until one wire, or all, are nearly as cold as at the beginning, or for a while."""
        rest = self.rest or self.last
        self.sees(lambda sample: which(sample.temperature) < min(rest.temperature) + 5, limit)
