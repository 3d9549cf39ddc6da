"""Does every plan come out? Random problems, solved and checked one by one.

Limbs of 1 to 10 links with heat parameters within a factor of two of the
nominal ones; 61 to 601 knots over 30 to 120 s; steps up to 170°, decaying
sinusoids and sinusoids of 1 Hz. Each solution is checked by the dynamics of
Drake's diagram (scaled defects below 1e-6) and simulated; knots are not
added, so that coarse ones differ from their simulation by what they differ.

    python benchmarks/sweep.py [--cases 300] [--seed 0]
"""

import argparse
import collections
import multiprocessing
import sys

import numpy as np

from limb_systems import LimbError, LimbParameters, SegmentParameters
from limb_systems.progress import Progress
from planners import Planner, references


def random_problem(seed: int):
    """A limb, knots (N,), s, a reference and what kind it is."""
    generator = np.random.default_rng(seed)
    links = int(generator.integers(1, 11))
    segment = SegmentParameters(links=links, stiffness=0.1246 * (links + 1) / 6)
    for law in (wire.linear_law for wire in segment.wires):
        for name in ("a1", "a2", "a3", "beta"):
            factor = 2.0 ** generator.uniform(-1.0, 1.0)
            setattr(law, name, float(getattr(law, name) * factor))
    duration = float(generator.uniform(30.0, 120.0))
    num_knots = int(generator.integers(61, 602))
    fine = np.arange(0.0, duration, 0.02)
    kind = ("steps", "decaying sinusoid", "1 Hz sinusoid")[generator.integers(3)]
    amplitude = np.deg2rad(generator.uniform(5.0, 60.0))
    if kind == "steps":
        levels = np.deg2rad(generator.uniform(-170.0, 170.0, 6))
        angles = levels[np.minimum((fine / duration * 6).astype(int), 5)]
    elif kind == "decaying sinusoid":
        period, decay = generator.uniform(3.0, 15.0), generator.uniform(10.0, 60.0)
        angles = amplitude * np.exp(-fine / decay) * np.sin(2 * np.pi * fine / period)
    else:
        angles = amplitude * np.sin(2 * np.pi * fine)
    reference = references.from_samples(fine, angles)
    times = np.linspace(0.0, fine[-1], num_knots)
    return LimbParameters(segments=[segment]), times, reference, kind


def solve(seed: int) -> dict:
    """What came of a problem: iterations, who solved it, its check."""
    parameters, times, reference, kind = random_problem(seed)
    problem = {
        "seed": seed,
        "links": parameters.num_joints,
        "knots": len(times),
        "kind": kind,
    }
    try:
        trajectory, _, _ = Planner(parameters, times).plan_unchecked(reference)
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
    options = parser.parse_args(arguments)
    seeds = range(options.seed, options.seed + options.cases)
    results = []
    with multiprocessing.Pool() as pool, Progress("sweep", len(seeds), "cases") as progress:
        for result in pool.imap_unordered(solve, seeds):
            results.append(result)
            progress.update(len(results))

    failed = [result for result in results if "failure" in result or result["defect"] > 1e-6]
    solved = [result for result in results if result not in failed]
    alone = [result for result in solved if result["solver"] == "IPOPT, Gauss-Newton"]
    iterations = [result["iterations"] for result in solved]
    print(f"cases                        {len(results)} (seeds {seeds.start}-{seeds.stop - 1})")
    print(f"solved                       {len(solved)} ({100 * len(solved) / len(results):.1f}%)")
    print(f"without fallback             {len(alone)} ({100 * len(alone) / len(results):.1f}%)")
    print(f"iterations: median, 90%, max {np.median(iterations):.0f}, ", end="")
    print(f"{np.percentile(iterations, 90):.0f}, {max(iterations)}")
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
