"""Feasible trajectories from references, by direct collocation (Sec. VI)."""

from . import references
from .grip import Grip, grip
from .nearest import nearest_bend_angle
from .planning import Planner, plan
from .task import Phase, Task, TaskError
from .transcription.ipopt import ExactHessianIpoptSolver
from .transcription.program import TrajectoryProgram
from .transcription.solving import InfeasibleError, PlanningError

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
    "grip",
    "nearest_bend_angle",
    "plan",
    "references",
]
