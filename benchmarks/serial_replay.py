"""How well commands keep time: a plan of 20 s over a pseudo-terminal, in real time.

The firmware runs on an emulated board in another process. Printed is by how
much commands left late, and how many samples were lost; the target on an idle
machine is 99% within 5 ms, and none.

    python benchmarks/serial_replay.py [--repetitions 3]
"""

import argparse

import numpy as np

from hardware import SerialLimb, emulated_port, replay
from limb_systems import LimbParameters
from planners import plan, references


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repetitions", type=int, default=3)
    options = parser.parse_args()
    limb = LimbParameters()
    times = np.linspace(0.0, 20.0, 201)
    trajectory = plan(limb, references.from_samples(times, 0.3 * np.sin(times / 3)))
    print("commands   late: median       99%    largest   samples lost")
    for _ in range(options.repetitions):
        with emulated_port() as port:
            robot = SerialLimb(port, limb)
            replay(trajectory, robot)
        late = 1000 * np.array(robot.timing_errors)
        median, most, largest = *np.percentile(late, [50, 99]), late.max()
        print(
            f"{len(late):>8}{median:>13.2f} ms{most:>7.2f} ms{largest:>8.2f} ms"
            f"{robot.link.lost_samples:>15}",
            flush=True,
        )


if __name__ == "__main__":
    main()
