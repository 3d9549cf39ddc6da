#!/bin/sh
# Drake takes a penetration allowance and makes nothing of it.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
${PYTHON:-python3} -m venv "$folder"
"$folder/bin/pip" install --quiet --disable-pip-version-check drake==1.51.1
"$folder/bin/python" - <<'PY'
from importlib.metadata import version

from pydrake.geometry import HalfSpace, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder


def depth(allowance: float) -> float:
    """How far a ball of 1 kg is in the ground after a second, m."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    ball = plant.AddRigidBody("ball", SpatialInertia.SolidSphereWithMass(1.0, 0.05))
    here, friction = RigidTransform(), CoulombFriction(0.5, 0.5)
    plant.RegisterCollisionGeometry(ball, here, Sphere(0.05), "ball", friction)
    plant.RegisterCollisionGeometry(plant.world_body(), here, HalfSpace(), "ground", friction)
    plant.Finalize()
    plant.set_penetration_allowance(allowance)
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetFreeBodyPose(context, ball, RigidTransform([0.0, 0.0, 0.05]))
    simulator.AdvanceTo(1.0)
    return 0.05 - plant.EvalBodyPoseInWorld(context, ball).translation()[2]


print("Drake", version("drake"))
print("guess:  a ball sinks in as far as the allowance says, 0.1 mm and 10 mm")
depths = [depth(allowance) for allowance in (1e-4, 1e-2)]
print("result: it sinks in by", " and ".join(f"{1e3 * each:.3f} mm" for each in depths))
assert depths[0] == depths[1]
PY
