"""The paper's procedure, end to end, on an emulated limb.

Records an emulated limb whose physics is richer than the model, calibrates the
model to the recordings, plans the reference of Fig. 5 with it, replays the
plan five times open loop, and leaves files, pictures, a report and a 3D replay
in a folder (`out` by default). Nothing here knows what the emulation is made of.

    python examples/demo.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

from calibration import (
    calibrate,
    calibration_summary,
    collect_from_twin,
    plot_validation,
    save_parameters,
    save_recordings,
    write_report,
)
from hardware import LimbTwin, SerialLimb, emulated_port, replay
from limb_systems import write_meshcat_replay
from limb_systems.plots import plot_tracking, save_figure
from limb_systems.tracking import tracking_errors
from planners import plan, references
from planners.report import plan_summary

PAPER_TABLE_1 = (3.44, 2.33, 7.43)  # degrees, the row 'Validation'
PAUSE = 300.0  # s between rollouts, to cool down


def main(folder: Path) -> None:
    twin = LimbTwin(seed=0)
    print("Recording an emulated limb, for half an hour of its time ...", flush=True)
    save_recordings(collect_from_twin(twin, num_angles=6), folder / "recordings")
    calibration = calibrate(folder / "recordings")
    save_parameters(calibration, folder / "limb.yaml")
    write_report(calibration, folder / "calibration.html")
    save_figure(plot_validation(calibration.validation), folder / "fig4.png")
    print(calibration_summary(calibration), end="\n\n")

    trajectory = plan(calibration.parameters, references.step_and_decaying_sine())
    trajectory.save(folder / "trajectory.csv")
    print(plan_summary(trajectory), end="\n\n")

    rollouts = [replay(trajectory, twin.again(PAUSE)) for _ in range(5)]
    for number, rollout in enumerate(rollouts, 1):
        rollout.save(folder / f"rollout_{number}.csv")
    errors = tracking_errors(trajectory, rollouts)

    print("tracking error |φ* - φ| of five open-loop rollouts, in degrees")
    print("                          mean   median   90th percentile")
    ours = np.rad2deg([errors.mean, errors.median, errors.percentile_90])
    for name, numbers in (("emulated limb", ours), ("the paper's robot", PAPER_TABLE_1)):
        print("{:<24}{:>6.2f}{:>9.2f}{:>18.2f}".format(name, *numbers))
    print("An emulation is no measurement: these numbers say nothing of a real limb.\n")

    # The same limb on a serial cable: the board's firmware behind a pseudo-terminal, in real time.
    start = plan(calibration.parameters, references.from_samples([0.0, 5.0], [0.0, 0.2]))
    with emulated_port(seed=0) as port:
        robot = SerialLimb(port, calibration.parameters)
        replay(start, robot, journal=folder / "serial.csv")
    late = np.percentile(1000 * np.array(robot.timing_errors), 99)
    print(
        f"serial      5 s over {port} in real time: 99% of the commands within {late:.1f} ms, "
        f"{robot.link.lost_samples} samples lost\n"
    )

    title = "Steps and decaying sinusoid: plan, and five rollouts on an emulated limb"
    save_figure(plot_tracking(trajectory, rollouts, title), folder / "fig5.png")
    write_meshcat_replay(folder / "replay.html", trajectory, title="Plan: steps, sinusoid")
    for path in sorted(folder.iterdir()):
        print(f"written     {path}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out"))
