"""The real board file on an nRF52-DK of paper (fake_machine.py)."""

import re
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import fake_machine as fake

from hardware.firmware import firmware, readings

VERSIONS = [(1, 24), (1, 25), (1, 26), (1, 27), (1, 28)]

# Pins of the board PCA10040 that are taken (its user guide, and the port's mpconfigboard.h).
CRYSTAL, UART, NFC = {0, 1}, {5, 6, 7, 8}, {9, 10}
BUTTONS, LEDS, RESET = {13, 14, 15, 16}, {17, 18, 19, 20}, {21}


@pytest.fixture(params=VERSIONS, ids=lambda version: ".".join(map(str, version)))
def chip(request):
    return fake.wired(request.param)


@pytest.fixture
def board(chip, monkeypatch):
    return chip.load_board(monkeypatch).Board()


def index_of(chip, *event):
    """Position in the log of the first event that begins so."""
    return next(i for i, each in enumerate(chip.log) if each[: len(event)] == event)


def test_gates_are_low_before_all_else(chip, monkeypatch):
    chip.load_board(monkeypatch).Board()
    assert chip.log[:2] == [("pin", 11, 1, 0), ("pin", 12, 1, 0)]


def test_gates_are_low_as_soon_as_the_file_is_loaded(chip, monkeypatch):
    chip.load_board(monkeypatch)
    assert [chip.output(pin) for pin in (11, 12)] == [0, 0]


def test_watchdog_runs_before_anything_that_can_wait(chip, monkeypatch):
    chip.load_board(monkeypatch).Board()
    start = index_of(chip, "mem32", fake.WATCHDOG_START)
    for slow in ("spi", "i2c", "pwm"):
        assert start < index_of(chip, slow)


def test_watchdog_goes_on_in_sleep_and_in_halt(chip, board):
    registers = chip.registers
    assert registers[fake.WATCHDOG_START] == 1
    assert registers[fake.WATCHDOG_CONFIG] == 0b1001
    assert registers[fake.WATCHDOG_ENABLE] == 1
    assert (registers[fake.WATCHDOG_TICKS] + 1) / 32768 == pytest.approx(0.2, abs=1e-3)


def test_watchdog_is_fed_by_feed_alone(chip, board):
    for wire in (0, 1):
        board.set_duty(wire, 0.5)
        board.read_thermocouple(wire)
    board.read_bend()
    board.send(b"x")
    board.receive()
    board.keep_supply()
    board.remember(3)
    fed = ("mem32", fake.WATCHDOG_RELOAD, 0x6E524635)
    assert fed not in chip.log
    board.feed()
    assert chip.log.count(fed) == 1


def test_the_crystal_makes_the_clock(chip, board):
    """Of watchdog and ticks; with the watchdog running another can no longer be chosen."""
    assert chip.registers[fake.CLOCK_STATE] == 1 << 16 | 1
    assert index_of(chip, "mem32", fake.CLOCK_START) < index_of(chip, "mem32", fake.WATCHDOG_START)


def test_a_clock_that_stands_still_holds_nothing_up(chip, monkeypatch):
    """Nor a computer that does not listen then."""
    module = chip.load_board(monkeypatch)
    board = module.Board()
    chip.cts = False
    module.time.ticks_ms = module.time.ticks_us = lambda: 0
    board.send(bytes(50))
    board.receive()


def test_no_pin_has_two_tasks(chip, board):
    used = [11, 12, 3, 4, 22, 25, 23, 24, 27, 26]
    assert set(used).isdisjoint(CRYSTAL | UART | NFC | BUTTONS | LEDS | RESET)
    assert len(set(used)) == len(used)
    outputs = {event[1] for event in chip.log if event[0] == "pin"}
    assert outputs == {11, 12, 3, 4, 22}
    assert chip.log[index_of(chip, "spi")][2:] == (25, 23, 24)
    assert chip.log[index_of(chip, "i2c")][2:] == (27, 26)


def test_readme_has_the_pins(board):
    text = (fake.BOARD_FILE.parent / "README.md").read_text(encoding="utf-8")
    table = text.split("## Wiring")[1].split("\n\n")[1]
    for pin in (11, 12, 3, 4, 22, 25, 24, 27, 26):
        assert f"P0.{pin:02}" in table


@pytest.mark.parametrize(
    ("duty", "count"),
    [(0.0, 0), (1.0, 16000), (0.5, 8000), (0.25, 4000), (0.9999, 15998), (0.0001, 1)],
)
def test_duty_is_counts_of_the_pwm(chip, board, duty, count):
    board.set_duty(1, 0.1)
    board.set_duty(0, duty)
    assert chip.log[-1] == ("pwm", 11, count, 16000)
    assert chip.output(11) == count / 16000
    assert chip.output(12) == 0.1


def test_gates_can_be_taken_from_a_pwm_that_runs(chip, monkeypatch):
    module = chip.load_board(monkeypatch)
    board = module.Board()
    for wire in (0, 1):
        board.set_duty(wire, 1.0)
    module.gates_low()
    assert [chip.output(pin) for pin in (11, 12)] == [0, 0]


@pytest.mark.parametrize("fails", ["at the start", "in a step"])
def test_program_that_fails_leaves_the_gates_low(chip, monkeypatch, fails):
    module = chip.load_board(monkeypatch)

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
    assert [chip.output(pin) for pin in (11, 12)] == [0, 0]


def test_every_byte_from_the_computer_arrives(chip, board):
    assert board.receive() == b""
    chip.host_sends(b"\x03\x04~\x00\xff")
    assert board.receive() == b"\x03\x04~\x00\xff"
    assert board.receive() == b""


def test_frame_is_sent_though_nobody_waits_for_it(chip, board):
    frame = bytes(range(60))
    before = chip.now
    board.send(frame)
    assert chip.now - before < 3000
    for _ in range(4):
        board.receive()
    assert bytes(chip.uart.line) == frame


def test_computer_that_does_not_listen_holds_nothing_up(chip, board):
    chip.cts = False
    frames = [bytes((number,)) * 50 for number in range(5)]
    for frame in frames:
        before = chip.now
        board.send(frame)
        board.receive()
        assert chip.now - before < 5000
    chip.cts = True
    for _ in range(10):
        board.receive()
    assert bytes(chip.uart.line) == frames[0] + frames[1]  # whole frames, and the others dropped
    board.send(b"again")
    assert bytes(chip.uart.line).endswith(b"again")


def test_thermocouples_are_those_of_their_wires(board):
    assert readings.thermocouple(board.read_thermocouple(0)) == (100, 22 * 16, 0)
    assert readings.thermocouple(board.read_thermocouple(1)) == (104, 22 * 16, 0)
    assert readings.thermocouple(board.read_thermocouple(0)) == (100, 22 * 16, 0)


def test_bend_sensor_is_started_and_read(chip, board):
    assert chip.i2c_writes == [(fake.BEND_ADDRESS, b"\x00\x01\x00")]
    assert readings.bend(board.read_bend()) == 64


def test_bend_sensor_that_is_silent(chip, monkeypatch):
    del chip.i2c_devices[fake.BEND_ADDRESS]
    board = chip.load_board(monkeypatch).Board()
    assert board.read_bend() == b""
    chip.i2c_devices[fake.BEND_ADDRESS] = b"\x00\x40\x00"
    assert board.read_bend() == b"\x00\x40\x00"


def test_serial_number_is_the_chips_own(board):
    assert board.serial_number == 0x0123456789ABCDEF.to_bytes(8, "little")


def test_random_number_has_16_bits(board):
    assert board.random == 0x0201


def test_time_goes_on_when_the_ports_ticks_wrap(monkeypatch):
    chip = fake.wired(microseconds=(fake.WRAP - 100) * 1000)
    board = chip.load_board(monkeypatch).Board()
    times = []
    for _ in range(5):
        times.append(board.ticks())
        chip.now += 50000
    assert times == pytest.approx([0, 50, 100, 150, 200], abs=2)


def test_supply_is_held_by_changes_alone(chip, board):
    assert chip.output(22) == 0
    levels = []
    for _ in range(4):
        board.keep_supply()
        levels.append(chip.output(22))
    assert levels == [1, 0, 1, 0]


@pytest.mark.parametrize(
    ("reasons", "ram", "cause"),
    [
        (0, False, firmware.POWER_ON),
        (fake.PIN, True, firmware.PIN_RESET),
        (fake.WATCHDOG, True, firmware.WATCHDOG_RESET),
        (fake.WATCHDOG, False, firmware.WATCHDOG_RESET),
        (fake.WATCHDOG | fake.SOFT, True, firmware.WATCHDOG_RESET),
        (fake.SOFT, True, firmware.SOFT_RESET),
        (fake.LOCKUP, True, firmware.LOCKUP_RESET),
        (fake.OFF, True, firmware.UNKNOWN_RESET),
    ],
)
def test_reset_cause(chip, monkeypatch, reasons, ram, cause):
    chip.load_board(monkeypatch).Board()
    chip.reset(reasons, ram=ram)
    assert chip.load_board(monkeypatch).Board().reset_cause == cause


def test_reset_cause_is_not_that_of_an_earlier_reset(chip, monkeypatch):
    chip.reset(fake.PIN | fake.WATCHDOG, ram=True)
    chip.load_board(monkeypatch).Board()
    chip.reset(fake.SOFT, ram=True)
    assert chip.load_board(monkeypatch).Board().reset_cause == firmware.SOFT_RESET


@pytest.mark.parametrize(
    ("reasons", "retained", "ram", "remembered"),
    [
        (fake.SOFT, True, True, 16),
        (fake.SOFT, True, False, 16),
        (fake.WATCHDOG, False, True, 16),
        (0, False, False, 0),
    ],
)
def test_reason_outlasts_a_reset(chip, monkeypatch, reasons, retained, ram, remembered):
    board = chip.load_board(monkeypatch).Board()
    assert board.remembered == 0
    board.remember(16)
    assert board.remembered == 0
    chip.reset(reasons, retained=retained, ram=ram)
    board = chip.load_board(monkeypatch).Board()
    assert board.remembered == remembered
    chip.reset(reasons, retained=retained, ram=ram)  # before the program said anything
    assert chip.load_board(monkeypatch).Board().remembered == remembered


def test_reason_can_be_forgotten(chip, monkeypatch):
    chip.load_board(monkeypatch).Board().remember(16)
    chip.reset(fake.SOFT, retained=True, ram=True)
    chip.load_board(monkeypatch).Board().remember(0)
    chip.reset(fake.SOFT, retained=True, ram=True)
    assert chip.load_board(monkeypatch).Board().remembered == 0


def test_ram_after_power_up_is_no_reason(chip, monkeypatch):
    for address in fake.RAM[::4]:
        chip.registers[address] = 0xA5A5A5A5
    assert chip.load_board(monkeypatch).Board().remembered == 0


def test_the_picture_of_the_wiring_has_the_pins(chip, monkeypatch):
    module = chip.load_board(monkeypatch)
    drawn = (Path(__file__).parents[2] / "docs" / "wiring.svg").read_text(encoding="utf-8")
    names = ("heater left", "heater right", "supply", "SCK", "MISO", "CS left", "CS right")
    pins = (*module.HEATERS, module.SUPPLY, module.SCK, module.MISO, *module.CHIP_SELECTS)
    for name, pin in zip((*names, "SCL", "SDA"), (*pins, module.SCL, module.SDA), strict=True):
        assert re.search(rf">P0\.{pin:02} (\(\w+\) )?{name}<", drawn), name
