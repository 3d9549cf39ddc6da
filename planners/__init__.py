"""Feasible trajectories from references, by direct collocation (Sec. VI)."""

import limb_systems  # noqa: F401 - before what takes long, see limb_systems.startup
from planners import references
from planners.grip import Grip, grip
from planners.nearest import nearest_bend_angle
from planners.planning import Planner, plan
from planners.task import Phase, Task, TaskError
from planners.transcription.ipopt import ExactHessianIpoptSolver
from planners.transcription.program import TrajectoryProgram
from planners.transcription.solving import InfeasibleError, PlanningError
from walking.gait_check import check_gait
from walking.gait_planning import plan_gait
from walking.gait_set import plan_gaits
from walking.walk_trajectory import walk

__all__ = [
    "ExactHessianIpoptSolver",
    "Grip",
    "InfeasibleError",
    "Phase",
    "Planner",
    "PlanningError",
    "Task",
    "TaskError",
    "TrajectoryProgram",
    "check_gait",
    "grip",
    "nearest_bend_angle",
    "plan",
    "plan_gait",
    "plan_gaits",
    "references",
    "walk",
]
