"""The check of plans against Drake's simulation at an accuracy of 1e-6, for 20 random limbs.

The limbs and references are those of `random_plans`, of each law in turn, over their first seconds.

    python benchmarks/check_against_drake.py [--limbs 20]
"""

import argparse
import time

import numpy as np
from random_plans import LAWS, random_problem

from limb_systems import Limb, LimbError, bend_angle, simulate
from planners import Planner, Task
from planners.radau import simulate_plan

DURATION = 5.0  # s, which Drake simulates in seconds
KNOT_RATE = 10.0  # Hz
ACCURACY = 1e-6
SAMPLE_RATE = 20.0  # Hz


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--limbs", type=int, default=20, help="default %(default)s")
    options = parser.parse_args()
    laws = list(LAWS)
    knots = np.linspace(0.0, DURATION, round(DURATION * KNOT_RATE) + 1)
    print("| seed | law | links | difference ° | check, CPU s | Drake, CPU s |")
    print("| --- | --- | --- | --- | --- | --- |")
    differences = []
    for seed in range(options.limbs):
        # Plan for the limb.
        law = laws[seed % len(laws)]
        parameters, _, reference, _ = random_problem(seed, law)
        planner = Planner(parameters, knots, task=Task.paper())
        try:
            trajectory, _, _ = planner.plan_unchecked(reference)
        except LimbError as error:
            print(f"| {seed} | {law} | {parameters.num_joints} | {error} | | |", flush=True)
            continue
        # Simulate its duty in both ways.
        begun = time.process_time()
        recording = simulate(
            Limb(parameters),
            trajectory,
            sample_rate=SAMPLE_RATE,
            accuracy=ACCURACY,
            initial_state=trajectory.state[:, 0],
        )
        by_drake = time.process_time() - begun
        begun = time.process_time()
        checked = bend_angle(parameters, simulate_plan(trajectory, recording.time))
        by_check = time.process_time() - begun
        difference = np.rad2deg(np.abs(checked - recording.bend_angle)).max()
        differences.append(difference)
        cells = f"{difference:.1e} | {by_check:.3f} | {by_drake:.2f}"
        print(f"| {seed} | {law} | {parameters.num_joints} | {cells} |", flush=True)
    print(f"largest difference of {len(differences)} limbs: {max(differences):.1e}°")


if __name__ == "__main__":
    main()
