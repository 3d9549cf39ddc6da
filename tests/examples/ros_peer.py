"""Somebody else's program on the network, with types written from the ROS 2 definitions."""

import json
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic


@final
@dataclass
class Dimension(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayDimension_"):
    label: str
    size: uint32
    stride: uint32


@final
@dataclass
class Layout(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayLayout_"):
    dim: sequence[Dimension]
    data_offset: uint32


@final
@dataclass
class Array(IdlStruct, typename="std_msgs::msg::dds_::Float64MultiArray_"):
    layout: Layout
    data: sequence[float64]


@final
@dataclass
class Text(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


@final
@dataclass
class Truth(IdlStruct, typename="std_msgs::msg::dds_::Bool_"):
    data: bool


QUALITY = Qos(Policy.Reliability.Reliable(10**8), Policy.History.KeepLast(10))
DROPPING = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(10))


class Peer:
    """Somebody else's program on the network."""

    def __init__(self, domain):
        self.participant = DomainParticipant(domain)
        self.state = self.reader("rt/limb/state", Text)
        self.sensors = self.reader("rt/ezloophw_sensors", Array, DROPPING)
        self.plan = self.reader("rt/limb/plan", Array)
        self.run = self.writer("rt/limb/run", Truth)
        self.duty = self.writer("rt/cmd_u_t", Array)

    def reader(self, name, kind, quality=QUALITY):
        return DataReader(self.participant, Topic(self.participant, name, kind), quality)

    def writer(self, name, kind):
        return DataWriter(self.participant, Topic(self.participant, name, kind), QUALITY)

    def command(self, *duty, delay=0.0):
        written = time.time_ns() - int(delay * 1e9)
        self.duty.write(Array(Layout([], 0), list(duty)), timestamp=written)
        return written * 1e-9

    def states(self, wanted=lambda state: True, limit=600.0, meanwhile=lambda: None):
        """(time of writing, state) until one is as wanted."""
        states, end = [], time.monotonic() + limit
        while time.monotonic() < end:
            meanwhile()
            time.sleep(0.02)
            for sample in self.state.take(10):
                if hasattr(sample, "data"):
                    written = sample.sample_info.source_timestamp * 1e-9
                    states.append((written, json.loads(sample.data)))
            if states and wanted(states[-1][1]):
                return states
        raise AssertionError(states[-5:])


if __name__ == "__main__":  # a publisher, which says when it wrote
    publisher = Peer(int(sys.argv[1]))
    while True:
        print(publisher.command(0.0, 0.2), flush=True)
        time.sleep(0.05)
