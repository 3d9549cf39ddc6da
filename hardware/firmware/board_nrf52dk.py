"""The nRF52-DK (PCA10040, nRF52832) under MicroPython 1.24 to 1.28: pins and peripherals.

Pins are GPIO numbers; the README has them by their names on the board, and says which facts
of this MicroPython are worked around here. `firmware` lists the methods of a board.
"""

import machine

WIRES = 2  # up to six, of which the chip has pins here for PWM and chip selects
AXES = 1  # bend angles of each Bend Labs sensor, 1 or 2
# P0.11 to P0.16: gates of the MOSFETs of left and right, and of further wires
HEATERS = (11, 12, 13, 14, 15, 16)[:WIRES]
# P0.03, P0.04, P0.28 to P0.31: MAX31855 of left and right, and of further wires
CHIP_SELECTS = (3, 4, 28, 29, 30, 31)[:WIRES]
SUPPLY = 22  # P0.22: the charge pump that holds the relay in the wires' supply
SCK = 25  # P0.25
MOSI = 23  # P0.23; the amplifiers have no MOSI
MISO = 24  # P0.24
SCL = 27  # P0.27
SDA = 26  # P0.26
BEND_ADDRESSES = (0x12,) if AXES == 1 else (0x13,)  # as sold; the sensor at the base first
PWM_FREQUENCY = 1000  # Hz

_PWM_ENABLES = (0x4001C500, 0x40021500)  # of the devices, each of which drives four gates


def gates_low():
    """Hold all gates low, also against the PWM, which goes on without the program."""
    for pin in HEATERS:
        machine.Pin(pin, machine.Pin.OUT, value=0)
    for enable in _PWM_ENABLES[: (WIRES + 3) // 4]:
        machine.mem32[enable] = 0


gates_low()  # before the other imports, which take a while on the board

import os  # noqa: E402
import struct  # noqa: E402
import time  # noqa: E402

import micropython  # noqa: E402

from .firmware import (  # noqa: E402
    LOCKUP_RESET,
    PIN_RESET,
    POWER_ON,
    SOFT_RESET,
    UNKNOWN_RESET,
    WATCHDOG_RESET,
)

# A transfer, by the maker's drivers of both sensors: a number and 2 bytes for each angle. A count
# is 1/64 degree for one axis, and 1/32 degree for two.
_TRANSFER = 1 + 2 * AXES
_BEND_SCALE = AXES  # of a count, in 1/64 degree
_MOST_COUNTS = 32767 // _BEND_SCALE
_RUN_FREELY = b"\x00\x01" + bytes(_TRANSFER - 2)

_PERIOD = 1000000000 // PWM_FREQUENCY  # ns

# Registers for which this MicroPython has no class (product specification of the nRF52832). Their
# numbers are read as signed.
_DEVICE_ID = (0x10000060, 0x10000064)
_RESET_REASONS = 0x40000400
_RETAINED = 0x40000520  # GPREGRET2: 8 bits; bootloaders like to use GPREGRET
_WATCHDOG_START = 0x40010000
_WATCHDOG_TICKS = 0x40010504  # of 32768 Hz, less one
_WATCHDOG_ENABLE = 0x40010508
_WATCHDOG_CONFIG = 0x4001050C
_WATCHDOG_RELOAD = 0x40010600
_RELOAD_KEY = 0x6E524635
_WATCHDOG_MS = 200
_CLOCK_START = 0x40000008  # of 32768 Hz, for watchdog and ticks
_CLOCK_STOP = 0x4000000C
_CLOCK_STATE = 0x40000418  # bit 16: it runs; bits 0 and 1: its source
_CLOCK_SOURCE = 0x40000518
_CRYSTAL = 1  # the board has one; else the chip's own oscillator, which is off by up to 2%
_RUNS_BY_CRYSTAL = 1 << 16 | _CRYSTAL

# The lowest word of the stack, just above the heap: MicroPython raises an exception when some
# 400 bytes of stack are left, and clears neither stack nor heap at a reset.
_RAM = 0x2000E000
_RAM_KEY = 0x5AC396  # in the upper 24 bits; after power-up they are random

_ROOM = 128 * (1 + (WIRES + 3) // 4)  # bytes that wait to be sent: two of the longest samples
_DRAIN_PASSES = 200  # in one call, some ms, without a clock, which may stand; a byte takes 87 us


class Board:
    """The board; `firmware` lists its methods."""

    channels = WIRES
    angles = AXES * len(BEND_ADDRESSES)

    def __init__(self):
        # Start the watchdog.
        self._take_crystal()  # before the watchdog, from which on no other can be chosen
        machine.mem32[_WATCHDOG_TICKS] = _WATCHDOG_MS * 32768 // 1000 - 1
        machine.mem32[_WATCHDOG_CONFIG] = 9  # goes on in sleep and while a debugger halts the CPU
        machine.mem32[_WATCHDOG_ENABLE] = 1
        machine.mem32[_WATCHDOG_START] = 1
        # The state from before the reset, and numbers of this board and this start.
        self._recall()
        self.serial_number = b"".join(
            (machine.mem32[address] & 0xFFFFFFFF).to_bytes(4, "little") for address in _DEVICE_ID
        )
        self.random = int.from_bytes(os.urandom(2), "little")
        # Open relay, serial port, buses and PWM.
        self._supply = machine.Pin(SUPPLY, machine.Pin.OUT, value=0)
        self._supply_level = 0
        micropython.kbd_intr(-1)  # 0x03 is a byte like any other from here on
        self._uart = os.dupterm(None)  # takes it from the prompt, which would get all bytes
        self._outgoing = b""
        self._selects = [machine.Pin(pin, machine.Pin.OUT, value=1) for pin in CHIP_SELECTS]
        self._spi = machine.SPI(
            0,
            baudrate=1000000,
            sck=machine.Pin(SCK),
            mosi=machine.Pin(MOSI),
            miso=machine.Pin(MISO),
        )
        # Not the I2C 0, which is one peripheral with the SPI 0.
        self._i2c = machine.I2C(1, scl=machine.Pin(SCL), sda=machine.Pin(SDA))
        self._frame = bytearray(4)
        # Without a device, a second PWM would write past the end of a table of this MicroPython.
        self._heaters = [
            machine.PWM(
                machine.Pin(pin), freq=PWM_FREQUENCY, duty_ns=0, device=n // 4, channel=n % 4
            )
            for n, pin in enumerate(HEATERS)
        ]
        self._now = 0
        self._ticks = time.ticks_ms()
        # Start the bend sensors.
        for address in BEND_ADDRESSES:
            try:
                self._i2c.writeto(address, _RUN_FREELY)
            except OSError:
                pass  # its silence is noticed at the first sample

    def _take_crystal(self):
        if machine.mem32[_CLOCK_STATE] & 0x10003 == _RUNS_BY_CRYSTAL:
            return
        machine.mem32[_CLOCK_STOP] = 1
        for _ in range(1000):  # until it stands, and longer than its erratum 132 asks for
            pass
        machine.mem32[_CLOCK_SOURCE] = _CRYSTAL
        machine.mem32[_CLOCK_START] = 1  # some 0.3 s; until then the oscillator counts

    def _recall(self):
        """Set `remembered` and `reset_cause`."""
        # A register or a word of the RAM has the reason from before the reset.
        word = machine.mem32[_RAM]
        survived = word >> 8 == _RAM_KEY
        # The register outlasts a soft reset, but seldom a watchdog's; in practice the RAM does.
        self.remembered = machine.mem32[_RETAINED] or (word & 0xFF if survived else 0)
        self.remember(self.remembered)
        # The cause is by MicroPython, whose registers are cleared.
        self.reset_cause = {
            machine.HARD_RESET: PIN_RESET,
            machine.WDT_RESET: WATCHDOG_RESET,
            machine.SOFT_RESET: SOFT_RESET,
            machine.LOCKUP_RESET: LOCKUP_RESET,
        }.get(machine.reset_cause(), UNKNOWN_RESET)
        if self.reset_cause == PIN_RESET and not survived:
            self.reset_cause = POWER_ON  # this MicroPython has one number for both
        machine.mem32[_RESET_REASONS] = 0xFFFFFFFF  # it cleared one reason; others would stay

    def ticks(self):
        ticks = time.ticks_ms()
        self._now += time.ticks_diff(ticks, self._ticks)
        self._ticks = ticks
        return self._now

    def receive(self):
        self._drain()
        count = self._uart.any()
        return self._uart.read(count) if count else b""

    def send(self, data):
        if len(self._outgoing) + len(data) <= _ROOM:
            self._outgoing += data
        self._drain()

    def _drain(self):
        """Send waiting bytes one by one; `write` would wait for a computer that may not listen."""
        sent = 0
        for _ in range(_DRAIN_PASSES):
            if sent == len(self._outgoing):
                break
            if self._uart.txdone():
                self._uart.writechar(self._outgoing[sent])
                sent += 1
        self._outgoing = self._outgoing[sent:]

    def read_thermocouple(self, wire):
        select = self._selects[wire]
        select.value(0)
        self._spi.readinto(self._frame)
        select.value(1)
        return bytes(self._frame)

    def read_bend(self):
        data = b"\0"
        try:
            for address in BEND_ADDRESSES:
                answer = self._i2c.readfrom(address, _TRANSFER)
                if answer[0] != 0:  # no sample
                    return b""
                for count in struct.unpack(f"<{AXES}h", answer[1:]):
                    if not -_MOST_COUNTS <= count <= _MOST_COUNTS:  # no limb bends by 512 degrees
                        return b""
                    data += struct.pack("<h", _BEND_SCALE * count)
        except OSError:
            return b""
        return data

    def set_duty(self, wire, duty):
        # In ns, as a full duty_u16 is one count short of full in MicroPython 1.24.
        self._heaters[wire].duty_ns(int(_PERIOD * duty + 0.5))

    def keep_supply(self):
        self._supply_level ^= 1
        self._supply.value(self._supply_level)

    def feed(self):
        machine.mem32[_WATCHDOG_RELOAD] = _RELOAD_KEY

    def remember(self, reason):
        machine.mem32[_RETAINED] = reason
        machine.mem32[_RAM] = _RAM_KEY << 8 | reason
