"""Several boards that heat together or not at all, with what `SerialLimb` asks of one."""

import contextlib
import dataclasses
import itertools
import operator
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np

from hardware.board.link import STALE, BoardInfo, BoardLink, Closed, Sample, check_fit, checked_duty
from hardware.firmware import guard
from limb_systems import LimbError, LimbParameters
from limb_systems.heat_bounds import HeatBounds
from limb_systems.simulation import PERIOD

Ports = str | Mapping[str, str]  # of a board, or of those of a robot's limbs by name


def limbs_of(robot: LimbParameters, names: Sequence[str]) -> dict[str, LimbParameters]:
    """The limbs of a robot by name, each with its segments of `RobotParameters.as_single_limb`.

    A segment has the name of its limb, with a number if the limb has several.

    Raises:
        LimbError: if the names are not those of all limbs.
    """
    given = [suffix[1:] or "1" for suffix in robot.segment_suffixes]
    owners = [name if name in names else name.rpartition("_")[0] for name in given]
    groups = itertools.groupby(zip(owners, robot.segments, strict=True), operator.itemgetter(0))
    limbs = [(name, [segment for _, segment in group]) for name, group in groups]
    if sorted(name for name, _ in limbs) != sorted(names):
        raise LimbError(
            f"There are ports for {', '.join(names)}, but the robot's segments are "
            f"{', '.join(given)}; give a port for each limb, by its name."
        )
    return {name: dataclasses.replace(robot, segments=segments) for name, segments in limbs}


def open_link(port: Ports, limb: LimbParameters) -> "Link":
    """Open the link to the board of a limb, or the links to several boards, one for each limb.

    Raises:
        HardwareError: if a port cannot be opened.
        LimbError: if there are several ports, but not for all limbs.
    """
    return BoardLink(port, limb) if isinstance(port, str) else SeveralBoards(port, limb)


def switch_off_together(links: Sequence[BoardLink]) -> None:
    """Switch all boards off as soon as one is off, silent for 0.2 s or without a cable.

    The thread that reads the board's samples does it. The next command to any of them raises what
    was wrong with the first.
    """

    def disarm(why: str) -> None:
        for link in links:
            link.disarm(why)

    for link in links:
        link.when_off = disarm


class SeveralBoards(Closed):
    """Connections to several boards, one for each limb of a robot, with the methods of `BoardLink`.

    Each method takes what the method of `BoardLink` takes, and raises what it raises, for any of
    the boards. None gets a duty other than zero unless all are armed, and all are switched off
    together, see `switch_off_together`. Use it as a context manager, or `close` it.

    - ``port``: ports, as text.
    - ``names``: names of the limbs, in the robot's order.
    """

    def __init__(self, ports: Mapping[str, str], robot: LimbParameters):
        """
        Args:
            ports: port of each limb by its name.
            robot: all limbs as one, as of `RobotParameters.as_single_limb`.

        Raises:
            HardwareError: if a port cannot be opened, or another program has it.
            LimbError: if the ports are not those of all limbs.
        """
        self.port = ", ".join(f"{name}={port}" for name, port in ports.items())
        self._limbs = limbs_of(robot, list(ports))
        self.names = list(self._limbs)
        self._ends = np.cumsum([len(limb.wires) for limb in self._limbs.values()]).tolist()
        self._total = 0.0
        with contextlib.ExitStack() as opened:
            self._links = [
                opened.enter_context(BoardLink(ports[name], limb))
                for name, limb in self._limbs.items()
            ]
            switch_off_together(self._links)
            self._opened = opened.pop_all()

    @property
    def lost_samples(self) -> int:
        """Number of samples of all boards that did not arrive."""
        return sum(link.lost_samples for link in self._links)

    def info(self) -> BoardInfo:
        """The boards as one, with all serial numbers and the lowest temperature limit.

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
            channels=sum(info.channels for info in infos),
            angles=sum(info.angles for info in infos),
        )

    def sample(self, oldest: float = STALE) -> Sample:
        """The newest samples as one, whose ``parts`` they are; times are those of the first.

        It is armed if all are, and has the reason of the board that was the first to be off.
        """
        samples = [link.sample(oldest) for link in self._links]
        first_off = min(samples, key=_rank)
        joined: dict[str, Any] = {
            name: np.concatenate([getattr(sample, name) for sample in samples])
            for name in ("temperature", "tip_tangent", "duty", "warmest")
        }
        return dataclasses.replace(
            samples[0],
            received=min(sample.received for sample in samples),
            armed=first_off.armed,
            reason=first_off.reason,
            parts=tuple(samples),
            **joined,
        )

    def arm(self, bounds: Sequence[HeatBounds], total_duty: float = 1.5) -> None:
        """Arms all boards at once; those that are ready first are held at zero until all are.

        No single board sees the sum of all duties; commands are reduced to ``total_duty``. If a
        board is not armed, all are off.
        """
        self._total = total_duty
        starts = [0, *self._ends]
        with self._all_or_none():
            with ThreadPoolExecutor(len(self._links)) as pool:
                armings = [
                    pool.submit(link.arm, bounds[start:end], total_duty)
                    for link, start, end in zip(self._links, starts, self._ends, strict=False)
                ]
                while wait(armings, PERIOD).not_done:
                    for link, arming in zip(self._links, armings, strict=True):
                        if arming.done() and not arming.exception():
                            link.command(np.zeros(len(link.sample().duty)))
            for arming in armings:
                arming.result()

    def command(self, duty: np.ndarray) -> None:
        """Sends each board its part of a duty (W), in [0, 1]; all are off if one fails."""
        duty = checked_duty(duty, self._ends[-1])
        duty = duty * min(1.0, self._total / max(duty.sum(), 1e-9))
        parts = zip(self._links, np.split(duty, self._ends[:-1]), strict=True)
        with self._all_or_none():
            # One that is off comes first, and ends this before another is heated.
            for link, part in sorted(parts, key=lambda pair: _rank(pair[0].sample())):
                link.command(part)

    def disarm(self) -> None:
        """Switches all wires off. Does not wait, and never raises."""
        for link in self._links:
            link.disarm()

    def close(self) -> None:
        """Disarms all boards, then closes their ports; a second call does nothing."""
        self.disarm()
        self._opened.close()

    @contextlib.contextmanager
    def _all_or_none(self) -> Iterator[None]:
        """A context after which all wires are off if it ends by an error."""
        try:
            yield
        except BaseException:
            self.disarm()
            raise


def _rank(sample: Sample) -> tuple[bool, bool]:
    """Order of samples: a board that is off by itself, those that the host switched off, armed."""
    return sample.armed, sample.reason == guard.HOST


Link = BoardLink | SeveralBoards
