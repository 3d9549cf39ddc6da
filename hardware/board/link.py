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
from typing import Any, Self, TypeVar

import numpy as np
import serial

from hardware.board.reasons import REASONS
from hardware.board.signals import heed_signals
from hardware.firmware import firmware, from_host, guard, protocol
from limb_systems import LimbError, LimbModel, LimbParameters
from limb_systems.heat_bounds import HeatBounds

BAUD_RATE = 115200
STALE = 0.25  # s, age after which a sample must not be used, nor a command be unanswered
SILENT = 0.2  # s without a sample of one of several boards, after which the others are switched off
# Share by which the board's clock may be slower than this computer's, as without a crystal.
# A delay that grows as slowly as that shows by answers to commands, which this clock times.
CLOCK_ERROR = 0.025
WRITE_TIMEOUT = 0.2  # s, after which a port must be ready for more
SESSION_END = 0.5  # s, within which a session that nobody commands has ended
ANSWER_TIME = 1.0  # s, within which a board answers
READING_TIME = 0.5  # s, within which a thermocouple has been read again after a bad frame
ARMING_TIME = 3.0  # s, in which a board that was just switched on has settled
WAITING_FRAMES = 8
FRAME_PAUSE = 0.01  # s, between those that arm, as many boards keep some 60 bytes that come
RESET_CAUSES = {
    firmware.POWER_ON: "switched on",
    firmware.PIN_RESET: "reset button",
    firmware.WATCHDOG_RESET: "watchdog, because its program hung",
    firmware.SOFT_RESET: "a program",
    firmware.LOCKUP_RESET: "lock-up of its processor",
    firmware.UNKNOWN_RESET: "unknown",
}

# pyserial's own errors are OSErrors, but it lets through those of line settings.
PORT_ERRORS = (OSError, termios.error)

Answer = TypeVar("Answer")


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
    - ``duty``: applied (W); the board reduces what was commanded where a wire
      gets hot, or all of them ask for too much.
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
        """The sample in frames: values that begin a SAMPLE, all angles, and three of each wire."""
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
        """Whether its reason stays until it is cleared."""
        return self.reason >= guard.LATCHING

    @property
    def age(self) -> float:
        """Time since it was received, s."""
        return time.monotonic() - self.received

    @property
    def reason_text(self) -> str:
        """The reason in words."""
        unknown = f"for a reason that this program does not know, {self.reason}"
        return REASONS.get(self.reason, unknown)


class Assembly:
    """Puts samples together: one counts only if its SAMPLE and all its CHANNELS came."""

    def __init__(self):
        self._sequence: int | None = None
        self._header: tuple = ()
        self._wires: dict[int, tuple] = {}
        self._count = 1

    def take(self, kind: int, values: tuple, received: float) -> Sample | None:
        """The sample that the values of a SAMPLE or CHANNELS complete, or None."""
        if values[0] != self._sequence:
            self._sequence, self._header, self._wires = values[0], (), {}
        if kind == protocol.SAMPLE:
            self._header = values
        else:
            _, first, self._count, *parts = values
            for wire, part in enumerate(zip(*3 * [iter(parts)], strict=True), first):
                self._wires[wire] = part
        if not self._header or len(self._wires) < self._count:
            return None
        self._sequence = None  # its copy is another one
        wires = [self._wires[wire] for wire in range(self._count)]
        return Sample.of(self._header[:6], self._header[6:], wires, received)


@dataclasses.dataclass(frozen=True)
class BoardInfo:
    """A board's description of itself.

    - ``firmware_version``: number of the firmware.
    - ``sample_period``: time between two samples, s.
    - ``temperature_limit``: reading at which it switches off, °C.
    - ``serial_number``: number of the board, as text.
    - ``channels``: number of wires that it drives.
    - ``reset_cause``: cause of its last reset, in words.
    - ``angles``: number of bend angles that it measures.
    """

    firmware_version: int
    sample_period: float
    temperature_limit: float
    serial_number: str
    channels: int
    reset_cause: str
    angles: int = 1


class Closed:
    """What is closed at the end of its context: a connection, or a system that has one."""

    __slots__ = ()  # for Drake's systems, see limb_systems.drake_python

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends it; a second call does nothing."""
        raise NotImplementedError


class SerialPort(Closed):
    """The host's end of a cable: a serial port that this program alone has."""

    def __init__(self, port: str):
        """
        Args:
            port: name of a serial port, or any URL of pyserial's.

        Raises:
            HardwareError: if it cannot be opened, or another program has it.
        """
        self.port = port
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
            reason = _in_words(error)
            if "Could not configure port" in reason:
                reason = "it is no serial port"
            raise HardwareError(
                f"Cannot open {port}: {reason}; soft-limb status lists those of this computer."
            ) from error

    def send(self, data: bytes) -> None:
        """Send bytes; HardwareError if the cable is gone, or the port not ready in time."""
        self._do(lambda: self._serial.write(data))

    def receive(self) -> bytes:
        """The bytes that came, or none within 10 ms; HardwareError if the cable is gone."""
        return self._do(lambda: self._serial.read(max(1, self._serial.in_waiting)))

    def now(self) -> float:
        """Time, s."""
        return time.monotonic()

    def wait(self, seconds: float) -> None:
        """Lets time pass."""
        time.sleep(seconds)

    def close(self) -> None:
        """Closes the port; a second call does nothing."""
        with contextlib.suppress(*PORT_ERRORS):
            self._serial.close()

    def _do(self, action: Callable[[], Any]) -> Any:
        try:
            return action()
        except serial.SerialTimeoutException as error:
            # It waits after the last byte, too: all of them may have left.
            raise HardwareError(
                f"{self.port} was not ready for more data within {WRITE_TIMEOUT:g} s of a write; "
                "is the board hung, or this computer too busy?"
            ) from error
        except (TypeError, *PORT_ERRORS) as error:
            raise HardwareError(f"The cable to {self.port} is gone: {_in_words(error)}.") from error


def _in_words(error: Exception) -> str:
    if isinstance(error, termios.error):
        return str(error.args[-1])
    number = getattr(error, "errno", None)
    return os.strerror(number) if number else str(error)


def _switched_off(port: str, sample: Sample) -> str:
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
    """A duty (W); HardwareError if it is out of [0, 1] or not a number."""
    duty = np.asarray(duty, float)
    if duty.shape != (num_wires,) or not ((duty >= 0) & (duty <= 1)).all():  # NaN is not
        raise HardwareError(f"duty is {duty.tolist()}; it must be {num_wires} numbers from 0 to 1.")
    return duty


def check_fit(limb: LimbParameters, board: BoardInfo, port: str) -> None:
    """Raises LimbError unless a board has what a limb needs, and nothing else."""
    wires, angles = len(limb.wires), LimbModel.of(limb).layout.num_bends
    if (wires, angles) != (board.channels, board.angles):
        raise LimbError(
            f"This limb has {wires} wires and {angles} bend angles, but the board on {port} has "
            f"{board.channels} channels and {board.angles} angles; describe the limb that is on "
            "it, or take the port of its board."
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
    """How each wire pulls (W), as `protocol.shares` reads it."""
    return [
        from_host.pull(bends.start, wire.e2, wire.e3 if segment.axes == 2 else 0.0)
        for bends, segment in zip(LimbModel.of(limb).layout.bends_of, limb.segments, strict=True)
        for wire in segment.wires
    ]


def shares_of(limb: LimbParameters) -> np.ndarray:
    """Shares of each wire's torque that turn the bend angles (F, W), as the board has them."""
    bends = range(LimbModel.of(limb).layout.num_bends)
    return np.array([protocol.shares(pulls_of(limb), bend) for bend in bends])


class BoardLink(Closed):
    """A connection to a board. It arms the board only in `arm`.

    Threads read and write. Only `info`, `arm` and `clear` wait for the cable: for
    an answer, and at most some seconds. Use it as a context manager, or `close`
    it: both disarm the board.

    - ``lost_samples``: number of samples that did not arrive.
    - ``delay``: time by which the newest sample was longer on its way than the fastest one, s.
    - ``when_off``: function that takes a sentence, called by a thread or a command when the board
      is not armed any more or silent for 0.2 s, a command fails, or its cable is gone; or None.
    """

    def __init__(self, port: str, limb: LimbParameters | None = None):
        """
        Args:
            port: name of a serial port, or any URL of pyserial's.
            limb: limb on the board; the nominal one if None.

        Raises:
            HardwareError: if it cannot be opened, or another program has it.
        """
        self.port, self._pulls = port, pulls_of(limb or LimbParameters())
        self._cable = SerialPort(port)
        self.parser = protocol.Parser(protocol.BOARD_KINDS)
        self._assembly = Assembly()
        self.lost_samples = 0
        self.when_off: Callable[[str], None] | None = None
        self._why_off = ""
        self._sample: Sample | None = None
        self._info: BoardInfo | None = None
        self._session, self._sequence = 0, 0
        self._unanswered: collections.deque[tuple[int, float]] = collections.deque(maxlen=100)
        self._clock_offset = np.inf  # s, between both clocks, of the sample that came fastest
        self.delay = 0.0
        self._restarts = self._restarts_when_armed = 0
        self._failure: str | None = None
        self._arrived = threading.Condition()
        self._outgoing: queue.Queue[bytes | None] = queue.Queue(WAITING_FRAMES)
        self._closing = False
        self._threads = [
            threading.Thread(target=work, name=f"{port} {work.__name__}", daemon=True)
            for work in (self._read, self._write)
        ]
        for thread in self._threads:
            thread.start()

    def info(self) -> BoardInfo:
        """Asks the board for its description.

        Raises:
            HardwareError: if it does not answer, or speaks another protocol.
        """
        self._send_until([protocol.encode(protocol.HELLO)], lambda: self._info, ANSWER_TIME)
        return self._answer(self._info, "a greeting")

    def sample(self, oldest: float = STALE) -> Sample:
        """The newest sample.

        Args:
            oldest: age at which it must not be used, s. Whoever heats leaves it as it is.

        Raises:
            HardwareError: if it is older or came that late, or the cable is gone.
        """
        self._check()
        self._wait_for(lambda: self._sample, ANSWER_TIME)
        sample = self._answer(self._sample, "after the port was opened")
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
        """The sample after the newest one, for which it waits.

        Raises:
            HardwareError: as `sample`.
        """
        before = self.sample()
        self._wait_for(lambda: self._sample is not before, STALE)
        return self.sample()

    def arm(self, bounds: Sequence[HeatBounds], total_duty: float = 1.5) -> None:
        """Arms the board: commands heat from now on.

        Args:
            bounds: bounds of all wires, as `LimbParameters.heat_bounds` has them.
            total_duty: largest sum of all duties.

        Raises:
            HardwareError: if it does not let itself be armed, with its reason,
                or if another program has armed it.
            KeyboardInterrupt: if a signal has ended the command that runs.
        """
        heed_signals()
        sample = self.sample()
        if sample.armed:
            self._wait_for(lambda: not self._sample_now().armed, SESSION_END)
            sample = self.sample()
            if sample.armed:
                raise HardwareError(f"The board on {self.port} is in use by another program.")
        if sample.latched:
            raise HardwareError(
                f"The board on {self.port} refuses to be armed: {sample.reason_text}. "
                "Mend it, then clear the fault: soft-limb status PORT --clear."
            )
        self._session, self._sequence, self._why_off = sample.challenge, 0, ""
        self._unanswered.clear()
        self._restarts_when_armed = self._restarts
        values = [dataclasses.astuple(bound) for bound in bounds]
        total = min(total_duty, len(values))  # they cannot have more
        frames = from_host.encode_arming(sample.challenge, values, total, self._pulls)
        armed = self._send_until(frames, lambda: self._sample_now().armed, ARMING_TIME)
        if not armed:
            raise HardwareError(
                f"The board on {self.port} does not let itself be armed: "
                f"{self.sample().reason_text}."
            )

    def command(self, duty: np.ndarray) -> None:
        """Sends a duty (W), in [0, 1]; it holds for 250 ms.

        Raises:
            HardwareError: if it is out of range or not a number, if the board
                is not armed, if samples no longer come, or if commands do not
                arrive in time.
            KeyboardInterrupt: if a signal has ended the command that runs.
        """
        heed_signals()
        try:
            self._command(duty)
        except HardwareError as error:
            self._tell_off(str(error))
            raise

    def _command(self, duty: np.ndarray) -> None:
        sample = self.sample()
        duty = checked_duty(duty, len(sample.duty))
        if self._why_off:
            raise HardwareError(self._why_off)
        if not sample.armed:
            raise HardwareError(_switched_off(self.port, sample))
        if self._restarts != self._restarts_when_armed:
            raise HardwareError(f"The time of the board on {self.port} went back; reset it.")
        self._check_answers(sample)
        self._sequence += 1
        self._unanswered.append((self._sequence, time.monotonic()))
        heard = round(1000 * sample.board_time)
        frame = from_host.encode_command(self._session, self._sequence, heard, duty.tolist())
        self._send(2 * frame)  # one may get lost; the board takes each once

    def _check_answers(self, sample: Sample) -> None:
        """Raises HardwareError if the oldest command without an answer is too old."""
        waiting = self._unanswered
        while waiting and (sample.acknowledged - waiting[0][0]) & 0xFFFF < 0x8000:
            waiting.popleft()
        if waiting and (late := time.monotonic() - waiting[0][1]) > STALE:
            raise HardwareError(
                f"The board on {self.port} did not get a command within {late:.2f} s; commands "
                "arrive late or not at all."
            )

    def disarm(self, why: str = "") -> None:
        """Switches the wires off. Does not wait, and never raises.

        Args:
            why: sentence that the next command raises, if another board is the cause.
        """
        self._why_off = self._why_off or why
        with contextlib.suppress(HardwareError):
            self._send(protocol.encode(protocol.DISARM))

    def clear(self) -> None:
        """Clears a latched fault; the board stays off until it is armed.

        Raises:
            HardwareError: if the fault is still there.
        """
        sample = self.sample()
        if not sample.latched:
            return
        cleared = self._send_until(
            [protocol.encode(protocol.CLEAR, sample.challenge)],
            lambda: not self._sample_now().latched,
            ANSWER_TIME,
        )
        if not cleared:
            reason = self.sample().reason_text
            raise HardwareError(f"The fault of the board on {self.port} is still there: {reason}.")

    def close(self) -> None:
        """Disarms the board and closes the port; a second call does nothing."""
        if self._closing:
            return
        for _ in range(3):  # a frame may get lost
            self.disarm()
        with contextlib.suppress(queue.Full):
            self._outgoing.put(None, timeout=0.2)
        self._threads[1].join(1.0)
        self._closing = True
        self._threads[0].join(1.0)
        self._cable.close()

    def _send_until(self, frames: Sequence[bytes], done: Callable[[], Any], limit: float) -> bool:
        """Sends frames until something is so, because they may get lost; whether it is."""
        end = time.monotonic() + limit
        while time.monotonic() < end:
            for number, frame in enumerate(frames):
                time.sleep(FRAME_PAUSE if number else 0.0)
                self._send(frame)
            if self._wait_for(done, 0.1):
                break
        self._check()
        return bool(done())

    def _wait_for(self, done: Callable[[], Any], limit: float) -> bool:
        """Waits until something is so, or the cable is gone."""
        with self._arrived:
            return bool(self._arrived.wait_for(lambda: done() or self._failure, limit))

    def _sample_now(self) -> Sample:
        assert self._sample  # whoever asks had one before
        return self._sample

    def _answer(self, answer: Answer | None, what: str) -> Answer:
        """What the board answered; HardwareError if it did not."""
        self._check()
        if answer:
            return answer
        if (other := self.parser.other_version) is not None:
            mend = (
                "flash the board with the firmware of this program."
                if other < protocol.VERSION
                else "use a newer version of this program."
            )
            raise HardwareError(
                f"The board on {self.port} speaks version {other} of the protocol, but this "
                f"program version {protocol.VERSION}; {mend}"
            )
        raise HardwareError(f"The board on {self.port} does not answer {what}.")

    def _check(self) -> None:
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
        self._tell_off(str(error))

    def _tell_off(self, why: str) -> None:
        if self.when_off:
            self.when_off(why)

    def _check_silence(self) -> None:
        """Tells once if this is one of several boards, and no sample came for 0.2 s."""
        sample = self._sample
        if self.when_off and sample and sample.armed and not self._why_off and sample.age > SILENT:
            self._tell_off(f"Nothing new came from the board on {self.port} for {SILENT:g} s.")

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
                    self._take(kind, values)
                    self._arrived.notify_all()
            self._check_silence()

    def _take(self, kind: int, values: tuple) -> None:
        if kind == protocol.INFO:
            version, period, limit, number, channels, angles, cause = values
            text = number.rstrip(b"\0")
            name = text.decode() if text.isalnum() else number.hex()
            cause = RESET_CAUSES.get(cause, f"unknown ({cause})")
            self._info = BoardInfo(version, period / 1000, limit / 4, name, channels, cause, angles)
            return
        if (sample := self._assembly.take(kind, values, time.monotonic())) is None:
            return
        if (before := self._sample) is not None:
            step = (sample.sequence - before.sequence) & 0xFFFF
            if step == 0 or sample.board_time == before.board_time:
                return  # the same again: nothing new
            self.lost_samples += step - 1 if step < 0x8000 else 0
            if sample.board_time < before.board_time:  # it was restarted, or sends old samples
                self._restarts += 1
                self._clock_offset = np.inf
            self._clock_offset += CLOCK_ERROR * (sample.received - before.received)
        offset = sample.received - sample.board_time
        self._clock_offset = min(self._clock_offset, offset)
        self.delay = offset - self._clock_offset
        self._sample = sample
        if before and before.armed and not sample.armed:
            self._tell_off(_switched_off(self.port, sample))
