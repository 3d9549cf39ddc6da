"""Feasible trajectories from references, by direct collocation (Sec. VI)."""

import limb_systems  # noqa: F401 - before what takes long, see limb_systems.startup
from planners import references
from planners.ipopt import ExactHessianIpoptSolver
from planners.planning import Planner, plan
from planners.program import TrajectoryProgram
from planners.quasi_static import InfeasibleError
from planners.solving import PlanningError
from planners.task import Phase, Task, TaskError

__all__ = [
    "ExactHessianIpoptSolver",
    "InfeasibleError",
    "Phase",
    "Planner",
    "PlanningError",
    "Task",
    "TaskError",
    "TrajectoryProgram",
    "plan",
    "references",
]
