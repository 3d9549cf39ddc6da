"""Export a plan, load it in another program, and replay it on a serial port in real time.

    python examples/plan_export_replay.py                          # plans, on an emulated board
    python examples/plan_export_replay.py PLAN.csv [-p PORT] [-o FOLDER]

Without a port an emulated limb stands in: the board's firmware in a process of its
own, behind a pseudo-terminal. With one (`python -m hardware ports` lists them) it is your robot
whose wires get hot. Ctrl-C switches them off, and every sample up to there is in the journal,
`replay.unfinished.csv`. The plan is for the nominal limb, which the emulated one is not.
"""

import argparse
import contextlib
import sys
from pathlib import Path

import numpy as np

from hardware import SerialLimb, emulated_port, replay
from limb_systems import LimbError, LimbParameters, Trajectory
from limb_systems.tracking import reference_distances, tracking_errors
from limb_systems.views.plots import plot_tracking, save_figure
from planners import plan, references


def export_plan(path):
    """The program that plans: bend by 35° within 10 s, and hold it."""
    reference = references.from_samples([0.0, 10.0, 14.0], np.deg2rad([0.0, 35.0, 35.0]))
    plan(LimbParameters(), reference).save(path)
    return path


def main(options):
    path = options.plan or export_plan(options.out / "plan.csv")
    trajectory = Trajectory.load(path)  # all that the program at the robot needs
    with contextlib.nullcontext(options.port) if options.port else emulated_port() as port:
        limb = SerialLimb(port, trajectory.parameters)
        recording = replay(trajectory, limb, journal=options.out / "replay.csv")
    source = recording.source if options.port else f"{recording.source}, emulated"
    distance = reference_distances(trajectory, [recording]).done
    error = tracking_errors(trajectory, [recording]).mean
    print(f"recorded    {source}: {len(recording.time)} samples, {limb.link.lost_samples} lost")
    print(f"commands    99% within {1000 * np.percentile(limb.timing_errors, 99):.1f} ms")
    print(f"reference   |φ_ref - φ|: mean {np.rad2deg(distance):.2f}°")
    print(f"tracking    |φ* - φ|: mean {np.rad2deg(error):.2f}°")
    save_figure(plot_tracking(trajectory, [recording], source), options.out / "replay.png")
    print(f"written     replay.csv, replay.png in {options.out}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Replays a plan on a serial port.")
    parser.add_argument("plan", nargs="?", type=Path, help="trajectory (.csv); one of 14 s if none")
    parser.add_argument("-p", "--port", help="of the robot; an emulated limb if left out")
    parser.add_argument("-o", "--out", type=Path, default="out", help="folder for the results")
    try:
        main(parser.parse_args())
    except LimbError as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit("stopped; wires are off")
