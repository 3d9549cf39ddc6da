"""A limb in a diagram of your own: `python examples/own_diagram.py`.

It is at the end of an arm that swings, and one of its wires is heated.
"""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from limb_systems import LimbParameters, add_limb, add_limb_actuation
from limb_systems.views.panels import Curve, Panel
from limb_systems.views.plots import draw, save_figure

finger, builder = LimbParameters(), DiagramBuilder()  # or LimbParameters.load("limb.yaml")
plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.002)
box = SpatialInertia.SolidBoxWithMass(0.1, 0.2, 0.02, 0.02)  # kg, m
arm = plant.AddRigidBody("arm", box.Shift([-0.1, 0.0, 0.0]))  # from the shoulder along x
frames = plant.world_frame(), arm.body_frame()
joint = plant.AddJoint(RevoluteJoint("shoulder", *frames, axis=[0.0, 1.0, 0.0], damping=2e-3))
tip = RigidTransform([0.2, 0.0, 0.0])
limb = add_limb(plant, finger, "finger", parent_frame=arm.body_frame(), X_PF=tip)
plant.Finalize()
wires = add_limb_actuation(builder, plant, limb, finger)
duty = builder.AddSystem(ConstantVectorSource([0.0, 0.25]))  # left and right
builder.Connect(duty.get_output_port(), wires.GetInputPort("duty"))
arm_log = LogVectorOutput(plant.get_state_output_port(), builder, 0.02)
bend_log = LogVectorOutput(wires.GetOutputPort("bend_angle"), builder, 0.02)
simulator = Simulator(builder.Build())
simulator.AdvanceTo(20.0)

states, bends = (log.FindLog(simulator.get_context()).data() for log in (arm_log, bend_log))
arm, bend = np.rad2deg(states[joint.position_start()]), np.rad2deg(bends[0])
print(f"after 20 s the arm hangs by {arm[-1]:.0f}°, and the limb is bent by {bend[-1]:.1f}°")
time, shown = 0.02 * np.arange(len(arm)), {"arm (°)": arm, "limb (°)": bend}
panels = [Panel(label, [Curve("", time, y, "#5b6b8c")]) for label, y in shown.items()]
save_figure(draw(panels), "out/own_diagram.png")
