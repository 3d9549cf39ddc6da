"""Feedback about a plan, receding horizon, temperature supervisor, learning over repetitions."""

from controllers.estimator import LimbObserver
from controllers.learner import Learner
from controllers.plan_feedback import PlanFeedback, PlanRegulator
from controllers.receding_horizon import RecedingHorizon
from controllers.reduced_model import ReducedModel
from controllers.temperature_supervisor import TemperatureSupervisor, supervised

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
