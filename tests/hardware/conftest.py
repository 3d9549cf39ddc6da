"""Emulated boards: along a clock that they share with the host, and in a process of their own.

The process is shared by the tests of a file, as it takes seconds to start, and as new for each.
"""

import dataclasses
import json
import random
import re
import struct
import subprocess
import sys
import time
import zlib

import numpy as np
import pytest
import simulated_board

from hardware import HardwareError, LimbTwin
from hardware.emulation.emulator import Emulation
from hardware.firmware import protocol
from hardware.firmware.firmware import Firmware
from limb_systems import LimbParameters, SegmentParameters

from .c_firmware import COMPILER, compile_core, make_both
from .virtual_time import VirtualCable, VirtualTime

BOUNDS = LimbParameters().heat_bounds
# What a host says that was late, or was stopped for a while, or a board that went off by that.
LATE = (
    "no valid command came for 250 ms",
    "The simulation fell behind by",
    "Nothing new came from the board",
    "was not ready for more data within",
    r"come 0\.\d+ s late",
    "did not get a command within",
    "this program sent no duty for 250 ms",
)
MOST_STARTS = 50
SETTLING_TIME = 0.6  # s, of a board that was switched on, before it can be armed


def small_limb() -> LimbParameters:
    """Return a limb that bends as the nominal one, and is simulated in less time."""
    return LimbParameters(segments=[SegmentParameters(links=2, stiffness=0.0623)])


def small_twin(seed=0, **options) -> LimbTwin:
    """Return an emulated limb like `small_limb`."""
    return LimbTwin(small_limb(), seed=seed, **options)


def beginning(trajectory, num_knots):
    """Return the first knots of a trajectory."""
    signals = ("time", "reference", "duty", "joint_state", "wire_temperature")
    signals = {name: getattr(trajectory, name) for name in (*signals, "measured_temperature")}
    parts = {name: signal[..., :num_knots] for name, signal in signals.items()}
    return dataclasses.replace(trajectory, **parts)


@pytest.fixture(autouse=True)
def fast_checksum(monkeypatch):
    """Let CPython calculate the checksum; firmware_checks.py tests the firmware's own."""
    monkeypatch.setattr(protocol, "crc32", lambda data: struct.pack("<I", zlib.crc32(data)))


class Board:
    """What happens to an emulated board."""

    port: str

    def events(self, kind):
        raise NotImplementedError

    def wait_for(self, condition, limit):
        raise NotImplementedError

    def duty(self):
        return [self.events("duty")[-1][side] for side in ("left", "right")]

    def off_after(self, since, limit=3.0) -> float:
        """s from a time until both wires were off."""

        def off():
            late = [e for e in self.events("duty") if e["time"] >= since - 1e-3]
            return next((e["time"] for e in late if e["left"] == e["right"] == 0.0), None)

        assert self.wait_for(lambda: off() is not None, limit), self.events("duty")[-3:]
        return off() - since


class VirtualBoard(Board):
    """An emulated board along a `VirtualTime`, at a port that programs of this process may open."""

    def __init__(self, time, port="/dev/virtual", twin=None):
        self._events = []
        cable = VirtualCable(time, port)
        note = lambda **event: self._events.append(event)  # noqa: E731
        cable.board = self._board = Emulation(twin or LimbTwin(), cable, note, time.monotonic)
        self.port, self._time, self.wait_for = port, time, time.wait_for
        self.order("restart")

    def events(self, kind):
        return [event for event in self._events if event["event"] == kind]

    def order(self, text) -> float:
        """Gives an order, which is obeyed at once; the time, s."""
        self._board.inject_fault(text)
        return self._time.monotonic()


class Emulator(Board):
    """``soft-limb emulate``, with its log, in real time."""

    def __init__(self, folder, *options):
        self.log = folder / f"log_{time.monotonic_ns()}.jsonl"
        self._begin = 0
        command = [sys.executable, "-m", "soft_limb", "emulate", "--log", str(self.log), *options]
        self.errors = folder / "errors.txt"
        with self.errors.open("w") as errors:
            self.process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True
            )
        self.port = self.process.stdout.readline().strip()
        self.next = self.process.stdout.readline().strip()
        assert self.port.startswith("/dev/")

    def renew(self):
        """Makes board, line and limb as new; what was before is no event any more."""
        self.order("mend")
        self.order("cool")
        self._begin = self.log.stat().st_size
        self.order("restart")

    def order(self, text) -> float:
        """Gives an order; returns when it was obeyed, s of the monotonic clock."""
        count = len(self.events("order"))
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()
        assert wait_for(lambda: len(self.events("order")) > count)
        return self.events("order")[-1]["time"]

    def events(self, kind):
        lines = self.log.read_bytes()[self._begin :].splitlines() if self.log.exists() else []
        events = [json.loads(line) for line in lines if line.endswith(b"}")]
        return [event for event in events if event["event"] == kind]

    def wait_for(self, condition, limit=None):
        return wait_for(condition)

    def stop(self):
        self.process.terminate()
        self.process.wait()


def start_heating(board, start):
    """A host that heats a board in real time.

    Where a computer is too busy for a host, it is off before it heats, and is started again.
    """
    for _ in range(MOST_STARTS):
        host = start()
        assert board.wait_for(lambda: any(board.duty()) or host.poll() is not None)
        if any(board.duty()):
            return host
        said = host.communicate()[1]
        assert any(re.search(words, said) for words in LATE), said
        board.renew()
    raise AssertionError(said)


def wait_for(condition, limit=600.0):
    """Whether something is so in the end. The limit only keeps a test from hanging."""
    end = time.monotonic() + limit
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return False


class Heating:
    """A host that keeps a wire at a duty, beside what a test does, until it fails."""

    def __init__(self, time, link, duty=(0.0, 1.0)):
        self.error, self._time, self._link, self._duty = None, time, link, np.array(duty)
        link.arm(BOUNDS * (len(duty) // len(BOUNDS)))
        self._due = time.monotonic()
        time.at_each_turn(self._command)

    def _command(self):
        if self._time.monotonic() < self._due:
            return
        self._due += 0.05
        try:
            self._link.command(self._duty)
        except HardwareError as error:
            self.error = error
        return self.error

    def freeze(self):
        self._due = np.inf

    def wake_up(self):
        self._due = self._time.monotonic()

    def failure(self) -> str:
        assert self._time.wait_for(lambda: self.error is not None)
        return str(self.error)


class SimulatedBoard(simulated_board.SimulatedBoard):
    """The board of a small limb, switched on a while ago, with what tests ask of it."""

    def __init__(self, twin=None, step=1):
        super().__init__(twin or small_twin(), step=step)
        self.run(SETTLING_TIME)

    def run_to_reading(self, duty):
        """Runs until the thermocouples were just read, as they are for every other sample."""
        count = len(self.samples)
        while len(self.samples) == count or self.newest.sequence % 2 == 0:
            self.run(0.001, duty)

    def heat(self):
        """The right wire at full duty for more than a second, and hot; in coarser steps."""
        assert self.arm()
        step, self._step = self._step, 5
        self.prove((0.0, 1.0))
        self.run(1.2, (0.0, 1.0))
        self._step = step
        assert self.duty == (0.0, 1.0)
        assert self.temperature[1] > 28.0

    def prove(self, duty):
        """Heats a little until thermocouples have followed, and the duty is no longer reduced."""
        start = self.now
        while self.duty != duty:
            self.run(0.05, duty)
            assert self.now - start < 5.0

    def time_to_off(self, limit, duty=(0.0, 1.0)):
        """s, with a host that goes on commanding unless its duty is None."""
        start = self.now
        while self.duty != (0.0, 0.0):
            self.run(0.001, duty)
            assert self.now - start <= limit, "still on"
        return self.now - start


def report(fault, seconds):
    """Print the time until duty was zero, for docs/hardware.md; pytest -s shows it."""
    print(f"\n{fault}: {1000 * seconds:.0f} ms")


@pytest.fixture(scope="session")
def core(tmp_path_factory):
    """The firmware in C, in single precision, as on a board."""
    if not COMPILER:
        pytest.skip("there is no C compiler here")
    return compile_core(tmp_path_factory.mktemp("core"))


@pytest.fixture(scope="session")
def both_firmwares(tmp_path_factory):
    """The firmware in Python and the core in C, which must do the same, byte for byte.

    The core has double precision, as Python has it. Without a C compiler it is left out.
    """
    if not COMPILER:
        return Firmware
    return make_both(compile_core(tmp_path_factory.mktemp("both"), "double"))


@pytest.fixture
def board_in_simulated_time(monkeypatch):
    random.seed(0)  # of damage and noise
    monkeypatch.setattr(random, "SystemRandom", lambda: random.Random(0))  # of the challenges
    return SimulatedBoard()


@pytest.fixture
def virtual_time(monkeypatch):
    return VirtualTime(monkeypatch)


@pytest.fixture
def emulator(virtual_time):
    return VirtualBoard(virtual_time)


@pytest.fixture(scope="module")
def _real_emulator(tmp_path_factory):
    emulator = Emulator(tmp_path_factory.mktemp("emulator"))
    yield emulator
    emulator.stop()


@pytest.fixture
def real_emulator(_real_emulator):
    """A board in a process of its own, in real time, as new."""
    _real_emulator.renew()
    return _real_emulator


@pytest.fixture
def start_host():
    """Starts a program at the board, as `subprocess.Popen` does; it ends with the test."""
    hosts = []

    def start(command, **options):
        hosts.append(subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **options))
        return hosts[-1]

    yield start
    for host in hosts:
        host.kill()  # or it would keep the port
        host.wait()
