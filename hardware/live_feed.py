"""The data that a running limb sends to a view, such as the live page's process."""

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort

from hardware.board.link import HardwareError, Sample
from hardware.board.listener import Signals, listen, ports_of_run
from hardware.board.serial_limb import SerialLimb
from hardware.firmware import guard
from limb_systems import LimbParameters, LimbSystem, Trajectory
from limb_systems.plan_band import Band, band
from limb_systems.simulation import PERIOD

DONE = "done"  # reason for the regular end of a run


@dataclasses.dataclass(frozen=True, eq=False)
class RunHeader:
    """The description of a recording before it begins, with new curves.

    - ``source``: name of the limb, as in recordings.
    - ``parameters``: description of the limb.
    - ``limit``: reading at which the heaters are switched off, °C.
    - ``duration``: longest duration, s.
    - ``plan``, ``band``: plan that the limb follows, and its band; or None.
    """

    source: str
    parameters: LimbParameters
    limit: float
    duration: float
    plan: Trajectory | None = None
    band: Band | None = None


@dataclasses.dataclass(frozen=True)
class Reading:
    """The state of a limb at a time.

    - ``time``: time since the recording began, s.
    - ``bend_angle``: φ of each bend, rad.
    - ``measured_temperature``: V of each wire, °C.
    - ``duty``: commanded duty of each wire.
    - ``applied_duty``: applied duty of each wire; or None.
    - ``reference``: reference of the bend angles, rad; or None.
    - ``sample``: newest sample of a robot's board; or None.
    - ``lost_samples``: number of its samples that did not arrive.
    """

    time: float
    bend_angle: list[float]
    measured_temperature: list[float]
    duty: list[float]
    applied_duty: list[float] | None = None
    reference: list[float] | None = None
    sample: Sample | None = None
    lost_samples: int = 0


@dataclasses.dataclass(frozen=True)
class Message:
    """A message to the view. The file of a new `RunHeader` goes with it.

    - ``activity``: sentence about the present run.
    - ``reading``: newest reading; None while no limb runs.
    """

    activity: str
    reading: Reading | None


class LiveView(Protocol):
    """A view of a running limb that never waits, such as `soft_limb.live_page.LivePage`."""

    def begin(self, header: RunHeader) -> None:
        """Show a new recording, before its wires are heated."""

    def say(self, sentence: str) -> None:
        """Show a sentence about the present run, until the next sentence."""

    def show(self, reading: Reading) -> None:
        """Show the state of the limb."""

    def rest(self) -> None:
        """Show that no limb runs any more."""


@contextlib.contextmanager
def live_display(
    builder: DiagramBuilder,
    live: LiveView | None,
    limb: LimbSystem,
    duty: OutputPort,
    duration: float,
    *,
    plan: Trajectory | None = None,
    reference: OutputPort | None = None,
) -> Iterator[None]:
    """Show a limb on a page, if there is one, in a context in which its diagram is built and run.

    Args:
        builder: builder of the diagram, which has the limb already, so that its command is first.
        duty, reference: ports of the duty that drives it, and of the desired bend angle.
        duration: longest duration, s.
        plan: trajectory that the limb follows.
    """
    if live is None:
        yield
        return
    # Begin a recording on the page.
    limit = guard.TEMPERATURE_LIMIT
    if isinstance(limb, SerialLimb):
        limit = limb.info.temperature_limit
    header = RunHeader(limb.source, limb.parameters, limit, duration)
    if plan:
        header = dataclasses.replace(header, plan=plan.since_start(), band=band(plan))
    live.begin(header)
    link = limb.link if isinstance(limb, SerialLimb) else None

    def show(time: float, signals: Signals) -> None:
        state: dict[str, Any] = {name: values.tolist() for name, values in signals.items()}
        if link:
            state["lost_samples"] = link.lost_samples
            # Without samples the limb raises an error.
            with contextlib.suppress(HardwareError):
                state["sample"] = link.sample(np.inf)  # of any age, which the limb checks
        live.show(Reading(time, **state))

    # Send the state at 20 Hz, and let the caller run the diagram.
    listen(builder, ports_of_run(limb, duty, ["applied_duty"], reference), 1 / PERIOD, show)
    try:
        yield
    finally:
        live.rest()
