"""How a robot walks in MuJoCo, a simulator that shares no code with Drake or with the planner.

The program reads a gait and its robot from a file, builds a model of the robot for MuJoCo, and
applies the duty of the gait open loop. It prints the travel of the body in each cycle beside the
plan: x and y are along and across the heading at the start of the cycle. The two shares are the
travel along the planned one and aside of it, both as shares of the planned travel.

The equations are stated here anew; this program takes only the reader of files from this project.

- A link is a box on hinges with springs and dampers, a foot is a sphere, the ground is a plane.
- A wire heats by T' = a1 (T - T0) + a2 D. It exerts the torque beta (T - T0) on each joint of its
  segment, in the direction in which the wire lies from the axis of the segment.
- A foot sinks in by its load over 10 kN/m, as in `Robot`. A foot that sticks creeps by 0.01 mm/s
  for each N along the ground. In `Robot` it creeps by 0.4 mm/s.
- MuJoCo lifts a foot that slides, by friction times speed times DAMPING / STIFFNESS: some 0.01 mm.
  With a tenth of DAMPING such feet vibrate, which changes strides on four feet by 2% to 6%.
- A robot falls when its body tilts by more than 60 degrees or touches the ground.

Segments with `stiffening`, `rest_memory` or `centred_joints` are refused, and so are wires of
another law than `LinearLaw`. MuJoCo (4.0) is not a dependency of this project:

    pip install mujoco
    python benchmarks/walks_in_mujoco.py gait.csv [-n CYCLES]
"""

import argparse
import itertools
import sys
import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
from scipy.linalg import block_diag

from limb_systems import LimbError, LinearLaw, SegmentParameters, WireParameters
from walking import Gait, RobotLimb, RobotParameters

TIME_STEP = 2e-4  # s
STIFFNESS, DAMPING = 1e4, 100.0  # N/m and N·s/m, of a foot on the ground
# MuJoCo adds IMPEDANCE / (1 - IMPEDANCE) times the inertia of a foot to its contact. Steps of
# TIME_STEP are stable with it, and it does not matter at the speed of a gait.
IMPEDANCE = 0.9
FRICTION_RATIO = 1000.0  # damping of a foot that sticks, as a multiple of DAMPING
LEAST_UPRIGHT = 0.5  # cosine of the tilt at which a robot has fallen
AXES = {"e2": "0 0 1", "e3": "0 -1 0", "twist": "1 0 0"}  # of joints, in the frame E1, E2, E3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("gait", help="file of a gait")
    parser.add_argument("-n", "--cycles", type=int, default=5, help="number of cycles (default 5)")
    options = parser.parse_args()
    if options.cycles < 1:
        parser.error(f"--cycles is {options.cycles}; it must be at least 1.")
    try:
        gait = Gait.load(options.gait)
        check_robot(gait.robot)
    except LimbError as error:
        sys.exit(str(error))
    print(f"{options.gait}: a cycle takes {gait.period:.2f} s")
    print("| cycle | x, mm | y, mm | turn, ° | along | aside |")
    print("| --- | --- | --- | --- | --- | --- |")
    poses, fall = walk(gait, options.cycles)
    planned = travel(*(planned_pose(gait.body_pose[:, knot]) for knot in (0, -1)))
    rows = [("plan", planned)]
    rows += [(str(k), travel(*pair)) for k, pair in enumerate(itertools.pairwise(poses), 1)]
    for name, moved in rows:
        along, aside = shares(moved, planned, gait.robot)
        x, y, turn = moved * [1e3, 1e3, np.rad2deg(1.0)]
        print(f"| {name} | {x:.2f} | {y:.2f} | {turn:.2f} | {along:.3f} | {aside:.3f} |")
    if fall:
        sys.exit(fall)


def check_robot(robot: RobotParameters) -> None:
    """Raise LimbError for a robot that this program cannot simulate."""
    if robot.body.mount == "welded" or robot.ground is None:
        raise LimbError("This robot cannot walk; it must have a ground and a body that moves.")
    for limb, segment in segments_of(robot):
        if segment.stiffening or segment.rest_memory or segment.centred_joints:
            raise LimbError(
                f"The limb {limb.name} has stiffening, rest_memory or centred_joints, which this "
                "program does not know; take a robot without them."
            )
        for wire in segment.wires:
            if type(wire.law) is not LinearLaw:
                raise LimbError(
                    f"The wire {wire.name} of the limb {limb.name} has the law "
                    f"{type(wire.law).__name__}; take a robot whose wires have the law LinearLaw."
                )


def segments_of(robot: RobotParameters) -> list[tuple[RobotLimb, SegmentParameters]]:
    """Return all segments of a robot, each with its limb."""
    return [(limb, segment) for limb in robot.limbs for segment in limb.parameters.segments]


def robot_xml(robot: RobotParameters) -> str:
    """Return MuJoCo's description of a robot on its ground."""
    root = ElementTree.Element("mujoco")
    add(root, "compiler", angle="radian", autolimits="true")
    options = {"cone": "elliptic", "impratio": FRICTION_RATIO, "tolerance": 1e-12}
    option = add(root, "option", integrator="implicitfast", gravity=sloped(robot), **options)
    add(option, "flag", autoreset="disable")  # a motion that blows up counts as a fall
    world = add(root, "worldbody")
    # The ground touches feet and body, and these do not touch each other.
    add(world, "geom", name="ground", type="plane", size=(0, 0, 1), contype=1, conaffinity=0)
    touches = {"contype": 0, "conaffinity": 1, "friction": (robot.ground.friction, 0, 0)}
    parts, body = robot.body, add(world, "body", name="body")
    if parts.mount == "free":
        add(body, "freejoint")
    else:
        add(body, "joint", type="slide", axis=(1, 0, 0))
        add(body, "joint", type="slide", axis=(0, 0, 1))
        add(body, "joint", type="hinge", axis=(0, -1, 0))  # turns +x to +z
    size = np.array([parts.length, parts.width, parts.height])
    moments = parts.mass / 12 * (size @ size - size**2)
    moments = moments if parts.inertia is None else parts.inertia
    add(body, "inertial", pos=(0, 0, 0), mass=parts.mass, diaginertia=moments)
    add(body, "geom", name="body", type="box", size=size / 2, **touches)
    for limb in robot.limbs:
        parent, place = body, {"pos": limb.position, "xyaxes": (*limb.e1, *limb.e2)}
        for segment in limb.parameters.segments:
            piece = segment.length / segment.links
            box = np.array([piece, segment.thickness, segment.width]) / 2
            for kinds in segment.joints:
                parent = add(parent, "body", **place)
                for kind in kinds:  # the first of them turns the others
                    spring = {
                        "stiffness": segment.stiffness * segment.joint_ratios[kind],
                        "damping": segment.damping * segment.joint_ratios[kind],
                        "springref": segment.joint_rest_angles[kind],
                    }
                    add(parent, "joint", type="hinge", axis=AXES[kind], **spring)
                mass, off = segment.mass / segment.links, {"contype": 0, "conaffinity": 0}
                add(parent, "geom", type="box", pos=(piece / 2, 0, 0), size=box, mass=mass, **off)
                place = {"pos": (piece, 0, 0)}
        mass = robot.feet.mass + limb.parameters.payload
        foot = {"name": f"{limb.name}_foot", "type": "sphere", "size": robot.feet.radius}
        add(parent, "geom", **foot, **place, mass=mass, priority=1, **touches)
    return ElementTree.tostring(root, encoding="unicode")


def add(parent: ElementTree.Element, tag: str, **attributes) -> ElementTree.Element:
    """Add an element whose attributes are texts, numbers or sequences of numbers."""
    texts = {
        name: value if isinstance(value, str) else " ".join(map(str, np.ravel(value).tolist()))
        for name, value in attributes.items()
    }
    return ElementTree.SubElement(parent, tag, texts)


def sloped(robot: RobotParameters) -> np.ndarray:
    """Return gravity (3,) in axes along and normal to a ground that rises along x, m/s²."""
    (x, y, z), slope = robot.gravity, robot.ground.slope
    return np.array(
        [x * np.cos(slope) + z * np.sin(slope), y, z * np.cos(slope) - x * np.sin(slope)]
    )


def make_model(robot: RobotParameters) -> mujoco.MjModel:
    """Return the model of a robot, with STIFFNESS and DAMPING of the contact of each foot.

    MuJoCo takes both as multiples of (1 - impedance) / m, with the inertia m that the body of the
    foot has in the straight robot, kg.
    """
    model = mujoco.MjModel.from_xml_string(robot_xml(robot))
    for limb in robot.limbs:
        foot = model.geom(f"{limb.name}_foot")
        mobility = model.body_invweight0[foot.bodyid[0], 0]  # 1/kg
        foot.solref = -np.array([STIFFNESS, DAMPING]) * (1 - IMPEDANCE) * mobility
        foot.solimp = [IMPEDANCE, IMPEDANCE, 1.0, 0.5, 1.0]  # at any depth
    return model


def torques_per_degree(robot: RobotParameters) -> np.ndarray:
    """Return the torque of each wire on each joint of the limbs per °C (n, W), N·m/°C."""
    blocks = []  # (joints, wires) of each segment
    for _, segment in segments_of(robot):
        kinds = itertools.chain.from_iterable(segment.joints)
        blocks.append([[torque_per_degree(wire, kind) for wire in segment.wires] for kind in kinds])
    return block_diag(*blocks)


def torque_per_degree(wire: WireParameters, kind: str) -> float:
    """Return the torque of a wire on a joint of a kind of its segment per °C, N·m/°C."""
    way = {"e2": wire.e2, "e3": wire.e3, "twist": 0.0}[kind]
    return wire.law.beta * way / np.hypot(wire.e2, wire.e3)


def walk(gait: Gait, cycles: int) -> tuple[list[np.ndarray], str]:
    """Simulate cycles of a gait from its first knot, at rest.

    Returns:
        The body's x, y and yaw, m and rad, at the start and after each completed cycle; and a
        sentence that says when the robot fell, empty if it did not.
    """
    robot, pose = gait.robot, gait.body_pose[:, 0]
    model, per_degree = make_model(robot), torques_per_degree(robot)
    data, joints = mujoco.MjData(model), len(per_degree)
    data.qpos[:3] = pose[:3]
    if len(pose) == 6:  # x, y, z, roll, pitch, yaw
        mujoco.mju_euler2Quat(data.qpos[3:7], pose[:2:-1], "zyx")
    data.qpos[-joints:] = gait.joint_state[:joints, 0]
    mujoco.mj_forward(model, data)
    laws = [wire.law for _, segment in segments_of(robot) for wire in segment.wires]
    a1, a2 = np.array([law.a1 for law in laws]), np.array([law.a2 for law in laws])
    warmth = gait.wire_temperature[:, 0] - robot.limbs[0].parameters.ambient_temperature
    poses, touching = [pose_of(data)], model.geom("body").id
    for cycle in range(1, cycles + 1):
        for duration, duty in zip(np.diff(gait.time), gait.duty.T, strict=False):
            steps = int(np.ceil(duration / TIME_STEP))
            model.opt.timestep = duration / steps
            decay, limit = np.exp(a1 * model.opt.timestep), -a2 * duty / a1
            for _ in range(steps):
                data.qfrc_applied[-joints:] = per_degree @ warmth
                mujoco.mj_step(model, data)
                warmth = limit + decay * (warmth - limit)
            upright = data.body("body").xmat[8] >= LEAST_UPRIGHT
            if touching in data.contact.geom or not upright:
                return poses, f"The robot falls in cycle {cycle}, after {data.time:.1f} s."
        poses.append(pose_of(data))
    return poses, ""


def pose_of(data: mujoco.MjData) -> np.ndarray:
    """Return the body's x, y and yaw (3,), m and rad."""
    body = data.body("body")
    return np.array([*body.xpos[:2], np.arctan2(body.xmat[3], body.xmat[0])])


def planned_pose(pose: np.ndarray) -> np.ndarray:
    """Return x, y and yaw (3,), m and rad, of a pose in the plane (3,) or in space (6,)."""
    return np.array([pose[0], 0.0, 0.0]) if len(pose) == 3 else pose[[0, 1, 5]]


def travel(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the travel between poses along and across the heading at the start, and the turn."""
    (x, y, turn), cosine, sine = end - start, np.cos(start[2]), np.sin(start[2])
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    return np.array([cosine * x + sine * y, cosine * y - sine * x, turn])


def shares(moved: np.ndarray, planned: np.ndarray, robot: RobotParameters) -> tuple[float, float]:
    """Return travel along and aside of the planned one, as shares of it.

    A turn counts as the way of a point that is as far away as the longest limb is long.
    """
    length = max(limb.parameters.length for limb in robot.limbs)
    moved, planned = moved * [1.0, 1.0, length], planned * [1.0, 1.0, length]
    along = moved @ planned / (planned @ planned)
    return along, np.linalg.norm(moved - along * planned) / np.linalg.norm(planned)


if __name__ == "__main__":
    main()
