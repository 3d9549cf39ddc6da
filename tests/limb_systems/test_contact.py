"""Forces of contact on bodies, against weight."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import ContactModel
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from limb_systems.contact import ContactForces
from walking.robot import add_contact_plant

GRIPPER = Path(__file__).parents[2] / "examples" / "gripper"


@pytest.mark.parametrize("model", [ContactModel.kHydroelastic, ContactModel.kPoint])
def test_a_ball_at_rest_is_carried_by_its_weight_and_presses_as_much(model):
    builder = DiagramBuilder()
    plant = add_contact_plant(builder)
    plant.set_contact_model(model)
    for name in ("ball", "table"):
        Parser(plant).AddModels(GRIPPER / f"{name}.sdf")
    ball, table = plant.GetBodyByName("ball"), plant.GetBodyByName("table")
    plant.WeldFrames(plant.world_frame(), table.body_frame())
    plant.SetDefaultFloatingBaseBodyPose(ball, RigidTransform([0.0, 0.0, 0.02]))
    plant.Finalize()
    forces = builder.AddSystem(ContactForces(plant, [[ball.index()], [table.index()]]))
    builder.Connect(plant.get_contact_results_output_port(), forces.get_input_port())
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.0)
    actual = forces.get_output_port().Eval(forces.GetMyContextFromRoot(simulator.get_context()))
    weight = 9.81 * 0.0027
    np.testing.assert_allclose(actual, [0.0, 0.0, weight, 0.0, 0.0, -weight], atol=0.02 * weight)
