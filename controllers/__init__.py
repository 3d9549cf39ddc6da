"""Feedback about a plan, receding horizon, temperature supervisor, learning over repetitions."""

from controllers.receding_horizon import RecedingHorizon
from controllers.reduced_model import ReducedModel

__all__ = ["RecedingHorizon", "ReducedModel"]
