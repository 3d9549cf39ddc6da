"""What tests of walking share."""

import copy
import dataclasses
import fcntl
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from walking import Gait, GaitPhase, RobotParameters, check_gait, plan_gait


def with_quick_wires(robot=None, factor=8.0) -> RobotParameters:
    """Return a robot whose wires heat and cool faster by a factor; cycles are as much shorter."""
    robot = copy.deepcopy(robot or RobotParameters())
    for wire in robot.as_single_limb.wires:
        wire.law.a1 *= factor
        wire.law.a2 *= factor
        wire.law.a3 *= factor
    return robot


def quickened(gait: Gait, factor: float) -> Gait:
    """Return the gait of the robot with quick wires: the same motion in a shorter time."""
    joint_state = gait.joint_state.copy()
    joint_state[len(joint_state) // 2 :] *= factor
    return dataclasses.replace(
        gait,
        time=gait.time / factor,
        joint_state=joint_state,
        phases=[GaitPhase(phase.start / factor, phase.contacts) for phase in gait.phases],
        robot=with_quick_wires(gait.robot, factor),
        check=copy.deepcopy(gait.check),
    )


def contacts_of_intervals(gait: Gait) -> np.ndarray:
    """Return the contact of each foot in each interval between knots (K - 1, F)."""
    starts = [phase.start for phase in gait.phases]
    phases = np.searchsorted(starts, gait.time[:-1] + 1e-9) - 1
    return np.array(gait.schedule)[phases]


@pytest.fixture(scope="session")
def made_once(tmp_path_factory) -> Callable[[str, Callable[[], Gait]], Gait]:
    """Return a gait by its name; the first worker of the tests that needs it makes it."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent

    def load_or_make(name: str, make: Callable[[], Gait]) -> Gait:
        path = Path(folder, f"{name}.csv")
        with open(path.with_suffix(".lock"), "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                make().save(path)
            return Gait.load(path)

    return load_or_make


@pytest.fixture(scope="session")
def crawl(made_once) -> Gait:
    """A crawl of the nominal robot, 10 °C below T_max: 26 mm in 17 s, not checked."""
    return made_once("crawl", lambda: plan_gait(temperature_margin=10.0, check=False))


@pytest.fixture(scope="session")
def quick_crawl(crawl) -> Gait:
    """The crawl of a robot whose wires are four times as quick, in 4.2 s, not checked."""
    return quickened(crawl, 4.0)


@pytest.fixture(scope="session")
def checked_crawl(made_once, quick_crawl) -> Gait:
    """`quick_crawl`, with its check."""
    return made_once("checked", lambda: check_gait(quick_crawl, cycles=2, spread=False))
