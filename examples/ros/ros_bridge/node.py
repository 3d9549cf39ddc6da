"""The process that exchanges messages with ROS 2; `NodeProcess` starts it.

A separate process keeps the threads of DDS, and a flood of messages, away from the loop that
commands the board.
"""

import contextlib
import sys
import time
from multiprocessing.connection import Connection

from ros_bridge.messages import Listener

TURN_TIME = 0.005  # s between two readings


def serve(pipe: Connection) -> None:
    """Publish messages from a pipe and answer with the received commands, until it is closed."""
    topics, num_wires, total_duty = pipe.recv()
    try:
        from ros_bridge.dds import DdsNode  # CycloneDDS may be missing

        node = DdsNode(topics)
    except Exception as error:  # of the library
        pipe.send(f"{type(error).__name__}: {error}")
        return
    listener = Listener(topics, num_wires, total_duty)
    pipe.send("")
    # Publish what the pipe brings, and answer with the commands.
    while True:
        previous = listener.received
        is_asked = pipe.poll(TURN_TIME)
        if is_asked:
            for topic, message in pipe.recv():
                node.publish(topic, message)
        listener.receive(node.take(), time.monotonic())
        if is_asked or listener.received is not previous:
            pipe.send(listener.received)


if __name__ == "__main__":
    with contextlib.suppress(EOFError, OSError):
        serve(Connection(int(sys.argv[1])))
