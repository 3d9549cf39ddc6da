"""Emulated boards: in a process of its own with a host that heats, and in simulated time.

The process is shared by all tests, as it takes seconds to start, and as new for each.
"""

import json
import random
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import simulated_board

from hardware import BoardLink, HardwareError
from limb_systems import LimbParameters

BOUNDS = LimbParameters().heat_bounds
SETTLING_TIME = 0.6  # s, of a board that was switched on, before it can be armed


class Emulator:
    """``python -m hardware emulate``, with its log."""

    def __init__(self, folder, *options):
        self.log = folder / f"log_{time.monotonic_ns()}.jsonl"
        self._begin = 0
        command = [sys.executable, "-m", "hardware", "emulate", "--log", str(self.log), *options]
        self.errors = folder / "errors.txt"
        with self.errors.open("w") as errors:
            self.process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True
            )
        self.port = self.process.stdout.readline().strip()
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

    def duty(self):
        return [self.events("duty")[-1][side] for side in ("left", "right")]

    def off_after(self, since, limit=3.0) -> float:
        """s from a time until both wires were off."""

        def off():
            late = [e for e in self.events("duty") if e["time"] >= since - 1e-3]
            return next((e["time"] for e in late if e["left"] == e["right"] == 0.0), None)

        assert wait_for(lambda: off() is not None, limit), self.events("duty")[-3:]
        return off() - since

    def stop(self):
        self.process.terminate()
        self.process.wait()


def wait_for(condition, limit=5.0):
    end = time.monotonic() + limit
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return False


def last_numbers(message: bytes, count: int) -> np.ndarray:
    """With which a message to the browser ends: MessagePack, a tag and eight bytes for each."""
    return np.frombuffer(message[-9 * count :], [("tag", "u1"), ("value", ">f8")])["value"]


class Heating:
    """A host that keeps a wire at a duty, as a thread, until it fails or is stopped."""

    def __init__(self, link, duty=(0.0, 1.0)):
        self.error, self._stop, self._duty = None, threading.Event(), np.array(duty)
        link.arm(BOUNDS * (len(duty) // len(BOUNDS)))
        self._thread = threading.Thread(target=self._run, args=(link,), daemon=True)
        self._thread.start()

    def _run(self, link):
        while not self._stop.wait(0.05):
            try:
                link.command(self._duty)
            except HardwareError as error:
                self.error = error
                return

    def failure(self) -> str:
        assert wait_for(lambda: self.error is not None)
        return str(self.error)

    def stop(self):
        self._stop.set()
        self._thread.join()


class SimulatedBoard(simulated_board.SimulatedBoard):
    """The nominal limb's, switched on a while ago, with what tests ask of it."""

    def __init__(self, twin=None, step=1):
        super().__init__(twin, step=step)
        self.run(SETTLING_TIME)

    def run_to_reading(self, duty):
        """Runs until the thermocouples were just read, as they are for every other sample."""
        count = len(self.sent)
        while len(self.sent) == count or self.sent[-1][0] % 2 == 0:
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


@pytest.fixture
def board_in_simulated_time(monkeypatch):
    random.seed(0)  # of damage and noise
    monkeypatch.setattr(random, "SystemRandom", lambda: random.Random(0))  # of the challenges
    return SimulatedBoard()


@pytest.fixture(scope="session")
def _emulators(tmp_path_factory):
    """The one in use, if any."""
    emulators = []
    yield emulators
    for emulator in emulators:
        emulator.stop()


@pytest.fixture
def emulator(_emulators, tmp_path_factory):
    if not _emulators:
        _emulators.append(Emulator(tmp_path_factory.mktemp("emulator")))
    emulator = _emulators[0]
    emulator.renew()
    yield emulator
    if any(event["order"] == "unplug" for event in emulator.events("order")):
        _emulators.remove(emulator)
        emulator.stop()


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


@pytest.fixture
def link(emulator):
    with BoardLink(emulator.port) as link:
        yield link
