"""A limb on a serial port, as a system with the ports of `Limb`."""

import dataclasses
import time
from pathlib import Path

import numpy as np
from pydrake.systems.framework import LeafSystem

from hardware.board.link import (
    MAX_SAMPLE_AGE,
    Closeable,
    HardwareError,
    check_fit,
    check_heat_is_measured,
)
from hardware.board.several_boards import Ports, SeveralBoards, open_link
from limb_systems import LimbModel, LimbParameters, NoBoard, SerialBoard
from limb_systems.drake_python import declare_state_output, weak_method
from limb_systems.limb_system import ACCURACY
from limb_systems.simulation import PERIOD

MAX_COMMAND_DELAY = 0.1  # s; a command that is later ends the simulation
COMMAND_DEADLINE = 5e-3  # s; a command that is later counts as missed
MAX_SAMPLE_GAP = 3.0  # s without samples, which end the recording of a limb without heat


class SerialLimb(LeafSystem, Closeable):
    """The robot: a board with a limb's wires, their thermocouples and its bend sensors.

    It may also be several boards, each with a limb of a robot. They are all armed before any of
    them heats, are commanded in the same tick, and are all switched off when one is.

    For a limb of W wires and F bend angles, or all limbs together:

    - input 0 ``duty``: D (W), in [0, 1]
    - output 0 ``measured_temperature``: V (W), °C; nan while an amplifier sends no reading
    - output 1 ``bend_angle``: φ (F), rad, by each segment's ``bend_sensor`` from the board's
      reading, such as α/2
    - output 2 ``sample_age``: time since the sample was received, s; the longest of all boards
    - output 3 ``applied_duty``: the duty that the board had applied at the sample (W)
    - output 4 ``board_time``: time from the start of the (first) board to the sample, s
    - output 5 ``measurement``: [V (W), φ (F)]
    - further outputs, of several boards, ``NAME.sample_age``: sample age of each limb's board, s
    - state, discrete, at 20 Hz: [V (W), φ (F), applied duty (W), board time, time of
      reception on the simulation's clock, then time of reception from each of several boards]

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
            port: name of a serial port, or any URL that pyserial accepts; or the ports of
                several boards by the names of their limbs.
            parameters: parameters of the limb, or their YAML file; the nominal limb if None;
                for a robot `RobotParameters.as_single_limb`.
            heated: whether the board is armed. If not, the limb is only watched
                and its ``duty`` ignored, for example for teaching.

        Raises:
            HardwareError: if no board with a known firmware answers.
            HardwareError: if it is heated, and was calibrated without thermocouples.
            LimbError: if the limb has not as many wires and bend angles as the board.
        """
        super().__init__()
        # Connect to the board, and see that it is made for the limb.
        self.parameters = LimbParameters.of(parameters)
        if heated:
            check_heat_is_measured(self.parameters)
        self.link = open_link(port, self.parameters)
        try:
            self.info = self.link.info()
            check_fit(self.parameters, self.info, self.link.port)
            self.link.sample()
            self._declare(port, heated)
        except BaseException:  # a signal, too
            self.link.close()
            raise

    def _declare(self, port: Ports, heated: bool) -> None:
        """Set the attributes; declare state, events and ports, see the class."""
        if isinstance(self.parameters.board, NoBoard):
            self.parameters.board = SerialBoard(self.info.serial_number)
        self.port = port
        self.source = f"limb {self.info.serial_number} on {self.link.port}"
        self.timing_errors: list[float] = []
        self._heated = heated
        self._start = 0.0  # time of the computer's clock at which the simulation's begins, s
        self._failure: HardwareError | None = None
        self._failure_is_recorded = False
        # Declare the state, whose numbers the class lists, and its updates.
        layout = LimbModel.of(self.parameters).layout
        segments = self.parameters.segments
        self._bend_sensors = [segments[number].bend_sensor for number in layout.bend_segment]
        num_wires = layout.num_wires
        num_readings = num_wires + layout.num_bends
        board_time = num_readings + num_wires  # index in the state
        received = board_time + 1
        board_names = self.link.names if isinstance(self.link, SeveralBoards) else []
        self.DeclareVectorInputPort("duty", num_wires)
        state = self.DeclareDiscreteState(received + 1 + len(board_names))
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._begin))
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, weak_method(self._command))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))
        # Declare the outputs, which show parts of the state.
        declare_state_output(self, "measured_temperature", state, slice(0, num_wires))
        declare_state_output(self, "bend_angle", state, slice(num_wires, num_readings))
        tickets = {self.discrete_state_ticket(state), self.time_ticket()}
        self.DeclareVectorOutputPort("sample_age", 1, _sample_age_output(received), tickets)
        declare_state_output(self, "applied_duty", state, slice(num_readings, board_time))
        declare_state_output(self, "board_time", state, slice(board_time, received))
        declare_state_output(self, "measurement", state, slice(0, num_readings))
        for index, name in enumerate(board_names, received + 1):
            calc_age = _sample_age_output(index)
            self.DeclareVectorOutputPort(f"{name}.sample_age", 1, calc_age, tickets)

    def close(self) -> None:
        """Switch the wires off and close the port."""
        self.link.close()

    def _begin(self, context, discrete_state):
        if self._heated:
            self.link.arm(self.parameters.heat_bounds, self.parameters.total_duty)
        self.timing_errors.clear()
        self._failure = None
        self._failure_is_recorded = False
        self._start = time.monotonic() - context.get_time()
        self._update(context, discrete_state)

    def _command(self, context):
        if not self._heated or self._failure:
            return
        delay = time.monotonic() - self._start - context.get_time()
        self.timing_errors.append(delay)
        if delay > MAX_COMMAND_DELAY:
            raise HardwareError(
                f"The simulation fell behind by {delay:.2f} s at {context.get_time():.2f} s; the "
                "computer is too busy to drive the limb."
            )
        duty = self.get_input_port().Eval(context)
        try:
            self.link.command(duty)
        except HardwareError as error:
            self.link.disarm()
            self._failure = error

    def _update(self, context, discrete_state):
        # A failure is raised a period late, so that the sample before it is recorded.
        if self._failure_is_recorded:
            assert self._failure
            raise self._failure
        self._failure_is_recorded = self._failure is not None
        sample = self.link.sample() if self._heated else self.link.sample(MAX_SAMPLE_GAP)
        # A limb without heat goes on with readings of nan while samples are missing.
        if not self._heated and sample.age > MAX_SAMPLE_AGE:
            sample = dataclasses.replace(
                sample,
                temperature=np.full_like(sample.temperature, np.nan),
                tip_tangent=np.full_like(sample.tip_tangent, np.nan),
            )
        # Write the state, in the order that the class lists.
        received = [each.received - self._start for each in (sample, *sample.parts)]
        bend_angles = [
            sensor.bend_angle(reading)
            for sensor, reading in zip(self._bend_sensors, sample.tip_tangent, strict=True)
        ]
        others = [*bend_angles, *sample.duty, sample.board_time, *received]
        discrete_state.set_value(np.append(sample.temperature, others))


def _sample_age_output(index: int):
    """Return a function that calculates a sample's age from its time in the state (index)."""

    def calc_age(context, output):
        received = context.get_discrete_state_vector().value()[index]
        output.SetFromVector([max(0.0, context.get_time() - received)])

    return calc_age
