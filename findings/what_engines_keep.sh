#!/bin/sh
# What Drake, MuJoCo, Pinocchio, PyBullet, DART and SAPIEN keep of one hinge in a file, and add to it.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
${PYTHON:-python3} -m venv "$folder"
"$folder/bin/pip" install --quiet --disable-pip-version-check \
    drake==1.51.1 mujoco-core==4.0.0 pin==4.1.0 pybullet==3.2.7 dartpy==6.20.0 sapien==3.0.3 setuptools==80.9.0
"$folder/bin/python" - <<'PY'
"""What Drake, MuJoCo, Pinocchio, PyBullet, DART and SAPIEN keep of one hinge in a file."""

import tempfile
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pybullet
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

URDF = """<robot name="hinge"><link name="base"/><link name="link"><inertial>
<origin xyz="0.1 0 0"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 0 1"/>
<limit lower="-0.5" upper="0.5" effort="1.5" velocity="10"/>
<dynamics damping="0.2" friction="0.1"/></joint></robot>"""
MJCF = """<mujoco model="hinge"><compiler angle="radian"/><worldbody><body name="link">
<inertial mass="1" pos="0.1 0 0" diaginertia="0.01 0.01 0.01"/>
<joint name="hinge" axis="0 0 1" range="-0.5 0.5" stiffness="5" springref="0.3" damping="0.2"
armature="0.02" actuatorfrcrange="-2 2"/></body></worldbody>
<actuator><motor name="motor" joint="hinge" forcerange="-1.5 1.5"/></actuator></mujoco>"""
SDF = """<sdf version="1.11" xmlns:drake="http://drake.mit.edu"><model name="hinge">
<link name="one"/><link name="other"/>
<joint name="hinge" type="revolute"><parent>world</parent><child>one</child><axis>
<xyz>0 0 1</xyz><dynamics><damping>0.2</damping><spring_stiffness>5</spring_stiffness>
<spring_reference>0.3</spring_reference></dynamics></axis></joint>
<joint name="second" type="revolute"><parent>world</parent><child>other</child><axis>
<xyz>0 0 1</xyz>{inside}</axis>{beside}</joint></model></sdf>"""
MIMIC = '<mimic joint="hinge"><multiplier>2</multiplier><offset>0</offset></mimic>'
DRAKE_MIMIC = '<drake:mimic joint="hinge" multiplier="2" offset="0"/>'


def in_drake(text: str, kind: str) -> MultibodyPlant:
    plant = MultibodyPlant(0.001)
    Parser(plant).AddModelsFromString(text, kind)
    plant.Finalize()
    return plant


def num_springs(plant: MultibodyPlant) -> int:
    return plant.num_force_elements() - 1  # gravity


folder = Path(tempfile.mkdtemp())
urdf, mjcf = folder / "hinge.urdf", folder / "hinge.xml"
urdf.write_text(URDF)
mjcf.write_text(MJCF)
found: dict[str, object] = {}

# Springs and mimic of SDFormat, and springs and effort of MJCF, in Drake.
sdf = in_drake(SDF.format(inside="", beside=""), "sdf")
found["SDFormat, spring: Drake"] = num_springs(sdf)
found["SDFormat, mimic: Drake"] = in_drake(
    SDF.format(inside=MIMIC, beside=""), "sdf"
).num_constraints()
found["SDFormat, drake:mimic: Drake"] = in_drake(
    SDF.format(inside="", beside=DRAKE_MIMIC), "sdf"
).num_constraints()
plant = in_drake(MJCF, "xml")
joint = plant.GetJointByName("hinge")
motor = plant.GetJointActuatorByName("motor")
found["MJCF, spring: Drake"] = num_springs(plant)
found["MJCF, damping: Drake"] = joint.default_damping()
found["MJCF, armature: Drake"] = motor.default_reflected_inertia()
found["MJCF, limit: Drake"] = joint.position_upper_limits()[0]
found["MJCF, effort: Drake"] = motor.effort_limit()
joint = in_drake(URDF, "urdf").GetJointByName("hinge")
found["URDF, damping: Drake"] = joint.default_damping()

# MuJoCo.
model = mujoco.MjModel.from_xml_path(str(mjcf))
found["MJCF, spring: MuJoCo"] = model.jnt_stiffness[0]
found["MJCF, reference: MuJoCo"] = model.qpos_spring[0]
model = mujoco.MjModel.from_xml_path(str(urdf))
found["URDF, damping: MuJoCo"] = model.dof_damping[0]
found["URDF, friction: MuJoCo"] = model.dof_frictionloss[0]

# Pinocchio, which has no springs.
model = pinocchio.buildModelFromMJCF(str(mjcf))
found["MJCF, damping: Pinocchio"] = model.damping[0]
found["MJCF, armature: Pinocchio"] = model.armature[0]
found["MJCF, effort: Pinocchio"] = model.upperEffortLimit[0]
model = pinocchio.buildModelFromUrdf(str(urdf))
found["URDF, friction: Pinocchio"] = model.upperDryFrictionLimit[0]

# PyBullet: inertia, and the speed of a link that turns at 10 rad/s, after a second.
pybullet.connect(pybullet.DIRECT)
body = pybullet.loadURDF(str(urdf), useFixedBase=True)
found["URDF, inertia: PyBullet"] = pybullet.getDynamicsInfo(body, 0)[2][2]
free = URDF.replace('damping="0.2" friction="0.1"', 'damping="0" friction="0.05"')
free = free.replace('type="revolute"', 'type="continuous"').replace('xyz="0.1 0 0"', 'xyz="0 0 0"')
free = free.replace('<limit lower="-0.5" upper="0.5" effort="1.5" velocity="10"/>', "")
other = folder / "free.urdf"  # PyBullet does not read a file of the same name again
other.write_text(free)
body = pybullet.loadURDF(
    str(other), useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE
)
pybullet.setJointMotorControl2(body, 0, pybullet.VELOCITY_CONTROL, force=0)
pybullet.resetJointState(body, 0, 0.0, 10.0)
for _ in range(240):
    pybullet.stepSimulation()
found["URDF, speed of 10 rad/s after 1 s: PyBullet"] = pybullet.getJointState(body, 0)[1]

# DART.
import dartpy  # noqa: E402  # after MuJoCo: both bring libraries of the same names

loader = dartpy.utils.DartLoader() if hasattr(dartpy, "utils") else dartpy.io.DartLoader()
skeleton = loader.parseSkeleton(str(urdf))
found["URDF, degrees of freedom: DART"] = skeleton.getNumDofs()
world = dartpy.simulation.World()
world.setGravity([0.0, 0.0, 0.0])
world.setTimeStep(0.01)
skeleton = dartpy.dynamics.Skeleton("spring")
joint, body = skeleton.createRevoluteJointAndBodyNodePair()
body.setInertia(dartpy.dynamics.Inertia(1.0, [0.0, 0.0, 0.0], np.eye(3)))
joint.setSpringStiffness(0, 25.0)
joint.setPosition(0, 1.0)
world.addSkeleton(skeleton)
angles = []
for _ in range(800):
    world.step()
    angles.append(joint.getPosition(0))
peaks = [b for a, b, c in zip(angles, angles[1:], angles[2:]) if a < b > c]
found["damping ratio of a spring without damping, 5 rad/s, 10 ms: DART"] = (
    np.log(peaks[0] / peaks[4]) / (8 * np.pi)
)

# SAPIEN.
import sapien  # noqa: E402

scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
robot = scene.create_urdf_loader().load(str(urdf))
found["URDF, friction: SAPIEN"] = robot.get_active_joints()[0].friction
found["URDF, damping of a link: SAPIEN"] = robot.links[1].angular_damping

EXPECTED = {
    "SDFormat, spring: Drake": 1,
    "SDFormat, mimic: Drake": 0,
    "SDFormat, drake:mimic: Drake": 1,
    "MJCF, spring: Drake": 0,
    "MJCF, damping: Drake": 0.2,
    "MJCF, armature: Drake": 0.02,
    "MJCF, limit: Drake": 0.5,
    "MJCF, effort: Drake": 1.5,
    "URDF, damping: Drake": 0.2,
    "MJCF, spring: MuJoCo": 5.0,
    "MJCF, reference: MuJoCo": 0.3,
    "URDF, damping: MuJoCo": 0.2,
    "URDF, friction: MuJoCo": 0.1,
    "MJCF, damping: Pinocchio": 0.2,
    "MJCF, armature: Pinocchio": 0.02,
    "MJCF, effort: Pinocchio": 2.0,
    "URDF, friction: Pinocchio": 0.1,
    "URDF, inertia: PyBullet": 6.67e-7,
    "URDF, speed of 10 rad/s after 1 s: PyBullet": 6.90,
    "URDF, degrees of freedom: DART": 7,
    "damping ratio of a spring without damping, 5 rad/s, 10 ms: DART": 0.025,
    "URDF, friction: SAPIEN": 0.05,
    "URDF, damping of a link: SAPIEN": 0.05,
}
for what, value in found.items():
    print(f"{what:66} {value:.3g}, expected {EXPECTED[what]:.3g}")
assert all(np.isclose(found[what], value, rtol=0.01) for what, value in EXPECTED.items())
PY
