"""What the page's process knows of a run."""

import collections
import os
import pickle
import time

import numpy as np

from hardware.live_feed import Message, Reading, RunHeader
from limb_systems.simulation import PERIOD

MOST_POINTS = 1500  # of a curve; the browser draws them on the computer that runs the limb
ENDLESS_STRIDE = 8  # of the readings of what has no end, so that the points are of ten minutes
ENDED_WITHOUT_A_WORD = (
    "the program has gone without saying why: it was stopped while it planned, it was killed, or "
    "it crashed"
)


class Run:
    """What the program that runs a limb has told, and how the run ended.

    - ``said``: name of what runs.
    - ``phase``: header of the newest recording; None before the first. ``number`` counts them.
    - ``reading``: newest reading of the phase, if there is one.
    - ``is_running``: whether a limb runs.
    - ``readings``: readings of the phase, for its curves: evenly thinned, all of one with an end,
      else its last ten minutes. ``count`` is how many were appended since they were thinned, and
      ``thinned`` how often they were, in all phases.
    - ``highest``: the highest V of each wire so far, °C.
    - ``heard``: time when something was heard last, s of the monotonic clock.
    - ``ended``: reason why it ended; empty until then.
    """

    def __init__(self):
        self.said, self.ended = "", ""
        self.phase: RunHeader | None = None
        self.reading: Reading | None = None
        self.heard = time.monotonic()
        self.is_running, self.number, self.count, self.thinned = False, 0, 0, 0
        self.readings: collections.deque[Reading] = collections.deque(maxlen=MOST_POINTS)
        self.highest: np.ndarray = np.zeros(0)
        self._stride, self._received = 1, 0

    def take(self, data: bytes, files: list[int]) -> None:
        """Take in a message, and the file that came with it if a phase begins."""
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
            if len(self.readings) == MOST_POINTS and self._may_thin():
                self._thin()
            self.readings.append(message.reading)
            self.count += 1
        self._received += 1

    def end(self, reason: str) -> None:
        """Note the end; without a reason the program was killed."""
        self.ended, self.is_running = reason or ENDED_WITHOUT_A_WORD, False

    def _may_thin(self) -> bool:
        assert self.phase
        return self.phase.duration is not None or self._stride < ENDLESS_STRIDE

    def _thin(self) -> None:
        """Leave out every other reading, also of those to come."""
        self.readings = collections.deque(list(self.readings)[::2], MOST_POINTS)
        self._stride *= 2
        self.thinned, self.count = self.thinned + 1, len(self.readings)

    def _begin(self, phase: RunHeader) -> None:
        self.phase, self.number, self.reading = phase, self.number + 1, None
        self.readings.clear()
        self.count = self._received = 0
        self.highest = np.full(len(phase.parameters.wires), -np.inf)
        expected = (phase.duration or 0.0) / PERIOD
        self._stride = max(1, int(np.ceil(expected / MOST_POINTS)))
