"""Robots that lift their feet: what is planned, and what eight strides of it are in simulation.

- ``pairs``: two limbs at each end of the body, the crawler's, in the order around it; those of a
  diagonal are lifted together, so that the body always stands on a rear and a front foot.
- ``row``: three limbs in a row, each of two segments that can bend opposite ways; each is lifted
  by itself. It is simulated only if asked for: the program takes minutes, and often finds no gait.

In the vertical plane in which planar robots move, nothing rolls sideways.

    python benchmarks/stepping.py [pairs|row] [MU ...]
"""

import sys

import numpy as np

from limb_systems import RobotParameters
from limb_systems.model.parameters import LimbParameters, SegmentParameters
from limb_systems.model.robot_parameters import RobotLimb, walking_limb
from planners import PlanningError, plan_gait
from planners.gait.check import check_gait
from planners.gait.planar_robot import PlanarRobot
from planners.gait.schedules import schedule_of

FRICTIONS = (0.3, 0.6, 1.0)


def pairs() -> RobotParameters:
    """Four of the crawler's limbs on its body."""
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


def row() -> RobotParameters:
    """Three limbs of 10 g, as stiff as the crawler's, of two segments of 5 cm each."""
    limbs = []
    for name, x in (("rear", -0.06), ("middle", 0.0), ("front", 0.06)):
        segments = [SegmentParameters(length=0.05, mass=0.005, stiffness=0.25) for _ in range(2)]
        parameters = LimbParameters(segments=segments)
        limbs.append(RobotLimb(name, position=[x, 0.0, 0.0], parameters=parameters))
    robot = RobotParameters(limbs=limbs, total_duty=2.25)
    robot.body.length = 0.13
    return robot


ROBOTS = {
    "pairs": (pairs, "lsls ssss slsl ssss"),
    "row": (row, "lss sss sls sss ssl sss"),
}


def report(name: str, friction: float) -> str:
    """One line on a robot's gait at a friction."""
    make, text = ROBOTS[name]
    robot = make()
    assert robot.ground
    robot.ground.friction = friction
    try:
        gait = plan_gait(robot, schedule=schedule_of(text, len(robot.limbs)), check=False)
    except PlanningError as error:
        return f"{name}, mu {friction:g}: {error}"
    gait = check_gait(gait, spread=False)
    planar = PlanarRobot(robot)
    heights = planar.feet(np.vstack([gait.body_pose, gait.joint_angles]).T)[..., 1] - planar.radius
    lifted = 1e3 * heights.max(axis=0)
    made = gait.check.simulation
    strides = " ".join(f"{share:.3f}" for share in made.strides)
    return (
        f"{name}, mu {friction:g}: {text}, {gait.check.iterations} iterations, "
        f"{gait.check.solve_time:.1f} s; planned {1e3 * gait.stride:.1f} mm in "
        f"{gait.period:.1f} s, {1e3 * gait.speed:.2f} mm/s, feet lifted by {lifted.min():.1f} to "
        f"{lifted.max():.1f} mm; strides made {strides}; {gait.check.failure() or 'passed'}"
    )


def main(arguments: list[str]) -> None:
    """Prints the report of each robot and friction asked for; by default, of the pairs."""
    names = [name for name in arguments if name in ROBOTS] or ["pairs"]
    frictions = [float(mu) for mu in arguments if mu not in ROBOTS] or FRICTIONS
    for name in names:
        for friction in frictions:
            print(report(name, friction), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
