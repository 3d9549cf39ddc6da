"""The sketch's own file, soft_limb.ino, on a model of Arduino and of a Teensy."""

import ctypes
import itertools
import shutil
import subprocess

import pytest

from hardware.firmware import firmware, from_host, guard, heat, protocol

from .c_firmware import COMPILER, CXX, SKETCH

LEFT, RIGHT, SUPPLY = 3, 5, 7  # pins
POWER, WATCHDOG = 1 << 0, 1 << 7  # causes of a reset

pytestmark = pytest.mark.skipif(not CXX, reason="there is no C++ compiler here")


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sketch")
    fake = f"-I{SKETCH.parents[3] / 'tests' / 'hardware' / 'fake_arduino'}"
    flags = ["-O1", "-Wall", "-Wextra", "-Werror", "-fPIC", "-c"]
    core = [COMPILER, *flags, SKETCH / "core.c", "-o", folder / "core.o"]
    subprocess.run(core, check=True)
    ino = [CXX, *flags, "-std=gnu++17", fake, "-include", "Arduino.h", "-x", "c++"]
    subprocess.run([*ino, SKETCH / "soft_limb.ino", "-o", folder / "ino.o"], check=True)
    linking = [CXX, "-shared", folder / "core.o", folder / "ino.o", "-o", folder / "sketch.so"]
    subprocess.run(linking, check=True)
    return folder / "sketch.so"


class Teensy:
    """A Teensy with the sketch on it, what is wired to it, and its host."""

    def __init__(self, compiled, why=POWER, kept=0):
        copy = compiled.with_name(f"{next(_numbers)}.so")  # whose variables are new
        self._library = ctypes.CDLL(str(shutil.copy(compiled, copy)))
        self._parser = protocol.Parser(protocol.BOARD_KINDS)
        self.frames = []
        self.set(WDOG3_CS=1 << 13, SRC_SRSR=why, SNVS_LPGPR0=kept, bend_count=3, room=64)
        self.read(25.0, 25.0)
        self.array("bend", ctypes.c_uint8)[:3] = [0, 0x40, 0xFF]
        self._library.setup()

    def set(self, **values):
        for name, value in values.items():
            ctypes.c_uint32.in_dll(self._library, name).value = value

    def get(self, name):
        return ctypes.c_uint32.in_dll(self._library, name).value

    def array(self, name, kind):
        return (kind * 32).in_dll(self._library, name)

    def read(self, left, right):
        """Lets thermocouples read temperatures, °C, in a room of 25 °C."""
        words = self.array("words", ctypes.c_uint32)
        words[9], words[10] = (int(4 * value) << 18 | 25 * 16 << 4 for value in (left, right))

    def duty(self, pin):
        """Of the timer at a pin, of 4096; None if the pin is an output, and low."""
        duty = self.array("pwm", ctypes.c_int32)[pin]
        output = self.array("mode", ctypes.c_uint8)[pin] == 1
        low = self.array("level", ctypes.c_uint8)[pin] == 0
        assert duty >= 0 or (output and low)
        return duty if duty >= 0 else None

    def send(self, data):
        start = self.get("receiving")
        received = (ctypes.c_uint8 * 65536).in_dll(self._library, "received")
        received[start : start + len(data)] = data
        self.set(receiving=start + len(data))

    def run(self, milliseconds):
        """Takes turns of the wavering bend, and what is sent; the levels of the supply's pin."""
        end, levels = self.get("now_us") + 1000 * milliseconds, []
        while self.get("now_us") < end:
            self.array("bend", ctypes.c_uint8)[1] = 0x40 + self.get("now_us") // 50000 % 5
            self._library.loop()
            levels.append(self.array("level", ctypes.c_uint8)[SUPPLY])
        sent = (ctypes.c_uint8 * 65536).in_dll(self._library, "sent")
        self.frames += self._parser.feed(bytes(sent[: self.get("sending")]))
        self.set(sending=0)
        return levels

    @property
    def sample(self):
        return [values for kind, values in self.frames if kind == protocol.SAMPLE][-1]

    @property
    def channels(self):
        return [values for kind, values in self.frames if kind == protocol.CHANNELS][-1]

    def heat(self):
        challenge, now = self.sample[2], self.sample[1]
        arming = from_host.encode_arming(challenge, [heat.NOMINAL_BOUNDS] * 2, 2.0, (16, 0))
        self.send(b"".join(arming))
        self.send(from_host.encode_command(challenge, 1, now, (0.0, 0.1)))
        return self.run(100)


_numbers = itertools.count()


def test_pins_sensors_and_port(compiled):
    board = Teensy(compiled)
    assert board.get("serial_began_well")  # the gates low, and no watchdog yet
    assert board.get("WDOG3_CS") & 1 << 7
    assert board.get("WDOG3_TOVAL") == pytest.approx(0.2 * 32768, abs=1)
    assert bytes(board.array("bend_told", ctypes.c_uint8)[:3]) == b"\x00\x01\x00"
    board.read(25.0, 25.5)
    board.send(protocol.encode(protocol.HELLO))
    assert len({*board.run(700)}) == 1  # the relay's pin stands still
    (info,) = [values for kind, values in board.frames if kind == protocol.INFO]
    assert info[3:] == (b"LIMB0001", 2, 1, firmware.POWER_ON)
    assert board._parser.rejected == 0
    assert board.sample[3:5] == (guard.DISARMED, guard.POWER_UP)
    assert -192 <= board.sample[6] <= -188
    assert board.channels[3::3] == (100, 102)
    assert board.get("WDOG3_CNT") == 0xB480A602  # it is fed
    assert (board.duty(LEFT), board.duty(RIGHT)) == (None, None)

    levels = board.heat()
    assert (board.duty(LEFT), board.duty(RIGHT)) == (None, 410)  # 0.1 of 4096
    changes = sum(before != after for before, after in itertools.pairwise(levels))
    assert 90 <= changes <= 101  # each ms of 100
    board.run(200)
    assert board.duty(RIGHT) is None
    assert board.sample[4] == guard.NO_COMMAND


def test_a_host_that_floods_or_does_not_listen_holds_nothing_up(compiled):
    board = Teensy(compiled)
    board.run(600)
    board.set(room=0)
    board.run(500)
    assert board.frames[-1][1][1] < 620  # ms; nothing was sent since
    board.set(room=64)
    board.run(200)
    assert board.sample[1] >= board.get("now_us") // 1000 - 60
    board.heat()
    assert board.duty(RIGHT) == 410
    board.send(b"\x55" * 60000)
    board.run(100)
    assert 0 < board.get("taken") < 55000
    assert board.sample[1] >= board.get("now_us") // 1000 - 60


def test_a_fault_outlives_a_reset_and_causes_are_told_apart(compiled):
    board = Teensy(compiled)
    board.run(600)
    first = board.sample[2]
    board.set(bend_count=0)
    board.run(100)
    assert board.sample[4] == guard.BEND_SILENT
    kept = board.get("SNVS_LPGPR0")
    again = Teensy(compiled, POWER, kept)  # by the loader's chip: the word is still there
    again.run(100)
    assert again.sample[4] == guard.BEND_SILENT
    assert again.sample[2] != first  # the challenge
    for why, word, reason in (
        (WATCHDOG, kept & ~0xFF, guard.RESTARTED),
        (POWER, kept & ~0xFF, guard.WAS_RESET),
        (POWER, 0x1234_0016, guard.POWER_UP),
    ):
        board = Teensy(compiled, why, word)
        board.run(100)
        assert board.sample[4] == reason
