"""Each firmware keeps the rules of a board, and one line that is changed breaks one of them."""

import json
import random
import sys
import types
from pathlib import Path
from unittest import mock

import pytest

from hardware import HardwareError
from hardware.board import board_check
from hardware.board.board_check import CASES, FAILED, NOT_RUN, PASSED, Host
from hardware.firmware import guard, protocol
from hardware.firmware.firmware import Firmware
from limb_systems import LimbParameters
from soft_limb.command import main

from .bench import Bench
from .conformance import RULES, check_board
from .conftest import small_twin
from .emulated_cable import EmulatedCable, PaperTwin

ROOT = Path(__file__).parents[2]
FIRMWARE = ROOT / "hardware" / "firmware"
# Rules that tell how a simulated limb differs from one on paper; all of them take ten seconds.
OF_WIRES_AND_BENDS = (
    *("info", "sensors", "bend", "bounds", "duty-goes", "heated-wire", "warmest", "bad-reading"),
    *("open", "detached", "silent"),
)
ON_SIMULATED = ("bend-in-64ths", "heated-wire", "heat-that")

# Rules, and the line of a file that breaks them if it is changed.
MUTANTS = [
    ("samples", "firmware", "SAMPLE_PERIOD = 50", "SAMPLE_PERIOD = 60"),
    ("samples-every-50-ms", "firmware", "(self._sequence + 1) &", "(self._sequence + 2) &"),
    ("samples-every-50-ms", "firmware", "for _ in (1, 2):", "for _ in (1,):"),
    ("frames-are-valid", "protocol", "_FLAG, _ESCAPE, 0x03)", "_FLAG, _ESCAPE)"),
    ("info", "firmware", "int(4 * guard.TEMP", "int(5 * guard.TEMP"),
    ("info", "firmware", "board.channels, board.angles, b", "1, 1, b"),
    ("damaged-frames-are-ignored", "protocol", "or body[-4:] != crc32(body[:-4])", ""),
    ("damaged-frames-are-ignored", "protocol", "elif body[0] != VERSION", "elif body[0] > 9"),
    ("damaged-frames-are-ignored", "protocol", "body[2:-4]) if", "body[2:2]) if"),
    ("noise-is-skipped", "protocol", "self._escaping = self._lost = False", "self._lost = False"),
    ("sensors", "readings", "_signed(word >> 18, 14)", "word >> 17"),
    ("bend-in-64ths-of-a-degree", "firmware", "list(self._bends)", "[b // 2 for b in self._bends]"),
    ("arm-arms", "guard", "self.reason = NO_REASON", "self.reason = BY_HOST"),
    ("arm-arms", "guard", "or self.state == ARMED or self.reason", "or self.reason"),
    ("cold-thermocouples-must-agree", "guard", "_TOLERANCE = 8.0", "_TOLERANCE = 20.0"),
    ("arm-needs-the-newest-challenge", "guard", "challenge != self.challenge or", ""),
    ("challenge", "guard", "challenge != self.challenge or", ""),
    ("arm-needs-the-newest-challenge", "guard", "* 25173 + 13849", "* 1"),
    ("bounds", "heat", "if not low <= bound <= high", "if not low <= bound"),
    ("no-bounds", "guard", "for bound in bounds\n", "for bound in bounds if any(bound)\n"),
    ("bounds", "heat", "bounds[0] <= bounds[1] and", ""),
    ("bounds", "heat", "bounds[2] <= bounds[3]", "True"),
    ("heat-must-show", "heat", "* LITTLE_DUTY >= MIN_DETECTABLE_RISE", "* LITTLE_DUTY >= 0.1"),
    ("no-sum", "guard", "0.0 < total <= len", "0.0 <= total <= len"),
    ("heat-must-show", "guard", "0.0 < total <= len(self.duty)", "0.0 < total"),
    ("bounds-must-be-whole", "firmware", "or protocol.checksum(frames) != expected", ""),
    ("duty-goes-to-its-wire", "firmware", "in values[3:]]", "in values[:2:-1]]"),
    ("sum", "guard", "if total > self._total", "if total > 2.0"),
    ("acknowledges-the-last-command", "firmware", "subject.acknowledged]", "subject._samples]"),
    ("stale-commands-do-nothing", "guard", "& 0xFFFF < 0x8000", "& 0xFFFF < 0x10000"),
    ("stale-commands-do-nothing", "guard", "or session != self.session", ""),
    ("stale-commands-do-nothing", "guard", "if age >= HEARTBEAT", "if age >= 5500"),
    ("duty-ends-in-time", "guard", "_command_time >= HEARTBEAT", "_command_time >= 400"),
    ("duty-ends-in-time", "guard", "HEARTBEAT = 250", "HEARTBEAT = 150"),
    ("duty-ends-in-time", "guard", "LONGEST_HOLD = 290", "LONGEST_HOLD = 1000"),
    ("silence", "guard", "_command_time >= HEARTBEAT or", "_command_time >= 500 and"),
    ("duty", "guard", "max(duty) > 1.0", "max(duty) > 7.0"),
        ("disarm", "guard", "self.trip(BY_HOST, now)", "pass"),
    ("off-has-its-reason", "guard", "LATE_COMMANDS if self._late else", ""),
    ("heat-that-is-not-read-latches", "guard", "MAX_SHORTFALL = 3.0", "MAX_SHORTFALL = 300.0"),
    ("heat-that-is-not-read-latches", "guard", "if challenge == self.challenge and", "if"),
    ("heat-that-is-not-read-latches", "guard", "ARMED or self.reason >= LATCHING", "ARMED"),
    ("warmth-without-heat-latches", "guard", "MAX_EXCESS = 15.0", "MAX_EXCESS = 150.0"),
    ("heated-wire-is-the-one-that-warms", "firmware", "couple(wire))", "couple(1 - wire))"),
    ("detached-thermocouple-latches", "guard", "MAX_SHORTFALL = 3.0", "MAX_SHORTFALL = 30.0"),
    ("bend-that-does-not-follow-latches", "guard", "_CHANGE = 60.0", "_CHANGE = 90.0"),
    ("warmest-follows-the-heat", "heat", "rate = a2_most", "rate = a2_least"),
    ("duty-is-reduced-before-127-c", "guard", "TEMPERATURE = 127.0", "TEMPERATURE = 250.0"),
    ("open-thermocouple-latches", "guard", "if faults & 1:", "if faults & 8:"),
    ("short-to-ground-latches", "guard", "elif faults & 2:", "elif faults & 8:"),
    ("short-to-supply-latches", "guard", "elif faults & 4:", "elif faults & 8:"),
    ("dead-amplifier-latches", "readings", "(0, 0xFFFFFFFF)", "(0xFFFFFFFF,)"),
    ("silent-bend-sensor-latches", "guard", "if bends is None:", "if bends == 0:"),
    ("reading-below-the-room-latches", "guard", "< -AGREEMENT_TOLERANCE:", "< -99.0:"),
    ("reserved-bits-latches", "readings", "word & _RESERVED or", ""),
    ("jump-latches", "guard", "LARGEST_JUMP = 10.0", "LARGEST_JUMP = 12.0"),
    ("fall-latches", "guard", "_temperatures and abs(", "_temperatures and ("),
    ("frozen-bend-sensor-latches", "guard", "STUCK_SAMPLES = 10", "STUCK_SAMPLES = 100"),
    ("first-fault-is-kept", "guard", "        if self.reason < LATCHING:\n", "        if True:\n"),
    ("bad-reading-is-borne", "guard", "BAD_SAMPLES = 3", "BAD_SAMPLES = 1"),
    ("bad-reading-is-borne", "guard", "0.0 if faults else max", "max"),
    ("bad-reading-is-borne", "firmware", "protocol.NO_READING if", "0 if"),
    ("watchdog-resets", "firmware", "guard.RESTARTED)", "guard.WAS_RESET)"),
    ("clock-that-stands-latches", "firmware", "STANDSTILL = 50", "STANDSTILL = 5000"),
    ("frozen-thermocouple-latches", "guard", "= 5000, 10000", "= 9000, 11000"),
    ("frozen-thermocouple-latches", "guard", "if still > latest", "if still > 99999"),
    ("reset-begins-anew", "guard", "SETTLING_SAMPLES = 10", "SETTLING_SAMPLES = 3"),
    ("reset-begins-anew", "firmware", "Guard(now, board.random", "Guard(now, 4711"),
    ("fault-outlives-a-reset", "firmware", "and board.remembered >= guard", "and 0 >= guard"),
    ("little-heat-after-a-start", "heat", "LITTLE_DUTY = 0.12", "LITTLE_DUTY = 0.2"),
    ("reading-above-110-c-latches", "guard", "LIMIT = 110.0", "LIMIT = 130.0"),
]  # fmt: skip


@pytest.fixture(autouse=True)
def seeded(monkeypatch):
    """Seed the noise and the challenges of emulated boards."""
    challenges = random.Random(0)
    random.seed(0)
    monkeypatch.setattr(random, "SystemRandom", lambda: challenges)


def broken(outcomes):
    """What did not pass."""
    return [(o.case.name, o.outcome, o.details) for o in outcomes if o.outcome != PASSED]


def mutant(file, old, new):
    """A firmware in which a line of one file is changed."""
    name = f"mutant_{file}"
    package = sys.modules[name] = types.ModuleType(name)
    for part in ("protocol", "readings", "heat", "guard", "firmware"):
        text = (FIRMWARE / f"{part}.py").read_text(encoding="utf-8")
        if part == file:
            assert text.count(old) == 1, (file, old, text.count(old))
            text = text.replace(old, new)
        module = sys.modules[f"{name}.{part}"] = types.ModuleType(f"{name}.{part}")
        module.__package__ = name
        exec(compile(text, f"{part}.py", "exec"), vars(module))
        setattr(package, part, module)
    package.protocol.crc32 = protocol.crc32
    return package.firmware.Firmware


def outcomes_of(program, rules=RULES, limb=None, by_hand=True):
    """What comes of rules on a board with a limb on paper."""
    with mock.patch("hardware.emulation.emulator.Firmware", program):
        cable = EmulatedCable(PaperTwin(limb))
        return check_board(cable, ask=cable.ask if by_hand else None, rules=rules, limb=limb)


def test_the_firmware_in_python_keeps_all_rules_and_the_core_does_the_same(both_firmwares):
    assert broken(outcomes_of(both_firmwares)) == []


def test_the_core_keeps_all_rules_in_single_precision(core):
    assert broken(outcomes_of(core)) == []


def test_what_needs_a_hand_is_not_run_without_one():
    found = outcomes_of(Firmware, by_hand=False)
    assert {o.case.name for o in found if o.outcome == NOT_RUN} == {
        r.name for r in RULES if r.needs
    }
    assert {o.outcome for o in found} == {PASSED, NOT_RUN}


def test_boards_with_four_wires_keep_the_rules_of_wires_and_bends(two_segments):
    """In two segments all of them, and around two axes those of which wire bends what."""
    for limb, names in (
        (two_segments, OF_WIRES_AND_BENDS),
        (LimbParameters.in_space(wires=4), ("info", "sensors", "bend-", "duty-goes", "heated")),
    ):
        rules = [rule for rule in RULES if rule.name.startswith(names)]
        assert broken(outcomes_of(Firmware, rules, limb)) == []
    with pytest.raises(HardwareError, match="has 4 channels, but the limb has 2 wires"):
        check_board(EmulatedCable(PaperTwin(two_segments)))


def test_a_board_with_a_simulated_limb_keeps_the_rules_of_heat_and_bends():
    cable = EmulatedCable(small_twin(seed=1))
    rules = [rule for rule in RULES if rule.name.startswith(ON_SIMULATED)]
    assert broken(check_board(cable, ask=cable.ask, rules=rules)) == []
    assert cable.emulation.board.wire_temperature().max() < 70.0


@pytest.mark.parametrize("file", sorted({file for _, file, *_ in MUTANTS}))
def test_a_changed_line_breaks_its_rule(file):
    for name, where, old, new in MUTANTS:
        if where == file:
            rules = [rule for rule in RULES if rule.name == name]
            (outcome,) = outcomes_of(mutant(file, old, new), rules)
            assert outcome.outcome == FAILED, (name, new)
            assert outcome.details


def test_each_rule_has_a_changed_line():
    assert {name for name, *_ in MUTANTS} == {rule.name for rule in RULES}


def test_a_board_that_stays_on_ends_the_checks(monkeypatch):
    monkeypatch.setattr(guard, "LONGEST_HOLD", 10**9)
    monkeypatch.setattr(guard.Guard, "disarm", lambda *_: None)
    monkeypatch.setattr(guard.Guard, "tick", lambda *_: None)
    found = outcomes_of(Firmware)
    (stays,) = (o for o in found if "disconnect the supply of its wires" in o.details)
    assert {o.outcome for o in found[found.index(stays) + 1 :]} == {NOT_RUN}


def test_a_host_that_misses_channels_ends_the_heat_of_all_wires():
    """It answers whole samples alone, so that the board's heartbeat ends."""
    limb = LimbParameters.in_space(wires=6)
    cable = EmulatedCable(PaperTwin(limb))
    bench = Bench(cable, limb=limb)
    bench.wait(0.7)
    bench.arm()
    bench.hold(bench.same_duty(0.05), 0.3)
    assert cable.duty == bench.same_duty(0.05)
    receive, parser = cable.receive, protocol.Parser(protocol.BOARD_KINDS)
    cable.receive = lambda: b"".join(
        protocol.encode(kind, *values)
        for kind, values in parser.feed(receive())
        if (kind, values[1]) != (protocol.CHANNELS, 4)  # the second of two
    )
    start = cable.milliseconds
    Host.hold(bench, bench.same_duty(0.05), 0.35)
    assert cable.duty == bench.same_duty(0.0)
    assert cable.emulation.firmware.guard.reason == guard.NO_COMMAND
    assert cable.milliseconds - start < 400


def test_an_emulated_board_whose_computer_was_busy_switches_off_in_time():
    """Its limb is heated for as long as the host's last command holds, not for three seconds."""
    cable = EmulatedCable(small_twin(seed=1))
    bench = Bench(cable, cable.ask)
    bench.wait(0.7)
    bench.arm()
    bench.hold((0.0, 1.0), 4.0)
    before = cable.emulation.board.wire_temperature()[1]
    duty = bench.newest.duty[1]
    cable.milliseconds += 3000
    for _ in range(100):  # passes, in which it catches up
        cable.wait(0.01)
    bench.wait(0.1)
    assert bench.newest.reason == guard.NO_COMMAND
    assert cable.emulation.board.ticks() == cable.milliseconds
    assert cable.emulation.board.wire_temperature()[1] < before + 23.0 * duty * 0.3


def test_board_check_at_a_port(virtual_time, emulator, capsys, monkeypatch):
    outcomes = []

    def check_and_keep(host, tell):
        check_board_at_port(host, lambda outcome: outcomes.append(outcome) or tell(outcome))

    check_board_at_port = board_check.check_board
    monkeypatch.setattr(board_check, "check_board", check_and_keep)
    check = ["board-check", emulator.port, "--supply", "7", "--cut-off"]
    assert main(check) == 0
    *lines, summary = capsys.readouterr().out.splitlines()
    assert lines == [f"ok       {case.name}" for case in CASES]
    assert summary == f"passed {len(CASES)}, failed 0, not run 0"
    assert emulator.duty() == [0.0, 0.0]
    monkeypatch.setattr(board_check, "check_board", lambda _, tell: [*map(tell, outcomes)])
    assert main([*check, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["passed"], facts["failed"], facts["not_run"]) == (len(CASES), 0, 0)
    assert facts["checks"][-1]["section"] == "docs/protocol.md#from-the-host"
    monkeypatch.setattr(board_check, "check_board", check_board_at_port)
    emulator.order("silence")
    virtual_time.sleep(1.0)
    assert main(check) == 1
    message = "error: The board cannot be checked: it is off for reason 22, the bend sensor does"
    assert capsys.readouterr().err.startswith(message)
    emulator.order("drop 1")
    assert main(check) == 1
    assert "sent no sample for 1 s" in capsys.readouterr().err


def test_board_check_heats_nothing_without_answers(virtual_time, emulator, capsys):
    for words, said in {
        "--supply 7": "not checked: nobody has said that a thermal cut-off is on the limb",
        "--cut-off": "not checked: nobody has said which voltage the wires' supply has",
        "--supply 7 --no-cut-off": "not checked: no cut-off",
    }.items():
        assert main(["board-check", emulator.port, *words.split()]) == 1
        assert said in capsys.readouterr().err
    assert not [event for event in emulator.events("duty") if event["left"] or event["right"]]
    assert main(["board-check", emulator.port, "--supply", "0"]) == 0  # it is off: nothing gets hot


def test_a_board_check_that_is_stopped_leaves_the_wires_off(emulator, monkeypatch, capsys):
    heat_gently = Host.heat

    def interrupt(host, *arguments):
        heat_gently(host, *arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(Host, "heat", interrupt)
    assert main(["board-check", emulator.port, "--supply", "0"]) == 130
    assert capsys.readouterr().err == "stopped; wires are off\n"
    *_, heated = (e["time"] for e in emulator.events("duty") if e["right"] > 0)
    assert emulator.off_after(heated) < 0.4  # it was heated for 0.3 s; silence would take 0.5 s
