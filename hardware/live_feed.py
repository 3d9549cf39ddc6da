"""What the process that runs a limb tells whoever shows it, such as the live page's process."""

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Protocol

import numpy as np
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort

from hardware.board.link import HardwareError
from hardware.board.serial_limb import DEADLINE, SerialLimb
from hardware.board.several_boards import Link
from hardware.firmware import guard
from limb_systems import LimbModel, LimbParameters, LimbSystem, Trajectory
from limb_systems.drake_python import weak_method
from limb_systems.plan_band import Band, band
from limb_systems.simulation import PERIOD

DONE = "done"  # why a run ended as it should


@dataclasses.dataclass(frozen=True, eq=False)
class RunHeader:
    """What is known of a recording before it begins, with new curves.

    - ``source``: name of the limb, as in recordings.
    - ``parameters``: description of the limb.
    - ``limit``: reading at which the heaters are switched off, °C.
    - ``duration``: longest duration, s; None if it has no end.
    - ``plan``, ``band``: plan that the limb follows, and its band; or None.
    """

    source: str
    parameters: LimbParameters
    limit: float
    duration: float | None = None
    plan: Trajectory | None = None
    band: Band | None = None


@dataclasses.dataclass(frozen=True)
class BoardReading:
    """What is known of a board and its cable at a moment.

    - ``armed``: whether the wires may be heated.
    - ``reason``: reason why they may not, in words.
    - ``warmest``: highest temperature of each wire by its duty, °C.
    - ``lost_samples``: number of samples that did not arrive.
    - ``late``: delay of the last command, s; None if none was sent.
    - ``commands``, ``missed``: number of commands sent, and of those later than `DEADLINE`.
    """

    armed: bool
    reason: str
    warmest: list[float]
    lost_samples: int
    late: float | None = None
    commands: int = 0
    missed: int = 0


@dataclasses.dataclass(frozen=True)
class Reading:
    """What is known of a limb at a moment.

    - ``time``: time since the recording began, s.
    - ``bend_angle``: φ of each bend, rad.
    - ``measured_temperature``: V of each wire, °C.
    - ``duty``: commanded duty of each wire.
    - ``applied_duty``: duty that the limb had applied, of each wire; or None.
    - ``reference``: bend angles that are asked for, rad; or None.
    - ``board``: state of a robot's board; or None.
    - ``cooling``: whether the run has ended, and its wires cool.
    """

    time: float
    bend_angle: list[float]
    measured_temperature: list[float]
    duty: list[float]
    applied_duty: list[float] | None = None
    reference: list[float] | None = None
    board: BoardReading | None = None
    cooling: bool = False


@dataclasses.dataclass(frozen=True)
class Message:
    """What is sent at once. The file of a new `RunHeader` goes with it.

    - ``activity``: sentence on what runs.
    - ``reading``: newest reading; None while no limb runs.
    """

    activity: str
    reading: Reading | None


class LiveView(Protocol):
    """Shows a limb while it runs, and never waits; `soft_limb.live_page.LivePage` is one."""

    def begin(self, header: RunHeader) -> None:
        """Show a new recording, before its wires are heated."""

    def say(self, what: str) -> None:
        """Say what runs, in words, until something else is said."""

    def show(self, reading: Reading) -> None:
        """Show what is known of the limb."""

    def rest(self) -> None:
        """Say that no limb runs any more."""


class Feed(LeafSystem):
    """Hands what a limb does to a `LiveView`, at 20 Hz; it waits for nothing.

    - input 0 ``duty``: D (W), in [0, 1]
    - input 1 ``measured_temperature``: V (W), °C
    - input 2 ``bend_angle``: φ (S), rad
    - further inputs, if there are such: ``applied_duty`` (W), ``reference`` (S), rad
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, live: LiveView, limb: LimbSystem, *, has_reference: bool = False):
        """
        Args:
            live: the page.
            limb: system whose outputs come in.
            has_reference: whether there is an input for the bend angle that is asked for.
        """
        super().__init__()
        layout = LimbModel.of(limb.parameters).layout
        num_wires, num_bends = layout.num_wires, layout.num_bends
        sizes = {"duty": num_wires, "measured_temperature": num_wires, "bend_angle": num_bends}
        if limb.HasOutputPort("applied_duty"):
            sizes["applied_duty"] = num_wires
        if has_reference:
            sizes["reference"] = num_bends
        self._live, self._names = live, list(sizes)
        self._robot = (limb.link, limb.timing_errors) if isinstance(limb, SerialLimb) else None
        self._commands = self._missed = 0
        for name, size in sizes.items():
            self.DeclareVectorInputPort(name, size)
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, weak_method(self._tell))

    def _tell(self, context) -> None:
        signals = {
            name: self.get_input_port(index).Eval(context).tolist()
            for index, name in enumerate(self._names)
        }
        board = self._board(*self._robot) if self._robot else None
        self._live.show(Reading(context.get_time(), **signals, board=board))

    def _board(self, link: Link, late: list[float]) -> BoardReading | None:
        new = late[self._commands :]
        self._commands += len(new)
        self._missed += sum(delay > DEADLINE for delay in new)
        # It is the limb that fails if samples do not come.
        with contextlib.suppress(HardwareError):
            return board_reading(link, late[-1] if late else None, self._commands, self._missed)
        return None


def board_reading(
    link: Link,
    late: float | None = None,
    commands: int = 0,
    missed: int = 0,
) -> BoardReading:
    """What is known of a board; arguments as of `BoardReading`.

    Raises:
        HardwareError: if no sample has come at all, or the cable is gone.
    """
    sample = link.sample(np.inf)  # whoever drives the limb looks at its age
    return BoardReading(
        sample.armed,
        sample.reason_text,
        sample.warmest.tolist(),
        link.lost_samples,
        late,
        commands,
        missed,
    )


@contextlib.contextmanager
def shown(
    builder: DiagramBuilder,
    live: LiveView | None,
    limb: LimbSystem,
    duty: OutputPort,
    duration: float,
    *,
    plan: Trajectory | None = None,
    reference: OutputPort | None = None,
) -> Iterator[None]:
    """A context in which a diagram is built and run whose limb is on a page, if there is one.

    Args:
        builder: builder of the diagram, which has the limb already: its command leaves first.
        live: the page.
        limb: system that runs.
        duty: port that drives it.
        duration: longest duration, s.
        plan: trajectory that the limb follows.
        reference: port of the bend angle that is asked for.
    """
    if live is None:
        yield
        return
    live.begin(
        RunHeader(
            limb.source,
            limb.parameters,
            limb.info.temperature_limit
            if isinstance(limb, SerialLimb)
            else guard.TEMPERATURE_LIMIT,
            duration,
            plan.since_start() if plan else None,
            band(plan) if plan else None,
        )
    )
    feed = builder.AddSystem(Feed(live, limb, has_reference=reference is not None))
    ports = {"duty": duty, **({"reference": reference} if reference else {})}
    for index in range(feed.num_input_ports()):
        port = feed.get_input_port(index)
        name = port.get_name()
        builder.Connect(ports.get(name) or limb.GetOutputPort(name), port)
    try:
        yield
    finally:
        live.rest()
