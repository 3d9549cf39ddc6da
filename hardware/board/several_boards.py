"""Several boards that heat together or not at all, with the interface of one board."""

import contextlib
import dataclasses
import itertools
import operator
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np

from hardware.board.link import (
    MAX_SAMPLE_AGE,
    BoardInfo,
    BoardLink,
    Closeable,
    Sample,
    check_fit,
    checked_duty,
)
from hardware.firmware import guard
from limb_systems import LimbError, LimbParameters
from limb_systems.heat_bounds import HeatBounds
from limb_systems.layout import slices
from limb_systems.simulation import PERIOD

Ports = str | Mapping[str, str]  # port of a board, or ports of the boards of limbs by name


def limbs_of(robot: LimbParameters, names: Sequence[str]) -> dict[str, LimbParameters]:
    """Return the limbs of a robot by name, with their segments of `as_single_limb`.

    A segment has the name of its limb, with a number if the limb has several.

    Raises:
        LimbError: if a limb has no name in ``names``, or a name no limb.
    """
    # Find the limb of each segment by the segment's name.
    segment_names = [suffix[1:] or "1" for suffix in robot.segment_suffixes]
    limb_names = [name if name in names else name.rpartition("_")[0] for name in segment_names]
    # Segments of a limb stand one after the other.
    limbs = []
    pairs = zip(limb_names, robot.segments, strict=True)
    for limb_name, group in itertools.groupby(pairs, operator.itemgetter(0)):
        segments = [segment for _, segment in group]
        limbs.append((limb_name, dataclasses.replace(robot, segments=segments)))
    if sorted(name for name, _ in limbs) != sorted(names):
        if not any(segment.name for segment in robot.segments):
            raise LimbError(
                f"There are ports for {', '.join(names)}, but this is a single limb; give one port "
                "without a name."
            )
        raise LimbError(
            f"There are ports for {', '.join(names)}, but the robot's segments are "
            f"{', '.join(segment_names)}; give a port for each limb, by its name."
        )
    return dict(limbs)


def open_link(port: Ports, limb: LimbParameters) -> "Link":
    """Open the link to the board of a limb, or the links to several boards, one for each limb.

    Raises:
        HardwareError: if a port cannot be opened.
        LimbError: if there are several ports, but not for all limbs.
    """
    return BoardLink(port, limb) if isinstance(port, str) else SeveralBoards(port, limb)


def switch_off_together(links: Sequence[BoardLink]) -> None:
    """Switch all boards off as soon as one is off, silent for 0.2 s or without a cable.

    The thread that reads the board's samples does it. The next command to any board raises the
    fault of the first.
    """

    def disarm_all(reason: str) -> None:
        for link in links:
            link.disarm(reason)

    for link in links:
        link.when_off = disarm_all


class SeveralBoards(Closeable):
    """Connections to several boards, one for each limb of a robot, with the methods of `BoardLink`.

    Each method has the arguments and errors of the method of `BoardLink`, for all boards. No board
    gets a duty other than zero unless all are armed, and all are switched off together, see
    `switch_off_together`. Use it as a context manager, or `close` it.

    - ``port``: ports, as text.
    - ``names``: names of the limbs, in the robot's order.
    """

    def __init__(self, ports: Mapping[str, str], robot: LimbParameters):
        """
        Args:
            ports: port of each limb by its name.
            robot: all limbs as one, see `RobotParameters.as_single_limb`.

        Raises:
            HardwareError: if a port cannot be opened, or another program has it.
            LimbError: if a limb has no port, or a port no limb.
        """
        self.port = ", ".join(f"{name}={port}" for name, port in ports.items())
        self._limbs = limbs_of(robot, list(ports))
        self.names = list(self._limbs)
        self._wires = slices([len(limb.wires) for limb in self._limbs.values()])  # of each board
        self._total_duty = 0.0
        # Open all boards; the open ones are closed if one fails.
        self._links: list[BoardLink] = []
        with contextlib.ExitStack() as opened:
            for name, limb in self._limbs.items():
                self._links.append(opened.enter_context(BoardLink(ports[name], limb)))
            switch_off_together(self._links)
            self._opened = opened.pop_all()

    @property
    def lost_samples(self) -> int:
        """The number of samples of all boards that did not arrive."""
        return sum(link.lost_samples for link in self._links)

    def info(self) -> BoardInfo:
        """Return the boards as one, with all serial numbers and the lowest temperature limit.

        Raises:
            LimbError: if a board has not as many wires and bend angles as its limb.
        """
        infos = [link.info() for link in self._links]
        for limb, info, link in zip(self._limbs.values(), infos, self._links, strict=True):
            check_fit(limb, info, link.port)
        return dataclasses.replace(
            infos[0],
            temperature_limit=min(info.temperature_limit for info in infos),
            serial_number=", ".join(dict.fromkeys(info.serial_number for info in infos)),
            channels=self._wires[-1].stop,
            angles=sum(info.angles for info in infos),
        )

    def sample(self, oldest: float = MAX_SAMPLE_AGE) -> Sample:
        """Return the newest samples as one, with the samples as its ``parts``.

        It has the board time of the first board. It is armed if all are, and has the reason of the
        board that was the first to be off.
        """
        samples = [link.sample(oldest) for link in self._links]
        first_off = min(samples, key=_off_rank)
        joined: dict[str, Any] = {}
        for name in ("temperature", "tip_tangent", "duty", "warmest"):
            joined[name] = np.concatenate([getattr(sample, name) for sample in samples])
        return dataclasses.replace(
            samples[0],
            received=min(sample.received for sample in samples),
            armed=first_off.armed,
            reason=first_off.reason,
            parts=tuple(samples),
            **joined,
        )

    def arm(self, bounds: Sequence[HeatBounds], total_duty: float = 1.5) -> None:
        """Arm all boards at once; boards that are ready first get duty zero until all are armed.

        No single board sees the sum of all duties, so `command` reduces it to ``total_duty``. If
        a board does not arm, all are off.
        """
        self._total_duty = total_duty
        with self._disarm_on_error():
            # Arm each board in a thread, and keep the armed ones alive.
            with ThreadPoolExecutor(len(self._links)) as pool:
                armings = []
                for link, wires in zip(self._links, self._wires, strict=True):
                    armings.append(pool.submit(link.arm, bounds[wires], total_duty))
                while wait(armings, PERIOD).not_done:
                    for link, arming in zip(self._links, armings, strict=True):
                        if arming.done() and not arming.exception():
                            link.command(np.zeros(len(link.sample().duty)))
            # Raise the error of a board that did not arm.
            for arming in armings:
                arming.result()

    def command(self, duty: np.ndarray) -> None:
        """Send each board its part of a duty (W), in [0, 1]; all are off if one fails."""
        duty = checked_duty(duty, self._wires[-1].stop)
        duty = duty * min(1.0, self._total_duty / max(duty.sum(), 1e-9))
        boards = zip(self._links, self._wires, strict=True)
        with self._disarm_on_error():
            # A board that is off comes first, and its error ends this before another is heated.
            for link, wires in sorted(boards, key=lambda board: _off_rank(board[0].sample())):
                link.command(duty[wires])

    def disarm(self) -> None:
        """Switch all wires off; do not wait, and never raise."""
        for link in self._links:
            link.disarm()

    def close(self) -> None:
        """Disarm all boards, then close their ports; a second call does nothing."""
        self.disarm()
        self._opened.close()

    @contextlib.contextmanager
    def _disarm_on_error(self) -> Iterator[None]:
        """Switch all wires off if the context ends by an error."""
        try:
            yield
        except BaseException:
            self.disarm()
            raise


def _off_rank(sample: Sample) -> tuple[bool, bool]:
    """Return a key that sorts boards: off by themselves, switched off by the host, armed."""
    return sample.armed, sample.reason == guard.BY_HOST


Link = BoardLink | SeveralBoards
