"""Gaits of the default robots in space: time to plan them, and what they make in MuJoCo's contact.

python benchmarks/gaits_in_space.py
"""

import math
import time

import numpy as np

from planners import PlanningError
from walking import Gait, RobotParameters, plan_gait
from walking.gait_check import simulate_gait
from walking.gait_set import schedules_on_the_spot
from walking.schedules import candidate_schedules

ROW = "{:<7}{:<20}{:<28}{:>7}{:>7}  {:<15}{:>6}"
MARGIN, CYCLES = 5.0, 5  # °C; simulated, from the heat of the limit cycle
COURSES = {
    "ahead": {},
    "arc to the left": {"turn": 0.2},
    "arc to the right": {"turn": -0.2},
    "on the spot, left": {"turn": 0.4, "stride": 0.0},
    "on the spot, right": {"turn": -0.4, "stride": 0.0},
    "as far as it turns": {"turn": math.inf},
    "1 mm/s, least heat": {"speed": 1e-3},
}


def goes(gait: Gait) -> str:
    """Return the planned stride of a cycle and its duration, in words."""
    parts = [] if gait.on_the_spot else [f"{1e3 * gait.stride:.1f} mm"]
    parts += [f"{np.rad2deg(gait.turn):+.1f}°"] if abs(gait.turn) > 1e-6 else []
    return f"{', '.join(parts)} in {gait.period:.1f} s"


def main() -> None:
    print(ROW.format("limbs", "gait", "planned", "CPU, s", "iter.", "made, of plan", "aside"))
    for limbs in (3, 4):
        robot = RobotParameters.in_space(limbs)
        for name, request in COURSES.items():
            turns = "spot" in name or "as far" in name
            schedule = (schedules_on_the_spot if turns else candidate_schedules)(robot)[0]
            began = time.process_time()
            try:
                gait = plan_gait(
                    robot,
                    schedule=schedule,
                    temperature_margin=MARGIN,
                    check=False,
                    explain=False,
                    **request,
                )
            except PlanningError as error:
                print(ROW.format(limbs, name, f"none: {error}", *[""] * 4), flush=True)
                continue
            taken = time.process_time() - began
            made = simulate_gait(gait, "", robot, CYCLES)
            shares = f"{min(made.strides):.3f}-{max(made.strides):.3f}" if made.strides else ""
            aside = f"{max(made.aside, default=math.nan):.1%}"
            how = f"{taken:.1f}", f"{gait.check.iterations}"
            print(ROW.format(limbs, name, goes(gait), *how, shares + made.fall, aside), flush=True)


if __name__ == "__main__":
    main()
