"""Random problems, solved and checked one by one: the share that is solved.

Limbs of 1 to 10 links with heat parameters within a factor of two of the
nominal ones; 61 to 601 knots over 30 to 120 s; steps up to 170°, decaying
sinusoids and sinusoids of 1 Hz. Each solution is checked by the dynamics of
Drake's diagram (scaled defects below 1e-6) and simulated; knots are not
added, so that coarse ones differ from their simulation by what they differ.

With `--law`, the wires have one of the laws of wires in warm silicone; every
other limb has wires as those in published recordings, which heat faster.

    python benchmarks/random_plans.py [--cases 300] [--seed 0] [--law linear]
"""

import argparse
import collections
import functools
import os
import sys

import numpy as np

from limb_systems import LimbError, LimbParameters, SegmentParameters
from limb_systems.progress import Progress
from limb_systems.wire_laws.coupled import CoupledLaw
from limb_systems.wire_laws.hysteretic import HystereticLaw
from limb_systems.wire_laws.linear import LinearLaw
from limb_systems.wire_laws.saturating import SaturatingLaw
from limb_systems.wire_laws.threshold import ThresholdLaw
from limb_systems.wire_laws.two_mass import TwoMassLaw
from limb_systems.wire_laws.wire_law import WireLaw
from planners import Planner, Task, references
from soft_limb.runs.jobs import run_each

LAWS: dict[str, type[WireLaw]] = {
    "linear": LinearLaw,
    "two-mass": TwoMassLaw,
    "threshold": ThresholdLaw,
    "saturating": SaturatingLaw,
    "hysteretic": HystereticLaw,
    "coupled": CoupledLaw,
}
# Ranges of the parameters of wires in published recordings.
RECORDED = {
    "a1": (-0.38, -0.17),
    "a2": (95.0, 150.0),
    "a3": (-0.5, -0.1),
    "silicone_warming": (0.02, 0.2),
    "silicone_cooling": (0.02, 0.08),
    "knee": (41.0, 65.0),
    "middle": (72.0, 98.0),
    "heating_middle": (76.0, 98.0),
}
PARTS = {  # that defaults do not have
    "heating_drop": (-0.2, 0.2),
    "stress_shift": (0.0, 15.0),
    "creep_share": (0.0, 0.3),
}
RECORDED_WIDTHS = {
    ThresholdLaw: (5.0, 8.0),
    SaturatingLaw: (13.0, 24.0),
    HystereticLaw: (13.0, 24.0),
    CoupledLaw: (13.0, 24.0),
}
HYSTERESIS = (4.0, 12.0)  # °C, from one middle to the other
# Of wires near the defaults: factors of rates and torques, and changes of temperatures, °C.
FACTOR = 1.4
CHANGE = 5.0


def random_law(kind: type[WireLaw], recorded: bool, generator: np.random.Generator) -> WireLaw:
    """Return a law near its defaults, or near laws of wires in published recordings."""
    law = kind()
    for name, value in vars(law).items():
        if recorded and name in RECORDED:
            changed = generator.uniform(*RECORDED[name])
        elif recorded and name == "width":
            changed = generator.uniform(*RECORDED_WIDTHS[kind])
        elif name in PARTS:
            changed = generator.uniform(*PARTS[name])
        elif name in ("knee", "middle", "heating_middle"):
            changed = value + generator.uniform(-CHANGE, CHANGE)
        else:
            changed = value * FACTOR ** generator.uniform(-1.0, 1.0)
        setattr(law, name, float(changed))
    if isinstance(law, HystereticLaw):
        law.cooling_middle = law.heating_middle - float(generator.uniform(*HYSTERESIS))
    return law


def random_problem(seed: int, law: str = "linear"):
    """Return a limb, knots (N,), s, a reference and what kind it is."""
    generator = np.random.default_rng(seed)
    links = int(generator.integers(1, 11))
    segment = SegmentParameters(links=links, stiffness=0.1246 * (links + 1) / 6)
    for wire in segment.wires:
        for name in ("a1", "a2", "a3", "beta"):
            factor = 2.0 ** generator.uniform(-1.0, 1.0)
            setattr(wire.law, name, float(getattr(wire.law, name) * factor))
    if law != "linear":
        recorded = bool(seed % 2)
        for wire in segment.wires:
            wire.law = random_law(LAWS[law], recorded, generator)
    duration = float(generator.uniform(30.0, 120.0))
    num_knots = int(generator.integers(61, 602))
    fine = np.arange(0.0, duration, 0.02)
    kind = ("steps", "decaying sinusoid", "1 Hz sinusoid")[generator.integers(3)]
    amplitude = np.deg2rad(generator.uniform(5.0, 60.0))
    if kind == "steps":
        levels = np.deg2rad(generator.uniform(-170.0, 170.0, 6))
        angles = levels[np.minimum((fine / duration * 6).astype(int), 5)]
    elif kind == "decaying sinusoid":
        period = generator.uniform(3.0, 15.0)
        decay = generator.uniform(10.0, 60.0)
        angles = amplitude * np.exp(-fine / decay) * np.sin(2 * np.pi * fine / period)
    else:
        angles = amplitude * np.sin(2 * np.pi * fine)
    reference = references.from_samples(fine, angles)
    times = np.linspace(0.0, fine[-1], num_knots)
    return LimbParameters(segments=[segment]), times, reference, kind


def solve(seed: int, law: str = "linear") -> dict:
    """Solve a problem, and return iterations, solver and check."""
    parameters, times, reference, kind = random_problem(seed, law)
    problem = {
        "seed": seed,
        "links": parameters.num_joints,
        "knots": len(times),
        "kind": kind,
    }
    try:
        trajectory, _, _ = Planner(parameters, times, task=Task.paper()).plan_unchecked(reference)
    except LimbError as error:
        return problem | {"failure": str(error)}
    check = trajectory.check
    return problem | {
        "solver": check.solver,
        "iterations": check.iterations,
        "solve_time": check.solve_time,
        "defect": check.largest_defect,
        "difference": check.largest_difference_deg,
    }


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=300, help="default %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="of the first case")
    parser.add_argument("--law", choices=LAWS, default="linear", help="default %(default)s")
    options = parser.parse_args(arguments)
    seeds = range(options.seed, options.seed + options.cases)
    results = []
    work = functools.partial(solve, law=options.law)
    processes = os.cpu_count() or 1
    with Progress("sweep", len(seeds), "cases") as progress:
        for result in run_each(work, seeds, processes):
            results.append(result)
            progress.update(len(results))

    failed = [result for result in results if "failure" in result or result["defect"] > 1e-6]
    solved = [result for result in results if result not in failed]
    alone = [result for result in solved if " (after " not in result["solver"]]
    iterations = [result["iterations"] for result in solved]
    print(f"cases                        {len(results)} (seeds {seeds.start}-{seeds.stop - 1})")
    print(f"solved                       {len(solved)} ({100 * len(solved) / len(results):.1f}%)")
    print(f"without fallback             {len(alone)} ({100 * len(alone) / len(results):.1f}%)")
    print(f"iterations: median, 90%, max {np.median(iterations):.0f}, ", end="")
    print(f"{np.percentile(iterations, 90):.0f}, {max(iterations)}")
    times = [result["solve_time"] for result in solved]
    print(f"solve s: median, max         {np.median(times):.2f}, {max(times):.2f}")
    print(f"largest scaled defect        {max(result['defect'] for result in solved):.1e}")
    differences = [result["difference"] for result in solved]
    print("difference from simulation:  median, 90%, max ", end="")
    print(", ".join(f"{np.percentile(differences, q):.3f}°" for q in (50, 90, 100)))
    for solver, count in collections.Counter(r["solver"] for r in solved).most_common():
        print(f"  {count:>4} by {solver}")
    for result in sorted(failed, key=lambda result: result["seed"]):
        print(f"  failed: {result}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
