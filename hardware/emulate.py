"""``python -m hardware emulate``: a board and a limb that are not there, on a port that is."""

import json
import select
import sys
import time
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
