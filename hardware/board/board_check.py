"""The self test of a board: its answers, its refusals, and the end of duty.

The numbers here are from docs/protocol.md, not from the firmware in this project, so that a
changed number shows. All wires get a duty of 4% for less than a second at a time.
"""

import contextlib
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from hardware.board.link import (
    HardwareError,
    Sample,
    SampleAssembler,
    SerialPort,
    check_heat_is_measured,
    pulls_of,
)
from hardware.board.signals import raise_if_interrupted
from hardware.firmware import from_host, protocol
from limb_systems import LimbParameters

PASSED = "passed"
FAILED = "failed"
NOT_RUN = "not run"
POLL_INTERVAL = 0.01  # s
GENTLE_DUTY = 0.04  # duty that warms a wire by less than 1 °C/s
MAX_READING = 45.0  # °C; the test stops above

Bounds = Sequence[float]  # of ARM: (a1 slowest, fastest, a2 least, most, a3 slowest)
WIDE_BOUNDS = (0.03, 0.5, 4.0, 40.0, 0.1)  # suit any wire
ZERO_BOUNDS = (0.0,) * 5
BOUND_RANGES = ((0.005, 0.2), (0.01, 0.5), (4.0, 60.0), (8.0, 100.0), (0.1, 4.0))
NOMINAL_BOUNDS = (0.042, 0.095, 17.0, 23.0, 0.5)
# Bounds out of order, then with one bound below or above its range.
WRONG_BOUNDS: list[Bounds] = [(0.095, 0.042, *NOMINAL_BOUNDS[2:]), (0.042, 0.095, 23.0, 17.0, 0.5)]
for _index, (_low, _high) in enumerate(BOUND_RANGES):
    for _wrong in (0.8 * _low, 1.2 * _high):
        WRONG_BOUNDS.append((*NOMINAL_BOUNDS[:_index], _wrong, *NOMINAL_BOUNDS[_index + 1 :]))


class StaysOnError(Exception):
    """Raised if the board heats when it must not."""


class NotRunError(Exception):
    """Raised if a rule cannot be checked."""


class Host:
    """The host's side of the cable, with all ``samples``, and values of INFO in ``infos``.

    Raises HardwareError at construction if the limb was calibrated without thermocouples.
    """

    def __init__(self, cable: SerialPort, limb: LimbParameters):
        check_heat_is_measured(limb)
        self.cable = cable
        self.pulls = pulls_of(limb)
        self.parser = protocol.Parser(protocol.BOARD_KINDS)
        self._assembly = SampleAssembler()
        self.session = self.sequence = 0
        self.names = limb.wire_names
        self.samples: list[Sample] = []
        self.infos: list[tuple] = []

    @property
    def newest(self) -> Sample:
        """The newest sample."""
        return self.samples[-1]

    def same_duty(self, share: float) -> list[float]:
        """Return the same duty for each wire."""
        return [share] * len(self.names)

    def send_empty(self, kind: int) -> None:
        """Send a frame without values three times, as one may get lost."""
        self.cable.send(3 * protocol.encode(kind))

    def receive(self) -> bytes:
        """Return the received bytes."""
        return self.cable.receive()

    def polls(self, seconds: float) -> Iterator[bool]:
        """Let time pass; yield after each poll whether a new sample came."""
        end = self.cable.now() + seconds - POLL_INTERVAL / 2
        while self.cable.now() < end:
            raise_if_interrupted()
            self.cable.wait(POLL_INTERVAL)
            count = len(self.samples)
            for kind, values in self.parser.feed(self.receive()):
                if kind == protocol.INFO:
                    self.infos.append(values)
                    continue
                sample = self._assembly.take(kind, values, self.cable.now())
                if sample and (not self.samples or sample.board_time != self.newest.board_time):
                    self.samples.append(sample)
            yield len(self.samples) > count

    def wait(self, seconds: float) -> None:
        """Let time pass, and receive frames."""
        for _ in self.polls(seconds):
            pass

    def next_sample(self, after: float = 0.0) -> Sample:
        """Return the first sample after some seconds; HardwareError if none comes for 1 s."""
        self.wait(after)
        if not any(self.polls(1.0)):
            raise HardwareError("The board sent no sample for 1 s; look at cable and supply.")
        return self.newest

    def send_arm(self, bounds: Sequence[Bounds], total: float, challenge: int) -> None:
        """Ask the board once to arm, with bounds of each wire."""
        self.session = challenge
        self.sequence = 0
        for frame in from_host.encode_arming(challenge, bounds, total, self.pulls):
            self.cable.send(frame)
            self.wait(POLL_INTERVAL)

    def command(self, duty: Sequence[float]) -> None:
        """Send the next COMMAND twice, in answer to the newest sample, with a duty of each wire."""
        self.sequence += 1
        sample_time = round(1000 * self.newest.board_time)
        frame = from_host.encode_command(self.session, self.sequence, sample_time, duty)
        self.cable.send(2 * frame)

    def hold(
        self,
        duty: Sequence[float],
        seconds: float,
        until: Callable[[Sample], object] = lambda _: False,
        hottest: float = MAX_READING,
    ) -> bool:
        """Command a duty in answer to each sample; return whether it ended because of ``until``.

        Raises StaysOnError if a heated wire is read above ``hottest``, °C.
        """
        for has_new_sample in self.polls(seconds):
            if has_new_sample:
                if self.newest.duty.any() and (self.newest.temperature > hottest).any():
                    highest = np.nanmax(self.newest.temperature)
                    raise StaysOnError(
                        f"a wire is read at {highest:.0f} °C, hotter than any check makes it; "
                        "look at wires and supply"
                    )
                if until(self.newest):
                    return True
                self.command(duty)
        return False

    def heat(self, total: float = 1.5) -> str:
        """Arm the board and hold a gentle duty for 0.3 s; return the fault in words, or ""."""
        for _ in range(8):
            self.send_arm([WIDE_BOUNDS] * len(self.names), total, self.next_sample().challenge)
            if self.next_sample(0.05).armed:
                self.hold(self.same_duty(GENTLE_DUTY), 0.3)
                return "" if self.newest.duty.all() else "no duty followed a command"
        return f"the board did not arm: {self.newest.reason_text}"

    def ensure_off(self) -> Sample:
        """Disarm the board; return the sample that shows it. StaysOnError if it heats on."""
        self.send_empty(protocol.DISARM)
        for after in (0.1, 0.8):  # by then its heartbeat has ended
            sample = self.next_sample(after)
            if not sample.armed and not sample.duty.any():
                return sample
        raise StaysOnError("it does not switch off; disconnect the supply of its wires now")


def _check_info(host: Host) -> str:
    host.send_empty(protocol.HELLO)
    host.wait(0.3)
    if not host.infos:
        return "no INFO came after three HELLO"
    version, period, limit, _, channels, angles, cause = host.infos[-1]
    num_bends = len(host.next_sample().tip_tangent)
    is_expected = (version, period, channels, angles) == (5, 50, len(host.names), num_bends)
    if is_expected and 0 < limit <= 440 and cause <= 5:
        return ""
    return (
        f"INFO says version {version}, {period} ms, {channels} channels, {angles} angles, "
        f"{limit / 4:g} °C at most, reset by cause {cause}"
    )


def _check_samples(host: Host) -> str:
    count = len(host.samples)
    host.wait(2.0)
    steps_ms = np.diff([1000 * sample.board_time for sample in host.samples[count:]])
    is_good = len(steps_ms) > 26 and abs(steps_ms.mean() - 50) <= 2
    return "" if is_good else f"{len(steps_ms) + 1} samples came in 2 s"


def _check_sensors(host: Host) -> str:
    sample = host.next_sample()
    V = sample.temperature
    tips_deg = np.rad2deg(sample.tip_tangent)
    is_cold = 10 <= V.min() <= V.max() <= MAX_READING and np.ptp(V) <= 8
    is_good = is_cold and (abs(tips_deg) < 120).all()
    return "" if is_good else f"wires are read at {V} °C, tip tangents at {tips_deg}°"


def _check_refusal(
    host: Host, reason: int | None, *wrong_bounds: Bounds, total=1.0, challenge_error=0
) -> str:
    """Check that ARM is refused for a reason, or for any if None, with wrong bounds of a wire."""
    for bounds, (wire, name) in itertools.product(wrong_bounds, enumerate(host.names)):
        bounds_of_wires: list[Bounds] = [WIDE_BOUNDS] * len(host.names)
        bounds_of_wires[wire] = bounds
        host.send_arm(bounds_of_wires, total, host.newest.challenge ^ challenge_error)
        sample = host.next_sample(0.05)
        if sample.armed or reason not in (None, sample.reason):
            return f"reason {sample.reason} after ARM with {bounds} of {name}, a sum of {total}"
    return ""


def _check_duty_end(
    host: Host, reason: int, max_age: float, act: Callable[[], None] = lambda: None
) -> str:
    """Heat gently and act; return the fault unless duty ends in time for a reason."""
    if fault := host.heat():
        return fault
    answered = host.newest.board_time
    act()
    host.wait(0.6)
    heated = [sample for sample in host.samples if sample.armed or sample.duty.any()]
    age = max(sample.board_time for sample in heated) - answered
    if age <= max_age and host.newest.reason == reason:
        return ""
    return f"armed for {age:.2f} s after it, then off for reason {host.newest.reason}"


def _check_sum(host: Host) -> str:
    if fault := host.heat(GENTLE_DUTY / 2 * len(host.names)):
        return fault
    is_reduced = np.allclose(host.newest.duty, GENTLE_DUTY / 2, rtol=0, atol=5e-5)
    return "" if is_reduced else f"duties are {host.newest.duty}; ARM allows half of {GENTLE_DUTY}"


class Case(NamedTuple):
    """A rule of docs/protocol.md, and its check.

    - ``name``: name for reports, which does not change.
    - ``rule``, ``section``: the rule in words, and its anchor on the page.
    - ``check``: function of the host; returns the board's fault in words, or "".
    - ``needs``: "hand" if something must be done at the robot, "order" if only an emulated board
      can do it, else empty.
    """

    name: str
    rule: str
    section: str
    check: Callable[[Any], str]
    needs: str = ""


BOARD_SECTION, HOST_SECTION = "from-the-board", "from-the-host"
# fmt: off
CASES = [Case(*row) for row in (
    ("info", "INFO says 50 ms, all wires and angles, and 110 °C at most.", BOARD_SECTION,
        _check_info),
    ("samples", "A SAMPLE comes every 50 ms.", BOARD_SECTION, _check_samples),
    ("sensors", "A cold limb is read at 10 to 45 °C and below 120°.", BOARD_SECTION,
        _check_sensors),
    ("challenge", "ARM without the newest challenge does not arm.", HOST_SECTION,
        lambda host: _check_refusal(host, None, WIDE_BOUNDS, challenge_error=1)),
    ("no-bounds", "ARM without bounds does not arm.", HOST_SECTION,
        lambda host: _check_refusal(host, 7, ZERO_BOUNDS)),
    ("bounds", "ARM with bounds out of range or order does not arm.", HOST_SECTION,
        lambda host: _check_refusal(host, 7, *WRONG_BOUNDS)),
    ("no-sum", "ARM with a largest sum of zero does not arm.", HOST_SECTION,
        lambda host: _check_refusal(host, 7, WIDE_BOUNDS, total=0.0)),
    ("duty", "A duty above 1 switches the board off.", HOST_SECTION,
        lambda host: _check_duty_end(host, 2, 0.08, lambda: host.command(host.same_duty(1.0001)))),
    ("sum", "Duties above the sum that ARM allows are reduced.", HOST_SECTION, _check_sum),
    ("silence", "Duty ends 250 ms after a COMMAND.", HOST_SECTION,
        lambda host: _check_duty_end(host, 1, 0.3)),
    ("disarm", "DISARM ends duty at once.", HOST_SECTION,
        lambda host: _check_duty_end(host, 3, 0.08, lambda: host.send_empty(protocol.DISARM))),
)]
# fmt: on


class Outcome(NamedTuple):
    """The outcome of a case: "passed", "failed" or "not run", with the fault or the reason."""

    case: Case
    outcome: str
    details: str = ""


def check_board(host: Host, report: Callable, cases: Sequence[Case] = ()) -> list[Outcome]:
    """Test a board case by case, and report each outcome. Duty must be zero after each case.

    Raises HardwareError if no samples come, the board is for another limb, or a fault is latched.
    """
    outcomes: list[Outcome] = []
    end_reason = ""
    try:
        # The board must be for this limb, and free of faults.
        sample = host.next_sample(0.5)
        if len(sample.temperature) != len(host.names):
            raise HardwareError(
                f"The board has {len(sample.temperature)} channels, but the limb has "
                f"{len(host.names)} wires; name the file of the limb that is on it: --limb FILE."
            )
        if sample.latched:
            raise HardwareError(
                f"The board cannot be checked: it is off for reason {sample.reason}, "
                f"{sample.reason_text}. Mend it, then: soft-limb status PORT --clear."
            )
        # After a board that heats when it must not, no further case is run.
        for case in cases or CASES:
            outcome = Outcome(case, NOT_RUN, end_reason)
            if not end_reason:
                try:
                    host.ensure_off()
                    fault = case.check(host)
                    host.ensure_off()
                    outcome = Outcome(case, FAILED if fault else PASSED, fault)
                except NotRunError as reason:
                    outcome = Outcome(case, NOT_RUN, str(reason))
                except StaysOnError as error:
                    outcome = Outcome(case, FAILED, str(error))
                    end_reason = "it heated when it must not"
            outcomes.append(outcome)
            report(outcome)
    finally:
        with contextlib.suppress(HardwareError):
            host.send_empty(protocol.DISARM)
    return outcomes
