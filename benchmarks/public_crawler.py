"""A crawler that another program simulated, rebuilt in Drake: where its centre of mass goes.

The crawler is the planar tripod of https://github.com/softmachineslab/horton_der_2d, a program of
discrete elastic rods. Two of its logs, the same run as far as both go, have its centre of mass:
simTripodRBState_2021_02_23_091909.csv to 0.625 s and ..._102610.csv to 0.98 s. Numbers here are
from its options_default.txt and from the files named below.

Five limbs of 13 edges make a rear leg, half the spine, a middle leg, the other half and a front
leg; each leg stands on a triangular foot. Nodes carry equal masses, edges are links, and 67 joints
have springs whose rest angles follow the curvature of heated wires. All is per metre of width.
What that program does, and a rod does not, is done here, too:

- every force is halved, gravity included, which leaves equilibria as they are but not motion;
- EI = E r³/12, and the mass of r thickness, 0.427 kg, is shared by 72 nodes;
- the curvature of a bend by φ is 2 tan(φ/2), whatever the edges' length;
- the lowest bend of the rear leg, number 0, gets the curvature of the front leg.

Its edges stretch, by some 1e-4, and these do not; its ground is rigid, this one yields by 0.1 µm.
This one starts at rest, which that one has come to when its first wire is heated. `Robot` cannot
describe it: its limbs keep their stiffness, and its feet are spheres fixed to them. Contact,
frames and time step are as in `Robot`.

    python benchmarks/public_crawler.py [LOG]
"""

import sys

import numpy as np
from pydrake.geometry import AddContactMaterial, Box, ProximityProperties, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PlanarJoint,
    RevoluteJoint,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from walking.robot import GROUND_SIZE, PLANE_ROTATION, TIME_STEP, add_contact_plant

# options_default.txt
EDGES, LIMB, FOOT, RADIUS = 13, 0.022, 0.2 * 0.022, 2e-3  # edges of a limb; m
MODULUS, DENSITY, VISCOSITY, FRICTION = 3e6, 1912.0, 8e-3, 0.8  # Pa, kg/m³, s, 1
TOP_CURVATURE = 0.4  # of a hot wire; its limb has the mean of it and of a cold one's, 0

# elasticRod.cpp, timeStepper.cpp
SHARE, GRAVITY = 0.5, 9.81  # of every force; m/s²
BENDING, MASS = MODULUS * RADIUS**3 / 12, 5 * LIMB / 71 * RADIUS * DENSITY  # N·m², kg of a node

# world.cpp, shapeMemoryAlloy.cpp: a wire is hot in 0.05 s, makes its limb stiffer, and cools as a
# logistic function does. tripod_ol_gait_fm_2020-09-03.csv: from 0.2 s to 1 s three wires have the
# duty 0.005 of 80 ms, which in steps of 1 ms is 1 ms.
HEATING_TIME, STIFFENING, COOLING_RATE, COOLING_TIME = 0.05, 1.68, 3.4, 1.4  # s, 1, 1/s, s
FIRST_PULSE, PERIOD = 239, 80  # steps
# Nodes at which the limbs with these wires bend, and to which side.
HEATED = [(range(2, 12), 1.0), (range(28, 39), -1.0), (range(54, 65), -1.0), (range(1, 2), -1.0)]
LOGGED = {0.625: -2.477, 0.98: -4.728}  # s, mm: x of the centre of mass

# Nodes 0 to 65 are in the limbs, from the rear foot on, 66 to 71 heels and toes. At node 26,
# the middle of the spine, node 27 begins the middle leg and node 40 the rest of the spine. Body n
# ends in node n and turns at the node before; the rear foot is body 0, the others are 66 and 67.
SPINE = 26
LIMB_NODES = 66
ANKLES = (0, 39, 65)
BEFORE = [0, *(SPINE if node == 40 else node - 1 for node in range(1, LIMB_NODES))]
BODY_OF = [*range(LIMB_NODES), 0, 0, 66, 66, 67, 67]
TURNS_AT = [*BEFORE, *ANKLES[1:]]
# Bends, as three nodes each.
BENDS = np.array(
    [(BEFORE[BEFORE[node]], BEFORE[node], node) for node in range(2, LIMB_NODES)]
    + [(27, SPINE, 40)]
    + [(1, 0, 66), (67, 0, 1), (38, 39, 68), (69, 39, 38), (64, 65, 70), (71, 65, 64)]
)


def straight_nodes() -> np.ndarray:
    """Return nodes (72, 2) as made, x and z, m: feet on the ground, centre of mass at x = 0."""
    height = FOOT * np.sqrt(3) / 2
    edge = LIMB / EDGES
    turn = np.deg2rad(20.0)
    tilt = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    corner = np.array([0.0, height])
    nodes = [corner]
    for limb, way in enumerate(np.array([[0, 1], [1, 0], [0, -1], [1, 0], [0, -1]], float)):
        start = corner + np.array([0.0, LIMB if limb == 3 else 0.0])  # the middle leg is left there
        corner = start + LIMB * way
        nodes += [start + step * edge * way for step in range(1, EDGES)]
        nodes.append(corner if limb in (2, 4) else corner + edge * (tilt @ way - way))
    for ankle in ANKLES:
        nodes += [nodes[ankle] + [side * FOOT / 2, -height] for side in (-1, 1)]
    return np.array(nodes) - [np.mean(nodes, axis=0)[0], 0.0]


def bent_by() -> np.ndarray:
    """Return the bends (71) by the pitch of the rear foot and the joints' angles (1 + 67)."""
    turned = np.eye(len(TURNS_AT))
    for body in range(1, len(turned)):
        turned[body] += turned[BODY_OF[TURNS_AT[body]]]
    first, last = (BENDS[:, k : k + 2].max(axis=1) for k in (0, 1))
    return turned[np.take(BODY_OF, first)] - turned[np.take(BODY_OF, last)]


def add_crawler(plant: MultibodyPlant, nodes: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Add all and finalize the plant; return the indices of pitch and joints in its positions."""
    contact = ProximityProperties()
    below = RigidTransform([0.0, 0.0, -GROUND_SIZE[2] / 2])
    AddContactMaterial(0.0, 1e7, CoulombFriction(FRICTION, FRICTION), contact)
    world = plant.world_body()
    joints = []
    plant.RegisterCollisionGeometry(world, below, Box(*GROUND_SIZE), "ground", contact)
    for number, node in enumerate(TURNS_AT):
        inertia = SpatialInertia.Zero()
        for own in np.flatnonzero(np.array(BODY_OF) == number):
            lever = np.array([*(nodes[own] - nodes[node]), 0.0])  # frames are in the plane
            inertia += SpatialInertia(MASS, lever, UnitInertia.PointMass(lever))
        body = plant.AddRigidBody(f"body_{number}", inertia)
        parent = world
        place = RigidTransform(PLANE_ROTATION)
        if number:
            before = BODY_OF[node]
            parent = joints[before].child_body()
            place = RigidTransform([*(nodes[node] - nodes[TURNS_AT[before]]), 0.0])
        frame = plant.AddFrame(FixedOffsetFrame(f"from_{number}", parent.body_frame(), place))
        kind, *more = (RevoluteJoint, [0, 0, 1], damping[number]) if number else (PlanarJoint,)
        joints.append(plant.AddJoint(kind(f"joint_{number}", frame, body.body_frame(), *more)))
    for tip in range(LIMB_NODES, len(BODY_OF)):
        place = RigidTransform([*(nodes[tip] - nodes[TURNS_AT[BODY_OF[tip]]]), 0.0])
        foot = joints[BODY_OF[tip]].child_body()
        plant.RegisterCollisionGeometry(foot, place, Sphere(1e-5), f"node_{tip}", contact)
    joints[0].set_default_translation(nodes[0])
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -SHARE * GRAVITY])
    plant.Finalize()
    return np.array([joint.position_start() + 2 * (joint is joints[0]) for joint in joints])


def heat(steps: int) -> np.ndarray:
    """Return the heat of a heated wire in each step, as a share of its top."""
    hot = np.zeros(steps + 1)
    top = 0.0
    since = 0
    for step in range(steps):
        if step >= FIRST_PULSE and (step - FIRST_PULSE) % PERIOD == 0:
            hot[step + 1] = top = hot[step] + TIME_STEP / HEATING_TIME
            since = step + 1
        else:
            cooled = COOLING_RATE * ((step + 1 - since) * TIME_STEP - COOLING_TIME)
            hot[step + 1] = top - top / (1 + np.exp(-cooled))
    return hot


def simulate_crawler(duration: float = 0.981) -> tuple[np.ndarray, np.ndarray]:
    """Return times (K,), s, and the centre of mass (2, K) at them, x and z, m."""
    nodes = straight_nodes()
    bent = bent_by()
    edges = [nodes[BENDS[:, k + 1]] - nodes[BENDS[:, k]] for k in (0, 1)]
    across = edges[0][:, 1] * edges[1][:, 0] - edges[0][:, 0] * edges[1][:, 1]
    made = np.arctan2(across, np.sum(edges[0] * edges[1], axis=1))  # rad, to the right
    stiffness = SHARE * BENDING / np.mean(np.linalg.norm(edges, axis=2), axis=0)
    side = np.zeros(len(BENDS))
    for middles, sign in HEATED:
        side[np.isin(BENDS[:, 1], middles)] = sign

    builder = DiagramBuilder()
    plant = add_contact_plant(builder)
    damping = VISCOSITY * stiffness / np.cos(made / 2) ** 4 @ bent**2
    angles = add_crawler(plant, nodes, damping)
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    force = np.zeros(plant.num_velocities())
    path = []
    for step, hot in enumerate(heat(round(duration / TIME_STEP))):
        simulator.AdvanceTo(step * TIME_STEP)
        path.append(plant.CalcCenterOfMassPositionInWorld(context)[[0, 2]])
        bend = made + bent @ plant.GetPositions(context)[angles]
        rest = np.where(side, side * hot * TOP_CURVATURE / 2, 2 * np.tan(made / 2))
        stiffer = np.where(side, 1 + hot * STIFFENING / 2, 1.0)
        torque = stiffness * stiffer * (2 * np.tan(bend / 2) - rest) / np.cos(bend / 2) ** 2
        force[angles] = -torque @ bent
        plant.get_applied_generalized_force_input_port().FixValue(context, force)
    return np.arange(len(path)) * TIME_STEP, np.transpose(path)


def main() -> None:
    times, (x, z) = simulate_crawler()
    for time, logged in LOGGED.items():
        found = 1e3 * np.interp(time, times, x)
        print(f"x at {time} s: {found:.3f} mm, in the log {logged:.3f} mm")
    if len(sys.argv) > 1:
        log = np.loadtxt(sys.argv[1], delimiter=",", skiprows=3).T
        log = log[:, (log[0] > 0.1999) & (log[0] < 0.9801)]
        for name, ours, logged in (("x", x, log[1]), ("z", z, log[2])):
            off = 1e3 * np.abs(np.interp(log[0], times, ours) - logged)
            rms = np.sqrt(np.mean(off**2))
            print(f"{name} from 0.2 to {log[0, -1]} s: {rms:.4f} mm rms, {off.max():.4f} at most")


if __name__ == "__main__":
    main()
