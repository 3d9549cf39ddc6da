"""Plan for an emulated limb, then repeat the paper's evaluation with it: `make demo`.

The demo plans ramps for the limb as described. Then it records an emulated limb, calibrates its
model, plans the ramps, the motion of Fig. 5 and two taught motions, and drives the limb in open
loop, by feedback and with learning. It takes two minutes on two cores. The folder gets report.html,
replay.html, pictures, recordings and plans; files of an earlier demo are replaced.

    python examples/demo.py [FOLDER]
"""

import argparse
import sys
from pathlib import Path

from reproduce_paper.experiment import Settings
from reproduce_paper.reproduce import reproduce_in

from limb_systems import LimbParameters
from planners import plan, references
from soft_limb.command import run_command
from soft_limb.results.summaries import plan_summary


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", default="out", type=Path, help="for all results")
    folder = parser.parse_args().folder
    return run_command(lambda: demo(folder), f"stopped; what is finished is kept in {folder}")


def demo(folder: Path) -> int:
    """Run the demo, and return its exit status."""
    print("planning ramps for the limb as described ...", flush=True)
    trajectory = plan(LimbParameters(), references.ramps())
    trajectory.save(folder / "first_plan.csv")
    print(plan_summary(trajectory))
    return reproduce_in(folder, [Settings(0, compare=False, disturb=False, quick=True)])


if __name__ == "__main__":
    sys.exit(main())
