"""The time of a plan with each law of the wires: Fig. 5, five links, 601 knots.

Whole plans from request to check, all laws in turn, so that the ratios to the
paper's law hold on a busy machine as well; medians of five repetitions.
"""

import time

import numpy as np
from random_plans import LAWS

from limb_systems import LimbParameters, Trajectory
from planners import Task, plan, references


def timed_plan(law: str) -> tuple[float, Trajectory]:
    """Return the time of the plan for a limb whose wires have the law's default values, s."""
    limb = LimbParameters()
    for wire in limb.wires:
        wire.law = LAWS[law]()
    reference = references.step_and_decaying_sine()
    started = time.perf_counter()
    trajectory = plan(limb, reference, task=Task.paper())
    return time.perf_counter() - started, trajectory


def main() -> None:
    times: dict[str, list[float]] = {law: [] for law in LAWS}
    checks = {}
    for repetition in range(6):
        for law in LAWS:
            seconds, trajectory = timed_plan(law)
            if repetition:  # before the first, Python loads what it needs
                times[law].append(seconds)
                checks[law] = trajectory.check
    ratios = {law: np.divide(times[law], times["linear"]) for law in LAWS}
    row = "{:<12}{:>10}{:>10}{:>16}{:>12}{:>13}"
    print(row.format("law", "whole s", "of it", "times linear", "iterations", "from its"))
    print(row.format("", "", "solve s", "(range)", "", "simulation"))
    for law, check in checks.items():
        ratio = f"{np.median(ratios[law]):.1f} ({ratios[law].min():.1f}-{ratios[law].max():.1f})"
        difference = f"{check.largest_difference_deg:.3f}°"
        cells = f"{np.median(times[law]):.2f}", f"{check.solve_time:.2f}", ratio
        print(row.format(law, *cells, check.iterations, difference))


if __name__ == "__main__":
    main()
