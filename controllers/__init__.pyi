"""Feedback about a plan, receding horizon, temperature supervisor, learning over repetitions."""

from .estimator import LimbObserver
from .gait_feedback import GaitFeedback
from .heat_feedback import HeatFeedback
from .learner import Learner
from .plan_feedback import PlanFeedback, PlanRegulator
from .receding_horizon import RecedingHorizon
from .reduced_model import ReducedModel
from .temperature_supervisor import TemperatureSupervisor, supervised
from .wayfinder import Wayfinder

__all__ = [
    "GaitFeedback",
    "HeatFeedback",
    "Learner",
    "LimbObserver",
    "PlanFeedback",
    "PlanRegulator",
    "RecedingHorizon",
    "ReducedModel",
    "TemperatureSupervisor",
    "Wayfinder",
    "supervised",
]
