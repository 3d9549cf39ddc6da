"""Your own controller: a plan's duty with PI feedback of the bend angle, on emulated limbs.

    python examples/custom_controller.py [PLAN.csv] [-o FOLDER]

D = D* + [-u, u] within [0, 1], with u = k_p e + k_i ∫ e dt and e = φ* - φ, at 20 Hz.
"""

import argparse

import numpy as np
from pydrake.systems.framework import LeafSystem

from hardware import LimbTwin, replay
from limb_systems import LimbParameters, Trajectory
from limb_systems.model.ownership import weak_method
from limb_systems.tracking import tracking_errors
from limb_systems.views.plots import plot_tracking, save_figure
from planners import plan, references


class PlanFeedback(LeafSystem):
    __slots__ = ()  # so that it is freed; limb_systems/model/ownership.py says why

    def __init__(self, trajectory):
        super().__init__()
        plan = trajectory.since_start()
        self._duty = plan.duty_trajectory()
        self._angle = references.from_samples(plan.time, plan.bend_angle)
        self.DeclareVectorInputPort("bend_angle", 1)
        self.DeclareDiscreteState(1)  # ∫ e dt, rad s
        self.DeclareStateOutputPort("duty", self.DeclareDiscreteState(2))
        self.DeclarePeriodicDiscreteUpdateEvent(0.05, 0.0, weak_method(self._update))

    def _update(self, context, state):
        error = self._angle.value(context.get_time())[0] - self.get_input_port().Eval(context)
        state.set_value(0, state.value(0) + 0.05 * error)
        feedback = (0.5 * error + 0.04 * state.value(0)) * [-1.0, 1.0]
        state.set_value(1, np.clip(self._duty.value(context.get_time())[:, 0] + feedback, 0.0, 1.0))


def closed_loop(trajectory, limb):
    return replay(trajectory, limb, controller=PlanFeedback(trajectory))


parser = argparse.ArgumentParser(description="Compares feedback of the bend angle with open loop.")
parser.add_argument("plan", nargs="?", help="trajectory (.csv); one with two steps if left out")
parser.add_argument("-o", "--out", default="out", help="folder for the pictures")
options = parser.parse_args()
steps = references.from_samples([0, 22, 25, 38, 42, 54], np.deg2rad([0, 0, 20, 20, -10, -10]))
trajectory = Trajectory.load(options.plan) if options.plan else plan(LimbParameters(), steps)
for name, run in (("open_loop", replay), ("closed_loop", closed_loop)):
    rollouts = [run(trajectory, LimbTwin(trajectory.parameters, seed=seed)) for seed in range(3)]
    missed = np.rad2deg(tracking_errors(trajectory, rollouts).mean)
    print(title := f"{name}: mean |φ* - φ| of three emulated limbs {missed:.2f}°")
    save_figure(plot_tracking(trajectory, rollouts, title), f"{options.out}/{name}.png")
