"""Strides of robots of four limbs that are not quite as described, on hard feet and on soft ones.

The gait ahead of `RobotParameters.in_space(4)` is planned for feet of each stiffness. Its second
stride is then simulated in MuJoCo, with the heat held to the plan, on robots of which k and β of
each limb differ by up to 10%, rest angles by 0.5°, friction by 30%, and hips by 1 mm in height and
place.

With ``--spot`` the robot turns on the spot, by the gait of `plan_gaits`. With ``--level`` a scale
of 1 g weighs what each foot of the standing robot carries, and shims below the feet take out the
warp that this tells. With ``--calibrated`` the gait is as for calibrated robots.

    python benchmarks/strides_on_soft_feet.py [--draws 10] [--stiffness 200] [--calibrated] [--spot]
        [--level] [--replan]
"""

import argparse
import copy
import dataclasses

import numpy as np

from limb_systems import simulate
from limb_systems.limb_parameters import CalibrationRecord
from planners import PlanningError
from walking import Gait, Robot, RobotParameters, plan_gait
from walking.commands.gaits import MIN_KEPT_STRIDE_SHARE, replan_gait
from walking.gait_check import (
    scale_limb,
    simulate_gait,
    warp_pattern,
    with_friction,
    with_warp_and_friction,
)
from walking.gait_request import GaitRequest
from walking.gait_set import plan_spot_turn
from walking.in_mujoco import simulate_in_mujoco
from walking.strides import fit_strides

MARGIN = 5.0  # °C
HIPS = 1e-3  # m
GRAM = 9.81e-3  # N, a step of a kitchen scale
STANDING_TIME = 1.5  # s, until the robot rests on its feet


def drawn(robot: RobotParameters, seed: int) -> RobotParameters:
    """Return a robot that differs from its description."""
    uniform = np.random.default_rng(seed).uniform
    robot = with_friction(copy.deepcopy(robot), uniform(0.7, 1.3))
    for limb in robot.limbs:
        scale_limb(limb.parameters, uniform(0.9, 1.1), {"beta": uniform(0.9, 1.1)})
        limb.position = (limb.position + uniform(-HIPS, HIPS, 3)).tolist()
        for segment in limb.parameters.segments:
            segment.rest_angle += np.deg2rad(uniform(-0.5, 0.5))
            segment.rest_angle_e3 += np.deg2rad(uniform(-0.5, 0.5))
    return robot


def leveled(robot: RobotParameters) -> RobotParameters:
    """Return a robot with shims that take out the warp that a scale of 1 g tells."""
    cold = np.zeros(len(robot.as_single_limb.wires))
    forces = simulate(Robot(robot, time_step=2e-3), cold, STANDING_TIME).contact_force
    assert forces is not None
    loads = GRAM * np.round(forces[2::3, -1] / GRAM)
    warp = -loads @ warp_pattern(robot) / robot.contact_stiffness
    return with_warp_and_friction(robot, -warp, 0.0)


def replanned(gait: Gait, robot: RobotParameters) -> str:
    """Return what the fit to two strides says, and what strides of the new gait are, in words."""
    recording = simulate_in_mujoco(gait, robot, 2)
    # The wires have the gait's heat.
    fit = fit_strides(gait, recording, 0.0, 2)
    again, said = replan_gait(gait, fit.robot)
    made = simulate_gait(again, "", robot, 2)
    shares = ", ".join(f"{share:.2f}" for share in made.strides)
    found = ", ".join(f"{name} {value.value:.3g}" for name, value in fit.estimates.items())
    return f"{found}; {said}; strides {shares} {made.fall}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--replan", action="store_true", help="plan anew where a stride is < 0.9")
    parser.add_argument("--level", action="store_true", help="weigh the feet, and shim them")
    parser.add_argument("--calibrated", action="store_true", help="robots as if calibrated")
    parser.add_argument("--spot", action="store_true", help="turn on the spot")
    parser.add_argument("--only", type=int, nargs="+", help="draws (default: the first ones)")
    parser.add_argument("--stiffness", type=float, nargs="+", default=[2e4, 1e3, 200.0])
    options = parser.parse_args()
    for stiffness in options.stiffness:
        robot = RobotParameters.in_space(4)
        if options.calibrated:
            for limb in robot.limbs:
                limb.parameters.calibration = CalibrationRecord([], [], [], [])
        damping = robot.feet.damping / robot.feet.stiffness * stiffness
        robot.feet = dataclasses.replace(robot.feet, stiffness=stiffness, damping=damping)
        # On the spot, `plan_gaits` takes no gait with which a robot of the spread falls.
        request = GaitRequest(temperature_margin=MARGIN, spread=options.spot, explain=False)
        try:
            gait = (
                plan_spot_turn(robot, 1.0, request) if options.spot else plan_gait(robot, request)
            )
        except PlanningError as error:
            print(f"{stiffness:g} N/m: {error}", flush=True)
            continue
        print(f"{stiffness:g} N/m: {gait!r}", flush=True)
        if gait is None:
            continue
        for seed in options.only or range(options.draws):
            other = drawn(robot, seed)
            if options.level:
                other = leveled(other)
            made = simulate_gait(gait, "", other, 2)
            shares = ", ".join(f"{share:.2f}" for share in made.strides)
            print(f"  draw {seed}: {shares} {made.fall}", flush=True)
            if options.replan and made.strides[-1:] and made.strides[-1] < MIN_KEPT_STRIDE_SHARE:
                print(f"    {replanned(gait, other)}", flush=True)


if __name__ == "__main__":
    main()
