"""The times of commands and samples: a plan of 20 s over a pseudo-terminal, in real time.

The firmware runs on an emulated board in another process. Printed is, for each
controller, by how much commands left late, how many by more than 5 ms, how many
samples were lost and how many plans of a horizon were late; the target on an
idle machine is 99% within 5 ms, and none lost.

    python benchmarks/serial_timing.py [--controller open-loop plan-feedback] [--repetitions 3]
"""

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np

from hardware import SerialLimb, emulated_port
from limb_systems import LimbParameters
from planners import Task, plan, references
from soft_limb.runs.rollout import CONTROLLERS, roll_out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--controller", nargs="+", choices=CONTROLLERS, default=list(CONTROLLERS))
    options = parser.parse_args()
    limb = LimbParameters()
    times = np.linspace(0.0, 20.0, 201)
    reference = references.from_samples(times, 0.3 * np.sin(times / 3))
    trajectory = plan(limb, reference, task=Task.closed_loop(limb))
    print(
        "controller          commands   late: median       99%    largest   by more than 5 ms   "
        "samples lost   replans begun, late   load"
    )
    for name in options.controller:
        for _ in range(options.repetitions):
            with emulated_port() as port, tempfile.TemporaryDirectory() as folder:
                rollout = roll_out(
                    trajectory,
                    lambda port=port: SerialLimb(port, limb),
                    Path(folder) / "recording.csv",
                    controller=name,
                    real_time=True,
                )
            late = 1000 * rollout.late
            median, most, largest = *np.percentile(late, [50, 99]), late.max()
            replans = "" if rollout.replans is None else f"{rollout.replans[:2].astype(int)}"
            print(
                f"{name:<18}{len(late):>10}{median:>13.2f} ms{most:>7.2f} ms{largest:>8.2f} ms"
                f"{np.mean(late > 5.0):>20.1%}{rollout.lost_samples:>15}{replans:>22}"
                f"{os.getloadavg()[0]:>7.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
