"""The rules of docs/protocol.md, checked on any board, also one with firmware of another maker.

From the repository: ``python -m tests.hardware.conformance PORT [--by-hand]``.

The numbers here are those of that page, not of the firmware in this project, so that they differ
if one of them is changed.
"""

import argparse
import itertools
import sys
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hardware.board import board_check
from hardware.board.board_check import (
    CASES,
    FAILED,
    NOMINAL_BOUNDS,
    POLL_INTERVAL,
    WIDE_BOUNDS,
    Bounds,
    Case,
    NotRunError,
    Outcome,
)
from hardware.board.link import Sample, SerialPort
from hardware.firmware import from_host, protocol
from limb_systems import LimbParameters

from .bench import UNDO, Ask, Bench, RuleBrokenError, expect, state_of

# Bounds of ARM: (a1 slowest, fastest, a2 least, most, a3 slowest).
STRONG = (0.2, 0.5, 60.0, 100.0, 4.0)  # of wires that would warm far more than any does
WEAK = (0.2, 0.2, 10.0, 10.0, 0.1)  # and far less
HIDING = (0.2, 0.5, 4.0, 8.0, 0.1)  # and so little that no thermocouple need show it
BUDGET = (0.005, 0.5, 4.0, 100.0, 0.1)  # by which any wire may be far warmer than it is

VERSION = 5
WARM = 80.0  # °C, of a reading at which a check gives up


RULES: list[Case] = list(CASES)


def check_board(
    cable: SerialPort,
    say: Callable[[Outcome], None] = lambda _: None,
    ask: Ask | None = None,
    rules: Sequence[Case] = RULES,
    limb: LimbParameters | None = None,
) -> list[Outcome]:
    """Check a board, rule by rule. It is off at the end, whatever happens.

    Args:
        cable, ask, limb: as for `Bench`. Without ``ask``, rules that need something done at the
            robot are not checked.
        say: takes each outcome when it is there.
        rules: rules to check, in their order.

    Raises:
        HardwareError: as `board_check.check_board`.
    """
    return board_check.check_board(Bench(cable, ask, limb), say, rules)


def _added(name: str, sentence: str, section: str, by: str, check: Callable[[Bench], None]):
    """Add a rule to `RULES`; ``check`` raises if the board breaks it."""

    def run(bench: Bench) -> str:
        if by and not bench.ask:
            raise NotRunError("it needs a hand at the robot")
        if bench.newest.latched:
            raise NotRunError(f"the board cannot be armed: {state_of(bench.newest)}")
        try:
            check(bench)
        except RuleBrokenError as broken:
            return str(broken)
        return ""

    RULES.append(Case(name, sentence, section, run, by))


def _rule(section: str, by: str = ""):
    """Add a rule to `RULES`: the name and the docstring of a function that checks it."""

    def add(check: Callable[[Bench], None]) -> None:
        name = check.__name__.strip("_").replace("_", "-")
        _added(name, check.__doc__ or "", section, by, check)

    return add


def _percent(duty: Sequence[float] | np.ndarray) -> str:
    return " and ".join(f"{100 * share:g}%" for share in duty)


def _expect_duty(sample: Sample, duty: Sequence[float], when: str) -> None:
    expect(
        np.allclose(sample.duty, duty, rtol=0, atol=5e-5),
        f"{_percent(sample.duty)} {when}; expected {_percent(duty)}",
    )


def _expect_off(sample: Sample, when: str, *reasons: int) -> None:
    off = not sample.armed and not sample.duty.any()
    expect(
        off and (not reasons or sample.reason in reasons),
        f"{when} {state_of(sample)}, at {_percent(sample.duty)}; expected it to be off"
        + "".join(f" for reason {reason}" for reason in reasons),
    )


# Frames from the board.


@_rule("from-the-board")
def _samples_every_50_ms(bench: Bench) -> None:
    """A SAMPLE comes every 50 ms, twice; its sequence increases by 1, and its time is in ms."""
    bench.next_sample()
    count = len(bench.samples) - 1
    start = len(bench.received)
    bench.wait(2.0)
    samples, received = bench.samples[count:], bench.received[start:]
    counted, arrived, numbers = np.diff(
        [(sample.board_time, sample.received, sample.sequence) for sample in samples], axis=0
    ).T
    expect(
        len(counted) > 26 and abs(counted.mean() - 0.05) <= 2e-3 and (counted > 0.02).all(),
        f"{len(counted)} steps in 2 s, of {np.round(1000 * counted)} ms; expected 50 ms each",
    )
    expect(
        abs(counted.sum() - arrived.sum()) <= 0.02 * arrived.sum() + 2 * POLL_INTERVAL,
        f"its clock counted {counted.sum():.2f} s in {arrived.sum():.2f} s; expected the same",
    )
    frames = protocol.Parser(protocol.BOARD_KINDS).feed(received)
    copies = [
        sum(kind == protocol.SAMPLE and values[0] == sample.sequence for kind, values in frames)
        for sample in samples[1:-1]
    ]
    expect(copies.count(2) >= 0.9 * len(copies), f"they came {copies} times; expected 2 each")
    steps = set((numbers % 0x10000).tolist())
    expect(steps == {1}, f"the sequence increased by {sorted(steps)}; expected by 1")


@_rule("frames")
def _frames_are_valid(bench: Bench) -> None:
    """Frames have their version, length and CRC-32; the byte 03 is sent as 7D 23."""
    rejected = bench.parser.rejected
    start = len(bench.received)
    bench.wait(2.0)
    received = bytes(bench.received[start:])
    damaged = bench.parser.rejected - rejected
    expect(damaged == 0, f"{damaged} frames were damaged; expected none")
    other = bench.parser.other_version
    expect(other is None, f"frames are of version {other}; expected {VERSION}")
    longest = max(map(len, received.split(b"\x7e"))) + 2
    expect(longest <= 64, f"a frame has {longest} bytes; expected 64 at most")
    expect(3 not in received, "the byte 03 came; expected it to be escaped")


# Frames to the board, by how many INFO come for them.


def _framed(body: bytes, spoil: int = 0) -> bytes:
    """The frame of any body, with a checksum that is right unless it is spoiled."""
    checksum = bytearray(protocol.crc32(body))
    checksum[0] ^= spoil
    frame = bytearray(b"\x7e")
    for byte in body + checksum:
        frame += bytes((0x7D, byte ^ 0x20)) if byte in (0x7E, 0x7D, 0x03) else bytes((byte,))
    return bytes(frame + b"\x7e")


HELLO = _framed(bytes((VERSION, 1)))


def _answers(bench: Bench, *pieces: bytes) -> int:
    """How many INFO come for these bytes."""
    bench.infos.clear()
    for piece in pieces:
        bench.cable.send(piece)
        bench.wait(POLL_INTERVAL)
    bench.wait(0.15)
    return len(bench.infos)


def _expect_answers(bench: Bench, expected: int, cases: Mapping[str, Sequence[bytes]]) -> None:
    """Each case must bring so many INFO, and no other change."""
    if not any(_answers(bench, HELLO) for _ in range(3)):
        raise NotRunError("the board does not answer HELLO")
    before = bench.newest
    for case, pieces in cases.items():
        answers = _answers(bench, *pieces)
        expect(answers == expected, f"{answers} INFO after {case}; expected {expected}")
    after = bench.next_sample()
    expect(
        (after.challenge, after.reason) == (before.challenge, before.reason),
        f"challenge or reason changed: {state_of(after)}; expected no change",
    )
    expect(_answers(bench, HELLO), "a HELLO after them had no answer; expected INFO")


@_rule("frames")
def _damaged_frames_are_ignored(bench: Bench) -> None:
    """A frame with a wrong CRC, or of another version, length or type, has no effect."""
    hello, kinds = bytes((VERSION, 1)), (0x00, 0x07, 0x42, 0x81, 0x82, 0xFF)
    cases = {f"a CRC that is wrong by {n:02X}": [_framed(hello, n)] for n in (0x01, 0x80)}
    cases |= {f"a HELLO of version {n}": [_framed(bytes((n, 1)))] for n in (2, 4, 6)}
    cases |= {f"a HELLO with {n} bytes more": [_framed(hello + bytes(n))] for n in (1, 24)}
    cases |= {f"a frame of type {n:02X}": [_framed(bytes((VERSION, n)))] for n in kinds}
    _expect_answers(bench, 0, cases)


@_rule("frames")
def _noise_is_skipped(bench: Bench) -> None:
    """Other bytes are skipped up to the next flag; frames may share one, or come byte by byte."""
    noises = {
        "bytes without a flag": b"\x55" * 40,
        "a body that is too long": b"\x7e" + b"\x55" * 60,
        "two escapes in a row": b"\x7e\x05\x7d\x7d",
        "an escape before a flag": b"\x7e\x05\x7d",
        "half a frame": HELLO[:4],
        "empty bodies": b"\x7e\x7e\x7e",
    }
    cases = {f"{name} and a HELLO": [noise + HELLO] for name, noise in noises.items()}
    cases["a HELLO in pieces"] = [bytes((byte,)) for byte in HELLO]
    _expect_answers(bench, 1, cases)
    _expect_answers(bench, 2, {"two HELLO with a shared flag": [HELLO[:-1] + HELLO]})


# Readings at rest.


@_rule("from-the-board", "hand")
def _bend_in_64ths_of_a_degree(bench: Bench) -> None:
    """The tip tangent angle is in 1/64 degrees, to the right positive."""
    with bench.fault("stick bend 90", "Bend the tip to the right, square to the base, and hold it"):
        angle = np.rad2deg(bench.next_sample().tip_tangent[0])
        expect(60 <= angle <= 120, f"the tip tangent is read as {angle:.0f}°; expected about 90°")


# Arming.


def _expect_armed(bench: Bench, *arguments) -> None:
    try:
        bench.arm(*arguments)
    except NotRunError as refusal:
        raise RuleBrokenError(f"{refusal}, 1 s after ARM; expected it to be armed") from refusal


@_rule("from-the-host")
def _arm_arms(bench: Bench) -> None:
    """ARM with the newest challenge arms, without duty; while armed it has no effect."""
    _expect_armed(bench)
    expect(bench.newest.reason == 0, f"it is armed with reason {bench.newest.reason}; expected 0")
    bench.heat_gently()
    bench.ensure_off()
    bench.arm()
    _expect_duty(bench.next_sample(0.05), bench.same_duty(0.0), "after ARM, before any COMMAND")
    bench.hold(bench.gentle_duty, 0.15)
    number = bench.sequence
    session = bench.session
    bench.send_arm([NOMINAL_BOUNDS] * len(bench.names), 0.01, session)
    bench.stray(bench.gentle_duty, sequence=number + 1)
    sample = bench.next_sample(0.05)
    expect(
        sample.armed and sample.acknowledged == number + 1,
        f"after a second ARM {state_of(sample)}, and command {sample.acknowledged} is the last; "
        f"expected armed, and {number + 1}",
    )
    _expect_duty(sample, bench.gentle_duty, "after a second ARM")


@_rule("what-a-board-must-do", "hand")
def _cold_thermocouples_must_agree(bench: Bench) -> None:
    """Thermocouples of cold wires that disagree by more than 8 °C do not arm."""
    with bench.fault("drift {0} 2", "Hold the {0} thermocouple between two warm fingers"):
        if not bench.sees(lambda sample: np.ptp(sample.temperature) > 10.5, 20.0):
            raise NotRunError("the thermocouples did not differ by 10 °C")
        bench.try_to_arm()
        _expect_off(bench.next_sample(0.05), "after ARM", 8)


@_rule("what-a-board-must-do")
def _arm_needs_the_newest_challenge(bench: Bench) -> None:
    """ARM with any other challenge has no effect; it changes each time the board is off."""
    challenges = [bench.newest.challenge]
    for _ in range(3):
        bench.arm()
        challenges.append(bench.ensure_off().challenge)
    expect(len(set(challenges)) == 4, f"the challenges were {challenges}; expected unlike ones")
    *_, old, new = challenges
    for challenge in {old, new ^ 1, new ^ 0x8000, 0} - {new}:
        bench.send_arm([NOMINAL_BOUNDS] * len(bench.names), 1.0, challenge)
        _expect_off(
            bench.next_sample(0.15), f"after ARM with {challenge}, where {new} is the newest,"
        )


@_rule("from-the-host")
def _heat_must_show(bench: Bench) -> None:
    """ARM arms only with a sum that all wires can have, and with bounds by which heat shows."""
    most = len(bench.names)
    for total in (most + 1e-4, 6.5535) if most < 6 else ():  # a frame cannot say more
        bench.try_to_arm(NOMINAL_BOUNDS, total)
        _expect_off(bench.next_sample(0.02), f"after ARM with a sum of {total:g}", 7)
    bench.try_to_arm(HIDING, 1.0)
    _expect_off(bench.next_sample(0.02), "after ARM with bounds by which 0.12 shows by 1 °C", 7)
    _expect_armed(bench, HIDING, 0.12)


@_rule("from-the-host")
def _bounds_must_be_whole(bench: Bench) -> None:
    """ARM arms only if the BOUNDS of all wires came, with its challenge and its CRC."""

    def frames(challenge: int, bounds: Bounds = NOMINAL_BOUNDS, wires: int = len(bench.names)):
        pulls = bench.pulls[:wires]
        return from_host.encode_arming(challenge, [bounds] * wires, 1.0, pulls)

    challenge = bench.next_sample().challenge
    right, other, stale = frames(challenge), frames(challenge, WIDE_BOUNDS), frames(challenge ^ 1)
    for what, sent in {
        "no BOUNDS of the first wire": right[1:],
        "a BOUNDS of another set": other[:1] + right[1:],
        "a BOUNDS of another challenge": stale[:1] + right[1:],
        "a wire less": frames(challenge, wires=len(bench.names) - 1),
    }.items():
        for frame in sent:
            bench.cable.send(frame)
            bench.wait(POLL_INTERVAL)
        _expect_off(bench.next_sample(0.05), f"after ARM with {what}", 7)


# Commands.


@_rule("from-the-host")
def _duty_goes_to_its_wire(bench: Bench) -> None:
    """COMMAND has the duty of each wire; above the sum all are reduced in proportion."""
    wires = len(bench.names)
    unlike = [0.02 + 0.01 * wire for wire in range(wires)]
    far = [0.09, 0.03, *bench.same_duty(0.06)[2:]]
    for total, asked, applied in (
        (1.5, unlike, unlike),
        (1.5, bench.only(0, 0.0123), bench.only(0, 0.0123)),
        (0.03 * wires, bench.same_duty(0.06), bench.same_duty(0.03)),
        (0.03 * wires, far, [share / 2 for share in far]),
    ):
        bench.arm(total=total)
        bench.hold(asked, 0.15)
        _expect_duty(bench.next_sample(), applied, f"for {_percent(asked)} and a sum of {total:g}")
        bench.ensure_off()


@_rule("from-the-board")
def _acknowledges_the_last_command(bench: Bench) -> None:
    """SAMPLE has its sequence, modulo 65536; 7D and a byte stand for the byte XOR 20."""
    bench.arm()
    first = bench.next_sample().acknowledged
    expect(first == 0, f"{0} is the last command of a new session; expected 0")
    for number in (1, 2, 0x03, 0x7D, 0x7E, 0x7E7D, 0xFDFD, 0x0007):  # it begins anew
        bench.stray(bench.same_duty(0.0), sequence=number)
        seen = bench.next_sample(0.1).acknowledged
        expect(seen == number, f"command {number:X} is acknowledged as {seen:X}")


@_rule("from-the-host")
def _stale_commands_do_nothing(bench: Bench) -> None:
    """COMMAND has no effect if it is old, late, repeated or of another session, nor while off."""
    bench.arm()
    before = bench.session
    bench.command(bench.gentle_duty)
    bench.next_sample(0.05)
    for session in (before, bench.ensure_off().challenge, 0):
        bench.stray(bench.gentle_duty, sequence=1000, session=session)
        _expect_off(bench.next_sample(), "after a COMMAND while it was off")
    bench.arm()
    bench.hold(bench.same_duty(0.02), 0.4)
    commands: list[tuple[str, dict]] = [
        (f"of session {session}", {"sequence": 10**4, "session": session})
        for session in {before, bench.session ^ 1, 0} - {bench.session}
    ]
    commands += [(f"of the sequence {number}", {"sequence": number}) for number in (0, 1, 5, 40000)]
    # The last of these answers a sample that is not yet.
    commands += [(f"that answers a sample {age:g} s old", {"age": age}) for age in (0.3, 5.0, -1.0)]
    asked = bench.same_duty(0.02)
    commands += [("for a wire more", {"duty": [*bench.gentle_duty, bench.gentle_duty[0]]})]
    commands += [("for a wire less", {"duty": bench.gentle_duty[1:]})]
    for what, command in commands:
        bench.command(asked)
        bench.next_sample()
        bench.stray(bench.gentle_duty, sequence=bench.sequence)
        bench.stray(**{"duty": bench.gentle_duty} | command)
        _expect_duty(bench.next_sample(), asked, f"after a command {what}, and one that repeats")


def _last_command(bench: Bench) -> float:
    """Ends a series of commands; the time of the SAMPLE that the last one answered, s."""
    bench.heat_gently(0.3)
    answered = bench.next_sample().board_time
    bench.command(bench.gentle_duty)
    return answered


@_rule("from-the-host")
def _duty_ends_in_time(bench: Bench) -> None:
    """A duty holds until 250 ms after its COMMAND, and 290 ms after the SAMPLE it answers."""
    answered = _last_command(bench)
    while (age := bench.next_sample().board_time - answered) <= 0.22:
        when = f"{1000 * age:.0f} ms after the last command"
        _expect_duty(bench.newest, bench.gentle_duty, when)
    bench.ensure_off()
    for after, answers_it, within in ((0.27, False, 0.36), (0.19, True, 0.385)):
        answered = _last_command(bench)
        # A SAMPLE tells too late when it ended; but a board that is off takes no command any more.
        bench.wait(after)
        bench.stray(bench.gentle_duty, age=answers_it * (bench.newest.board_time - answered))
        ended = bench.sees(lambda sample: not sample.armed, 1.0)
        age = bench.newest.board_time - answered
        expect(
            ended and age <= within,
            f"{'off' if ended else 'armed'} {1000 * age:.0f} ms after the answered sample, with "
            f"another COMMAND after {1000 * after:.0f} ms; expected off within "
            f"{1000 * within:.0f} ms",
        )
        bench.ensure_off()


@_rule("from-the-host")
def _off_has_its_reason(bench: Bench) -> None:
    """SAMPLE says whether no command came, or late ones only."""
    bench.arm()
    bench.wait(0.6)
    if not bench.next_sample().armed:  # else another rule is broken
        _expect_off(bench.newest, "when no command came", 1)
    bench.ensure_off()
    bench.arm()
    for came in bench.polls(0.8):
        if came:
            bench.stray(bench.same_duty(0.0), age=0.4)
    _expect_off(bench.newest, "when only late commands came", 6)


# Faults. Bounds that no wire has let the band act at once.


def _make_fault(bench: Bench) -> None:
    """Heats the coolest wire, which ARM says warms far more, until the board is off for 21."""
    bench.cool(min)
    bench.arm(STRONG)
    duty = bench.only(int(np.argmin(bench.newest.temperature)), 0.3)
    bench.hold_until_off(duty, 6.0)
    _expect_off(bench.newest, "where ARM said that the wire warms by 60 °C/s at least", 21)


@_rule("the-band")
def _heat_that_is_not_read_latches(bench: Bench) -> None:
    """A reading below the band latches 21 until CLEAR with the newest challenge; it stays off."""
    _make_fault(bench)
    bench.wait(6.0)  # after which the fault is gone
    old, new = bench.session, bench.newest.challenge
    bench.try_to_arm()
    _expect_off(bench.next_sample(0.15), "after ARM without a CLEAR", 21)
    for challenge in {old, new ^ 1} - {new}:
        bench.cable.send(protocol.encode(protocol.CLEAR, challenge))
        _expect_off(bench.next_sample(0.15), f"after CLEAR with {challenge}, not the newest,", 21)
    new = bench.newest.challenge
    bench.clear()
    _expect_off(bench.next_sample(), "after CLEAR", 3)
    expect(bench.newest.challenge != new, "CLEAR kept the challenge; expected a new one")


@_rule("the-band")
def _warmth_without_heat_latches(bench: Bench) -> None:
    """A reading above the band latches 24."""
    bench.arm(WEAK)
    duty = bench.only(int(np.argmin(bench.newest.warmest)), 0.3)  # of which it knows the least heat
    bench.hold_until_off(duty, 15.0)
    seen = bench.newest
    bench.switch_off()
    bench.cool(max)  # or else a board takes the thermocouple for a wrong one
    what = f"at {seen.temperature.max():.0f} °C, where ARM said 10 °C/s at most,"
    _expect_off(seen, what, 24)


def _prove(bench: Bench) -> None:
    """Has all thermocouples follow some heat, as they must after a start; then it is off."""
    if bench.newest.warmest.max() >= 127:
        bench.arm(NOMINAL_BOUNDS)
        bench.hold(bench.same_duty(0.25), 4.0)
        bench.ensure_off()


@_rule("from-the-board")
def _heated_wire_is_the_one_that_warms(bench: Bench) -> None:
    """Left is the left wire, its thermocouple and negative angles, and so is any other wire."""
    _prove(bench)
    for wire, side in reversed(list(enumerate(bench.names))):
        before = bench.next_sample()
        bench.arm()
        bench.hold(bench.only(wire, 0.3), 7.0)
        after = bench.next_sample(0.05)
        bench.switch_off()
        risen = after.temperature - before.temperature
        own, other = risen[wire], np.delete(risen, wire).max(initial=0.0)
        turns = np.rad2deg(after.tip_tangent - before.tip_tangent)
        turned = bench.shares[:, wire] @ turns
        expect(
            own > 3 and own > 2 * other,
            f"heat to the {side} wire raised its own V by {own:.1f} °C, another by {other:.1f}; "
            "expected more than 3 °C, and twice the other",
        )
        expect(
            turned > 1, f"it turned the tip by {turned:.1f}° to the {side}; expected 1° at least"
        )


@_rule("the-band", "hand")
def _detached_thermocouple_latches(bench: Bench) -> None:
    """A thermocouple that has come off latches 21."""
    with bench.fault("detach {0}", "Take the {0} thermocouple off its wire, into the air"):
        bench.next_sample()
        bench.clear()  # it may have jumped
        bench.arm(NOMINAL_BOUNDS)
        bench.hold_until_off(bench.same_duty(0.15), 10.0)
        _expect_off(bench.newest, "10 s after it was heated", 21)


@_rule("what-a-board-must-do", "hand")
def _bend_that_does_not_follow_latches(bench: Bench) -> None:
    """A bend that does not turn by 3° while the wires' difference changes by 60 °C latches 23."""
    _prove(bench)
    bench.cool(max)
    with bench.fault("stick bend", "Clamp the limb so that it cannot bend"):
        bench.arm((0.042, 0.07, 17.0, 23.0, 0.5))  # they cool more slowly at most
        shares = bench.shares[0]
        least, pulls = np.zeros(len(shares)), [0.0]  # °C, as the board calculates it
        sides = [np.where(side * shares > 0.1, side * shares, 0.0) for side in (-1, 1)]
        one, other = (0.5 * (side > 0) / side.sum() for side in sides)  # as two wires pull

        def ends(sample: Sample) -> bool:
            least[:] += 0.05 * (17.0 * sample.duty - 0.07 * least)
            pulls.append(shares @ least)
            return bool(not sample.armed or np.ptp(pulls) > 65 or sample.temperature.max() > WARM)

        for duty, seconds in ((one, 4.5), (0 * one, 20.0), (other, 9.0)):
            if bench.hold(duty, seconds, until=ends):
                break
        if bench.newest.armed and np.ptp(pulls) <= 65:
            raise NotRunError("these wires would become too warm; they are stronger than others")
        _expect_off(bench.newest, "after a change by 65 °C", 23)


@_rule("the-band")
def _warmest_follows_the_heat(bench: Bench) -> None:
    """The most a wire can have follows its duty."""
    _prove(bench)
    bench.arm(BUDGET)
    bench.command(bench.same_duty(0.0))
    start = bench.next_sample()
    count = len(bench.samples) - 1
    bench.hold(bench.only(0, 0.1), 3.0)
    bench.hold(bench.only(-1, 0.08), 3.0)
    given = sum(
        100.0 * (after.board_time - before.board_time) * before.duty
        for before, after in itertools.pairwise(bench.samples[count:])
    )
    risen = bench.newest.warmest - start.warmest
    expect(
        (np.abs(risen - given) <= 6.0).all(),
        f"the most that the wires can have rose by {risen} °C, when ARM said up to 100 °C/s at "
        f"full duty; expected {np.round(given)} °C",
    )
    armed = bench.newest.warmest
    bench.switch_off()
    off = bench.next_sample(0.5).warmest
    expect(
        (np.abs(off - armed) <= 3).all(),
        f"the most fell from {armed} to {off} °C within 0.7 s of switching off; expected it to be "
        "kept",
    )


@_rule("the-band")
def _duty_is_reduced_before_127_c(bench: Bench) -> None:
    """The duty is reduced so that the most a wire can have stays below 127 °C."""
    _prove(bench)
    bench.arm(BUDGET)
    bench.hold(bench.only(-1, 0.25), 8.0, until=lambda sample: 0 < sample.duty[-1] < 0.2)
    bench.hold(bench.only(-1, 0.25), 1.0)
    seen = bench.next_sample()
    expect(
        seen.armed and seen.duty[-1] < 0.2 and seen.warmest.max() <= 129,
        f"{state_of(seen)}, with {_percent(seen.duty)} after heat for {seen.warmest.max():g} °C; "
        "expected it to stay armed, at a reduced duty, and at 127 °C at most",
    )


def _expect_latch(
    bench: Bench, reason: int, order: str, by_hand: str, seconds: float = 3.0
) -> float:
    """A fault must latch within a time, s, for its reason; the highest reading until then, °C."""
    with bench.fault(order, by_hand):
        bench.sees(lambda sample: sample.latched or sample.temperature.max() > 118.0, seconds)
        hottest = np.nanmax([sample.temperature for sample in bench.samples])
        _expect_off(bench.newest, f"with readings up to {hottest:.1f} °C", reason)
    return hottest


# What, its reason, the order and what is done by hand.
for _what, *_fault in (
    ("open thermocouple", 17, "open {0}", "Unplug the {0} thermocouple"),
    ("short to ground", 18, "ground {1}", "Ground a lead of the {1} thermocouple"),
    ("short to supply", 19, "supply {0}", "Put the {0} thermocouple's lead to 3.3 V"),
    ("dead amplifier", 17, "dead {1}", "Unplug the {1} amplifier's data line, DO"),
    ("silent bend sensor", 22, "silence", "Unplug the bend sensor"),
    ("reading below the room", 25, "drift {0} -1", "Hold ice on the {0} bead", 30.0),
    ("reserved bits", 26, "garbled {0}", ""),
    ("jump", 20, "offset {1} 11", ""),
    ("fall", 20, "offset {0} -11", ""),
    ("frozen bend sensor", 23, "freeze bend", ""),
):

    def _latches(bench: Bench, fault: Sequence = tuple(_fault)) -> None:
        bench.cool(max)  # or else another fault shows first
        _expect_latch(bench, *fault)

    _by = "hand" if _fault[2] else "order"
    _name, _sentence = f"{_what} latches".replace(" ", "-"), f"A fault latches: {_what}."
    _added(_name, _sentence, "what-a-board-must-do", _by, _latches)


@_rule("what-a-board-must-do", "order")
def _bad_reading_is_borne(bench: Bench) -> None:
    """A single bad reading is sent as none, and ends the duty of its wire alone until the next."""
    bench.heat_gently()
    bench.tell("glitch {0} 1", "")
    start = len(bench.samples)
    bench.hold(bench.gentle_duty, 0.5)
    bad = [sample for sample in bench.samples[start:] if np.isnan(sample.temperature).any()]
    expect(
        len(bad) == 2 and all(np.isnan(sample.temperature[0]) for sample in bad),
        f"{len(bad)} samples had no reading; expected the two samples of one",
    )
    for sample in bad:
        _expect_duty(sample, [0.0, *bench.gentle_duty[1:]], "without a reading")
    expect(bench.newest.armed, f"{state_of(bench.newest)} after it; expected it to be armed")
    _expect_duty(bench.newest, bench.gentle_duty, "after the next reading")


@_rule("what-a-board-must-do", "order")
def _watchdog_resets(bench: Bench) -> None:
    """A watchdog resets a board whose program hangs, which latches 27."""
    bench.heat_gently()
    bench.tell("stall 5.0", "")
    bench.wait(0.3)
    _expect_off(bench.next_sample(), "after its program hung", 27)


@_rule("what-a-board-must-do", "order")
def _clock_that_stands_latches(bench: Bench) -> None:
    """A clock that stands still latches 28."""
    bench.heat_gently()
    bench.tell("stop clock", "")
    bench.wait(2.0)
    bench.tell("mend", "")
    _expect_off(bench.next_sample(0.3), "after its clock stood still", 28)


@_rule("the-band", "order")
def _frozen_thermocouple_latches(bench: Bench) -> None:
    """A heated wire's reading that stands still gets no duty after 10 s, and latches 21."""
    _prove(bench)
    bench.cool(max)
    bench.arm(NOMINAL_BOUNDS)
    bench.hold(bench.only(0, 0.15), 8.0)
    bench.tell("freeze {0}", "")
    bench.hold(bench.only(0, 0.08), 9.7)
    seen = bench.next_sample()
    expect(
        seen.armed and 0 < seen.duty[0] < 0.07,
        f"{state_of(seen)}, at {_percent(seen.duty)} 9.7 s after it froze; expected below 7%",
    )
    bench.hold_until_off(bench.only(0, 0.08), 13.0)
    _expect_off(bench.newest, "22 s after it froze", 21)
    bench.do("mend", UNDO)


@_rule("what-a-board-must-do", "hand")
def _first_fault_is_kept(bench: Bench) -> None:
    """The first fault that latches stays."""
    with bench.fault("supply {1}", "Connect a lead of the {1} thermocouple to 3.3 V"):
        bench.next_sample(0.3)
        bench.do("silence", "Unplug the bend sensor as well")
        _expect_off(bench.next_sample(0.3), "after two faults", 19)


@_rule("what-a-board-must-do", "hand")
def _reset_begins_anew(bench: Bench) -> None:
    """After a reset reason and cause say so, the challenge is random, and ten samples must come."""
    challenges = []
    for _ in range(3):
        bench.reset()
        challenges.append(bench.newest.challenge)
        _expect_off(bench.newest, "after a reset", 5)
    expect(len(set(challenges)) == 3, f"{challenges} after three resets; expected unlike ones")
    while not bench.newest.armed and bench.newest.sequence < 30:
        bench.try_to_arm()
        bench.next_sample()
    number = bench.newest.sequence
    expect(
        bench.newest.armed and number > 10,
        f"{state_of(bench.newest)} at sample {number}; expected it to arm after sample 10",
    )
    bench.ensure_off()
    _answers(bench, 3 * HELLO)
    causes = [info[6] for info in bench.infos]
    expect({1, 3} & {*causes}, f"causes {causes} of the last reset; expected 1 or 3")


@_rule("what-a-board-must-do", "hand")
def _fault_outlives_a_reset(bench: Bench) -> None:
    """A latched fault stays over a reset."""
    _make_fault(bench)
    bench.reset()
    _expect_off(bench.next_sample(), "after a reset", 21)


@_rule("the-band", "hand")
def _little_heat_after_a_start(bench: Bench) -> None:
    """After any start there is little duty until a thermocouple has followed it."""
    bench.cool(max)
    bench.reset()
    bench.next_sample(0.6)
    bench.arm(NOMINAL_BOUNDS)
    share = round(min(0.3, 1.2 / len(bench.names)), 2)
    bench.hold(bench.same_duty(share), 0.3)
    seen = bench.next_sample()
    expect(
        seen.warmest.min() >= 120 and seen.duty.max() <= 0.12,
        f"{_percent(seen.duty)} after a reset, where the wires can have {seen.warmest} °C; "
        "expected 12% at most, and 120 °C or more",
    )
    bench.hold(bench.same_duty(share), 10.0, until=lambda sample: sample.duty.min() == share)
    seen = bench.newest
    _expect_duty(seen, bench.same_duty(share), "after ten seconds of the duty that was asked for")
    hottest = seen.warmest.max()
    expect(hottest < 100, f"a wire can have {hottest:g} °C after ten seconds; expected below 100")


@_rule("what-a-board-must-do", "hand")
def _reading_above_110_c_latches(bench: Bench) -> None:
    """Two readings in a row above 110 °C latch 16."""
    bench.reset()  # after which a wire may be hot by its heat, so that the band bears it
    bench.wait(0.6)
    warm = "Begin to warm the {0} thermocouple, off the limb, slowly to above 110 °C by hot air"
    hottest = _expect_latch(bench, 16, "drift {0} 4", warm, 60.0)
    expect(110 <= hottest <= 113, f"it latched at {hottest:.1f} °C; expected 110 to 113 °C")


def main() -> int:
    """Check a board at a port rule by rule; return 1 if it breaks a rule."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("port")
    parser.add_argument("-l", "--limb", help="description of the limb on it, else the nominal one")
    parser.add_argument("--by-hand", action="store_true", help="wait for what is done by hand")
    parser.add_argument("--by-order", action="store_true", help="wait for orders at `emulate`")
    options = parser.parse_args()

    def say(result: Outcome) -> None:
        print(f"{result.outcome:<9}{result.case.name}{': ' * bool(result.details)}{result.details}")
        if result.outcome == FAILED:
            print(f"         rule: {result.case.rule} docs/protocol.md#{result.case.section}")

    def ask(order: str, by_hand: str) -> bool:
        what = f'Type "{order}" at soft-limb emulate' if options.by_order else by_hand
        asked = f"         {what}, then press Enter here (s and Enter: skip) "
        return bool(what) and not input(asked)

    asks = ask if options.by_hand or options.by_order else None
    with SerialPort(options.port) as cable:
        results = check_board(cable, say, asks, limb=LimbParameters.of(options.limb))
    return int(any(result.outcome == FAILED for result in results))


if __name__ == "__main__":
    sys.exit(main())
