"""How hot wires get that nobody has calibrated, under feedback about a plan of steps.

The plan is of the nominal limb. The limbs are emulated ones of three kinds of physics, two of which
share no law with the model. Shown are the highest true temperature of each limb, °C, and the mean
distance of the bend from the plan, °.

    python benchmarks/heat_of_uncalibrated_limbs.py [--limbs 4]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: matrices are small

import numpy as np
from other_limbs import OTHER, limb_of

from controllers import PlanFeedback
from hardware import replay
from hardware.emulation.twin import SPECIMENS
from limb_systems import LimbParameters
from planners import Task, plan, references

TIMES = (0.0, 20.0, 21.0, 28.0, 29.0, 36.0, 37.0, 44.0, 45.0, 52.0)  # s
STEPS = np.deg2rad([0.0, 0.0, 35.0, 35.0, -35.0, -35.0, 20.0, 20.0, -20.0, -20.0])
REST = 300.0  # s, before


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--limbs", type=int, default=4, help="of each kind (default %(default)s)")
    options = parser.parse_args()
    nominal = LimbParameters()
    reference = references.from_samples(TIMES, STEPS)
    trajectory = plan(nominal, reference, task=Task.closed_loop(nominal))
    print(f"{'physics':<12}{'T, °C':<32}distance, °")
    for physics in (*SPECIMENS, OTHER):
        hottest, distances = [], []
        for seed in range(options.limbs):
            rested = limb_of(physics, seed).after_rest(REST, truth=True)
            recording = replay(trajectory, rested, controller=PlanFeedback(trajectory))
            hottest.append(f"{recording.wire_temperature.max():.1f}")
            planned = trajectory.interpolated(trajectory.bend_angle, recording.time)
            apart = np.abs(recording.bend_angle - planned)
            distances.append(f"{np.rad2deg(apart.mean()):.1f}")
        print(f"{physics:<12}{' '.join(hottest):<32}{' '.join(distances)}", flush=True)


if __name__ == "__main__":
    main()
