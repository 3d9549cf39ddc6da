"""An emulated board with an emulated limb on it, for the firmware to run on.

The sensors answer with the bytes of the real ones. The limb is a `LimbTwin`
that is simulated along a clock, the computer's or another. Its sensors can be
made to fail.
"""

import random
import struct
import time
from collections.abc import Callable

import numpy as np

from hardware.emulation.specimen import serial_number
from hardware.emulation.twin import LimbTwin
from hardware.firmware.firmware import CHANNELS
from limb_systems import LimbError
from limb_systems.simulation import make_simulator

LIMB_PERIOD = 0.02  # s, by which the limb is simulated at a time


class EmulatedBoard:
    """A board for `firmware.Firmware`; see there for its methods.

    ``on_duty(left, right)`` is called whenever the duty at the wires changes;
    ``clock()`` is the time, s, along which the limb is simulated.

    Raises:
        LimbError: at construction, if the limb has another number of wires than
            the board has channels, or several segments.
    """

    def __init__(
        self,
        twin: LimbTwin,
        on_duty: Callable[[float, float], None],
        clock: Callable[[], float] = time.monotonic,
    ):
        num_wires, num_segments = len(twin.parameters.wires), len(twin.parameters.segments)
        if num_wires != CHANNELS or num_segments != 1:
            raise LimbError(
                f"An emulated board is for {CHANNELS} wires and one bend sensor; this limb has "
                f"{num_wires} wires in {num_segments} segment{'s' * (num_segments != 1)}."
            )
        self._clock, self._start = clock, clock()
        self._on_duty = on_duty
        self._duty = [0.0, 0.0]
        self._twin = twin
        self._simulator = make_simulator(twin, twin.accuracy)
        self._context = self._simulator.get_mutable_context()
        self._input = twin.GetInputPort("duty").FixValue(self._context, [0, 0])
        self._simulator.Initialize()
        self.to_host, self.from_host = bytearray(), bytearray()
        self.serial_number = serial_number(twin.specimen.board).encode()
        self.random = random.SystemRandom().getrandbits(16)
        self.mend()
        self.fed = clock()

    def mend(self) -> None:
        """Removes all faults of sensors."""
        self.thermocouple_faults = [0, 0]
        self.frozen_temperature: list[float | None] = [None, None]
        self.frozen_bend: bytes | None = None
        self.bend_is_silent = False

    def cool(self) -> None:
        """Brings the limb back to its initial state: cold and at rest."""
        self._twin.SetDefaultContext(self._context)
        self._simulator.Initialize()

    def advance(self) -> None:
        """Simulates the limb up to now."""
        now = self._clock() - self._start
        if now >= self._context.get_time() + LIMB_PERIOD:
            self._simulator.AdvanceTo(now)

    def ticks(self) -> int:
        return round(1000 * (self._clock() - self._start))

    def receive(self) -> bytes:
        data = bytes(self.from_host)
        self.from_host.clear()
        return data

    def send(self, data: bytes) -> None:
        self.to_host += data

    def read_thermocouple(self, wire: int) -> bytes:
        temperature = self.reading("measured_temperature")[wire]
        if self.frozen_temperature[wire] is not None:
            temperature = self.frozen_temperature[wire]
        faults = self.thermocouple_faults[wire]
        internal = 22 * 16  # of the amplifier, in 1/16 °C
        word = (round(4 * temperature) & 0x3FFF) << 18 | internal << 4 | faults
        return struct.pack(">I", word | (0x10000 if faults else 0))

    def read_bend(self) -> bytes:
        if self.bend_is_silent:
            return b""
        sensor = self._twin.parameters.segments[0].bend_sensor
        tangent = np.rad2deg(sensor.reading(self.reading("bend_angle")[0]))
        noise = random.gauss(0.0, 0.05)  # below the twin's steps, like every converter's
        data = struct.pack("<bh", 0, round(64 * (tangent + noise)))
        return data if self.frozen_bend is None else self.frozen_bend

    def set_duty(self, wire: int, duty: float) -> None:
        self._duty[wire] = duty
        self._input.GetMutableData().set_value(np.array(self._duty))
        self._on_duty(*self._duty)

    def feed(self) -> None:
        self.fed = self._clock()

    def reading(self, name: str) -> np.ndarray:
        """The readings at a port of the twin."""
        return self._twin.GetOutputPort(name).Eval(self._context)
