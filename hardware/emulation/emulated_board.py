"""An emulated board with an emulated limb on it, for the firmware to run on.

The sensors answer with the bytes of real sensors. The limb is a `LimbTwin` that is simulated
along a clock. Faults of its sensors can be injected.
"""

import dataclasses
import random
import struct
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hardware.emulation.sensors import THERMOCOUPLE_NOISE
from hardware.emulation.twin import EmulatedSystem
from hardware.firmware.firmware import POWER_ON
from hardware.firmware.protocol import MOST_ANGLES, MOST_CHANNELS
from limb_systems import LimbError, LimbModel
from limb_systems.simulation import make_simulator

LIMB_PERIOD = 0.02  # s; the limb is simulated in multiples of it
AMPLIFIER_WARMTH = 1.0  # °C above the room
SUPPLY_TIME = 0.1  # s, for which the charge pump holds the supply's relay


@dataclasses.dataclass
class Thermocouple:
    """The faults of a thermocouple, none by default.

    - ``faults``: fault bits of its amplifier.
    - ``frozen``: constant reading, °C.
    - ``share``: reading above the room over the temperature above the room; -1 if it is reversed,
      0 if it has come off the wire.
    - ``offset``, ``drift``: error of the reading, °C, and rate at which the error grows, °C/s.
    - ``noise``: standard deviation of additional noise, °C.
    - ``word``: constant word from its amplifier.
    - ``bad_frames``: number of next frames that are as from an open thermocouple.
    """

    faults: int = 0
    frozen: float | None = None
    share: float = 1.0
    offset: float = 0.0
    drift: float = 0.0
    noise: float = 0.0
    word: int | None = None
    bad_frames: int = 0


class RunningTwin:
    """An emulated limb or robot that its boards simulate step by step."""

    def __init__(self, twin: EmulatedSystem):
        self.twin: Any = twin
        self._simulator = make_simulator(twin, twin.accuracy)
        self._context = self._simulator.get_mutable_context()
        duty = twin.GetInputPort("duty")
        self.duty = np.zeros(duty.size())  # D (W) of all wires, for boards to set
        self._input = duty.FixValue(self._context, self.duty)
        self._begin()

    def limb_part(self, limb: str) -> tuple[Any, slice]:
        """Return parameters and wires of a robot's limb by name, or of all if it is empty."""
        if not limb:
            return self.twin.parameters, slice(None)
        robot = self.twin.robot
        names = [each.name for each in robot.limbs]
        return robot.limb(limb), robot.wires_of[names.index(limb)]

    def cool(self) -> None:
        """Bring it back to its initial state: cold and at rest."""
        self.twin.SetDefaultContext(self._context)
        self._begin()

    def _begin(self) -> None:
        self.twin.without_cut_out(self._context)  # the firmware switches off instead
        self._simulator.Initialize()

    def advance(self, time: float) -> None:
        """Simulate up to a time, s, since it was made, unless the simulation is there."""
        if time > self._context.get_time():
            self._input.GetMutableData().set_value(self.duty)
            self._simulator.AdvanceTo(time)

    def reading(self, name: str) -> np.ndarray:
        """Return the readings at a port."""
        return self.twin.GetOutputPort(name).Eval(self._context)

    def wire_temperature(self) -> np.ndarray:
        """Return T (W), °C, which no board can read."""
        wires = self.twin.GetSubsystemByName("shape_memory_wires")
        return wires.GetOutputPort("wire_temperature").Eval(
            wires.GetMyContextFromRoot(self._context)
        )


class EmulatedBoard:
    """A board for `firmware.Firmware`, with the wires and bend angles of a limb or a robot.

    A robot's limb, by name, may also have this board while other limbs have boards of their own.
    ``on_duty(duty)`` is called with the duties of all wires whenever a pin changes;
    ``clock()`` returns the time, s, along which the limb is simulated.

    Raises:
        LimbError: at construction, if the limb has more wires or bend angles than a
            board may have.
    """

    def __init__(
        self,
        twin: EmulatedSystem | RunningTwin,
        on_duty: Callable[[Sequence[float]], None],
        clock: Callable[[], float] = time.monotonic,
        limb: str = "",
    ):
        # Take the whole of a limb or robot, or one limb of a robot.
        self._running = twin if isinstance(twin, RunningTwin) else RunningTwin(twin)
        self._prefix = f"{limb}." if limb else ""
        self._wires: slice
        self.parameters, self._wires = self._running.limb_part(limb)
        self.channels = len(self.reading("measured_temperature"))
        self.angles = len(self.reading("bend_angle"))
        if self.channels > MOST_CHANNELS or self.angles > MOST_ANGLES:
            raise LimbError(
                f"An emulated board has at most {MOST_CHANNELS} channels and {MOST_ANGLES} bend "
                f"angles; this limb has {self.channels} wires and {self.angles} bend angles."
            )
        # Time, duty and sensors.
        self._clock = clock
        self._start = clock()
        self._on_duty = on_duty
        self._duty = [0.0] * self.channels
        segments = self.parameters.segments
        layout = LimbModel.of(self.parameters).layout
        self._sensors = [segments[number].bend_sensor for number in layout.bend_segment]
        # The attributes of a board that `firmware` lists.
        self.to_host = bytearray()
        self.from_host = bytearray()
        self.serial_number = self.parameters.board.serial_number.encode()
        self.random = random.SystemRandom().getrandbits(16)
        self.reset_cause = POWER_ON
        self.remembered = 0
        self._supply_held_at = clock()
        self.mend()
        self.feed()

    def mend(self) -> None:
        """Remove all faults of sensors, supply and MOSFETs."""
        self.thermocouples = [Thermocouple() for _ in range(self.channels)]
        self._faulty_since = self._clock()
        self._stopped_at: int | None = None
        self.frozen_bend: bytes | None = None
        self.stuck_bend: list[float] = []  # degrees of each angle, to which noise is added
        self.bend_is_silent = False
        self.heat_share = 1.0  # heat over the heat of a correct supply
        self.chill = 0.0  # °C, error by which amplifiers read their own temperature too low
        self.shorted = [False] * self.channels  # MOSFETs that conduct
        self._heat()

    def fail(self, wire: int, **faults: Any) -> None:
        """Add faults to a thermocouple, see `Thermocouple`."""
        self.thermocouples[wire] = dataclasses.replace(self.thermocouples[wire], **faults)
        self._faulty_since = self._clock()

    def stop_clock(self) -> None:
        """Stop the board's clock, while the limb's clock goes on."""
        self._stopped_at = self.ticks()

    def cool(self) -> None:
        """Bring the limb or robot back to its initial state: cold and at rest."""
        self._running.cool()

    def advance(self) -> None:
        """Simulate the limb up to the last multiple of `LIMB_PERIOD`.

        Other times would lead to steps below the integrator's smallest step between the updates of
        the twin's parts. The integrator makes such steps explicitly, and a few of them in a row
        lead to nan, because the limb is stiff.
        """
        self._heat()
        periods = int((self._clock() - self._start) / LIMB_PERIOD + 1e-6)
        self._running.advance(periods * LIMB_PERIOD)

    def _heat(self) -> None:
        """Heat the wires by the duty at the pins, and by the faults of MOSFETs and supply."""
        supplied = self._clock() - self._supply_held_at < SUPPLY_TIME
        heat = np.where(self.shorted, 1.0, self.heat_share * np.array(self._duty))
        self._running.duty[self._wires] = heat * supplied

    def ticks(self) -> int:
        now = round(1000 * (self._clock() - self._start))
        return now if self._stopped_at is None else self._stopped_at

    def receive(self) -> bytes:
        data = bytes(self.from_host)
        self.from_host.clear()
        return data

    def send(self, data: bytes) -> None:
        self.to_host += data

    def read_thermocouple(self, wire: int) -> bytes:
        room = self._running.twin.specimen.ambient
        fault = self.thermocouples[wire]
        # Add the faults to the temperature.
        temperature = self.reading("measured_temperature")[wire]
        if fault.share == 0:
            temperature = random.gauss(room, THERMOCOUPLE_NOISE)
        temperature = room + fault.share * (temperature - room) + fault.offset
        temperature += fault.drift * (self._clock() - self._faulty_since)
        temperature += random.gauss(0.0, fault.noise) if fault.noise else 0.0
        if fault.frozen is not None:
            temperature = fault.frozen
        # Encode it as a MAX31855 does, with the amplifier's own temperature and fault bits.
        junction = round(16 * (room + AMPLIFIER_WARMTH - self.chill)) & 0xFFF
        quarters = round(4 * (temperature - self.chill)) & 0x3FFF
        faults = fault.faults
        if fault.bad_frames:
            fault.bad_frames -= 1
            faults |= 1
        word = quarters << 18 | junction << 4 | faults
        word |= 0x10000 if faults else 0
        return struct.pack(">I", word if fault.word is None else fault.word)

    def read_bend(self) -> bytes:
        if self.bend_is_silent:
            return b""
        if self.frozen_bend is not None:
            return self.frozen_bend
        # A byte 0, then each angle of the tip's tangent in 1/64 degree, as `firmware` says.
        data = b"\0"
        for index, bend_angle in enumerate(self.reading("bend_angle")):
            sensor = self._sensors[index]
            if self.stuck_bend:
                noise_deg = float(np.rad2deg(sensor.reading(sensor.noise)))  # of the tangent
                tangent_deg = self.stuck_bend[index] + random.gauss(0.0, noise_deg)
            else:
                tangent_deg = np.rad2deg(sensor.reading(bend_angle))
            # An emulated limb moves in steps; a converter's noise changes the last bits between.
            tangent_deg += random.gauss(0.0, 0.05)
            data += struct.pack("<h", round(64 * tangent_deg))
        return data

    def set_duty(self, wire: int, duty: float) -> None:
        self._duty[wire] = duty
        self._heat()
        self._on_duty(self._duty)

    def keep_supply(self) -> None:
        self._supply_held_at = self._clock()

    def feed(self) -> None:
        self.fed = self.ticks()

    def remember(self, reason: int) -> None:
        self.remembered = reason

    def reset(self, cause: int) -> None:
        """Reset the board, for one of the causes that `firmware` lists."""
        for wire in range(self.channels):
            self.set_duty(wire, 0.0)  # like the pins of a board in reset
        if cause == POWER_ON:
            self.remembered = 0
        self.reset_cause = cause
        self.random = random.SystemRandom().getrandbits(16)
        self.feed()

    def reading(self, name: str) -> np.ndarray:
        """Return the readings at a port of the twin, or of its limb on this board."""
        return self._running.reading(self._prefix + name)

    def wire_temperature(self) -> np.ndarray:
        """Return T (W), °C, which no board can read."""
        return self._running.wire_temperature()[self._wires]
