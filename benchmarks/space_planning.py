"""The processor time and accuracy of plans for limbs that bend in space.

1. Whole plans of 60 s with 601 knots, for the paper's law: each in a process of its own, without
   its start, and the check's simulation apart. These plans are quasi-static: the limb is where it
   would rest if its wires stayed as warm as they are, but for the delay σ/k. So each row has how
   far the plan is from a full simulation of its duty.
2. Random problems: three or four misplaced wires, any gravity, payloads, laws of all kinds, and
   references that are feasible or not. Each must be solved, or refused by a sentence that says why.

    python benchmarks/space_planning.py [--problems 300] [--seed 0]
"""

import argparse
import collections
import copy
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from limb_systems import (
    HystereticLaw,
    LimbError,
    LimbModel,
    LimbParameters,
    LinearLaw,
    ThresholdLaw,
    TwoMassLaw,
    WireParameters,
)
from planners import Planner, references
from planners.plan_check import simulated_differences

G, SETTLED = 9.81, 2.0  # m/s², s
TIMES = np.linspace(0.0, 60.0, 601)
COARSE = np.linspace(0.0, 40.0, 201)
CASES = {  # links, segments, gravity, payload
    "n = 5": (5, 1, [0.0, 0.0, 0.0], 0.0),
    "n = 5, gravity": (5, 1, [0.0, -G, 0.0], 0.0),
    "n = 5, gravity, 20 g": (5, 1, [0.0, -G, 0.0], 0.02),
    "n = 5, hanging, 20 g": (5, 1, [G, 0.0, 0.0], 0.02),
    "n = 5, gravity, 50 g": (5, 1, [0.0, -G, 0.0], 0.05),
    "n = 10": (10, 1, [0.0, 0.0, 0.0], 0.0),
    "n = 10, gravity": (10, 1, [0.0, -G, 0.0], 0.0),
    "two segments": (5, 2, [0.0, 0.0, 0.0], 0.0),
    "two segments, hanging": (5, 2, [G, 0.0, 0.0], 0.0),
    "three segments": (5, 3, [0.0, 0.0, 0.0], 0.0),
    "three segments, hanging": (5, 3, [G, 0.0, 0.0], 0.0),
}


def plan_case(name: str) -> str:
    """Return a row of the table: circles of 15°, or of 10° of each of several segments, in 46 s."""
    links, segments, gravity, payload = CASES[name]
    limb = LimbParameters.in_space(links=links)
    limb.segments = [copy.deepcopy(limb.segments[0]) for _ in range(segments)]
    limb.total_duty = 1.5 * segments
    limb.gravity = gravity
    limb.payload = payload
    phases = (
        2 * np.pi * TIMES / 46.0
        + np.pi / 2 * np.arange(LimbModel.of(limb).layout.num_bends)[:, None]
    )
    size = np.deg2rad(15.0 if segments == 1 else 10.0) * np.minimum(TIMES / 20.0, 1.0)
    started = time.process_time()
    reference = references.from_samples(TIMES, size * np.sin(phases))
    plan, times, differences = Planner(limb, TIMES).plan_unchecked(reference)
    planned = time.process_time()
    simulated_differences(plan)
    checking = time.process_time() - planned
    early, late = (differences[part].max() for part in (times < SETTLED, times >= SETTLED))
    first, later, rms = np.rad2deg([early, late, np.sqrt((differences**2).mean())])
    return (
        f"| {name} | {planned - started - checking:.2f} | {checking:.2f} | "
        f"{plan.check.iterations} | {first:.3f} | {later:.3f} | {rms:.3f} |"
    )


def random_problem(generator: np.random.Generator):
    """Return a limb, and a reference."""
    limb = LimbParameters.in_space(int(generator.integers(3, 5)), int(generator.integers(3, 9)))
    segment = limb.segments[0]
    segment.twists, segment.centred_joints = map(bool, generator.integers(0, 2, 2))
    direction = generator.normal(size=3)
    pulled = generator.uniform() < 0.8
    limb.gravity = (pulled * G * direction / np.linalg.norm(direction)).tolist()
    limb.payload = float(generator.choice([0.0, 0.01, 0.03]))
    law = generator.choice([LinearLaw, LinearLaw, TwoMassLaw, ThresholdLaw, HystereticLaw])
    segment.wires = [
        WireParameters.at(wire.name, 360.0 * k / len(segment.wires) + generator.normal(0.0, 4.0))
        for k, wire in enumerate(segment.wires)
    ]
    for wire in segment.wires:
        wire.law = law()
    limb.temperature_limits.warm_up_time = float(generator.uniform(3.0, 20.0))
    knots = np.arange(0.0, 41.0, generator.uniform(2.0, 10.0))
    angles = np.deg2rad(generator.uniform(5.0, 40.0)) * generator.normal(size=(2, len(knots)))
    course = np.array([np.interp(COARSE, knots, row) for row in angles])
    if generator.uniform() < 0.3:  # steps
        course = angles[:, np.searchsorted(knots, COARSE, side="right") - 1]
    return limb, references.from_samples(COARSE, np.clip(course, -3.0, 3.0))


def solve_random(seed: tuple[int, int]) -> tuple[str, str, float, float]:
    """Return outcome and law in words, processor time, s, and distance from the simulation, rad."""
    limb, reference = random_problem(np.random.default_rng(seed))
    law = type(limb.wires[0].law).__name__
    started = time.process_time()
    apart = np.nan
    try:
        _, _, differences = Planner(limb, COARSE).plan_unchecked(reference)
        outcome = "solved"
        apart = differences.max()
    except LimbError as error:
        outcome = f"seed {seed}: {error}"
    return outcome, law, time.process_time() - started, apart


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Times plans of limbs that bend in space.")
    parser.add_argument("--problems", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print("| limb | plan, CPU s | its check | iterations | first 2 s, ° | later, ° | rms, ° |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, max_tasks_per_child=1) as pool:
        for row in pool.map(plan_case, CASES):
            print(row, flush=True)
    seeds = [(options.seed, number) for number in range(options.problems)]
    with ProcessPoolExecutor(1, mp_context=spawn) as pool:
        results = list(pool.map(solve_random, seeds))
    for outcome, count in collections.Counter(outcome for outcome, *_ in results).most_common():
        print(f"{count:4d} {outcome}")
    for law in sorted({law for _, law, *_ in results}):
        spent, apart = np.array([numbers for _, name, *numbers in results if name == law]).T
        worst = np.rad2deg(np.nanpercentile(apart, [50, 95, 100]))
        print(
            f"{law}: {np.median(spent):.2f} s (median), {spent.max():.2f} s at most, with the "
            f"check; simulated {worst[0]:.2f}° apart (median), {worst[1]:.2f}° (95%), "
            f"{worst[2]:.2f}° at most"
        )
