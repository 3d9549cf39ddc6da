"""What the process that runs a limb tells the page's process."""

import dataclasses

from limb_systems import LimbParameters, Trajectory
from limb_systems.band import Band


@dataclasses.dataclass(frozen=True, eq=False)
class Phase:
    """A recording that begins, with new curves.

    - ``source``: what the limb is.
    - ``parameters``: of the limb.
    - ``limit``: of V, at which the heaters are switched off, °C.
    - ``duration``: at most, s; None if it has no end.
    - ``plan``, ``band``: what the limb follows, and how far it may be from that; or None.
    """

    source: str
    parameters: LimbParameters
    limit: float
    duration: float | None = None
    plan: Trajectory | None = None
    band: Band | None = None


@dataclasses.dataclass(frozen=True)
class Reading:
    """What is known of a limb at a moment.

    - ``time``: since the phase began, s.
    - ``bend_angle``: φ of each segment, rad.
    - ``measured_temperature``: V of each wire, °C.
    - ``duty``: that was asked for, of each wire.
    - ``applied_duty``: that the limb had applied, of each wire; or None.
    - ``reference``: bend angle that is asked for, of each segment, rad; or None.
    - ``board``: of a robot; or None.
    """

    time: float
    bend_angle: list[float]
    measured_temperature: list[float]
    duty: list[float]
    applied_duty: list[float] | None = None
    reference: list[float] | None = None
    board: "BoardReading | None" = None


@dataclasses.dataclass(frozen=True)
class BoardReading:
    """What is known of a board and its cable at a moment.

    - ``armed``: whether the wires may be heated.
    - ``reason``: why they may not, in words.
    - ``warmest``: the most that each wire can have by its duty, °C.
    - ``lost_samples``: that did not arrive.
    - ``late``: by which the last command was late, s; None if none was sent.
    - ``commands``, ``missed``: how many were sent, and how many of them later than `DEADLINE`.
    """

    armed: bool
    reason: str
    warmest: list[float]
    lost_samples: int
    late: float | None = None
    commands: int = 0
    missed: int = 0


@dataclasses.dataclass(frozen=True)
class Message:
    """What is sent at once. The file of a new `Phase` goes with it.

    - ``said``: what runs, in words.
    - ``reading``: None while no limb runs.
    """

    said: str
    reading: Reading | None
