"""Checks whether a board keeps the rules of docs/protocol.md, also one of another maker.

The numbers here are those of that page, not of the firmware in this project, so that they differ
if one of them is changed.
"""

import contextlib
import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence

from hardware.firmware import protocol
from hardware.robot.bench import (
    POLL,
    Ask,
    Bench,
    Bounds,
    CheckFailedError,
    HostEnd,
    NotRunError,
    RawSample,
    StaysOnError,
    expect,
)
from hardware.robot.link import HardwareError

PASSED, FAILED, NOT_RUN = "passed", "failed", "not run"

# Bounds of ARM: (a1 slowest, fastest, a2 least, most, a3 slowest).
NOMINAL = (0.042, 0.095, 17.0, 23.0, 0.5)
STRONG = (0.2, 0.5, 60.0, 100.0, 4.0)  # of wires that would warm far more than any does
WEAK = (0.2, 0.2, 10.0, 10.0, 0.1)  # and far less
HIDING = (0.2, 0.5, 4.0, 8.0, 0.1)  # and so little that no thermocouple need show it
BUDGET = (0.005, 0.5, 4.0, 100.0, 0.1)  # by which any wire may be far warmer than it is
RANGES = ((0.005, 0.2), (0.01, 0.5), (4.0, 60.0), (8.0, 100.0), (0.1, 4.0))

GENTLE = 0.04  # duty that warms a wire by less than 1 °C/s
WARM = 80.0  # °C, of a reading at which a check gives up
COOLING_TIME = 60.0  # s, within which a wire that was warm is nearly cold
RESET_TIME = 20.0  # s, in which a person presses the button
_HELLO = bytes((protocol.VERSION, protocol.HELLO))


@dataclasses.dataclass(frozen=True)
class Check:
    """A rule, and how it is checked.

    - ``name``: stable, for reports.
    - ``rule``: in a sentence.
    - ``section``: of docs/protocol.md, its anchor.
    - ``run``: talks to the board; raises if the rule is broken.
    - ``by_hand``: whether something must be done at the robot.
    """

    name: str
    rule: str
    section: str
    run: Callable[[Bench], None]
    by_hand: bool


@dataclasses.dataclass(frozen=True)
class Result:
    """What came of a check.

    - ``outcome``: "passed", "failed" or "not run".
    - ``what``: what was seen and what was expected, or why it was not run.
    """

    check: Check
    outcome: str
    what: str = ""


CHECKS: list[Check] = []


def run_checks(
    end: HostEnd,
    say: Callable[[Result], None] = lambda _: None,
    ask: Ask | None = None,
    checks: Sequence[Check] = CHECKS,
) -> list[Result]:
    """Checks a board. It is off at the end, whatever happens.

    Args:
        end: of the cable to the board.
        say: takes each result when it is there.
        ask: has something done at the robot: takes an order to an emulated board, and a sentence
            to a person, None if nobody can do it; whether it was done. Without it the checks
            that need it are not run.
        checks: in their order.

    Raises:
        HardwareError: if the cable is gone, or if a fault is latched at the beginning.
    """
    results: list[Result] = []
    bench = Bench(end, ask)

    def note(check: Check, outcome: str, what: str = "") -> None:
        results.append(Result(check, outcome, what))
        say(results[-1])

    ended = None  # why no further check is run
    try:
        bench.wait(0.5)
        if not bench.samples:
            ended = "no SAMPLE comes"
        elif bench.rest.latched:
            raise HardwareError(
                f"The board cannot be checked: {bench.last.why}. Mend it, then clear the fault: "
                "soft-limb status PORT --clear."
            )
        for check in checks:
            if ended and results:
                note(check, NOT_RUN, ended)
            elif check.by_hand and ask is None:
                note(check, NOT_RUN, "it needs a hand at the robot")
            elif ended:
                note(check, FAILED, "no SAMPLE came within 0.5 s; expected one each 50 ms")
            else:
                outcome, what, ended = _run(bench, check)
                note(check, outcome, what)
    finally:
        bench.switch_off()
    return results


def _run(bench: Bench, check: Check) -> tuple[str, str, str | None]:
    """Outcome of a check, what was seen, and why no further one can be run."""
    try:
        bench.begin()
        check.run(bench)
        outcome, what = PASSED, ""
    except CheckFailedError as failure:
        outcome, what = FAILED, str(failure)
    except NotRunError as reason:
        outcome, what = NOT_RUN, str(reason)
    except StaysOnError as error:
        return FAILED, str(error), "the board heated when it must not"
    bench.end()
    return outcome, what, None


def _check(name: str, rule: str, section: str, by_hand: bool = False):
    """Adds a check to `CHECKS`."""

    def add(run: Callable[[Bench], None]) -> Callable[[Bench], None]:
        CHECKS.append(Check(name, rule, section, run, by_hand))
        return run

    return add


def _framed(body: bytes, spoil: int = 0) -> bytes:
    """The frame of any body, with a checksum that is right unless it is spoiled."""
    checksum = bytearray(protocol.crc32(body))
    checksum[0] ^= spoil
    frame = bytearray(b"\x7e")
    for byte in body + checksum:
        frame += bytes((0x7D, byte ^ 0x20)) if byte in (0x7E, 0x7D, 0x03) else bytes((byte,))
    return bytes(frame + b"\x7e")


def _answers(bench: Bench, data: bytes) -> int:
    """How many INFO come for these bytes."""
    bench.infos.clear()
    bench.send_bytes(data)
    bench.wait(0.15)
    return len(bench.infos)


def _greets(bench: Bench) -> None:
    """Raises `NotRunError` unless the board answers a HELLO, as some checks need it."""
    if not _answers(bench, 3 * _framed(_HELLO)):
        raise NotRunError("the board does not answer HELLO")


def _since(bench: Bench, seconds: float) -> list[RawSample]:
    """Those that come from now on."""
    bench.fresh()
    count = len(bench.samples) - 1
    bench.wait(seconds)
    return bench.samples[count:]


# Frames.


@_check("samples-every-50-ms", "A SAMPLE comes every 50 ms.", "from-the-board")
def _samples_every_50_ms(bench: Bench) -> None:
    samples = _since(bench, 1.5)
    steps = [(b.time - a.time) & 0xFFFFFFFF for a, b in itertools.pairwise(samples)]
    mean = sum(steps) / max(1, len(steps))
    expect(
        len(steps) > 20 and 48 <= mean <= 52 and min(steps) >= 20 and max(steps) <= 80,
        f"{len(steps)} steps of {min(steps, default=0)} to {max(steps, default=0)} ms, "
        f"{mean:.1f} ms on average, in 1.5 s; expected 50 ms each",
    )


@_check("samples-come-twice", "Each SAMPLE is sent twice.", "from-the-board")
def _samples_come_twice(bench: Bench) -> None:
    bench.fresh()
    count = len(bench.copies)
    bench.wait(1.0)
    copies = bench.copies[count:-1]
    twice = sum(number == 2 for number in copies)
    expect(
        twice >= 0.9 * len(copies) > 0,
        f"{twice} of {len(copies)} samples came twice; expected all of them",
    )


@_check("samples-are-numbered", "The sequence of SAMPLE increases by 1.", "from-the-board")
def _samples_are_numbered(bench: Bench) -> None:
    numbers = [sample.sequence for sample in _since(bench, 0.8)]
    steps = {(b - a) & 0xFFFF for a, b in itertools.pairwise(numbers)}
    expect(steps == {1}, f"the sequence increased by {sorted(steps)}; expected by 1")


@_check("clock-counts-ms", "The time of SAMPLE is in ms.", "from-the-board")
def _clock_counts_ms(bench: Bench) -> None:
    bench.fresh()
    count = len(bench.samples)
    bench.wait(2.0)
    counted = (bench.last.time - bench.samples[count - 1].time) / 1000
    passed = bench.arrivals[-1] - bench.arrivals[count - 1]
    expect(
        abs(counted - passed) <= 0.02 * passed + 2 * POLL,
        f"its clock counted {counted:.2f} s in {passed:.2f} s; expected the same within 2%",
    )


@_check("frames-are-valid", "Frames have their version, length and CRC-32.", "frames")
def _frames_are_valid(bench: Bench) -> None:
    rejected, start = bench.parser.rejected, len(bench.received)
    bench.wait(1.5)
    longest = max(map(len, bytes(bench.received[start:]).split(b"\x7e"))) + 2
    wrong = bench.parser.rejected - rejected
    expect(
        wrong == 0 and bench.parser.other_version is None,
        f"{wrong} frames were damaged, version {bench.parser.other_version or protocol.VERSION}; "
        "expected none, and version 3",
    )
    expect(longest <= 64, f"a frame has {longest} bytes; expected 64 at most")


@_check("03-is-escaped", "The byte 03 is sent as 7D 23.", "frames")
def _three_is_escaped(bench: Bench) -> None:
    start = len(bench.received)
    bench.wait(2.0)
    count = bench.received[start:].count(3)
    expect(count == 0, f"the byte 03 came {count} times; expected it to be escaped")


@_check("hello-is-answered", "The board answers HELLO with INFO.", "from-the-host")
def _hello_is_answered(bench: Bench) -> None:
    answers = [_answers(bench, _framed(_HELLO)) for _ in range(3)]
    expect(max(answers) > 0, "no INFO came after three HELLO; expected one for each")


@_check("info-describes-the-board", "INFO has the board's numbers.", "from-the-board")
def _info_describes_the_board(bench: Bench) -> None:
    _greets(bench)
    version, period, limit, _, channels, cause = bench.infos[-1]
    expect(version == 3, f"firmware version {version}; expected 3")
    expect(period == 50, f"a sample period of {period} ms; expected 50 ms")
    expect(0 < limit <= 440, f"a limit of {limit / 4:g} °C; expected 110 °C at most")
    expect(channels == 2, f"{channels} channels; expected 2")
    expect(cause <= 5, f"cause {cause} of the last reset; expected 0 to 5")


@_check("bad-checksum-is-ignored", "A frame with a wrong CRC has no effect.", "frames")
def _bad_checksum_is_ignored(bench: Bench) -> None:
    _greets(bench)
    answers = sum(_answers(bench, _framed(_HELLO, spoil)) for spoil in (0x01, 0x80))
    expect(answers == 0, "a HELLO with a wrong checksum was answered; expected no answer")


@_check("other-version-is-ignored", "A frame of another version has no effect.", "versions")
def _other_version_is_ignored(bench: Bench) -> None:
    _greets(bench)
    for version in (2, 4):
        answers = _answers(bench, _framed(bytes((version, protocol.HELLO))))
        expect(answers == 0, f"a HELLO of version {version} was answered; expected no answer")


@_check("wrong-length-is-ignored", "A frame of another length has no effect.", "frames")
def _wrong_length_is_ignored(bench: Bench) -> None:
    _greets(bench)
    for size in (1, 24):
        answers = _answers(bench, _framed(_HELLO + bytes(size)))
        expect(answers == 0, f"a HELLO with {size} bytes of payload was answered; expected no")


@_check("unknown-types-are-ignored", "A frame of an unknown type has no effect.", "frames")
def _unknown_types_are_ignored(bench: Bench) -> None:
    _greets(bench)
    before = bench.last
    for kind in (0x00, 0x06, 0x42, 0x81, 0x82, 0xFF):
        answers = _answers(bench, _framed(bytes((protocol.VERSION, kind))))
        expect(answers == 0, f"a frame of type {kind:02X} was answered; expected no answer")
    after = bench.fresh()
    expect(
        (after.challenge, after.reason) == (before.challenge, before.reason),
        f"challenge or reason changed: {after.why}; expected no change",
    )
    _still_answers(bench)


def _still_answers(bench: Bench) -> None:
    expect(_answers(bench, _framed(_HELLO)) > 0, "a HELLO after them had no answer; expected INFO")


@_check("noise-is-skipped", "Other bytes are skipped up to the next flag.", "frames")
def _noise_is_skipped(bench: Bench) -> None:
    _greets(bench)
    noises = {
        "bytes without a flag": b"\x55" * 40,
        "a body that is too long": b"\x7e" + b"\x55" * 60,
        "two escapes in a row": b"\x7e\x05\x7d\x7d",
        "an escape before a flag": b"\x7e\x05\x7d",
        "half a frame": _framed(_HELLO)[:4],
    }
    for name, noise in noises.items():
        answers = _answers(bench, noise + _framed(_HELLO))
        expect(answers == 1, f"{answers} INFO for a HELLO after {name}; expected one")


@_check("flags-may-be-shared", "Two frames may share a flag; an empty body is none.", "frames")
def _flags_may_be_shared(bench: Bench) -> None:
    _greets(bench)
    shared = _framed(_HELLO)[:-1] + _framed(_HELLO)
    answers = _answers(bench, shared)
    expect(answers == 2, f"{answers} INFO for two HELLO with a shared flag; expected two")
    answers = _answers(bench, b"\x7e\x7e\x7e" + _framed(_HELLO) + b"\x7e\x7e")
    expect(answers == 1, f"{answers} INFO for a HELLO between flags; expected one")


@_check("frames-come-in-pieces", "A frame may come byte by byte.", "frames")
def _frames_come_in_pieces(bench: Bench) -> None:
    _greets(bench)
    bench.infos.clear()
    for byte in _framed(_HELLO):
        bench.send_bytes(bytes((byte,)))
        bench.wait(POLL)
    bench.wait(0.15)
    expect(len(bench.infos) == 1, f"{len(bench.infos)} INFO for a HELLO in pieces; expected one")


# Readings at rest.


@_check("temperatures-in-quarter-degrees", "V is in 1/4 °C.", "from-the-board")
def _temperatures_in_quarter_degrees(bench: Bench) -> None:
    left, right = bench.fresh().temperature
    expect(
        10 <= left <= 45 and 10 <= right <= 45,
        f"V is {left:g} and {right:g} °C; expected that of a room, 10 to 45 °C",
    )


@_check(
    "bend-in-64ths-of-a-degree",
    "The tip tangent angle is in 1/64 degrees, to the right positive.",
    "from-the-board",
    by_hand=True,
)
def _bend_in_64ths(bench: Bench) -> None:
    bend = "Bend the tip to the right, square to the base, and hold it there; then press Enter."
    with _fault(bench, "stick bend 90", bend, "Release the limb, then press Enter."):
        angle = bench.fresh().bend / 64
    expect(60 <= angle <= 120, f"the tip tangent is read as {angle:.0f}°; expected about 90°")


# Arming.


@_check("arm-arms", "ARM with the newest challenge arms; the reason is 0.", "from-the-host")
def _arm_arms(bench: Bench) -> None:
    armed = bench.try_to_arm()
    expect(armed, f"{bench.last.why} 1 s after ARM; expected it to be armed")
    expect(bench.last.reason == 0, f"it is armed with reason {bench.last.reason}; expected 0")


@_check(
    "cold-thermocouples-must-agree",
    "Thermocouples of cold wires that disagree by more than 8 °C do not arm.",
    "what-a-board-must-do",
    by_hand=True,
)
def _cold_thermocouples_must_agree(bench: Bench) -> None:
    warm = "Hold the left thermocouple between two warm fingers, hold on, press Enter."
    with _fault(bench, "drift left 2", warm, "Release the thermocouple, then press Enter."):
        for came in bench.steps(20.0):
            if came and abs(bench.last.left - bench.last.right) > 4 * 10.5:
                break
        else:
            raise NotRunError("the thermocouples did not differ by 10 °C")
        armed = bench.try_to_arm(seconds=0.1)
        seen = bench.last
    expect(not armed and seen.reason == 8, f"{seen.why}; expected reason 8, and off")


@_check(
    "arm-needs-the-newest-challenge",
    "ARM with any other challenge has no effect.",
    "from-the-host",
)
def _arm_needs_the_newest_challenge(bench: Bench) -> None:
    bench.arm()
    old = bench.session
    new = bench.off().challenge
    for challenge in {old, new ^ 1, new ^ 0x8000, 0} - {new}:
        bench.send_arm(challenge)
        expect(not bench.settled().armed, f"challenge {challenge} armed it; the newest was {new}")


@_check(
    "challenge-changes-when-off",
    "The challenge changes each time the board is switched off.",
    "what-a-board-must-do",
)
def _challenge_changes(bench: Bench) -> None:
    challenges = []
    for _ in range(3):
        bench.arm()
        challenges.append(bench.session)
        bench.off()
    challenges.append(bench.last.challenge)
    expect(
        len(set(challenges)) == 4, f"the challenges were {challenges}; expected four unlike ones"
    )


@_check(
    "armed-without-command-no-duty",
    "After ARM there is no duty until a COMMAND comes.",
    "what-a-board-must-do",
)
def _no_duty_without_command(bench: Bench) -> None:
    bench.arm()
    bench.drive((GENTLE, GENTLE), 0.2)
    bench.off()
    bench.arm()
    duty = bench.settled(0.05).duty
    expect(duty == (0, 0), f"a duty of {_percent(duty)} after ARM; expected none")


@_check("no-heat-unless-armed", "Off, no COMMAND brings duty.", "what-a-board-must-do")
def _no_heat_unless_armed(bench: Bench) -> None:
    bench.arm()
    bench.command((GENTLE, GENTLE))
    bench.settled(0.05)
    ended, number = bench.session, bench.sequence
    newest = bench.off().challenge
    for session in (ended, newest, 0):
        for _ in range(3):
            number += 1
            bench.command((GENTLE, GENTLE), sequence=number, session=session)
            sample = bench.fresh()
            expect(
                not sample.armed and sample.duty == (0, 0),
                f"a duty of {_percent(sample.duty)} while it was off; expected none",
            )


@_check("arming-again-changes-nothing", "ARM has no effect while armed.", "from-the-host")
def _arming_again_changes_nothing(bench: Bench) -> None:
    bench.arm()
    for _ in range(3):
        bench.command((GENTLE, GENTLE))
        bench.fresh()
    bench.send_arm(bench.session, total=0.01)
    bench.fresh()
    bench.command((GENTLE, GENTLE))
    sample = bench.settled(0.05)
    expect(
        sample.armed and sample.acknowledged == 4 and sample.duty == (400, 400),
        f"after a second ARM {sample.why}, command {sample.acknowledged} is the last, duty "
        f"{_percent(sample.duty)}; expected armed, 4, and 4% each",
    )


@_check("bounds-in-range", "ARM with a bound out of its range does not arm.", "from-the-host")
def _bounds_in_range(bench: Bench) -> None:
    for number, (low, high) in enumerate(RANGES):
        for wire, value in enumerate((0.8 * low, 1.2 * high)):  # too low on the left
            wires: list[Bounds] = [NOMINAL, NOMINAL]
            wires[wire] = [*NOMINAL[:number], value, *NOMINAL[number + 1 :]]
            bench.send_arm(bench.fresh().challenge, wires[0], right=wires[1])
            expect(
                not bench.settled(0.05).armed,
                f"it armed with bound {number + 1} of the {('left', 'right')[wire]} wire at "
                f"{value:g}; expected {low:g} to {high:g}",
            )


@_check(
    "bounds-must-show-heat",
    "ARM with bounds by which heat need not show arms only with a small sum of duties.",
    "from-the-host",
)
def _bounds_must_show_heat(bench: Bench) -> None:
    for total, arms in ((1.0, False), (0.12, True)):
        armed = bench.try_to_arm(HIDING, total, 0.1)
        expect(
            armed == arms,
            f"bounds by which a duty of 0.12 shows by 1 °C {'armed' if armed else 'did not arm'} "
            f"it with a sum of duties of {total:g}; expected the contrary",
        )


@_check("bounds-in-order", "ARM with bounds out of order does not arm.", "from-the-host")
def _bounds_in_order(bench: Bench) -> None:
    cooling, heating = (0.1, 0.05, *NOMINAL[2:]), (*NOMINAL[:2], 30.0, 20.0, 0.5)
    for left, right in ((cooling, NOMINAL), (NOMINAL, heating)):
        bench.send_arm(bench.fresh().challenge, left, right=right)
        armed = bench.settled(0.05).armed
        expect(not armed, "it armed with a lower bound above the upper one; expected it to refuse")


@_check("sum-in-range", "ARM with a sum of duties of 0 or above 2 does not arm.", "from-the-host")
def _sum_in_range(bench: Bench) -> None:
    for total in (0, 20001, 65535):
        values = protocol.arm_values(bench.fresh().challenge, (NOMINAL, NOMINAL), 1.0)
        values[-1] = total
        bench.send(protocol.ARM, *values)
        armed = bench.settled(0.05).armed
        expect(not armed, f"it armed with a sum of {total / 10000:g}; expected it to refuse")


# Commands.


def _percent(duty: tuple[int, int]) -> str:
    return f"{duty[0] / 100:g}% and {duty[1] / 100:g}%"


@_check("duty-goes-to-its-wire", "COMMAND has the duty of left, then of right.", "from-the-host")
def _duty_goes_to_its_wire(bench: Bench) -> None:
    bench.arm()
    for duty, ticks in (((0.02, 0.05), (200, 500)), ((0.0123, 0.0), (123, 0))):
        bench.drive(duty, 0.15)
        applied = bench.fresh().duty
        expect(
            applied == ticks,
            f"applied {_percent(applied)} when asked for {_percent(ticks)}; expected the same",
        )


def _acknowledged(bench: Bench, number: int, bits: int = 0xFFFF) -> bool:
    """Whether a SAMPLE comes that acknowledges a command, by these bits of its sequence."""
    return bench.sees(lambda sample: sample.acknowledged & bits == number & bits)


@_check("acknowledges-the-last-command", "SAMPLE has its sequence's low half.", "from-the-board")
def _acknowledges(bench: Bench) -> None:
    bench.arm()
    first = bench.fresh().acknowledged
    expect(first == 0, f"{first} is the last command of a new session; expected 0")
    for number in (1, 2, 70000, 70001):
        bench.command((0.0, 0.0), sequence=number)
        low = number & 0xFFFF
        expect(
            _acknowledged(bench, low),
            f"command {number} is acknowledged as {bench.last.acknowledged}; expected {low}",
        )


@_check("escapes-are-understood", "7D and a byte stand for the byte XOR 20.", "frames")
def _escapes_are_understood(bench: Bench) -> None:
    bench.arm()
    for number in (0x03, 0x7D, 0x7E, 0x7E7D, 0x037E7D, 0x7D7D7D7D):
        bench.command((0.0, 0.0), sequence=number)
        expect(
            _acknowledged(bench, number, 0xFF),
            f"a COMMAND with the sequence {number:X} had no effect; expected it to be taken",
        )


@_check("sequence-must-increase", "An old or repeated COMMAND has no effect.", "from-the-host")
def _sequence_must_increase(bench: Bench) -> None:
    bench.arm()
    for _ in range(4):
        bench.command((0.02, 0.02))
        bench.fresh()
    for old in (0, 1, 3):
        number = bench.sequence - old
        bench.command((GENTLE, GENTLE), sequence=number)
        duty = bench.fresh().duty
        expect(
            duty == (200, 200),
            f"command {number} after command {bench.sequence} brought {_percent(duty)}; expected "
            "2% each as before",
        )
        bench.command((0.02, 0.02))
        bench.fresh()


@_check("command-needs-its-session", "COMMAND of another session does nothing.", "from-the-host")
def _command_needs_its_session(bench: Bench) -> None:
    bench.arm()
    bench.drive((0.02, 0.02), 0.1)
    before = bench.session
    bench.off()
    bench.arm()
    bench.drive((0.02, 0.02), 0.1)
    for session in {before, bench.session ^ 1, 0} - {bench.session}:
        bench.command((GENTLE, GENTLE), sequence=bench.sequence + 100, session=session)
        duty = bench.fresh().duty
        expect(
            duty == (200, 200),
            f"a command of session {session} in session {bench.session} brought "
            f"{_percent(duty)}; expected 2% each as before",
        )
        bench.command((0.02, 0.02))
        bench.fresh()


@_check(
    "late-commands-do-nothing",
    "COMMAND that answers a SAMPLE older than 250 ms has no effect.",
    "from-the-host",
)
def _late_commands_do_nothing(bench: Bench) -> None:
    bench.arm()
    bench.drive((0.02, 0.02), 0.4)
    for age in (300, 5000, -1000):  # the last one answers a sample that is not yet
        bench.command((0.02, 0.02))
        bench.fresh()
        bench.command((GENTLE, GENTLE), heard=bench.last.time - age)
        duty = bench.fresh().duty
        expect(
            duty == (200, 200),
            f"a command that answers a sample {age} ms old brought {_percent(duty)}; expected 2% "
            "each as before",
        )
        bench.sequence += 1


@_check("duty-out-of-range-switches-off", "A duty above 10000 switches off.", "from-the-host")
def _duty_out_of_range(bench: Bench) -> None:
    for duty in ((1.0001, 0.0), (0.0, 6.5535)):
        bench.arm()
        bench.drive((0.02, 0.02), 0.1)
        bench.command(duty)
        sample = bench.settled(0.05)
        expect(
            not sample.armed and sample.duty == (0, 0),
            f"a duty of {100 * max(duty):g}% left it at {_percent(sample.duty)}; expected off",
        )
        bench.off()


def _last_command(bench: Bench) -> int:
    """Ends a series of commands; the time of the SAMPLE that the last one answered, ms."""
    bench.arm()
    bench.drive((GENTLE, GENTLE), 0.3)
    answered = bench.fresh().time
    bench.command((GENTLE, GENTLE))
    return answered


def _off_time(bench: Bench, since: int) -> int | None:
    """ms of the board's clock from a time to the first SAMPLE that is off; None if none is."""
    for came in bench.steps(1.0):
        if came and not bench.last.armed:
            return (bench.last.time - since) & 0xFFFFFFFF
    return None


@_check(
    "off-250-ms-after-last-command",
    "A duty ends 250 ms after its COMMAND.",
    "from-the-host",
)
def _off_after_last_command(bench: Bench) -> None:
    answered = _last_command(bench)
    # A SAMPLE tells too late; but a board that is off takes no command any more.
    bench.wait(0.27)
    bench.command((GENTLE, GENTLE))
    off = _off_time(bench, answered)
    expect(
        off is not None and off <= 360,
        f"{'still armed after 1 s' if off is None else f'read as off after {off} ms'}, with a "
        "command after 270 ms; expected it to be off after 250 ms, and to take no more",
    )


@_check("duty-holds-for-250-ms", "A duty holds for 250 ms after its COMMAND.", "from-the-host")
def _duty_holds(bench: Bench) -> None:
    answered = _last_command(bench)
    bench.fresh()
    for came in bench.steps(0.5):
        age = (bench.last.time - answered) & 0xFFFFFFFF
        if age > 220:
            return
        if came:
            expect(
                bench.last.duty == (400, 400),
                f"{_percent(bench.last.duty)} {age} ms after the last command; expected it to hold",
            )


@_check(
    "off-290-ms-after-the-answered-sample",
    "A duty ends 290 ms after the SAMPLE that its COMMAND answers.",
    "from-the-host",
)
def _off_after_answered_sample(bench: Bench) -> None:
    answered = _last_command(bench)
    bench.wait(0.19)
    if not bench.last.armed:
        raise NotRunError("it was off 200 ms after a command")
    bench.command((GENTLE, GENTLE), heard=answered)
    off = _off_time(bench, answered)
    expect(
        off is not None and off <= 385,
        f"{'still armed after 1 s' if off is None else f'read as off after {off} ms'}; expected "
        "off 290 ms after the sample, read at most 340 ms after",
    )


@_check("disarm-switches-off", "DISARM switches off at once.", "from-the-host")
def _disarm_switches_off(bench: Bench) -> None:
    bench.arm()
    bench.drive((GENTLE, GENTLE), 0.15)
    bench.switch_off()
    sample = bench.settled(0.03)
    expect(
        not sample.armed and sample.duty == (0, 0),
        f"{_percent(sample.duty)} after DISARM; expected off",
    )


@_check("off-has-its-reason", "SAMPLE says why the board is off.", "from-the-board")
def _off_has_its_reason(bench: Bench) -> None:
    bench.arm()
    bench.settled(0.6)
    _expect_reason(bench, 1, "no command came")
    bench.arm()
    bench.command((1.0001, 0.0))
    bench.settled(0.03)
    _expect_reason(bench, 2, "a duty was out of range")
    bench.arm()
    bench.switch_off()
    bench.settled(0.03)
    _expect_reason(bench, 3, "DISARM came")
    bench.arm()
    for came in bench.steps(0.8):
        if came:
            bench.command((0.0, 0.0), heard=bench.last.time - 400)
    _expect_reason(bench, 6, "only late commands came")
    bench.send_arm(bench.last.challenge, (0.3, *NOMINAL[1:]))
    bench.settled()
    _expect_reason(bench, 7, "the bounds of ARM were out of range")


def _expect_reason(bench: Bench, reason: int, event: str) -> None:
    if not bench.last.armed:  # else another check fails
        expect(
            bench.last.reason == reason,
            f"{bench.last.why}, after {event}; expected reason {reason}",
        )
    bench.off()


@_check("sum-of-duties-is-limited", "Both duties are reduced in proportion.", "the-band")
def _sum_of_duties_is_limited(bench: Bench) -> None:
    bench.arm(total=0.06)
    for asked, applied in (((0.06, 0.06), (300, 300)), ((0.09, 0.03), (450, 150))):
        bench.drive(asked, 0.15)
        seen = bench.fresh().duty
        expect(
            all(abs(a - b) <= 1 for a, b in zip(sorted(seen), sorted(applied), strict=True)),
            f"{_percent(seen)} where the sum may be 6%; expected {_percent(applied)}",
        )


# Faults. Bounds that no wire has let the band act at once.


def _cool(bench: Bench, which: Callable[[Sequence[float]], float]) -> None:
    """Waits until one wire, or both, are nearly as cold as at the beginning; for 60 s at most."""
    for came in bench.steps(COOLING_TIME):
        if came and which(bench.last.temperature) < min(bench.rest.temperature) + 5:
            return


def _heat_too_little(bench: Bench) -> None:
    """Heats the cooler wire, which ARM says warms far more, until the board is off."""
    _cool(bench, min)
    bench.arm(STRONG)
    duty = (0.3, 0.0) if bench.last.left < bench.last.right else (0.0, 0.3)
    bench.drive(duty, 6.0, until=lambda sample: not sample.armed)


def _make_fault(bench: Bench) -> None:
    """Latches a fault, by bounds of wires that would warm far more than these."""
    _heat_too_little(bench)
    if not bench.last.latched:
        raise NotRunError("no fault could be made: it bears a wire that reads far too little")


@_check(
    "clear-leaves-it-off",
    "CLEAR clears a fault that is gone; the board stays off, with a new challenge.",
    "from-the-host",
)
def _clear_leaves_it_off(bench: Bench) -> None:
    _make_fault(bench)
    before = bench.settled().challenge
    bench.clear()
    bench.settled()
    expect(
        not bench.last.armed and bench.last.reason == 3,
        f"after CLEAR {bench.last.why}; expected off, for reason 3",
    )
    expect(bench.last.challenge != before, "CLEAR kept the challenge; expected a new one")


# Faults of the sensors, while it is off.


@contextlib.contextmanager
def _fault(bench: Bench, order: str, by_hand: str | None, mended: str | None) -> Iterator[None]:
    """Has a fault made, and mended at the end."""
    bench.do(order, by_hand)
    try:
        yield
    except (CheckFailedError, NotRunError):
        bench.do("mend", mended)
        raise
    bench.do("mend", mended)


def _latches(
    bench: Bench,
    reason: int,
    order: str,
    by_hand: str | None = None,
    mended: str | None = None,
    seconds: float = 3.0,
) -> None:
    """A fault must latch, with its reason."""
    with _fault(bench, order, by_hand, mended):
        end = bench.now + seconds
        while not bench.last.latched and bench.now < end:
            bench.fresh()
        seen = bench.last
    expect(
        not seen.armed and seen.reason == reason, f"{seen.why}; expected reason {reason} to latch"
    )


def _latching(
    name: str,
    rule: str,
    reason: int,
    order: str,
    by_hand: str | None = None,
    mended: str | None = None,
) -> None:
    """Adds a check of a fault that must latch, with its reason."""
    _check(name, rule, "what-a-board-must-do", True)(
        lambda bench: _latches(bench, reason, order, by_hand, mended)
    )


_latching(
    "open-thermocouple-latches",
    "An open thermocouple latches.",
    17,
    "open left",
    "Unplug the left thermocouple, then press Enter.",
    "Plug the left thermocouple in again, then press Enter.",
)
_latching(
    "short-to-ground-latches",
    "A short to ground latches.",
    18,
    "ground right",
    "Connect a lead of the right thermocouple to ground, then press Enter.",
    "Remove that connection, then press Enter.",
)
_latching(
    "short-to-supply-latches",
    "A short to supply latches.",
    19,
    "supply left",
    "Connect a lead of the left thermocouple to the amplifier's 3.3 V, then press Enter.",
    "Remove that connection, then press Enter.",
)
_latching(
    "dead-amplifier-latches",
    "A frame of all zeros or ones latches.",
    17,
    "dead right",
    "Unplug the right amplifier's data line, DO, then press Enter.",
    "Plug that line in again, then press Enter.",
)
_latching("reserved-bit-latches", "A reserved bit that is set latches.", 26, "garbled left")
_latching("jump-latches", "A jump of more than 10 °C latches.", 20, "offset left 30")
_latching(
    "silent-bend-sensor-latches",
    "A silent bend sensor latches.",
    22,
    "silence",
    "Unplug the bend sensor, then press Enter.",
    "Plug the bend sensor in again, then press Enter.",
)
_latching("frozen-bend-sensor-latches", "Ten equal bends latch.", 23, "freeze bend")


@_check("first-fault-is-kept", "The first fault that latches stays.", "what-a-board-must-do", True)
def _first_fault_is_kept(bench: Bench) -> None:
    short = "Connect a lead of the right thermocouple to 3.3 V, then press Enter."
    mended = "Remove that connection, plug the bend sensor in again, then press Enter."
    with _fault(bench, "supply right", short, mended):
        bench.settled(0.3)
        bench.do("silence", "Unplug the bend sensor as well, then press Enter.")
        seen = bench.settled(0.3)
    expect(seen.reason == 19, f"{seen.why}; expected reason 19, which came first")


# The band, by heat.


@_check("heat-that-is-not-read-latches", "A reading below the band latches 21.", "the-band")
def _heat_that_is_not_read(bench: Bench) -> None:
    _heat_too_little(bench)
    expect(
        not bench.last.armed and bench.last.reason == 21 and bench.last.duty == (0, 0),
        f"{bench.last.why}, when ARM said that the wire warms by 60 °C/s at least; expected off "
        "for reason 21",
    )


@_check("fault-stays-until-clear", "A latched fault cannot be armed.", "what-a-board-must-do")
def _fault_stays(bench: Bench) -> None:
    _make_fault(bench)
    reason = bench.last.reason
    bench.wait(6.0)  # after which the fault is gone
    armed = bench.try_to_arm()
    expect(
        not armed and bench.last.reason == reason,
        f"{bench.last.why}, without a CLEAR; expected reason {reason} to stay",
    )


@_check("clear-needs-the-newest-challenge", "CLEAR needs the newest challenge.", "from-the-host")
def _clear_needs_the_newest_challenge(bench: Bench) -> None:
    _make_fault(bench)
    old = bench.session
    bench.wait(6.0)
    for challenge in {old, bench.last.challenge ^ 1} - {bench.last.challenge}:
        bench.send(protocol.CLEAR, challenge)
        expect(
            bench.settled().latched,
            f"CLEAR with {challenge} cleared it; the newest was {bench.last.challenge}",
        )


@_check("warmth-without-heat-latches", "A reading above the band latches 24.", "the-band")
def _warmth_without_heat(bench: Bench) -> None:
    bench.arm(WEAK)
    start = max(bench.fresh().temperature)
    bench.drive((0.3, 0.0), 15.0, until=lambda sample: not sample.armed)
    seen, risen = bench.last, max(bench.last.temperature) - start
    bench.switch_off()
    _cool(bench, max)  # or else a board takes the thermocouple for a wrong one
    expect(
        not seen.armed and seen.reason == 24 and seen.duty == (0, 0),
        f"{seen.why}, when a wire became {risen:.0f} °C warmer and ARM said that it warms by "
        "10 °C/s at most; expected off for reason 24",
    )


@_check(
    "heated-wire-is-the-one-that-warms",
    "Left is the left wire, its thermocouple and negative angles, and so is right.",
    "from-the-board",
)
def _heated_wire_warms(bench: Bench) -> None:
    for wire, side in ((1, "right"), (0, "left")):
        before = bench.settled()
        bench.arm()
        bench.drive((0.3, 0.0) if wire == 0 else (0.0, 0.3), 7.0)
        after = bench.settled(0.05)
        own, other = (after.temperature[n] - before.temperature[n] for n in (wire, 1 - wire))
        turned = (after.bend - before.bend) / 64 * (1 if wire else -1)
        expect(
            own > 3 and own > 2 * other,
            f"heat to the {side} wire raised its own V by {own:.1f} °C, the other by {other:.1f}; "
            "expected more than 3 °C, and twice the other",
        )
        expect(
            turned > 1, f"it turned the tip by {turned:.1f}° to the {side}; expected 1° at least"
        )
        bench.switch_off()


@_check(
    "detached-thermocouple-latches",
    "A thermocouple that has come off latches 21.",
    "the-band",
    by_hand=True,
)
def _detached_thermocouple(bench: Bench) -> None:
    with _fault(
        bench,
        "detach left",
        "Take the left thermocouple off its wire, let it hang in the air, then press Enter.",
        "Fix the thermocouple on its wire again, then press Enter.",
    ):
        bench.settled()
        if bench.last.latched:  # it jumped
            bench.clear()
        bench.arm(NOMINAL)
        bench.drive((0.15, 0.15), 10.0, until=lambda sample: not sample.armed)
        seen = bench.last
    expect(
        not seen.armed and seen.reason == 21, f"{seen.why} within 10 s; expected off for reason 21"
    )


@_check(
    "bend-that-does-not-follow-latches",
    "A bend that does not turn by 3° while the wires' difference changes by 60 °C latches 23.",
    "what-a-board-must-do",
    by_hand=True,
)
def _bend_that_does_not_follow(bench: Bench) -> None:
    _prove(bench)
    _cool(bench, max)
    with _fault(
        bench,
        "stick bend",
        "Clamp the limb so that it cannot bend, then press Enter.",
        "Release the limb, then press Enter.",
    ):
        bench.arm((0.042, 0.07, 17.0, 23.0, 0.5))  # they cool more slowly at most
        least, pulls = [0.0, 0.0], [0.0, 0.0]  # °C, as the board calculates it

        def ends(sample: RawSample) -> bool:
            for wire in (0, 1):
                least[wire] += 0.05 * (17.0 * sample.duty[wire] / 10000 - 0.07 * least[wire])
            pull = least[1] - least[0]
            pulls[:] = min(pulls[0], pull), max(pulls[1], pull)
            return not sample.armed or pulls[1] - pulls[0] > 65 or max(sample.temperature) > WARM

        for duty, seconds in (((0.5, 0.0), 4.5), ((0.0, 0.0), 20.0), ((0.0, 0.5), 9.0)):
            if bench.drive(duty, seconds, until=ends):
                break
        seen = bench.last
        if seen.armed and pulls[1] - pulls[0] <= 65:
            raise NotRunError("these wires would become too warm; they are stronger than others")
    expect(not seen.armed and seen.reason == 23, f"{seen.why}; expected off for reason 23")


def _prove(bench: Bench) -> None:
    """Has both thermocouples follow some heat, as they must after a start; then it is off."""
    bench.arm(NOMINAL)
    bench.drive((0.25, 0.25), 4.0)
    bench.off()


@_check("warmest-follows-the-heat", "The most a wire can have follows its duty.", "the-band")
def _warmest_follows(bench: Bench) -> None:
    _prove(bench)
    bench.arm(BUDGET)
    bench.command((0.0, 0.0))
    start = bench.fresh().warmest
    given = [0.0, 0.0]
    for duty in ((0.1, 0.0), (0.0, 0.08)):
        bench.command(duty)
        bench.fresh()
        count = len(bench.samples) - 1
        bench.drive(duty, 3.0)
        for before, after in itertools.pairwise(bench.samples[count:]):
            interval = (after.time - before.time) / 1000
            for wire in (0, 1):
                given[wire] += 100.0 * interval * before.duty[wire] / 10000
    for wire, side in enumerate(("left", "right")):
        risen = bench.last.warmest[wire] - start[wire]
        expect(
            abs(risen - given[wire]) <= 6.0,
            f"the most that the {side} wire can have rose by {risen} °C, when ARM said up to 100 "
            f"°C/s at full duty; expected {given[wire]:.0f} °C",
        )
    armed = bench.last.warmest
    bench.switch_off()
    off = bench.settled(0.5).warmest
    expect(
        all(abs(a - b) <= 3 for a, b in zip(off, armed, strict=True)),
        f"the most fell from {armed} to {off} °C within 0.7 s of switching off; expected it to be "
        "kept",
    )


@_check(
    "duty-is-reduced-before-127-c",
    "The duty is reduced so that the most a wire can have stays below 127 °C.",
    "the-band",
)
def _duty_is_reduced(bench: Bench) -> None:
    _prove(bench)
    bench.arm(BUDGET)
    bench.drive((0.0, 0.25), 8.0, until=lambda sample: 0 < max(sample.duty) < 2000)
    bench.drive((0.0, 0.25), 1.0)
    seen = bench.fresh()
    expect(seen.armed, f"{seen.why}; expected it to stay armed, at a reduced duty")
    expect(
        max(seen.duty) < 2000,
        f"still {_percent(seen.duty)} after heat for more than 127 °C; expected a reduced duty",
    )
    expect(max(seen.warmest) <= 129, f"up to {max(seen.warmest)} °C; expected 127 °C at most")


# Readings that are hot, and resets. They change what the board knows, and so come last.


@_check(
    "duty-ends-from-100-to-105-c",
    "The duty is reduced to zero as a reading goes from 100 to 105 °C.",
    "the-band",
    by_hand=True,
)
def _duty_ends_hot(bench: Bench) -> None:
    _prove(bench)
    bench.arm(BUDGET)
    for _ in range(8):  # until the wire may well be hot by its heat
        if bench.last.warmest_left < 105:
            bench.drive((0.1, 0.0), 1.0)
    with _fault(bench, "drift left 4", None, None):
        if not bench.last.armed:
            bench.arm(BUDGET)
        seen: list[tuple[float, int]] = []

        def hot(sample: RawSample) -> bool:
            seen.append((sample.left / 4, sample.duty_left))
            return not sample.armed or sample.left >= 4 * 109

        bench.drive((0.005, 0.005), 40.0, until=hot, hottest=math.inf)
    cool = [duty for reading, duty in seen[3:] if reading < 88]
    warm = [duty for reading, duty in seen if 107 <= reading < 110]
    if not cool or not warm:
        raise NotRunError("the reading did not go from below 88 °C to above 107 °C")
    expect(min(cool) >= 40, f"{min(cool) / 100:g}% below 88 °C; expected what was asked for, 0.5%")
    expect(max(warm) == 0, f"{max(warm) / 100:g}% above 107 °C; expected none")


@_check(
    "reading-below-the-room-latches",
    "A reading more than 8 °C below the amplifiers latches 25.",
    "what-a-board-must-do",
    by_hand=True,
)
def _reading_below_the_room(bench: Bench) -> None:
    _latches(
        bench,
        25,
        "drift left -1",
        "Hold ice in a bag on the left thermocouple, then press Enter.",
        "Take the ice away and wait for a minute, then press Enter.",
        30.0,
    )


def _reset(bench: Bench) -> None:
    """Has the board reset, and waits until it is."""
    before = bench.fresh().sequence
    bench.do("reset", "Press Enter, and within 20 s the board's reset button.")
    end = bench.now + RESET_TIME
    while bench.now < end:
        with contextlib.suppress(CheckFailedError):
            if bench.fresh().sequence < before:
                return
    raise NotRunError("the board was not reset within 20 s")


@_check(
    "not-armed-before-ten-samples",
    "It arms only after ten samples since its start.",
    "what-a-board-must-do",
    by_hand=True,
)
def _not_armed_before_ten_samples(bench: Bench) -> None:
    _reset(bench)
    end = bench.now + 2.0
    while not bench.last.armed and bench.now < end:
        bench.send_arm(bench.last.challenge)
        bench.fresh()
    number = bench.last.sequence
    expect(
        bench.last.armed and number > 10,
        f"{bench.last.why} at sample {number}; expected it to arm after sample 10",
    )


@_check(
    "fault-outlives-a-reset",
    "A latched fault stays over a reset.",
    "what-a-board-must-do",
    by_hand=True,
)
def _fault_outlives_a_reset(bench: Bench) -> None:
    _make_fault(bench)
    reason = bench.last.reason
    _reset(bench)
    seen = bench.settled()
    expect(seen.reason == reason, f"{seen.why} after a reset; expected reason {reason} to stay")


@_check("reset-is-reported", "After a reset reason and cause say so.", "from-the-board", True)
def _reset_is_reported(bench: Bench) -> None:
    _reset(bench)
    seen = bench.settled()
    expect(not seen.armed and seen.reason == 5, f"{seen.why} after a reset; expected reason 5")
    _greets(bench)
    cause = bench.infos[-1][5]
    expect(cause in (1, 3), f"cause {cause} of the last reset; expected 1 or 3")


@_check(
    "reset-draws-a-new-challenge",
    "The challenge is random at power-up.",
    "what-a-board-must-do",
    by_hand=True,
)
def _reset_draws_a_new_challenge(bench: Bench) -> None:
    challenges = []
    for _ in range(3):
        _reset(bench)
        challenges.append(bench.last.challenge)
    expect(
        len(set(challenges)) == 3,
        f"the challenges after three resets were {challenges}; expected unlike ones",
    )


@_check(
    "little-heat-after-a-start",
    "After any start there is little duty until a thermocouple has followed it.",
    "the-band",
    by_hand=True,
)
def _little_heat_after_a_start(bench: Bench) -> None:
    _cool(bench, max)
    _reset(bench)
    bench.settled(0.6)
    bench.arm(NOMINAL)
    bench.drive((0.3, 0.3), 0.3)
    seen = bench.fresh()
    expect(
        min(seen.warmest) >= 120 and max(seen.duty) <= 1200,
        f"{_percent(seen.duty)} after a reset, where the wires can have {seen.warmest} °C; "
        "expected 12% at most, and 120 °C or more",
    )
    bench.drive((0.3, 0.3), 10.0, until=lambda sample: sample.duty == (3000, 3000))
    seen = bench.last
    expect(
        seen.duty == (3000, 3000) and max(seen.warmest) < 100,
        f"{_percent(seen.duty)} after ten seconds, where the wires can have {seen.warmest} °C; "
        "expected the 30% that were asked for, and less than 100 °C",
    )


@_check(
    "hung-program-is-reset",
    "A watchdog resets a board whose program hangs, and that latches 27.",
    "what-a-board-must-do",
    by_hand=True,
)
def _hung_program_is_reset(bench: Bench) -> None:
    bench.do("stall 1", None)
    seen = bench.settled(1.5)
    expect(seen.reason == 27, f"{seen.why} after its program hung; expected reason 27")


@_check(
    "stopped-clock-latches",
    "A clock that stands still switches off, and latches 28.",
    "what-a-board-must-do",
    by_hand=True,
)
def _stopped_clock_latches(bench: Bench) -> None:
    bench.arm()
    with contextlib.suppress(CheckFailedError):  # no SAMPLE comes
        bench.do("stop clock", None)
    bench.do("mend", None)
    seen = bench.settled()
    expect(seen.reason == 28, f"{seen.why} after its clock stood still; expected reason 28")


@_check(
    "reading-above-110-c-latches",
    "Two readings in a row above 110 °C latch 16.",
    "what-a-board-must-do",
    by_hand=True,
)
def _reading_above_the_limit(bench: Bench) -> None:
    _hot(
        bench,
        "drift left 4",
        "Warm the bead of the left thermocouple, off the limb, slowly to above 110 °C, with hot "
        "air; press Enter when you begin.",
        (110.0, 113.0),
    )


@_check(
    "steep-rise-latches-before-110-c",
    "A wire that is 10 °C above the limit by the slope of its readings latches 16.",
    "what-a-board-must-do",
    by_hand=True,
)
def _steep_rise(bench: Bench) -> None:
    _hot(bench, "drift left 25", None, (60.0, 108.0))


def _hot(bench: Bench, order: str, by_hand: str | None, limits: tuple[float, float]) -> None:
    """A reading that rises must latch 16 between two temperatures, °C."""
    # After a reset a wire may be hot by its heat, so that the band bears it.
    _reset(bench)
    bench.settled(0.6)
    cool = "Let the thermocouple cool, fix it on its wire, then press Enter."
    with _fault(bench, order, by_hand, by_hand and cool):
        end, hottest = bench.now + 60.0, -math.inf
        while not bench.last.latched and bench.now < end and hottest < limits[1] + 5:
            hottest = max(hottest, *bench.fresh().temperature)
        seen = bench.last
    expect(
        seen.reason == 16 and limits[0] <= hottest <= limits[1],
        f"{seen.why} when the reading was {hottest:.1f} °C; expected reason 16 from "
        f"{limits[0]:g} to {limits[1]:g} °C",
    )
