"""A limb in your own diagram: heats the right wire and prints the bend angle.

python examples/compose_diagram.py
"""

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from limb_systems import Limb

builder = DiagramBuilder()
limb = builder.AddSystem(Limb())
duty = builder.AddSystem(ConstantVectorSource([0.0, 0.2]))  # left, right
builder.Connect(duty.get_output_port(), limb.GetInputPort("duty"))
log = LogVectorOutput(limb.GetOutputPort("bend_angle"), builder, publish_period=0.05)
simulator = Simulator(builder.Build())
ApplySimulatorConfig(SimulatorConfig(integration_scheme="radau3"), simulator)
simulator.AdvanceTo(60.0)
angle = log.FindLog(simulator.get_context()).data()[0]
print(f"bend angle after 60 s: {np.rad2deg(angle[-1]):.1f}°")
