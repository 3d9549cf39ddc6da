"""Exchange messages with ROS 2 over DDS, by CycloneDDS alone.

Names of topics and types are mangled as in ROS 2: ``/cmd_u_t`` is ``rt/cmd_u_t``.
"""

import collections
import itertools
import os
import time
from collections.abc import Callable
from typing import Any

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from ros_bridge.messages import MAX_MESSAGE_SIZE, Message, ReceivedMessage, Topics

# Messages that wait to be read: so many that floods of other writers displace no command. Only the
# newest message of each writer is decoded.
QUEUE_LENGTH = 5000


class Undecoded(bytes):
    """The bytes of a message."""

    sample_info: Any


class _Message(IdlStruct):
    """A message whose bytes are kept and decoded later."""

    @classmethod
    def deserialize(cls, data: bytes, *_: Any, **__: Any) -> Any:
        return Undecoded(data)


def _type(name: str, *bases: type, **fields: Any) -> Any:
    return final(make_idl_struct(name, f"std_msgs::msg::dds_::{name}_", fields, bases=bases))


Dimension = _type("MultiArrayDimension", label=str, size=uint32, stride=uint32)
Layout = _type("MultiArrayLayout", dim=sequence[Dimension], data_offset=uint32)
Float64MultiArray = _type("Float64MultiArray", _Message, layout=Layout, data=sequence[float64])
String = _type("String", _Message, data=str)
Bool = _type("Bool", _Message, data=bool)


class DdsNode:
    """A writer and reader of messages in the DDS domain ROS_DOMAIN_ID; 0 if that is not set.

    It never waits. Its writers are reliable, so that any reader matches; its readers need reliable
    writers, which is the default of ROS 2. Raises DDSException if there is no network, for example.
    """

    def __init__(self, topics: Topics):
        domain = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID") or 0))
        reliable = Policy.Reliability.Reliable(duration(milliseconds=100))
        lifecycle = Policy.WriterDataLifecycle(autodispose=False)
        kept = Qos(reliable, Policy.History.KeepLast(10), lifecycle)
        waiting = Qos(reliable, Policy.History.KeepLast(QUEUE_LENGTH), lifecycle)
        # Open a writer or reader for each topic.
        self._writers = {}
        self._readers = {}
        numbers = Float64MultiArray
        written = {topics.sensors: numbers, topics.plan: numbers, topics.state: String}
        for name, kind in written.items():
            self._writers[name] = DataWriter(domain, Topic(domain, f"rt{name}", kind), kept)
        for name, kind in {topics.duty: numbers, topics.run: Bool}.items():
            self._readers[name] = DataReader(domain, Topic(domain, f"rt{name}", kind), waiting)

    def publish(self, topic: str, message: Message) -> None:
        """Write a message."""
        if isinstance(message, dict):
            size = len(message)
            label = ",".join(message)
            layout = Layout([Dimension(label, size, size)], 0)
            self._writers[topic].write(Float64MultiArray(layout, list(message.values())))
        else:
            self._writers[topic].write(String(message))

    def take(self) -> list[ReceivedMessage]:
        """Return the newest message of each writer since the last call."""
        return list(itertools.chain(*map(self._take, self._readers)))

    def _take(self, name: str) -> list[ReceivedMessage]:
        # Find the newest message of each writer, and count its messages.
        reader = self._readers[name]
        newest: dict[int, Any] = {}
        counts: collections.Counter[int] = collections.Counter()
        for sample in reader.take(QUEUE_LENGTH):
            if isinstance(sample, Undecoded):  # else it tells that a writer has gone
                writer = sample.sample_info.publication_handle
                newest[writer] = sample
                counts[writer] += 1
        # Decode them.
        received = []
        for writer, sample in newest.items():
            value = _value(reader.topic.data_type.__idl__.deserialize, sample)
            delay = (time.time_ns() - sample.sample_info.source_timestamp) * 1e-9
            received.append(ReceivedMessage(name, writer, value, delay, counts[writer]))
        return received


def _value(decode: Callable[[bytes], Any], data: Undecoded) -> Any:
    if len(data) > MAX_MESSAGE_SIZE:
        return f"it has {len(data)} bytes"
    try:
        return decode(data).data
    except Exception as error:  # whatever is in it
        return f"it cannot be decoded: {type(error).__name__}"
