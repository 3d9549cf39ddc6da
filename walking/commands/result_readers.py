"""Readers of gait and robot files, for commands on results."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from limb_systems.summary import Entry, Summary
from soft_limb.results.read_result import GAIT, ROBOT, Read, identity_entry
from walking.commands.gait_summaries import gait_summary
from walking.gait import Gait
from walking.robot_parameters import RobotParameters


def _read_gait(path: Path, _text: str, _quick: bool) -> Read:
    gait = Gait.load(path)
    return gait, gait.provenance, gait_summary(gait) + Summary([identity_entry(gait.robot)])


def _read_robot(path: Path, _text: str, _quick: bool) -> Read:
    robot = RobotParameters.load(path)
    body = robot.body
    ground = robot.ground
    stands = f"μ = {ground.friction:g}, slope {np.rad2deg(ground.slope):g}°" if ground else "none"
    entries = [
        Entry("body", f"{body.mount}, {1e3 * body.mass:g} g"),
        *(Entry(limb.name, ", ".join(limb.parameters.wire_names)) for limb in robot.limbs),
        Entry("ground", stands),
        identity_entry(robot),
    ]
    return robot, None, Summary(entries)


READERS: dict[str, Callable[[Path, str, bool], Read]] = {GAIT: _read_gait, ROBOT: _read_robot}
