"""The host's end of the cable: sends and receives frames, in separate threads."""

import collections
import contextlib
import dataclasses
import os
import queue
import termios
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
import serial

from hardware.board.reasons import REASONS
from hardware.board.signals import raise_if_interrupted
from hardware.firmware import firmware, from_host, guard, protocol
from limb_systems import LimbError, LimbModel, LimbParameters
from limb_systems.heat_bounds import HeatBounds

BAUD_RATE = 115200
MAX_SAMPLE_AGE = 0.25  # s; an older sample must not be used, nor a command wait longer
MAX_SILENCE = 0.2  # s; if one of several boards is silent for longer, all are switched off
# Largest relative slowness of the board's clock, which may lack a crystal.
# A delay that grows as slowly shows in the answers to commands, which this computer's clock times.
CLOCK_ERROR = 0.025
WRITE_TIMEOUT = 0.2  # s, after which a port must be ready for more
SESSION_END_TIME = 0.5  # s, within which a session without commands has ended
ANSWER_TIME = 1.0  # s, within which a board answers
READING_TIME = 0.5  # s, within which a thermocouple has been read again after a bad frame
ARMING_TIME = 3.0  # s, in which a board that was just switched on has settled
MAX_QUEUED_FRAMES = 8
FRAME_PAUSE = 0.01  # s, between the frames of an arming; many boards buffer only some 60 bytes
RESET_CAUSES = {
    firmware.POWER_ON: "switched on",
    firmware.PIN_RESET: "reset button",
    firmware.WATCHDOG_RESET: "watchdog, because its program hung",
    firmware.SOFT_RESET: "a program",
    firmware.LOCKUP_RESET: "lock-up of its processor",
    firmware.UNKNOWN_RESET: "unknown",
}

# pyserial's own errors are OSErrors, but errors of line settings come from termios.
PORT_ERRORS = (OSError, termios.error)

Answer = TypeVar("Answer")
Predicate = Callable[[], Any]


class HardwareError(LimbError):
    """The board, its cable or its sensors failed; the wires are off."""


@dataclasses.dataclass(frozen=True)
class Sample:
    """The readings and the state of a board at one time.

    - ``received``: time of arrival by this computer's clock, s.
    - ``sequence``: number of the sample, modulo 65536.
    - ``board_time``: time since the start of the board, s.
    - ``challenge``: number that the next arming must repeat.
    - ``armed``: whether the wires may be heated.
    - ``reason``: why they may not, one of the reasons of `hardware.firmware.guard`.
    - ``acknowledged``: sequence of the last command, modulo 65536.
    - ``temperature``: V (W), °C; nan where the amplifier sent no reading.
    - ``tip_tangent``: α (A), as the bend sensors read it, rad.
    - ``duty``: applied (W); the board reduces the command where a wire gets hot, or where the
      sum is too large.
    - ``warmest``: highest temperatures that the wires can have by their heat (W), °C.
    - ``parts``: sample of each board, if this is one of several boards.
    """

    received: float
    sequence: int
    board_time: float
    challenge: int
    armed: bool
    reason: int
    acknowledged: int
    temperature: np.ndarray
    tip_tangent: np.ndarray
    duty: np.ndarray
    warmest: np.ndarray
    parts: tuple["Sample", ...] = ()

    @classmethod
    def of(cls, header: Sequence, bends: Sequence, wires: Sequence, received: float) -> "Sample":
        """Return the sample in frames: a SAMPLE's header and bends, and three numbers per wire."""
        sequence, ticks, challenge, state, reason, acknowledged = header
        quarters, duty, warmest = map(np.array, zip(*wires, strict=True))
        has_reading = quarters != protocol.NO_READING
        return cls(
            received=received,
            sequence=sequence,
            board_time=ticks / 1000,
            challenge=challenge,
            armed=state == guard.ARMED,
            reason=reason,
            acknowledged=acknowledged,
            temperature=np.where(has_reading, quarters / 4, np.nan),
            tip_tangent=np.deg2rad(np.array(bends) / 64),
            duty=duty / protocol.FULL_DUTY,
            warmest=warmest.astype(float),
        )

    @property
    def latched(self) -> bool:
        """True if its reason stays until it is cleared."""
        return self.reason >= guard.LATCHING

    @property
    def age(self) -> float:
        """The time since it was received, s."""
        return time.monotonic() - self.received

    @property
    def reason_text(self) -> str:
        """The reason in words."""
        unknown = f"for a reason that this program does not know, {self.reason}"
        return REASONS.get(self.reason, unknown)


class SampleAssembler:
    """Assembles samples from their frames: a SAMPLE and all its CHANNELS."""

    def __init__(self):
        self._sequence: int | None = None
        self._header: tuple = ()
        self._wires: dict[int, tuple] = {}
        self._num_wires = 1

    def take(self, kind: int, values: tuple, received: float) -> Sample | None:
        """Return the sample that the values of a SAMPLE or CHANNELS complete, or None."""
        # Begin a new sample with a new sequence number.
        if values[0] != self._sequence:
            self._sequence = values[0]
            self._header = ()
            self._wires = {}
        # Store the values of this frame; CHANNELS have three for each wire.
        if kind == protocol.SAMPLE:
            self._header = values
        else:
            _, first, self._num_wires, *numbers = values
            for start in range(0, len(numbers), 3):
                self._wires[first + start // 3] = tuple(numbers[start : start + 3])
        if not self._header or len(self._wires) < self._num_wires:
            return None
        self._sequence = None  # every frame is sent twice: its copy begins another sample
        wires = [self._wires[wire] for wire in range(self._num_wires)]
        return Sample.of(self._header[:6], self._header[6:], wires, received)


@dataclasses.dataclass(frozen=True)
class BoardInfo:
    """The description that a board gives of itself.

    - ``firmware_version``: number of the firmware.
    - ``temperature_limit``: reading at which it switches off, °C.
    - ``serial_number``: number of the board, as text.
    - ``channels``: number of wires that it drives.
    - ``reset_cause``: cause of its last reset, in words.
    - ``angles``: number of bend angles that it measures.
    """

    firmware_version: int
    temperature_limit: float
    serial_number: str
    channels: int
    reset_cause: str
    angles: int = 1


class Closeable:
    """A context manager that closes itself: a connection, or a system that has one."""

    __slots__ = ()  # for Drake's systems, see limb_systems.drake_python

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close it; a second call does nothing."""
        raise NotImplementedError


class SerialPort(Closeable):
    """The host's end of a cable: a serial port that this program alone has."""

    def __init__(self, port: str):
        """
        Args:
            port: name of a serial port, or any URL of pyserial's.

        Raises:
            HardwareError: if it cannot be opened, or another program has it.
        """
        self.port = port
        # Open it, and explain an error in words.
        try:
            self._serial = serial.serial_for_url(
                port, BAUD_RATE, timeout=0.01, write_timeout=WRITE_TIMEOUT, do_not_open=True
            )
            with contextlib.suppress(AttributeError, ValueError):
                self._serial.exclusive = True  # only for ports, not for URLs of sockets
            self._serial.open()
        except (ValueError, *PORT_ERRORS) as error:
            if "exclusively lock" in str(error):
                raise HardwareError(f"{port} is in use by another program.") from error
            reason = _error_text(error)
            if "Could not configure port" in reason:
                reason = "it is no serial port"
            raise HardwareError(
                f"Cannot open {port}: {reason}; soft-limb status lists this computer's ports."
            ) from error

    def send(self, data: bytes) -> None:
        """Send bytes; HardwareError if the cable is gone, or the port not ready in time."""
        self._attempt(lambda: self._serial.write(data))

    def receive(self) -> bytes:
        """Return received bytes, or none after 10 ms; HardwareError if the cable is gone."""
        return self._attempt(lambda: self._serial.read(max(1, self._serial.in_waiting)))

    def now(self) -> float:
        """Return the time, s."""
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(seconds)

    def close(self) -> None:
        """Close the port; a second call does nothing."""
        with contextlib.suppress(*PORT_ERRORS):
            self._serial.close()

    def _attempt(self, action: Callable[[], Any]) -> Any:
        """Return the result of an action at the port; HardwareError if it fails."""
        try:
            return action()
        except serial.SerialTimeoutException as error:
            # pyserial waits after the last byte, too: all bytes may have left.
            raise HardwareError(
                f"{self.port} was not ready for more data within {WRITE_TIMEOUT:g} s of a write; "
                "is the board hung, or this computer too busy?"
            ) from error
        except (TypeError, *PORT_ERRORS) as error:
            raise HardwareError(
                f"The cable to {self.port} is gone: {_error_text(error)}."
            ) from error


def check_port_exists(port: str) -> None:
    """Raise HardwareError if there is no serial port of this name; open none. URLs are not checked.

    Opening a port resets some boards.
    """
    if "://" not in port and not Path(port).exists():
        raise HardwareError(
            f"There is no port {port}; soft-limb status lists this computer's ports."
        )


def _error_text(error: Exception) -> str:
    if isinstance(error, termios.error):
        return str(error.args[-1])
    number = getattr(error, "errno", None)
    return os.strerror(number) if number else str(error)


def _switched_off_message(port: str, sample: Sample) -> str:
    return f"The board on {port} switched off: {sample.reason_text}."


def present_temperature(link: Any) -> np.ndarray:
    """Return V (W,), °C, of a link's newest sample in which every wire has a reading.

    Raises:
        HardwareError: if a wire has none for 0.5 s, or as `BoardLink.sample`.
    """
    end = time.monotonic() + READING_TIME
    while np.isnan((sample := link.sample()).temperature).any():
        if time.monotonic() > end:
            raise HardwareError(
                f"The board on {link.port} has no reading of each wire: {sample.reason_text}; look "
                "at its thermocouples and amplifiers."
            )
        time.sleep(FRAME_PAUSE)
    return sample.temperature


def checked_duty(duty: np.ndarray, num_wires: int) -> np.ndarray:
    """Return a duty (W) as numbers; HardwareError if it is out of [0, 1] or not a number."""
    duty = np.asarray(duty, float)
    if duty.shape != (num_wires,) or not ((duty >= 0) & (duty <= 1)).all():  # false for nan
        raise HardwareError(f"duty is {duty.tolist()}; it must be {num_wires} numbers from 0 to 1.")
    return duty


def check_fit(limb: LimbParameters, board: BoardInfo, port: str) -> None:
    """Raise LimbError unless a board has as many channels and angles as a limb needs."""
    num_wires = len(limb.wires)
    num_bends = LimbModel.of(limb).layout.num_bends
    if (num_wires, num_bends) != (board.channels, board.angles):
        raise LimbError(
            f"This limb has {num_wires} wires and {num_bends} bend angles, but the board on {port} "
            f"has {board.channels} channels and {board.angles} angles; describe the limb that is "
            "on it, or take the port of its board."
        )


def check_heat_is_measured(limb: LimbParameters) -> None:
    """Raise HardwareError if a limb was calibrated without thermocouples, so that none may heat."""
    if not limb.heat_is_measured:
        raise HardwareError(
            "The limb, or a limb of the robot, was calibrated without thermocouples, so that "
            "nobody knows how hot its wires get, and boards refuse to heat it. Bond thermocouples, "
            "collect recordings with the description from before this calibration, and calibrate "
            "and plan again. What is planned with this calibration can be simulated."
        )


def pulls_of(limb: LimbParameters) -> list[int]:
    """Return the pull of each wire (W), a number that `protocol.shares` decodes."""
    pulls = []
    layout = LimbModel.of(limb).layout
    for bends, segment in zip(layout.bends_of, limb.segments, strict=True):
        for wire in segment.wires:
            e3 = wire.e3 if segment.axes == 2 else 0.0
            pulls.append(from_host.pull(bends.start, wire.e2, e3))
    return pulls


def shares_of(limb: LimbParameters) -> np.ndarray:
    """Return the shares of each wire's torque that turn the bend angles (F, W), by the board."""
    pulls = pulls_of(limb)
    num_bends = LimbModel.of(limb).layout.num_bends
    return np.array([protocol.shares(pulls, bend) for bend in range(num_bends)])


class BoardLink(Closeable):
    """A connection to a board. It arms the board only in `arm`.

    Threads read and write. Only `info`, `arm` and `clear` wait for an answer over the cable, at
    most some seconds. Use it as a context manager, or `close` it: both disarm the board.

    - ``lost_samples``: number of samples that did not arrive.
    - ``delay``: travel time of the newest sample, beyond the travel time of the fastest, s.
    - ``when_off``: function that takes a sentence, or None. A thread or a command calls it when
      the board is not armed any more or silent for 0.2 s, a command fails, or the cable is gone.
    """

    def __init__(self, port: str, limb: LimbParameters | None = None):
        """
        Args:
            port: name of a serial port, or any URL of pyserial's.
            limb: limb on the board; the nominal one if None.

        Raises:
            HardwareError: if it cannot be opened, or another program has it.
        """
        self.port = port
        self._limb = limb or LimbParameters()
        self._cable = SerialPort(port)
        self.parser = protocol.Parser(protocol.BOARD_KINDS)
        self._assembly = SampleAssembler()
        self.lost_samples = 0
        self.when_off: Callable[[str], None] | None = None
        self._off_reason = ""  # sentence, if another board is the cause
        self._sample: Sample | None = None
        self._info: BoardInfo | None = None
        # Commands: their session, their sequence, and the commands without an answer.
        self._session = self._sequence = 0
        self._unanswered: collections.deque[tuple[int, float]] = collections.deque(maxlen=100)
        self._clock_offset = np.inf  # s, between both clocks, by the fastest sample
        self.delay = 0.0
        self._restarts = self._restarts_when_armed = 0
        # Start a thread that reads and a thread that writes.
        self._failure: str | None = None
        self._arrived = threading.Condition()
        self._outgoing: queue.Queue[bytes | None] = queue.Queue(MAX_QUEUED_FRAMES)
        self._closing = False
        self._threads = []
        for work in (self._read, self._write):
            thread = threading.Thread(target=work, name=f"{port} {work.__name__}", daemon=True)
            self._threads.append(thread)
            thread.start()

    def info(self) -> BoardInfo:
        """Request the board's description.

        Raises:
            HardwareError: if it does not answer, or speaks another protocol.
        """
        self._send_until([protocol.encode(protocol.HELLO)], lambda: self._info, ANSWER_TIME)
        return self._checked_answer(self._info, "a greeting")

    def sample(self, oldest: float = MAX_SAMPLE_AGE) -> Sample:
        """Return the newest sample.

        Args:
            oldest: largest age and delay of the sample, s. Leave the default if wires are heated.

        Raises:
            HardwareError: if the sample is older or came later, or the cable is gone.
        """
        self._raise_failure()
        self._wait_for(lambda: self._sample, ANSWER_TIME)
        sample = self._checked_answer(self._sample, "after the port was opened")
        if sample.age > oldest:
            raise HardwareError(
                f"Nothing new came from the board on {self.port} for {sample.age:.2f} s."
            )
        if self.delay > oldest:
            raise HardwareError(
                f"Samples from the board on {self.port} come {self.delay:.2f} s late; is this "
                "computer or the connection too busy?"
            )
        return sample

    def next_sample(self) -> Sample:
        """Wait for the sample after the newest one, and return it.

        Raises:
            HardwareError: see `sample`.
        """
        newest = self.sample()
        self._wait_for(lambda: self._sample is not newest, MAX_SAMPLE_AGE)
        return self.sample()

    def arm(self, bounds: Sequence[HeatBounds], total_duty: float = 1.5) -> None:
        """Arm the board: commands heat from now on.

        Args:
            bounds: bounds of all wires, see `LimbParameters.heat_bounds`.
            total_duty: largest sum of all duties.

        Raises:
            HardwareError: if the limb was calibrated without thermocouples, the board refuses,
                with its reason, or another program has armed it.
            KeyboardInterrupt: if a signal has ended the present command.
        """
        raise_if_interrupted()
        check_heat_is_measured(self._limb)
        # Let a session that has no commands end; another program goes on with its session.
        sample = self.sample()
        if sample.armed:
            self._wait_for(lambda: not self._current_sample().armed, SESSION_END_TIME)
            sample = self.sample()
            if sample.armed:
                raise HardwareError(f"The board on {self.port} is in use by another program.")
        if sample.latched:
            raise HardwareError(
                f"The board on {self.port} refuses to be armed: {sample.reason_text}. "
                "Mend it, then clear the fault: soft-limb status PORT --clear."
            )
        # Begin a session, and send its bounds until the board is armed.
        self._session = sample.challenge
        self._sequence = 0
        self._off_reason = ""
        self._unanswered.clear()
        self._restarts_when_armed = self._restarts
        values = list(map(dataclasses.astuple, bounds))
        largest_total = min(total_duty, len(values))  # each duty is at most one
        pulls = pulls_of(self._limb)
        frames = from_host.encode_arming(sample.challenge, values, largest_total, pulls)
        armed = self._send_until(frames, lambda: self._current_sample().armed, ARMING_TIME)
        if not armed:
            raise HardwareError(
                f"The board on {self.port} does not let itself be armed: "
                f"{self.sample().reason_text}."
            )

    def command(self, duty: np.ndarray) -> None:
        """Send a duty (W), in [0, 1]; it holds for 250 ms.

        Raises:
            HardwareError: if the duty is out of range or not a number, the board is not armed,
                samples no longer come, or commands do not arrive in time.
            KeyboardInterrupt: if a signal has ended the present command.
        """
        raise_if_interrupted()
        try:
            self._send_command(duty)
        except HardwareError as error:
            self._report_off(str(error))
            raise

    def _send_command(self, duty: np.ndarray) -> None:
        # Refuse unless the board is armed, answers, and has not been reset.
        sample = self.sample()
        duty = checked_duty(duty, len(sample.duty))
        if self._off_reason:
            raise HardwareError(self._off_reason)
        if not sample.armed:
            raise HardwareError(_switched_off_message(self.port, sample))
        if self._restarts != self._restarts_when_armed:
            raise HardwareError(f"The time of the board on {self.port} went back; reset it.")
        self._check_answers(sample)
        # Send the next command in answer to this sample.
        self._sequence += 1
        self._unanswered.append((self._sequence, time.monotonic()))
        sample_time = round(1000 * sample.board_time)
        frame = from_host.encode_command(self._session, self._sequence, sample_time, duty.tolist())
        self._send(2 * frame)  # a frame may get lost; the board obeys each command once

    def _check_answers(self, sample: Sample) -> None:
        """Raise HardwareError if the oldest command without an answer is too old."""
        # Forget the commands that the sample acknowledges; their sequence is modulo 2**16.
        unanswered = self._unanswered
        while unanswered and (sample.acknowledged - unanswered[0][0]) & 0xFFFF < 0x8000:
            unanswered.popleft()
        if unanswered and (age := time.monotonic() - unanswered[0][1]) > MAX_SAMPLE_AGE:
            raise HardwareError(
                f"The board on {self.port} did not get a command within {age:.2f} s; commands "
                "arrive late or not at all."
            )

    def disarm(self, reason: str = "") -> None:
        """Switch the wires off; do not wait, and never raise.

        Args:
            reason: sentence that the next command raises, if another board is the cause.
        """
        self._off_reason = self._off_reason or reason
        with contextlib.suppress(HardwareError):
            self._send(protocol.encode(protocol.DISARM))

    def clear(self) -> None:
        """Clear a latched fault; the board stays off until it is armed.

        Raises:
            HardwareError: if the fault is still there.
        """
        sample = self.sample()
        if not sample.latched:
            return
        cleared = self._send_until(
            [protocol.encode(protocol.CLEAR, sample.challenge)],
            lambda: not self._current_sample().latched,
            ANSWER_TIME,
        )
        if not cleared:
            reason = self.sample().reason_text
            raise HardwareError(f"The fault of the board on {self.port} is still there: {reason}.")

    def close(self) -> None:
        """Disarm the board and close the port; a second call does nothing."""
        if self._closing:
            return
        # Send the queue, then end both threads.
        reader, writer = self._threads
        for _ in range(3):  # a frame may get lost
            self.disarm()
        with contextlib.suppress(queue.Full):
            self._outgoing.put(None, timeout=0.2)
        writer.join(1.0)
        self._closing = True
        reader.join(1.0)
        self._cable.close()

    def _send_until(self, frames: Sequence[bytes], is_done: Predicate, limit: float) -> bool:
        """Send frames, which may get lost, until something is done; return whether it is."""
        end = time.monotonic() + limit
        while time.monotonic() < end:
            for number, frame in enumerate(frames):
                time.sleep(FRAME_PAUSE if number else 0.0)
                self._send(frame)
            if self._wait_for(is_done, 0.1):
                break
        self._raise_failure()
        return bool(is_done())

    def _wait_for(self, is_done: Predicate, limit: float) -> bool:
        """Wait until something is done or the cable is gone; return False after the limit, s."""
        with self._arrived:
            return bool(self._arrived.wait_for(lambda: is_done() or self._failure, limit))

    def _current_sample(self) -> Sample:
        assert self._sample  # every caller had a sample before
        return self._sample

    def _checked_answer(self, answer: Answer | None, request: str) -> Answer:
        """Return the board's answer to a request; HardwareError if there is none."""
        self._raise_failure()
        if answer:
            return answer
        version = self.parser.other_version
        if version is not None:
            advice = "use a newer version of this program."
            if version < protocol.VERSION:
                advice = "flash the board with the firmware of this program."
            raise HardwareError(
                f"The board on {self.port} speaks version {version} of the protocol, but this "
                f"program version {protocol.VERSION}; {advice}"
            )
        raise HardwareError(f"The board on {self.port} does not answer {request}.")

    def _raise_failure(self) -> None:
        if self._failure:
            raise HardwareError(self._failure)

    def _send(self, frame: bytes) -> None:
        try:
            self._outgoing.put_nowait(frame)
        except queue.Full as error:
            raise HardwareError(f"{self.port} takes no more data; is the board hung?") from error

    def _fail(self, error: HardwareError) -> None:
        with self._arrived:
            if self._failure:
                return
            self._failure = str(error)
            self._arrived.notify_all()
        self._report_off(str(error))

    def _report_off(self, reason: str) -> None:
        if self.when_off:
            self.when_off(reason)

    def _check_silence(self) -> None:
        """Report once if this is one of several boards, and no sample came for 0.2 s."""
        sample = self._sample
        if not (self.when_off and sample and sample.armed) or self._off_reason:
            return
        if sample.age > MAX_SILENCE:
            reason = f"Nothing new came from the board on {self.port} for {MAX_SILENCE:g} s."
            self._report_off(reason)

    def _write(self) -> None:
        while (frame := self._outgoing.get()) is not None:
            try:
                self._cable.send(frame)
            except HardwareError as error:
                self._fail(error)

    def _read(self) -> None:
        while not self._closing:
            try:
                data = self._cable.receive()
            except HardwareError as error:
                self._fail(error)
                return
            for kind, values in self.parser.feed(data):
                with self._arrived:
                    self._handle(kind, values)
                    self._arrived.notify_all()
            self._check_silence()

    def _handle(self, kind: int, values: tuple) -> None:
        """Store the values of a frame from the board."""
        if kind == protocol.INFO:
            self._info = _board_info(values)
            return
        sample = self._assembly.take(kind, values, time.monotonic())
        if sample is None:
            return
        # Compare the sample with the previous sample: copies, losses and restarts.
        previous = self._sample
        if previous is not None:
            step = (sample.sequence - previous.sequence) & 0xFFFF
            if step == 0 or sample.board_time == previous.board_time:
                return  # a copy
            self.lost_samples += step - 1 if step < 0x8000 else 0
            if sample.board_time < previous.board_time:  # it was restarted, or sends old samples
                self._restarts += 1
                self._clock_offset = np.inf
            self._clock_offset += CLOCK_ERROR * (sample.received - previous.received)
        # The fastest sample gives the offset of the board's clock; others are delayed.
        offset = sample.received - sample.board_time
        self._clock_offset = min(self._clock_offset, offset)
        self.delay = offset - self._clock_offset
        self._sample = sample
        if previous and previous.armed and not sample.armed:
            self._report_off(_switched_off_message(self.port, sample))


def _board_info(values: tuple) -> BoardInfo:
    """Return the description in the values of an INFO."""
    version, _, limit_quarters, number, channels, angles, cause = values
    text = number.rstrip(b"\0")
    name = text.decode() if text.isalnum() else number.hex()
    cause = RESET_CAUSES.get(cause, f"unknown ({cause})")
    return BoardInfo(version, limit_quarters / 4, name, channels, cause, angles)
