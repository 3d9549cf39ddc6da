"""Boards in simulated time that obey orders, for a host's `Bench`: on paper, and emulated."""

import random
import struct

from hardware.board.link import pulls_of
from hardware.emulation.emulator import Emulation
from hardware.firmware import firmware
from hardware.firmware.firmware import Firmware
from limb_systems import LimbModel, LimbParameters

from .conftest import small_twin
from .firmware_checks import ROOM, PaperBoard

STEP = 10  # ms, of the loop
WATCHDOG = 200  # ms


class PaperRobot(PaperBoard):
    """A board on paper that obeys the orders of `soft-limb emulate`, and the host's cable to it."""

    def __init__(self, program=Firmware, limb=None):
        limb = limb or LimbParameters()
        super().__init__(pulls=pulls_of(limb), angles=LimbModel.of(limb).layout.num_bends)
        self._names = limb.wire_names
        self._random = random.Random(0)
        self.program = program
        self.ask("mend")
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

    def ask(self, order, by_hand=""):
        """Obeys an order."""
        name, *words = order.split()
        wire = self._names.index(words[0]) if words and words[0] in self._names else 0
        match name:
            case "mend":
                self.faults, self.words, self.errors = (
                    [what] * self.channels for what in (0, None, 0.0)
                )
                self.bad_frames = [0] * self.channels
                self.drift = self.drifted = 0.0
                self.detached, self.silent, self.bends = False, False, None
                self.hung, self.stopped = 0, None
            case "open" | "ground" | "supply":
                self.faults[wire] = {"open": 1, "ground": 2, "supply": 4}[name]
            case "glitch":
                self.bad_frames[wire] = int(words[1])
            case "dead" | "garbled":
                self.words[wire] = {"dead": 0, "garbled": 8}[name]
            case "offset":
                self.errors[wire] = float(words[1])
            case "drift":
                self.drift = float(words[1])
            case "detach":
                self.detached = True
            case "silence":
                self.silent = True
            case "freeze" if words == ["bend"]:
                self.bends = lambda: 77
            case "freeze":
                (self.words[wire],) = struct.unpack(">I", self.read_thermocouple(wire))
            case "stick":
                angle = 64 * int(words[1]) if len(words) > 1 else 0
                self.bends = lambda: angle + self._random.randrange(5)
            case "stop":
                self.stopped = self.now
            case "stall":
                self.hung = 1000 * float(words[0])
            case _:
                assert name == "reset"
                self.reset(firmware.PIN_RESET)
        return True

    # The board.

    def ticks(self):
        return self.now if self.stopped is None else self.stopped

    def feed(self):
        self.fed = self.ticks()

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


class PaperCable:
    """The host's end of the cable to a board on paper."""

    def __init__(self, robot):
        self.robot, self.wait, self.ask = robot, robot.wait, robot.ask

    def send(self, data):
        self.robot.incoming += data

    def receive(self):
        data = b"".join(self.robot.sent)
        self.robot.sent.clear()
        return data

    def now(self):
        return self.robot.now / 1000


class EmulatedCable:
    """Both ends of the cable to an emulated board, in simulated time."""

    def __init__(self):
        self.milliseconds = 0
        self.to_board, self.to_host = b"", b""
        self.emulation = Emulation(small_twin(seed=1), self, clock=self.now)

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
        self.emulation.inject_fault(order)
        return True
