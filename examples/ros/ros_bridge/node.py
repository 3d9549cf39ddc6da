"""The process that speaks to ROS 2: ``python -m ros_bridge.node``, by `NodeProcess` alone.

It keeps the threads of DDS, and what a flood of messages costs, away from the loop that commands
the board.
"""

import contextlib
import sys
import time
from multiprocessing.connection import Connection

from ros_bridge.messages import Listener, Node, Topics

TURN_TIME = 0.005  # s, after which it reads again


def make_node(topics: Topics) -> Node:
    """A node by `rclpy` if it can be imported, as where ROS 2 is set up, else by CycloneDDS.

    Raises:
        ImportError: if there is neither.
    """
    try:
        from ros_bridge.rclpy_node import RosNode

        return RosNode(topics)
    except ImportError:
        from ros_bridge.dds import DdsNode

        return DdsNode(topics)


def serve(pipe: Connection) -> None:
    """Publishes what comes, and answers with what was received, until the other end is closed."""
    topics, num_wires, total_duty = pipe.recv()
    try:
        node = make_node(topics)
    except Exception as error:  # of any library
        pipe.send(f"{type(error).__name__}: {error}")
        return
    listener = Listener(topics, num_wires, total_duty)
    pipe.send("")
    while True:
        before, is_asked = listener.received, pipe.poll(TURN_TIME)
        if is_asked:
            for topic, message in pipe.recv():
                node.publish(topic, message)
        listener.receive(node.take(), time.monotonic())
        if is_asked or listener.received is not before:
            pipe.send(listener.received)


if __name__ == "__main__":
    with contextlib.suppress(EOFError, OSError):
        serve(Connection(int(sys.argv[1])))
