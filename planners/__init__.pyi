"""Feasible trajectories from references, by direct collocation (Sec. VI)."""

from . import references
from .nearest import nearest_bend_angle
from .planning import Planner, plan
from .task import Phase, Task, TaskError
from .transcription.ipopt import ExactHessianIpoptSolver
from .transcription.program import TrajectoryProgram
from .transcription.solving import InfeasibleError, PlanningError

__all__ = [
    "ExactHessianIpoptSolver",
    "InfeasibleError",
    "Phase",
    "Planner",
    "PlanningError",
    "Task",
    "TaskError",
    "TrajectoryProgram",
    "nearest_bend_angle",
    "plan",
    "references",
]
