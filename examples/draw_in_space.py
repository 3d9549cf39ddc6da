"""A limb with three wires draws a circle and the letters SL with its tip.

    python examples/draw_in_space.py [PATH.csv] [-l LIMB.yaml] [-o FOLDER]

A path is a CSV of the tip's E2 and E3 in mm, without a header. The plan, made without calibration,
drives an emulated limb: in open loop, and with a receding-horizon controller that measures its
bend.
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

LETTER_L = [[-6, -12], [4, -10], [4, 10], [4, -10], [12, -10]]  # mm
SPEED = 2.0  # mm/s
START = 25.0  # s, when the wires are warm and the tip is at the first point


def arc(center, radius, first_deg, last_deg):
    angles = np.deg2rad(np.linspace(first_deg, last_deg, 61))
    return center + radius * np.column_stack([np.cos(angles), np.sin(angles)])


def main(options):
    # Choose the path: from a file, or a circle and two letters.
    if options.path:
        path = np.loadtxt(options.path, delimiter=",", ndmin=2)
    else:
        circle = arc([0, 0], 18, 90, 450)
        letter_s = [arc([-6, 5], 5, 20, 270), arc([-6, -5], 5, 90, -160)]
        path = np.vstack([circle, *letter_s, LETTER_L])
    # Move along it at constant speed, after warming up at the straight pose.
    steps = np.maximum(np.hypot(*np.diff(path, axis=0).T), 1e-3)
    times = [0.0, 20.0, *(START + np.append(0.0, np.cumsum(steps)) / SPEED)]
    tip = np.vstack([np.zeros((2, 2)), path]).T / 1e3
    # Plan, and drive an emulated limb along the plan.
    trajectory = plan(options.limb, references.from_tip_path(options.limb, times, tip))
    trajectory.save(options.out / "drawing.csv")
    for name, controller in (("open_loop", None), ("feedback", RecedingHorizon(trajectory))):
        twin = LimbTwin(options.limb, seed=1, truth=True)
        recording = true_bend(replay(trajectory, twin, controller=controller))
        recording.save(options.out / f"drawing_{name}.csv")
        distance_deg = np.rad2deg(reference_distances(trajectory, [recording]).measured)
        print(f"{name:<12}mean distance of the bend from the reference: {distance_deg:.2f}°")
        write_meshcat_replay(options.out / f"drawing_{name}.html", recording, plan=trajectory)
        save_figure(plot_tracking(trajectory, [recording]), options.out / f"drawing_{name}.png")
    print(f"written     drawing.csv, drawing_*.csv, .html and .png in {options.out}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw with the tip of a limb in space.")
    parser.add_argument("path", nargs="?", type=argparse.FileType())
    parser.add_argument("-l", "--limb", type=LimbParameters.load, default=LimbParameters.in_space())
    parser.add_argument("-o", "--out", type=Path, default="out", help="folder for the results")
    try:
        main(parser.parse_args())
    except (LimbError, ValueError) as error:
        sys.exit(f"error: {error}")
