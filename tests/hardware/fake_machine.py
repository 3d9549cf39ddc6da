"""An nRF52-DK of paper, with the modules that MicroPython's nrf port has there.

It does what the port's sources do in 1.24 to 1.28, with their faults: what would hang the real
board or destroy its memory raises AssertionError here. It is a model of those sources and of
the chip's product specification, not of a board that was measured.
"""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

BOARD_FILE = Path(__file__).parents[2] / "hardware" / "firmware" / "board_nrf52dk.py"

# Bits of RESETREAS.
PIN, WATCHDOG, SOFT, LOCKUP, OFF = 1 << 0, 1 << 1, 1 << 2, 1 << 3, 1 << 16

DEVICE_ID = (0x10000060, 0x10000064)
RESET_REASONS, GPREGRET, GPREGRET2 = 0x40000400, 0x4000051C, 0x40000520
WATCHDOG_START, WATCHDOG_RELOAD = 0x40010000, 0x40010600
WATCHDOG_TICKS, WATCHDOG_ENABLE, WATCHDOG_CONFIG = 0x40010504, 0x40010508, 0x4001050C
PWM_ENABLE = (0x4001C500, 0x40021500, 0x40022500)
RAM = range(0x20000000, 0x20010000)

CLOCK_START, CLOCK_STOP = 0x40000008, 0x4000000C
CLOCK_STATE, CLOCK_SOURCE = 0x40000418, 0x40000518
BEND_ADDRESS, TWO_AXIS_ADDRESS = 0x12, 0x13  # of Bend Labs' sensors

BYTE_TIME = 87  # us on the line
WRAP = 1 << 30  # of the port's ticks


class Chip:
    """The chip, the board around it and the interpreter in it.

    ``log`` has what the program did to the pins, registers and peripherals, in order.
    """

    def __init__(self, version=(1, 28), microseconds=0):
        """microseconds: of the clock at power-up."""
        self.version = version
        self.now = microseconds
        self.registers = dict(zip(DEVICE_ID, (0x89ABCDEF, 0x01234567), strict=True))
        self.thermocouples = {}  # bytes of the amplifier at each chip select
        self.i2c_devices = {}  # bytes that each address reads
        self.cts = True
        self.reset(0)

    def reset(self, reasons, *, retained=False, ram=False):
        """Starts anew for RESETREAS bits; 0 is a power-up.

        retained: whether the registers GPREGRET outlast it; ram: whether the RAM does.
        """
        kept = {
            address: value
            for address, value in self.registers.items()
            if address in DEVICE_ID
            or (address in RAM and ram)
            or (address in (GPREGRET, GPREGRET2) and retained)
            or (address == RESET_REASONS and reasons)
        }
        self.registers = kept
        self.registers[RESET_REASONS] = kept.get(RESET_REASONS, 0) | reasons
        self.registers[CLOCK_STATE] = 1 << 16  # the port has started it, by the chip's oscillator
        self.log = []
        self.levels = {}  # of the pins that are outputs
        self.owners = {0: None, 1: None, 2: None}  # of the peripherals that SPI and I2C share
        self.pwm = [PwmDevice() for _ in PWM_ENABLE]
        self.interrupt_character = 3
        self.i2c_writes = []
        self.uart = Uart(self)
        self.terminal = self.uart
        self.reset_cause = self._take_reset_cause()

    def _take_reset_cause(self):
        """As the port does: one number for no reason and for the pin; clears one reason alone."""
        reasons = self.registers[RESET_REASONS]
        cause = next((bit for bit in (0, 1, 2, 3, 16, 17, 18, 19) if reasons >> bit & 1), 0)
        self.registers[RESET_REASONS] &= ~(1 << cause)
        return cause

    def output(self, pin):
        """Mean level of an output, in [0, 1]; None of a pin that floats."""
        for device, enable in zip(self.pwm, PWM_ENABLE, strict=True):
            for channel, owner in device.pins.items():
                if owner == pin and self.registers.get(enable, 0) and channel in device.counts:
                    return min(1.0, device.counts[channel] / device.top)
        return self.levels.get(pin)

    def host_sends(self, data):
        """Bytes from the computer: to the prompt, or to the program."""
        for byte in data:
            prompt = self.terminal is not None and self.version >= (1, 26)
            if byte == self.interrupt_character and (prompt or self.version < (1, 26)):
                raise KeyboardInterrupt
            if not prompt and len(self.uart.incoming) < 63:
                self.uart.incoming.append(byte)

    def load_board(self, monkeypatch, **settings):
        """The board file as a new module, as at each start of the board.

        settings: constants at its top, as an owner of the board changes them.
        """
        modules = {
            "machine": machine_module(self),
            "micropython": SimpleNamespace(kbd_intr=self._set_interrupt_character),
        }
        for name, module in modules.items():
            monkeypatch.setitem(sys.modules, name, module)
        spec = importlib.util.spec_from_file_location("hardware.firmware.board_nrf52dk", BOARD_FILE)
        board = importlib.util.module_from_spec(spec)
        source = BOARD_FILE.read_text(encoding="utf-8")
        for name, value in settings.items():
            source, count = re.subn(rf"(?m)^{name} = \S+", f"{name} = {value}", source)
            assert count == 1, name
        exec(compile(source, BOARD_FILE, "exec"), vars(board))
        # CPython's own have none of what the port's have; nothing of them is used at the import.
        board.os = SimpleNamespace(urandom=lambda n: bytes(range(1, n + 1)), dupterm=self._dupterm)
        board.time = SimpleNamespace(
            ticks_ms=lambda: self._pass_time() // 1000 % WRAP,
            ticks_us=lambda: self._pass_time() % WRAP,
            ticks_diff=lambda end, start: (end - start + WRAP // 2) % WRAP - WRAP // 2,
        )
        return board

    def _pass_time(self):
        self.now += 10
        return self.now

    def _set_interrupt_character(self, character):
        self.interrupt_character = character

    def _dupterm(self, terminal):
        previous, self.terminal = self.terminal, terminal
        return previous


class Memory:
    """machine.mem32, which reads signed numbers."""

    def __init__(self, chip):
        self._chip = chip

    def __getitem__(self, address):
        assert address % 4 == 0
        value = self._chip.registers.get(address, 0)
        return value - (1 << 32) if value >> 31 else value

    def __setitem__(self, address, value):
        assert address % 4 == 0
        registers, value = self._chip.registers, value & 0xFFFFFFFF
        self._chip.log.append(("mem32", address, value))
        locked = (WATCHDOG_TICKS, WATCHDOG_ENABLE, WATCHDOG_CONFIG)  # while the watchdog runs
        if address in locked and registers.get(WATCHDOG_START):
            return
        if address in (CLOCK_START, CLOCK_STOP):  # the watchdog keeps it going
            running = address == CLOCK_START or registers.get(WATCHDOG_START, 0)
            source = registers.get(CLOCK_SOURCE, 0)
            registers[CLOCK_STATE] = running << 16 | source
        if address == RESET_REASONS:
            value = registers.get(address, 0) & ~value
        elif address in (GPREGRET, GPREGRET2):
            value &= 0xFF
        registers[address] = value


class Pin:
    """machine.Pin; without a mode it names the pin and changes nothing."""

    IN, OUT = 0, 1
    chip: Chip

    def __init__(self, number, mode=None, value=None):
        self.number = number
        if mode is not None:
            self.chip.log.append(("pin", number, mode, value))
            if mode == self.OUT:
                self.chip.levels[number] = value or 0

    def value(self, level):
        self.chip.log.append(("level", self.number, level))
        assert self.number in self.chip.levels, "not an output"
        self.chip.levels[self.number] = int(bool(level))


class PwmDevice:
    """One of the chip's PWMs: four channels of one frequency."""

    def __init__(self):
        self.free = True
        self.top = None
        self.pins = {}
        self.counts = {}


class Pwm:
    """machine.PWM."""

    chip: Chip

    def __init__(self, pin, freq=None, duty_u16=None, duty_ns=None, device=None, channel=0):
        if device is None:
            frees = [index for index, each in enumerate(self.chip.pwm) if each.free]
            if not frees:
                raise ValueError("all PWM devices in use")
            device, channel = frees[0], 0
        entry = 4 * device + channel
        # The port takes this number of a channel for one of a device.
        assert entry < len(self.chip.pwm), "writes past the end of the port's table"
        self.chip.pwm[entry].free = False
        self._device, self._channel = self.chip.pwm[device], channel
        self._device.free = False
        self._device.pins[channel] = pin.number
        self._enable = PWM_ENABLE[device]
        if freq is not None:
            divider = next(d for d in range(8) if 16000000 // (1 << d) // freq < 32768)
            self._clock = 16000000 // (1 << divider)
            self._device.top = self._clock // freq
        if duty_u16 is not None:
            self.duty_u16(duty_u16)
        if duty_ns is not None:
            self.duty_ns(duty_ns)

    def duty_u16(self, duty):
        full = 65536 if self.chip.version < (1, 25) else 65535
        self._start(self._device.top * duty // full)

    def duty_ns(self, duty):
        self._start(duty * self._clock // 1000000000)

    def _start(self, count):
        assert isinstance(count, int)
        self._device.counts[self._channel] = count
        self.chip.log.append(("pwm", self._device.pins[self._channel], count, self._device.top))
        self.chip.registers[self._enable] = 1


class Spi:
    """machine.SPI. Quietly does nothing if an I2C has its peripheral, and then hangs."""

    chip: Chip

    def __init__(self, number, baudrate=1000000, *, sck, mosi, miso):
        self._number = number
        if self.chip.owners[number] is None:
            self.chip.owners[number] = self
        self.chip.log.append(("spi", number, sck.number, mosi.number, miso.number))

    def readinto(self, buffer):
        assert self.chip.owners[self._number] is self, "would hang: the I2C has this peripheral"
        low = [pin for pin in self.chip.thermocouples if self.chip.levels.get(pin) == 0]
        assert len(low) == 1, "one amplifier must be selected"
        buffer[:] = self.chip.thermocouples[low[0]]


class I2c:
    """machine.I2C. Takes its peripheral from an SPI that has it."""

    chip: Chip

    def __init__(self, number, *, scl, sda):
        self._number = number
        assert number in (0, 1), "I2C doesn't exist"
        self.chip.owners[number] = self
        self.chip.log.append(("i2c", number, scl.number, sda.number))

    def _check(self, address):
        assert self.chip.owners[self._number] is self, "would hang: the SPI has this peripheral"
        if address not in self.chip.i2c_devices:
            raise OSError(19, "ENODEV")

    def writeto(self, address, data):
        self._check(address)
        frame = self.chip.i2c_devices[address]
        assert len(data) == len(frame), "the sensor takes frames as long as those it sends"
        self.chip.i2c_writes.append((address, data))

    def readfrom(self, address, count):
        self._check(address)
        frame = self.chip.i2c_devices[address]
        assert count == len(frame), "would read a part of a frame, or past its end"
        return frame


class Uart:
    """The one machine.UART of the chip, at 115200 baud, with RTS and CTS."""

    def __init__(self, chip):
        self._chip = chip
        self.incoming = bytearray()
        self.line = bytearray()  # what the computer received
        self._last = None  # time at which the byte that is being sent is out

    def any(self):
        return len(self.incoming)

    def read(self, count):
        assert count <= len(self.incoming), "would block"
        data = bytes(self.incoming[:count])
        del self.incoming[:count]
        return data or None

    def txdone(self):
        self._chip.now += 10
        if self._last is not None and self._chip.cts and self._chip.now >= self._last:
            self._last = None
        return self._last is None

    def writechar(self, byte):
        assert self.txdone(), "would block"
        self.line.append(byte)
        self._last = self._chip.now + BYTE_TIME

    def write(self, data):
        assert self._chip.cts, "would block"
        self.line += data
        self._chip.now += BYTE_TIME * len(data)


def machine_module(chip):
    """The module `machine` on a chip."""
    module = ModuleType("machine")
    for name, base in {"Pin": Pin, "PWM": Pwm, "SPI": Spi, "I2C": I2c}.items():
        setattr(module, name, type(name, (base,), {"chip": chip}))
    module.UART = lambda number, baudrate: chip.uart
    module.mem32 = Memory(chip)
    module.unique_id = lambda: b""
    module.reset_cause = lambda: chip.reset_cause
    module.HARD_RESET, module.WDT_RESET, module.SOFT_RESET, module.LOCKUP_RESET = 0, 1, 2, 3
    return module


def wired(version=(1, 28), **arguments):
    """A chip with the sensors of the wiring table; the wires have 25 and 26 °C."""
    chip = Chip(version, **arguments)
    for celsius, pin in ((25, 3), (26, 4)):
        chip.thermocouples[pin] = (celsius << 20 | 22 << 8).to_bytes(4, "big")
    chip.i2c_devices[BEND_ADDRESS] = b"\x00\x40\x00"
    return chip
