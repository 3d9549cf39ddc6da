"""The real board file on an nRF52-DK of paper (fake_machine.py), as each MicroPython has it."""

import re
import runpy
import struct
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import fake_machine as fake
from firmware_checks import PaperBoard

from hardware.board.link import SampleAssembler
from hardware.firmware import firmware, protocol, readings

VERSIONS = [(1, 24), (1, 25), (1, 26), (1, 27), (1, 28)]

# Pins of the board PCA10040 that are taken (its user guide, and the port's mpconfigboard.h).
CRYSTAL, UART, NFC = {0, 1}, {5, 6, 7, 8}, {9, 10}
BUTTONS, LEDS, RESET = {13, 14, 15, 16}, {17, 18, 19, 20}, {21}


@pytest.fixture(params=VERSIONS, ids=lambda version: ".".join(map(str, version)))
def chip(request):
    """The chip under each version, for what differs between them."""
    return fake.wired(request.param)


@pytest.fixture
def newest():
    return fake.wired(VERSIONS[-1])


def index_of(chip, *event):
    """Position in the log of the first event that begins so."""
    return next(i for i, each in enumerate(chip.log) if each[: len(event)] == event)


def test_the_board_starts_safely_and_reads_and_sends(chip, monkeypatch):
    """Gates first, then crystal and watchdog, then all that can wait."""
    module = chip.load_board(monkeypatch)
    assert chip.log[:2] == [("pin", 11, 1, 0), ("pin", 12, 1, 0)]
    assert [chip.output(pin) for pin in (11, 12)] == [0, 0]
    board = module.Board()
    start = index_of(chip, "mem32", fake.WATCHDOG_START)
    assert index_of(chip, "mem32", fake.CLOCK_START) < start
    for slow in ("spi", "i2c", "pwm"):
        assert start < index_of(chip, slow)
    registers = chip.registers
    assert registers[fake.CLOCK_STATE] == 1 << 16 | 1  # by the crystal
    # It goes on in sleep and in halt.
    assert registers[fake.WATCHDOG_START] == registers[fake.WATCHDOG_ENABLE] == 1
    assert registers[fake.WATCHDOG_CONFIG] == 0b1001
    assert (registers[fake.WATCHDOG_TICKS] + 1) / 32768 == pytest.approx(0.2, abs=1e-3)

    for _ in range(2):
        assert readings.thermocouple(board.read_thermocouple(0)) == (100, 22 * 16, 0)
        assert readings.thermocouple(board.read_thermocouple(1)) == (104, 22 * 16, 0)
    assert chip.i2c_writes == [(fake.BEND_ADDRESS, b"\x00\x01\x00")]
    assert readings.bends(board.read_bend()) == (64,)
    assert board.serial_number == 0x0123456789ABCDEF.to_bytes(8, "little")
    assert board.random == 0x0201
    assert board.receive() == b""
    chip.host_sends(b"\x03\x04~\x00\xff")
    assert board.receive() == b"\x03\x04~\x00\xff"
    assert board.receive() == b""
    assert board.remembered == 0
    assert set(vars(PaperBoard)) - set(dir(board)) <= {"pass_time", "__dict__", "__weakref__"}

    board.set_duty(1, 0.1)
    duties = {0.0: 0, 1.0: 16000, 0.5: 8000, 0.25: 4000, 0.9999: 15998, 0.0001: 1}
    for duty, count in duties.items():
        board.set_duty(0, duty)
        assert chip.log[-1] == ("pwm", 11, count, 16000)
        assert (chip.output(11), chip.output(12)) == (count / 16000, 0.1)
    for wire in (0, 1):
        board.set_duty(wire, 1.0)
    module.gates_low()  # also of a PWM that runs
    assert [chip.output(pin) for pin in (11, 12)] == [0, 0]


def test_watchdog_is_fed_by_feed_alone_and_the_supply_held_by_changes(newest, monkeypatch):
    board = newest.load_board(monkeypatch).Board()
    assert newest.output(22) == 0
    levels = []
    for _ in range(4):
        board.keep_supply()
        levels.append(newest.output(22))
    assert levels == [1, 0, 1, 0]
    for wire in (0, 1):
        board.set_duty(wire, 0.5)
        board.read_thermocouple(wire)
    board.read_bend()
    board.send(b"x")
    board.receive()
    board.remember(3)
    fed = ("mem32", fake.WATCHDOG_RELOAD, 0x6E524635)
    assert fed not in newest.log
    board.feed()
    assert newest.log.count(fed) == 1


def test_neither_a_clock_that_stands_still_nor_a_deaf_computer_holds_it_up(newest, monkeypatch):
    module = newest.load_board(monkeypatch)
    board = module.Board()
    frame = bytes(range(60))
    before = newest.now
    board.send(frame)
    assert newest.now - before < 3000
    for _ in range(4):
        board.receive()
    assert bytes(newest.uart.line) == frame

    newest.uart.line.clear()
    newest.cts = False
    frames = [bytes((number,)) * 50 for number in range(8)]
    for frame in frames:
        before = newest.now
        board.send(frame)
        board.receive()
        assert newest.now - before < 5000
    newest.cts = True
    for _ in range(30):
        board.receive()
    assert bytes(newest.uart.line) == b"".join(frames[:5])  # whole ones; the others are dropped
    board.send(b"again")
    assert bytes(newest.uart.line).endswith(b"again")

    newest.cts = False
    module.time.ticks_ms = module.time.ticks_us = lambda: 0
    board.send(bytes(50))
    board.receive()


def test_pins_are_free_and_those_of_readme_and_picture(newest, monkeypatch):
    module = newest.load_board(monkeypatch)
    module.Board()
    used = [11, 12, 3, 4, 22, 25, 23, 24, 27, 26]
    assert set(used).isdisjoint(CRYSTAL | UART | NFC | BUTTONS | LEDS | RESET)
    assert len(set(used)) == len(used)
    outputs = {event[1] for event in newest.log if event[0] == "pin"}
    assert outputs == {11, 12, 3, 4, 22}
    assert newest.log[index_of(newest, "spi")][2:] == (25, 23, 24)
    assert newest.log[index_of(newest, "i2c")][2:] == (27, 26)
    text = (fake.BOARD_FILE.parent / "README.md").read_text(encoding="utf-8")
    table = text.split("## Wiring")[1].split("\n\n")[1]
    drawn = (Path(__file__).parents[2] / "docs" / "wiring.svg").read_text(encoding="utf-8")
    names = ("heater left", "heater right", "supply", "SCK", "MISO", "CS left", "CS right")
    pins = (*module.HEATERS, module.SUPPLY, module.SCK, module.MISO, *module.CHIP_SELECTS)
    for name, pin in zip((*names, "SCL", "SDA"), (*pins, module.SCL, module.SDA), strict=True):
        assert f"P0.{pin:02}" in table
        assert re.search(rf">P0\.{pin:02} (\(\w+\) )?{name}<", drawn), name


@pytest.mark.parametrize("fails", ["at the start", "in a step"])
def test_program_that_fails_leaves_the_gates_low(newest, monkeypatch, fails):
    module = newest.load_board(monkeypatch)

    class Firmware:
        def __init__(self, board):
            board.set_duty(0, 1.0)
            board.set_duty(1, 1.0)
            if fails == "at the start":
                raise MemoryError("as any exception")

        def step(self):
            raise MemoryError("as any exception")

    monkeypatch.setitem(sys.modules, "firmware", SimpleNamespace(__path__=[]))
    monkeypatch.setitem(sys.modules, "firmware.board_nrf52dk", module)
    monkeypatch.setitem(sys.modules, "firmware.firmware", SimpleNamespace(Firmware=Firmware))
    with pytest.raises(MemoryError, match="as any exception"):
        runpy.run_path(str(fake.BOARD_FILE.with_name("main.py")))
    assert [newest.output(pin) for pin in (11, 12)] == [0, 0]


@pytest.mark.parametrize(
    ("axes", "address", "counts_per_degree", "angles"),
    [(1, 0x12, 64, [45.0]), (1, 0x12, 64, [-30.0]), (2, 0x13, 32, [45.0, -30.0])],
)
def test_the_firmware_runs_on_it_with_bend_labs_sensors(
    newest, monkeypatch, axes, address, counts_per_degree, angles
):
    """Address, frames and counts as in the maker's drivers, one_axis_ads and two_axis_ads."""
    counts = [round(counts_per_degree * angle) for angle in angles]
    newest.i2c_devices = {address: struct.pack(f"<b{axes}h", 0, *counts)}
    board = newest.load_board(monkeypatch, AXES=axes).Board()
    assert newest.i2c_writes == [(address, bytes([0, 1] + [0] * (2 * axes - 1)))]
    program = firmware.Firmware(board)
    newest.host_sends(protocol.encode(protocol.HELLO))
    for _ in range(100):
        newest.now += 2000  # us
        program.step()
    assert [newest.output(pin) for pin in (11, 12)] == [0, 0]
    parser = protocol.Parser(protocol.BOARD_KINDS)
    frames = parser.feed(bytes(newest.uart.line))
    assert parser.rejected == 0
    (info,) = [values for kind, values in frames if kind == protocol.INFO]
    assert board.serial_number in info
    assembly = SampleAssembler()
    taken = [assembly.take(*frame, 0.0) for frame in frames if frame[0] != protocol.INFO]
    samples = [sample for sample in taken if sample]
    assert 6 <= len(samples) <= 12  # in 0.2 s, each twice
    for sample in samples:
        assert np.rad2deg(sample.tip_tangent) == pytest.approx(angles, abs=1e-9)
    newest.i2c_devices[address] = struct.pack(f"<b{axes}h", 0, *[-32768] * axes)
    assert readings.bends(board.read_bend(), axes) is None
    del newest.i2c_devices[address]
    assert board.read_bend() == b""


def test_time_goes_on_when_the_ports_ticks_wrap(monkeypatch):
    chip = fake.wired(microseconds=(fake.WRAP - 100) * 1000)
    board = chip.load_board(monkeypatch).Board()
    times = []
    for _ in range(5):
        times.append(board.ticks())
        chip.now += 50000
    assert times == pytest.approx([0, 50, 100, 150, 200], abs=2)


def test_reset_cause(chip, monkeypatch):
    chip.load_board(monkeypatch).Board()
    for reasons, ram, cause in (
        (0, False, firmware.POWER_ON),
        (fake.PIN, True, firmware.PIN_RESET),
        (fake.WATCHDOG, True, firmware.WATCHDOG_RESET),
        (fake.WATCHDOG, False, firmware.WATCHDOG_RESET),
        (fake.WATCHDOG | fake.SOFT, True, firmware.WATCHDOG_RESET),
        (fake.SOFT, True, firmware.SOFT_RESET),  # not that of the reset before
        (fake.LOCKUP, True, firmware.LOCKUP_RESET),
        (fake.OFF, True, firmware.UNKNOWN_RESET),
    ):
        chip.reset(reasons, ram=ram)
        assert chip.load_board(monkeypatch).Board().reset_cause == cause, (reasons, ram)


def test_reason_outlasts_a_reset_until_it_is_forgotten(monkeypatch):
    for reasons, retained, ram, remembered in (
        (fake.SOFT, True, True, 16),
        (fake.SOFT, True, False, 16),
        (fake.WATCHDOG, False, True, 16),
        (0, False, False, 0),
    ):
        chip = fake.wired()
        board = chip.load_board(monkeypatch).Board()
        assert board.remembered == 0
        board.remember(16)
        assert board.remembered == 0
        for _ in (1, 2):  # the second time before the program said anything
            chip.reset(reasons, retained=retained, ram=ram)
            board = chip.load_board(monkeypatch).Board()
            assert board.remembered == remembered
        board.remember(0)
        chip.reset(fake.SOFT, retained=True, ram=True)
        assert chip.load_board(monkeypatch).Board().remembered == 0
    chip = fake.wired()
    for address in fake.RAM[::4]:  # after power-up it is no reason
        chip.registers[address] = 0xA5A5A5A5
    assert chip.load_board(monkeypatch).Board().remembered == 0
