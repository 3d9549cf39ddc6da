"""The paper's validation test, end to end, on an emulated limb.

Plans the reference of Fig. 5, checks the plan, replays it five times open
loop, and leaves files, pictures and a 3D replay in a folder (`out` by default):

    python examples/demo.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

from hardware import LimbTwin, replay
from limb_systems import LimbParameters, write_meshcat_replay
from limb_systems.plots import plot_tracking, save_figure
from limb_systems.tracking import tracking_errors
from planners import plan, references
from planners.report import plan_summary

PAPER_TABLE_1 = (3.44, 2.33, 7.43)  # degrees, the row 'Validation'


def main(folder: Path) -> None:
    parameters = LimbParameters()
    trajectory = plan(parameters, references.step_and_decaying_sine())
    parameters.save(folder / "limb.yaml")
    trajectory.save(folder / "trajectory.csv")
    print(plan_summary(trajectory), end="\n\n")

    rollouts = [replay(trajectory, LimbTwin(parameters, seed=seed)) for seed in range(5)]
    for number, rollout in enumerate(rollouts, 1):
        rollout.save(folder / f"rollout_{number}.csv")
    errors = tracking_errors(trajectory, rollouts)

    print("tracking error |φ* - φ| of five open-loop rollouts, in degrees")
    print("                          mean   median   90th percentile")
    ours = np.rad2deg([errors.mean, errors.median, errors.percentile_90])
    for name, numbers in (("emulated limb", ours), ("the paper's robot", PAPER_TABLE_1)):
        print("{:<24}{:>6.2f}{:>9.2f}{:>18.2f}".format(name, *numbers))
    print("The emulation is the model with sensor noise; it says nothing of a real limb.\n")

    title = "Steps and decaying sinusoid: plan, and five rollouts on an emulated limb"
    save_figure(plot_tracking(trajectory, rollouts, title), folder / "fig5.png")
    write_meshcat_replay(folder / "replay.html", trajectory, title="Plan: steps, sinusoid")
    for path in sorted(folder.iterdir()):
        print(f"written     {path}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out"))
