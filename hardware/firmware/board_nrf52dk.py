"""The nRF52-DK under MicroPython (board PCA10040, 1.24 or later): pins and peripherals.

Pins are GPIO numbers; the README has them by their names on the board.
"""

import os
import time

import machine
import micropython

HEATERS = (11, 12)  # P0.11, P0.12: gates of the MOSFETs of left and right
CHIP_SELECTS = (13, 14)  # P0.13, P0.14: MAX31855 of left and right
SCK, MOSI, MISO = 25, 23, 24  # P0.25, P0.23, P0.24; the amplifiers have no MOSI
SCL, SDA = 27, 26  # P0.27, P0.26
BEND_ADDRESS = 0x12
PWM_FREQUENCY = 1000  # Hz

# Registers of the nRF52832's watchdog (product specification, chapter 44), for which this
# MicroPython has no class. It resets the board, and a board in reset heats nothing.
_WATCHDOG = 0x40010000
_START, _RELOAD_VALUE, _ENABLE, _CONFIG, _RELOAD = 0x000, 0x504, 0x508, 0x50C, 0x600
_RELOAD_KEY = 0x6E524635
_WATCHDOG_MS = 200


class Board:
    """See `firmware` for what a board is."""

    def __init__(self):
        micropython.kbd_intr(-1)  # 0x03 is a byte like any other from here on
        self._heaters = [
            machine.PWM(machine.Pin(pin), freq=PWM_FREQUENCY, duty_u16=0) for pin in HEATERS
        ]
        self._selects = [machine.Pin(pin, machine.Pin.OUT, value=1) for pin in CHIP_SELECTS]
        self._spi = machine.SPI(
            0,
            baudrate=1000000,
            sck=machine.Pin(SCK),
            mosi=machine.Pin(MOSI),
            miso=machine.Pin(MISO),
        )
        self._i2c = machine.I2C(0, scl=machine.Pin(SCL), sda=machine.Pin(SDA))
        self._uart = machine.UART(0, 115200)
        self._frame = bytearray(4)
        self._now = 0
        self._ticks = time.ticks_ms()
        self.serial_number = machine.unique_id()[:8]
        self.random = int.from_bytes(os.urandom(2), "little")
        try:
            self._i2c.writeto(BEND_ADDRESS, b"\x00\x01\x00")  # run freely
        except OSError:
            pass  # its silence is noticed at the first sample
        machine.mem32[_WATCHDOG + _RELOAD_VALUE] = _WATCHDOG_MS * 32768 // 1000
        machine.mem32[_WATCHDOG + _CONFIG] = 1  # goes on in sleep
        machine.mem32[_WATCHDOG + _ENABLE] = 1
        machine.mem32[_WATCHDOG + _START] = 1

    def ticks(self):
        ticks = time.ticks_ms()
        self._now += time.ticks_diff(ticks, self._ticks)
        self._ticks = ticks
        return self._now

    def receive(self):
        return self._uart.read(self._uart.any()) or b"" if self._uart.any() else b""

    def send(self, data):
        self._uart.write(data)

    def read_thermocouple(self, wire):
        select = self._selects[wire]
        select.value(0)
        self._spi.readinto(self._frame)
        select.value(1)
        return bytes(self._frame)

    def read_bend(self):
        try:
            return self._i2c.readfrom(BEND_ADDRESS, 3)
        except OSError:
            return b""

    def set_duty(self, wire, duty):
        self._heaters[wire].duty_u16(int(65535 * duty))

    def feed(self):
        machine.mem32[_WATCHDOG + _RELOAD] = _RELOAD_KEY
