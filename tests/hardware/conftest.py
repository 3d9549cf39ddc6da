"""An emulated board in a process of its own, and a host that heats."""

import json
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from hardware import BoardLink, HardwareError


class Emulator:
    """``python -m hardware emulate``, with its log."""

    def __init__(self, folder, *orders):
        self.log = folder / f"log_{time.monotonic_ns()}.jsonl"
        command = [sys.executable, "-m", "hardware", "emulate", "--log", str(self.log)]
        for order in orders:
            command += ["--do", order]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.port = self.process.stdout.readline().strip()
        assert self.port.startswith("/dev/")

    def order(self, text) -> float:
        """Gives an order; returns when it was obeyed, s of the monotonic clock."""
        count = len(self.events("order"))
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()
        assert wait_for(lambda: len(self.events("order")) > count)
        return self.events("order")[-1]["time"]

    def events(self, kind):
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        events = [json.loads(line) for line in lines if line.endswith("}")]
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


class Heating:
    """A host that keeps a wire at a duty, as a thread, until it fails or is stopped."""

    def __init__(self, link, duty=(0.0, 1.0)):
        self.error, self._stop, self._duty = None, threading.Event(), np.array(duty)
        link.arm()
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


@pytest.fixture
def emulator(tmp_path):
    emulator = Emulator(tmp_path)
    yield emulator
    emulator.stop()


@pytest.fixture
def link(emulator):
    with BoardLink(emulator.port) as link:
        yield link


@pytest.fixture
def heating(link, emulator):
    """The right wire at full duty for more than a second, and hot."""
    heating = Heating(link)
    time.sleep(1.2)
    assert emulator.duty() == [0.0, 1.0]
    assert link.sample().temperature[1] > 28.0
    yield heating
    heating.stop()
