"""Your own reference, which need not be feasible, and the plan that comes nearest to it.

    python examples/own_reference.py [REFERENCE.csv] [-l LIMB.yaml] [-o FOLDER]

A reference is a CSV of time (s) and bend angle (degrees). Without one, a wave is
drawn in numpy and written as such a file, to look at and to start from.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from limb_systems import LimbError, LimbParameters
from limb_systems.views.plots import plot_tracking, save_figure
from planners import plan, references
from soft_limb.results.summaries import plan_summary


def draw_reference(path):
    """Two periods of a sine, after the 20 s in which wires warm up (20), and rest."""
    times = np.arange(0.0, 48.05, 0.1)
    waving = (times > 20.0) & (times < 44.0)
    degrees = np.where(waving, 20.0 * np.sin(2 * np.pi * (times - 20.0) / 12.0), 0.0)
    path.parent.mkdir(parents=True, exist_ok=True)
    table = np.column_stack([times, degrees])
    np.savetxt(path, table, "%.2f", delimiter=",", header="time (s), bend angle (degrees)")
    return path


def main(options):
    path = options.reference or draw_reference(options.out / "own_reference.csv")
    trajectory = plan(options.limb, references.load(path))
    trajectory.save(options.out / "own_plan.csv")
    print(plan_summary(trajectory))
    save_figure(plot_tracking(trajectory), options.out / "own_plan.png")
    print(f"written     own_plan.csv, own_plan.png in {options.out}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Plans a reference.")
    parser.add_argument("reference", nargs="?", type=Path, help="CSV of time (s), angle (degrees)")
    parser.add_argument("-l", "--limb", type=LimbParameters.load, default=LimbParameters())
    parser.add_argument("-o", "--out", type=Path, default="out", help="folder for the results")
    try:
        main(parser.parse_args())
    except LimbError as error:
        sys.exit(f"error: {error}")
