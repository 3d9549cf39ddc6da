"""How much memory the firmware takes under MicroPython: firmware_load.py WIRES ANGLES"""

import gc
import sys


class Board:
    """A limb at rest."""

    def __init__(self, channels=2, angles=1):
        self.channels = channels
        self.angles = angles
        self.now = self.reset_cause = self.remembered = 0
        self.random = 4711
        self.serial_number = b"\0" * 8
        self.incoming = b""
        self.duty = [0.0] * channels
        self.bend = 0

    def ticks(self):
        return self.now

    def receive(self):
        data = self.incoming
        self.incoming = b""
        return data

    def read_thermocouple(self, wire):
        return b"\x01\x90\x19\x00"  # 25 °C, and 25 °C of the amplifier

    def read_bend(self):
        self.bend = (self.bend + 1) % 9
        return b"\0" + bytes((self.bend, 0)) * self.angles

    def set_duty(self, wire, duty):
        self.duty[wire] = duty

    def ignore(self, *_):
        pass

    send = keep_supply = feed = remember = ignore


def live():
    """Return the bytes in use."""
    gc.collect()
    return gc.mem_alloc()


def garbage_of_pass(board, firmware):
    """Return the bytes that a pass takes, with a sample and with a command that comes twice."""
    from hardware.firmware import from_host, heat

    guard = firmware.guard
    board.now += 50
    if guard.session is None:
        bounds = [heat.NOMINAL_BOUNDS] * board.channels
        frames = from_host.encode_arming(guard.challenge, bounds, 1.0, [0] * board.channels)
        board.incoming = b"".join(frames)
    else:
        duty = [0.01] * board.channels
        values = guard.session, guard.acknowledged + 1, board.now - 50, duty
        board.incoming = 2 * from_host.encode_command(*values)
    before = live()
    firmware.step()
    return gc.mem_alloc() - before


def main(channels, angles):
    """Print what is in use, and the most that one of 350 passes takes; 50 passes arm before."""
    before = live()
    from hardware.firmware.firmware import Firmware

    board = Board(channels, angles)
    firmware = Firmware(board)
    in_use = live() - before
    garbage = [garbage_of_pass(board, firmware) for _ in range(400)]
    assert board.duty[0] > 0
    print("with", channels, "wires a pass with a sample and two commands takes")
    print(max(garbage[50:]), "bytes; code and data are", in_use, "bytes")


main(*map(int, sys.argv[1:]))
