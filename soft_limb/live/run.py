"""What the page's process knows of a run."""

import collections
import os
import pickle
import time

import numpy as np

from hardware.live.messages import Message, Reading, RunHeader
from limb_systems.simulation import PERIOD

MOST_POINTS = 1500  # of a curve; the browser draws them on the computer that runs the limb
ENDED_WITHOUT_A_WORD = (
    "the program has gone without saying why: it was stopped while it planned, it was killed, or "
    "it crashed"
)


class Run:
    """What was heard, and how it ended.

    - ``said``: name of what runs.
    - ``phase``: the last that began; None before one. ``number`` counts them.
    - ``reading``: newest reading of the phase, if there is one.
    - ``is_running``: whether a limb runs.
    - ``readings``: newest readings of the phase, for its curves; ``count`` is how many there were.
    - ``highest``: the highest V of each wire so far, °C.
    - ``heard``: time when something was heard last, s of the monotonic clock.
    - ``ended``: reason why it ended; empty until then.
    """

    def __init__(self):
        self.said, self.ended = "", ""
        self.phase: RunHeader | None = None
        self.reading: Reading | None = None
        self.heard = time.monotonic()
        self.is_running, self.number, self.count = False, 0, 0
        self.readings: collections.deque[Reading] = collections.deque(maxlen=MOST_POINTS)
        self.highest: np.ndarray = np.zeros(0)
        self._stride, self._received = 1, 0

    def take(self, data: bytes, files: list[int]) -> None:
        """Takes in a message, and the file that came with it if a phase begins."""
        for handle in files:
            with os.fdopen(handle, "rb") as file:
                file.seek(0)
                self._begin(pickle.load(file))
        message: Message = pickle.loads(data)
        self.heard = time.monotonic()
        self.said, self.is_running = message.said, message.reading is not None
        if message.reading is None:
            return
        self.reading = message.reading
        self.highest = np.fmax(self.highest, message.reading.measured_temperature)
        if self._received % self._stride == 0:
            self.readings.append(message.reading)
            self.count += 1
        self._received += 1

    def end(self, reason: str) -> None:
        """Notes the end; without a reason the program was killed."""
        self.ended, self.is_running = reason or ENDED_WITHOUT_A_WORD, False

    def _begin(self, phase: RunHeader) -> None:
        self.phase, self.number, self.reading = phase, self.number + 1, None
        self.readings.clear()
        self.count = self._received = 0
        self.highest = np.full(len(phase.parameters.wires), -np.inf)
        expected = (phase.duration or 0.0) / PERIOD
        self._stride = max(1, int(np.ceil(expected / MOST_POINTS)))
