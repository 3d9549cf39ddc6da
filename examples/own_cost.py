"""A plan with a cost and a constraint of your own: smooth duty, and a supply with a slow fuse.

    python examples/own_cost.py

The fuse bears, on average over any 3 s, half of the current that one wire takes at full duty.
"""

import sys

import numpy as np

from limb_systems import LimbError, LimbParameters
from limb_systems.views.panels import Curve, Panel
from limb_systems.views.plots import draw, save_figure
from planners import Task, plan, references
from soft_limb.results.summaries import plan_summary


def supplied(program):
    duty = program.prog.decision_variables()[program.duty]  # (K, W)
    for change in np.diff(duty, axis=0):
        program.prog.AddQuadraticCost(50 * change @ change).evaluator().set_description("jumps")
    for total in np.lib.stride_tricks.sliding_window_view(duty.sum(axis=1), 30):  # 3 s
        program.prog.AddLinearConstraint(total.mean() <= 0.5).evaluator().set_description("fuse")


ways = {"as usual": (Task(), "#999999"), "with a fuse": (Task(customize=supplied), "#e07b1f")}
steps = references.from_samples([0, 22, 24, 32, 36, 45], np.deg2rad([0, 0, 25, 25, -15, -15]))
panels = [Panel("bend angle (°)", []), Panel("duty, left + right", [], from_zero=True)]
try:
    for name, (task, color) in ways.items():
        found = plan(LimbParameters(), steps, task=task)
        bend, total = np.rad2deg(found.bend_angle[0]), found.duty.sum(axis=0)
        panels[0].curves.append(Curve(name, found.time, bend, color))
        panels[1].curves.append(Curve(name, found.time, total, color))
    save_figure(draw(panels), "out/own_cost.png")
    found.save("out/own_cost.csv")
    print(plan_summary(found), "written     own_cost.csv and .png in out", sep="\n")
except LimbError as error:
    sys.exit(f"error: {error}")
