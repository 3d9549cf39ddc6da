"""How fast crawlers of two limbs walk, and how fast their gaits are planned.

Violations are calculated from the gait alone: balance, height of the feet, travel of those that
stick, friction and (6) of the heat of each interval, as shares of weight, length and T_max. With
--simulate, eight strides with contact are the least and the largest share of the planned one, of
the first gait that passes: a steadier one where the fastest does not.

    python benchmarks/gaits.py [nominal random cooling laws slope] [--simulate]
"""

import argparse

import numpy as np

from limb_systems import (
    Gait,
    HystereticLaw,
    LimbError,
    LinearLaw,
    RobotParameters,
    ThresholdLaw,
    TwoMassLaw,
    Wires,
)
from planners import plan_gait
from planners.gait.planar_robot import PlanarRobot

HEADER = "case | mm/s | stride, mm | period, s | iterations | s | violation | simulated"


def violation(gait: Gait) -> float:
    """The largest violation of what a gait has to hold, scaled."""
    planar, wires = PlanarRobot(gait.robot), Wires(gait.parameters)
    assert gait.robot.ground is not None
    mu = gait.robot.ground.friction
    load = np.hypot(*planar.weight)
    y, steps = np.vstack([gait.body_pose, gait.joint_angles]).T, np.diff(gait.time)
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
    violations += [np.abs(heights - planar.radius).max() / planar.size]
    violations += [np.abs(moved).max() / planar.size, gait.wire_temperature.max() / limit - 1]
    if all(isinstance(wire.law, LinearLaw) for wire in gait.parameters.wires):
        states, after = gait.wire_temperature[:, :-1].T, gait.wire_temperature[:, 1:].T
        rates = [wires.rates(at, gait.duty[:, :-1].T) for at in (states, after)]
        middle = 0.5 * (states + after) + steps[:, None] / 8 * (rates[0] - rates[1])
        mean = (rates[0] + 4 * wires.rates(middle, gait.duty[:, :-1].T) + rates[1]) / 6
        violations += [np.abs(after - states - steps[:, None] * mean).max() / limit]
    return float(max(violations))


def row(case: str, robot: RobotParameters, simulate: bool, **request) -> Gait | None:
    """Prints a row of a table; the gait, or None if there is none."""
    try:
        gait = plan_gait(robot, check=simulate, spread=False, **request)
    except LimbError as error:
        print(f"{case} | {error}", flush=True)
        return None
    check, made = gait.check, gait.check.simulation.strides
    strides = f"{min(made):.3f}-{max(made):.3f}" if made else ""
    print(
        f"{case} | {1e3 * gait.speed:.3f} | {1e3 * gait.stride:.1f} | {gait.period:.2f} | "
        f"{check.iterations} | {check.solve_time:.1f} | {violation(gait):.0e} | {strides}",
        flush=True,
    )
    return gait


def crawler(friction: float = 0.3, slope_deg: float = 0.0) -> RobotParameters:
    """The crawler on a ground."""
    robot = RobotParameters()
    assert robot.ground is not None
    robot.ground.friction, robot.ground.slope = friction, float(np.deg2rad(slope_deg))
    return robot


def random_walker(seed: int, alike: bool = True) -> RobotParameters:
    """A walker whose limbs differ in k, β, a1 and a2, and, unless alike, in length and place."""
    rng = np.random.default_rng(seed)
    robot = crawler(rng.uniform(0.3, 0.8))
    robot.body.mass = rng.uniform(0.010, 0.030)
    lengths, hips = rng.uniform([[0.05], [0.025]], [[0.07], [0.040]], (2, 2))
    for number, (limb, side) in enumerate(zip(robot.limbs, (-1.0, 1.0), strict=True)):
        segment = limb.parameters.segments[0]
        own = 0 if alike else number
        limb.position[0], segment.length = side * hips[own], lengths[own]
        k, beta, a1, a2 = rng.uniform(0.8, 1.2, 4)
        segment.stiffness *= k
        for wire in segment.wires:
            law = wire.law
            law.beta, law.a1, law.a2 = beta * law.beta, a1 * law.a1, a2 * law.a2
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
            for wire in robot.together.wires:
                wire.law.a1, wire.law.a2 = share * wire.law.a1, heating * wire.law.a2
            gait = row(f"a1 x {share}, a2 x {heating}", robot, simulate)
            if gait:
                print(f"    period x |a1| = {-gait.period * robot.together.wires[0].law.a1:.5f}")


def laws(simulate: bool) -> None:
    for law in (LinearLaw, TwoMassLaw, ThresholdLaw, HystereticLaw):
        for margin in (0.0, 15.0):
            robot = crawler()
            for wire in robot.together.wires:
                wire.law = law()
            row(f"{law.__name__}, margin {margin:g}", robot, simulate, temperature_margin=margin)


def slope(simulate: bool) -> None:
    for friction in (0.3, 0.6):
        row(f"5° up, mu {friction}", crawler(friction, 5.0), simulate)


if __name__ == "__main__":
    tables = {table.__name__: table for table in (nominal, random, cooling, laws, slope)}
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("tables", nargs="*", default=list(tables), help=", ".join(tables))
    parser.add_argument("--simulate", action="store_true", help="eight strides with contact")
    arguments = parser.parse_args()
    for name in arguments.tables:
        print(f"\n{name}: {HEADER}")
        tables[name](arguments.simulate)
