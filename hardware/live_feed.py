"""The data that a running limb sends to a view, such as the live page's process."""

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort

from hardware.board.link import HardwareError, Sample
from hardware.board.serial_limb import SerialLimb
from hardware.firmware import guard
from limb_systems import LimbModel, LimbParameters, LimbSystem, Trajectory
from limb_systems.drake_python import weak_method
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


class Feed(LeafSystem):
    """A system that sends the state of a limb to a `LiveView`, at 20 Hz, without waiting.

    - input 0 ``duty``: D (W), in [0, 1]
    - input 1 ``measured_temperature``: V (W), °C
    - input 2 ``bend_angle``: φ (F), rad
    - further inputs, if the limb or controller has them: ``applied_duty`` (W), ``reference`` (F),
      rad
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, live: LiveView, limb: LimbSystem, *, has_reference: bool = False):
        """
        Args:
            live: the page.
            limb: system whose outputs are connected.
            has_reference: whether there is an input for the reference of the bend angle.
        """
        super().__init__()
        layout = LimbModel.of(limb.parameters).layout
        sizes = dict.fromkeys(("duty", "measured_temperature"), layout.num_wires)
        sizes["bend_angle"] = layout.num_bends
        if limb.HasOutputPort("applied_duty"):
            sizes["applied_duty"] = layout.num_wires
        if has_reference:
            sizes["reference"] = layout.num_bends
        self._live = live
        self._names = list(sizes)
        self._link = limb.link if isinstance(limb, SerialLimb) else None
        for name, size in sizes.items():
            self.DeclareVectorInputPort(name, size)
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, weak_method(self._publish))

    def _publish(self, context) -> None:
        signals = {name: self.GetInputPort(name).Eval(context).tolist() for name in self._names}
        state: dict[str, Any] = {}
        if self._link:
            state["lost_samples"] = self._link.lost_samples
            # Without samples the limb raises an error.
            with contextlib.suppress(HardwareError):
                state["sample"] = self._link.sample(np.inf)  # of any age, which the limb checks
        self._live.show(Reading(context.get_time(), **signals, **state))


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
        live: the page.
        limb: system that runs.
        duty: port that drives it.
        duration: longest duration, s.
        plan: trajectory that the limb follows.
        reference: port of the reference of the bend angle.
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
    # Connect the feed to the limb, and let the caller run the diagram.
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
