"""A board on the bench, for the rules of `conformance`: a host that also says what none should."""

import contextlib
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from hardware.board.board_check import GENTLE_DUTY, WIDE_BOUNDS, Bounds, Host, NotRunError
from hardware.board.link import HardwareError, Sample, SerialPort, shares_of
from hardware.firmware import from_host, guard, protocol
from limb_systems import LimbParameters

MAX_READING = 90.0  # °C, of a reading at which the checks stop
CLEARING_TIME = 40.0  # s, within which a fault that a check made is gone
RESET_TIME = 20.0  # s, in which a person presses the button
UNDO = "Undo what you did, and wait until all is as cold and as straight as before"

Ask = Callable[[str, str], bool]


class RuleBrokenError(Exception):
    """The board breaks a rule."""


def expect(good: object, what: str) -> None:
    """Raise `RuleBrokenError` with a sentence unless it is good."""
    if not good:
        raise RuleBrokenError(what)


def state_of(sample: Sample) -> str:
    """Return state and reason of a board in words."""
    off = f"it is off for reason {sample.reason}, {sample.reason_text}"
    return "it is armed" if sample.armed else off


class Bench(Host):
    """A board on the bench.

    - ``ask``: see below.
    - ``received``: all bytes.
    - ``rest``: first sample of all, when the wires were cold.
    - ``shares``: the shares of the limb's wires, see `shares_of`.
    - ``gentle_duty``: a duty of all wires that warms them little.
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
        super().__init__(cable, limb)
        self.ask = ask
        self.shares = shares_of(limb)
        self.gentle_duty = self.same_duty(GENTLE_DUTY)
        self.received = bytearray()
        self.rest: Sample | None = None

    def receive(self) -> bytes:
        """Return what came, and keep it."""
        data = super().receive()
        self.received += data
        return data

    def polls(self, seconds: float) -> Iterator[bool]:
        """As of `Host`; keeps the first sample."""
        for came in super().polls(seconds):
            self.rest = self.rest or (self.newest if came else None)
            yield came

    def sees(self, shows: Callable[[Sample], object], seconds: float) -> bool:
        """Wait for a sample that shows something; return whether one came."""
        return any(came and shows(self.newest) for came in self.polls(seconds))

    def next_sample(self, after: float = 0.0) -> Sample:
        """As of `Host`; RuleBrokenError if no sample comes."""
        try:
            return super().next_sample(after)
        except HardwareError:
            raise RuleBrokenError("no SAMPLE came for 1 s") from None

    def only(self, wire: int, share: float) -> list[float]:
        """A duty for one wire, and none for the others."""
        return [share * (number == wire % len(self.names)) for number in range(len(self.names))]

    def ensure_off(self) -> Sample:
        """As of `Host`; clears a fault that a check has made."""
        super().ensure_off()
        with contextlib.suppress(RuleBrokenError):
            self.clear()
        return self.newest

    def switch_off(self) -> None:
        """Say DISARM, three times, as one may get lost. Never raises."""
        with contextlib.suppress(HardwareError):
            self.send_empty(protocol.DISARM)

    def clear(self) -> None:
        """Clear a latched fault when it is gone for good; RuleBrokenError if that takes 40 s."""
        end = self.cable.now() + CLEARING_TIME
        while self.newest.latched:
            expect(self.cable.now() < end, f"not cleared within 40 s: {state_of(self.newest)}")
            self.cable.send(protocol.encode(protocol.CLEAR, self.newest.challenge))
            self.next_sample(0.5)

    def try_to_arm(
        self, bounds: Bounds = WIDE_BOUNDS, total: float = 1.5, *, each: Sequence[Bounds] = ()
    ) -> None:
        """Ask once for arming, with the newest challenge. each: bounds of each wire, if unlike."""
        self.send_arm(each or [bounds] * len(self.names), total, self.newest.challenge)

    def arm(self, bounds: Bounds = WIDE_BOUNDS, total: float = 1.5) -> None:
        """Ask the board to arm until it is; NotRunError if that takes more than 1 s."""
        self.next_sample()
        for _ in range(8):
            self.try_to_arm(bounds, total)
            if self.sees(lambda sample: sample.armed, 0.12):
                return
        raise NotRunError(f"the board did not arm: {state_of(self.newest)}")

    def stray(self, duty, *, sequence=None, session=None, age=0.0) -> None:
        """Send a COMMAND twice that is not the next one.

        Args:
            duty: duty of each wire; in a frame it may be as large as 6.5.
            sequence, session: other ones than those of the next command.
            age: time by which the sample that it answers is older than the newest one, s.
        """
        sequence = self.sequence + 1 if sequence is None else sequence
        session = self.session if session is None else session
        sample_time = round(1000 * (self.newest.board_time - age))
        self.cable.send(2 * from_host.encode_command(session, sequence, sample_time, duty))

    def hold(self, duty, seconds, until=lambda _: False, hottest=MAX_READING) -> bool:
        """As of `Host`; NotRunError if commands come too late to keep the board armed."""

        def late(sample: Sample) -> bool:
            return not sample.armed and sample.reason in (guard.NO_COMMAND, guard.LATE_COMMANDS)

        self.command(duty)
        ended = super().hold(duty, seconds, lambda s: late(s) or until(s), hottest)
        if late(self.newest):
            raise NotRunError(
                "commands did not come in time; is this computer or the connection too busy?"
            )
        return ended

    def hold_until_off(self, duty: Sequence[float], seconds: float) -> None:
        """`hold` a duty, at most until the board is off."""
        self.hold(duty, seconds, until=lambda sample: not sample.armed)

    def heat_gently(self, seconds: float = 0.2) -> None:
        """Arm, and hold a gentle duty of all wires."""
        self.arm()
        self.hold(self.gentle_duty, seconds)

    # What happens at the robot.

    def do(self, order: str, by_hand: str) -> None:
        """Switch off, and have something done by an order or by hand; NotRunError if it is not.

        Both may have {0} for the name of the first wire, and {1} for that of the last.
        """
        self.switch_off()
        self.tell(order, by_hand)
        self.receive()  # what came while it was done may have gaps
        self.samples.clear()
        self.parser = protocol.Parser(protocol.BOARD_KINDS)
        self.next_sample(0.1)

    def tell(self, order: str, by_hand: str) -> None:
        """Have something done while the board is in whatever state; NotRunError if it is not."""
        order, by_hand = (text.format(self.names[0], self.names[-1]) for text in (order, by_hand))
        if self.ask is None or not self.ask(order, by_hand):
            raise NotRunError("what it needs at the robot was not done")

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
        """Have the board reset, and wait until it is; NotRunError if it was not."""
        before, end = self.next_sample().sequence, self.cable.now() + RESET_TIME
        self.do("reset", "Be ready to press the board's reset button within 20 s")
        while self.newest.sequence >= before:
            if self.cable.now() > end:
                raise NotRunError("the board was not reset within 20 s")
            with contextlib.suppress(RuleBrokenError):
                self.next_sample()

    def cool(self, which: Callable[[np.ndarray], float], limit: float = 60.0) -> None:
        """Wait until one wire, or all, are nearly as cold as at the beginning, or for a while."""
        rest = self.rest or self.newest
        self.sees(lambda sample: which(sample.temperature) < min(rest.temperature) + 5, limit)
