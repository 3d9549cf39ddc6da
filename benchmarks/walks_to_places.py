"""Walks of robots in space that are not as planned: to a place, a heading there, and back.

The gaits are of a robot of three limbs, or from a folder. The robots that walk are drawn
around it: friction by up to 30% less or more, and k, β, a1 and a2 of each limb 10% larger or
smaller. `Wayfinder` knows the robot as planned, and sees its body. The mechanics have steps of
4 ms, with which strides are 1% shorter. Shown are the friction, how long it took, how far from each
place the robot was when it counted it as reached, or at its end, the hottest wire, and what it took
to compute.

    python benchmarks/walks_to_places.py [--gaits FOLDER] [--draws 20] [--first 0] [--jobs 2]
"""

import argparse
import multiprocessing
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: matrices are small

import numpy as np

from hardware import replay
from walking import Gait, Robot, RobotParameters, Wayfinder, plan_gaits, walk
from walking.gait_check import find_fall, with_varied_parameters
from walking.gait_set import AHEAD, load_gaits
from walking.wayfinder import GOAL

MARGIN = 5.0  # °C
FRICTION = 0.3  # share
GOALS = ((0.5, 0.0, np.pi / 2), (0.0, 0.0))  # m, rad
LONGEST = 5000.0  # s
ROW = "{:>5}  {:>8}  {:>7}  {:>16}  {:>6}  {:>7}  {}"


class Watched(Wayfinder):
    """A `Wayfinder` that tells where it was when it counted a place as reached."""

    __slots__ = ()

    def _begin_cycle(self, course, pose, overrun):
        before = int(course[GOAL])
        super()._begin_cycle(course, pose, overrun)
        for goal in range(before, int(course[GOAL])):
            reached.append(f"{1e3 * np.hypot(*(pose[:2] - GOALS[goal][:2])):.0f}")


reached: list[str] = []


def run(job: tuple[dict[str, Gait], int]) -> str:
    """Return a row of the table."""
    gaits, draw = job
    ahead = gaits[AHEAD]
    rng = np.random.default_rng(draw)
    robot = with_varied_parameters(ahead.robot, rng)
    share = rng.uniform(1 - FRICTION, 1 + FRICTION)
    robot.ground.friction *= share
    reached.clear()
    began = time.process_time()
    most = walk(ahead, int(LONGEST / ahead.period))
    recording = replay(most, Robot(robot, time_step=4e-3), controller=Watched(gaits, GOALS))
    taken = time.process_time() - began
    missed = [
        *reached,
        *(
            f"not ({1e3 * np.hypot(*(recording.body_pose[:2, -1] - goal[:2])):.0f})"
            for goal in GOALS[len(reached) :]
        ),
    ]
    return ROW.format(
        draw,
        f"{share:.2f}",
        f"{recording.time[-1]:.0f} s",
        ", ".join(missed) + " mm",
        f"{recording.wire_temperature.max():.1f}",
        f"{taken:.0f} s",
        find_fall(recording, ahead)[0],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--gaits", type=Path, help="folder that soft-limb gait --set wrote")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    if options.gaits:
        gaits = load_gaits(options.gaits)
    else:
        gaits = plan_gaits(RobotParameters.in_space(3), temperature_margin=MARGIN)
    for name, gait in gaits.items():
        print(f"{name:11} {gait!r}")
    print(ROW.format("draw", "friction", "time", "from the places", "T, °C", "CPU", "fall"))
    jobs = [(gaits, options.first + draw) for draw in range(options.draws)]
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        for row in pool.imap(run, jobs):
            print(row, flush=True)


if __name__ == "__main__":
    main()
