"""A limb on a serial port, as a system with the ports of `Limb`."""

import dataclasses
import time
from pathlib import Path

import numpy as np
from pydrake.systems.framework import LeafSystem

from hardware.board.link import STALE, Closed, HardwareError, check_fit, check_heat_is_measured
from hardware.board.several_boards import Ports, SeveralBoards, open_link
from limb_systems import LimbModel, LimbParameters, NoBoard, SerialBoard
from limb_systems.drake_python import declare_part, weak_method
from limb_systems.limb_system import ACCURACY
from limb_systems.simulation import PERIOD

LATEST = 0.1  # s, that a command may be late
DEADLINE = 5e-3  # s, by which it is late for the record
LONGEST_GAP = 3.0  # s without samples, after which a limb without heat is not recorded on


class SerialLimb(LeafSystem, Closed):
    """The robot: a board with a limb's wires, their thermocouples and its bend sensors.

    Or several boards, each with a limb of a robot: they are armed before any of them heats,
    are commanded in the same tick, and are all switched off when one is.

    For a limb of W wires and F bend angles, or all limbs together:

    - input 0 ``duty``: D (W), in [0, 1]
    - output 0 ``measured_temperature``: V (W), °C; nan while an amplifier sends no reading
    - output 1 ``bend_angle``: φ (F), rad, what each segment's ``bend_sensor`` makes of
      the board's reading, such as α/2
    - output 2 ``sample_age``: time since the sample was received, s; the longest of all boards
    - output 3 ``applied_duty``: the duty that the board had applied at the sample (W)
    - output 4 ``board_time``: time from the start of the (first) board to the sample, s
    - output 5 ``measurement``: [V (W), φ (F)]
    - further outputs, of several boards, ``NAME.sample_age``: that of each limb's board, s
    - state, discrete, at 20 Hz: [V (W), φ (F), applied duty (W), board time, time of
      reception on the simulation's clock, then those of each of several boards]

    The outputs hold the last sample; only its age increases between samples. The
    board is armed at initialization. Once per period a new duty is sent from the
    thread of the Simulator, which does not wait for the cable.

    Simulate it in real time, as `limb_systems.simulation.record` does. The
    simulation ends with a `HardwareError` if the board switches off, samples are
    older than 0.25 s or come late, commands are not answered, the duty is out of
    range, or the simulation is more than 0.1 s late. For a period before that, the
    outputs show the last sample, so that it is recorded. To switch the wires off,
    call `close` or use the system as a context manager. If this process dies, the
    board switches off after 250 ms.

    A limb that is only watched goes on without samples for up to 3 s: readings are nan from
    0.25 s on, and come again with the next sample.

    ``timing_errors`` has the delay of each command, s.
    """

    __slots__ = ()  # see limb_systems.drake_python

    real_time = True
    accuracy: float | None = ACCURACY

    def __init__(
        self,
        port: Ports,
        parameters: LimbParameters | str | Path | None = None,
        *,
        heated: bool = True,
    ):
        """
        Args:
            port: name of a serial port, or any URL that pyserial accepts; or those of several
                boards by their limbs' names.
            parameters: parameters of the limb, as far as they are known, or their YAML file;
                the nominal limb if None. Of a robot, `RobotParameters.together`.
            heated: whether the board is armed. If not, the limb is only watched
                and its ``duty`` ignored, for example for teaching.

        Raises:
            HardwareError: if no board with a known firmware answers.
            HardwareError: if it is heated, and was calibrated without thermocouples.
            LimbError: if the limb has not as many wires and bend angles as the board.
        """
        super().__init__()
        self.parameters = LimbParameters.of(parameters)
        if heated:
            check_heat_is_measured(self.parameters)
        self.link = open_link(port, self.parameters)
        try:
            self.info = self.link.info()
            check_fit(self.parameters, self.info, self.link.port)
            self.link.sample()
        except BaseException:  # a signal, too
            self.link.close()
            raise
        if isinstance(self.parameters.board, NoBoard):
            self.parameters.board = SerialBoard(self.info.serial_number)
        self.port, self.source = port, f"limb {self.info.serial_number} on {self.link.port}"
        self.timing_errors: list[float] = []
        self._heated, self._start = heated, 0.0
        self._failure: HardwareError | None = None
        self._failure_is_recorded = False
        layout = LimbModel.of(self.parameters).layout
        segments = [self.parameters.segments[n] for n in layout.bend_segment]
        self._bend_sensors = [segment.bend_sensor for segment in segments]
        wires, angles = len(self.parameters.wires), len(segments)
        self.DeclareVectorInputPort("duty", wires)
        boards = self.link.names if isinstance(self.link, SeveralBoards) else []
        size = 2 * wires + angles + 2
        state = self.DeclareDiscreteState(size + len(boards))
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._begin))
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, weak_method(self._command))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))
        read = wires + angles
        declare_part(self, "measured_temperature", state, slice(0, wires))
        declare_part(self, "bend_angle", state, slice(wires, read))
        tickets = {self.discrete_state_ticket(state), self.time_ticket()}
        self.DeclareVectorOutputPort("sample_age", 1, _shown_age(size - 1), tickets)
        declare_part(self, "applied_duty", state, slice(read, read + wires))
        declare_part(self, "board_time", state, slice(read + wires, read + wires + 1))
        declare_part(self, "measurement", state, slice(0, read))
        for place, name in enumerate(boards, size):
            self.DeclareVectorOutputPort(f"{name}.sample_age", 1, _shown_age(place), tickets)

    def close(self) -> None:
        """Switches the wires off and closes the port."""
        self.link.close()

    def _begin(self, context, discrete_state):
        if self._heated:
            self.link.arm(self.parameters.heat_bounds, self.parameters.total_duty)
        self.timing_errors.clear()
        self._failure, self._failure_is_recorded = None, False
        self._start = time.monotonic() - context.get_time()
        self._update(context, discrete_state)

    def _command(self, context):
        if not self._heated or self._failure:
            return
        late = time.monotonic() - self._start - context.get_time()
        self.timing_errors.append(late)
        if late > LATEST:
            raise HardwareError(
                f"The simulation fell behind by {late:.2f} s at {context.get_time():.2f} s; the "
                "computer is too busy to drive the limb."
            )
        duty = self.get_input_port().Eval(context)
        try:
            self.link.command(duty)
        except HardwareError as error:
            self.link.disarm()
            self._failure = error

    def _update(self, context, discrete_state):
        if self._failure_is_recorded:
            assert self._failure
            raise self._failure
        self._failure_is_recorded = self._failure is not None
        sample = self.link.sample() if self._heated else self.link.sample(LONGEST_GAP)
        if not self._heated and sample.age > STALE:
            sample = dataclasses.replace(
                sample,
                temperature=np.full_like(sample.temperature, np.nan),
                tip_tangent=np.full_like(sample.tip_tangent, np.nan),
            )
        received = [each.received - self._start for each in (sample, *sample.parts)]
        bend_angles = [
            sensor.bend_angle(reading)
            for sensor, reading in zip(self._bend_sensors, sample.tip_tangent, strict=True)
        ]
        last = [*bend_angles, *sample.duty, sample.board_time, *received]
        discrete_state.set_value(np.append(sample.temperature, last))


def _shown_age(place: int):
    """A function that shows the age of a sample whose reception is at a place of the state."""

    def show(context, output):
        received = context.get_discrete_state_vector().value()[place]
        output.SetFromVector([max(0.0, context.get_time() - received)])

    return show
