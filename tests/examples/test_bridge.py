"""The bridge to ROS 2, to which another process speaks over DDS."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from ros_bridge.drive import ARMED, FAULT, IDLE, RUNNING, Driver, drive
from ros_bridge.messages import Listener, ReceivedCommands, ReceivedMessage, Topics

from hardware import LimbTwin
from limb_systems import LimbError, LimbParameters
from planners import plan, references

pytest.importorskip("cyclonedds")
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.qos import Policy

from . import ros_peer

pytestmark = pytest.mark.whole

BRIDGE = Path(__file__).parents[2] / "examples" / "ros" / "bridge.py"


def runs(state):
    return state["state"] == "running" and max(state["duty"]) > 0


@pytest.fixture(scope="module")
def domain():
    return random.Random(os.getpid()).randrange(1, 200)


@pytest.fixture(scope="module")
def bridge(domain, tmp_path_factory):
    """``bridge.py`` with an emulated limb, and a plan of ten seconds."""
    path = tmp_path_factory.mktemp("bridge") / "plan.csv"
    parameters = LimbParameters()
    parameters.temperature_limits.warm_up_time = 100.0
    reference = references.from_samples([0.0, 10.0], [0.0, 0.1])
    plan(parameters, reference, knot_rate=2.0).save(path)
    command = [sys.executable, str(BRIDGE), "--emulated", "0", "--plan", str(path)]
    process = subprocess.Popen(
        command,
        env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline().startswith("bridge ")
    yield process
    process.kill()
    process.communicate()


@pytest.fixture(scope="module")
def peer(bridge, domain):
    peer = ros_peer.Peer(domain)
    peer.states()
    return peer


def test_names_are_mangled_as_in_ros_2(peer):
    def found(kind):
        reader = BuiltinDataReader(peer.participant, kind)
        return {
            e.topic_name: (e.type_name, e.qos[Policy.Reliability], e.qos[Policy.Durability])
            for e in reader.take(100)
            if e.participant_key != peer.participant.guid
        }

    array, text, truth = (
        f"std_msgs::msg::dds_::{n}_" for n in ("Float64MultiArray", "String", "Bool")
    )
    written, read = {}, {}
    for kind, ends, count in (
        (BuiltinTopicDcpsPublication, written, 3),
        (BuiltinTopicDcpsSubscription, read, 2),
    ):
        peer.states(lambda _: len(ends) >= count, meanwhile=lambda: ends.update(found(kind)))
    names = {"rt/ezloophw_sensors": array, "rt/limb/plan": array, "rt/limb/state": text}
    assert {name: kind for name, (kind, _, _) in written.items()} == names
    assert {n: k for n, (k, _, _) in read.items()} == {"rt/cmd_u_t": array, "rt/limb/run": truth}
    for _, reliability, durability in (*written.values(), *read.values()):
        assert isinstance(reliability, Policy.Reliability.Reliable)
        assert durability == Policy.Durability.Volatile


def test_publishes_what_is_measured_in_si(peer):
    samples = []
    peer.states(lambda _: samples, meanwhile=lambda: samples.extend(peer.sensors.take(10)))
    (dimension,) = samples[-1].layout.dim
    assert (dimension.label, dimension.size) == ("left_c,right_c,bend_0_rad", 3)
    left, right, bend = samples[-1].data
    assert 15 < left < 60
    assert 15 < right < 60
    assert abs(bend) < 0.5


def test_duty_ends_with_its_publisher(peer, domain):
    """The publisher is killed, and sends no last message."""
    command = [sys.executable, ros_peer.__file__, str(domain)]
    publisher = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        peer.states(runs)
    finally:
        publisher.kill()
        publisher.communicate()
    states = peer.states(lambda state: state["state"] == ARMED and max(state["duty"]) == 0)
    assert "too old" in states[-1][1]["why"]


def test_starts_and_stops_the_plan(peer):
    peer.states(lambda state: state["age"] > 1.0)
    peer.run.write(ros_peer.Truth(True))
    peer.states(lambda state: runs(state) and state["plan_time"] > 0.3)
    peer.run.write(ros_peer.Truth(False))
    states = peer.states(lambda state: state["plan_time"] is None and max(state["duty"]) == 0)
    planned = peer.plan.take(10)[-1]
    names = planned.layout.dim[0].label.split(",")
    assert names == ["time_s", "reference_0_rad", "planned_0_rad", "duty_left", "duty_right"]
    moment, reference, bend, *_ = planned.data
    assert reference == pytest.approx(0.01 * moment)
    assert bend == pytest.approx(reference, abs=0.05)
    assert states[-1][1]["state"] == ARMED


def test_ends_by_a_signal(bridge, peer):
    peer.states(runs, meanwhile=lambda: peer.command(0.0, 0.2))
    bridge.terminate()
    assert bridge.wait() == 128 + signal.SIGTERM
    assert "wires are off" in bridge.stderr.read()


@pytest.mark.parametrize(
    ("failure", "state"),
    [
        (LimbError("The cable is gone."), {"state": FAULT, "why": "The cable is gone."}),
        (KeyboardInterrupt(), {"state": IDLE, "why": "the bridge has ended"}),
    ],
)
def test_wires_are_off_before_the_end_is_published(failure, state, monkeypatch):
    """On any way out; then the other process ends."""
    calls = mock.Mock()
    limb = LimbTwin(seed=0)
    monkeypatch.setattr(LimbTwin, "real_time", True)
    monkeypatch.setattr(LimbTwin, "close", calls.off, raising=False)
    monkeypatch.setattr("ros_bridge.drive.NodeProcess", lambda *_: calls.node)
    monkeypatch.setattr("ros_bridge.drive._loop", mock.Mock(side_effect=failure))
    with pytest.raises(type(failure)):
        drive(limb)
    published = mock.call.node.publish({"/limb/state": json.dumps(state)})
    assert calls.mock_calls == [mock.call.off(), published, mock.call.node.close(), mock.call.off()]


def test_a_limb_that_cuts_out_ends_the_bridge(monkeypatch):
    """Each tick applies the newest duty, and publishes it with the readings."""
    parameters = LimbParameters()
    parameters.temperature_limits.maximum = 150.0
    node = mock.Mock()
    node.receive.side_effect = 1000 * [ReceivedCommands((0.1, 0.6), time.monotonic() + 1e3)]
    monkeypatch.setattr("ros_bridge.drive.NodeProcess", lambda *_: node)
    monkeypatch.setattr("ros_bridge.drive.time.sleep", lambda _: None)
    with pytest.raises(LimbError, match="was measured at 110 °C or more"):
        drive(LimbTwin(parameters, seed=0))
    *ticks, end = (call.args[0] for call in node.publish.mock_calls)
    assert json.loads(end["/limb/state"])["state"] == FAULT
    assert json.loads(ticks[-2]["/limb/state"])["duty"] == pytest.approx([0.1, 0.6], abs=3e-3)
    readings = np.array([list(tick["/ezloophw_sensors"].values()) for tick in ticks])
    assert readings[-1, 1] >= 110.0 > readings[:-1, 1].max()
    assert readings[-1, 2] > readings[0, 2] + 0.3  # towards the right


class Network:
    """A `Listener` and a `Driver` with a clock of their own."""

    def __init__(self, **options):
        self.listener = Listener(Topics(), 2, 1.5)
        self.driver = Driver(LimbParameters(), **options)
        self.now = 100.0

    def write(self, *duty, writer=1, **options):
        self.listener.receive([ReceivedMessage("/cmd_u_t", writer, duty, **options)], self.now)

    def wait(self, seconds):
        for _ in range(round(seconds / 0.01)):
            self.now += 0.01
            self.listener.receive([], self.now)

    def duty(self, measured=25.0):
        self.wait(0.05)
        return self.driver.duty(self.listener.received, np.full(2, measured), self.now).tolist()


def test_the_first_writer_has_the_topic():
    network = Network()
    for step in range(100):
        if step < 40:
            network.write(0.0, 0.2, writer=1)
        for duty in ((0.5, 0.5), (0.5,), (np.nan, 2.0)):
            network.write(*duty, writer=2)
        duty = network.duty()
        if step < 40:
            assert duty == [0.0, 0.2]
            assert step == 0 or "another writer" in network.driver.why
    assert duty == [0.0, 0.0]  # who has taken nobody's place while it wrote has none after
    network.now += 10.0  # in which this process did not run
    network.write(0.5, 0.5, writer=2)
    assert network.duty() == [0.0, 0.0]
    network.wait(0.3)
    network.write(0.5, 0.5, writer=2)
    assert network.duty() == [0.5, 0.5]


def test_a_writer_of_garbage_has_no_topic():
    network = Network()
    for _ in range(10):
        network.write(3.0, 0.0, writer=2)
        assert network.duty() == [0.0, 0.0]
        assert "not within 0 and 1" in network.driver.why
    for duty, delay, why in (
        ((0.9, 0.9), 0.0, "total_duty is 1.5"),
        ((0.0, 0.2, 0.0), 0.0, "3 numbers"),
        ((0.0, np.nan), 0.0, "not within 0 and 1"),
        ((0.0, 0.2), 0.3, "written 0.30 s ago"),
    ):
        network.write(*duty, delay=delay)
        assert network.duty() == [0.0, 0.0]
        assert why in network.driver.why
    network.write(0.0, 0.2, writer=1)
    network.write(3.0, 0.0, writer=2)
    assert network.duty() == [0.0, 0.2]


def test_no_duty_is_applied_when_it_is_older_than_250_ms_or_on_hot_wires():
    network = Network()
    network.write(0.0, 0.2, delay=0.1)
    last = network.now - 0.1
    while network.duty() != [0.0, 0.0]:
        assert network.now + 0.05 <= last + 0.25 + 1e-9  # for which it stays
    network.wait(1.0)
    network.write(0.0, 0.2)
    assert network.duty(measured=101.0) == [0.0, 0.0]
    assert "temperature_limits.maximum" in network.driver.why
    assert network.duty() == [0.0, 0.2]


def test_a_plan_starts_from_cold_wires_without_another_writer(fig5_plan):
    network = Network(plan=fig5_plan)

    def ask(run):
        network.listener.receive([ReceivedMessage("/limb/run", 1, run)], network.now)

    network.write(0.0, 0.2)
    ask(True)
    network.duty()
    assert "another program commands" in network.driver.why
    network.wait(3.0)
    ask(True)
    network.duty(measured=60.0)
    assert "35 °C" in network.driver.why
    network.wait(3.0)
    ask(True)
    for _ in range(40):
        duty = network.duty()
        network.write(0.5, 0.5)  # it is not heeded
    moment = network.driver.plan_time
    assert moment == pytest.approx(1.95)
    wanted = [np.interp(moment, fig5_plan.time, row) for row in fig5_plan.duty]
    assert duty == pytest.approx(wanted)
    network.now += fig5_plan.duration  # the process did not run
    assert network.duty() == [0.0, 0.0]
    assert network.driver.plan_time is None
    for _ in range(10):  # who repeats it does not start it again
        ask(True)
        ask(True)
        network.duty()
    assert network.driver.state == RUNNING
    ask(False)
    assert network.duty() == [0.0, 0.0]
    assert network.driver.state == ARMED
