"""A plan with your own cost and your own constraint: smooth duty, and a supply with a slow fuse.

    python examples/own_cost.py

The fuse limits the mean current over any 3 s to half of the current of one wire at full duty.
"""

import sys

import numpy as np

from limb_systems import LimbError, LimbParameters
from limb_systems.views.panels import Curve, Panel
from limb_systems.views.plots import draw, save_figure
from planners import Task, plan, references
from soft_limb.results.summaries import plan_summary


def limit_supply(program):
    duty = program.prog.decision_variables()[program.duty]  # (K, W)
    # Add a cost on the change of duty between knots.
    for change in np.diff(duty, axis=0):
        program.prog.AddQuadraticCost(50 * change @ change).evaluator().set_description("jumps")
    # Limit the mean of both wires' duty over each window of 3 s, or 30 knots.
    for total in np.lib.stride_tricks.sliding_window_view(duty.sum(axis=1), 30):
        program.prog.AddLinearConstraint(total.mean() <= 0.5).evaluator().set_description("fuse")


tasks = {"as usual": (Task(), "#999999"), "with a fuse": (Task(customize=limit_supply), "#e07b1f")}
steps = references.from_samples([0, 22, 24, 32, 36, 45], np.deg2rad([0, 0, 25, 25, -15, -15]))
bend_panel = Panel("bend angle (°)", [])
duty_panel = Panel("duty, left + right", [], from_zero=True)
try:
    for name, (task, color) in tasks.items():
        trajectory = plan(LimbParameters(), steps, task=task)
        bend = np.rad2deg(trajectory.bend_angle[0])
        bend_panel.curves.append(Curve(name, trajectory.time, bend, color))
        duty_panel.curves.append(Curve(name, trajectory.time, trajectory.duty.sum(axis=0), color))
    save_figure(draw([bend_panel, duty_panel]), "out/own_cost.png")
    trajectory.save("out/own_cost.csv")
    print(plan_summary(trajectory), "written     own_cost.csv and .png in out", sep="\n")
except LimbError as error:
    sys.exit(f"error: {error}")
