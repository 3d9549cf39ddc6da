"""Two fingers on a lift grip a table-tennis ball, hold it up and let it go.

    python examples/gripper/gripper.py

scenario.yaml describes fingers, lift and ball. One finger is planned for; contact is simulated.
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
# Compute the bend for the force, and plan to bend, hold and open.
grip_state = grip(finger, center=[0.085, 0.035], radius=0.02, force=0.1)  # m, from the base, and N
closed = grip_state.bend_angle
bends = np.array([[0.0, 0.0, closed, closed, 0.0, 0.0]])
motion = references.from_samples([0.0, 12.0, 14.0, OPENS, OPENS + 1.0, END], bends)
planned = plan(finger, motion, task=Task(duty_weight=0.05))
# Simulate both fingers on the lift.
inputs = fingers_duty(planned)
inputs["wrist.desired_state"] = PiecewisePolynomial.CubicShapePreserving(*LIFT, True)
signals = drive(Station(FOLDER / "scenario.yaml"), inputs, END)

# Print forces and times of plan and simulation.
time = signals["time"]
force = np.linalg.norm(signals["left_finger.contact_force"], axis=0)
hottest = grip_state.wire_temperature.max()
duty = planned.duty[:, planned.time >= HOLDS][:, 0].max()
opens = planned.time[planned.bend_angle[0] > grip_state.gripping_bend_angle][-1] - OPENS
free = time[np.flatnonzero(force)[-1]] - OPENS
most = grip_state.largest_force
print(f"grip        {grip_state.force:.3f} N at {hottest:.0f} °C, at most {most:.3f} N")
print(f"plan        held with a duty of {duty:.2f}, open {opens:.1f} s after that")
print(f"simulation  {force[time >= HOLDS][0]:.3f} N, the ball is free after {free:.1f} s")
# Draw the simulation.
curves = {
    "force (N)": force,
    "right wire (°C)": signals["left_finger.wire_temperature"][1],
    "height of the ball (mm)": 1e3 * signals["ball.state"][6],
}
panels = [Panel(label, [Curve("", time, values, "#5b6b8c")]) for label, values in curves.items()]
save_figure(draw(panels), "out/gripper.png")
