"""Messages on the topics, and the rules that decide which writer commands the duty."""

import dataclasses
from collections.abc import Sequence

import numpy as np

# Text of a String, or numbers by name of a Float64MultiArray, whose label has the names.
Message = str | dict[str, float]
MAX_DUTY_AGE = 0.25  # s; also the silence after which another writer may command
MAX_MESSAGE_SIZE = 4096  # bytes; larger messages are not decoded
MAX_TURN_TIME = 0.02  # s, longest time between two readings on an idle computer
START_SILENCE = 2.0  # s without a start message, after which a start message counts


@dataclasses.dataclass(frozen=True)
class Topics:
    """Names of topics.

    - ``duty``: Float64MultiArray; D (W), in [0, 1].
    - ``run``: Bool; true starts the plan, false stops it.
    - ``sensors``: Float64MultiArray; [V (W), °C, φ (F), rad].
    - ``plan``: Float64MultiArray; [time s, φ_ref (F), φ* (F), rad, D (W)].
    - ``state``: String; an object in JSON.
    """

    duty: str = "/cmd_u_t"
    run: str = "/limb/run"
    sensors: str = "/ezloophw_sensors"
    plan: str = "/limb/plan"
    state: str = "/limb/state"


@dataclasses.dataclass(frozen=True)
class ReceivedMessage:
    """The newest message of a writer.

    - ``topic``: name of its topic.
    - ``writer``: number of the writer.
    - ``value``: duty or truth value; or a sentence that says why it is invalid.
    - ``delay``: time from writing to reading by the clocks of both computers, s.
    - ``count``: number of messages of the writer since the last call.
    """

    topic: str
    writer: int
    value: Sequence[float] | bool | str
    delay: float = 0.0
    count: int = 1


@dataclasses.dataclass(frozen=True)
class ReceivedCommands:
    """The commands that were received so far.

    - ``duty``: newest duty of the commanding writer; None if there is none, or it was refused.
    - ``born``: time when it was written, or read if refused, s of the monotonic clock.
    - ``refused``: reason why the newest duty was refused; empty if it was not.
    - ``delay``: time from writing to reading of the newest duty, s.
    - ``commands``: number of duties that were received and not refused.
    - ``other``: time when another writer was ignored last, s of the monotonic clock.
    - ``run``, ``requests``: newest start (true) or stop of the plan, and number of both.
    """

    duty: tuple[float, ...] | None = None
    born: float = -np.inf
    refused: str = ""
    delay: float = 0.0
    commands: int = 0
    other: float = -np.inf
    run: bool = False
    requests: int = 0


class Listener:
    """The state of the received commands, and the writer that may command the duty.

    The first writer of a valid duty commands until no valid duty of it has come for 250 ms. All
    other writers are ignored meanwhile. So another writer takes over only after a silence, in
    which the duty is zero.
    """

    def __init__(self, topics: Topics, num_wires: int, total_duty: float):
        """
        Args:
            topics: names of the topics.
            num_wires: W.
            total_duty: largest sum of a duty.
        """
        self.received = ReceivedCommands()
        self._topics = topics
        self._num_wires = num_wires
        self._total = total_duty
        self._holder: int | None = None
        self._silence = np.inf
        self._now = -np.inf
        self._last_run = -np.inf

    def receive(self, messages: Sequence[ReceivedMessage], now: float) -> None:
        """Process the messages of a turn at the time ``now``, s of the monotonic clock."""
        # Time in which this process did not run does not count as silence.
        self._silence += min(now - self._now, MAX_TURN_TIME)
        self._now = now
        for written in messages:
            if written.topic == self._topics.duty:
                self._receive_duty(written, now)
            elif isinstance(written.value, bool):
                # A writer that repeats a start does not ask for a second run.
                if not written.value or now - self._last_run > START_SILENCE:
                    self._note(run=written.value, requests=self.received.requests + 1)
                self._last_run = now

    def _receive_duty(self, written: ReceivedMessage, now: float) -> None:
        # Ignore other writers while one commands.
        why = self._refusal(written)
        is_free = self._silence > MAX_DUTY_AGE
        if not is_free and written.writer != self._holder:
            self._note(other=now)
        if not why:
            self._silence = 0.0
            self._holder = written.writer if is_free else self._holder
        if is_free or written.writer == self._holder:
            self._note(
                duty=None if why else tuple(written.value),  # type: ignore[arg-type]
                born=now if why else now - max(0.0, written.delay),
                refused=why,
                delay=written.delay,
                commands=self.received.commands + (0 if why else written.count),
            )

    def _refusal(self, written: ReceivedMessage) -> str:
        """Return the reason why a duty must not be applied; empty if it may be applied."""
        if isinstance(written.value, str):
            return written.value
        duty = np.array(written.value, float)
        if duty.shape != (self._num_wires,):
            return f"it has {duty.size} numbers, not one for each of {self._num_wires} wires"
        if not ((duty >= 0) & (duty <= 1)).all():
            return f"it is {duty.tolist()}, not within 0 and 1"
        if duty.sum() > self._total + 1e-3:
            return f"its sum is {duty.sum():.3g}, but total_duty is {self._total:g}"
        if written.delay > MAX_DUTY_AGE:
            return f"it was written {written.delay:.2f} s ago, if both computers' clocks agree"
        return ""

    def _note(self, **changes: object) -> None:
        self.received = dataclasses.replace(self.received, **changes)  # type: ignore[arg-type]
