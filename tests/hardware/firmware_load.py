"""How much time and memory the firmware takes under MicroPython: firmware_load.py WIRES ANGLES"""

import gc
import sys
import time


class Board:
    """A limb at rest."""

    def __init__(self, channels=2, angles=1):
        self.channels, self.angles = channels, angles
        self.now, self.random, self.reset_cause, self.remembered = 0, 4711, 0, 0
        self.serial_number, self.incoming = b"\0" * 8, b""
        self.duty, self.bend = [0.0] * channels, 0

    def ticks(self):
        return self.now

    def receive(self):
        data, self.incoming = self.incoming, b""
        return data

    def read_thermocouple(self, wire):
        return b"\x01\x90\x19\x00"  # 25 °C, and 25 °C of the amplifier

    def read_bend(self):
        self.bend = (self.bend + 1) % 9
        return b"\0" + bytes((self.bend, 0)) * self.angles

    def set_duty(self, wire, duty):
        self.duty[wire] = duty

    def send(self, data):
        pass

    def keep_supply(self):
        pass

    def feed(self):
        pass

    def remember(self, reason):
        pass


class Load:
    """A firmware that is armed and commanded, a pass at a time."""

    def __init__(self, board, firmware):
        from hardware.firmware import from_host, heat

        self._from_host, self._bounds = from_host, [heat.NOMINAL_BOUNDS] * board.channels
        self._board, self._firmware = board, firmware
        self._number = self._time = self._longest = self._garbage = 0

    def run(self):
        """One pass, with a sample and with a command that comes twice."""
        board, guard, said = self._board, self._firmware.guard, self._from_host
        board.now += 50
        self._number += 1
        if guard.session is None:
            values = guard.challenge, self._bounds, 1.0, [0] * board.channels
            board.incoming = b"".join(said.encode_arming(*values))
        else:
            duty = [0.01] * board.channels
            values = guard.session, guard.acknowledged + 1, board.now - 50, duty
            board.incoming = 2 * said.encode_command(*values)
        before, start = gc.mem_alloc(), time.ticks_us()
        self._firmware.step()
        taken, garbage = time.ticks_diff(time.ticks_us(), start), gc.mem_alloc() - before
        if self._number > 50:
            self._time += taken
            self._garbage = max(self._garbage, garbage)

    def tell(self, in_use):
        """Prints wires, the mean time and the most memory of a pass, and what is in use."""
        assert self._board.duty[0] > 0
        mean = self._time // (self._number - 50)
        print("with", self._board.channels, "wires")
        print("a pass with a sample and two commands takes", mean, "us and", self._garbage, "bytes")
        print("code and data are", in_use, "bytes")


def live():
    """Bytes in use."""
    gc.collect()
    return gc.mem_alloc()


def main(channels, angles):
    """Runs 400 passes; garbage is collected between them."""
    before = live()
    from hardware.firmware.firmware import Firmware

    board = Board(channels, angles)
    firmware = Firmware(board)
    in_use = live() - before
    load = Load(board, firmware)
    for _ in range(400):
        live()
        load.run()
    load.tell(in_use)


main(*map(int, sys.argv[1:]))
