"""Feedback about a plan, receding horizon, temperature supervisor, learning over repetitions."""

from controllers.learning import Learner
from controllers.reduced_model import ReducedModel

__all__ = ["Learner", "ReducedModel"]
