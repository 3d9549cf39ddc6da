"""``python -m hardware``: replays a trajectory and records what happens."""

import argparse
import sys
from pathlib import Path

import numpy as np

from hardware import LimbTwin, replay
from limb_systems import LimbError, Trajectory
from limb_systems.tracking import tracking_errors


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m hardware",
        description="Replays planned trajectories on an emulated limb, in simulated time.",
        epilog="exit status: 0 done, 1 it could not be done, 2 wrong usage",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    replay_parser = commands.add_parser(
        "replay", help="replay a trajectory open loop and write the recording"
    )
    replay_parser.add_argument("trajectory", type=Path, help="trajectory file (.csv)")
    replay_parser.add_argument(
        "-o", "--output", required=True, type=Path, help="recording file to write (.csv)"
    )
    replay_parser.add_argument(
        "--seed", type=int, default=0, help="of the emulated limb's noise (default %(default)s)"
    )
    options = parser.parse_args(arguments)
    try:
        trajectory = Trajectory.load(options.trajectory)
        recording = replay(trajectory, LimbTwin(trajectory.parameters, seed=options.seed))
        recording.save(options.output)
        errors = tracking_errors(trajectory, [recording])
    except (LimbError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; nothing was written", file=sys.stderr)
        return 130
    mean, median, percentile_90 = np.rad2deg([errors.mean, errors.median, errors.percentile_90])
    print(f"source      {recording.source}")
    print(
        f"tracking    |φ* - φ|: mean {mean:.2f}°, median {median:.2f}°, "
        f"90th percentile {percentile_90:.2f}°"
    )
    print(f"written     {options.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
