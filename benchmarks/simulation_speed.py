"""How fast the limb simulates: times real time, for integrators of Drake.

Sixty seconds of duty that is redrawn at random every half second, linear in
between, recorded at 20 Hz. The first row of each limb is what `simulate`
does; the others are the same diagram with other integrators, over a shorter
time where they are slow. The best of three runs, in one process. Limbs in space
have two joints for each link, or three with twists, and three wires.

The emulated limb has events at 50 Hz and physics in Python; its row is that
of `simulate` on it.

    python benchmarks/simulation_speed.py
"""

import time

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

import limb_systems.simulation
from hardware import LimbTwin
from limb_systems import Limb, LimbParameters, SegmentParameters, simulate

SCHEMES = ("implicit_euler", "velocity_implicit_euler", "radau1", "runge_kutta3")


def planar(links: int) -> LimbParameters:
    return LimbParameters(segments=[SegmentParameters(links, stiffness=0.1246 * (links + 1) / 6)])


def in_space(links: int, twists: bool = False) -> LimbParameters:
    limb = LimbParameters.in_space(links=links)
    limb.segments[0].twists = twists
    limb.segments[0].stiffness *= (links + 1) / 6
    return limb


def times_real_time(parameters: LimbParameters, scheme: str, duration: float, system=Limb) -> float:
    knots = np.arange(0.0, duration + 0.5, 0.5)
    wires = len(parameters.wires)
    duty = np.random.default_rng(0).uniform(0.0, 0.4, (wires, len(knots)))
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
    limbs = [
        ("5 links", planar(5), 200),
        ("10 links", planar(10), 100),
        ("5 in space", in_space(5), 100),
        ("5, twisting", in_space(5, twists=True), 50),
        ("10 in space", in_space(10), 75),
    ]
    print("limb          integrator               times real time   (target for ours)")
    for name, limb, target in limbs:
        speed = times_real_time(limb, ours, 60.0)
        print(f"{name:<14}{ours:<24}{speed:>16.0f}   ({target})")
        for scheme in SCHEMES if len(limb.wires) == 2 else SCHEMES[:-1]:
            duration = 1.0 if scheme == "runge_kutta3" else 10.0
            print(f"{name:<14}{scheme:<24}{times_real_time(limb, scheme, duration):>16.1f}")
    speed = times_real_time(planar(5), ours, 60.0, LimbTwin)
    print(f"{'5 links':<14}{'emulated limb':<24}{speed:>16.0f}   (50)")


if __name__ == "__main__":
    main()
