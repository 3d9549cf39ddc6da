"""Your own controller on an emulated limb, behind a supervisor that limits wire temperature.

    python examples/supervised_controller.py [PLAN.csv] [-o FOLDER]

The controller is a PI controller of the bend angle at 20 Hz: D = [-u, u], clipped to [0, 1], with
u = k_p e + k_i ∫ e dt and e = φ_ref - φ. It measures no temperature: if the reference is out of
reach, its duty grows until the limb cuts out.
"""

import argparse

import numpy as np
from pydrake.systems.framework import LeafSystem

from controllers import supervised
from hardware import LimbTwin, replay
from limb_systems import LimbParameters, Trajectory
from limb_systems.drake_python import weak_method
from limb_systems.views.plots import plot_tracking, save_figure
from planners import plan, references


class BendControl(LeafSystem):
    __slots__ = ()  # so that it is freed; limb_systems/drake_python.py says why

    def __init__(self, trajectory):
        super().__init__()
        self._plan = trajectory.since_start()
        self.DeclareVectorInputPort("bend_angle", 1)
        self.DeclareDiscreteState(1)  # ∫ e dt, rad s
        self.DeclareStateOutputPort("duty", self.DeclareDiscreteState(2))
        self.DeclarePeriodicDiscreteUpdateEvent(0.05, 0.0, weak_method(self._update))

    def _update(self, context, state):
        reference = self._plan.interpolated(self._plan.reference, context.get_time())
        error = reference - self.get_input_port().Eval(context)
        state.set_value(0, state.value(0) + 0.05 * error)
        asked = (2.0 * error + 0.5 * state.value(0)) * [-1.0, 1.0]
        state.set_value(1, np.clip(asked, 0.0, 1.0))


parser = argparse.ArgumentParser(description="Drive a limb with a controller, then supervise it.")
parser.add_argument("plan", nargs="?", help="trajectory (.csv); one with two steps if left out")
parser.add_argument("-o", "--out", default="out", help="folder for the pictures")
options = parser.parse_args()
steps = references.from_samples([0, 22, 25, 38, 42, 54], np.deg2rad([0, 0, 55, 55, -10, -10]))
trajectory = Trajectory.load(options.plan) if options.plan else plan(LimbParameters(), steps)
parameters = trajectory.parameters
for name in ("alone", "supervised"):
    controller = BendControl(trajectory)
    if name == "supervised":
        controller = supervised(controller, parameters)
    recording = replay(trajectory, LimbTwin(parameters, seed=0, truth=True), controller=controller)
    print(title := f"{name}: wires got {recording.wire_temperature.max():.0f} °C hot")
    print(f"  it ended early: {recording.interrupted}" if recording.interrupted else "  to the end")
    save_figure(plot_tracking(trajectory, [recording], title), f"{options.out}/{name}.png")
