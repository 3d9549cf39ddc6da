"""Two fingers on a lift grip a table-tennis ball, hold it up and let it go.

    python examples/gripper/gripper.py

All that is there is in scenario.yaml. The plan is that of one finger; contact is simulated.
"""

from pathlib import Path

import numpy as np
from grip import fingers_duty, grip
from pydrake.trajectories import PiecewisePolynomial

from hardware import Station, drive
from limb_systems import LimbParameters
from limb_systems.views.panels import Curve, Panel
from limb_systems.views.plots import draw, save_figure
from planners import Task, plan, references

FOLDER = Path(__file__).parent
HOLDS, OPENS, END = 18.0, 23.0, 30.0  # s
LIFT = [0.0, 15.0, 17.0, 20.0, 22.0, END], [[0.0, 0.0, 0.05, 0.05, 0.0, 0.0]]  # s, m
finger = LimbParameters.load(FOLDER / "finger.yaml")
held = grip(finger, center=[0.085, 0.035], radius=0.02, force=0.1)  # m, from the base, and N
bends = np.array([[0.0, 0.0, held.bend_angle, held.bend_angle, 0.0, 0.0]])
motion = references.from_samples([0.0, 12.0, 14.0, OPENS, OPENS + 1.0, END], bends)
planned = plan(finger, motion, task=Task(duty_weight=0.05))
inputs = fingers_duty(planned)
inputs["wrist.desired_state"] = PiecewisePolynomial.CubicShapePreserving(*LIFT, True)
seen = drive(Station(FOLDER / "scenario.yaml"), inputs, END)

time, force = seen["time"], np.linalg.norm(seen["left_finger.contact_force"], axis=0)
hot, duty = held.wire_temperature.max(), planned.duty[:, planned.time >= HOLDS][:, 0].max()
opens = planned.time[planned.bend_angle[0] > held.gripping_bend_angle][-1] - OPENS
free = time[np.flatnonzero(force)[-1]] - OPENS
print(f"grip        {held.force:.3f} N at {hot:.0f} °C, at most {held.largest_force:.3f} N")
print(f"plan        held with a duty of {duty:.2f}, open {opens:.1f} s after that")
print(f"simulation  {force[time >= HOLDS][0]:.3f} N, the ball is free after {free:.1f} s")
temperature, height = seen["left_finger.wire_temperature"][1], 1e3 * seen["ball.state"][6]
shown = {"force (N)": force, "right wire (°C)": temperature, "height of the ball (mm)": height}
panels = [Panel(label, [Curve("", time, values, "#5b6b8c")]) for label, values in shown.items()]
save_figure(draw(panels), "out/gripper.png")
