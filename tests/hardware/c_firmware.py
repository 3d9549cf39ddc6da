"""The sketch's core, hardware/firmware/arduino/soft_limb/core.c, in place of `Firmware`."""

import ctypes
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

from hardware.firmware.firmware import Firmware

SKETCH = Path(__file__).parents[2] / "hardware" / "firmware" / "arduino" / "soft_limb"
COMPILER = shutil.which("cc") or shutil.which("gcc")
CXX = COMPILER and (shutil.which("c++") or shutil.which("g++"))

INSIDE = r"""
#include "core.h"
int firmware_size(void) { return sizeof(struct firmware); }
void prove(struct firmware *f, const uint8_t *proven)
{
    for (int i = 0; i < CHANNELS; i++)
        f->guard.channel[i].proven = proven[i];
}
void guard_of(const struct firmware *f, uint16_t *values)
{
    values[0] = f->guard.state, values[1] = f->guard.session, values[2] = f->guard.challenge;
}
"""

_Bytes = ctypes.POINTER(ctypes.c_uint8)


def compile_core(folder, real="float"):
    """The class of the core's firmware, for numbers that are float or double."""
    options = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Wdouble-promotion", "-Werror"]
    (folder / "inside.c").write_text(INSIDE)
    output = folder / f"core_{real}.so"
    subprocess.run(
        [COMPILER, *options, f"-DREAL={real}", "-ffp-contract=off", "-shared", "-fPIC",
         f"-I{SKETCH}", "-o", output, SKETCH / "core.c", folder / "inside.c"],
        check=True,
    )  # fmt: skip
    library = ctypes.CDLL(str(output))
    number = {"float": ctypes.c_float, "double": ctypes.c_double}[real]
    functions = {
        "ticks": (ctypes.c_uint32,),
        "receive": (ctypes.c_int, _Bytes, ctypes.c_int),
        "send": (None, _Bytes, ctypes.c_int),
        "read_thermocouple": (ctypes.c_uint32, ctypes.c_int),
        "read_bend": (ctypes.c_int, _Bytes),
        "set_duty": (None, ctypes.c_int, number),
        "keep_supply": (None,),
        "feed": (None,),
        "remember": (None, ctypes.c_uint8),
    }
    types = {name: ctypes.CFUNCTYPE(*signature) for name, signature in functions.items()}

    class Board(ctypes.Structure):
        _fields_ = [
            *types.items(),
            ("reset_cause", ctypes.c_uint8),
            ("remembered", ctypes.c_uint8),
            ("random", ctypes.c_uint16),
            ("serial_number", ctypes.c_uint8 * 8),
        ]

    class CFirmware:
        """The core on a board in Python; see `firmware` for what a board is."""

        def __init__(self, board):
            self._board, self._waiting = board, b""
            calls = [kind(getattr(self, f"_{name}", getattr(board, name, None)))
                     for name, kind in types.items()]  # fmt: skip
            serial_number = (ctypes.c_uint8 * 8)(*board.serial_number)
            self._struct = Board(
                *calls, board.reset_cause, board.remembered, board.random, serial_number
            )
            self._firmware = ctypes.create_string_buffer(library.firmware_size())
            library.start_firmware(self._firmware, ctypes.byref(self._struct))

        def prove(self, proven):
            """Has thermocouples followed some heat, as tests ask for it."""
            library.prove(self._firmware, bytes(proven))

        @property
        def guard(self):
            """State, session and challenge of the guard, which a host is told of."""
            values = (ctypes.c_uint16 * 3)()
            library.guard_of(self._firmware, values)
            return SimpleNamespace(state=values[0], session=values[1], challenge=values[2])

        def step(self):
            self._waiting = None
            library.step_firmware(self._firmware)

        def _ticks(self):
            return self._board.ticks() & 0xFFFFFFFF

        def _receive(self, data, room):
            if self._waiting is None:
                self._waiting = self._board.receive()
            some, self._waiting = self._waiting[:room], self._waiting[room:]
            ctypes.memmove(data, some, len(some))
            return len(some)

        def _send(self, data, size):
            self._board.send(ctypes.string_at(data, size))

        def _read_thermocouple(self, wire):
            return int.from_bytes(self._board.read_thermocouple(wire), "big")

        def _read_bend(self, data):
            answer = self._board.read_bend()
            ctypes.memmove(data, answer, len(answer))
            return len(answer)

    return CFirmware


# What a board that starts tells its firmware.
FACTS = ("channels", "angles", "reset_cause", "remembered", "random", "serial_number")


class Recorder:
    """A board that notes each call of it, with its arguments and what came of it."""

    def __init__(self, board):
        self._board, self.calls = board, []
        self.facts = {name: getattr(board, name) for name in FACTS}

    def __getattr__(self, name):
        if name in self.facts:
            return self.facts[name]

        def call(*arguments):
            self.calls.append((name, arguments, getattr(self._board, name)(*arguments)))
            return self.calls[-1][2]

        return call


class Player:
    """A board that answers each call as a recorder did, and notes those that differ."""

    def __init__(self, recorder):
        self._recorder, self.differences = recorder, []

    def __getattr__(self, name):
        if name in self._recorder.facts:
            return self._recorder.facts[name]

        def call(*arguments):
            calls = self._recorder.calls
            *expected, result = calls.pop(0) if calls else (None, None, None)
            if [name, arguments] != expected:
                self.differences.append(((name, *arguments), expected))
            return result

        return call


def make_both(c_firmware):
    """A program that is both firmwares: the core must call its board as Python does."""

    class Both(Firmware):
        def __init__(self, board):
            self.recorder = Recorder(board)
            super().__init__(self.recorder)
            self.player = Player(self.recorder)
            self.core = c_firmware(self.player)
            self.compare()

        def step(self):
            self.core.prove(self.guard.proven)  # or not, as a test may have set it
            super().step()
            self.core.step()
            self.compare()

        def compare(self):
            assert self.player.differences == []
            assert self.recorder.calls == []

    return Both
