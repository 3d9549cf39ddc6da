"""The bridge to ROS 2 between two processes, alone and with a third one that floods it.

`examples/ros/bridge.py` runs a robot on an emulated board, in processes of their own. This process
commands it at 20 Hz, each time with another duty, and listens: for what share of the messages
came within 20 ms from their writing, and within 20 ms of when they were due; how many duties of
those sent were lost; whether the robot had another duty than those of this process, and how late
commands left for the board. Then a third process writes on the command topic as fast as it can,
first valid duties, then arrays of the wrong length, and starts of a plan on the other topic. The
targets are 99% within 20 ms, none lost, and no other duty.

    python benchmarks/ros_bridge_delay.py [--seconds 60]
"""

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from hardware import emulated_port
from limb_systems import Recording

ROS = Path(__file__).parents[1] / "examples" / "ros"
sys.path.insert(0, str(ROS))
from ros_bridge.dds import Bool, Float64MultiArray, Layout, String  # noqa: E402

PERIOD, NEAR = 0.05, 0.02  # s
OTHER = 0.9  # duty of who floods
FLOODS = ("", "valid", "garbage")
QUALITY = Qos(Policy.Reliability.Reliable(10**8), Policy.History.KeepLast(1))


class Peer:
    """A program on the network."""

    def __init__(self):
        self.sent = 0
        self._participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
        self.duty = self._make(DataWriter, "rt/cmd_u_t", Float64MultiArray)
        self.run = self._make(DataWriter, "rt/limb/run", Bool)
        self.state = self._make(DataReader, "rt/limb/state", String)
        self.sensors = self._make(DataReader, "rt/ezloophw_sensors", Float64MultiArray)

    def _make(self, role, name, kind):
        return role(self._participant, Topic(self._participant, name, kind), QUALITY)

    def command(self, *duty: float) -> None:
        self.duty.write(Float64MultiArray(Layout([], 0), list(duty)))

    def states(self) -> list[dict]:
        samples = [sample for sample in self.state.take(10) if isinstance(sample, bytes)]
        states = [json.loads(String.__idl__.deserialize(sample).data) for sample in samples]
        for state in states:
            assert "commands" in state, state  # the bridge has ended
        return states


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--flood", choices=FLOODS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    os.environ.setdefault("ROS_DOMAIN_ID", str(os.getpid() % 200 + 1))
    if options.flood:
        flood(options.flood)
    print(
        f"{'flood':<8}{'per s':>8}   sensors: within 20 ms   median       99%   largest   "
        "every 50 ± 20 ms   duties: sent   lost   within 20 ms   median       99%   largest"
        "   robot: ticks without a duty   with another   load"
    )
    for kind in FLOODS:
        report(kind, options.seconds)


def flood(kind: str) -> None:
    """Writes on topics as fast as it can, and counts each second."""
    peer, duty = Peer(), [OTHER / 2, OTHER / 2] if kind == "valid" else [OTHER] * 5
    message = Float64MultiArray(Layout([], 0), duty)
    while True:
        end, count = time.monotonic() + 1.0, 0
        while time.monotonic() < end:
            peer.duty.write(message)
            count += 1
            if kind == "garbage":
                peer.run.write(Bool(True))
        print(count, flush=True)


@contextlib.contextmanager
def program(*command: str) -> Iterator[subprocess.Popen]:
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.terminate()
        process.communicate()


def report(kind: str, seconds: float) -> None:
    """A run, and what came of it."""
    with contextlib.ExitStack() as stack:
        path = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "recording.csv"
        port = stack.enter_context(emulated_port())
        with program(str(ROS / "bridge.py"), "-p", port, "-o", str(path)):
            peer = Peer()
            while not peer.states():
                time.sleep(0.1)
            stop = threading.Event()
            commander = threading.Thread(target=command, args=(peer, stop), daemon=True)
            listen(peer, 0.5)
            commander.start()
            listen(peer, 1.0)  # it has the topic then
            rate = ""
            if kind:
                flooder = stack.enter_context(program(__file__, "--flood", kind))
                listen(peer, 5.0)  # until it is there
                rate = flooder.stdout.readline().strip()
            sensors, delays = listen(peer, seconds)
            stop.set()
            commander.join()
            _, last = listen(peer, 0.5)
        duty = Recording.load(path).duty[:, -round(seconds / PERIOD) - 20 : -20]
    asked = (duty[0] == 0) & (np.abs(duty[1] - 0.15) <= 0.05)
    off = ~duty.any(axis=0)
    late, intervals = sensors[0] - sensors[1], np.diff(sensors[0])
    print(
        f"{kind or 'none':<8}{rate:>8}{np.mean(late < NEAR):>22.2%}{_times(late)}"
        f"{np.mean(np.abs(intervals - PERIOD) < NEAR):>19.2%}"
        f"{peer.sent:>15}{peer.sent - max(last):>7}"
        f"{np.mean(np.array(list(delays.values())) < NEAR):>15.2%}{_times(list(delays.values()))}"
        f"{off.sum():>31}{np.sum(~asked & ~off):>15}{os.getloadavg()[0]:>7.1f}",
        flush=True,
    )


def command(peer: Peer, stop: threading.Event) -> None:
    """Commands at 20 Hz until it is stopped, each time another duty."""
    random = np.random.default_rng(0)
    start = time.monotonic()
    while not stop.wait(max(0.0, start + peer.sent * PERIOD - time.monotonic())):
        peer.command(0.0, 0.1 + 0.1 * random.random())
        peer.sent += 1


def listen(peer: Peer, seconds: float) -> tuple[np.ndarray, dict[int, float]]:
    """When readings arrived and were written, s; and the delay of each duty by its number, s."""
    times, delays, end = [], {}, time.monotonic() + seconds
    peer.sensors.take()
    peer.states()
    while time.monotonic() < end:
        for sample in peer.sensors.take(10):
            if isinstance(sample, bytes):
                times.append((time.time(), sample.sample_info.source_timestamp * 1e-9))
        delays |= {state["commands"]: state["delay"] for state in peer.states()}
        time.sleep(0.001)
    return np.transpose(times), delays


def _times(seconds) -> str:
    """Median, 99th percentile and largest, ms."""
    median, most = 1000 * np.percentile(seconds, [50, 99])
    return f"{median:>6.2f} ms{most:>7.2f} ms{1000 * max(seconds):>7.2f} ms"


if __name__ == "__main__":
    main()
