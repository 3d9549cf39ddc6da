"""A limb with three wires draws a circle and the letters SL with its tip.

    python examples/draw_in_space.py [PATH.csv] [-l LIMB.yaml] [-o FOLDER]

A path is a CSV of the tip's E2 and E3 in mm, without titles. The plan drives an emulated limb that
nobody has calibrated, in open loop and by plans of the coming seconds that see its bend.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from controllers import RecedingHorizon
from hardware import LimbTwin, replay
from limb_systems import LimbError, LimbParameters, write_meshcat_replay
from limb_systems.tracking import reference_distances, true_bend
from limb_systems.views.plots import plot_tracking, save_figure
from planners import plan, references

L = [[-6, -12], [4, -10], [4, 10], [4, -10], [12, -10]]  # mm
SPEED, WAIT = 2.0, 25.0  # mm/s, and s until the wires are warm and the tip is where it begins


def arc(center, radius, first, last):  # degrees
    angles = np.deg2rad(np.linspace(first, last, 61))
    return center + radius * np.column_stack([np.cos(angles), np.sin(angles)])


def main(options):
    s = [arc([-6, 5], 5, 20, 270), arc([-6, -5], 5, 90, -160)]
    letters = np.vstack([arc([0, 0], 18, 90, 450), *s, L])
    path = np.loadtxt(options.path, delimiter=",", ndmin=2) if options.path else letters
    steps = np.maximum(np.hypot(*np.diff(path, axis=0).T), 1e-3)
    times = [0.0, 20.0, *(WAIT + np.append(0.0, np.cumsum(steps)) / SPEED)]
    tip = np.vstack([np.zeros((2, 2)), path]).T / 1e3
    trajectory = plan(options.limb, references.from_tip_path(options.limb, times, tip))
    trajectory.save(options.out / "drawing.csv")
    for name, controller in (("open_loop", None), ("feedback", RecedingHorizon(trajectory))):
        twin = LimbTwin(options.limb, seed=1, truth=True)
        recording = true_bend(replay(trajectory, twin, controller=controller))
        recording.save(options.out / f"drawing_{name}.csv")
        missed = np.rad2deg(reference_distances(trajectory, [recording]).measured)
        print(f"{name:<12}{missed:.2f}° from what was asked for, on average")
        write_meshcat_replay(options.out / f"drawing_{name}.html", recording, plan=trajectory)
        save_figure(plot_tracking(trajectory, [recording]), options.out / f"drawing_{name}.png")
    print(f"written     drawing.csv, drawing_*.csv, .html and .png in {options.out}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draws with the tip of a limb in space.")
    parser.add_argument("path", nargs="?", type=argparse.FileType())
    parser.add_argument("-l", "--limb", type=LimbParameters.load, default=LimbParameters.in_space())
    parser.add_argument("-o", "--out", type=Path, default="out", help="folder for the results")
    try:
        main(parser.parse_args())
    except (LimbError, ValueError) as error:
        sys.exit(f"error: {error}")
