"""Exchange messages with ROS 2 by its client library, `rclpy`."""

import functools
import time
from typing import Any

import rclpy
from std_msgs.msg import (
    Bool,
    Float64MultiArray,
    MultiArrayDimension,
    MultiArrayLayout,
    String,
)

from ros_bridge.messages import Message, ReceivedMessage, Topics


class RosNode:
    """A `Node` of ROS 2. As `rclpy` does not say who wrote a duty, two publishers are refused."""

    def __init__(self, topics: Topics):
        rclpy.init()
        self._node = rclpy.create_node("soft_limb")
        self._duty = topics.duty
        written = {topics.sensors: Float64MultiArray, topics.plan: Float64MultiArray}
        written[topics.state] = String
        self._publishers = {
            name: self._node.create_publisher(kind, name, 10) for name, kind in written.items()
        }
        self._written: dict[str, ReceivedMessage] = {}
        for name, kind in {topics.duty: Float64MultiArray, topics.run: Bool}.items():
            self._node.create_subscription(kind, name, functools.partial(self._keep, name), 1)

    def publish(self, topic: str, message: Message) -> None:
        """Write a message."""
        if isinstance(message, dict):
            size = len(message)
            label = ",".join(message)
            dimension = MultiArrayDimension(label=label, size=size, stride=size)
            layout = MultiArrayLayout(dim=[dimension], data_offset=0)
            self._publishers[topic].publish(
                Float64MultiArray(layout=layout, data=list(message.values()))
            )
        else:
            self._publishers[topic].publish(String(data=message))

    def take(self) -> list[ReceivedMessage]:
        """Return the newest message of each topic since the last call."""
        self._written.clear()
        for _ in range(2 * len(self._publishers)):  # each does at most one thing that waits
            rclpy.spin_once(self._node, timeout_sec=0)
        return list(self._written.values())

    def _keep(self, name: str, message: Any, info: dict[str, int] | None = None) -> None:
        """Keep a message; older versions of `rclpy` do not tell when it was written."""
        value = message.data
        delay = 0.0
        if name == self._duty:
            value = list(value)
            if self._node.count_publishers(name) > 1:
                value = "several publishers are on its topic"
        if info:
            delay = (time.time_ns() - info["source_timestamp"]) * 1e-9
        self._written[name] = ReceivedMessage(name, 0, value, delay)
