"""A limb of another physics than models and emulation, to make recordings as labs have them.

Wires are relays with hysteresis, they cool by two exponentials, thermocouples are late and lag,
and the bend sensor drifts.
"""

import numpy as np

from limb_systems import LimbParameters, Recording

STEP = 0.02  # s, of Euler's method
RELAYS = 40


class OwnLimb:
    """A limb with wires left and right, cold at first; each recording goes on from the last."""

    def __init__(self, seed: int, delay: float = 0.1):
        """
        Args:
            seed: of what it is like, and of its noise.
            delay: of the readings, beside the lag, s.
        """
        self._random = random = np.random.default_rng(seed)
        self._room = random.uniform(20.0, 24.0)
        self._cooling, self._silicone = 1 / random.uniform(9.0, 16.0), 1 / random.uniform(80, 130)
        self._share, self._heating = random.uniform(0.15, 0.3), random.uniform(35.0, 60.0, 2)
        self._lag, self._delay = random.uniform(0.6, 1.2, 2), round(delay / STEP)
        self._up = random.normal(random.uniform(62.0, 75.0), 7.0, (2, RELAYS))
        self._down = self._up - np.abs(random.normal(12.0, 3.0, (2, RELAYS)))
        self._bend, self._rest = random.uniform(0.8, 1.2, 2), random.uniform(-0.05, 0.05)
        self._on, self._drift = np.zeros((2, RELAYS), bool), 0.0
        self._wires = self._warm = self._read = np.full(2, self._room)
        self._late = [self._wires] * (self._delay + 1)

    def record(self, pulses, duration: float, sample_rate: float = 10.0) -> Recording:
        """A recording of pulses, each (index of the wire, duty, start, duration), s."""
        times = np.arange(round(duration / STEP) + 1) * STEP
        duty = np.zeros((2, len(times)))
        for wire, level, start, length in pulses:
            duty[wire, (times > start - 1e-9) & (times < start + length - 1e-9)] = level
        rows = [self._step(d) for d in duty.T]
        every = round(1 / sample_rate / STEP)
        signals = np.array(rows)[::every].T
        # In force since the sample before.
        held = np.column_stack([duty[:, 0], duty[:, ::every][:, :-1]])
        return Recording(
            time=times[::every],
            duty=held,
            measured_temperature=np.round(4 * signals[:2]) / 4,
            bend_angle=signals[2:],
            parameters=LimbParameters(ambient_temperature=22.0),
            source="own limb",
            sample_rate=sample_rate,
        )

    def _step(self, duty: np.ndarray) -> list[float]:
        noise = self._random.normal(size=4)
        share = (self._on.mean(axis=1) * self._bend) @ [-1.0, 1.0]
        bend = self._rest + share / (1 + 0.15 * share**2) + self._drift + 0.003 * noise[0]
        row = [*(self._read + 0.15 * noise[1:3]), bend]
        flow = self._cooling * (self._wires - self._warm)
        loss = self._silicone * (self._warm - self._room)
        self._read = self._read + STEP * (self._late[0] - self._read) / self._lag
        self._wires = self._wires + STEP * (self._heating * duty - flow)
        self._warm = self._warm + STEP * (self._share * flow - loss)
        self._late = [*self._late[1:], self._wires]
        self._on |= self._wires[:, None] > self._up
        self._on &= self._wires[:, None] > self._down
        self._drift += 4e-4 * np.sqrt(STEP) * noise[3] - STEP * self._drift / 120.0
        return row
