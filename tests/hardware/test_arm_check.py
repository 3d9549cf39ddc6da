"""What arm-check finds."""

import io
import re
from unittest import mock

import numpy as np
import pytest
import witness  # noqa: F401 - knows the physics
from simulated_board import SimulatedBoard, SimulatedLink

from hardware import BoardLink, HardwareError, LimbTwin
from hardware.board import arm_check
from hardware.board.arm_check import check_supply, check_wires
from hardware.board.board_check import Host
from hardware.board.heat_rates import HeatRates
from limb_systems import CalibrationRecord, LimbError, LimbParameters
from soft_limb.command import main

from .virtual_time import VirtualCable


def continuum_limb() -> LimbTwin:
    return LimbTwin(seed=1, physics="continuum")


def check(limb, order=None, described=None):
    """Whether it passed, what was said of what failed, and the hottest wire, °C."""
    board = SimulatedBoard(limb, step=25)
    if order:
        board.emulation.inject_fault(order)
    board.run(1.0)
    link = SimulatedLink(board)
    failures = []
    passed = check_wires(link, lambda good, what: good or failures.append(what), described)
    assert not any(board.duty)
    return passed, failures, link.hottest


def test_arm_check_passes_a_limb_of_another_physics():
    passed, failures, hottest = check(continuum_limb())
    assert passed, failures
    assert hottest < 75.0


def test_arm_check_finds_a_thermocouple_that_shows_a_share():
    passed, failures, hottest = check(continuum_limb(), "share right 0.6")
    assert not passed
    assert "Either its thermocouple shows a share of its rise" in failures[0]
    assert hottest < 90.0


def test_the_board_ends_arm_check_where_no_heat_shows():
    with pytest.raises(LimbError, match="does not show it: it is off the wire or badly bonded"):
        check(continuum_limb(), "detach left")


def test_what_interrupts_arm_check_switches_the_wires_off():
    board = SimulatedBoard(LimbTwin(seed=1), step=25)
    board.run(1.0)
    link = SimulatedLink(board)

    def interrupted_sample():
        if any(board.duty):
            raise KeyboardInterrupt
        return SimulatedLink.next_sample(link)

    link.next_sample = interrupted_sample
    with pytest.raises(KeyboardInterrupt):
        check_wires(link, lambda good, what: None)
    assert not any(board.duty)


@pytest.mark.parametrize(
    "heat",
    [
        lambda link, limb: check_wires(link, lambda good, what: None, limb),
        lambda link, limb: Host(None, limb),
        lambda link, limb: link.arm(limb.heat_bounds),
    ],
    ids=["arm-check", "board-check", "by hand"],
)
def test_no_board_heats_a_limb_without_thermocouples(heat, virtual_time):
    limb = LimbParameters()
    limb.calibration = CalibrationRecord([], [], [], [], heat_measured=False)
    VirtualCable(virtual_time, "/dev/virtual")
    said = "was calibrated without thermocouples"
    with BoardLink("/dev/virtual", limb) as link, pytest.raises(HardwareError, match=said):
        heat(link, limb)


def test_thermocouples_are_compared_by_heat_and_by_bend():
    duty, bend = np.full((200, 2), 0.2), np.deg2rad(np.linspace(0.0, 10.0, 200))
    heatings = 2 * [(duty, np.zeros((200, 2)), bend)]
    for shown, good in ((14.0, False), (18.0, True)):
        rates = [HeatRates(heating, 0.07, 1.0) for heating in (20.0, shown)]
        said = []
        arm_check._check_likeness(
            ["left", "right"], rates, heatings, lambda ok, what: said.append((ok, what))
        )
        ((passed, what),) = said
        assert passed == good
        assert f"right thermocouple shows {shown / 20:.0%} of what the left one does" in what
        assert ("Bond the thermocouple anew" in what) != good


@pytest.mark.parametrize(
    ("shown", "good"),
    [
        ((14.4, 14.4), [False, False]),  # both: nobody can tell which is wrong
        ((14.46, 27.1), [True, True]),
        ((14.4, 20.0), [False, True]),
        ((16.1, 16.1), [True, True]),
        ((20.0, 27.2), [True, False]),
    ],
)
def test_a_verdict_on_heat_agrees_with_the_range_that_it_names(shown, good):
    """Of a described 20 °C/s, 85% of 85% to 115% over 85%."""
    said = []
    most = [LimbParameters().heat_bounds[0].most_heating] * 2
    arm_check._check_heat(["left", "right"], shown, most, lambda ok, what: said.append((ok, what)))
    assert [ok for ok, _ in said] == good
    for (ok, what), heating in zip(said, shown, strict=True):
        number = r"([\d.]+)"
        found = re.search(rf"shows {number} °C/s .* where {number} to {number} are accepted", what)
        value, low, high = map(float, found.groups())
        assert value == pytest.approx(heating, abs=0.05)
        assert ok == (low <= value <= high)


@pytest.mark.parametrize(
    ("calibrated_at", "voltage", "cut_off", "good", "said"),
    [
        (0.0, None, None, False, ["no nobody has said which voltage", "no nobody .* cut-off"]),
        (0.0, None, True, False, ["no nobody has said which voltage", "ok a thermal cut-off"]),
        (0.0, 7.0, None, False, ["ok the supply has 7 V; write supply_voltage: 7", "no nobody"]),
        (0.0, 7.0, True, True, ["ok the supply has 7 V; write supply_voltage: 7", "ok a thermal"]),
        (7.0, 9.9, True, False, ["no the supply .*: 200% of its heat, .*; set it to 7 V", "ok a"]),
        (7.0, 7.4, True, True, ["ok the supply .* 112% of its heat, where 85% to 115%", "ok a"]),
        (7.0, 7.0, False, False, ["ok the supply", "no no cut-off: only a thermal cut-off in"]),
    ],
)
def test_no_answer_about_the_supply_is_a_no(calibrated_at, voltage, cut_off, good, said):
    checks = check_supply(LimbParameters(supply_voltage=calibrated_at), voltage, cut_off)
    assert all(ok for ok, _ in checks) == good
    heard = [f"{'ok' if ok else 'no'} {what}" for ok, what in checks]
    assert len(heard) == 2
    assert all(map(re.match, said, heard)), heard


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("", "FAILED   nobody has said that a thermal cut-off is on the limb"),
        ("--supply 7", "FAILED   nobody has said that a thermal cut-off is on the limb"),
        ("--cut-off", "FAILED   nobody has said which voltage the wires' supply has"),
        ("--supply 7 --no-cut-off", "FAILED   no cut-off"),
        ("--json", '"passed": false'),
        ("--supply -7 --cut-off", "supply's voltage is -7 V; it must be from 0.1"),
        ("--supply 0", "supply's voltage is 0 V; it must be from 0.1"),
    ],
)
def test_no_port_is_opened_without_leave_to_heat(words, said, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr("soft_limb.commands.hardware.BoardLink", opened.append)
    monkeypatch.setattr("sys.stdin", io.StringIO())  # as of </dev/null
    assert main(["arm-check", "/dev/null", *words.split()]) == 1
    assert not opened
    assert said in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    ("answers", "is_opened"),
    [("7\ny\n", True), ("7\n\n", False), ("\ny\n", False), ("7\nn\n", False), ("", False)],
)
def test_a_person_at_a_terminal_has_to_answer_yes(answers, is_opened, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    opened = []

    def refuse(*_):
        opened.append(True)
        raise LimbError("there is no board")

    monkeypatch.setattr("soft_limb.commands.hardware.BoardLink", refuse)
    monkeypatch.setattr("sys.stdin", Terminal(answers))
    assert main(["arm-check", "/dev/null"]) == 1
    assert bool(opened) == is_opened


def test_nobody_is_asked_where_there_is_no_port(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", mock.Mock(isatty=lambda: True, readline=pytest.fail))
    for command in ("arm-check", "board-check"):
        assert main([command, "/dev/no_board"]) == 1
        assert "There is no port /dev/no_board" in capsys.readouterr().err
