"""Feasible trajectories from references, by direct collocation (Sec. VI)."""

from planners import references
from planners.planning import PlanningError, plan
from planners.quasi_static import InfeasibleError

__all__ = ["InfeasibleError", "PlanningError", "plan", "references"]
