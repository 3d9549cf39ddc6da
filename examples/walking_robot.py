"""Plan a gait for a crawler of two limbs, and walk on ground with more friction than planned.

    python examples/walking_robot.py [ROBOT.yaml] [-n CYCLES] [--friction FACTOR] [-o FOLDER]

The robot starts with cold wires. It walks with the duty of the gait, then with feedback, which
tracks the bends and corrects them after each measured stride. The robot is simulated with the
model of the plan; `soft-limb walk` drives an emulated robot.
"""

import argparse
import copy
import sys
from pathlib import Path

import numpy as np

from hardware import replay
from limb_systems import LimbError, Robot, RobotParameters, write_meshcat_replay
from limb_systems.views.plots import plot_motion, save_figure
from planners import plan_gait
from walking import GaitFeedback
from walking.gait_check import measure_strides
from walking.walk_trajectory import walk


def main(options):
    # Plan the gait.
    gait = plan_gait(options.robot, spread=False)
    gait.save(options.out / "gait.csv")
    save_figure(plot_motion(gait), options.out / "gait.png")
    print(gait.summary())
    # Walk on other ground, with and without feedback.
    robot = copy.deepcopy(gait.robot)
    robot.ground.friction *= options.friction
    trajectory = walk(gait, options.cycles)
    start = trajectory.duration - options.cycles * gait.period
    feedback = GaitFeedback(gait, options.cycles)
    for name, controller in {"open_loop": None, "feedback": feedback}.items():
        # Feedback waits for limbs that lag, at most as long as the walk lasts, and ends the walk.
        longest = walk(gait, 2 * options.cycles) if controller else trajectory
        recording = replay(longest, Robot(robot), controller=controller)
        recording.save(options.out / f"walk_{name}.csv")
        starts = start + gait.period * np.arange(options.cycles + 1)
        if controller:
            starts = np.array(feedback.cycle_starts)
        strides = 1e3 * gait.stride * measure_strides(recording, gait, starts)[0]
        print(f"{name:<12}strides of {', '.join(f'{stride:.1f}' for stride in strides)} mm")
        save_figure(plot_motion(recording), options.out / f"walk_{name}.png")
        write_meshcat_replay(options.out / f"walk_{name}.html", recording)
    print(f"written     gait.csv, gait.png, walk_*.csv, .png and .html in {options.out}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Plan a gait, and walk.")
    parser.add_argument("robot", nargs="?", type=RobotParameters.load)
    parser.add_argument("-n", "--cycles", type=int, default=6)
    parser.add_argument(
        "--friction", type=float, default=1.3, help="factor on the planned friction"
    )
    parser.add_argument("-o", "--out", type=Path, default="out", help="folder for the results")
    try:
        main(parser.parse_args())
    except LimbError as error:
        sys.exit(f"error: {error}")
