"""The rules of a board: this firmware keeps them, and a board that breaks one fails it."""

import random
import struct
import zlib

import pytest

from hardware.emulation.emulator import Emulation
from hardware.emulation.twin import LimbTwin
from hardware.firmware import firmware, from_host, guard, heat, protocol, wide
from hardware.firmware.firmware import Firmware
from hardware.robot.link import HardwareError, pulls_of
from limb_systems import Layout, LimbParameters

from .bench import Bench
from .conformance import FAILED, NOT_RUN, PASSED, RULES, check_board
from .firmware_checks import ROOM, PaperBoard

STEP = 10  # ms, of the loop
WATCHDOG = 200  # ms


class PaperRobot(PaperBoard):
    """A board on paper that obeys the orders of `soft-limb emulate`, and the host's end."""

    def __init__(self, program=Firmware, limb=None):
        limb = limb or LimbParameters()
        super().__init__(pulls=pulls_of(limb), angles=Layout(limb).num_bends)
        self._names = limb.wire_names
        self._random = random.Random(0)
        self.program = program
        self.hung = 0
        self.obey("mend")
        self.firmware = program(self)

    def wait(self, seconds):
        for _ in range(round(1000 * seconds / STEP)):
            self.pass_time(STEP)
            self.drifted += self.drift * STEP / 1000
            if self.hung > 0:
                self.hung -= STEP
            else:
                self.firmware.step()
            if self.ticks() - self.fed > WATCHDOG:
                self.reset(firmware.WATCHDOG_RESET)

    def ticks(self):
        return self.now if self.stopped is None else self.stopped

    def feed(self):
        self.fed = self.ticks()

    # Orders.

    def ask(self, order, by_hand):
        self.obey(order)
        return True

    def obey(self, order):
        name, *words = order.split()
        wire = self._names.index(words[0]) if words and words[0] in self._names else 0
        if name == "mend":
            self.faults, self.words, self.errors = (
                [what] * self.channels for what in (0, None, 0.0)
            )
            self.drift = self.drifted = 0.0
            self.detached, self.silent, self.bends = False, False, None
            self.hung, self.stopped = 0, None
        elif name in ("open", "ground", "supply"):
            self.faults[wire] = {"open": 1, "ground": 2, "supply": 4}[name]
        elif name in ("dead", "garbled"):
            self.words[wire] = {"dead": 0, "garbled": 8}[name]
        elif name == "offset":
            self.errors[wire] = float(words[1])
        elif name == "drift":
            self.drift = float(words[1])
        elif name == "detach":
            self.detached = True
        elif name == "silence":
            self.silent = True
        elif name == "freeze":
            self.bends = lambda: 77
        elif name == "stick":
            angle = 64 * int(words[1]) if len(words) > 1 else 0
            self.bends = lambda: angle + self._random.randrange(5)
        elif name == "stop":
            self.stopped = self.now
        elif name == "stall":
            self.hung = 1000 * float(words[0])
        else:
            assert name == "reset"
            self.reset(firmware.PIN_RESET)

    def reset(self, cause):
        self.duty = [0.0] * self.channels
        self.reset_cause, self.random = cause, self._random.getrandbits(16)
        self.hung, self.fed = 0, self.now
        self.firmware = self.program(self)

    def read_thermocouple(self, wire):
        if self.words[wire] is not None:
            return struct.pack(">I", self.words[wire])
        before = self.temperatures[wire], self.errors[wire]
        if wire == 0:
            self.errors[0] += self.drifted
            if self.detached:
                self.temperatures[0] = ROOM
        data = super().read_thermocouple(wire)
        self.temperatures[wire], self.errors[wire] = before
        return data

    def read_bend(self):
        data = super().read_bend()
        if self.bends is None or not data:
            return data
        return b"\0" + b"".join(struct.pack("<h", self.bends()) for _ in range(self.angles))


class Cable:
    """The host's end of the cable to a board on paper."""

    def __init__(self, robot):
        self.robot = robot
        self.wait = robot.wait

    def send(self, data):
        self.robot.incoming += data

    def receive(self):
        data = b"".join(self.robot.sent)
        self.robot.sent.clear()
        return data

    def now(self):
        return self.robot.now / 1000


@pytest.fixture(autouse=True)
def fast_checksum(monkeypatch):
    """The same one, as test_protocol.py tests; it would take a third of the time."""
    monkeypatch.setattr(protocol, "crc32", lambda data: struct.pack("<I", zlib.crc32(data)))


def outcomes(change=lambda program, patch: None, by_hand=True, rules=RULES):
    """What came of the rules with a board whose program was changed."""

    with pytest.MonkeyPatch.context() as patch:

        class Program(Firmware):
            def __init__(self, board):
                super().__init__(board)
                change(self, patch)

        robot = PaperRobot(Program)
        found = check_board(Cable(robot), ask=robot.ask if by_hand else None, rules=rules)
    assert [outcome.rule for outcome in found] == rules
    return found


def test_this_firmware_keeps_all_rules_and_those_that_need_no_hand_without_one():
    assert [(o.rule.name, o.what) for o in outcomes() if o.outcome != PASSED] == []
    found = outcomes(by_hand=False)
    assert {o.rule.by_hand for o in found if o.outcome == NOT_RUN} == {True}
    assert {o.rule.by_hand for o in found if o.outcome == PASSED} == {False}
    assert len({o.outcome for o in found}) == 2


def test_boards_with_four_wires_keep_all_rules(two_segments):
    """Around two axes, and in two segments."""
    for limb in (LimbParameters.in_space(wires=4), two_segments):
        robot = PaperRobot(limb=limb)
        found = check_board(Cable(robot), ask=robot.ask, limb=limb)
        assert [(o.rule.name, o.what) for o in found if o.outcome != PASSED] == []
    with pytest.raises(
        HardwareError, match="has 4 channels, but the limb has the wires left, right"
    ):
        check_board(Cable(robot))


def test_a_host_that_misses_channels_ends_the_heat_of_all_wires():
    """It answers whole samples alone, so that the board's heartbeat ends."""
    limb = LimbParameters.in_space(wires=6)
    cable = Cable(PaperRobot(limb=limb))
    bench = Bench(cable, limb=limb)
    bench.wait(0.7)
    bench.arm()
    bench.hold(bench.every(0.05), 0.3)
    assert cable.robot.duty == bench.every(0.05)
    receive, parser = cable.receive, protocol.Parser(from_host.KINDS, from_host.FORMATS)
    cable.receive = lambda: b"".join(
        wide.encode(kind, *values)
        for kind, values in parser.feed(receive())
        if (kind, values[1]) != (wide.CHANNELS, 4)  # the second of two
    )
    start = cable.robot.now
    bench.hold(bench.every(0.05), 0.35)
    assert cable.robot.duty == bench.every(0.0)
    assert cable.robot.firmware.guard.reason == guard.NO_COMMAND
    assert cable.robot.now - start < 400


class EmulatedCable:
    """Both ends of the cable to an emulated board, in simulated time."""

    def __init__(self):
        self.milliseconds = 0
        self.to_board, self.to_host = b"", b""
        self.emulation = Emulation(LimbTwin(seed=1), self, clock=self.now)

    def read(self):
        data, self.to_board = self.to_board, b""
        return data

    def write(self, data):
        self.to_host += data

    def unplug(self):
        pass

    def send(self, data):
        self.to_board += data

    def receive(self):
        data, self.to_host = self.to_host, b""
        return data

    def now(self):
        return self.milliseconds / 1000

    def wait(self, seconds):
        for _ in range(round(1000 * seconds / STEP)):
            self.milliseconds += STEP
            self.emulation.step()

    def ask(self, order, by_hand):
        self.emulation.misbehave(order)
        return True


def test_the_emulated_board_keeps_the_rules_of_heat_and_of_orders():
    """It keeps all rules, but they take eight seconds; the firmware is the same as on paper."""
    cable = EmulatedCable()
    names = {
        "bend-in-64ths-of-a-degree",
        "dead-amplifier-latches",
        "heat-that-is-not-read-latches",
        "heated-wire-is-the-one-that-warms",
    }
    found = check_board(cable, ask=cable.ask, rules=[r for r in RULES if r.name in names])
    assert [(o.rule.name, o.what) for o in found if o.outcome != PASSED] == []
    assert cable.emulation.board.wire_temperature().max() < 70.0


def test_an_emulated_board_whose_computer_was_busy_switches_off_in_time():
    """Its limb is heated for as long as the host's last command holds, not for three seconds."""
    cable = EmulatedCable()
    bench = Bench(cable, cable.ask)
    bench.wait(0.7)
    bench.arm()
    bench.hold((0.0, 1.0), 4.0)
    before = cable.emulation.board.wire_temperature()[1]
    duty = bench.last.duty[1]
    cable.milliseconds += 3000
    for _ in range(100):  # passes, in which it catches up
        cable.wait(STEP / 1000)
    bench.wait(0.1)
    assert bench.last.reason == guard.NO_COMMAND
    assert cable.emulation.board.ticks() == cable.milliseconds
    assert cable.emulation.board.wire_temperature()[1] < before + 23.0 * duty * 0.3


def test_a_silent_board_and_one_that_does_not_switch_off_end_the_checks():
    def say_nothing(program, patch):
        program._board.send = lambda data: None

    first, *others = outcomes(say_nothing)
    assert (first.outcome, {o.outcome for o in others}) == (FAILED, {NOT_RUN})

    def never_off(program, patch):
        no_disarm(program, patch)
        heartbeat_of(10**9)(program, patch)
        patch.setattr(guard, "LONGEST_HOLD", 10**9)

    found = outcomes(never_off)
    (stays,) = (o for o in found if "disconnect the supply of its wires" in o.what)
    assert {o.outcome for o in found[found.index(stays) + 1 :]} == {NOT_RUN}


# Boards that break one rule each.


def constants(module=guard, **values):
    """Constants of the board; the checks do not use them."""

    def change(program, patch):
        for name, value in values.items():
            patch.setattr(module, name, value)

    return change


def in_guard(name):
    """A method of the guard, which gets the guard and the old one first."""

    def decorate(new):
        def change(program, patch):
            subject = program.guard
            old = getattr(subject, name)
            setattr(subject, name, lambda *arguments: new(subject, old, *arguments))

        return change

    return decorate


def in_program(name):
    """A method of the program, which gets the program and the old one first."""

    def decorate(new):
        def change(program, patch):
            old = getattr(program, name)
            setattr(program, name, lambda *arguments: new(program, old, *arguments))

        return change

    return decorate


def ignores(*reasons):
    """A guard that does not mind these faults."""

    @in_guard("trip")
    def change(subject, trip, reason, now):
        if reason not in reasons:
            trip(reason, now)

    return change


def sends(damage):
    """What the board sends is damaged."""

    def change(program, patch):
        board = program._board
        board.send = lambda data: board.sent.append(damage(data))

    return change


def parses(kind):
    def change(program, patch):
        program._parser = kind(program._parser._kinds)

    return change


class NoChecksum(protocol.Parser):
    def _finish(self, frames):
        body = bytes(self._body[:-4])
        self._body = body + protocol.crc32(body)
        super()._finish(frames)


class AnyVersion(protocol.Parser):
    def _finish(self, frames):
        body = bytes([protocol.VERSION]) + bytes(self._body[1:-4])
        if bytes(self._body[-4:]) == protocol.crc32(bytes(self._body[:-4])):
            self._body = body + protocol.crc32(body)
        super()._finish(frames)


class AnyLength(protocol.Parser):
    def _finish(self, frames):
        body = bytes(self._body[:-4])
        if bytes(self._body[-4:]) == protocol.crc32(body) and body[1] == protocol.HELLO:
            self._body = body[:2] + protocol.crc32(body[:2])
        super()._finish(frames)


class AnyType(protocol.Parser):
    def _finish(self, frames):
        body = bytes(self._body[:-4])
        if body[:1] == b"\x03" and len(body) == 2 and body[1] not in self._kinds:
            frames.append((protocol.HELLO, ()))
        super()._finish(frames)


class NoEscapes(protocol.Parser):
    """It takes no escapes in a sequence."""

    def _finish(self, frames):
        if self._body[1] != protocol.COMMAND or not {0x7D, 0x7E} & set(self._body[4:8]):
            super()._finish(frames)


class StuckByNoise(protocol.Parser):
    """Noise takes the frame after it with it."""

    noisy = False

    def _lose(self):
        super()._lose()
        self.noisy = True

    def feed(self, data):
        frames = super().feed(data)
        if frames and self.noisy:
            self.noisy = False
            return []
        return frames


class EatsFlags(protocol.Parser):
    """After a frame it waits for another flag to begin the next one."""

    def _finish(self, frames):
        count = len(frames)
        super()._finish(frames)
        self.ended = len(frames) > count

    def feed(self, data):
        frames = []
        for byte in data:
            self.ended = False
            frames += super().feed(bytes([byte]))
            if self.ended:
                self._lost = True
        return frames


class ForgetsPieces(protocol.Parser):
    def feed(self, data):
        frames = super().feed(data)
        self._body, self._lost = bytearray(), True
        return frames


@in_program("_handle")
def says_50_ms(program, handle, kind, values, now):
    firmware.SAMPLE_PERIOD = 50
    handle(kind, values, now)
    firmware.SAMPLE_PERIOD = 60


def slow_samples(program, patch):
    patch.setattr(firmware, "SAMPLE_PERIOD", 60)
    says_50_ms(program, patch)


@in_program("_send_sample")
def once(program, send_sample, now):
    send_sample(now)
    program._board.sent.pop()


@in_program("_send_sample")
def jumping_sequence(program, send_sample, now):
    program._sequence += 2 * (program._sequence % 8 == 7)
    send_sample(now)


def fast_clock(program, patch):
    board = program._board
    board.ticks = lambda: PaperRobot.ticks(board) * 11 // 10


def damaged_copies(program, patch):
    board = program._board
    counter = iter(range(10**6))
    board.send = lambda data: board.sent.append(
        data[:-3] + bytes([data[-3] ^ 0x40]) + data[-2:] if next(counter) % 32 == 0 else data
    )


@in_program("_handle")
def no_greeting(program, handle, kind, values, now):
    if kind != protocol.HELLO:
        handle(kind, values, now)


@in_program("_handle")
def no_wires(program, handle, *arguments):
    channels, program._board.channels = program._board.channels, 1
    handle(*arguments)
    program._board.channels = channels


@in_program("_send_sample")
def whole_degrees(program, send_sample, now):
    quarters = program._quarters
    program._quarters = [value // 4 for value in quarters]
    send_sample(now)
    program._quarters = quarters


@in_program("_send_sample")
def sixteenths_of_a_degree(program, send_sample, now):
    bends = program._bends
    program._bends = bends and [bend // 4 for bend in bends]
    send_sample(now)
    program._bends = bends


@in_guard("arm")
def keeps_its_reason(subject, arm, *arguments):
    arm(*arguments)
    if subject.state == guard.ARMED:
        subject.reason = guard.HOST


@in_guard("_agree")
def any_cold_wires(subject, agree):
    return True


@in_guard("arm")
def any_challenge(subject, arm, challenge, *arguments):
    arm(subject.challenge, *arguments)


@in_guard("trip")
def same_challenge(subject, trip, *arguments):
    challenge = subject.challenge
    trip(*arguments)
    subject.challenge = challenge


def keeps_the_duty(program, patch):
    asked = [0.0, 0.0]

    @in_guard("command")
    def command(subject, old, *arguments):
        old(*arguments)
        asked[:] = subject._asked

    @in_guard("arm")
    def arm(subject, old, *arguments):
        old(*arguments)
        if subject.state == guard.ARMED:
            subject._asked = list(asked)

    command(program, patch)
    arm(program, patch)


def heats_when_off(program, patch):
    @in_guard("command")
    def command(subject, old, session, sequence, heard, duty, now):
        old(session, sequence, heard, duty, now)
        if subject.state == guard.DISARMED:
            subject._asked = list(duty)

    @in_guard("sample")
    def sample(subject, old, *arguments):
        old(*arguments)
        if subject.state == guard.DISARMED:
            subject._asked = [0.0, 0.0]

    command(program, patch)
    sample(program, patch)


@in_guard("arm")
def arms_again(subject, arm, *arguments):
    subject.state = guard.DISARMED
    arm(*arguments)


def only_in_order(bounds):
    return bounds[0] <= bounds[1] and bounds[2] <= bounds[3]


def only_in_range(bounds):
    return all(low <= b <= high for b, (low, high) in zip(bounds, heat.RANGES, strict=True))


@in_guard("arm")
def any_sum(subject, arm, challenge, bounds, total, *others):
    arm(challenge, bounds, total if 0.0 < total <= 2.0 else 1.0, *others)


@in_guard("command")
def swapped_wires(subject, command, session, sequence, heard, duty, now):
    command(session, sequence, heard, [duty[1], duty[0], *duty[2:]], now)


@in_program("_send_sample")
def low_byte_of_the_sequence(program, send_sample, now):
    acknowledged = program.guard.acknowledged
    program.guard.acknowledged &= 0xFF
    send_sample(now)
    program.guard.acknowledged = acknowledged


@in_guard("command")
def any_sequence(subject, command, *arguments):
    subject.acknowledged = -1
    command(*arguments)
    subject.acknowledged = max(subject.acknowledged, 0)


@in_guard("command")
def any_session(subject, command, session, *arguments):
    command(subject.session, *arguments)


@in_guard("command")
def any_age(subject, command, session, sequence, heard, duty, now):
    late = (now - heard) & 0xFFFFFFFF >= 250
    command(session, sequence, now - 249 if late else heard, duty, now)


@in_guard("command")
def limits_the_duty(subject, command, session, sequence, heard, duty, now):
    command(session, sequence, heard, [min(share, 1.0) for share in duty], now)


def heartbeat_of(milliseconds):
    @in_guard("tick")
    def change(subject, tick, now):
        subject._heard += milliseconds - 250
        tick(now)
        subject._heard -= milliseconds - 250

    return change


@in_guard("disarm")
def no_disarm(subject, disarm, now):
    pass


@in_guard("trip")
def always_the_host(subject, trip, reason, now):
    trip(reason if reason >= guard.LATCHING else guard.HOST, now)


@in_guard("arm")
def any_power(subject, arm, challenge, bounds, total, *others):
    arm(challenge, bounds, 2.0 if 0.0 < total <= 2.0 else total, *others)


def no_open(wire):
    @in_guard("_check_wire")
    def change(subject, check_wire, number, temperature, faults, *arguments):
        check_wire(number, temperature, faults & ~1 if number == wire else faults, *arguments)

    return change


@in_guard("trip")
def newest_fault(subject, trip, reason, now):
    if reason == guard.BEND_SILENT:
        subject.reason = guard.NONE
    trip(reason, now)


@in_guard("arm")
def does_not_latch(subject, arm, *arguments):
    if not subject._faulty and subject.reason >= guard.LATCHING:
        subject.reason = guard.HOST
    arm(*arguments)


@in_guard("clear")
def any_clear(subject, clear, challenge):
    clear(subject.challenge)


@in_guard("clear")
def clear_keeps_the_challenge(subject, clear, challenge):
    clear(challenge)
    subject.challenge = challenge


@in_guard("clear")
def no_clear(subject, clear, challenge):
    pass


def swapped_thermocouples(program, patch):
    board = program._board
    board.read_thermocouple = lambda wire: PaperRobot.read_thermocouple(board, 1 - wire)


@in_guard("warmest")
def forgets_heat_when_off(subject, warmest, wire):
    return warmest(wire) if subject.state == guard.ARMED else 25


def forgets_faults(program, patch):
    program._board.remember = lambda reason: None
    program._board.remembered = 0


@in_program("_handle")
def no_cause(program, handle, *arguments):
    cause, program._board.reset_cause = program._board.reset_cause, firmware.POWER_ON
    handle(*arguments)
    program._board.reset_cause = cause


def same_random_number(program, patch):
    program.guard.challenge = 4711


def much_heat_after_a_start(program, patch):
    program.guard.proven = [True, True]
    for observer in program.guard.observers:
        observer.most = min(observer.most, 80.0)


def no_watchdog(program, patch):
    program._board.feed = lambda: None
    program._board.fed = 10**9


# For each rule boards that break it.
BOARDS = {
    "samples-every-50-ms": (slow_samples, once, jumping_sequence, fast_clock),
    "frames-are-valid": (damaged_copies, sends(lambda data: data.replace(b"\x7d\x23", b"\x03"))),
    "info-describes-the-board": (no_greeting, no_wires),
    "damaged-frames-are-ignored": (
        parses(NoChecksum),
        parses(AnyVersion),
        parses(AnyLength),
        parses(AnyType),
    ),
    "noise-is-skipped": (parses(StuckByNoise), parses(EatsFlags), parses(ForgetsPieces)),
    "temperatures-in-quarter-degrees": (whole_degrees,),
    "bend-in-64ths-of-a-degree": (sixteenths_of_a_degree,),
    "arm-arms": (keeps_its_reason, keeps_the_duty, arms_again),
    "cold-thermocouples-must-agree": (any_cold_wires,),
    "arm-needs-the-newest-challenge": (any_challenge, same_challenge),
    "bounds-in-range": (
        constants(heat, acceptable=only_in_order),
        constants(heat, acceptable=only_in_range),
        constants(heat, shown=lambda bounds, total: True),
        constants(heat, shown=lambda bounds, total: total > 0.5),
        any_sum,
    ),
    "duty-goes-to-its-wire": (swapped_wires, any_power),
    "acknowledges-the-last-command": (low_byte_of_the_sequence, parses(NoEscapes)),
    "stale-commands-do-nothing": (heats_when_off, any_sequence, any_session, any_age),
    "duty-ends-in-time": (heartbeat_of(400), heartbeat_of(150), constants(LONGEST_HOLD=1000)),
    "off-has-its-reason": (limits_the_duty, no_disarm, always_the_host),
    "heat-that-is-not-read-latches": (
        ignores(guard.NOT_WARMING),
        does_not_latch,
        any_clear,
        clear_keeps_the_challenge,
        no_clear,
    ),
    "warmth-without-heat-latches": (ignores(guard.TOO_WARM),),
    "heated-wire-is-the-one-that-warms": (swapped_thermocouples, swapped_wires),
    "warmest-follows-the-heat": (forgets_heat_when_off,),
    "duty-is-reduced-before-127-c": (constants(HIGHEST=250.0),),
    "open-thermocouple-latches": (no_open(0),),
    "short-to-ground-latches": (ignores(guard.THERMOCOUPLE_TO_GROUND),),
    "short-to-supply-latches": (ignores(guard.THERMOCOUPLE_TO_SUPPLY),),
    "dead-amplifier-latches": (no_open(1),),
    "silent-bend-sensor-latches": (ignores(guard.BEND_SILENT),),
    "first-fault-is-kept": (newest_fault,),
    "detached-thermocouple-latches": (ignores(guard.NOT_WARMING),),
    "bend-that-does-not-follow-latches": (constants(PULL=1000.0), swapped_thermocouples),
    "reading-below-the-room-latches": (ignores(guard.BELOW_ROOM),),
    "reset-begins-anew": (constants(SETTLING_SAMPLES=3), no_cause, same_random_number),
    "fault-outlives-a-reset": (forgets_faults,),
    "little-heat-after-a-start": (much_heat_after_a_start,),
    "reading-above-110-c-latches": (constants(HOT_SAMPLES=10**6),),
}


@pytest.mark.parametrize("section", sorted({rule.section for rule in RULES}))
def test_boards_that_break_a_rule_fail_it(section):
    """Each board is checked by the rule that it breaks."""
    for rule in RULES:
        for change in BOARDS[rule.name] if rule.section == section else ():
            (outcome,) = outcomes(change, rules=[rule])
            assert outcome.outcome == FAILED, (rule.name, change)
    assert BOARDS.keys() == {rule.name for rule in RULES}
