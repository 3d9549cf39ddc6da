"""Limbs on anybody's plant: against the limb alone, from files too, and what is refused."""

import numpy as np
import pytest
from pydrake.geometry import (
    AddCompliantHydroelasticPropertiesForHalfSpace,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    HalfSpace,
    ProximityProperties,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.multibody.tree import FixedOffsetFrame, SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from limb_systems import (
    Limb,
    LimbError,
    LimbParameters,
    SegmentParameters,
    add_limb,
    add_limb_actuation,
    simulate,
    tip_position,
)
from limb_systems.simulation import make_simulator
from urdf import limb_sdf, limb_urdf

DUTY = {"left": [0.0, 0.3], "right": [0.25, 0.1]}


def limb_with(rest_angle=0.1, gravity=(0.0, 0.0, 0.0)):
    segment = SegmentParameters(links=2, stiffness=0.0623, rest_angle=rest_angle)
    limb = LimbParameters(segments=[segment])
    limb.payload = 0.005
    limb.gravity = list(gravity)
    return limb


def driven(builder, plant, fingers, parameters, accuracy=1e-5, duration=4.0):
    """The bends of some limbs under their `DUTY`, after a time, s."""
    sinks = {}
    for name, limb in fingers.items():
        wires = add_limb_actuation(builder, plant, limb, parameters)
        source = builder.AddSystem(ConstantVectorSource(DUTY[name]))
        builder.Connect(source.get_output_port(), wires.GetInputPort("duty"))
        sinks[name] = LogVectorOutput(wires.GetOutputPort("bend_angle"), builder, 0.5)
    simulator = make_simulator(builder.Build(), accuracy)
    simulator.AdvanceTo(duration)
    return {name: sink.FindLog(simulator.get_context()).data() for name, sink in sinks.items()}


def test_two_limbs_on_a_body_beside_a_free_one_bend_as_each_alone():
    tilted = RollPitchYaw(0.4, -0.9, 2.0).ToRotationMatrix()
    down = tilted.inverse() @ np.array([0.0, 0.0, -9.81])
    parameters = limb_with(gravity=down)
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    plant.AddRigidBody("ball", SpatialInertia.SolidSphereWithMass(0.01, 0.02))
    wrist = plant.AddFrame(
        FixedOffsetFrame("wrist", plant.world_frame(), RigidTransform([0.1, 0.2, 0.3]))
    )
    fingers = {
        name: add_limb(
            plant,
            parameters,
            f"{name}_finger",
            parent_frame=wrist,
            X_PF=RigidTransform(tilted, [0.0, y, 0.0]),
        )
        for name, y in (("left", -0.05), ("right", 0.05))
    }
    plant.Finalize()
    context = plant.CreateDefaultContext()
    angles = np.array([0.1, 0.5])
    plant.SetPositions(context, fingers["right"], angles)
    base, tip = (plant.GetFrameByName(name, fingers["right"]) for name in ("base", "tip"))
    at = tip.CalcPose(context, base).translation()
    np.testing.assert_allclose(at[:2], tip_position(parameters, angles), atol=1e-12)
    for name, bend in driven(builder, plant, fingers, parameters).items():
        alone = simulate(Limb(parameters), DUTY[name], 4.0, sample_rate=2.0, accuracy=1e-5)
        np.testing.assert_allclose(bend, alone.bend_angle, atol=5e-5)
        assert np.abs(bend).max() > 0.1


def test_a_limb_from_a_file_bends_as_the_limb_alone(tmp_path):
    parameters = limb_with()
    file = tmp_path / "finger.sdf"
    file.write_text(limb_sdf(parameters.segments, payload=parameters.payload))
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    (limb,) = Parser(plant).AddModels(file)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, 0.0])
    plant.Finalize()
    bend = driven(builder, plant, {"left": limb}, parameters)["left"][:, -1]
    alone = simulate(Limb(parameters), DUTY["left"], 4.0).bend_angle[:, -1]
    np.testing.assert_allclose(bend, alone, atol=1e-4)


def test_a_limb_in_space_does_not_collide_with_itself():
    parameters = LimbParameters.in_space(wires=2, links=2)
    (segment,) = parameters.segments
    segment.stiffness = 0.0623
    segment.twists = True
    segment.centred_joints = True
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
    limb = add_limb(plant, parameters)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, 0.0])
    plant.Finalize()
    for body in plant.GetBodyIndices(limb):  # Drake may divide by each mass
        assert plant.get_body(body).default_mass() > 0.0
    bend = driven(builder, plant, {"left": limb}, parameters, accuracy=None)["left"][:, -1]
    alone = simulate(Limb(parameters), DUTY["left"], 4.0).bend_angle[:, -1]
    np.testing.assert_allclose(bend, alone, atol=2e-3)
    assert np.abs(bend).max() > 0.1


@pytest.mark.parametrize(("is_rigid", "makes_surfaces"), [(True, True), (False, False)])
def test_a_limb_makes_hydroelastic_contact_with_rigid_ground_alone(is_rigid, makes_surfaces):
    """Drake has no surface between two compliant shapes of which one is a half space."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
    plant.set_contact_model(ContactModel.kHydroelasticWithFallback)
    ground = ProximityProperties()
    AddContactMaterial(None, None, CoulombFriction(0.5, 0.5), ground)
    if is_rigid:
        AddRigidHydroelasticProperties(ground)
    else:
        AddCompliantHydroelasticPropertiesForHalfSpace(0.02, 1e6, ground)
    top = RigidTransform([0.0, 0.0, -0.009])  # the limb, 2 cm wide, reaches 1 mm below it
    plant.RegisterCollisionGeometry(plant.world_body(), top, HalfSpace(), "ground", ground)
    add_limb(plant)
    plant.SetUseSampledOutputPorts(False)
    plant.Finalize()
    diagram = builder.Build()
    context = plant.GetMyContextFromRoot(diagram.CreateDefaultContext())
    results = plant.get_contact_results_output_port().Eval(context)
    assert (results.num_hydroelastic_contacts() > 0) == makes_surfaces
    assert (results.num_point_pair_contacts() > 0) != makes_surfaces


def test_models_that_do_not_fit_their_description_are_refused():
    parameters, builder = LimbParameters(), DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    text = limb_urdf(parameters.segments)
    (limp,) = Parser(plant).AddModelsFromString(text, "urdf")
    finger = add_limb(plant, parameters, "finger")
    arm = add_limb(plant, parameters, "arm")
    plant.AddRigidBody("tool", arm, SpatialInertia.SolidSphereWithMass(0.01, 0.02))
    (free,) = Parser(plant, "free").AddModelsFromString(limb_sdf(parameters.segments), "sdf")
    plant.Finalize()
    stiffer = LimbParameters(segments=[SegmentParameters(stiffness=0.2)])
    shorter = LimbParameters(segments=[SegmentParameters(links=3)])
    for model, described, said in (
        (free, parameters, "base of the limb 'free::limb' is free; weld the frame base"),
        (limp, parameters, "'limb' has no springs or no actuators.*parse its SDFormat"),
        (arm, parameters, "limb 'arm' has other bodies, too: tool; give"),
        (finger, stiffer, "joint_1 of the limb 'finger' is 0.1246 N·m/rad in the pl"),
        (finger, shorter, "'finger' has 5 joints in the plant and 3 in its descr"),
    ):
        with pytest.raises(LimbError, match=said):
            add_limb_actuation(builder, plant, model, described)
