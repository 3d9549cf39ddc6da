"""Feasible trajectories from references, by direct collocation (Sec. VI)."""

import importlib
from typing import Any

from planners import references
from planners.grip import Grip, grip
from planners.nearest import nearest_bend_angle
from planners.planning import Planner, plan
from planners.task import Phase, Task, TaskError
from planners.transcription.ipopt import ExactHessianIpoptSolver
from planners.transcription.program import TrajectoryProgram
from planners.transcription.solving import InfeasibleError, PlanningError

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


def __getattr__(name: str) -> Any:
    """`plan_gait`, which is in `walking`."""
    if name == "plan_gait":
        return getattr(importlib.import_module("walking"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
