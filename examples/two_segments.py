"""A limb of two segments in series, each of which follows its own reference.

    python examples/two_segments.py [REFERENCE.csv] [-l LIMB.yaml] [-o FOLDER]

A reference is a CSV of time (s) and a column of bend angles (degrees) for each segment. Without a
reference the limb bends to an S and then to a C. The plan's duty is simulated on the model of the
limb; there is no emulated limb.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from limb_systems import (
    Limb,
    LimbError,
    LimbParameters,
    SegmentParameters,
    simulate,
    write_meshcat_replay,
)
from limb_systems.views.plots import plot_tracking, save_figure
from planners import plan, references
from soft_limb.results.summaries import plan_summary

BASE = SegmentParameters(links=3, length=0.06, mass=0.015)
TIP = SegmentParameters(links=3, length=0.05, mass=0.010, stiffness=0.10)
S_THEN_C = references.from_samples(
    [0.0, 22.0, 25.0, 30.0, 34.0, 40.0],
    np.deg2rad([[0.0, 0.0, 15.0, 15.0, 15.0, 15.0], [0.0, 0.0, -15.0, -15.0, 20.0, 20.0]]),
)


def main(options):
    # Plan, and simulate the duty of the plan.
    trajectory = plan(options.limb, options.reference)
    recording = simulate(Limb(options.limb), trajectory)
    recording.save(options.out / "two_segments.csv")
    errors = np.abs(trajectory.since_start().bend_angle_at(recording.time) - recording.bend_angle)
    # Print and draw plan and simulation.
    print(plan_summary(trajectory))
    for number, error in enumerate(np.rad2deg(errors.max(axis=1)), 1):
        print(f"segment {number}   simulated within {error:.3f}° of the plan")
    title = "Each segment with its own reference: plan and simulation"
    save_figure(plot_tracking(trajectory, [recording], title), options.out / "two_segments.png")
    write_meshcat_replay(options.out / "two_segments.html", recording, title=title)
    print(f"written     two_segments .csv, .png and .html in {options.out}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Plan and simulate a limb of several segments.")
    parser.add_argument("reference", nargs="?", type=references.load, default=S_THEN_C)
    limb = LimbParameters(segments=[BASE, TIP])
    parser.add_argument("-l", "--limb", type=LimbParameters.load, default=limb)
    parser.add_argument("-o", "--out", type=Path, default="out", help="folder for the results")
    try:
        main(parser.parse_args())
    except LimbError as error:
        sys.exit(f"error: {error}")
