"""How fast the limb simulates: times real time, for integrators of Drake.

Sixty seconds of duty that is redrawn at random every half second, linear in
between, recorded at 20 Hz. The first row of each limb is what `simulate`
does; the others are the same diagram with other integrators, over a shorter
time where they are slow. The best of three runs, in one process.

The emulated limb has events at 50 Hz and physics in Python; its row is that
of `simulate` on it.

    python benchmarks/simulation.py
"""

import time

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

import limb_systems.simulation
from hardware import LimbTwin
from limb_systems import Limb, LimbParameters, SegmentParameters, simulate

SCHEMES = ("implicit_euler", "velocity_implicit_euler", "radau1", "runge_kutta3")


def times_real_time(links: int, scheme: str, duration: float, system=Limb) -> float:
    segment = SegmentParameters(links=links, stiffness=0.1246 * (links + 1) / 6)
    parameters = LimbParameters(segments=[segment])
    knots = np.arange(0.0, duration + 0.5, 0.5)
    duty = np.random.default_rng(0).uniform(0.0, 0.4, (2, len(knots)))
    course = PiecewisePolynomial.FirstOrderHold(knots, duty)
    limb_systems.simulation.INTEGRATION_SCHEME = scheme
    best = np.inf
    for _ in range(3):
        limb = system(parameters)
        start = time.perf_counter()
        simulate(limb, course, duration, accuracy=1e-3)
        best = min(best, time.perf_counter() - start)
    return duration / best


def main() -> None:
    ours = limb_systems.simulation.INTEGRATION_SCHEME
    print("links  integrator               times real time   (target for ours)")
    for links, target in ((5, 200), (10, 100)):
        speed = times_real_time(links, ours, 60.0)
        print(f"{links:>5}  {ours:<24}{speed:>16.0f}   ({target})")
        for scheme in SCHEMES:
            duration = 1.0 if scheme == "runge_kutta3" else 10.0
            print(f"{links:>5}  {scheme:<24}{times_real_time(links, scheme, duration):>16.1f}")
    speed = times_real_time(5, ours, 60.0, LimbTwin)
    print(f"    5  {'emulated limb':<24}{speed:>16.0f}   (50)")


if __name__ == "__main__":
    main()
