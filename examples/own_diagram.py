"""A limb in your own diagram, at the end of a swinging arm, with one wire heated.

python examples/own_diagram.py
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

# An arm that swings about its shoulder.
builder = DiagramBuilder()
plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.002)
box = SpatialInertia.SolidBoxWithMass(0.1, 0.2, 0.02, 0.02)  # kg, m
arm = plant.AddRigidBody("arm", box.Shift([-0.1, 0.0, 0.0]))  # from the shoulder along x
frames = plant.world_frame(), arm.body_frame()
joint = plant.AddJoint(RevoluteJoint("shoulder", *frames, axis=[0.0, 1.0, 0.0], damping=2e-3))
# A limb at the end of the arm.
finger = LimbParameters()  # or LimbParameters.load("limb.yaml")
tip = RigidTransform([0.2, 0.0, 0.0])
limb = add_limb(plant, finger, "finger", parent_frame=arm.body_frame(), X_PF=tip)
plant.Finalize()
# Its wires, with a constant duty.
wires = add_limb_actuation(builder, plant, limb, finger)
duty = builder.AddSystem(ConstantVectorSource([0.0, 0.25]))  # left and right
builder.Connect(duty.get_output_port(), wires.GetInputPort("duty"))
# Simulate.
arm_log = LogVectorOutput(plant.get_state_output_port(), builder, 0.02)
bend_log = LogVectorOutput(wires.GetOutputPort("bend_angle"), builder, 0.02)
simulator = Simulator(builder.Build())
simulator.AdvanceTo(20.0)

# Print and draw the angles.
context = simulator.get_context()
arm_deg = np.rad2deg(arm_log.FindLog(context).data()[joint.position_start()])
bend_deg = np.rad2deg(bend_log.FindLog(context).data()[0])
print(
    f"after 20 s the arm hangs by {arm_deg[-1]:.0f}°, and the limb is bent by {bend_deg[-1]:.1f}°"
)
time = 0.02 * np.arange(len(arm_deg))
curves = {"arm (°)": arm_deg, "limb (°)": bend_deg}
panels = [Panel(label, [Curve("", time, y, "#5b6b8c")]) for label, y in curves.items()]
save_figure(draw(panels), "out/own_diagram.png")
