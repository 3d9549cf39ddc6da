"""``python -m hardware emulate``: a board and a limb that are not there, on a port that is."""

import contextlib
import json
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from hardware.emulated_board import Emulation
from hardware.twin import LimbTwin
from limb_systems import LimbError

TURN = 0.001  # s


def emulate(twin: LimbTwin, orders: list[str], log: Path | None = None) -> None:
    """Runs the firmware on an emulated board until the process is stopped.

    Prints the port to connect to, then obeys orders from standard input.

    Args:
        twin: the limb on the board.
        orders: obeyed at once, as of `Emulation.misbehave`.
        log: file for what happens, a line of JSON for each change of duty
            and each order.

    Raises:
        LimbError: if an order at the start is not understood.
    """
    with open(log, "w", encoding="utf-8") if log else open("/dev/null", "w") as file:

        def note(**event) -> None:
            file.write(json.dumps(event) + "\n")
            file.flush()

        emulation = Emulation(twin, note)
        for order in orders:
            emulation.misbehave(order)
        print(emulation.port, flush=True)
        listening = True
        while True:
            emulation.step()
            if listening and select.select([sys.stdin], [], [], 0)[0]:
                line = sys.stdin.readline()
                listening = bool(line)
                try:
                    if line.strip():
                        emulation.misbehave(line)
                except LimbError as error:
                    print(f"error: {error}", file=sys.stderr)
            time.sleep(TURN)


@contextlib.contextmanager
def emulated_port(seed: int = 0) -> Iterator[str]:
    """A port with an emulated board and limb on it, in a process of their own.

    Args:
        seed: of the limb.
    """
    command = [sys.executable, "-m", "hardware", "emulate", "--seed", str(seed)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as board:
        try:
            yield board.stdout.readline().decode().strip()
        finally:
            board.kill()
