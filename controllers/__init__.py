"""Feedback about a plan, receding horizon, temperature supervisor, learning over repetitions."""

from controllers.learning import Learner
from controllers.limb_observer import LimbObserver
from controllers.margins import Margins, stability_margins
from controllers.plan_feedback import PlanFeedback
from controllers.plan_regulator import PlanRegulator
from controllers.receding_horizon import RecedingHorizon
from controllers.reduced_model import ReducedModel
from controllers.temperature_supervisor import TemperatureSupervisor, supervised

__all__ = [
    "Learner",
    "LimbObserver",
    "Margins",
    "PlanFeedback",
    "PlanRegulator",
    "RecedingHorizon",
    "ReducedModel",
    "TemperatureSupervisor",
    "stability_margins",
    "supervised",
]
