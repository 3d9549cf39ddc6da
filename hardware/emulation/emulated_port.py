"""A port that acts like a robot's, for scripts where there is none."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def emulated_port(seed: int = 0) -> Iterator[str]:
    """A port with an emulated board and limb on it, in a process of their own.

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
