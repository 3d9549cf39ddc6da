"""Plan a reference of one's own, replay it, and see how well it went.

python examples/plan_and_replay.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

from hardware import LimbTwin, replay
from limb_systems import LimbParameters
from limb_systems.plots import plot_tracking, save_figure
from limb_systems.tracking import tracking_errors
from planners import plan, references
from planners.report import plan_summary

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
times = np.arange(0.0, 45.0, 0.1)
wave = np.where(times > 20.0, np.deg2rad(15.0) * np.sin(2 * np.pi * (times - 20.0) / 12.0), 0.0)

parameters = LimbParameters()  # or LimbParameters.load("limb.yaml")
trajectory = plan(parameters, references.from_samples(times, wave))
trajectory.save(folder / "my_trajectory.csv")
print(plan_summary(trajectory))

# The emulated limb is not quite as the nominal parameters say; examples/demo.py calibrates first.
recording = replay(trajectory, LimbTwin(parameters, seed=1))
recording.save(folder / "my_recording.csv")
errors = tracking_errors(trajectory, [recording])
print(f"mean tracking error on the emulated limb: {np.rad2deg(errors.mean):.2f}°")
save_figure(plot_tracking(trajectory, [recording]), folder / "my_plan.png")
