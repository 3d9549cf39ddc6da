"""The speed of robots, and the time to plan their gaits.

The robots are crawlers of two limbs, but for the table ``lifting``:

- ``pairs``: two limbs at each end of the body, the crawler's, in the order around it; limbs of a
  diagonal are lifted together, so that the body always stands on a rear and a front foot.
- ``row``: three limbs in a row, each of two segments that can bend opposite ways; each is lifted
  by itself. The program takes minutes, and often finds no gait.

In the vertical plane in which planar robots move, nothing rolls sideways.

Violations are calculated from the gait alone: balance, height of the feet, travel of those that
stick, friction and (6) of the heat of each interval, as shares of weight, length and T_max. With
--simulate, the strides of the check are the least and the largest share of the planned one, of
the first gait that passes: a steadier one where the fastest does not.

    python benchmarks/gaits.py [nominal random cooling slope lifting] [--simulate]
"""

import argparse

import numpy as np

from limb_systems import LimbError, LimbModel, LimbParameters, LinearLaw, SegmentParameters
from walking import Gait, RobotParameters, plan_gait
from walking.gait_check import scale_limb
from walking.robot_parameters import RobotLimb, walking_limb
from walking.schedules import parse_schedule
from walking.walker import Walker

HEADER = "case | mm/s | stride, mm | period, s | iterations | s | violation | simulated"


def violation(gait: Gait) -> float:
    """Return the largest violation of what a gait has to hold, scaled."""
    planar = Walker(gait.robot)
    wires = LimbModel.of(gait.parameters).wires
    mu = gait.robot.ground.friction
    load = np.linalg.norm(planar.weight)
    y = np.vstack([gait.body_pose, gait.joint_angles]).T
    steps = np.diff(gait.time)
    forces = gait.contact_force.T.reshape(len(y), -1, 2)
    by_feet = planar.feet_jacobian(y)
    balance = planar.potential.first(y)[1][:, 0] - np.einsum("kfc,kfcd->kd", forces, by_feet)
    balance[:, 3:] -= wires.forces(gait.wire_states.T, gait.joint_angles.T)
    balance[:, 2:] /= planar.size
    travel, heights = np.moveaxis(planar.feet(y), -1, 0)
    phases = np.searchsorted([p.start for p in gait.phases], gait.time[:-1] + 1e-9) - 1
    contacts = np.array([gait.phases[p].contacts for p in phases])
    moved = np.diff(travel, axis=0)[contacts == "stick"]
    excess = np.abs(forces[..., 0]) - mu * forces[..., 1]
    limit = gait.parameters.temperature_limits.maximum
    violations = [np.abs(balance).max() / load, excess.max() / load]
    pressed = forces[:-1, :, 1] / gait.robot.contact_stiffness * (contacts != "swing").all()
    off_ground = np.abs(heights[:-1] + pressed - planar.radius)[contacts != "swing"]
    violations += [off_ground.max() / planar.size]
    violations += [np.abs(moved).max() / planar.size, gait.wire_temperature.max() / limit - 1]
    if all(isinstance(wire.law, LinearLaw) for wire in gait.parameters.wires):
        states = gait.wire_temperature[:, :-1].T
        after = gait.wire_temperature[:, 1:].T
        rates = [wires.rates(at, gait.duty[:, :-1].T) for at in (states, after)]
        middle = 0.5 * (states + after) + steps[:, None] / 8 * (rates[0] - rates[1])
        mean = (rates[0] + 4 * wires.rates(middle, gait.duty[:, :-1].T) + rates[1]) / 6
        violations += [np.abs(after - states - steps[:, None] * mean).max() / limit]
    return float(max(violations))


def row(case: str, robot: RobotParameters, simulate: bool, **request) -> Gait | None:
    """Print a row of a table; return the gait, or None if there is none."""
    try:
        gait = plan_gait(robot, check=simulate, spread=False, **request)
    except LimbError as error:
        print(f"{case} | {error}", flush=True)
        return None
    check = gait.check
    made = gait.check.simulation.strides
    strides = f"{min(made):.3f}-{max(made):.3f}" if made else ""
    print(
        f"{case} | {1e3 * gait.speed:.3f} | {1e3 * gait.stride:.1f} | {gait.period:.2f} | "
        f"{check.iterations} | {check.solve_time:.1f} | {violation(gait):.0e} | {strides}",
        flush=True,
    )
    return gait


def crawler(friction: float = 0.3, slope_deg: float = 0.0) -> RobotParameters:
    """Return the crawler on a ground."""
    robot = RobotParameters()
    robot.ground.friction = friction
    robot.ground.slope = float(np.deg2rad(slope_deg))
    return robot


def random_walker(seed: int, alike: bool = True) -> RobotParameters:
    """Return a walker whose limbs differ in k, β, a1, a2 and, unless alike, in length and place."""
    rng = np.random.default_rng(seed)
    robot = crawler(rng.uniform(0.3, 0.8))
    robot.body.mass = rng.uniform(0.010, 0.030)
    lengths, hips = rng.uniform([[0.05], [0.025]], [[0.07], [0.040]], (2, 2))
    for number, (limb, side) in enumerate(zip(robot.limbs, (-1.0, 1.0), strict=True)):
        own = 0 if alike else number
        limb.position[0] = side * hips[own]
        limb.parameters.segments[0].length = lengths[own]
        k, beta, a1, a2 = rng.uniform(0.8, 1.2, 4)
        scale_limb(limb.parameters, k, {"beta": beta, "a1": a1, "a2": a2})
    return robot


def nominal(simulate: bool) -> None:
    for friction in (0.3, 0.6):
        row(f"mu {friction}", crawler(friction), simulate)
        row(f"mu {friction}, energy", crawler(friction), simulate, objective="energy")


def random(simulate: bool) -> None:
    for seed in range(20):
        row(f"walker {seed}", random_walker(seed), simulate)
    for seed in range(20):
        row(f"walker {seed}, limbs of other lengths", random_walker(seed, False), simulate)


def cooling(simulate: bool) -> None:
    for share in (1.0, 0.5, 0.25):
        for heating in dict.fromkeys((1.0, share)):
            robot = crawler()
            for wire in robot.as_single_limb.wires:
                wire.law.a1 = share * wire.law.a1
                wire.law.a2 = heating * wire.law.a2
            gait = row(f"a1 x {share}, a2 x {heating}", robot, simulate)
            if gait:
                print(
                    f"    period x |a1| = {-gait.period * robot.as_single_limb.wires[0].law.a1:.5f}"
                )


def slope(simulate: bool) -> None:
    for friction in (0.3, 0.6):
        row(f"5° up, mu {friction}", crawler(friction, 5.0), simulate)


def pairs() -> RobotParameters:
    """Return four of the crawler's limbs on its body."""
    corners = {
        "rear_left": [-0.03, 0.02, 0.0],
        "front_left": [0.03, 0.02, 0.0],
        "front_right": [0.03, -0.02, 0.0],
        "rear_right": [-0.03, -0.02, 0.0],
    }
    return RobotParameters(
        limbs=[
            RobotLimb(name, position=place, parameters=walking_limb())
            for name, place in corners.items()
        ]
    )


def three_in_a_row() -> RobotParameters:
    """Return three limbs of 10 g, as stiff as the crawler's, of two segments of 5 cm each."""
    limbs = []
    for name, x in (("rear", -0.06), ("middle", 0.0), ("front", 0.06)):
        segments = [SegmentParameters(length=0.05, mass=0.005, stiffness=0.25) for _ in range(2)]
        parameters = LimbParameters(segments=segments)
        limbs.append(RobotLimb(name, position=[x, 0.0, 0.0], parameters=parameters))
    robot = RobotParameters(limbs=limbs, total_duty=2.25)
    robot.body.length = 0.13
    return robot


def lifting(simulate: bool) -> None:
    for name, make, text in (
        ("pairs", pairs, "lsls ssss slsl ssss"),
        ("row", three_in_a_row, "lss sss sls sss ssl sss"),
    ):
        for friction in (0.3, 0.6, 1.0):
            robot = make()
            robot.ground.friction = friction
            schedule = parse_schedule(text, len(robot.limbs))
            gait = row(f"{name}, mu {friction}", robot, simulate, schedule=schedule)
            if gait:
                planar = Walker(robot)
                feet = planar.feet(np.vstack([gait.body_pose, gait.joint_angles]).T)[..., 1]
                lifted = 1e3 * (feet - planar.radius).max(axis=0)
                print(f"    feet lifted by {lifted.min():.1f} to {lifted.max():.1f} mm")


if __name__ == "__main__":
    tables = {t.__name__: t for t in (nominal, random, cooling, slope, lifting)}
    quick = [name for name in tables if name != "lifting"]
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("tables", nargs="*", default=quick, help=", ".join(tables))
    parser.add_argument("--simulate", action="store_true", help="check by simulation")
    arguments = parser.parse_args()
    for name in arguments.tables:
        print(f"\n{name}: {HEADER}")
        tables[name](arguments.simulate)
