"""A port with an emulated robot, for scripts without a robot."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def emulated_port(seed: int = 0) -> Iterator[str]:
    """A port with an emulated board and limb, which run in a separate process.

    Args:
        seed: of the limb.
    """
    command = [sys.executable, "-m", "hardware", "emulate", "--emulated", str(seed)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as board:
        assert board.stdout  # it is a pipe
        try:
            yield board.stdout.readline().decode().strip()
        finally:
            board.kill()
