"""How a robot walks in MuJoCo, a simulator that shares no code with Drake.

The program reads a gait and its robot from a file, applies the duty of the gait open loop, as the
check of gaits does, and prints the travel of the body in each cycle beside the plan: x and y are
along and across the heading at the start of the cycle. The two shares are the travel along the
planned one and aside of it, both as shares of the planned travel.

    python benchmarks/walks_in_mujoco.py gait.csv [-n CYCLES]
"""

import argparse
import sys

import numpy as np

from limb_systems import LimbError
from walking import Gait
from walking.gait import travels
from walking.gait_check import fall_of
from walking.in_mujoco import simulate_in_mujoco


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("gait", help="file of a gait")
    parser.add_argument("-n", "--cycles", type=int, default=5, help="number of cycles (default 5)")
    options = parser.parse_args()
    if options.cycles < 1:
        parser.error(f"--cycles is {options.cycles}; it must be at least 1.")
    try:
        gait = Gait.load(options.gait)
        recording = simulate_in_mujoco(gait, gait.robot, options.cycles)
    except LimbError as error:
        sys.exit(str(error))
    fall, end = fall_of(recording, gait)
    ends = gait.period * np.arange(int(end / gait.period + 1e-6) + 1)
    pose = np.unwrap(recording.body_pose, axis=1)
    poses = np.array([np.interp(ends, recording.time, row) for row in pose])

    print(f"{options.gait}: a cycle takes {gait.period:.2f} s")
    print("| cycle | x, mm | y, mm | turn, ° | along | aside |")
    print("| --- | --- | --- | --- | --- | --- |")
    planned = gait.body_pose[:, [0, -1]]
    names = ["plan", *map(str, range(1, len(ends)))]
    moved = np.hstack([travels(planned), travels(poses)])
    shares = np.hstack([gait.progress(planned), gait.progress(poses)])
    for name, way, (along, aside) in zip(names, moved.T, shares.T, strict=True):
        x, y, turn = np.pad(way, (0, 3 - len(way))) * [1e3, 1e3, np.rad2deg(1.0)]
        print(f"| {name} | {x:.2f} | {y:.2f} | {turn:.2f} | {along:.3f} | {aside:.3f} |")
    if fall:
        sys.exit(f"The robot falls: {fall}.")


if __name__ == "__main__":
    main()
