"""What the process that runs a limb tells whoever shows it, such as the page's process."""

import dataclasses

from limb_systems import LimbParameters, RobotParameters, Trajectory
from limb_systems.band import Band


@dataclasses.dataclass(frozen=True, eq=False)
class RunHeader:
    """What is known of a recording before it begins, with new curves.

    - ``source``: name of the limb, as in recordings.
    - ``parameters``: description of the limb.
    - ``limit``: reading at which the heaters are switched off, °C.
    - ``duration``: longest duration, s; None if it has no end.
    - ``plan``, ``band``: plan that the limb follows, and its band; or None.
    - ``robot``: the robot whose limbs these are; or None.
    """

    source: str
    parameters: LimbParameters
    limit: float
    duration: float | None = None
    plan: Trajectory | None = None
    band: Band | None = None
    robot: RobotParameters | None = None


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
    board: "BoardReading | None" = None
    cooling: bool = False


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
class Message:
    """What is sent at once. The file of a new `RunHeader` goes with it.

    - ``said``: sentence on what runs.
    - ``reading``: newest reading; None while no limb runs.
    """

    said: str
    reading: Reading | None
