"""Feedback about a plan, receding horizon, temperature supervisor, learning over repetitions."""

from .estimator import LimbObserver
from .learner import Learner
from .plan_feedback import PlanFeedback, PlanRegulator
from .receding_horizon import RecedingHorizon
from .reduced_model import ReducedModel
from .temperature_supervisor import TemperatureSupervisor, supervised

__all__ = [
    "Learner",
    "LimbObserver",
    "PlanFeedback",
    "PlanRegulator",
    "RecedingHorizon",
    "ReducedModel",
    "TemperatureSupervisor",
    "supervised",
]
